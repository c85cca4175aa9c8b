"""Find which part of a body is in front in each pixel of the views, and how well the colours there fit the part."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import PreparedMasks, plain
from hypose.compute.compiled import kernel
from hypose.compute.parts import projected
from hypose.compute.threads import over_chunks
from hypose.compute.zbuffer import draw_faces, draw_nearest, inverse_depth
from hypose.geometry import Array

_LIMB = 32
"""Number of labels per limb, and largest number of parts."""
_ENOUGH = 1500
"""Number of pixels of a person that suffice instead of all."""
_STRONG = 3.0
"""A strong edge is a change of colour of so many times the usual change within a person."""


def shown_parts(
    vertices: ArrayLike,
    faces: NDArray[np.int32],
    part: NDArray[np.uint8],
    projection: ArrayLike,
    shape: tuple[int, int],
) -> tuple[NDArray[np.uint8], tuple[slice, slice]]:
    """Draw which part of a body is in front in each pixel of a view.

    vertices: (V, 3) m.
    faces, part: (F, 3), and (F,) part of each.
    projection: (3, 4) pinhole projection.
    shape: (h, w) shape of the view.
    Returns: (h, w) number of the visible part plus 1, 0 where there is no body; and the rows and columns that
        contain the body.
    """
    out, (uv, z, reach) = np.zeros(shape, np.uint8), projected(vertices, projection)
    x0, y0 = (int(np.clip(np.ceil(reach[k, 0]), 0, shape[1 - k])) for k in range(2))
    x1, y1 = (int(np.clip(np.floor(reach[k, 1]) + 1, n, shape[1 - k])) for k, n in enumerate((x0, y0)))
    box = slice(y0, y1), slice(x0, x1)
    face = np.full((y1 - y0, x1 - x0), -1, np.int32)
    draw_faces(uv - (x0, y0), inverse_depth(z), faces, np.zeros(face.shape, np.float32), face, cull=True)
    out[box] = np.where(face >= 0, part[face] + 1, 0)
    return out, box


def _step(area: float) -> int:
    """Return the step between the rows and columns that are read of a mask of this area."""
    return max(1, round(math.sqrt(area / _ENOUGH)))


def rim_edges(masks: PreparedMasks, edges: NDArray[np.uint8] | None) -> tuple[NDArray[np.float32], ...]:
    """Compute the strength of colour edges in the masks of each view, for `colour_sums`.

    masks: masks of the frame.
    edges: (C, 2, h, w) changes of colour; None: zeros.
    Returns: per view (2, h, w), at the pixels that `colour_sums` reads: the change of colour in multiples of the usual
        change within the mask, at most 1, minus its mean over the mask.
    """
    out = list[NDArray[np.float32]]()
    for c, (w, h) in enumerate(masks.sizes.tolist()):
        step = _step(masks.areas[c])
        mask = masks.masks[c, :h:step, :w:step] > 0
        found = np.zeros((2, *mask.shape), np.float32)
        if edges is not None and masks.usable[c] and mask.any():
            near = np.ones((step, step), np.uint8)
            for k in range(2):
                seen = cv2.dilate(edges[c, k, :h, :w], near)[::step, ::step].astype(np.float32)
                seen = np.minimum(seen / (_STRONG * max(float(np.median(seen[mask])), 1.0)), 1.0)
                found[k] = seen - seen[mask].mean()
        out.append(found)
    return tuple(out)


def colour_sums(
    vertices: ArrayLike,
    faces: NDArray[np.int32],
    part: NDArray[np.uint8],
    masks: PreparedMasks,
    codes: NDArray[np.uint16],
    table: NDArray[np.float32],
    limb: NDArray[np.uint8] | None = None,
    edges: tuple[NDArray[np.float32], ...] | None = None,
) -> tuple[Array, Array]:
    """Sum over each view how well the colours fit posed bodies, and how strong the edges along their limbs are.

    vertices: (N, V, 3) m.
    faces, part: (F, 3), and (F,) part of each.
    masks: masks of the frame.
    codes: (C, h, w) colour of each pixel.
    table: (C, P, K) value by part and colour.
    limb: (F,) limb of each face; None: one limb.
    edges: strength of colour edges, as returned by `rim_edges`; None: zeros.
    Returns: (N, C) sums of the table over the pixels of the mask in which the body shows a part; (N, C) sums of the
        edges along the rims of limbs in front of others. 0 in views that are not usable. Of large masks only every
        second pixel or so is read.
    """
    v = plain(vertices, np.float64)
    out, rims = np.zeros((2, len(masks.usable), len(v)))
    use, f = np.flatnonzero(masks.usable), plain(faces, np.int32)
    label = part if limb is None else (part + _LIMB * limb).astype(np.uint8)
    edges = rim_edges(masks, None) if edges is None else edges

    def work(first: int, last: int) -> None:
        for k in use[first:last].tolist():
            w, h = masks.sizes[k].tolist()
            step = _step(masks.areas[k])
            mask, colour = (np.ascontiguousarray(a[k, :h:step, :w:step]) for a in (masks.masks, codes))
            projection = plain(masks.projections[k] / [[step], [step], [1]], np.float64)
            seen = np.einsum("nvc,rc->nrv", v, projection[:, :3]) + projection[:, 3:]
            inverse = inverse_depth(seen[:, 2])
            uv = np.ascontiguousarray(seen[:, :2] * inverse[:, None])
            _colour_sums(uv, inverse, f, label, mask, colour, table[k], edges[k], out[k], rims[k])
            out[k] *= step * step
            rims[k] *= step

    over_chunks(work, len(use), None)
    return out.T, rims.T


GAP = 0.04
"""m; a limb so far in front of another has a rim."""


@kernel
def _colour_sums(uv, inverse, faces, part, mask, codes, table, edges, out, rims):
    """Compute the sums of `colour_sums` for one view.

    uv, inverse: (N, 2, V) px and (N, V) 1/m of the vertices.
    part: (F,) _LIMB times the limb, plus the part.
    mask, codes: (h, w). table: (P, K). edges: (2, h, w).
    out, rims: (N,) get the sums.
    """
    h, w = mask.shape
    nearest, face, every = np.empty((h, w), np.float32), np.empty((h, w), np.int32), np.arange(faces.shape[0])
    for n in range(uv.shape[0]):
        nearest[:] = np.float32(0.0)
        face[:] = -1
        draw_nearest(uv[n, 0], uv[n, 1], inverse[n], faces, every, True, nearest, face)
        total, rim = 0.0, 0.0
        for r in range(h):
            for x in range(w):
                if face[r, x] < 0 or mask[r, x] == 0:
                    continue
                label = part[face[r, x]]
                total += table[label % _LIMB, codes[r, x]]
                for k in range(2):
                    s, y = r + k, x + 1 - k
                    if s < h and y < w and face[s, y] >= 0 and mask[s, y] != 0:
                        if label // _LIMB != part[face[s, y]] // _LIMB:
                            if abs(1.0 / nearest[r, x] - 1.0 / nearest[s, y]) > GAP:
                                rim += edges[k, r, x]
        out[n], rims[n] = total, rim
