"""Selection: unbiased, low variance, exactly Algorithm 4."""

import numpy as np

from hypose.inference.resampling import (
    systematic_indices,
)


def copies(index, n):
    return np.array([np.bincount(row, minlength=n) for row in index.reshape(-1, n)])


def random_weights(rng, shape):
    w = rng.random(shape) ** 4 + 1e-12
    return w / w.sum(-1, keepdims=True)


def test_systematic_copies_are_floor_or_ceil():
    rng = np.random.default_rng(0)
    for n in (1, 2, 7, 500):
        w = random_weights(rng, (200, n))
        c = copies(systematic_indices(w, rng.random(200)), n)
        assert (c.sum(1) == n).all()
        assert (c >= np.floor(n * w - 1e-9)).all() and (c <= np.ceil(n * w + 1e-9)).all()


def test_systematic_is_unbiased():
    # averaged over an even grid of starts, the copies are N w up to the grid's own resolution
    w = random_weights(np.random.default_rng(1), 20)
    starts = (np.arange(4000) + 0.5) / 4000
    c = copies(systematic_indices(np.broadcast_to(w, (4000, 20)), starts), 20)
    np.testing.assert_allclose(c.mean(0), 20 * w, atol=2 / 4000)


def test_weight_zero_is_never_drawn():
    w = np.array([0.0, 0.5, 0.0, 0.0, 0.5, 0.0])
    for u in (0.0, 1e-17, 0.3, np.nextafter(1, 0)):
        assert set(systematic_indices(w, u).tolist()) <= {1, 4}
