"""Pieces of depth maps."""

import numpy as np
import pytest

from hypose.compute.depth_points import middle_of_piece


@pytest.mark.parametrize("count", [1, 2, 7, 100])
def test_the_middle_of_a_piece_is_the_median(count):
    depth = np.random.default_rng(count).random((1, count + 3)).astype(np.float32) + 0.1
    labels = np.ones_like(depth, dtype=np.int32)
    labels[0, :2] = 2
    depth[0, 2] = 0  # a hole
    assert middle_of_piece(labels, 1, depth) == np.median(depth[0, 3:])
