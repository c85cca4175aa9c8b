"""Rows of one's own: derivatives against finite differences, and the same poses as the compiled solve finds."""

import numpy as np
import pytest

from hypose import fitting
from hypose.errors import InputError
from hypose.evidence.terms import PointTerm, RowTerm
from tests.capsule_person import capsule_person, random_pose

BODY = capsule_person(0.09)
S = BODY.skeleton
J = len(S.joint_names)
PRIOR = (fitting.Quadratic(np.zeros(S.dof), np.full(S.dof, 0.3)),)
ANCHORS = np.array([[2, 2, 0.5], [-2, 2, 2], [-2, -2, 0.5], [2, -2, 2.0]])


def ranges(measured, sd=0.05):
    """Distances (P, 4) to the anchors."""

    def residuals(points):
        away = points[:, None] - ANCHORS
        far = np.linalg.norm(away, axis=-1)
        return (far - measured) / sd, away / far[..., None] / sd

    return residuals


def places(measured, sd):
    """Points (P, 3) themselves, as a PointTerm has them."""
    return lambda points: ((points - measured) / sd, np.broadcast_to(np.eye(3) / sd, (len(points), 3, 3)))


def test_the_gradient_is_that_of_finite_differences(rng):
    pose, other = random_pose(BODY, rng, 0.3), random_pose(BODY, rng, 0.3)
    offset = rng.normal(0, 0.1, (J, 3))
    far = np.linalg.norm(BODY.joints(other)[:, None] - ANCHORS, axis=-1)
    terms = [RowTerm(np.arange(J), ranges(far), offset, rng.random(J)), RowTerm(np.array([3]), ranges(far[3:4]))]
    still = fitting.SolveSettings(0, 0)

    def at(q):
        return fitting.fit_pose(BODY, q, terms, options=still)

    found, h = at(pose), 1e-6
    assert found.rows == J + 1 and np.linalg.eigvalsh(found.hessian).min() > -1e-6
    numeric = [(at(pose + h * e).cost - at(pose - h * e).cost) / (2 * h) for e in np.eye(S.dof)]
    free = (pose > S.lower + h) & (pose < S.upper - h)
    np.testing.assert_allclose(found.gradient[free], np.array(numeric)[free], rtol=1e-4, atol=1e-3)


def test_points_as_rows_of_ones_own_are_a_point_term(rng):
    pose = random_pose(BODY, rng, 0.2)
    measured = BODY.joints(pose) + rng.normal(0, 0.02, (J, 3))
    measured[5] += 0.6  # an outlier
    weight = rng.uniform(0.5, 1, J)
    joint, offset = np.arange(J), np.zeros((J, 3))
    options = fitting.SolveSettings(30, 0, tolerance=1e-6)
    given = PointTerm(measured, weight, joint, offset, 0.02)
    known = fitting.fit_pose(BODY, S.rest_pose(), [given], priors=PRIOR, options=options)
    rows = (RowTerm(joint, places(measured, 0.02), offset, weight),)
    own = fitting.fit_pose(BODY, S.rest_pose(), rows, priors=PRIOR, options=options)
    np.testing.assert_allclose(own.pose, known.pose, atol=1e-6)
    np.testing.assert_allclose(own.cost, known.cost, rtol=1e-9)
    np.testing.assert_allclose(own.hessian, known.hessian, rtol=1e-4, atol=1e-3)
    assert (own.rows, own.iterations, own.converged) == (known.rows, known.iterations, known.converged)


def test_ranges_find_the_pose(rng):
    pose = random_pose(BODY, rng, 0.2)
    far = np.linalg.norm(BODY.joints(pose)[:, None] - ANCHORS, axis=-1)
    rows = (RowTerm(np.arange(J), ranges(far, 0.02)),)
    found = fitting.fit_pose(BODY, S.rest_pose(), rows, priors=PRIOR, options=fitting.SolveSettings(40, 0))
    assert np.linalg.norm(BODY.joints(found.pose) - BODY.joints(pose), axis=1).max() < 0.005
    assert (found.pose >= S.lower).all() and (found.pose <= S.upper).all()


def test_rows_of_the_wrong_shape_are_told():
    flat = RowTerm(np.array([1]), lambda points: (points[:, 0], points))
    with pytest.raises(InputError, match=r"must have the shape \(P, R\)"):
        fitting.fit_pose(BODY, S.rest_pose(), [flat])
    with pytest.raises(InputError, match="RowTerm needs"):
        RowTerm(np.array([1, 2]), ranges(0.0), np.zeros(3))
    with pytest.raises(InputError, match=f"joint {J} of {J}"):
        fitting.fit_pose(BODY, S.rest_pose(), [RowTerm(np.array([J]), ranges(0.0))])
