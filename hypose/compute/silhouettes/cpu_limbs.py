"""numba: which of many poses of a limb are no worse than the first one, drawing the others in as few views as tell.

Before any of it is drawn a limb cannot explain more of a mask than what is uncovered in its window.
"""

from __future__ import annotations

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.silhouettes.cpu_lanes import camera_lanes, lane_windows, silhouette_xor, skin_lanes
from hypose.compute.silhouettes.cpu_vectors import LANES, project_vertices

CELL = 8
"""rows that are counted together, and columns: those of a byte"""

u1 = np.uint8


@kernel
def uncovered(prepared, drawn, cells):
    """cells (C, R + 1, B + 1) i4, zero: sums over the cells above and to the left of the masks' pixels that are not
    drawn (C, h, B), both packed."""
    for c in range(prepared.bits.shape[0]):
        if not prepared.usable[c]:
            continue
        total = cells[c]
        for r in range(prepared.bits.shape[1]):
            mask, other, line = prepared.bits[c, r], drawn[c, r], total[r // CELL + 1, 1:]
            for b in range(mask.shape[0]):
                x = mask[b] & u1(~other[b])
                x = u1(x - ((x >> 1) & 0x55))
                x = u1((x & 0x33) + ((x >> 2) & 0x33))
                line[b] += (x + (x >> 4)) & 0x0F
        for r in range(1, total.shape[0]):
            along = np.int32(0)
            for b in range(1, total.shape[1]):
                along += total[r, b]
                total[r, b] = total[r - 1, b] + along


@kernel
def least_energies(poses, first, last, tree, mesh, turning, prepared, boxes, drawn_counts, cells, scratch, out):
    """Blocks first..last (of LANES poses) of out (N, C): no view costs less; cells as `uncovered` makes them, the other
    arguments as for cpu_lanes.silhouette_xor, which has placed the joints that are not turning."""
    frames, centres, axis, turn, maps, points, u, v, p, bounds, window, origin = scratch[:12]
    for block in range(first, last):
        begin = block * LANES
        lanes = min(LANES, poses.shape[0] - begin)
        skin_lanes(poses, begin, tree, mesh, turning, frames, centres, axis, turn, maps, points)
        for c in range(prepared.bits.shape[0]):
            if not prepared.usable[c]:
                continue
            camera_lanes(prepared.projections[c], poses, begin, p)
            project_vertices(points, p, u, v, bounds)
            lane_windows(bounds, boxes[c], lanes, window, origin)
            sums = cells[c]
            for k in range(lanes):
                left, top = origin[k, 0] // CELL, origin[k, 1] // CELL
                right = (origin[k, 0] + origin[k, 2] + CELL - 1) // CELL
                bottom = (origin[k, 1] + origin[k, 3] + CELL - 1) // CELL
                open_pixels = sums[bottom, right] - sums[bottom, left] - sums[top, right] + sums[top, left]
                worst = drawn_counts[c, 0] + prepared.areas[c] - 2 * drawn_counts[c, 1]
                out[begin + k, c] = (worst - open_pixels) / prepared.norm[c]


@kernel
def view_that_tells(cells, norm, left):
    """The view among those left (C,) bool in which most is uncovered; -1 when none is left."""
    best, found = -1.0, -1
    for c in range(norm.shape[0]):
        if left[c] and cells[c, -1, -1] / norm[c] > best:
            best, found = cells[c, -1, -1] / norm[c], c
    return found


@kernel
def limb_energies(
    poses, slack, more, tree, mesh, turning, prepared, boxes, drawn, drawn_counts, cells, scratch, counts, told
):
    """counts (N, C, 3), zero, as of silhouette_xor, and told (N,), False: whether they are those of all views, as of
    the first poses and of all that cost at most `slack` times as much as the first one, and `more`. cells: zero; other
    arguments as for silhouette_xor."""
    n, views, n_dof = poses.shape[0], prepared.bits.shape[0], poses.shape[1]
    norm, left, limit, view = prepared.norm, prepared.usable.copy(), more + 1e-9 * abs(more), -1
    alive, n_alive = np.arange(n), min(n, LANES)  # the first block is as much work as the first pose alone
    least, total, only, anew = np.zeros((n, views)), np.zeros(n), prepared.usable, mesh.needed
    while True:
        tried, out = np.empty((n_alive, n_dof)), np.zeros((n_alive, views, 3), np.int64)
        for i in range(n_alive):
            for d in range(n_dof):
                tried[i, d] = poses[alive[i], d]
        blocks = (n_alive + LANES - 1) // LANES
        silhouette_xor(
            *(tried, 0, blocks, tree, mesh, anew, turning),
            *(prepared, only, boxes, prepared.areas, drawn, drawn_counts, scratch, out),
        )
        kept = 0
        for i in range(n_alive):
            a = alive[i]
            for c in range(views):
                if only[c]:
                    for k in range(3):
                        counts[a, c, k] = out[i, c, k]
                    if view >= 0:
                        total[a] += out[i, c, 0] / norm[c] - least[a, c]
                    elif a == 0:
                        limit += out[i, c, 0] / norm[c] * slack * (1 + 1e-9)  # sums may round otherwise
            told[a] = view < 0
            alive[kept] = a
            kept += total[a] <= limit
        n_alive = kept
        if view < 0:
            uncovered(prepared, drawn, cells)
            blocks = (n + LANES - 1) // LANES
            least_energies(poses, 1, blocks, tree, mesh, turning, prepared, boxes, drawn_counts, cells, scratch, least)
            n_alive = 0
            for a in range(min(n, LANES), n):
                for c in range(views):
                    total[a] += least[a, c]
                alive[n_alive] = a
                n_alive += total[a] <= limit
        view = view_that_tells(cells, norm, left) if n_alive > 0 else -1
        if view < 0:
            break
        only = np.zeros(views, np.bool_)
        only[view] = True
        left[view] = False
        anew = turning
    for i in range(n_alive):
        told[alive[i]] = True
