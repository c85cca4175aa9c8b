"""Coverage of reported regions: groups, levels, and the rows made of scenes."""

import numpy as np
import pytest

from benchmarks.multiview.uncertainty import GROUPS, covered, rows_of
from hypose.body.ready_bodies import JOINT_NAMES
from hypose.tracking.pose_covariance import joint_group
from tests.tailed import tailed


def test_groups_of_joints():
    groups = {joint_group(n) for n in JOINT_NAMES}
    assert groups == set(GROUPS) - {"all"}
    assert joint_group("left_shoulder") == "torso" and joint_group("right_wrist") == "arms"


def test_a_calibrated_estimate_covers_what_it_says(rng):
    truth = np.zeros((4000, len(JOINT_NAMES), 3))
    sd = np.full(truth.shape[:2], 0.02)
    estimate = truth + 0.02 * tailed(rng, truth.shape)
    found = covered(estimate, sd, truth)
    for group in GROUPS:
        np.testing.assert_allclose(found[group], (0.5, 0.9, 0.95), atol=0.02)
    assert covered(estimate, 0.5 * sd, truth)["all"][1] < 0.5


def test_rows_are_means_over_scenes():
    scenes = [{g: np.array([0.4, 0.8, 0.9]) for g in GROUPS}, {g: np.array([0.6, 1.0, 1.0]) for g in GROUPS}]
    rows = {(r.metric, r.case): r for r in rows_of(scenes)}
    assert rows["coverage_90", "legs"].value == pytest.approx(0.9)
    assert rows["coverage_50", "all"].n == 2
