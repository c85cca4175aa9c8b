"""Depth maps in the articulated solver: derivatives, recovery of a pose, empty space."""

import numpy as np
import pytest

from hypose import fitting
from hypose.body.default_body import human
from hypose.evidence.terms import DepthTerm, depth_term
from hypose.tracking.start_search import known_pose
from tests.depth_pictures import frame_of, sensors

BODY = human()
D = BODY.skeleton.dof


@pytest.fixture(scope="module")
def truth():
    pose = known_pose(BODY, "standing")
    pose[:3] = 0.02, -0.05, 0.95
    names = BODY.skeleton.dof_names
    for name, value in (("left_elbow_flexion", 0.6), ("right_knee_flexion", 0.5)):
        if name in names:
            pose[names.index(name)] += value
    return BODY.skeleton.clamp(pose)


@pytest.fixture(scope="module")
def term(truth):
    return depth_term(frame_of(BODY, truth, sensors(2)).depth)


def cost(pose, term):
    fit = fitting.fit_pose(BODY, pose, [term], options=fitting.SolveSettings(iterations=0, coarse_iterations=0))
    return fit


def test_the_gradient_is_that_of_the_cost(truth, term, rng):
    pose = BODY.skeleton.clamp(truth + 0.03 * rng.normal(size=D))
    analytic = cost(pose, term).gradient
    step = 1e-4
    numeric = np.array(
        [(cost(pose + step * e, term).cost - cost(pose - step * e, term).cost) / (2 * step) for e in np.eye(D)]
    )
    # which place is nearest changes within the step: all but a little of the gradient is the same
    free = (pose > BODY.skeleton.lower + 2 * step) & (pose < BODY.skeleton.upper - 2 * step)
    difference = np.abs(analytic - numeric)[free]
    assert np.median(difference) < 0.02 * np.abs(numeric).max()
    assert analytic[free] @ numeric[free] > 0.98 * np.linalg.norm(analytic[free]) * np.linalg.norm(numeric[free])


def test_a_pose_is_found_again_from_two_sensors(truth, term, rng):
    start = BODY.skeleton.clamp(truth + np.r_[[0.03] * 3, [0.08] * (D - 3)] * rng.normal(size=D))
    options = fitting.SolveSettings(iterations=25, coarse_iterations=0)
    prior = fitting.Quadratic(truth * 0 + start, np.full(D, 0.01))
    found = fitting.fit_pose(BODY, start, [term], priors=[prior], options=options)
    before, after = (
        1000 * np.linalg.norm(BODY.joints(q) - BODY.joints(truth), axis=-1).mean() for q in (start, found.pose)
    )
    assert before > 25 and after < 12
    assert found.cost < 0.2 * cost(start, term).cost


def test_a_body_before_what_was_seen_is_pushed_back(truth, term):
    toward = truth.copy()
    toward[1] -= 0.08  # the first sensor stands at -y
    alone = DepthTerm(
        term.points[:0], term.normals[:0], term.weight[:0], 0 * term.first, term.eyes, term.maps, term.sizes,
        term.projections,
    )  # fmt: skip
    assert cost(toward, alone).rows == 0  # without points nothing counts
    full = cost(toward, term)
    assert full.gradient[1] < 0  # downhill is +y, away from the sensor
    assert cost(toward, term).cost > cost(truth, term).cost


def test_points_that_nothing_is_near_cost_and_pull_nowhere(truth, term):
    far = truth.copy()
    far[0] += 5.0
    found = cost(far, term)
    assert np.abs(found.gradient).max() < 1e-9
    assert found.cost == pytest.approx(0.5 * term.weight.sum(), rel=1e-6)
