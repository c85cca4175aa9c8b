"""Fitting a clip: coupled frames are smoother, gaps are bridged, the banded solve is the dense one."""

import numpy as np
import pytest

from hypose import fitting
from hypose.evidence.terms import PointTerm
from hypose.fitting.clip_solve import Coupling, _Clip, _moved, default_acceleration
from hypose.geometry import so3_exp, so3_log
from tests.capsule_person import capsule_person, random_pose

BODY = capsule_person(0.09)
S = BODY.skeleton
J = len(S.joint_names)


@pytest.fixture
def motion(rng):
    a, b = random_pose(BODY, rng, 0.2), random_pose(BODY, rng, 0.2)
    t = 0.5 - 0.5 * np.cos(np.linspace(0, np.pi, 20))[:, None]
    return (1 - t) * a + t * b


def point_terms(motion, rng, noise):
    return [
        [PointTerm(p + noise * rng.normal(size=p.shape), np.ones(J), np.arange(J), np.zeros((J, 3)), 0.02)]
        for p in BODY.joints(motion)
    ]


def test_smooth_clip_is_closer_to_the_truth_than_single_frames(motion, rng):
    terms = point_terms(motion, rng, 0.02)
    prior = [fitting.Quadratic(np.zeros(S.dof), np.full(S.dof, 0.3))]
    single = np.stack([fitting.fit_pose(BODY, m, t, priors=prior).pose for m, t in zip(motion, terms, strict=True)])
    clip = fitting.fit_clip(BODY, motion, terms, acceleration=10.0, priors=prior)
    truth = BODY.joints(motion)
    error = [np.linalg.norm(BODY.joints(q) - truth, axis=-1).mean() for q in (single, clip)]
    assert error[1] < 0.75 * error[0]
    jerk = [np.abs(np.diff(BODY.joints(q), 3, axis=0)).mean() for q in (single, clip)]
    assert jerk[1] < 0.5 * jerk[0]


def test_frames_without_evidence_are_bridged(motion, rng):
    terms = point_terms(motion, rng, 0.0)
    gap = [[] if 8 <= t < 12 else term for t, term in enumerate(terms)]
    start = motion.copy()
    start[8:12] = motion[7]
    clip = fitting.fit_clip(BODY, start, gap, acceleration=1.0)
    assert np.linalg.norm(BODY.joints(clip) - BODY.joints(motion), axis=-1).max() < 0.02


@pytest.mark.parametrize("cut_at", [None, 3])
def test_step_is_the_dense_step(motion, rng, cut_at):
    velocity, cut = np.full(S.dof, 3.0), np.zeros((5, S.dof), bool)
    if cut_at is not None:  # the way of one shoulder from frame 3 to 4 does not count
        cut[cut_at, S.dofs_of("left_shoulder")] = True
    coupling = Coupling(6, default_acceleration(S.dof, 2.0), velocity, cut)
    problem = _Clip(BODY, coupling, point_terms(motion[:6], rng, 0.02), ())
    q = motion[:6] + 0.02 * rng.normal(size=(6, S.dof))
    gradient, hessian = problem.evaluate(q)[1]()
    problem.lower, problem.upper = np.full(S.dof, -np.inf), np.full(S.dof, np.inf)
    step = problem.step(gradient, hessian, q, 1e-2)
    dense = np.zeros((6 * S.dof, 6 * S.dof))
    for d, weight in enumerate(default_acceleration(S.dof, 2.0)):
        goes_on = 1.0 - cut[:, d, None]
        d1 = goes_on * np.diff(np.eye(6), 1, axis=0)
        d2 = goes_on[1:] * goes_on[:-1] * np.diff(np.eye(6), 2, axis=0)
        dense[d :: S.dof, d :: S.dof] += weight * d2.T @ d2 + velocity[d] * d1.T @ d1
    for t in range(6):
        dense[t * S.dof : (t + 1) * S.dof, t * S.dof : (t + 1) * S.dof] += hessian[t]
    dense += 1e-2 * np.diag(np.maximum(np.diag(dense), 1))
    np.testing.assert_allclose(step.ravel(), -np.linalg.solve(dense, gradient.ravel()), rtol=1e-7, atol=1e-10)


def test_clip_gradient_by_finite_differences(motion, rng):
    a = rng.normal(size=(4, S.dof, S.dof))
    known = [fitting.Gaussian(m + 0.1, x @ x.T) for m, x in zip(motion[:4], a, strict=True)]
    coupling = Coupling(4, default_acceleration(S.dof), np.full(S.dof, 2.0))
    problem = _Clip(
        BODY, coupling, [[*t, k] for t, k in zip(point_terms(motion[:4], rng, 0.02), known, strict=True)], ()
    )
    q = motion[:4] + 0.02 * rng.normal(size=(4, S.dof))
    gradient, _ = problem.evaluate(q)[1]()
    numeric = np.zeros_like(q)
    for t in range(4):
        for d in range(S.dof):
            e = np.zeros_like(q)
            e[t, d] = 1e-5
            numeric[t, d] = (problem.evaluate(_moved(q, e))[0] - problem.evaluate(_moved(q, -e))[0]) / 2e-5
    np.testing.assert_allclose(gradient, numeric, atol=1e-6 * np.abs(numeric).max())


def test_somebody_who_turns_round_and_round_is_smoothed_like_anybody_else(rng):
    turned = np.linspace(0, 4 * np.pi, 100)
    truth = np.zeros((100, S.dof))
    lean = so3_exp(np.stack([0.1 * np.sin(turned), 0.05 * np.cos(turned), np.zeros(100)], 1))
    truth[:, 3:6] = so3_log(so3_exp(np.stack([0 * turned, 0 * turned, turned], 1)) @ lean)
    known = []
    for q in truth:
        seen = q.copy()
        seen[3:6] = so3_log(so3_exp(0.01 * rng.normal(size=3)) @ so3_exp(q[3:6]))
        known.append(fitting.Gaussian(seen, np.eye(S.dof)))
    starts = np.stack([k.centre for k in known])
    clip = fitting.fit_clip(BODY, starts, [[k] for k in known], acceleration=10.0)
    error = np.linalg.norm(BODY.joints(clip) - BODY.joints(truth), axis=-1)
    assert error.mean() < 0.5 * np.linalg.norm(BODY.joints(starts) - BODY.joints(truth), axis=-1).mean()
    assert error.max() < 0.02
