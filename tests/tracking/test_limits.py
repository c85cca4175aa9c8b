"""Evidence that no joint can follow is not followed: every pose that comes out lies within the limits."""

import numpy as np
import pytest

from hypose.evidence.keypoints import BODY_25B
from hypose.tracking.frame_evidence import keypoint_model
from hypose.tracking.keypoint_clip import track_keypoint_clip
from hypose.tracking.recipes import recipe
from hypose.tracking.smoothing import smooth_motion
from hypose.tracking.tracker import Tracker, motion_of
from tests.tracking.test_keypoint_evidence import seen_by

HINGES = ("left_knee", "right_knee", "left_elbow", "right_elbow")


@pytest.fixture
def broken(body, standing):
    """Poses (5, D) whose knees and elbows bend the wrong way, further and further."""
    hinges = body.skeleton.dofs_of(*HINGES)
    poses = np.repeat(standing[None], 5, 0)
    poses[:, hinges] = body.skeleton.lower[hinges] - np.linspace(0, 0.6, 5)[:, None]
    return poses


def within(body, poses):
    s = body.skeleton
    return bool((poses >= s.lower - 1e-9).all() and (poses <= s.upper + 1e-9).all())


@pytest.mark.parametrize("name", ["default", "hpf", "hpf-apo"])
def test_limits_hold_while_tracking_silhouettes_and_in_the_clip(body, standing, broken, frame_of, name):
    tracker = Tracker(body, recipe(name, body, particles=24))
    state, estimates = tracker.start(standing), []
    for t, pose in enumerate(broken):
        state, estimate = tracker.step(state, frame_of(body, pose, t))
        estimates.append(estimate)
    motion = motion_of(body, np.arange(5) / 25, estimates)
    assert within(body, motion.poses)
    smooth = smooth_motion(body, motion, np.stack([e.uncertainty.information for e in estimates])).motion
    assert within(body, smooth.poses)


def test_limits_hold_for_key_points(body, standing, broken, small_rig):
    model = keypoint_model(body, BODY_25B)
    seen = [seen_by(small_rig, model, body, q) for q in broken]
    poses = track_keypoint_clip(body, model, seen, standing, 25.0).motion.poses
    assert within(body, poses)
    hinges = body.skeleton.dofs_of(*HINGES)
    assert (poses[-1, hinges] < body.skeleton.lower[hinges] + 0.1).all()  # as far as it goes


def test_a_shoulder_goes_on_beyond_half_a_turn(body, standing, small_rig):
    """The rotation vector of a shoulder that turns on would end in the corner of its limits, the other branch's not."""
    s, model = body.skeleton, keypoint_model(body, BODY_25B)
    axis = np.array([1.0, -1.0, 0.7]) / np.linalg.norm([1.0, -1.0, 0.7])
    turning = np.repeat(standing[None], 14, 0)
    turning[:, s.dofs_of("left_shoulder")] = np.linspace(2.4, 5.0, 14)[:, None] * axis
    turning[:, s.dofs_of("left_elbow")] = 0.8
    assert (turning[-1] > s.upper + 0.3).any()
    seen = [seen_by(small_rig, model, body, q) for q in turning]
    found = track_keypoint_clip(body, model, seen, turning[0], 25.0).motion
    assert within(body, found.poses)
    assert np.linalg.norm(found.joints - body.joints(turning), axis=-1).max() < 0.03
