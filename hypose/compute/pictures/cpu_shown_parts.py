"""numba: which part of a body is in front in each pixel, and what its colours say (shown_parts.py)."""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.compiled import kernel

NEAR = 0.05
"""Triangles with a corner nearer than this (m) are not drawn."""

LIMB = 32
"""Labels of one limb; there are at most so many parts."""
GAP = 0.04
"""m: who lies so far before another has a rim."""


@kernel
def draw_front(vertices, faces, part, projection, depth, shown, box):
    """Write part + 1 of the face (F,) in front into shown (h, w), where it covers a pixel's centre and is seen from
    outside; vertices (V, 3), projection (3, 4). depth (h, w) holds 1 / z, 0 where nothing is. box (4,): rows, columns
    that were drawn on, half open."""
    h, w = shown.shape
    box[0], box[1], box[2], box[3] = h, 0, w, 0
    n = vertices.shape[0]
    u, v, inverse = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        far = projection[2, 0] * x + projection[2, 1] * y + projection[2, 2] * z + projection[2, 3]
        if far < NEAR:
            inverse[i] = 0.0
            continue
        inverse[i] = 1.0 / far
        u[i] = (projection[0, 0] * x + projection[0, 1] * y + projection[0, 2] * z + projection[0, 3]) * inverse[i]
        v[i] = (projection[1, 0] * x + projection[1, 1] * y + projection[1, 2] * z + projection[1, 3]) * inverse[i]
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if inverse[a] == 0.0 or inverse[b] == 0.0 or inverse[c] == 0.0:
            continue
        area = (u[b] - u[a]) * (v[c] - v[a]) - (u[c] - u[a]) * (v[b] - v[a])
        if area >= 0.0:  # y points down: what is counter-clockwise from outside has negative area when seen from there
            continue
        r0 = max(0, int(math.ceil(max(min(v[a], v[b], v[c]), -1.0))))
        r1 = min(h - 1, int(math.floor(min(max(v[a], v[b], v[c]), h + 1.0))))
        c0 = max(0, int(math.ceil(max(min(u[a], u[b], u[c]), -1.0))))
        c1 = min(w - 1, int(math.floor(min(max(u[a], u[b], u[c]), w + 1.0))))
        if r0 > r1 or c0 > c1:
            continue
        box[0], box[1] = min(box[0], r0), max(box[1], r1 + 1)
        box[2], box[3] = min(box[2], c0), max(box[3], c1 + 1)
        share = 1.0 / area
        along, across = (v[c] - v[a]) * share, -(v[b] - v[a]) * share
        for r in range(r0, r1 + 1):
            s = ((c0 - u[a]) * (v[c] - v[a]) - (u[c] - u[a]) * (r - v[a])) * share
            t = ((u[b] - u[a]) * (r - v[a]) - (c0 - u[a]) * (v[b] - v[a])) * share
            for x in range(c0, c1 + 1):
                if s >= 0.0 and t >= 0.0 and s + t <= 1.0:
                    near = np.float32(inverse[a] + s * (inverse[b] - inverse[a]) + t * (inverse[c] - inverse[a]))
                    if near > depth[r, x]:
                        depth[r, x] = near
                        shown[r, x] = part[f] + 1
                s += along
                t += across


@kernel
def clear(depth, box):
    """depth (h, w) as it was before anything was drawn."""
    depth[box[0] : max(box[0], box[1]), box[2] : max(box[2], box[3])] = np.float32(0.0)


@kernel
def _rim(shown, mask, depth, r, x, s, y):
    """Whether two neighbouring pixels show different limbs, one before the other."""
    if shown[s, y] == 0 or mask[s, y] == 0 or (shown[r, x] - 1) // LIMB == (shown[s, y] - 1) // LIMB:
        return False
    return abs(1.0 / depth[r, x] - 1.0 / depth[s, y]) > GAP


@kernel
def colour_sums(vertices, faces, part, projection, mask, codes, table, edges, depth, shown, out, rims):
    """out (N,): sum of table (P, K), by part and colour, over the pixels of the mask (h, w) that show a part of a body
    with vertices (N, V, 3); rims (N,): sum of edges (2, h, w) where one limb begins before another. part (F,): LIMB
    times the limb, and the part. depth, shown: empty, and empty again afterwards."""
    box = np.empty(4, np.int64)
    for n in range(vertices.shape[0]):
        draw_front(vertices[n], faces, part, projection, depth, shown, box)
        total, rim = 0.0, 0.0
        for r in range(box[0], box[1]):
            for x in range(box[2], box[3]):
                if shown[r, x] > 0 and mask[r, x] != 0:
                    label = shown[r, x] - 1
                    total += table[label % LIMB, codes[r, x]]
                    if x + 1 < box[3] and _rim(shown, mask, depth, r, x, r, x + 1):
                        rim += edges[0, r, x]
                    if r + 1 < box[1] and _rim(shown, mask, depth, r, x, r + 1, x):
                        rim += edges[1, r, x]
                shown[r, x] = 0
                depth[r, x] = np.float32(0.0)
        out[n], rims[n] = total, rim
