"""The measures of doubt have their known values, and the fits find what was put in."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.multiview.error_fit import Rows, ece, in_clip, said
from benchmarks.multiview.spread_fit import UNSEEN, covered, fit_joint, level_error, squares
from hypose.synthetic.metrics import EVALUATED
from hypose.tracking.error_model import (
    BY_ITSELF,
    FEATURES,
    GROUPS,
    ErrorModel,
)
from tests.tailed import tailed


def test_what_joints_are_worth_in_a_doubtful_clip_is_found():
    rng, clips, frames = np.random.default_rng(4), 60, 40
    x = np.zeros((clips * frames, len(EVALUATED), len(FEATURES)))
    clip = np.repeat(np.arange(clips), frames)
    bad = clip % 2 == 1
    odds = rng.normal(np.where(bad, 1.0, -5.0)[:, None], 2.0, x.shape[:2])
    x[..., 0] = odds
    wrong = rng.random(odds.shape) < 1 / (1 + np.exp(-np.where(bad, 0.3, 1.0)[:, None] * odds))
    yes = np.ones(len(x), bool)
    rows = Rows(x, np.where(wrong, 0.2, 0.0), np.full(len(x), "walk"), clip, clip, yes, yes)
    weights, shape = np.eye(len(FEATURES))[[0] * len(GROUPS)], (len(GROUPS), len(FEATURES))
    alone = np.tile(BY_ITSELF, (len(GROUPS), 1))
    model = ErrorModel(
        np.zeros(shape[1]), np.ones(shape[1]), weights, np.zeros(shape[0]), alone, np.full(shape[0], 0.1)
    )
    found = replace(model, in_clip=in_clip(model, rows))
    assert found.in_clip[:, 3].max() < -0.1  # the slope falls
    before, now = (said(m, rows) for m in (model, found))
    assert ece(before[bad], wrong[bad]) > 0.1 and ece(now[bad], wrong[bad]) < 0.03
    assert ece(now[~bad], wrong[~bad]) < 0.03
    assert np.allclose(said(found, rows.take(clip == 7)), now[clip == 7])  # of no other clip


def test_a_spread_of_two_parts_is_found():
    rng = np.random.default_rng(1)
    sd = rng.uniform(0.005, 0.03, 4000)
    covariance = sd[:, None, None] ** 2 * np.eye(3)
    away = tailed(rng, (4000, 3)) * np.sqrt((0.7 * sd) ** 2 + 0.012**2)[:, None]
    a, b = fit_joint([(away, covariance, np.zeros((4000, 3, 3)))])
    m2 = squares(away, covariance, a / UNSEEN, b / UNSEEN)
    assert covered(m2, 3) == pytest.approx(0.9, abs=0.02) and level_error(m2, 3) < 0.03
    assert level_error(m2, 3, normal=True) > 0.05
    c, d = (x / UNSEEN for x in fit_joint([(away, covariance, np.tile(0.01**2 * np.eye(3), (4000, 1, 1)))]))
    m2 = squares(away, covariance + (0.01 / c) ** 2 * np.eye(3), c, d)
    assert covered(m2, 3) == pytest.approx(0.9, abs=0.02) and d < b
