"""One test per printed equation of Sminchisescu & Triggs 2001 that the monocular tracker rests on."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.ndimage import correlate, gaussian_filter

from benchmarks.papers.superquadrics import grid, nodes, superquadric_body
from hypose.body.default_body import human
from hypose.compute.losses import leclerc, lorentzian, quadratic
from hypose.compute.solver import bounded_step_kernel
from hypose.evidence.edges_flow import Flow, edge_field, optical_flow
from hypose.evidence.frame import Picture
from hypose.fitting.problem import Posed
from hypose.inference.layer import Layer, Recipe, search
from hypose.inference.resampling import keep
from hypose.tracking.monocular.picture_rows import (
    contour_nodes,
    edge_rows,
    flow_rows,
    line_search,
    robust,
    view_of,
)
from hypose.tracking.monocular.pool import OPTIMISED, accumulated, candidates, prune, uncertain_samples
from hypose.tracking.monocular.problem import Fixed, frame_evidence, moving_edges, score
from hypose.tracking.monocular.settings import MonoSettings, body_dofs
from tests.monocular.pictures import camera, picture, wall
from tests.monocular.test_cost import FLOW, evaluate, flow_problem
from tests.papers.test_body_equations import transforms

NO_BACKGROUND = replace(
    MonoSettings(), edge=MonoSettings().edge._replace(background=0.0, loss=leclerc), interpenetration=0.0
)


@pytest.fixture(scope="module")
def scene():
    body = human()
    pose = body.skeleton.rest_pose()
    return body, pose, picture(body, pose, camera(body), wall(clutter=8))


def problem_of(scene, settings):
    body, _, image = scene
    fixed = Fixed(body, camera(body), body_dofs(body.skeleton), settings)
    return frame_evidence(fixed, Picture(camera(body), image), None)


def seen_at(problem, pose):
    return view_of(Posed(problem.fixed.body, pose, problem.fixed.body.skin(pose)), problem.fixed.camera)


def edges_of(problem, pose):
    """The rows of the contour against the edges."""
    how = problem.fixed.settings.edge
    return edge_rows(seen_at(problem, pose), problem.fixed.moving, problem.field, how, how.sigma_px)[0]


def superquadric(x_d, eta, omega):
    """D of equation (1) at one node: a superellipsoid, tapered, then bent to a circle of curvature k."""
    a1, a2, a3, e1, e2, t1, t2, k, alpha = x_d

    def power(c, e):
        return np.sign(c) * np.abs(c) ** e

    x = a1 * power(np.cos(eta), e1) * power(np.cos(omega), e2)
    y = a2 * power(np.cos(eta), e1) * power(np.sin(omega), e2)
    z = a3 * power(np.sin(eta), e1)
    x, y = x * (1 + t1 * z / a3), y * (1 + t2 * z / a3)
    r = x * np.cos(alpha) + y * np.sin(alpha)
    bent = 1 / k - (1 / k - r) * np.cos(k * z)
    return np.array([x + (bent - r) * np.cos(alpha), y + (bent - r) * np.sin(alpha), (1 / k - r) * np.sin(k * z)])


def test_equation_1_deformation_chain_and_projection(rng):
    x_d = np.array([0.06, 0.05, 0.16, 0.7, 0.9, 0.2, -0.1, 1.5, 0.4])
    angles, _ = grid()
    expected = np.array([superquadric(x_d, eta, omega) for eta, omega in angles])
    np.testing.assert_allclose(nodes(x_d, angles), expected, atol=1e-12)
    # A and P: every node follows its joint's chain, then the camera
    body = human()
    parts, s = superquadric_body(body), body.skeleton
    pose = s.clamp(s.rest_pose() + rng.normal(0, 0.3, s.dof))
    view, moved = camera(body), transforms(s, pose)
    joint, still = parts.coarse.skin_index[:, 0], parts.coarse.vertices.astype(np.float64)
    world = np.einsum("vab,vb->va", moved[joint][:, :3, :3], still) + moved[joint][:, :3, 3]
    seen = (world @ view.camera_from_world[:3, :3].T + view.camera_from_world[:3, 3]) @ view.K.T
    np.testing.assert_allclose(view.project(parts.skin(pose)), seen[:, :2] / seen[:, 2:], atol=2e-3)


@pytest.mark.parametrize("sigma", [0.5, 3.0])
def test_equations_2_and_3_robust_forms(sigma):
    s = np.array([0.0, 0.3, 4.0, 90.0])
    for form, rho in (
        (lorentzian, np.log1p(s / sigma**2)),
        (leclerc, 1 - np.exp(-s / sigma**2)),
        (quadratic, s / sigma**2),
    ):
        found = np.stack(np.broadcast_arrays(*robust(form, s, sigma)), 1)
        np.testing.assert_allclose(found[:, 0], rho, atol=1e-14)
        # rho(0) = 0 and rho'(0) = nu / sigma^2, nu = 1
        np.testing.assert_allclose(found[0, :2], [0, 1 / sigma**2])
        h = 1e-6
        for k in (0, 1):  # rho' and rho'' by central differences
            up, down = (robust(form, s + e, sigma)[k] for e in (h, -h))
            np.testing.assert_allclose(found[:, k + 1], (up - down) / (2 * h), atol=1e-8 / sigma**4)


def test_equation_4_weights_are_exp_of_minus_the_cost_over_their_sum(scene):
    pose = scene[1]
    costs = np.array([3.0, 4.5, 3.2])
    pool = candidates(OPTIMISED, np.repeat(pose[None], 3, 0), evidence=costs)
    layer = Layer(lambda h, frame, rng: h, accumulated, keep)
    found = search(pool, Recipe("weighed", (layer,)), None, np.random.default_rng).weighted
    np.testing.assert_allclose(found.weights, np.exp(-costs) / np.exp(-costs).sum(), rtol=1e-12)


def test_equations_5_and_6_assigned_nodes_cost_half_rho_and_occluded_ones_k_nu(scene):
    # deviations: a node stands for its length of contour, its cost is not divided by N nu, and back-facing nodes, whose
    # share of a closed surface hardly changes, are counted but cost nothing
    problem, pose, e = problem_of(scene, NO_BACKGROUND), scene[1], NO_BACKGROUND.edge
    view = seen_at(problem, pose)
    nodes = contour_nodes(view, problem.fixed.moving, e.spacing_px)
    most, expected = 1 - np.exp(-(e.window_px**2) / e.sigma_px**2), 0.0
    offset, strength = line_search(problem.field, nodes.uv, nodes.normal, e.window_px, e.threshold)
    for i, seen in enumerate(nodes.seen):
        share = e.height * nodes.length[i] / e.sample_px  # nu times independent samples
        if not seen:
            expected += 0.5 * share * e.occluded * most
            continue
        w = strength[i] / max(1.0, strength[i].sum())
        rho = 1 - np.exp(-(offset[i] ** 2) / e.sigma_px**2)
        expected += 0.5 * share * ((w * rho).sum() + (1 - w.sum()) * most)
    assert edges_of(problem, pose).cost == pytest.approx(expected, rel=1e-6)
    assert 0.4 < 1 - view.front.mean() < 0.6  # N_bf of a closed surface


def test_section_3_2_edges_are_gradients_of_the_smoothed_picture(rng):
    image = cv2.GaussianBlur(rng.integers(0, 256, (60, 80)).astype(np.uint8), (0, 0), 1.5)
    field = edge_field(image, 1.2, 0.93)
    smooth = gaussian_filter(image.astype(np.float64), 1.2, truncate=4.0)
    scharr = np.array([[-3, 0, 3], [-10, 0, 10], [-3, 0, 3]]) / 32
    gradient = np.stack([correlate(smooth, scharr), correlate(smooth, scharr.T)], -1)
    size = np.linalg.norm(gradient, axis=-1, keepdims=True)
    full = np.quantile(size[1:-1:2, 1:-1:2], 0.93)
    inner = (slice(8, -8), slice(8, -8))
    np.testing.assert_allclose(field[inner], (gradient / np.maximum(size, full))[inner], atol=0.03)


def test_section_3_2_flow_has_outliers_and_boundaries_where_motion_ends(rng):
    # a textured square moves over a still textured wall
    wall_, square = (
        cv2.GaussianBlur(rng.integers(0, 256, s).astype(np.uint8), (0, 0), 1.2) for s in ((120, 160), (50, 50))
    )
    pictures = []
    for x in (50, 54):
        picture_ = wall_.copy()
        picture_[35:85, x : x + 50] = square
        pictures.append(picture_)
    found = optical_flow(*pictures)
    np.testing.assert_allclose(np.median(found.flow[45:75, 60:90], axis=(0, 1)), [4, 0], atol=0.2)
    np.testing.assert_allclose(np.median(found.flow[:20], axis=(0, 1)), [0, 0], atol=0.2)
    assert np.median(found.error[45:75, 60:90]) < 0.3 < 0.6 < np.median(found.error[45:75, 101:103])  # covered next
    assert found.boundaries[45:75, 54].mean() > 0.5 > 0.1 > found.boundaries[55:65, 75:83].mean()


def test_equation_7_all_edges_in_the_window_are_assigned_by_strength():
    # three vertical edges: the search along x keeps all three, at sub-pixel places, the weak one with its strength
    h, w = 40, 80
    field = np.zeros((h, w, 2), np.float32)
    for centre, strength in ((30.25, 1.0), (40.0, 0.4), (47.0, -0.7)):
        x = np.arange(w)
        field[:, :, 0] += strength * np.exp(-0.5 * ((x - centre) / 1.2) ** 2)
    at = np.array([[38.0, 20.0]])
    offset, strength = (x[0] for x in line_search(field, at, np.array([[1.0, 0.0]]), 14, 0.08))
    found = strength > 0
    np.testing.assert_allclose(offset[found], [-7.75, 2.0, 9.0], atol=0.15)
    np.testing.assert_allclose(strength[found], [1.0, 0.4, 0.7], atol=0.05)
    # edges across the normal count nothing
    assert not line_search(field, at, np.array([[0.0, 1.0]]), 14, 0.08)[1].any()


def test_equation_7_motion_boundaries_weigh_the_edges():
    field = np.ones((6, 8, 2), np.float32)
    boundaries = np.zeros((3, 4), np.float32)
    boundaries[1, 2] = 1.0
    flow = Flow(np.zeros((3, 4, 2), np.float32), boundaries, boundaries, (2, 1))
    out = moving_edges(field, flow, 0.1)
    assert out[2, 4, 0] == pytest.approx(1.0)  # a full boundary keeps the edge
    assert out[0, 0, 1] == pytest.approx(0.1)  # where nothing moves it is worth the floor


@pytest.mark.parametrize("loss", [lorentzian, leclerc])
def test_equation_7_inner_nodes_are_compared_with_where_flow_carries_them(loss):
    body, active = human(), body_dofs(human().skeleton)
    pose, how = body.skeleton.rest_pose(), FLOW._replace(loss=loss)
    problem, targets = flow_problem(body, active, pose, settings=how)
    at, view = pose + 0.01, camera(body, distance=1.7)
    total = flow_rows(Posed(body, at, body.skin(at)), view.projection, targets, how).cost
    before, after = ((targets.share[..., None] * body.skin(q)[targets.carrier]).sum(1) for q in (pose, at))
    np.testing.assert_allclose(view.project(before) + [3.0, -2.0], targets.target, atol=0.01)
    s = ((view.project(after) - targets.target) ** 2).sum(1) / how.sigma_px**2
    rho = np.log1p(s) if loss is lorentzian else 1 - np.exp(-s)
    weight = how.height * (how.spacing_px / how.area_px) ** 2
    assert len(s) > 50 and total == pytest.approx(0.5 * weight * rho.sum(), rel=1e-4)


def test_equations_8_and_9_gradient_and_hessian_are_sums_over_nodes(scene):
    # the rows against J^T (sum rho' W dr) and J^T (sum rho' W + 2 rho'' (W dr)(W dr)^T) J, with J by
    # finite differences of the node's place along its normal
    body, pose, _ = scene
    settings = replace(NO_BACKGROUND, edge=NO_BACKGROUND.edge._replace(spacing_px=40.0))
    problem = problem_of(scene, settings)
    active, e = problem.fixed.active, settings.edge
    _, gradient, hessian = evaluate(pose, problem)
    hessian = hessian - np.diag(problem.fixed.posture)  # the pose is at rest, so that only the Hessian has it
    nodes = contour_nodes(seen_at(problem, pose), problem.fixed.moving, e.spacing_px)
    share = np.stack([1 - nodes.place, nodes.place], 1)[..., None]

    def places(q):
        return (camera(body).project((share * body.skin(q)[nodes.ends]).sum(1)) * nodes.normal).sum(1)

    jacobian = np.zeros((len(share), len(active)))
    for k, d in enumerate(active):
        up, down = pose.copy(), pose.copy()
        up[d] += 1e-4
        down[d] -= 1e-4
        jacobian[:, k] = (places(up) - places(down)) / 2e-4
    offset, strength = line_search(problem.field, nodes.uv, nodes.normal, 14, e.threshold)
    w = strength / np.maximum(1.0, strength.sum(1, keepdims=True)) * nodes.seen[:, None]
    w *= (e.height * nodes.length / e.sample_px)[:, None]
    r1 = np.exp(-(offset**2) / 9) / 9
    first = -(w * r1 * offset).sum(1)
    second = (w * np.maximum(r1 - 2 * r1 / 9 * offset**2, 0.1 * r1)).sum(1)
    expected = jacobian.T @ (second[:, None] * jacobian)
    np.testing.assert_allclose(gradient, jacobian.T @ first, atol=3e-3 * np.abs(gradient).max())
    np.testing.assert_allclose(hessian, expected, atol=3e-3 * np.abs(expected).max())


def test_equation_10_priors_add_their_gradient_and_curvature(scene):
    problem = problem_of(scene, NO_BACKGROUND)
    pose = scene[1]
    spread = problem.fixed.spread
    plain = evaluate(pose, problem)
    pulled = evaluate(pose, problem.predicted(pose + 0.02))
    np.testing.assert_allclose(pulled.hessian - plain.hessian, np.diag(1 / spread**2), atol=1e-6)
    np.testing.assert_allclose(pulled.gradient - plain.gradient, -0.02 / spread**2, atol=1e-6)
    assert pulled.cost - plain.cost == pytest.approx((0.5 * (0.02 / spread) ** 2).sum(), rel=1e-6)


def test_section_3_2_samples_are_ranked_by_edges_and_priors_and_not_by_flow(scene):
    problem, pose = problem_of(scene, NO_BACKGROUND).predicted(scene[1] + 0.02), scene[1]
    edges, (h, w) = edges_of(problem, pose).cost, problem.field.shape[:2]
    priors = 0.5 * ((0.02 / problem.fixed.spread) ** 2).sum()
    none = np.zeros((h, w), np.float32)
    flow = Flow(np.full((h, w, 2), 5, np.float32), none, none, (0, 0))
    for carried in (None, flow):
        assert score(pose, problem._replace(flow=carried)) == pytest.approx(edges + priors)
    assert priors > 0.05


def test_equation_11_the_damped_step_and_the_active_limits(rng):
    for _ in range(30):
        a = rng.normal(size=(9, 6))
        hessian, g, q = a.T @ a, rng.normal(size=6), np.zeros(6)
        w = np.diag(np.maximum(np.diag(hessian), 1.0))
        step, endless = np.empty(6), np.full(6, np.inf)
        assert bounded_step_kernel(hessian, g, q, -endless, endless, 0.3, step)
        np.testing.assert_allclose((hessian + 0.3 * w) @ step, -g, atol=1e-9)
        # a limit that the descent direction leaves is active: its coordinate stays, the others solve their own system
        lower, upper = -endless.copy(), endless.copy()
        held = int(np.abs(g).argmax())
        (lower if g[held] > 0 else upper)[held] = 0.0
        assert bounded_step_kernel(hessian, g, q, lower, upper, 0.3, step)
        free = np.arange(6) != held
        assert step[held] == 0
        np.testing.assert_allclose(
            step[free], np.linalg.solve((hessian + 0.3 * w)[np.ix_(free, free)], -g[free]), atol=1e-9
        )


def test_figure_4_samples_lie_along_the_most_uncertain_free_directions():
    body = human()
    active = body_dofs(body.skeleton)
    rng = np.random.default_rng(0)
    basis = np.linalg.qr(rng.normal(size=(30, 30)))[0]
    values = np.geomspace(4.0, 4e4, 30)
    spread = np.ones(30)
    free = np.ones(30, bool)
    pose = body.skeleton.rest_pose()
    unlimited = np.full(30, np.inf)
    how = replace(MonoSettings().search, directions=2, samples=2, reach=3.0, longest=100.0)
    hessian = basis @ np.diag(values) @ basis.T
    found = uncertain_samples(pose, hessian, free, active, spread, -unlimited, unlimited, how)
    assert len(found) == 8
    steps = (found - pose)[:, active]
    for k in range(2):  # x + p sigma_j v_j with sigma_j = 1 / sqrt(lambda_j), p to p_f on either side
        along = steps[4 * k : 4 * k + 4] @ basis[:, k]
        np.testing.assert_allclose(np.sort(along), np.array([-3, -1.5, 1.5, 3]) / np.sqrt(values[k]), rtol=1e-6)
    # a dof that a limit holds stays: the decomposition is that of the free subspace
    held = free.copy()
    held[3] = False
    stuck = uncertain_samples(pose, hessian, held, active, spread, -unlimited, unlimited, how)
    assert (stuck[:, active[3]] == pose[active[3]]).all()


def test_figure_4_the_pool_of_all_hypotheses_is_pruned_to_the_best_distinct_ones():
    body = human()
    settings = replace(MonoSettings().search, hypotheses=3, distinct_m=0.05)

    poses = np.repeat(body.skeleton.rest_pose()[None], 5, 0)
    poses[:, body.skeleton.dofs_of("left_elbow")] += np.array([[0.0], [0.01], [0.5], [0.9], [-0.5]])
    pool = candidates(OPTIMISED, poses, evidence=np.array([1.0, 1.1, 3.0, 2.0, 9.0]))
    kept = prune(pool, body, settings)
    # 0.01 is no other pose than 0; of the rest the two best stay
    assert kept.columns["evidence"].tolist() == [1.0, 2.0, 3.0]
