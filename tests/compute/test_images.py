"""Pictures to masks: foreground by its definition; undistorted pictures in a box as in the whole."""

import cv2
import numpy as np
import pytest

from hypose.compute import picture_to_mask
from hypose.errors import InputError


def lens_of(stored, working, bend=0.1, shift=0.3):
    x, y = np.meshgrid(np.arange(working[0]), np.arange(working[1]))
    r2 = ((x - working[0] / 2) ** 2 + (y - working[1] / 2) ** 2) / working[0] ** 2
    maps = x + (x - working[0] / 2) * bend * r2 + shift, y + (y - working[1] / 2) * bend * r2
    return picture_to_mask.make_lens(stored, *maps), maps


def not_the_room(image, room, box):
    """The definition, as a mask; floating point in the kernel's order."""
    y0, y1, x0, x1 = box or (0, image.shape[0], 0, image.shape[1])
    s = np.s_[y0:y1, x0:x1]
    other = ((image[s] < room.low[s]) | (image[s] > room.high[s])).any(2).astype(np.uint8)
    if room.shadow:
        colour, mean = np.moveaxis(image[s].astype(np.float32), 2, 0), np.moveaxis(room.mean[s], 2, 0)
        dot = [a[0] + a[1] + a[2] for a in (colour * mean, mean * mean)]
        brightness = dot[0] / np.maximum(dot[1], np.float32(1))
        rest = (colour - brightness * mean) ** 2
        dark = (brightness > np.float32(room.darkest)) & (brightness < np.float32(room.lightest))
        dark &= rest[0] + rest[1] + rest[2] < np.float32(room.chroma)
        other -= cv2.morphologyEx(other * dark, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    mask = np.zeros(image.shape[:2], np.uint8)
    mask[s] = other
    return mask


@pytest.mark.parametrize("stored", [(240, 180), (160, 120), (108, 121), (80, 60), (97, 60), (960, 61), (85, 660)])
@pytest.mark.parametrize("bend", [0.0, 0.1, -0.3])
def test_undistorted_pictures_are_those_of_opencv(rng, stored, bend):
    lens, maps = lens_of(stored, (80, 60), bend, 0.0 if bend == 0 else 0.3)
    assert lens.straight == (bend == 0)
    picture = rng.integers(0, 256, (stored[1], stored[0], 3), dtype=np.uint8)
    shrunk = cv2.resize(picture, (80, 60), interpolation=cv2.INTER_AREA)
    other = cv2.remap(shrunk, *(m.astype(np.float32) for m in maps), cv2.INTER_LINEAR)
    fast = picture_to_mask.shrink_undistort(picture, lens)
    difference = np.abs(other.astype(int) - fast)
    assert difference.mean() < 1.0 and np.percentile(difference, 99.9) <= 5
    flat = np.full((stored[1], stored[0], 3), 200, np.uint8)
    assert set(np.unique(picture_to_mask.shrink_undistort(flat, lens)[8:-8, 8:-8])) <= {200}
    y0, y1, x0, x1 = box = (7, 41, 13, 64)
    assert np.array_equal(picture_to_mask.shrink_undistort(picture, lens, box)[y0:y1, x0:x1], fast[y0:y1, x0:x1])


def test_pictures_of_another_size_are_refused():
    lens, _ = lens_of((160, 120), (80, 60))
    with pytest.raises(InputError, match="160"):
        picture_to_mask.shrink_undistort(np.zeros((60, 80, 3), np.uint8), lens)
    with pytest.raises(InputError, match="enlarged"):
        lens_of((60, 60), (80, 60))


@pytest.mark.parametrize("shadow", [True, False])
@pytest.mark.parametrize("size", [(70, 50), (64, 40), (129, 33), (15, 9)])
def test_what_is_not_the_room_is_that_of_the_definition(rng, shadow, size):
    w, h = size
    mean = cv2.blur(rng.integers(40, 220, (h, w, 3)).astype(np.float32), (5, 5))
    light = 0.1 + 1.7 * cv2.blur(rng.random((h, w)), (7, 7))[..., None]
    picture = np.clip(mean * light + rng.normal(0, 3, mean.shape), 0, 255).astype(np.uint8)
    picture[h // 3 : h // 2, w // 5 : w // 2] = rng.integers(0, 256, (h // 2 - h // 3, w // 2 - w // 5, 3))
    low, high = np.clip(mean - 20, 0, 255).astype(np.uint8), np.clip(mean + 20, 0, 255).astype(np.uint8)
    room = picture_to_mask.BackgroundLevels(low, high, mean, shadow, 0.45, 0.97, 144.0)
    for box in (None, (h // 9, 2 * h // 3, w // 6, 4 * w // 5)):
        fast = picture_to_mask.not_the_room(picture, room, box)
        assert fast.any() and np.array_equal(fast, not_the_room(picture, room, box))


@pytest.mark.parametrize("hide", [False, True])
def test_order_statistics_are_those_of_sorting(rng, hide):
    stack = rng.integers(0, 256, (9, 300, 3), dtype=np.uint8)
    hidden = rng.random((9, 300)) < 0.5 if hide else None
    rank = rng.integers(0, 9, 300)
    fast = picture_to_mask.order_statistic(stack, hidden, rank)
    for p in range(300):
        values = np.sort(stack[:, p] if hidden is None else stack[~hidden[:, p], p], 0)
        assert np.array_equal(fast[p], values[rank[p]] if rank[p] < len(values) else [255] * 3)
