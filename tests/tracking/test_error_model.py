"""The probability that a joint is wrong: from what an audit found, with weights that speak one way."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.body.joint_angles import ANGLE_NAMES
from hypose.body.motion import Motion, isotropic
from hypose.tracking.error_model import (
    ELSEWHERE_M,
    as_mixture,
    evidence_of,
    judged,
    needs_review,
    without_mixture,
)
from hypose.tracking.joint_features import AUDITED

NAMES = human().skeleton.joint_names


def clip(frames=30, points=False, masks=True):
    body = human()
    poses = np.zeros((frames, body.skeleton.dof))
    joints = body.joints(poses)
    lost = np.zeros(frames, bool)
    motion = Motion(
        *(body.skeleton, np.arange(frames) / 25, joints, poses, isotropic(np.full(joints.shape[:2], 0.012))),
        *(lost, lost.copy(), np.full(frames, 4), np.full(frames, 0.17 if masks else np.nan)),
    )
    usual = {"bare": 0.005, "bare_second": 0.001, "exposed": 2.0, "exposed_second": 0.6}
    usual |= {"exchanged": -0.06, "points_agree": 4}
    usual |= {"outside": 0.05, "points_median": 0.02, "points_worst": 0.05, "points_views": 4, "points_all": 0.02}
    audit = np.zeros((*joints.shape[:2], len(AUDITED)), np.float32)
    for k, name in enumerate(AUDITED):
        there = points if name.startswith("points") else masks
        audit[..., k] = usual.get(name, 0.0) if there else np.nan
    return motion, joints, audit


@pytest.mark.parametrize(
    ("masks", "points", "evidence"),
    [(True, False, "silhouettes"), (False, True, "keypoints"), (True, True, "both")],
)
def test_a_clean_clip_is_not_doubted_and_an_arm_that_disagrees_is(masks, points, evidence):
    motion, joints, audit = clip(points=points, masks=masks)
    assert evidence_of(audit) == evidence
    p, low_confidence = judged(motion, joints, audit)
    assert p.shape == low_confidence.shape == joints.shape[:2] and p.dtype == np.float32
    assert not low_confidence.any() and p.max() < 0.05
    wrist = NAMES.index("right_wrist")
    bad = audit.copy()
    for name, value in {"bare": 0.2, "bare_second": 0.08, "outside": 1.5, "loose": 0.2}.items():
        if masks:
            bad[10:20, wrist, AUDITED.index(name)] = value
    for name, value in (("points_median", 0.3), ("points_worst", 0.4), ("points_views", 2), ("points_agree", 0)):
        if points:
            bad[10:20, wrist, AUDITED.index(name)] = value
    jumped = joints.copy()
    jumped[12:16, wrist] += 0.25
    again, flagged = judged(motion, jumped, bad)
    assert again[15, wrist] > 5 * p[15, wrist]
    # detectors err alone so often that a key point far from a joint says little when nothing else does
    assert flagged[15, wrist] or not masks


def test_what_one_view_alone_shows_is_doubted_unless_a_second_one_is_near_in_time():
    motion, joints, audit = clip(points=True, masks=False)
    ankle, views = NAMES.index("left_ankle"), AUDITED.index("points_views")
    audit[:, ankle, views] = 1
    p, low_confidence = judged(motion, joints, audit)
    assert low_confidence[:, ankle].all() and p[:, ankle].min() >= 0.4 - 1e-6
    assert not np.delete(low_confidence, ankle, 1).any()
    audit[::6, ankle, views] = 3  # a limb is where it was a tenth of a second ago
    assert not judged(motion, joints, audit)[1].any()
    both = clip(points=True)
    both[2][:, ankle, views] = 1
    assert not judged(*both)[1].any()  # masks show it as well


def test_a_frame_is_worth_a_look_where_wrong_joints_are_to_be_expected():
    p = np.full((4, len(NAMES)), 0.02, np.float32)
    joints = np.zeros(p.shape, bool)
    p[1, :3], p[2, 0], p[3, 0] = 0.1, 0.3, 0.1
    joints[1, :3] = joints[2, 0] = joints[3, 0] = True
    assert needs_review(p, joints, "silhouettes").tolist() == [False, True, True, False]
    assert needs_review(p, joints, "both").tolist() == [False, True, True, True]


def test_who_is_lost_is_not_believed():
    motion, joints, audit = clip()
    motion.lost[5:8] = True
    p, low_confidence = judged(motion, joints, audit)
    assert (p[5:8] >= 0.5).all() and low_confidence[5:8].all() and not low_confidence[10:].any()


def test_a_doubtful_joint_may_be_elsewhere_and_its_sd_says_so():
    walk, _, _ = clip()
    names = walk.skeleton.joint_names
    ankle, shape = names.index("left_ankle"), walk.joints.shape[:2]
    p, low_confidence = np.full(shape, 0.02, np.float32), np.zeros(shape, bool)
    p[:, ankle], low_confidence[:, ankle] = 0.3, True
    sd = np.full((len(walk), len(ANGLE_NAMES)), 0.05, np.float32)
    motion = replace(walk, error_probability=p, low_confidence_joints=low_confidence, angle_sd=sd)
    told = as_mixture(motion)
    others = np.arange(len(names)) != ankle
    np.testing.assert_allclose(told.joint_covariance[:, others], walk.joint_covariance[:, others], rtol=1e-6)
    more = told.joint_covariance[:, ankle] - walk.joint_covariance[:, ankle]
    np.testing.assert_allclose(more, np.broadcast_to(0.3 * ELSEWHERE_M**2 / 3 * np.eye(3), more.shape), rtol=1e-4)
    wider = {n for n, s in zip(ANGLE_NAMES, told.angle_sd[0], strict=True) if s > 0.1}
    assert wider == {"knee_angle_l"}
    before = without_mixture(told)
    np.testing.assert_allclose(before.joint_covariance, walk.joint_covariance, atol=1e-8)
    np.testing.assert_allclose(before.angle_sd, sd, rtol=1e-5)


def test_nothing_is_surer_than_its_covariance():
    motion, joints, audit = clip(points=True, masks=False)
    head = NAMES.index("head")
    wide = motion.joint_covariance.copy()
    wide[:, head] = np.diag([0.15**2, 0.01**2, 0.01**2])
    p, low_confidence = judged(replace(motion, joint_covariance=wide), joints, audit)
    assert low_confidence[:, head].all() and (p[:, head] > 0.3).all()
    assert np.delete(p, head, 1).max() < 0.05 and not np.delete(low_confidence, head, 1).any()
