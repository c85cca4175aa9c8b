"""The tracker as a whole on small pictures of a known body."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.body.ready_bodies import human
from hypose.body.superquadrics import superquadric_body
from hypose.errors import EvidenceError, InputError
from hypose.monocular.flips import mirrored
from hypose.monocular.models import body_dofs
from hypose.monocular.settings import MonoSettings
from hypose.monocular.tracker import MonoTracker
from hypose.monocular.types import (
    MonoFrame,
    MonoHypotheses,
    MonoPoints,
    clicked_joints,
    points_from_keypoints,
    posterior_arrays,
)
from tests.monocular.pictures import SIZE, camera, mask, picture, wall

SETTINGS = replace(MonoSettings(), search=replace(MonoSettings().search, hypotheses=3, directions=1))


def motion(body, frames):
    """(frames, D): an arm that lifts and bends, a knee that bends, a small step aside; 2 to 5 px per frame."""
    s = body.skeleton
    q = np.tile(s.rest_pose(), (frames, 1))
    t = np.arange(frames)[:, None]
    q[:, s.dofs_of("left_shoulder")] += 0.06 * t * [0.3, -1, 0.4]
    q[:, s.dofs_of("left_elbow")] += 0.07 * t
    q[:, s.dofs_of("right_knee")] += 0.08 * t
    q[:, s.dofs_of("right_hip")[:1]] -= 0.05 * t
    q[:, 0] += 0.006 * t[:, 0]
    return s.clamp(q)


@pytest.fixture(scope="module")
def clip():
    body = human()
    view, poses = camera(body), motion(body, 6)
    background = wall(clutter=12)
    return body, view, poses, [picture(body, q, view, background, seed=7) for q in poses]


def follow(body, view, poses, pictures, settings=SETTINGS, *, points=None, masks=None, threads=1, seed=5):
    tracker = MonoTracker(body, view, settings, threads=threads)
    frames = [
        MonoFrame(i, i / 25, image, None if masks is None else masks[i], None if points is None else points[i])
        for i, image in enumerate(pictures)
    ]
    state = tracker.start(MonoHypotheses.at(poses[0]), frames[0])
    rng, out = np.random.default_rng(seed), []
    for frame in frames[1:]:
        state, estimate = tracker.step(state, frame, rng)
        out.append(estimate)
    return out


def error(body, estimates, poses):
    found, truth = body.joints(np.stack([e.pose for e in estimates])), body.joints(poses[1:])
    return np.linalg.norm(found - found[:, :1] - truth + truth[:, :1], axis=-1).mean()


def test_a_small_motion_is_recovered(clip):
    body, view, poses, pictures = clip
    estimates = follow(body, view, poses, pictures)
    moved = np.linalg.norm(body.joints(poses[0]) - body.joints(poses[-1]), axis=1)
    assert moved.max() > 0.12
    assert error(body, estimates, poses) < 0.02
    last = estimates[-1]
    assert not last.lost
    assert last.nodes.assigned > 0.8 * last.nodes.contour > 40
    assert last.nodes.flow > 20
    assert 1 <= last.alive <= 3
    assert last.posterior.weights.sum() == pytest.approx(1)
    # one view sees depth worst
    limbs = [body.skeleton.joint(n) for n in ("left_wrist", "right_ankle", "head")]
    assert (last.depth_sd[limbs] > last.joint_sd[limbs]).all()


def test_superquadric_parts_can_be_followed_too(clip):
    body, view, poses, pictures = clip
    assert error(body, follow(superquadric_body(body), view, poses, pictures), poses) < 0.06


def test_masks_and_key_points_help(clip):
    body, view, poses, pictures = clip
    names = ("left_wrist", "right_knee", "left_elbow", "right_ankle", "left_shoulder", "nonsense")
    index = [body.skeleton.joint(n) for n in names[:-1]]
    seen = np.full((len(poses), len(names), 3), np.nan)
    seen[:, :-1, :2] = view.project(body.joints(poses))[:, index]
    seen[:, :-1, 2] = 1.0
    points = [points_from_keypoints(body, names, k) for k in seen]
    estimates = follow(body, view, poses, pictures, points=points, masks=[mask(body, q, view) for q in poses])
    assert error(body, estimates, poses) < 0.025


def test_the_same_seed_gives_the_same_numbers_on_any_number_of_threads(clip):
    body, view, poses, pictures = clip
    isotropic = replace(SETTINGS, search=replace(SETTINGS.search, isotropic=True))
    first, second = (follow(body, view, poses[:4], pictures[:4], isotropic, threads=t) for t in (1, 2))
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.posterior.poses, b.posterior.poses)
        np.testing.assert_array_equal(a.posterior.covariances, b.posterior.covariances)


def test_inputs_are_not_changed(clip):
    body, view, poses, pictures = clip
    tracker = MonoTracker(body, view, SETTINGS, threads=1)
    image, start = pictures[0].copy(), poses[0].copy()
    h = MonoHypotheses.at(start)
    state = tracker.start(h, MonoFrame(0, 0.0, image))
    arrays = [state.hypotheses.poses.copy(), state.hypotheses.velocities.copy(), state.grey.copy()]
    second = pictures[1].copy()
    tracker.step(state, MonoFrame(1, 0.04, second), np.random.default_rng(0))
    for before, after in zip(arrays, (state.hypotheses.poses, state.hypotheses.velocities, state.grey), strict=True):
        np.testing.assert_array_equal(before, after)
    np.testing.assert_array_equal(image, pictures[0])
    np.testing.assert_array_equal(second, pictures[1])
    np.testing.assert_array_equal(start, poses[0])


def test_every_ablation_runs_and_keeps_what_is_not_estimated(clip):
    body, view, poses, pictures = clip
    s, search = SETTINGS, SETTINGS.search
    ablations = (
        s.robust("gaussian"),
        s.robust("lorentzian"),
        replace(s, flow=replace(s.flow, use=False)),
        replace(s, edge=replace(s.edge, motion_boundaries=False)),
        replace(s, velocity=0.0, limits=False, interpenetration=0.0, second_order=False),
        replace(s, search=replace(search, hypotheses=1)),
        replace(s, search=replace(search, flips=True, flip_every=1)),
        replace(s, edges=False),
    )
    held = np.setdiff1d(np.arange(body.skeleton.dof), body_dofs(body.skeleton))
    for settings in ablations:
        estimate = follow(body, view, poses[:3], pictures[:3], settings)[-1]
        assert np.isfinite(estimate.pose).all()
        assert np.isfinite(estimate.joint_covariance).all()
        np.testing.assert_array_equal(estimate.pose[held], poses[0][held])
        assert not estimate.posterior.covariances[:, held].any()
        if settings.search.hypotheses == 1:
            assert estimate.alive == 1


def test_limits_are_hard(clip):
    body, view, poses, pictures = clip
    s = body.skeleton
    for estimate in follow(body, view, poses, pictures):
        for q in estimate.posterior.poses:
            assert (q >= s.lower - 1e-9).all()
            assert (q <= s.upper + 1e-9).all()


def test_mirrored_limbs_look_alike_and_lie_elsewhere(clip):
    body, view, poses, _ = clip
    pose = poses[-1].copy()
    pose[body.skeleton.dofs_of("right_hip")[:1]] = -0.6
    found = mirrored(body, view, pose, body_dofs(body.skeleton))
    assert len(found) >= 2
    joints, others = body.joints(pose), body.joints(found)
    far = np.linalg.norm(others - joints, axis=-1).max(1)
    pixels = np.linalg.norm(view.project(others) - view.project(joints), axis=-1).max(1)
    assert (far > 0.1).all()
    assert (pixels < 12).all()


def test_mirrored_poses_are_ranked_after_they_are_optimised(clip):
    body, view, poses, pictures = clip
    tracker = MonoTracker(body, view, SETTINGS, threads=1)
    clicks = view.project(body.joints(poses[3]))
    names = ("left_wrist", "right_wrist", "right_ankle", "left_ankle", "left_elbow", "right_knee")
    points = clicked_joints(body, {n: tuple(clicks[body.skeleton.joint(n)]) for n in names})
    frame = MonoFrame(3, 0.12, pictures[3], mask(body, poses[3], view), points)
    mirror_images = mirrored(body, view, poses[3], body_dofs(body.skeleton))
    ranked = tracker.optimise(MonoHypotheses.at(np.stack([poses[3], *mirror_images])), frame)
    assert len(ranked) > 2
    assert (np.diff(ranked.costs) >= 0).all()
    best = body.joints(ranked.poses[0]) - body.joints(poses[3])
    assert np.linalg.norm(best, axis=1).mean() < 0.08
    assert (np.linalg.eigvalsh(ranked.covariances[0]) > -1e-9).all()


def test_a_posterior_becomes_plain_arrays(clip):
    body, view, poses, pictures = clip
    estimates = follow(body, view, poses[:4], pictures[:4])
    arrays = posterior_arrays(body, estimates)
    k = max(e.alive for e in estimates)
    assert arrays["mode_poses"].shape == (3, k, body.skeleton.dof)
    np.testing.assert_array_equal(arrays["mode_poses"][:, 0], [e.pose for e in estimates])
    np.testing.assert_allclose(np.nansum(arrays["mode_weights"], 1), 1)
    assert all(a.dtype.kind in "fi" for a in arrays.values())


def test_bad_input_is_refused_in_a_sentence(clip):
    body, view, poses, pictures = clip
    tracker = MonoTracker(body, view, SETTINGS, threads=1)
    state, rng = tracker.start(MonoHypotheses.at(poses[0])), np.random.default_rng(0)
    w, h = SIZE
    small, grey = np.zeros((h // 2, w // 2, 3), np.uint8), np.zeros((h, w), np.uint8)
    with pytest.raises(InputError, match=r"Frame 4 is 120 x 100 px, camera cam 240 x 200"):
        tracker.step(state, MonoFrame(4, 0.0, small), rng)
    with pytest.raises(InputError, match="Frame 5: a picture must be"):
        tracker.step(state, MonoFrame(5, 0.0, grey), rng)
    with pytest.raises(EvidenceError, match="Frame 6: the mask is empty"):
        tracker.step(state, MonoFrame(6, 0.0, pictures[0], grey), rng)
    with pytest.raises(InputError, match="Frame 7: the mask is 120 x 100"):
        tracker.step(state, MonoFrame(7, 0.0, pictures[0], grey[: h // 2, : w // 2]), rng)
    nan = np.array([[np.nan, 1.0]])
    with pytest.raises(EvidenceError, match="no finite position"):
        MonoPoints(nan, np.ones(1), np.zeros(1, int), np.zeros((1, 3)), np.ones(1))
    with pytest.raises(InputError, match="36 finite numbers"):
        tracker.start(MonoHypotheses.at(np.full(36, np.nan)))
    with pytest.raises(InputError, match="ascending indices"):
        MonoTracker(body, view, SETTINGS, np.array([3, 2])).start(MonoHypotheses.at(poses[0]), None)
        MonoTracker(body, view, SETTINGS, np.array([3, 2])).step(state, MonoFrame(0, 0.0, pictures[0]), rng)
    with pytest.raises(InputError, match="choose one of gaussian"):
        SETTINGS.robust("square")
    with pytest.raises(InputError, match="no joint 'tail'"):
        clicked_joints(body, {"tail": (1.0, 2.0)})


def test_a_body_out_of_the_picture_is_lost(clip):
    body, view, poses, pictures = clip
    away = poses[0].copy()
    away[:3] += [8.0, 4.0, 0.0]
    estimate = follow(body, view, np.stack([away, away]), pictures[:2])[0]
    assert estimate.lost
    assert np.isfinite(estimate.pose).all()
