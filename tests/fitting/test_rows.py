"""Every cue that gives rows, and every block of unknowns that frames share, found by discovery: a new one needs an
entry below, or these tests fail."""

import inspect
from dataclasses import replace

import numpy as np
import pytest

from hypose.body.anthropometry import SHAPE_FACTORS
from hypose.body.default_body import human
from hypose.calibration import depth_registration, refine_body
from hypose.calibration.refine_points import CameraUnknowns
from hypose.evidence.frame import Keypoints
from hypose.evidence.terms import contour_term, depth_term
from hypose.fitting import rows
from hypose.fitting.problem import Posed, PoseProblem, Quadratic, Rows, Rule
from hypose.tracking import shape_refinement
from hypose.tracking.frame_evidence import keypoint_model, keypoint_term
from hypose.tracking.monocular import points
from hypose.tracking.monocular.proportions import proportions
from hypose.tracking.start_search import known_pose
from tests.depth_pictures import frame_of, sensors

BODY, RIG = human(), sensors(3)
S = BODY.skeleton
TRUTH = known_pose(BODY, "standing")
TRUTH[:3] = 0.02, -0.05, 0.95
FRAME = frame_of(BODY, TRUTH, RIG)
CONTOURS, DEPTH = contour_term(FRAME.silhouettes), depth_term(FRAME.depth)


def keypoints():
    model = keypoint_model(BODY, tuple(S.joint_names))
    uv = np.stack([camera.project_pinhole(model.positions(BODY, TRUTH)) for camera in RIG])
    return keypoint_term(Keypoints(np.concatenate([uv, np.ones((*uv.shape[:2], 1))], -1), model.names, RIG), BODY)


KEYPOINTS = keypoints()
CUES = {
    "rows_of_contours": lambda at, _, factor: rows.rows_of_contours(at, CONTOURS, factor, 1.0, 4.0, 0.5),
    "rows_of_depth": lambda at, _, factor: rows.rows_of_depth(at, DEPTH, factor),
    "rows_of_keypoints": lambda at, _, factor: [rows.rows_of_keypoints(at, KEYPOINTS, RIG.projections)],
}


class Alone(PoseProblem):
    """Poses that share nothing."""

    free = np.zeros(1, bool)

    def shared_cost(self, shared, body):
        return 0.0

    def shared_rows(self, shared, posed, rows):
        return np.eye(1), np.zeros(1), [np.zeros((len(r.view), 1)) for r in rows]

    def shared_moved(self, shared, step):
        return shared


def problem(name):
    return Alone(BODY, [[CUES[name]]], [Quadratic(np.zeros(S.dof), np.full(S.dof, 1e-3))])


def found(name, pose):
    return Rows.joined(CUES[name](Posed(BODY, pose, BODY.skin(pose[None])[0]), None, 1.0))


def test_every_cue_is_tested_here():
    assert set(CUES) == {n for n, f in inspect.getmembers(rows, inspect.isfunction) if n.startswith("rows_of_")}


@pytest.mark.parametrize("name", CUES)
def test_rows_of_a_cue(name, rng):
    pose = S.clamp(TRUTH + 0.03 * rng.normal(size=S.dof))
    before = pose.copy()
    made, again = found(name, pose), found(name, pose)
    for one, other in zip(made, again, strict=True):
        assert np.isfinite(one).all()
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(pose, before)
    assert len(made.view) > 30 and (made.weight >= 0).all() and made.cost > found(name, TRUTH).cost
    # derivatives by a pose are those of the points; a joint that moves a part of a blended vertex is near them
    whole = problem(name).moves[made.carrier]
    vertices, step = BODY.skin(pose[None])[0], 1e-5
    by_pose = made.by_pose(S.world_twists(pose), problem(name).moves)
    for d in (0, 4, 5, int(S.dofs_of("left_elbow")[0])):
        moved = pose + step * np.eye(S.dof)[d]
        there = Posed(BODY, moved, BODY.skin(moved[None])[0])
        carried = np.concatenate([there.vertices - vertices, np.zeros((len(S.parents), 3))])
        if name == "rows_of_keypoints":
            (r1, c1), (r0, c0) = S.forward(moved), S.forward(pose)
            j, o = KEYPOINTS.joint, KEYPOINTS.offset
            change = c1[j] - c0[j] + np.einsum("kab,kb->ka", r1[j] - r0[j], o)
            near = (np.linalg.norm(made.point[:, None] - (c0[j] + np.einsum("kab,kb->ka", r0[j], o)), axis=2)).argmin(1)
            told = (made.slope * change[near]).sum(1) / step
        else:
            told = (made.slope * np.einsum("rc,rcd->rd", made.share, carried[made.carrier])).sum(1) / step
        rigid = (np.abs(whole[..., d] - np.rint(whole[..., d])) < 1e-5).all(1)
        assert rigid.mean() > 0.9
        np.testing.assert_allclose(by_pose[rigid, d], told[rigid], rtol=1e-3, atol=0.05)
    by_shift = made.by_vertices(np.tile(np.eye(3), (len(vertices), 1, 1)))
    np.testing.assert_allclose(by_shift, 0 if name == "rows_of_keypoints" else made.slope, atol=1e-9)


