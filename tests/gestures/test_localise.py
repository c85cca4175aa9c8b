"""Localization: votes, density, memory, volume, early rejection."""

import numpy as np
import pytest

from hypose.compute.forest_votes import ScanPlan
from hypose.errors import InputError
from hypose.gestures.depth_pictures import DepthLens, millimetres
from hypose.gestures.localise import LocaliseSettings, localise

from .toys import LENS, grown, toy

THOROUGH = ScanPlan(first=0, coarse=0)


@pytest.fixture(scope="module")
def forest():
    return grown(200).freeze()


def test_the_disc_is_found_where_it_is(forest):
    rng = np.random.default_rng(11)
    for _ in range(10):
        depth, (x, y), _ = toy(rng, int(rng.integers(900, 1600)))
        found = localise(depth, LENS, [forest])[0]
        assert np.hypot(found.x - x, found.y - y) < 5
        assert found.position is not None
        np.testing.assert_allclose(found.position, LENS.point(found.x, found.y, found.position[2]), atol=1e-9)
        assert abs(found.position[2] * 1000 - depth[int(y) - 2 : int(y) + 3, int(x) - 2 : int(x) + 3].max()) < 20


def test_the_score_does_not_depend_on_distance(forest):
    rng = np.random.default_rng(3)
    scores = {z: [] for z in (900, 1600)}
    for z, values in scores.items():
        for _ in range(8):
            values.append(localise(toy(rng, z)[0], LENS, [forest])[0].score)
    near, far = (np.mean(v) for v in scores.values())
    assert 0.6 < near / far < 1.6  # without z^2 it would be 3.2


def test_early_rejection_changes_no_detection(forest):
    rng = np.random.default_rng(4)
    thorough, quick = LocaliseSettings(THOROUGH), LocaliseSettings()
    for _ in range(20):
        depth, _, _ = toy(rng, int(rng.integers(900, 1600)))
        f, g = localise(depth, LENS, [forest], thorough)[0], localise(depth, LENS, [forest], quick)[0]
        assert np.hypot(f.x - g.x, f.y - g.y) < 1.5 and abs(f.score - g.score) < 0.1 * f.score


def test_metres_are_recognised():
    whole = np.full((48, 64), 2, np.uint16)
    with pytest.raises(InputError, match="that is metres"):
        millimetres(whole)
    np.testing.assert_array_equal(millimetres(np.full((48, 64), 2.5)), 2500)
    np.testing.assert_array_equal(millimetres(np.full((48, 64), np.nan)), 0)
    with pytest.raises(InputError, match="cannot be metres"):
        millimetres(np.full((48, 64), 2500.0))


@pytest.mark.parametrize(
    "picture", [np.zeros((3, 48, 64), np.uint16), np.zeros((8, 64), np.uint16), np.zeros((64, 64), "?")]
)
def test_what_is_no_picture_is_refused(picture):
    with pytest.raises(InputError):
        millimetres(picture)


def test_lenses_that_cannot_be_are_refused():
    with pytest.raises(InputError, match="lens"):
        DepthLens(0.0, 0.0, 1.0, 1.0)
