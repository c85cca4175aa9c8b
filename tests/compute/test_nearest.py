"""The nearest of many, as the solver looks for it: points of an outline, places on triangles."""

import numpy as np
import pytest

from hypose.compute import contours, depth_rows

f4 = np.float32


@pytest.mark.parametrize("height", [30.0, 400.0, 900.0])
@pytest.mark.parametrize("count", [1, 13, 400])
def test_the_nearest_point_is_that_of_a_look_at_all(height, count):
    rng = np.random.default_rng(count)
    low = f4(20)
    u, v = rng.uniform(0, 100, count).astype(f4), (low + rng.uniform(0, height, count)).astype(f4)
    ordered, rows, number = np.empty(2032, f4), np.empty(2032, f4), np.empty(2032, np.int32)
    place = np.empty(65, np.int64)
    contours._by_row(count, u, v, low, ordered, rows, number, place)
    assert sorted(number[:count]) == list(range(count))
    assert place[0] == 0 and place[-1] == count and (np.diff(place) >= 0).all()
    points = rng.uniform((-50, -100), (150, height + 150), (200, 2)).astype(f4)
    points[7] = -1e6  # left out
    found = np.empty(len(points), np.int32)
    contours.nearest(count, ordered, rows, number, place, low, points, found)
    assert found[7] == 0
    for one, (x, y) in zip(np.delete(found, 7), np.delete(points, 7, axis=0), strict=True):
        packed = np.minimum((np.square(u - x) + np.square(v - y)) * f4(64), f4(1e6)).astype(np.int64)
        assert one == packed.argmin()  # the first among equals


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
