"""Forests: the compiled walk against the definition, growth, bounds."""

import numpy as np
import pytest

from hypose.gestures.forest import ForestSettings, GrowingForest
from tests import forest_reference as runtime

from .toys import LENS, grown, more, padded, probabilities, toy


def exported(forest):
    r = forest.packed
    return {"test": r[..., :5], "left": r[..., 5], "share": r[..., 6:7], "clip_mm": forest.settings.clip}


@pytest.mark.parametrize("clip", [150, None])
def test_compiled_walk_equals_the_definition(clip):
    forest = grown(60, clip_mm=clip).freeze()
    rng = np.random.default_rng(5)
    depth, _, _ = toy(rng)
    rows, columns = np.nonzero(depth)  # every pixel that has depth, the border included
    picture = padded(depth)
    mine = probabilities(forest, picture, rows, columns)
    theirs = runtime.shares(exported(forest), depth, rows, columns, LENS.fx)
    np.testing.assert_allclose(mine, theirs[:, 0], atol=1e-6)
    assert mine.max() > 0.8  # it has learned something, so that the comparison has leaves to compare


def test_alpha_bounds_the_splits_and_beta_forbids_them():
    small, large = grown(80, alpha=60), grown(80, alpha=600)
    assert small.arrays.size.sum() > 2 * large.arrays.size.sum()
    # one bit is the most that a split of two classes can gain
    assert (grown(80, beta=1.0).arrays.size == 1).all()


def test_memory_stays_within_its_bounds_and_slots_are_never_shared():
    forest = grown(150, alpha=10, most_slots=12, most_nodes=101, candidates=20)
    a = forest.arrays
    assert a.free.shape[1] <= 12 and a.left.shape[1] <= 101 and int(a.size.max()) <= 101
    for t in range(15):
        used = a.slot[t][a.slot[t] >= 0]
        both = np.concatenate([used, a.free[t, : a.n_free[t]]])
        assert sorted(both) == list(range(a.free.shape[1]))
    assert a.tally[1] > 0  # no slot was left
    more(forest, np.random.default_rng(9), 5)


def test_holes_and_pixels_nearer_than_the_border_allows_teach_nothing():
    rng = np.random.default_rng(0)
    forest = GrowingForest.new(ForestSettings(), rng)
    depth = np.zeros((64, 64), np.uint16)
    depth[32:] = 300
    forest.learn(padded(depth), np.arange(64), np.full(64, 5), np.ones(64, int))
    assert forest.arrays.seen.sum() == 0
