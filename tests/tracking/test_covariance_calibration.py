"""Standard deviations of joints and angles: propagated as samples do, fitted parts added."""

import numpy as np
import pytest

from benchmarks.multiview.error_scenes import as_curved
from hypose.body.default_body import human
from hypose.body.joint_angles import joint_angles
from hypose.body.motion import Motion, isotropic
from hypose.tracking.covariance_calibration import (
    angle_variance,
    apart_factors,
    beyond_usual,
    fitted_spread_table,
    with_angle_variance,
    with_fitted_joints,
)
from hypose.tracking.joint_features import AUDITED

BODY = human()


@pytest.fixture
def poses():
    s = BODY.skeleton
    q = 0.15 * np.random.default_rng(3).standard_normal((2, s.dof))
    q[:, 3:6] = [0.1, 0.05, 0.4]
    return s.clamp(q)


def motion_of(poses):
    joints = BODY.joints(poses)
    n = len(poses)
    return Motion(
        *(BODY.skeleton, np.arange(n) / 25, joints, poses, isotropic(np.full(joints.shape[:2], 0.01))),
        *(np.zeros(n, bool), np.zeros(n, bool), np.full(n, 4), np.zeros(n)),
    )


def test_variances_of_angles_are_those_of_samples(poses):
    s, rng = BODY.skeleton, np.random.default_rng(0)
    root = 0.02 * rng.standard_normal((s.dof, s.dof)) / np.sqrt(s.dof)
    covariance = root @ root.T + 1e-4 * np.eye(s.dof)
    samples = poses[0] + rng.multivariate_normal(np.zeros(s.dof), covariance, 4000)
    spread = joint_angles(s, np.concatenate([poses[:1], samples]))[1][1:]
    found = angle_variance(s, poses, np.stack([covariance] * 2))[0]
    assert np.sqrt(found) == pytest.approx(spread.std(0), rel=0.08)


@pytest.mark.parametrize("evidence", ["silhouettes", "keypoints", "both"])
def test_fitted_parts_are_added_and_can_be_taken_off(poses, evidence):
    motion = motion_of(poses)
    covariance = np.stack([1e-4 * np.eye(BODY.skeleton.dof)] * len(poses))
    variance = angle_variance(BODY.skeleton, poses, covariance)
    full = with_angle_variance(with_fitted_joints(motion, evidence), variance, evidence)
    j = BODY.skeleton.joint("left_ankle")
    a, b = fitted_spread_table()["joints"][evidence]["ankle"]
    assert full.joint_sd[0, j] == pytest.approx(np.hypot(a * 0.01, b), rel=1e-3)
    assert full.systematic_covariance[:, j] == pytest.approx(np.tile(b**2 * np.eye(3), (len(motion), 1, 1)))
    back = as_curved(full, evidence)
    assert back.systematic_covariance == pytest.approx(0, abs=1e-8)
    assert back.joint_covariance == pytest.approx(motion.joint_covariance, abs=1e-8)
    assert back.angle_sd == pytest.approx(np.sqrt(variance), abs=2e-4)


def test_views_that_contradict_each_other_widen_what_is_said(poses):
    motion, evidence = motion_of(poses), "silhouettes"
    usual, by_joint, _ = apart_factors(evidence)
    audit = np.full((len(motion), len(motion.skeleton.joint_names), len(AUDITED)), np.nan, np.float32)
    assert beyond_usual(audit, evidence) == 0.0
    audit[:, :, -1] = np.hypot(usual, 0.02)
    beyond = beyond_usual(audit, evidence)
    assert beyond == pytest.approx(0.02, abs=1e-6)
    plain, wide = (with_fitted_joints(motion, evidence, x) for x in (0.0, beyond))
    more = (wide.joint_covariance - plain.joint_covariance)[:, 0]
    assert more == pytest.approx(np.broadcast_to((by_joint * beyond) ** 2 * np.eye(3), more.shape), abs=1e-8)
