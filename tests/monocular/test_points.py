"""Poses and proportions together from points: derivatives, and what more than one picture is worth."""

import numpy as np

from hypose.body.anthropometry import body_of, entity
from hypose.body.default_body import human
from hypose.synthetic.scenes import look_at
from hypose.tracking.monocular.points import clicked_joints, fit_proportions
from hypose.tracking.monocular.problem import floor_of
from hypose.tracking.monocular.proportions import proportions
from hypose.tracking.monocular.settings import MonoSettings, body_dofs
from hypose.tracking.smoothing import soles_of

POINTS = tuple(
    [f"{side}_{part}" for side in ("left", "right") for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")]
    + ["neck", "head"]
)
CAMERA = look_at("cam1", (2.6, -2.4, 1.4), (0.0, 0.0, 1.0), 450.0, (384, 288))


def stance(body, seed):
    """(D,) a pose with bent limbs."""
    s, rng = body.skeleton, np.random.default_rng(seed)
    q = s.rest_pose()
    q[:3], q[5] = (0.05, -0.1, 0.92), 0.3
    limbs = [d for d, n in enumerate(s.dof_names) if n.split("_")[1] in ("shoulder", "elbow", "hip", "knee")]
    q[limbs] += rng.uniform(-0.5, 0.5, len(limbs))
    return s.clamp(q)


def points_of(body, pose):
    uv = CAMERA.project_pinhole(body.joints(pose))
    clicks = {n: (float(u), float(v)) for n in POINTS for u, v in [uv[body.skeleton.joint(n)]]}
    return lambda b: clicked_joints(b, clicks, CAMERA, 0.5)


def test_more_pictures_measure_lengths_better() -> None:
    template = human()
    prior, active = proportions(template, template.stature), body_dofs(template.skeleton)
    wanted = [entity(f"{n} length") for n in ("upper arm", "forearm", "thigh", "shank")]
    truth = prior.centre.copy()
    truth[wanted] += [0.08, -0.08, 0.07, -0.07]
    person = body_of(template, truth)
    poses = [stance(person, seed) for seed in range(6)]
    pictures = [points_of(person, q) for q in poses]
    # the wrong lengths move the first guess, as they do when poses are found with the template's
    begin = [
        q + 0.05 * np.random.default_rng(9).normal(size=len(q)) * np.isin(np.arange(len(q)), active) for q in poses
    ]
    errors = []
    for n in (1, 6):
        found, factors, cost = fit_proportions(template, pictures[:n], begin[:n], prior.centre.copy(), prior, active)
        assert found.shape == (n, template.skeleton.dof)
        assert np.isfinite(cost)
        assert (np.abs(factors - prior.interval.mean(0)) <= np.ptp(prior.interval, axis=0) / 2 + 1e-9).all()
        held = np.setdiff1d(np.arange(template.skeleton.dof), active)
        np.testing.assert_array_equal(found[:, held], np.array(begin[:n])[:, held])
        errors.append(np.abs(factors - truth)[wanted].mean())
    assert errors[1] < 0.7 * errors[0]


def test_who_stands_on_a_known_floor_is_measured_better() -> None:
    template = human()
    prior, active = proportions(template, template.stature), body_dofs(template.skeleton)
    wanted = [entity(f"{n} length") for n in ("thigh", "shank")]
    truth = prior.centre.copy()
    truth[wanted] -= 0.06
    person = body_of(template, truth)
    poses = [stance(person, seed) for seed in range(3)]
    for q in poses:
        q[2] -= soles_of(person).positions(person, q[None])[0, :, 2].min()
    pictures = [points_of(person, q) for q in poses]
    soles = floor_of(template, 0.0, MonoSettings())
    errors = [
        np.abs(fit_proportions(template, pictures, poses, prior.centre, prior, active, f)[1] - truth)[wanted]
        for f in (None, soles)
    ]
    assert errors[1].mean() < 0.75 * errors[0].mean()
