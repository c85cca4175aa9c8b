"""The first hypotheses from points of one picture."""

import numpy as np
import pytest

from benchmarks.synthetic.mono_scenes import body_scene
from hypose.body.anthropometry import body_of, entity
from hypose.body.default_body import human
from hypose.evidence.frame import Frame, Picture
from hypose.synthetic.scenes import look_at
from hypose.tracking.monocular.initialise import initialise, rival_poses
from hypose.tracking.monocular.points import clicked_joints
from hypose.tracking.monocular.proportions import proportions
from hypose.tracking.monocular.settings import body_dofs

CLICKED = tuple(
    [f"{side}_{part}" for side in ("left", "right") for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")]
    + ["neck", "head"]
)


@pytest.fixture(scope="module")
def camera():
    return look_at("cam1", (2.6, -2.4, 1.4), (0.0, 0.0, 1.0), 450.0, (384, 288))


@pytest.fixture(scope="module")
def stride():
    body = human()
    s, q = body.skeleton, np.zeros(body.skeleton.dof)
    q[:3] = (0.05, -0.1, 0.92)
    q[5] = 0.3
    q[s.dofs_of("left_hip")[0]], q[s.dofs_of("left_knee")] = -0.5, 0.3
    q[s.dofs_of("right_hip")[0]], q[s.dofs_of("right_knee")] = 0.3, 0.6
    q[s.dofs_of("left_elbow")], q[s.dofs_of("right_elbow")] = 0.5, 0.9
    return body, q


def clicks_of(body, camera, pose, names=CLICKED):
    uv = camera.project(body.joints(pose))
    return {n: (float(uv[j, 0]), float(uv[j, 1])) for n in names for j in [body.skeleton.joint(n)]}


def aligned_error(body, pose, joints):
    mine = body.joints(pose)
    return float(np.linalg.norm(mine - mine[0] - joints + joints[0], axis=1).mean())


def test_rivals_hold_the_truth_and_its_mirror_images(camera, stride) -> None:
    body, q = stride
    points = clicked_joints(body, clicks_of(body, camera, q), camera, 2.0)
    active = body_dofs(body.skeleton)
    rivals = rival_poses(body, camera, points, active, 8)
    assert 4 <= len(rivals) <= 8
    errors = [aligned_error(body, r, body.joints(q)) for r in rivals]
    assert min(errors) < 0.045
    assert max(errors) > 0.06  # the others look alike and are not
    shown = camera.project(body.joints(q))
    clicked = [body.skeleton.joint(n) for n in CLICKED]
    for r in rivals:
        apart = np.linalg.norm(camera.project(body.joints(r)) - shown, axis=1)[clicked]
        assert np.median(apart) < 4
    held = np.setdiff1d(np.arange(body.skeleton.dof), active)
    np.testing.assert_allclose(rivals[:, held], 0, atol=1e-3)


def test_proportions_are_found_with_the_pose_and_are_mirrored() -> None:
    scene = body_scene(104, 0.2, motion="wave")
    s = human().skeleton
    uv = scene.camera.project(scene.performance.joints[0])
    clicks = {n: (float(uv[s.joint(n), 0]), float(uv[s.joint(n), 1])) for n in CLICKED}
    frame = Frame(0.0, 0, picture=Picture(scene.camera, scene.image(0)))
    fit = initialise(
        human(), lambda b: clicked_joints(b, clicks, scene.camera, 2.0), frame, height=scene.subject.stature, rivals=4
    )
    assert abs(fit.body.stature / scene.subject.stature - 1) < 0.04
    lengths = fit.body.segment_lengths()
    for part in ("upper_arm", "forearm", "thigh", "shank"):
        assert lengths[f"left_{part}"] == pytest.approx(lengths[f"right_{part}"], rel=0.01)
    assert fit.residual_px < 6
    h = fit.hypotheses
    assert 1 <= h.count <= 4
    assert h.weights.sum() == pytest.approx(1)
    assert (np.diff(h.columns["cost"]) >= 0).all()
    errors = [aligned_error(fit.body, q, scene.performance.joints[0]) for q in h.values]
    assert min(errors) < 0.15
    variance = np.diagonal(h.columns["covariance"][0])[body_dofs(fit.body.skeleton)]
    assert (variance > 0).all()
    prior = proportions(human(), scene.subject.stature)
    assert (np.abs(fit.factors - prior.interval.mean(0)) <= np.ptp(prior.interval, axis=0) / 2 + 1e-9).all()


def test_the_height_is_known_or_that_of_adults() -> None:
    scale = entity("scale")
    known, unknown = proportions(human(), 1.9), proportions(human(), None)
    assert body_of(human(), known.centre).stature == pytest.approx(1.9, abs=0.01)
    assert known.sd[scale] < unknown.sd[scale] / 4
