"""An audit sees an arm that is elsewhere, in masks and in key points, and what other hypotheses say of it."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.synthetic.scenes import make_scene
from hypose.tracking.frame_evidence import keypoint_model, prepare
from hypose.tracking.joint_features import AUDITED, audit_frame
from hypose.tracking.refinement import SETTLING, refine
from hypose.tracking.start_search import scaled_to_height, start_from_keypoints


@pytest.fixture(scope="module")
def seen():
    """A frame of a walk, the body, a pose that fits it, and the same with the right arm raised."""
    scene = make_scene("walk", rig="humaneva-4", seconds=0.08, seed=5)
    frame = next(iter(scene.mask_frames(0.5, keypoints=True)))
    from hypose.body.default_body import human

    body = scaled_to_height(human(), scene.subject.stature)
    joints = np.arange(len(body.skeleton.joint_names))
    start = start_from_keypoints(body, scene.joints[0], joints, np.zeros((len(joints), 3))).pose
    pose = refine(body, start[None], prepare(frame, body, start), SETTLING)[0].pose
    wrong = pose.copy()
    wrong[body.skeleton.dofs_of("right_shoulder")] += 1.2
    return frame, body, pose, body.skeleton.clamp(wrong)


def column(audit, name):
    return audit[:, AUDITED.index(name)]


def test_a_wrong_arm_leaves_bare_mask_and_sticks_out(seen):
    frame, body, pose, wrong = seen
    right, off = (audit_frame(body, q, replace(frame, keypoints=None)) for q in (pose, wrong))
    elbow, wrist, knee = (body.skeleton.joint(n) for n in ("right_elbow", "right_wrist", "left_knee"))
    assert column(off, "bare")[elbow] > column(right, "bare")[elbow] + 0.005
    assert column(off, "outside")[wrist] > column(right, "outside")[wrist] + 0.3
    assert column(off, "bare")[knee] == pytest.approx(column(right, "bare")[knee], abs=0.02)
    assert (column(right, "exposed_second") <= 1).all() and (column(right, "exposed") <= 4).all()
    assert all(np.isnan(column(right, n)).all() for n in AUDITED if n.startswith("points"))


def test_key_points_tell_how_far_a_joint_is_off(seen):
    frame, body, pose, wrong = seen
    model = keypoint_model(body, frame.keypoints.names)
    points = replace(frame, silhouettes=None)
    right, off = (audit_frame(body, q, points, model) for q in (pose, wrong))
    wrist = body.skeleton.joint("right_wrist")
    away = np.linalg.norm(body.joints(wrong)[wrist] - body.joints(pose)[wrist])
    assert column(right, "points_median")[wrist] < 0.06
    assert 0.4 * min(away, 0.5) < column(off, "points_median")[wrist] <= 0.5
    assert np.isnan(column(right, "bare")).all()
    assert (column(right, "points_views")[wrist] >= 2) and (column(right, "points_all") < 0.06).all()
