"""The nearest of many, as the solver looks for it: points of an outline, places on triangles."""

import numpy as np

from hypose.compute import depth_rows

f4 = np.float32


def test_the_nearest_place_of_a_triangle_is_as_near_as_any():
    rng = np.random.default_rng(0)
    lanes = 16
    shares = np.linspace(0, 1, 101)
    s, t = (x.ravel() for x in np.meshgrid(shares, shares))
    s, t = s[s + t <= 1], t[s + t <= 1]
    parts = set()
    for _ in range(40):
        u, v, p = rng.standard_normal((3, lanes, 3)).astype(f4)
        work = np.zeros(12 * lanes, f4)
        work[: 9 * lanes] = np.concatenate([u.T, v.T, p.T]).ravel()
        depth_rows.closest_on_triangles(work)
        a, b, squared = work[9 * lanes :].reshape(3, lanes).astype(np.float64)
        assert (np.minimum(a, b) >= -1e-6).all()
        assert (a + b <= 1 + 1e-6).all()
        place = a[:, None] * u + b[:, None] * v
        np.testing.assert_allclose(((place - p) ** 2).sum(1), squared, rtol=1e-4, atol=1e-6)
        every = s[:, None, None] * u + t[:, None, None] * v
        assert (squared <= ((every - p) ** 2).sum(-1).min(0) + 1e-5).all()
        parts |= {(x > 1e-6, y > 1e-6, x + y < 1 - 1e-6) for x, y in zip(a.tolist(), b.tolist(), strict=True)}
    assert len(parts) == 7  # corners, edges, inside