@pytest.mark.parametrize("name", CUES)
def test_a_cue_brings_a_pose_back(name, rng):
    start = S.clamp(TRUTH + np.r_[[0.02] * 3, [0.05] * (S.dof - 3)] * rng.normal(size=S.dof))
    asked = problem(name)
    asked.factor = 2.0
    fit = asked.solve((None, start[None]), 10, Rule(slack=1.002, moved=1e-4))
    away = [np.linalg.norm(BODY.joints(q) - BODY.joints(TRUTH), axis=1).mean() for q in (start, fit.state[1][0])]
    assert fit.cost < asked.evaluate((None, start[None]))[0] and away[1] < 0.6 * away[0], away


def shape(cue):
    known = shape_refinement.Known(height=1.8, mass=80.0, bones=0.1)
    made = shape_refinement._ShapeProblem(BODY, [[cue]] * 2, [], known, 1.0, 1.01)
    return made, 0.02 * np.cos(np.arange(len(SHAPE_FACTORS)))


def cameras(cue):
    unknowns = CameraUnknowns(RIG, True, None)
    return refine_body._BodyProblem(BODY, [[cue]] * 2, [], unknowns), list(RIG)


def places(cue):
    made = depth_registration._SensorProblem(BODY, [[cue]] * 2, [], len(RIG))
    return made, np.stack([camera.camera_from_world for camera in RIG])


def by_cameras(at, cameras, factor):
    return [rows.rows_of_keypoints(at, KEYPOINTS, np.stack([c.projection for c in cameras]))]


def by_sensors(at, places, factor):
    """Every vertex at the same place before each sensor."""
    for c, (place, camera) in enumerate(zip(places, RIG, strict=True)):
        seen = (
            TRUE_POINTS @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3] - place[:3, 3]
        ) @ place[:3, :3]
        carrier = np.repeat(np.arange(len(seen))[:, None], 3, 1)
        share, slope = np.tile([1.0, 0, 0], (len(seen), 1)), np.tile([0.6, 0, 0.8], (len(seen), 1)) @ place[:3, :3]
        r = ((at.vertices - seen) * slope).sum(1)
        weight = np.ones(len(seen))
        yield Rows(carrier, share, at.vertices, slope, r, weight, np.full(len(seen), c), 0.5 * float(r @ r))


def by_corners(at, _, factor):
    """Every vertex at the same place."""
    r = (at.vertices - TRUE_POINTS).ravel()
    carrier = np.repeat(np.repeat(np.arange(len(at.vertices)), 3)[:, None], 3, 1)
    share, slope = np.tile([1.0, 0, 0], (len(r), 1)), np.tile(np.eye(3), (len(at.vertices), 1))
    point, none = np.repeat(at.vertices, 3, 0), np.zeros(len(r), np.int64)
    return [Rows(carrier, share, point, slope, r, np.ones(len(r)), none, 0.5 * float(r @ r))]


def proportions_of_points(_):
    prior = proportions(BODY, None)
    seen = replace(KEYPOINTS, points=KEYPOINTS.points[:1], projections=RIG.projections[:1])
    made = points._PointsProblem(BODY, [lambda body: seen] * 2, prior.centre, prior, [], None)
    return made, prior.centre[points.INTERNAL]


TRUE_POINTS = BODY.skin(TRUTH[None])[0]
BLOCKS = {
    "_PointsProblem": (proportions_of_points, None),
    "_ShapeProblem": (shape, by_corners),
    "_BodyProblem": (cameras, by_cameras),
    "_SensorProblem": (places, by_sensors),
}


def test_every_block_of_unknowns_is_tested_here():
    assert set(BLOCKS) == {c.__name__ for c in PoseProblem.__subclasses__() if c.__module__.startswith("hypose.")}


@pytest.mark.parametrize("name", BLOCKS)
def test_the_gradient_by_what_frames_share_is_that_of_the_cost(name, rng):
    make, cue = BLOCKS[name]
    asked, shared = make(cue)
    q = S.clamp(TRUTH + 0.03 * rng.normal(size=(2, S.dof)))
    equations = asked.evaluate((shared, q))[1]()
    count = len(asked.free)
    assert equations.gradient.shape == (count,) and equations.cross.shape == (2, S.dof, count)
    assert np.linalg.eigvalsh(equations.hessian).min() > -1e-6
    for d in range(count):
        step = 1e-5 * np.eye(count)[d]
        costs = [asked.evaluate((asked.shared_moved(shared, s), q))[0] for s in (step, -step)]
        slope = (costs[0] - costs[1]) / 2e-5
        # sizes are differentiated by steps of 1 %
        rough = 0.05 if name in ("_ShapeProblem", "_PointsProblem") else 1e-4
        assert equations.gradient[d] == pytest.approx(slope, rel=rough, abs=rough * np.abs(equations.gradient).max()), d
