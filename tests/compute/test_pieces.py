"""Pieces of masks that points touch, as scipy labels them."""

import numpy as np
import pytest
from scipy.ndimage import label

from hypose.compute.parts import touched_area


def expected(picture: np.ndarray, cells: np.ndarray) -> tuple[int, int]:
    labels = np.zeros(picture.shape, np.int32)
    label(picture, np.ones((3, 3)), output=labels)
    area = np.bincount(labels.ravel())
    own = np.zeros(len(area), bool)
    own[labels[cells[:, 1], cells[:, 0]]] = True
    own[0], area[0] = False, 0
    return int(area[own].sum()), int(area[~own].max())


@pytest.mark.parametrize("step", [1, 2, 3])
def test_areas_are_those_of_labelled_pieces(step: int, rng: np.random.Generator) -> None:
    touched = 0
    for share in (0.02, 0.3, 0.45, 0.7, 1.0):
        for shape in ((1, 1), (1, 40), (37, 1), (50, 61)):
            now, before = (rng.random(shape) < share for _ in range(2))
            at = rng.uniform(-5, np.array(shape[::-1]) + 5, (12, 2))
            at[0] = np.nan
            at[1:3] = (0, 0), (shape[1] - 1, shape[0] - 1)
            small = (now & before)[::step, ::step]
            inside = at[((at >= 0) & (at <= (shape[1] - 1, shape[0] - 1))).all(1)]
            cells = np.minimum(np.rint(inside / step).astype(int), (small.shape[1] - 1, small.shape[0] - 1))
            bits, others = (np.packbits(m, axis=1, bitorder="little") for m in (now, before))
            found = touched_area(bits, others, (shape[1], shape[0]), step, at)
            assert found == expected(small, cells)
            touched += found[0] > 0
    assert touched > 5
