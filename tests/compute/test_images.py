"""Pictures to masks: the compiled kernels give the bytes of the plain definitions, in a box as in the whole."""

import cv2
import numpy as np
import pytest

from hypose import compute
from hypose.compute.pictures import picture_to_mask
from hypose.errors import InputError


def lens_of(stored, working, bend=0.1, shift=0.3):
    x, y = np.meshgrid(np.arange(working[0]), np.arange(working[1]))
    r2 = ((x - working[0] / 2) ** 2 + (y - working[1] / 2) ** 2) / working[0] ** 2
    return picture_to_mask.make_lens(
        stored, x + (x - working[0] / 2) * bend * r2 + shift, y + (y - working[1] / 2) * bend * r2
    ), (x, y, r2)


@pytest.mark.parametrize("stored", [(240, 180), (160, 120), (108, 121), (80, 60), (97, 60)])
@pytest.mark.parametrize("bend", [0.0, 0.1, -0.3])
def test_undistorted_pictures_are_those_of_the_definition(rng, stored, bend):
    lens, _ = lens_of(stored, (80, 60), bend, 0.0 if bend == 0 else 0.3)
    assert lens.straight == (bend == 0)
    picture = rng.integers(0, 256, (stored[1], stored[0], 3), dtype=np.uint8)
    fast = picture_to_mask.shrink_undistort(picture, lens)
    with compute.use("numpy"):
        plain = picture_to_mask.shrink_undistort(picture, lens)
    assert np.array_equal(fast, plain)
    y0, y1, x0, x1 = box = (7, 41, 13, 64)
    assert np.array_equal(picture_to_mask.shrink_undistort(picture, lens, box)[y0:y1, x0:x1], fast[y0:y1, x0:x1])


def test_undistorted_pictures_are_those_of_opencv(rng):
    lens, (x, y, r2) = lens_of((322, 243), (240, 180))
    picture = rng.integers(0, 256, (243, 322, 3), dtype=np.uint8)
    maps = [(a + (a - n / 2) * 0.1 * r2 + s).astype(np.float32) for a, n, s in ((x, 240, 0.3), (y, 180, 0.3))]
    lens = picture_to_mask.make_lens((322, 243), *maps)
    shrunk = cv2.resize(picture, (240, 180), interpolation=cv2.INTER_AREA)
    other = cv2.remap(shrunk, *maps, cv2.INTER_LINEAR)
    difference = np.abs(other.astype(int) - picture_to_mask.shrink_undistort(picture, lens))
    assert difference.mean() < 0.6 and np.percentile(difference, 99.9) <= 4
    flat = np.full((243, 322, 3), 200, np.uint8)
    assert set(np.unique(picture_to_mask.shrink_undistort(flat, lens)[5:-5, 5:-5])) <= {200}


def test_pictures_of_another_size_are_refused():
    lens, _ = lens_of((160, 120), (80, 60))
    with pytest.raises(InputError, match="160"):
        picture_to_mask.shrink_undistort(np.zeros((60, 80, 3), np.uint8), lens)
    with pytest.raises(InputError, match="enlarged"):
        lens_of((60, 60), (80, 60))


@pytest.mark.parametrize("shadow", [True, False])
def test_differences_and_shadows_are_those_of_the_definition(rng, shadow):
    mean = rng.integers(40, 220, (50, 70, 3)).astype(np.float32)
    dark = rng.random((50, 70, 1)) * 0.7 + 0.4
    picture = np.clip(mean * dark + rng.normal(0, 3, mean.shape), 0, 255).astype(np.uint8)
    picture[20:35, 10:60] = rng.integers(0, 256, (15, 50, 3))
    low, high = np.clip(mean - 20, 0, 255).astype(np.uint8), np.clip(mean + 20, 0, 255).astype(np.uint8)
    room = picture_to_mask.Room(low, high, mean, (mean * mean).sum(2), shadow, 0.45, 0.97, 144.0)
    fast, box = picture_to_mask.differences(picture, room), (3, 44, 5, 61)
    part = picture_to_mask.differences(picture, room, box)
    foreground = picture_to_mask.without_shadows(fast)
    with compute.use("numpy"):
        plain = picture_to_mask.differences(picture, room)
        assert np.array_equal(picture_to_mask.without_shadows(fast), foreground)
    assert (plain != fast).mean() < 1e-3  # the shadow test is in floating point
    assert set(np.unique(fast)) == ({0, 1, 2} if shadow else {0, 1})
    assert np.array_equal(part[3:44, 5:61], fast[3:44, 5:61]) and part.sum() == part[3:44, 5:61].sum()


@pytest.mark.parametrize("noise", [0.0, 0.002, 0.05, 0.5])
@pytest.mark.parametrize("rule", [(60, 0.02, 0.1), (0, 1.0, np.inf), (10, 0.001, 0.3), (5, 0.0, np.inf)])
def test_regions_are_those_of_opencv(rng, noise, rule):
    for _ in range(5):
        mask = np.zeros((70, 90), np.uint8)
        for _ in range(8):
            centre, axes = rng.integers(0, 90, 2).tolist(), rng.integers(2, 30, 2).tolist()
            cv2.ellipse(mask, centre, axes, 0, 0, 360, int(rng.integers(0, 2)), -1)
        mask ^= (rng.random(mask.shape) < noise).astype(np.uint8)
        before = mask.copy()
        fast = picture_to_mask.clean_regions(mask, *rule)
        assert np.array_equal(mask, before)
        with compute.use("numpy"):
            assert np.array_equal(fast, picture_to_mask.clean_regions(mask, *rule))
    for whole in (0, 1):
        assert (picture_to_mask.clean_regions(np.full((9, 11), whole, np.uint8), *rule) == whole).all()


@pytest.mark.parametrize("hide", [False, True])
def test_order_statistics_are_those_of_sorting(rng, hide):
    stack = rng.integers(0, 256, (9, 300, 3), dtype=np.uint8)
    hidden = rng.random((9, 300)) < 0.5 if hide else None
    rank = rng.integers(0, 9, 300)
    fast = picture_to_mask.order_statistic(stack, hidden, rank)
    with compute.use("numpy"):
        assert np.array_equal(fast, picture_to_mask.order_statistic(stack, hidden, rank))
    if not hide:
        assert np.array_equal(fast[7], np.sort(stack[:, 7], 0)[rank[7]])
