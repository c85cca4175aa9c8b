"""Packed masks come back as they were; cleaning removes, fills and keeps what its settings say."""

import cv2
import numpy as np
import pytest

from hypose.compute.packed_masks import Cleaning, clean, draw, pack

SIZES = [(90, 70), (64, 50), (128, 33), (200, 60), (31, 40), (7, 9), (1, 1)]


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
        runs = pack(mask)
        assert np.array_equal(draw(runs), mask) and np.array_equal(mask, before)
        assert np.array_equal(draw(pack(255 * mask)), mask)
        x, y, width, height = cv2.boundingRect(mask)
        assert runs.area == mask.sum() and runs.shape == (h, w)
        assert runs.box == ((y, y + height, x, x + width) if width else (0, 0, 0, 0))
        top, left = h // 4, w // 3
        part = draw(runs, np.zeros((h // 2, w // 2), np.uint8), (top, left))
        assert np.array_equal(part, mask[top : top + h // 2, left : left + w // 2])
        beyond = draw(runs, np.zeros((h + 3, w + 5), np.uint8), (-2, -1))
        assert np.array_equal(beyond, np.pad(mask, ((2, 1), (1, 4))))


def blobs(*boxes):
    """A mask of rectangles y0, y1, x0, x1; a negative sign before y0 cuts one out."""
    mask = np.zeros((60, 80), np.uint8)
    for (y0, y1, x0, x1), value in boxes:
        mask[y0:y1, x0:x1] = value
    return mask


PERSON, NEAR, FAR, SPECK = (10, 40, 10, 30), (42, 50, 12, 22), (10, 40, 65, 75), (30, 31, 33, 34)
HOLE, GAP, BAY = (20, 24, 15, 20), (25, 26, 10, 30), (10, 14, 12, 16)


@pytest.mark.parametrize(
    ("boxes", "how", "kept"),
    [
        ([(PERSON, 1), (SPECK, 1)], Cleaning(open_px=3), [(PERSON, 1)]),
        ([(PERSON, 1), (GAP, 0)], Cleaning(close_px=5), [(PERSON, 1)]),
        ([(PERSON, 1), (HOLE, 0), (BAY, 0)], Cleaning(hole_px=20), [(PERSON, 1), (BAY, 0)]),
        ([(PERSON, 1), (HOLE, 0)], Cleaning(hole_px=19), [(PERSON, 1), (HOLE, 0)]),
        ([(PERSON, 1), (NEAR, 1), (FAR, 1)], Cleaning(keep_gap=0.5), [(PERSON, 1), (NEAR, 1)]),
        ([(PERSON, 1), (NEAR, 1), (FAR, 1)], Cleaning(keep_share=0.4), [(PERSON, 1), (FAR, 1)]),
        ([(PERSON, 1), (NEAR, 1), (FAR, 1)], Cleaning(keep_share=1.0), [(PERSON, 1)]),
        ([], Cleaning(3, 5, 60, 0.02, 0.1), []),
    ],
)
def test_a_mask_is_cleaned_as_its_settings_say(boxes, how, kept):
    mask, wanted = blobs(*boxes), pack(blobs(*kept))
    before = mask.copy()
    for scale in (1, 255):
        found = clean(scale * mask, how)
        assert np.array_equal(draw(found), draw(wanted)) and (found.box, found.area) == (wanted.box, wanted.area)
    assert np.array_equal(mask, before)


@pytest.mark.parametrize("size", SIZES)
def test_cleaned_masks_have_the_size_and_only_add_within_reach(rng, size):
    for mask in masks(rng, size):
        found = draw(clean(mask, Cleaning(0, 5, 0, 0.0)))
        assert found.shape == mask.shape and (found >= mask).all()
        assert (found <= cv2.dilate(mask, np.ones((5, 5), np.uint8))).all()
