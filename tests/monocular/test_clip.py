"""Two passes over a clip put together."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.body.motion import Modes
from hypose.evidence.frame import Frame, Picture
from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.monocular.picture_search import PictureSearch
from hypose.tracking.monocular.recipe import backward_estimates, picture_recipe, summed_up, together
from hypose.tracking.monocular.settings import MonoSettings, body_dofs
from hypose.tracking.tracker import Tracker
from tests.monocular.pictures import camera, picture, wall

RATE = 25.0


def modes(poses, costs=None, spread=0.1):
    """Modes (T, K) of poses (T, K, D), equally likely where there are any."""
    there = np.isfinite(poses[..., 0])
    weights = np.where(there, 1 / there.sum(1, keepdims=True), np.nan)
    t, k, d = poses.shape
    covariances = np.where(there[..., None, None], spread**2 * np.eye(d), np.nan)
    costs = np.where(there, 0.0 if costs is None else costs, np.nan)
    nowhere = np.zeros((t, k, 1, 3)), np.zeros((t, 1, 3, 3)), np.zeros((t, 1))
    return Modes(poses, nowhere[0], weights, costs, covariances, *nowhere[1:], there.sum(1))


def test_modes_are_summed_up_by_mean_and_spread():
    poses = np.zeros((2, 3, 8))
    poses[0, :, 7] = (0.0, 0.3, 0.6)
    poses[1, 1:] = np.nan
    mean, covariance = summed_up(modes(poses))
    assert mean[0, 7] == pytest.approx(0.3)
    assert covariance[0, 7, 7] == pytest.approx(0.01 + 0.06)
    np.testing.assert_allclose(covariance[1], 0.01 * np.eye(8), atol=1e-12)


def test_the_start_trusts_the_way_there_and_a_better_fit_wins():
    t = 200
    there, back = np.zeros((t, 1, 8)), np.zeros((t, 1, 8))
    back[..., 7] = 1.0
    poses, covariances = together(modes(there), modes(back), RATE)
    assert poses[0, 7] < 0.05  # the start is known
    assert poses[150, 7] == pytest.approx(0.5, abs=0.05)
    assert poses[-1, 7] == 0  # no way back from the last frame
    assert covariances[150, 7, 7] == pytest.approx(0.01 + 0.25, rel=0.02)
    costs = np.where(np.arange(t)[:, None] == 150, 40.0, 0.0)
    poses, covariances = together(modes(there, costs), modes(back), RATE)
    assert poses[150, 7] > 0.99
    assert covariances[150, 7, 7] < 0.02


def test_the_way_back_finds_the_way_back():
    body = human()
    view, s = camera(body), body.skeleton
    poses = np.tile(s.rest_pose(), (5, 1))
    poses[:, s.dofs_of("left_elbow")] += 0.08 * np.arange(5)[:, None]
    poses[:, s.dofs_of("left_shoulder")[1]] -= 0.06 * np.arange(5)
    background = wall(clutter=12)
    images = [picture(body, q, view, background, seed=7) for q in poses]
    usual = MonoSettings()
    settings = replace(usual, search=replace(usual.search, hypotheses=2, directions=1))
    tracker = Tracker(body, picture_recipe(PictureSearch(body, settings, body_dofs(s))))
    last = Hypotheses(poses[-1:], np.zeros(1), columns={"velocity": poses[-1:] - poses[-2:-1]})
    way = [Frame(i / RATE, i, picture=Picture(view, images[i], images[i + 1])) for i in range(3, -1, -1)]
    found = list(backward_estimates(tracker, tracker.start(last), way))
    joints = body.joints(np.stack([e.pose for e in found]))
    assert np.linalg.norm(joints - body.joints(poses[3::-1]), axis=-1).mean() < 0.02
