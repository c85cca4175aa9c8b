"""A look at every fourth pixel finds the box of what is not the room."""

import cv2
import numpy as np
import pytest

from hypose.compute.glance import AMONG, MARGIN, STEP, differing_box, glance_at, stored_places
from hypose.compute.picture_to_mask import BackgroundLevels, make_lens, shrink_undistort

SIZE = (160, 120)


def room_of(mean, slack=12):
    low, high = (np.clip(mean.astype(int) + s, 0, 255).astype(np.uint8) for s in (-slack, slack))
    return BackgroundLevels(low, high, mean.astype(np.float32), False, 0.5, 0.9, 100.0)


def maps():
    x, y = np.meshgrid(np.arange(SIZE[0], dtype=float), np.arange(SIZE[1], dtype=float))
    return x + 1.5, y - 0.7


@pytest.fixture
def walls(rng):
    """A room with sharp edges as it is undistorted, and the stored picture of it, three times as large."""
    stored = np.repeat(np.repeat(rng.integers(40, 200, (12, 16, 3)), 30, 0), 30, 1).astype(np.uint8)
    return shrink_undistort(stored, make_lens((480, 360), *maps())), stored


def look(picture, mean):
    places = stored_places((picture.shape[1], picture.shape[0]), *maps())
    glance = glance_at(room_of(mean))
    y, x = (np.floor(a).astype(int) for a in (places.y, places.x))
    value = (sum(picture[y + i, x + j].astype(int) for i in (0, 1) for j in (0, 1)) + 2) >> 2
    found = ((value < glance.low) | (value > glance.high)).any(2) & ~places.outside
    company = cv2.boxFilter(found.astype(np.uint8), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    left, top, w, h = cv2.boundingRect((found & (company >= AMONG)).astype(np.uint8))
    ends = STEP * (top + h) + MARGIN, STEP * (left + w) + MARGIN
    wanted = max(STEP * top - MARGIN, 0), min(ends[0], SIZE[1]), max(STEP * left - MARGIN, 0), min(ends[1], SIZE[0])
    box = differing_box(picture, places, glance, SIZE)
    assert box == (wanted if h else None)
    return box


def noisy(picture, rng, sd=4.0):
    return np.clip(np.rint(picture + rng.normal(0, sd, picture.shape)), 0, 255).astype(np.uint8)


def test_an_empty_room_with_noise_and_edges_has_no_box(walls, rng):
    mean, picture = walls
    assert look(noisy(picture, rng), mean) is None


def test_the_box_holds_the_person_and_a_margin(walls, rng):
    mean, picture = walls
    x, y = maps()
    for left, top, w, h in ((60, 30, 20, 50), (0, 0, 12, 30), (140, 100, 20, 20)):
        seen = picture.copy()
        seen[3 * top : 3 * (top + h), 3 * left : 3 * (left + w)] = (5, 250, 5)
        y0, y1, x0, x1 = look(noisy(seen, rng), mean)
        inside = (x >= left) & (x < left + w) & (y >= top) & (y < top + h)
        rows, columns = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
        assert y0 <= rows[0] and rows[-1] < y1 and x0 <= columns[0] and columns[-1] < x1
        reach = MARGIN + STEP
        assert y0 >= rows[0] - reach and y1 <= rows[-1] + reach + 1
        assert x0 >= columns[0] - reach and x1 <= columns[-1] + reach + 1
