"""The person leaves and somebody else is in view: nobody is taken for them, and they are found again."""

import numpy as np
import pytest

from hypose.evidence.keypoints import BODY_25B
from hypose.tracking.frame_evidence import keypoint_model
from hypose.tracking.keypoint_clip import track_keypoint_clip
from hypose.tracking.recipes import recipe
from hypose.tracking.start_search import scaled_to_height
from hypose.tracking.tracker import Tracker
from tests.tracking.measures import joint_error
from tests.tracking.test_keypoint_evidence import seen_by

HERE, AWAY = range(5), range(5, 17)
FRAMES = 22


@pytest.fixture
def stranger(standing):
    """Somebody else, 1.6 m away and turned."""
    pose = standing.copy()
    pose[:2] += [1.4, -0.8]
    pose[5] -= 1.0
    return pose


@pytest.mark.parametrize(("x", "y", "turn"), [(1.4, -0.8, -1), (1.2, 0.8, 1), (0, 1.5, 2)])
def test_silhouettes_of_somebody_else_are_not_followed(body, standing, frame_of, x, y, turn):
    stranger = standing.copy()
    stranger[[0, 1, 5]] += x, y, turn
    tracker = Tracker(body, recipe("default", body, particles=16))
    state, estimates = tracker.start(standing), []
    for t in range(FRAMES):
        state, estimate = tracker.step(state, frame_of(body, stranger if t in AWAY else standing, t))
        estimates.append(estimate)
    for t in AWAY:
        assert estimates[t].lost and np.linalg.norm(estimates[t].pose[:2] - standing[:2]) < 0.2
    assert not estimates[-1].lost and joint_error(body, estimates[-1].pose, standing) < 0.05


def test_key_points_of_somebody_else_are_not_followed(body, standing, stranger, small_rig, rng):
    model = keypoint_model(body, BODY_25B)
    seen = [seen_by(small_rig, model, body, stranger if t in AWAY else standing, rng, 0.5) for t in range(FRAMES)]
    motion = track_keypoint_clip(body, model, seen, standing, 25.0).motion
    assert np.flatnonzero(motion.extrapolated).tolist() == list(AWAY)
    for pose in motion.poses:
        assert joint_error(body, pose, standing) < 0.03
    assert motion.joint_sd[11].mean() > 2 * motion.joint_sd[2].mean()


@pytest.mark.parametrize(("size", "taken"), [(1.0, True), (0.72, False)])
def test_whoever_comes_back_elsewhere_must_have_the_body(body, standing, stranger, small_rig, rng, size, taken):
    other = body if size == 1.0 else scaled_to_height(body, size * body.stature)
    pose = stranger.copy()
    pose[2] *= size
    here, there = (keypoint_model(b, BODY_25B) for b in (body, other))
    seen = [seen_by(small_rig, here, body, standing, rng, 0.3)] * 4 + [None] * 30
    seen += [seen_by(small_rig, there, other, pose, rng, 0.3)] * 8
    motion = track_keypoint_clip(body, here, seen, standing, 25.0).motion
    assert motion.lost[33] and motion.extrapolated[34:].all() != taken
    if taken:
        assert joint_error(body, motion.poses[-1], pose) < 0.03
