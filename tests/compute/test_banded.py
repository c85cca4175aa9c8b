"""Coupled frames: the kernels against dense linear algebra."""

import numpy as np
import pytest

from hypose import compute
from hypose.compute.solver.banded import frame_covariances, solve_coupled


@pytest.fixture(params=[1, 2, 5, 8])
def clip(request, rng):
    """own (T, D, D) with a frame of which nothing is known, and bands (3, T, D)."""
    frames, d = request.param, 4
    a = rng.normal(size=(frames, d, d))
    own = a @ np.swapaxes(a, 1, 2) + 0.1 * np.eye(d)
    if frames > 2:
        own[frames // 2] = 0.0
    bands = np.zeros((3, frames, d))
    for stencil, weight in (((1, -2, 1), rng.uniform(1, 5, d)), ((-1, 1), rng.uniform(0.1, 1, d))):
        for first in range(frames - len(stencil) + 1):
            for i, x in enumerate(stencil):
                for j in range(i, len(stencil)):
                    bands[j - i, first + i] += x * stencil[j] * weight
    return own, bands


def test_kernels_agree_with_dense_algebra(clip, rng):
    own, bands = clip
    right = rng.normal(size=own.shape[:2])
    with compute.use("reference"):
        x, covariances = solve_coupled(own, bands, right), frame_covariances(own, bands)
    np.testing.assert_allclose(solve_coupled(own, bands, right), x, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(frame_covariances(own, bands), covariances, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("back_end", ["auto", "reference"])
def test_a_matrix_that_is_not_positive_is_refused(back_end):
    own = -np.eye(3)[None].repeat(4, 0)
    with compute.use(back_end):
        assert solve_coupled(own, np.zeros((3, 4, 3)), np.ones((4, 3))) is None
