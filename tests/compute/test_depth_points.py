"""Pieces of a mask and the holes that it closes over, against OpenCV's."""

import cv2
import numpy as np
import pytest

from hypose.compute.depth_points import holes_filled, middle_of_piece


@pytest.fixture(params=[(1, 1), (3, 40), (40, 3), (61, 47)])
def mask(request):
    rng = np.random.default_rng(sum(request.param))
    return (cv2.blur(rng.random(request.param), (3, 3)) > 0.5).astype(np.uint8)


def test_holes_that_a_mask_closes_over_are_filled(mask):
    rng = np.random.default_rng(1)
    depth = (rng.random(mask.shape) > 0.5).astype(np.float32)
    solid = rng.random(mask.shape) > 0.5
    narrow, wide = (cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((k, k), np.uint8)) for k in (3, 5))
    expected = mask | (np.where(solid, wide, narrow) & (depth == 0))
    np.testing.assert_array_equal(holes_filled(mask, depth, solid), expected)


@pytest.mark.parametrize("count", [1, 2, 7, 100])
def test_the_middle_of_a_piece_is_the_median(count):
    depth = np.random.default_rng(count).random((1, count + 3)).astype(np.float32) + 0.1
    labels = np.ones_like(depth, dtype=np.int32)
    labels[0, :2] = 2
    depth[0, 2] = 0  # a hole
    assert middle_of_piece(labels, 1, depth) == np.median(depth[0, 3:])
