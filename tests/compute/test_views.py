"""The outline of a pose in several views at once: its definition, and that of the running sums."""

import numba
import numpy as np
import pytest

from hypose.compute import coverage
from tests import reference
from tests.capsule_person import random_pose, ring

f4 = np.float32


@numba.njit
def second_strip(difference, mask, out, counts):
    strides = difference.shape[1], out.shape[1]
    coverage.fill_strip(difference, 64, strides[0], difference.shape[0], mask, out, 8, strides[1], counts)


@pytest.mark.parametrize("views", [1, 4, 6])
def test_contours_of_views_are_those_of_each_view(body, rng, views):
    rig, mesh, pose = ring(views, f=210.0, size=(200, 230)), body.coarse.arrays, random_pose(body, rng)
    vertices = (body.skin(pose) - pose[:3]).astype(f4)
    n_edges = len(mesh.edges)
    p, turned = np.empty((coverage.VIEWS, 3, 4), f4), np.empty((12, coverage.VIEWS), f4)
    uv, bounds = np.empty((len(vertices), 2, coverage.VIEWS), f4), np.empty((5, coverage.VIEWS), f4)
    front, union = np.empty(len(mesh.faces), np.uint8), np.empty(n_edges, np.int32)
    start, end, lines = np.empty(n_edges, np.int32), np.empty(n_edges, np.int32), np.empty((4, n_edges), f4)
    for c in range(views):
        k = c % coverage.VIEWS
        if k == 0:
            coverage.project_views(vertices, rig.projections, c, pose, p, turned, uv, bounds)
            coverage.front_views(mesh.faces, uv, front)
            n_union = coverage.contours_of_any(mesh.edges, front, union)
        exact = np.c_[vertices + pose[:3], np.ones(len(vertices))] @ rig.projections[c].T
        np.testing.assert_allclose(uv[:, :, k], exact[:, :2] / exact[:, 2:], atol=2e-3)
        u, v = (np.ascontiguousarray(uv[:, i, k]) for i in (0, 1))
        np.testing.assert_array_equal(bounds[:4, k], [u.min(), u.max(), v.min(), v.max()])
        assert bounds[4, k] == pytest.approx(exact[:, 2].min(), abs=1e-5)
        a, b, d = (uv[mesh.faces[:, i], :, k] for i in range(3))
        seen = (b[:, 0] - a[:, 0]) * (d[:, 1] - a[:, 1]) < (d[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
        np.testing.assert_array_equal((front >> k) & 1, seen)
        n = coverage.contours_of_view(k, n_union, union, mesh.edges, front, uv, start, end, lines)
        left, right = seen[mesh.edges[:, 2]], seen[mesh.edges[:, 3]]
        contour = np.where(left[:, None], mesh.edges[:, :2], mesh.edges[:, 1::-1])[left != right]
        assert n == len(contour) > 20
        np.testing.assert_array_equal(np.stack([start[:n], end[:n]], 1), contour)
        np.testing.assert_array_equal(lines[:, :n], [u[start[:n]], v[start[:n]], u[end[:n]], v[end[:n]]])
        difference = np.zeros((231, 256), np.int8)
        coverage.emit_lines(n, lines, 0, 0, 200, 230, difference)
        drawn = reference.rasterize(vertices + pose[:3], mesh.faces, rig.projections[c], (200, 230))
        assert ((np.cumsum(difference, 0)[:230, :200] > 0) != drawn).sum() <= 2


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
