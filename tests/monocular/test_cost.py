"""The cost of a pose: derivatives of every term against finite differences, and the search against scipy."""

from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import minimize

from benchmarks.papers.superquadrics import superquadric_body
from benchmarks.synthetic.mono_subjects import arm_dofs, with_hand
from hypose.body.default_body import human
from hypose.evidence.edges_flow import Flow
from hypose.evidence.frame import Picture
from hypose.fitting.problem import Posed
from hypose.tracking.monocular.picture_rows import contour_nodes, view_of
from hypose.tracking.monocular.points import clicked_joints
from hypose.tracking.monocular.problem import Fixed, PictureProblem, frame_evidence, newton_descent
from hypose.tracking.monocular.settings import FlowSettings, MonoSettings, body_dofs
from hypose.tracking.smoothing import soles_of
from tests.monocular.pictures import SIZE, camera, mask

ONLY_POINTS = MonoSettings(edges=False)
FLOW = FlowSettings(sigma_px=4.0, height=1.0, spacing_px=6.0)


class Cost(NamedTuple):
    cost: float
    gradient: np.ndarray
    hessian: np.ndarray


def evaluate(pose, evidence, targets=None):
    """Cost of evidence and priors at one pose (D,), with derivatives."""
    cost, make = PictureProblem(evidence, None, targets).evaluate(pose)
    hessian, gradient = make()
    return Cost(cost, gradient, hessian)


def pose_of(body, seed=0, spread=0.1):
    s = body.skeleton
    return s.clamp(s.rest_pose() + np.random.default_rng(seed).normal(0, spread, s.dof))


def varied(fixed, **changed):
    """The fixed parts with some of them replaced."""
    out = copy(fixed)
    vars(out).update(changed)
    return out


def problem_of(body, active, settings=ONLY_POINTS, points=None, image=None, distance=3.5, floor=None):
    view = camera(body, distance=distance)
    fixed = Fixed(body, view, active, settings, floor)
    blank = np.full((SIZE[1], SIZE[0], 3), 120, np.uint8) if image is None else image
    return frame_evidence(fixed, Picture(view, blank), points)


def numeric_gradient(cost, pose, active, h=1e-5):
    out = np.zeros(len(active))
    for k, d in enumerate(active):
        up, down = pose.copy(), pose.copy()
        up[d] += h
        down[d] -= h
        out[k] = (cost(up) - cost(down)) / (2 * h)
    return out


def test_points_and_priors_have_the_gradient_of_their_cost():
    body = human()
    pose = pose_of(body)
    seen = camera(body).project(body.joints(pose))
    clicks = {n: tuple(seen[body.skeleton.joint(n)] + [6, -9]) for n in ("left_wrist", "right_knee", "head")}
    points = clicked_joints(body, clicks, camera(body))
    problem = problem_of(body, body_dofs(body.skeleton), ONLY_POINTS, points)
    problem = problem.predicted(pose + 0.03)
    found = evaluate(pose, problem)
    numeric = numeric_gradient(lambda q: evaluate(q, problem).cost, pose, problem.fixed.active)
    np.testing.assert_allclose(found.gradient, numeric, atol=2e-5 * np.abs(numeric).max())


def test_spheres_push_an_arm_out_of_the_trunk():
    body = human()
    problem = problem_of(body, body_dofs(body.skeleton))
    assert evaluate(body.skeleton.rest_pose(), problem).cost == pytest.approx(0, abs=1e-9)
    pose = body.skeleton.rest_pose()
    pose[body.skeleton.dofs_of("left_shoulder")] = [0.4, 1.1, 0.0]  # the hand in the trunk
    found = evaluate(pose, problem)
    fixed = problem.fixed
    without = problem._replace(fixed=varied(fixed, spheres=fixed.spheres._replace(weight=0.0)))
    assert found.cost - evaluate(pose, without).cost > 20
    numeric = numeric_gradient(lambda q: evaluate(q, problem).cost, pose, problem.fixed.active)
    np.testing.assert_allclose(found.gradient, numeric, atol=1e-4 * np.abs(numeric).max())


@pytest.mark.parametrize("above", [0.04, -0.3])
def test_the_lower_sole_is_pulled_onto_the_floor_and_none_sinks(above):
    body = human()
    pose = body.skeleton.rest_pose()
    pose[body.skeleton.dofs_of("left_ankle")[0]] += 0.4  # heel and ball at different heights, under the right foot
    heights = soles_of(body).positions(body, pose[None])[0, :, 2]
    problem = problem_of(body, body_dofs(body.skeleton), floor=float(heights.min()) - above)
    found = evaluate(pose, problem)
    sd = MonoSettings().floor_sd_m
    under = heights[heights < heights.min() - above] if above < 0 else heights.min()
    expected = 2 * np.log(1 + (under - heights.min() + above) ** 2 / (4 * sd**2)).sum()
    nowhere = problem._replace(fixed=varied(problem.fixed, floor=None))
    assert found.cost - evaluate(pose, nowhere).cost == pytest.approx(expected, abs=1e-6)
    numeric = numeric_gradient(lambda q: evaluate(q, problem).cost, pose, problem.fixed.active)
    np.testing.assert_allclose(found.gradient, numeric, atol=1e-4 * np.abs(numeric).max())
    assert np.sign(found.gradient[2]) == np.sign(above)


