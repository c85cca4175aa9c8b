"""Rows of a body's outline against a mask's, both ways, where the body's sizes or the cameras are unknown too.

The pose solver never makes its rows (cpu_rows.py); here they are given out, since their derivatives are by more than
a pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import MeshArrays
from hypose.compute.native import native, plain
from hypose.compute.pictures.parts import covered

Array = NDArray[np.float64]
_REFERENCE_PX, _HEIGHT_PX, _OUTLINE = 6.0, 260.0, 130
"""Rows of weight 1 lie so far apart on a person so tall; and so many points of the mask's outline."""
_FARTHEST = 0.25
"""of the person's height: what lies farther off is another outline"""
_USUAL = 1024
"""rows of a view, for which there is room at first"""
_NEAR_M = 0.05


@dataclass(frozen=True)
class OutlineRows:
    """ends (R, 2): two mesh vertices a, b; values (R, 6): along, so that the row's point is (1 - along) a + along b,
    residual px, its gradient with respect to the point, px/m, and weight, rows per reference row."""

    ends: NDArray[np.int64]
    values: Array

    @property
    def residual(self) -> Array:
        """(R,) px."""
        return self.values[:, 1]

    @property
    def gradient(self) -> Array:
        """(R, 3) px/m."""
        return self.values[:, 2:5]

    @property
    def weight(self) -> Array:
        """(R,)"""
        return self.values[:, 5]

    def points(self, vertices: Array) -> Array:
        """(R, 3) m, where the rows are on a mesh with vertices (V, 3)."""
        t = self.values[:, :1]
        return (1 - t) * vertices[self.ends[:, 0]] + t * vertices[self.ends[:, 1]]

    def jacobian(self, vertices: Array, twists: Array, moves: Array, slopes: Array | None = None) -> Array:
        """(R, D + K): derivatives by a pose with these world twists (D, 6), then by K sizes.

        vertices (V, 3) m; moves (V, D): share of a dof's motion at a vertex; slopes (V, K, 3) of the vertices by the
        sizes, None: there are none."""
        by_size = np.zeros((len(vertices), 0, 3)) if slopes is None else slopes
        out = np.empty((len(self.ends), twists.shape[0] + by_size.shape[1]))
        given = (plain(x, np.float64) for x in (self.values, vertices, twists, moves, by_size))
        native("solver.outline_rows").row_jacobian(plain(self.ends, np.int64), *given, out)
        return out


def joined_rows(parts: Sequence[OutlineRows]) -> OutlineRows:
    """The rows of several views, one after the other."""
    none = OutlineRows(np.zeros((0, 2), np.int64), np.zeros((0, 6)))
    return OutlineRows(*(np.concatenate([getattr(p, n) for p in (none, *parts)]) for n in ("ends", "values")))


def outline_rows(
    vertices: Array,
    faces: NDArray[np.int32],
    edges: NDArray[np.int32],
    projection: ArrayLike,
    size: Sequence[int],
    sdf: NDArray[np.float32],
    outline: NDArray[np.float32],
    height_px: float,
    spacing_px: float,
    least_cosine: float,
) -> OutlineRows | None:
    """Rows of one view: the body's outline in the mask's distances, and the mask's to the body's nearest.

    vertices (V, 3) m of a closed mesh with faces (F, 3) and edges (E, 4); projection (3, 4); size (2,): width, height
    px; sdf (h, w) px, negative inside, and outline (K, 2) px of the mask; height_px of the person; spacing_px: of the
    first kind of rows. Rows whose outlines have normals with a cosine below least_cosine are left out; None when the
    body is not in the view. Which points are the outline, and which is nearest, is held fixed in the derivatives."""
    reference = max(_REFERENCE_PX / _HEIGHT_PX * height_px, 1.0)
    lengths = np.array([reference, _FARTHEST * height_px, _OUTLINE / max(len(outline), 1)])
    v, p = plain(vertices, np.float64), plain(projection, np.float64)
    seen = np.einsum("vc,rc->vr", v, p[:, :3]) + p[:, 3]
    if not (seen[:, 2] > _NEAR_M).all():
        return None
    uv, f = seen[:, :2] / seen[:, 2:], plain(faces, np.int32)
    own = covered(uv, seen[:, 2], f, (size[1], size[0]))
    given = v, uv, f, plain(edges, np.int32), p, own, plain(sdf, np.float32), plain(outline, np.float32)
    n = -_USUAL
    while n < -1:
        ends, values = np.empty((-n, 2), np.int64), np.empty((-n, 6))
        find = native("solver.outline_rows").outline_rows
        n = find(*given, float(spacing_px), float(least_cosine), lengths, ends, values)
    return None if n < 0 else OutlineRows(ends[:n], values[:n])


def warm_up(mesh: MeshArrays) -> None:
    """Both kernels once, on a toy."""
    row = OutlineRows(np.zeros((1, 2), np.int64), np.zeros((1, 6)))
    row.jacobian(np.float64(mesh.vertices), np.zeros((6, 6)), np.zeros((len(mesh.vertices), 6)))
    picture, outline = np.zeros((8, 8), np.float32), np.zeros((1, 2), np.float32)
    outline_rows(mesh.vertices + 1.0, mesh.faces, mesh.edges, np.eye(3, 4), [8, 8], picture, outline, 8.0, 4.0, 0.5)
