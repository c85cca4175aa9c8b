"""The articulated solver: derivatives, recovery of a known pose, limits, loud failure, determinism."""

from dataclasses import replace

import numpy as np
import pytest

from hypose import fitting
from hypose.compute import solver
from hypose.compute.arrays import NOT_KNOWN, PriorArrays
from hypose.errors import InputError, SolverError
from hypose.evidence.frame import Silhouettes
from hypose.evidence.terms import KeypointTerm, PointTerm, contour_term
from hypose.fitting.articulated import cues_of, workspace_for
from tests import reference
from tests.capsule_person import capsule_person, random_pose, ring

BODY = capsule_person(0.055)
SKELETON = BODY.skeleton
JOINTS = len(SKELETON.joint_names)


def start_near(pose, rng, turn=0.055, shift=0.01):
    return SKELETON.clamp(pose + rng.normal(size=SKELETON.dof) * np.r_[[shift] * 3, [turn] * (SKELETON.dof - 3)])


def joint_error_mm(a, b):
    return 1000 * np.linalg.norm(BODY.joints(a) - BODY.joints(b), axis=-1).mean()


@pytest.fixture(scope="module")
def rig():
    return ring(4, f=480.0, size=(480, 360))


def silhouettes_of(pose, rig, usable=None):
    v = BODY.skin(pose)
    masks = np.stack([reference.rasterize(v, BODY.coarse.faces, c.projection, c.size) for c in rig])
    use = np.ones(len(rig), bool) if usable is None else np.asarray(usable)
    return Silhouettes(masks.astype(np.uint8), rig, use, ("",) * len(rig))


@pytest.fixture(scope="module")
def scene(rig):
    pose = random_pose(BODY, np.random.default_rng(3), 0.25)
    return pose, contour_term(silhouettes_of(pose, rig))


def keypoints_of(pose, rig, rng, noise=0.0):
    joint = np.arange(JOINTS)
    offset = rng.normal(size=(JOINTS, 3)) * 0.05
    r, p = SKELETON.forward(pose)
    world = p + np.einsum("jab,jb->ja", r, offset)
    uv = np.stack([c.project_pinhole(world) for c in rig])
    uv += noise * rng.normal(size=uv.shape)
    points = np.concatenate([uv, np.full((*uv.shape[:2], 1), 0.8)], -1)
    return KeypointTerm(points, rig.projections, joint, offset, scale_px=2.0)


def points_of(pose, rng):
    joint = np.arange(JOINTS)
    offset = rng.normal(size=(JOINTS, 3)) * 0.05
    r, p = SKELETON.forward(pose)
    return PointTerm(p + np.einsum("jab,jb->ja", r, offset), np.ones(JOINTS), joint, offset, scale_m=0.03)


def evaluate(pose, *evidence):
    cues, _ = cues_of(BODY, evidence)
    d = SKELETON.dof
    priors = PriorArrays(np.zeros((0, d)), np.zeros((0, d)), np.full(d, -np.inf), np.full(d, np.inf))
    return solver.evaluate(pose, SKELETON.tree, BODY.coarse.arrays, cues, priors, workspace_for(BODY, cues))


def numeric_gradient(pose, term, step=1e-5):
    e = np.eye(len(pose)) * step
    return np.array([(evaluate(pose + a, term).cost - evaluate(pose - a, term).cost) / (2 * step) for a in e])


@pytest.mark.parametrize("cue", ["keypoints", "points"])
def test_gradient_of_point_rows_by_finite_differences(cue, rig, rng):
    truth = random_pose(BODY, rng, 0.3)
    term = keypoints_of(truth, rig, rng) if cue == "keypoints" else points_of(truth, rng)
    pose = start_near(truth, rng, 0.2, 0.05)
    analytic, numeric = evaluate(pose, term).gradient, numeric_gradient(pose, term)
    assert np.abs(analytic - numeric).max() < 1e-6 * np.abs(numeric).max()


@pytest.mark.parametrize(("direction", "agreement"), [("reverse", 0.95), ("both", 0.85)])
def test_contour_gradient_follows_the_cost(direction, agreement, scene, rng):
    """Outline points come and go as the body moves, which no gradient knows and which makes the cost jitter: the two
    agree over steps of several mm. Reverse rows (mask -> body) only change their nearest point and agree better."""
    pose, term = scene
    near = start_near(pose, rng)
    dense = term._replace(row_spacing_px=1.0)

    if direction == "reverse":
        dense = dense._replace(sdf=np.full_like(dense.sdf, NOT_KNOWN))

    def at(q):
        return evaluate(q, dense)

    step = 8e-3 * np.eye(SKELETON.dof)
    numeric = np.array([(at(near + e).cost - at(near - e).cost) / 1.6e-2 for e in step])
    assert np.corrcoef(at(near).gradient, numeric)[0, 1] > agreement
    assert (np.linalg.eigvalsh(at(near).hessian) > -1e-6).all()