def flow_problem(body, active, pose, shift=(3.0, -2.0), settings=FLOW):
    """Inner nodes of a pose, carried by a uniform flow."""
    evidence = problem_of(body, active, replace(ONLY_POINTS, interpenetration=0.0, flow=settings), distance=1.7)
    w, h = SIZE
    flow, none = np.broadcast_to(np.float32(shift), (h, w, 2)).copy(), np.zeros((h, w), np.float32)
    evidence = evidence._replace(flow=Flow(flow, none, none, (0, 0)))
    return evidence, evidence.targets(pose)


@pytest.mark.parametrize("kind", ["skin", "superquadrics", "arm"])
def test_the_jacobian_of_the_nodes(kind):
    # up to the rotation of a skinned point about its blended place;
    # the flow term sees surface nodes through skinning, chain and projection, and its targets do not move
    body = {"skin": human, "superquadrics": lambda: superquadric_body(human()), "arm": lambda: with_hand(human())}[
        kind
    ]()
    active = arm_dofs(body.skeleton) if kind == "arm" else body_dofs(body.skeleton)
    pose = pose_of(body, 1)
    problem, targets = flow_problem(body, active, pose)
    assert len(targets.target) > (6 if kind == "arm" else 80)
    at = pose + 0.01
    gradient = evaluate(at, problem, targets).gradient
    numeric = numeric_gradient(lambda q: evaluate(q, problem, targets).cost, at, problem.fixed.active, h=3e-4)
    np.testing.assert_allclose(gradient, numeric, atol=2e-2 * np.abs(numeric).max())


def test_the_search_finds_what_scipys_bounded_solver_finds():
    body = human()
    s = body.skeleton
    truth = pose_of(body, 3, 0.3)
    truth[s.dofs_of("left_knee")] = 0.7
    seen = camera(body).project(body.joints(truth))
    names = [n for n in s.joint_names if n.split("_")[-1] in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")]
    points = clicked_joints(body, {n: tuple(seen[s.joint(n)]) for n in (*names, "head", "pelvis")}, camera(body))
    problem = problem_of(body, body_dofs(s), ONLY_POINTS, points)
    active = problem.fixed.active
    # a knee that may not bend as far as it should: the limit must hold it
    lower, upper = problem.fixed.lower, problem.fixed.upper.copy()
    knee = int(np.flatnonzero(active == s.dofs_of("left_knee")[0])[0])
    upper[knee] = truth[active[knee]] - 0.2
    problem = problem._replace(fixed=varied(problem.fixed, upper=upper))
    start = np.clip(truth + np.random.default_rng(4).normal(0, 0.05, s.dof), s.lower, s.upper)
    found = newton_descent(start, start, problem, 0, 60)

    def cost(x):
        q = start.copy()
        q[active] = x
        return evaluate(q, problem)

    bounds = list(zip(lower, upper, strict=True))
    first = np.clip(start[active], lower, upper)
    double = minimize(
        lambda x: (cost(x).cost, cost(x).gradient), first, jac=True, method="L-BFGS-B", bounds=bounds,
        options={"maxiter": 600, "ftol": 1e-12},
    )  # fmt: skip
    assert found.evidence <= double.fun + 0.05
    assert (found.pose[active] <= upper).all()
    assert (found.pose[active] >= lower).all()


def test_occluding_contour_runs_along_the_silhouette():
    body = human()
    pose = body.skeleton.rest_pose()
    fixed = problem_of(body, body_dofs(body.skeleton)).fixed
    nodes = contour_nodes(view_of(Posed(body, pose, body.skin(pose)), fixed.camera), fixed.moving, 6.0)
    assert nodes.seen.sum() > 60
    # more of a trunk's outline is seen than hidden, round as it is
    assert (~nodes.seen).sum() < nodes.seen.sum()
    shown = mask(body, pose, fixed.camera)
    for step, inside in ((-2.5, 1), (2.5, 0)):
        x, y = np.rint(nodes.uv + step * nodes.normal)[nodes.seen].astype(int).T
        assert ((shown[y, x] > 0) == inside).mean() > (0.9 if inside else 0.6)
