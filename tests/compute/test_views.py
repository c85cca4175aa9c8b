"""The outline of a pose in several views at once: what single views and plain sums give, bit by bit."""

import numba
import numpy as np
import pytest

from hypose.compute import silhouettes, vectors
from tests.capsule_person import random_pose, ring

f4 = np.float32


@numba.njit
def second_strip(difference, mask, out, counts):
    strides = difference.shape[1], out.shape[1]
    vectors.fill_strip(difference, 64, strides[0], difference.shape[0], mask, out, 8, strides[1], counts)


@pytest.mark.parametrize("views", [1, 4, 6])
def test_contours_of_views_are_those_of_each_view(body, rng, views):
    rig, mesh, pose = ring(views, f=210.0, size=(200, 230)), body.coarse.arrays, random_pose(body, rng)
    vertices = (body.skin(pose) - pose[:3]).astype(f4)
    n_edges = len(mesh.edges)
    p, turned = np.empty((silhouettes.VIEWS, 3, 4), f4), np.empty((12, silhouettes.VIEWS), f4)
    uv, bounds = np.empty((len(vertices), 2, silhouettes.VIEWS), f4), np.empty((5, silhouettes.VIEWS), f4)
    front, union = np.empty(len(mesh.faces), np.uint8), np.empty(n_edges, np.int32)
    start, end, lines = np.empty(n_edges, np.int32), np.empty(n_edges, np.int32), np.empty((4, n_edges), f4)
    seen, begins, ends = np.empty(len(mesh.faces), np.uint8), np.empty(n_edges, np.int32), np.empty(n_edges, np.int32)
    for c in range(views):
        k = c % silhouettes.VIEWS
        if k == 0:
            silhouettes.project_views(vertices, rig.projections, c, pose, p, turned, uv, bounds)
            silhouettes.front_views(mesh.faces, uv, front)
            n_union = silhouettes.contours_of_any(mesh.edges, front, union)
        exact = np.c_[vertices + pose[:3], np.ones(len(vertices))] @ rig.projections[c].T
        np.testing.assert_allclose(uv[:, :, k], exact[:, :2] / exact[:, 2:], atol=2e-3)
        u, v = (np.ascontiguousarray(uv[:, i, k]) for i in (0, 1))
        np.testing.assert_array_equal(bounds[:4, k], [u.min(), u.max(), v.min(), v.max()])
        assert bounds[4, k] == pytest.approx(exact[:, 2].min(), abs=1e-5)
        silhouettes.front_faces(mesh.faces, u, v, seen)
        np.testing.assert_array_equal((front >> k) & 1, seen)
        n = silhouettes.contours_of_view(k, n_union, union, mesh.edges, front, uv, start, end, lines)
        assert n == silhouettes.contour_edges(mesh.edges, seen, begins, ends) > 20
        np.testing.assert_array_equal([start[:n], end[:n]], [begins[:n], ends[:n]])
        np.testing.assert_array_equal(lines[:, :n], [u[start[:n]], v[start[:n]], u[end[:n]], v[end[:n]]])
        plain, fast = np.zeros((231, 200), np.int8), np.zeros((231, 200), np.int8)
        silhouettes.emit_contours(n, start, end, u, v, 0, 0, 200, 230, plain)
        silhouettes.emit_lines(n, lines, 0, 0, 200, 230, fast)
        np.testing.assert_array_equal(plain, fast)


def test_a_strip_holds_the_pixels_whose_running_sum_is_positive(rng):
    rows, line = 40, 24
    difference = rng.integers(-1, 2, (rows, 8 * line)).astype(np.int8)
    inside = np.cumsum(difference[:, 64:128], 0) > 0
    mask = rng.integers(0, 256, (rows, line)).astype(np.uint8)
    out, counts = np.full((rows, line), 255, np.uint8), np.array([100, 200])
    others = difference[:, :64].copy()
    second_strip(difference, mask, out, counts)
    np.testing.assert_array_equal(np.unpackbits(out[:, 8:16], axis=1, bitorder="little"), inside)
    assert (out[:, :8] == 255).all() and (out[:, 16:] == 255).all()
    seen = np.unpackbits(mask[:, 8:16], axis=1, bitorder="little").astype(bool)
    assert counts.tolist() == [100 + inside.sum(), 200 + (inside & seen).sum()]
    assert not difference[:, 64:128].any() and (difference[:, :64] == others).all()
