"""Masks of a stream, packed."""

import numpy as np
import pytest

from hypose.compute.mask_runs import draw, runs_of
from hypose.evidence.outlines import WORKING_HEIGHT, view_outline
from hypose.io.recordings.masks_in_work import PackedMask


@pytest.mark.parametrize("box", [(0, 40, 0, 30), (17, 60, 23, 64), (5, 6, 9, 10), (0, 0, 0, 0)])
def test_a_packed_mask_comes_back_and_so_does_its_outline(box):
    y0, y1, x0, x1 = box
    mask = np.zeros((60, 64), np.uint8)
    mask[y0:y1, x0:x1] = np.random.default_rng(0).random((y1 - y0, x1 - x0)) < 0.9
    packed = PackedMask(runs_of(mask), "")
    np.testing.assert_array_equal(draw(packed.runs), mask)
    assert packed.area == mask.sum()
    made, whole = packed.outline(), view_outline(mask, working_height=WORKING_HEIGHT)
    assert made.corner == whole.corner and made.found == whole.found
    np.testing.assert_array_equal(made.distance, whole.distance)
    np.testing.assert_array_equal(made.points, whole.points)


def test_no_mask_has_no_outline():
    packed = PackedMask(None, "cam1: no image")
    assert packed.outline() is None and packed.area == 0 and packed.reason == "cam1: no image"
