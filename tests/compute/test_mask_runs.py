"""Masks as bits and runs: the compiled kernels find what OpenCV does, and masks come back as they were."""

import cv2
import numpy as np
import pytest

from hypose import compute
from hypose.compute.pictures.mask_runs import Cleaning, bits_of, clean, draw, runs_of

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


@pytest.mark.parametrize("how", RULES)
@pytest.mark.parametrize("size", SIZES)
def test_cleaned_masks_are_those_of_opencv(rng, size, how):
    shape = size[1], size[0]
    for mask in masks(rng, size):
        bits = bits_of(mask)
        with compute.use("numpy"):
            assert np.array_equal(bits_of(mask), bits)
            plain = clean(bits.copy(), shape, how)
        fast = clean(bits, shape, how)
        assert np.array_equal(draw(fast), draw(plain))
        assert (fast.box, fast.area) == (plain.box, plain.area)
