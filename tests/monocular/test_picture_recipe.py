"""The recipe of one camera as a whole on small pictures of a known body."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.cameras.camera import CameraRig
from hypose.compute.losses import lorentzian, quadratic
from hypose.errors import EvidenceError, InputError
from hypose.evidence.frame import Frame, Keypoints, Picture
from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.frame_evidence import keypoint_term
from hypose.tracking.monocular.flips import mirrored
from hypose.tracking.monocular.picture_search import PictureSearch
from hypose.tracking.monocular.points import clicked_joints
from hypose.tracking.monocular.recipe import picture_recipe
from hypose.tracking.monocular.settings import MonoSettings, body_dofs
from hypose.tracking.tracker import (
    Tracker,
    TrackerSettings,
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


def tracker_of(body, settings=SETTINGS, active=None, seed=5):
    recipe = picture_recipe(PictureSearch(body, settings, active, points=partial(keypoint_term, scale_px=4.0)))
    return Tracker(body, recipe, TrackerSettings("auto", seed))


def frame_of(view, pictures, i, points=None, masks=None):
    before = pictures[i - 1] if i else None
    picture = Picture(view, pictures[i], before, None if masks is None else masks[i])
    return Frame(i / 25, i, keypoints=None if points is None else points[i], picture=picture)


def at(*poses):
    return Hypotheses.uniform(np.stack(poses))


def follow(body, view, poses, pictures, settings=SETTINGS, *, points=None, masks=None):
    tracker = tracker_of(body, settings)
    frames = [frame_of(view, pictures, i, points, masks) for i in range(1, len(pictures))]
    return [estimate for _, estimate in tracker.follow(tracker.start(at(poses[0])), frames)]


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
    modes = last.uncertainty.modes
    assert 1 <= modes.alive[0] == modes.poses.shape[1] <= 3
    assert modes.weights.sum() == pytest.approx(1)
    np.testing.assert_array_equal(modes.poses[0, 0], last.pose)
    # one view sees depth worst
    limbs = [body.skeleton.joint(n) for n in ("left_wrist", "right_ankle", "head")]
    assert (modes.depth_sd[0, limbs] > last.joint_sd[limbs]).all()


def test_masks_and_key_points_help(clip):
    body, view, poses, pictures = clip
    names = ("left_wrist", "right_knee", "left_elbow", "right_ankle", "left_shoulder", "nonsense")
    index = [body.skeleton.joint(n) for n in names[:-1]]
    seen = np.full((len(poses), len(names), 3), np.nan)
    seen[:, :-1, :2] = view.project(body.joints(poses))[:, index]
    seen[:, :-1, 2] = 1.0
    points = [Keypoints(k[None], names, CameraRig((view,))) for k in seen]
    estimates = follow(body, view, poses, pictures, points=points, masks=[mask(body, q, view) for q in poses])
    assert error(body, estimates, poses) < 0.025


def test_the_same_seed_gives_the_same_numbers(clip):
    body, view, poses, pictures = clip
    first, second = (follow(body, view, poses[:4], pictures[:4]) for _ in range(2))
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.uncertainty.modes.poses, b.uncertainty.modes.poses)
        np.testing.assert_array_equal(a.uncertainty.modes.covariances, b.uncertainty.modes.covariances)


def test_every_ablation_runs_and_keeps_what_is_not_estimated(clip):
    body, view, poses, pictures = clip
    s, search = SETTINGS, SETTINGS.search
    ablations = (
        s.robust(quadratic),
        s.robust(lorentzian),
        replace(s, velocity=0.0, interpenetration=0.0),
        replace(s, search=replace(search, hypotheses=1)),
        replace(s, search=replace(search, flips=True, flip_every=1)),
        replace(s, edges=False),
    )
    held = np.setdiff1d(np.arange(body.skeleton.dof), body_dofs(body.skeleton))
    for settings in ablations:
        estimate = follow(body, view, poses[:3], pictures[:3], settings)[-1]
        assert np.isfinite(estimate.pose).all()
        assert np.isfinite(estimate.uncertainty.joint_covariance).all()
        np.testing.assert_array_equal(estimate.pose[held], poses[0][held])
        assert not estimate.uncertainty.modes.covariances[:, :, held].any()
        if settings.search.hypotheses == 1:
            assert estimate.uncertainty.modes.alive == 1


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


def test_bad_input_is_refused_in_a_sentence(clip):
    body, view, poses, pictures = clip
    tracker = tracker_of(body)
    state = tracker.start(at(poses[0]))
    w, h = SIZE
    small, grey = np.zeros((h // 2, w // 2, 3), np.uint8), np.zeros((h, w), np.uint8)

    refused = (
        (small, None, InputError, r"Frame 4: a picture of camera cam must be .200, 240, 3. uint8, got .100, 120"),
        (grey, None, InputError, "Frame 4: a picture of camera cam must be"),
        (pictures[0], grey, EvidenceError, "Frame 4: the mask is empty"),
        (pictures[0], grey[: h // 2, : w // 2], InputError, "Frame 4: the mask is 120 x 100"),
    )
    for image, shape, error, words in refused:
        with pytest.raises(error, match=words):
            tracker.step(state, Frame(0.0, 4, picture=Picture(view, image, None, shape)))
    for bad in (np.full(36, np.nan), np.zeros(7)):
        with pytest.raises(InputError, match="36 finite numbers"):
            tracker.start(at(bad))
    backwards = tracker_of(body, active=np.array([3, 2]))
    with pytest.raises(InputError, match="ascending indices"):
        backwards.step(backwards.start(at(poses[0])), frame_of(view, pictures, 0))
    with pytest.raises(InputError, match="uses one picture only; leave out evidence of your own"):
        replace(tracker, own=(None,))
    with pytest.raises(InputError, match="no joint 'tail'"):
        clicked_joints(body, {"tail": (1.0, 2.0)}, view)


def test_a_body_out_of_the_picture_is_lost(clip):
    body, view, poses, pictures = clip
    away = poses[0].copy()
    away[:3] += [8.0, 4.0, 0.0]
    estimate = follow(body, view, np.stack([away, away]), pictures[:2])[0]
    assert estimate.lost
    assert np.isfinite(estimate.pose).all()
