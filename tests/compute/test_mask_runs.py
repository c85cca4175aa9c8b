"""Masks as bits and runs: the compiled kernels find what OpenCV does, and masks come back as they were."""

import cv2
import numpy as np
import pytest

from hypose.compute.mask_runs import Cleaning, bits_of, clean, disc, draw, runs_of

SIZES = [(90, 70), (64, 50), (128, 33), (200, 60), (31, 40), (7, 9), (1, 1)]
RULES = [
    Cleaning(),
    Cleaning(0, 5, 60, 0.02, 0.1),
    Cleaning(3, 9, 400, 0.0, np.inf),
    Cleaning(2, 4, 0, 1.0, np.inf),
    Cleaning(4, 6, 10, 0.001, 0.3),
    Cleaning(0, 20, 10**6, 0.0, 0.3),
    Cleaning(5, 0, 5, 0.0, np.inf),
    Cleaning(0, 100, 30, 0.1, 1.0),
]


def masks(rng, size):
    """Ellipses, some of them holes, over all borders, with more and more noise; none and all."""
    w, h = size
    for noise in (0.0, 0.002, 0.05, 0.5):
        mask = np.zeros((h, w), np.uint8)
        for _ in range(8):
            centre, axes = rng.integers(0, max(w, h), 2).tolist(), rng.integers(2, 30, 2).tolist()
            cv2.ellipse(mask, centre, axes, 0, 0, 360, int(rng.integers(0, 2)), -1)
        yield mask ^ (rng.random(mask.shape) < noise).astype(np.uint8)
    for whole in (0, 1):
        yield np.full((h, w), whole, np.uint8)


@pytest.mark.parametrize("size", SIZES)
def test_masks_come_back(rng, size):
    w, h = size
    for mask in masks(rng, size):
        before = mask.copy()
        runs = runs_of(mask)
        assert np.array_equal(draw(runs), mask) and np.array_equal(mask, before)
        assert np.array_equal(draw(runs_of(255 * mask)), mask)
        x, y, width, height = cv2.boundingRect(mask)
        assert runs.area == mask.sum() and runs.shape == (h, w)
        assert runs.box == ((y, y + height, x, x + width) if width else (0, 0, 0, 0))
        top, left = h // 4, w // 3
        part = draw(runs, np.zeros((h // 2, w // 2), np.uint8), (top, left))
        assert np.array_equal(part, mask[top : top + h // 2, left : left + w // 2])
        beyond = draw(runs, np.zeros((h + 3, w + 5), np.uint8), (-2, -1))
        assert np.array_equal(beyond, np.pad(mask, ((2, 1), (1, 4))))


def cleaned(mask, how):
    """The definition of `clean`, by OpenCV."""
    out, margin = np.zeros_like(mask), how.close_px + 1
    x, y, w, h = cv2.boundingRect(mask)
    if w == 0:
        return out
    part = np.s_[max(y - margin, 0) : y + h + margin, max(x - margin, 0) : x + w + margin]
    made = mask[part].copy()
    if how.open_px > 1:
        square = np.ones((how.open_px, how.open_px), np.uint8)
        made = np.asarray(cv2.morphologyEx(made, cv2.MORPH_OPEN, square), dtype=np.uint8)
    if how.close_px > 1:
        made = np.asarray(cv2.morphologyEx(made, cv2.MORPH_CLOSE, disc(how.close_px)), dtype=np.uint8)
    out[part] = regions(made, how)
    return out


def regions(part, how):
    if how.hole_px:
        _, label, stats, _ = cv2.connectedComponentsWithStats(1 - part, connectivity=4)
        small = stats[:, cv2.CC_STAT_AREA] <= how.hole_px
        small[0] = False  # label 0 is the foreground here
        part |= small[np.asarray(label, dtype=np.int64)].astype(np.uint8)
    count, label, stats, _ = cv2.connectedComponentsWithStats(part, connectivity=8)
    if count < 2:
        return part
    area = stats[:, cv2.CC_STAT_AREA].astype(np.int64)
    area[0] = 0
    main = int(area.argmax())
    keep = (area >= max(how.keep_share * area[main], 1)) & (area > 0)
    if how.keep_share >= 1:
        keep = np.arange(count) == main
    start = stats[:, [cv2.CC_STAT_LEFT, cv2.CC_STAT_TOP]].astype(np.int64)
    size = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].astype(np.int64)
    gap = np.maximum(np.maximum(start - (start + size)[main], start[main] - (start + size)), 0).max(1)
    keep &= gap <= how.keep_gap * size[main].max()
    return keep[np.asarray(label, dtype=np.int64)].astype(np.uint8)


@pytest.mark.parametrize("how", RULES)
@pytest.mark.parametrize("size", SIZES)
def test_cleaned_masks_are_those_of_opencv(rng, size, how):
    shape = size[1], size[0]
    for mask in masks(rng, size):
        plain, fast = runs_of(cleaned(mask, how)), clean(bits_of(mask), shape, how)
        assert np.array_equal(draw(fast), draw(plain))
        assert (fast.box, fast.area) == (plain.box, plain.area)
