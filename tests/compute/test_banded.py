"""Coupled frames against dense linear algebra."""

import numpy as np
import pytest

from hypose.compute.linear import frame_covariances, solve_coupled


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


def dense(own, bands):
    t, d = own.shape[:2]
    m, on = np.zeros((t, d, t, d)), np.arange(d)
    for k in range(t):
        m[k, :, k] += own[k]
        m[k, on, k, on] += bands[0, k]
        for s in (1, 2):
            if k + s < t:
                m[k, on, k + s, on] = m[k + s, on, k, on] = bands[s, k]
    return m.reshape(t * d, t * d)


def test_frames_are_solved_as_by_dense_algebra(clip, rng):
    own, bands = clip
    right, inverse = rng.normal(size=own.shape[:2]), np.linalg.inv(dense(own, bands))
    np.testing.assert_allclose(solve_coupled(own, bands, right).ravel(), inverse @ right.ravel(), rtol=1e-8, atol=1e-12)
    blocks = np.einsum("tdte->tde", inverse.reshape(*own.shape[:2], *own.shape[:2]))
    np.testing.assert_allclose(frame_covariances(own, bands), blocks, rtol=1e-8, atol=1e-12)


def test_a_matrix_that_is_not_positive_is_refused():
    own, bands = -np.eye(3)[None].repeat(4, 0), np.zeros((3, 4, 3))
    assert solve_coupled(own, bands, np.ones((4, 3))) is None
    assert frame_covariances(own, bands) is None