def test_recovers_a_pose_from_its_own_silhouettes(rig):
    rng = np.random.default_rng(11)
    before, after = [], []
    for _ in range(5):
        pose = random_pose(BODY, rng, 0.25)
        start = start_near(pose, rng)
        fit = fitting.fit_pose(
            BODY,
            start,
            [contour_term(silhouettes_of(pose, rig))],
            priors=[fitting.Quadratic(start, np.full(SKELETON.dof, 0.3))],
            options=fitting.SolveSettings(iterations=24, coarse_iterations=12),
        )
        before.append(joint_error_mm(start, pose))
        after.append(joint_error_mm(fit.pose, pose))
    assert np.mean(before) > 40
    assert np.median(after) < 5


def test_recovers_a_pose_from_key_points_and_from_points(rig, rng):
    pose = random_pose(BODY, rng, 0.3)
    start = start_near(pose, rng, 0.15, 0.1)
    options = fitting.SolveSettings(iterations=30, coarse_iterations=0, tolerance=1e-8)
    for term in (keypoints_of(pose, rig, rng), points_of(pose, rng)):
        fit = fitting.fit_pose(BODY, start, [term], options=options)
        assert joint_error_mm(fit.pose, pose) < 0.01
        assert fit.converged and fit.rows > 0 and fit.cost < 1e-6


def test_missing_points_are_left_out(rig, rng):
    pose = random_pose(BODY, rng, 0.3)
    keypoints, points = keypoints_of(pose, rig, rng), points_of(pose, rng)
    uvc = keypoints.points.copy()
    uvc[0, 3] = np.nan
    uvc[1, 4, 2] = 0.1
    xyz = points.points_world.copy()
    xyz[2] = np.nan
    fit = fitting.fit_pose(BODY, pose, [keypoints._replace(points=uvc), replace(points, points_world=xyz)])
    assert np.isfinite(fit.pose).all()
    assert fit.rows == uvc.shape[0] * uvc.shape[1] - 2 + JOINTS - 1


def test_limits_hold_and_bind(rng):
    pose = random_pose(BODY, rng, 0.2)
    knee = int(SKELETON.dofs_of("left_knee")[0])
    beyond = pose.copy()
    beyond[knee] = SKELETON.lower[knee] - 0.5
    fit = fitting.fit_pose(BODY, pose, [points_of(beyond, rng)], options=fitting.SolveSettings(30, 0))
    assert (fit.pose >= SKELETON.lower).all() and (fit.pose <= SKELETON.upper).all()
    assert fit.pose[knee] == SKELETON.lower[knee]
    assert fit.gradient[knee] > 0  # it pushes outwards


def test_unusable_starts_are_refused_loudly(scene, rig, rng):
    pose, term = scene
    bad = pose.copy()
    bad[5] = np.nan
    with pytest.raises(SolverError, match="pelvis_rz"):
        fitting.fit_pose(BODY, bad, [term])
    with pytest.raises(SolverError, match="36 numbers"):
        fitting.fit_pose(BODY, pose[:-1], [term])
    sdf = term.sdf.copy()
    sdf[:] = np.nan
    with pytest.raises(SolverError, match="not finite"):
        fitting.fit_pose(BODY, pose, [term._replace(sdf=sdf)])
    with pytest.raises(InputError, match="joint 99"):
        fitting.fit_pose(BODY, pose, [replace(points_of(pose, rng), joint=np.full(JOINTS, 99))])


def test_what_is_known_of_a_pose_is_the_same_on_both_branches_of_its_rotation():
    pose, points = SKELETON.rest_pose(), BODY.joints(SKELETON.rest_pose())
    pose[3:6] = (0.4, -0.8, 2.9)
    other = pose.copy()
    other[3:6] *= 1 - 2 * np.pi / np.linalg.norm(pose[3:6])
    joints = np.arange(len(points))
    term = PointTerm(BODY.joints(pose), np.ones(len(points)), joints, np.zeros_like(points), 0.01)
    still = fitting.SolveSettings(iterations=0, coarse_iterations=0)
    one, two = (fitting.fit_pose(BODY, q, [term], options=still) for q in (pose, other))
    np.testing.assert_allclose(two.pose, other)
    np.testing.assert_allclose(one.information, two.information, rtol=1e-9, atol=1e-6)
    around = [SKELETON.informed_joint_covariances(q, one.information + np.eye(len(q))) for q in (pose, other)]
    np.testing.assert_allclose(*around, rtol=1e-9, atol=1e-12)


def test_shrunk_evidence_weighs_and_places_the_person_alike(rig):
    pose = random_pose(BODY, np.random.default_rng(3), 0.25)
    silhouettes = silhouettes_of(pose, rig)
    small = contour_term(silhouettes, working_height=60)
    assert (small.shrunk > 1).any()
    start = pose.copy()
    start[:3] += 0.03
    fits = [
        fitting.fit_pose(BODY, start, [t], options=fitting.SolveSettings(16, 4))
        for t in (contour_term(silhouettes), small)
    ]
    assert joint_error_mm(fits[0].pose, fits[1].pose) < 10
    assert fits[1].hessian[0, 0] == pytest.approx(fits[0].hessian[0, 0], rel=0.3)
