"""Forests of depth tests: the test itself, the arrays they live in, and how trees grow. forest_votes.py: how a picture
is looked at with them.

Depth here is (h, w) uint16 in millimetres, 0 = hole, as sensors give it: tests compare whole millimetres, so that the
same picture gives the same answer everywhere. A hole counts as far away (10 m), never as near.
In kernels a picture is a padded flat int16 array in millimetres whose holes and border are FAR_MM. A test is (uy, ux,
vy, vx, threshold) in millimetres: the clipped depth at the pixel + u minus that at the pixel + v (the pixel itself when
v = 0) goes left when it is below the threshold. An offset of m millimetres at depth d is floor(m f / d + 0.5) pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.compiled import kernel

DepthImage = NDArray[np.uint16]
FAR_MM = 10000
"""What a hole, the outside of the picture and everything beyond counts as."""
UNCLIPPED_MM = 20000
"""A clipping distance that clips nothing."""
MAX_NODES = 32766
"""Of one tree: node numbers are 16-bit."""


class GrowingArrays(NamedTuple):
    """A forest that grows: nt trees of N nodes, S slots with T candidate tests per tree, C classes.

    test (nt, N, 5) i2: uy, ux, vy, vx, threshold in mm.
    left (nt, N) i2:.
    left child or -1 (right = left + 1).
    seen (nt, N, C) u4: samples seen.
    level (nt, N) u1: depth of the node.
    slot (nt, N) i2 or -1.
    size (nt,) i4: nodes in use.
    free (nt, S) i2 and n_free (nt,) i4: stack of unused slots.
    candidate (nt, S, T, 5) i2.
    left_count (nt, S, T, C) u2.
    total (nt, S, C) i4.
    random (nt,) u8: state of each tree's random numbers.
    tally (2,) i8: splits, refusals for want of a slot.
    """

    test: NDArray[np.int16]
    left: NDArray[np.int16]
    seen: NDArray[np.uint32]
    level: NDArray[np.uint8]
    slot: NDArray[np.int16]
    size: NDArray[np.int32]
    free: NDArray[np.int16]
    n_free: NDArray[np.int32]
    candidate: NDArray[np.int16]
    left_count: NDArray[np.uint16]
    total: NDArray[np.int32]
    random: NDArray[np.uint64]
    tally: NDArray[np.int64]


@dataclass(frozen=True)
class PaddedDepth:
    """A depth picture with a border of FAR_MM.

    values (h + 2 border, w + 2 border) i2.
    focal length px; tests of up to reach_mm may be read at pixels not nearer than near_mm.
    """

    values: NDArray[np.int16]
    border: int
    focal: float
    near_mm: int
    reach_mm: int

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the picture."""
        return self.values.shape[0] - 2 * self.border, self.values.shape[1] - 2 * self.border

    @property
    def flat(self) -> NDArray[np.int16]:
        """values as one row."""
        return self.values.reshape(-1)

    @property
    def width(self) -> int:
        """Of the padded picture."""
        return self.values.shape[1]

    def cells(self, rows: ArrayLike, columns: ArrayLike) -> NDArray[np.int64]:
        """Places in `flat` of the pixels (rows (S,), columns (S,))."""
        r, c = np.asarray(rows, dtype=np.int64), np.asarray(columns, dtype=np.int64)
        return (r + self.border) * self.width + c + self.border


def pad_depth(
    depth: DepthImage, focal: float, near_mm: int, reach_mm: int, reuse: PaddedDepth | None = None
) -> PaddedDepth:
    """Return the padded picture; written into `reuse` when that has the same shape and border."""
    border = math.ceil(reach_mm * focal / near_mm) + 2
    h, w = depth.shape
    shape = (h + 2 * border, w + 2 * border)
    if reuse is not None and reuse.values.shape == shape and reuse.border == border:
        values = reuse.values
    else:
        values = np.full(shape, FAR_MM, np.int16)
    _pad(np.require(depth, np.uint16, ["C", "W", "A"]), border, values)
    return PaddedDepth(values, border, float(focal), int(near_mm), int(reach_mm))


def grow(
    picture: PaddedDepth,
    cells: NDArray[np.int64],
    labels: NDArray[np.int32],
    arrays: GrowingArrays,
    *,
    clip_mm: int,
    spread_mm: int,
    rate: float,
    alpha: int,
    beta: float,
    deepest: int,
) -> None:
    """Update a growing forest, in place, with the samples at `cells` (S,) of classes `labels` (S,), in their order."""
    _grow(
        picture.flat,
        picture.width,
        cells,
        labels,
        picture.focal,
        picture.near_mm,
        clip_mm,
        picture.reach_mm,
        spread_mm,
        rate,
        alpha,
        beta,
        deepest,
        arrays,
    )


def cut_patches(picture: PaddedDepth, cells: NDArray[np.int64], step_mm: int) -> NDArray[np.int16]:
    """Return (S, P, P) depth relative to the centre's, mm, every step_mm over the square that tests may reach."""
    side = 2 * (picture.reach_mm // step_mm) + 1
    out = np.empty((len(cells), side, side), np.int16)
    _cut_patches(picture.flat, picture.width, cells, picture.focal, step_mm, out)
    return out


class TreeArraysOffline(NamedTuple):
    """One tree of `grow_tree`: test (N, 5) i2 (patch row and column of u and of v, threshold mm), left (N,) i2, seen
    (N, C) u4, level (N,) u1."""

    test: NDArray[np.int16]
    left: NDArray[np.int16]
    seen: NDArray[np.uint32]
    level: NDArray[np.uint8]


def grow_tree(
    patches: NDArray[np.int16],
    labels: NDArray[np.int8],
    order: NDArray[np.int64],
    classes: int,
    rng: np.random.Generator,
    *,
    deepest: int,
    tests: int,
    thresholds: int,
    clip_mm: int,
    sample: int,
    fewest: int = 4,
) -> TreeArraysOffline:
    """Return one tree from the patches named in `order` (with repetitions), by information gain (eq. 3.2)."""
    room = min(MAX_NODES, 2 * len(order) + 1)
    tree = TreeArraysOffline(
        np.zeros((room, 5), np.int16),
        np.full(room, -1, np.int16),
        np.zeros((room, classes), np.uint32),
        np.zeros(room, np.uint8),
    )
    state = rng.integers(0, 2**63, 1).astype(np.uint64)
    n = _grow_tree(
        patches,
        labels,
        order.copy(),
        deepest,
        tests,
        thresholds,
        clip_mm,
        sample,
        fewest,
        state,
        *tree,
    )
    return TreeArraysOffline(*(a[:n].copy() for a in tree))


def patch_leaves(patches: NDArray[np.int16], tree: TreeArraysOffline, clip_mm: int) -> NDArray[np.int32]:
    """Return (S,) the leaf that each patch reaches."""
    out = np.empty(len(patches), np.int32)
    _patch_leaves(patches, clip_mm, tree.test, tree.left, out)
    return out


f4 = np.float32
u8 = np.uint64
i4 = np.int32
_SHIFT = 4096  # makes the truncation of a negative number a floor
_HALF = f4(4096.5)


@kernel
def _pad(depth, border, out):
    """out (h + 2 border, w + 2 border) i2 = depth (h, w) u2 mm inside, holes and depths beyond FAR as FAR_MM."""
    for y in range(depth.shape[0]):
        line, made = depth[y], out[y + border]
        for x in range(depth.shape[1]):
            v = line[x]
            made[x + border] = FAR_MM if v == 0 or v > FAR_MM else v


@kernel(inline=True)
def response(flat, width, c, d, s, lo, hi, uy, ux, vy, vx):
    """What the test of (uy, ux) against (vy, vx) mm reads at cell c of depth d, with s = focal length / d and depths
    clipped to lo..hi."""
    y = i4(f4(uy) * s + _HALF) - _SHIFT
    x = i4(f4(ux) * s + _HALF) - _SHIFT
    a = i4(flat[u8(np.int64(c) + y * width + x)])
    a = min(max(a, lo), hi)
    b = d
    if vy != 0 or vx != 0:
        y = i4(f4(vy) * s + _HALF) - _SHIFT
        x = i4(f4(vx) * s + _HALF) - _SHIFT
        b = i4(flat[u8(np.int64(c) + y * width + x)])
        b = min(max(b, lo), hi)
    return a - b


@kernel(inline=True)
def _bits(state, t):
    """splitmix64 (Steele, Lea, Flood 2014): 64 random bits of tree t; its state is one word, saved with the forest."""
    state[t] = state[t] + u8(0x9E3779B97F4A7C15)
    z = state[t]
    z = (z ^ (z >> u8(30))) * u8(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> u8(27))) * u8(0x94D049BB133111EB)
    return z ^ (z >> u8(31))


@kernel(inline=True)
def _uniform(state, t):
    return np.float64(_bits(state, t) >> u8(11)) * (1.0 / 9007199254740992.0)


@kernel
def _poisson(state, t, rate):
    k, p = 0, math.exp(-rate)
    total, u = p, _uniform(state, t)
    while u > total and k < 100:
        k += 1
        p *= rate / k
        total += p
    return k


@kernel(inline=True)
def _offset(state, t, half):
    return int(_uniform(state, t) * (2 * half + 1)) - half


@kernel
def draw_test(state, t, half, spread, test):
    """A random test (5,): offsets uniform in the square, half of them against the pixel itself; the threshold is a
    product of two uniform numbers, so that small differences are the most frequent."""
    test[0], test[1] = _offset(state, t, half), _offset(state, t, half)
    if _uniform(state, t) < 0.5:
        test[2], test[3] = _offset(state, t, half), _offset(state, t, half)
    else:
        test[2], test[3] = 0, 0
    test[4] = int((2 * _uniform(state, t) - 1) * spread * _uniform(state, t))


@kernel
def _entropy(counts, n):
    h = 0.0
    if n > 0:
        for c in range(counts.shape[0]):
            p = counts[c] / n
            if p > 0:
                h -= p * math.log2(p)
    return h


@kernel
def best_test(left, total, side):
    """(index, gain) of the candidate of largest information gain (eq. 3.2), in bits; -1 where none gains anything.

    left (T, C): counts of the left side per candidate.
    total (C,).
    side (2, C) is scratch.

    Deviation: the entropy before the split is added, which eq. 3.2 leaves out, so that beta of Algorithm 6 is a gain.
    """
    n = 0
    for c in range(total.shape[0]):
        n += total[c]
    whole = _entropy(total, n)
    best, gain = -1, 0.0
    for q in range(left.shape[0]):
        nl = 0
        for c in range(total.shape[0]):
            side[0, c], side[1, c] = left[q, c], total[c] - left[q, c]
            nl += left[q, c]
        if nl == 0 or nl == n:
            continue
        g = whole - (nl * _entropy(side[0], nl) + (n - nl) * _entropy(side[1], n - nl)) / n
        if g > gain:
            best, gain = q, g
    return best, gain


@kernel
def _open(g, t, n, half, spread):
    """A free slot with fresh candidates for leaf n of tree t; -1 when the pool is empty."""
    if g.n_free[t] == 0:
        g.tally[1] += 1
        return -1
    g.n_free[t] -= 1
    slot = g.free[t, g.n_free[t]]
    g.slot[t, n] = slot
    for q in range(g.candidate.shape[2]):
        draw_test(g.random, t, half, spread, g.candidate[t, slot, q])
    g.left_count[t, slot] = 0
    g.total[t, slot] = 0
    return slot


@kernel
def _close(g, t, n, slot):
    g.slot[t, n] = -1
    g.free[t, g.n_free[t]] = slot
    g.n_free[t] += 1


@kernel
def _split(g, t, n, slot, q):
    """Make the winning candidate the node's test; the children start with the class counts of their side."""
    a = g.size[t]
    g.size[t] += 2
    g.left[t, n] = a
    g.test[t, n] = g.candidate[t, slot, q]
    for c in range(g.seen.shape[2]):
        lower = g.left_count[t, slot, q, c]
        g.seen[t, a, c] = lower
        g.seen[t, a + 1, c] = g.total[t, slot, c] - lower
    for k in range(2):
        g.level[t, a + k] = g.level[t, n] + 1
        g.slot[t, a + k] = -1
        g.left[t, a + k] = -1
    _close(g, t, n, slot)
    g.tally[0] += 1


@kernel
def _grow(flat, width, cells, labels, focal, near, clip, half, spread, rate, alpha, beta, deepest, g):
    """Algorithm 6 for samples: cells (S,) i8 of the flat padded picture, labels (S,) i4 class. g: GrowingArrays.

    Deviation: a leaf gets candidates only once it has seen two samples of each of two classes, and counts |S_j| from
    then on. Deviation: a slot that has seen 3 alpha samples without a gainful test is given back and drawn again.
    Deviation: the Poisson number of repeats is added at once, so that a split waits for all of them. Deviation: the
    numbers of nodes and of leaves with candidates are bounded, which bounds the memory.
    """
    trees, classes = g.left.shape[0], g.seen.shape[2]
    side = np.empty((2, classes), np.int64)
    for i in range(cells.shape[0]):
        c = u8(cells[i])
        d = i4(flat[c])
        if d < near or d >= FAR_MM:
            continue
        s, lo, hi, y = f4(focal / d), d - clip, d + clip, labels[i]
        for t in range(trees):
            k = _poisson(g.random, t, rate)
            if k == 0:
                continue
            n = 0
            while g.left[t, n] >= 0:
                e = g.test[t, n]
                f = response(flat, width, c, d, s, lo, hi, e[0], e[1], e[2], e[3])
                n = g.left[t, n] + (0 if f < e[4] else 1)
            g.seen[t, n, y] += k
            if g.level[t, n] >= deepest:
                continue
            slot = g.slot[t, n]
            if slot < 0:
                seen = 0
                for j in range(classes):
                    seen += 1 if g.seen[t, n, j] >= 2 else 0
                if seen < 2:
                    continue
                slot = _open(g, t, n, half, spread)
                if slot < 0:
                    continue
            g.total[t, slot, y] += k
            for q in range(g.candidate.shape[2]):
                e = g.candidate[t, slot, q]
                if response(flat, width, c, d, s, lo, hi, e[0], e[1], e[2], e[3]) < e[4]:
                    g.left_count[t, slot, q, y] += k
            seen = 0
            for j in range(classes):
                seen += g.total[t, slot, j]
            if seen <= alpha or g.size[t] + 2 > g.left.shape[1]:
                if seen > 3 * alpha:
                    _close(g, t, n, slot)
                continue
            best, gain = best_test(g.left_count[t, slot], g.total[t, slot], side)
            if best >= 0 and gain > beta:
                _split(g, t, n, slot, best)
            elif seen > 3 * alpha:
                _close(g, t, n, slot)


@kernel
def _cut_patches(flat, width, cells, focal, step, out):
    """out (S, P, P) i2: depth minus the centre's at multiples of `step` mm around each cell: what tests at those
    offsets would read."""
    side = out.shape[1]
    for i in range(cells.shape[0]):
        c = cells[i]
        d = i4(flat[c])
        s = f4(focal / d)
        for a in range(side):
            y = i4(f4((a - side // 2) * step) * s + _HALF) - _SHIFT
            for b in range(side):
                x = i4(f4((b - side // 2) * step) * s + _HALF) - _SHIFT
                out[i, a, b] = flat[c + y * width + x] - d


@kernel
def _patch_response(patch, clip, e):
    a = min(max(i4(patch[e[0], e[1]]), -clip), clip)
    return a - min(max(i4(patch[e[2], e[3]]), -clip), clip)


@kernel
def _grow_tree(
    patches, labels, order, deepest, tests, thresholds, clip, sample, fewest, state, test, left, count, level
):
    """One tree from all samples at once: at every node `tests` random pairs of patch pixels with `thresholds` cuts
    each, drawn evenly from the range of what the node's samples read there; judged on at most `sample` samples.

    order (n,) i8 is permuted.
    test (N, 5) i2: patch indices and threshold.
    left (N,) i2.
    count (N, C) u4.

    Returns the number of nodes.
    """
    classes, side = count.shape[1], patches.shape[1]
    stack = np.empty((2 * deepest + 8, 3), np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, order.shape[0], 0
    waiting, nodes = 1, 1
    level[0] = 0
    pairs, cuts = np.empty((tests, 4), np.int64), np.empty((tests, thresholds), np.int64)
    most = min(sample, order.shape[0])
    read, who = np.empty((tests, most), np.int32), np.empty(most, np.int8)
    lefts, total = np.empty((tests * thresholds, classes), np.int64), np.empty(classes, np.int64)
    sides = np.empty((2, classes), np.int64)
    while waiting > 0:
        waiting -= 1
        a, b, node = stack[waiting, 0], stack[waiting, 1], stack[waiting, 2]
        n = b - a
        count[node] = 0
        for i in range(a, b):
            count[node, labels[order[i]]] += 1
        left[node] = -1
        present = 0
        for c in range(classes):
            present += 1 if count[node, c] > 0 else 0
        if level[node] >= deepest or n < fewest or present < 2 or nodes + 2 > left.shape[0]:
            continue
        for q in range(tests):
            for k in range(4):
                pairs[q, k] = int(_uniform(state, 0) * side)
            if _uniform(state, 0) < 0.5:
                pairs[q, 2], pairs[q, 3] = side // 2, side // 2
        total[:] = 0
        m = min(n, sample)
        for i in range(m):
            j = order[a + i] if m == n else order[a + int(_uniform(state, 0) * n)]
            who[i] = labels[j]
            total[who[i]] += 1
            for q in range(tests):
                read[q, i] = _patch_response(patches[j], clip, pairs[q])
        lefts[:] = 0
        for q in range(tests):
            low, high = read[q, :m].min(), read[q, :m].max()
            for k in range(thresholds):
                cuts[q, k] = low + 1 + int(_uniform(state, 0) * (high - low))
                for i in range(m):
                    lefts[q * thresholds + k, who[i]] += 1 if read[q, i] < cuts[q, k] else 0
        best, gain = best_test(lefts, total, sides)
        if best < 0 or gain < 1e-6:
            continue
        q, cut = best // thresholds, cuts[best // thresholds, best % thresholds]
        i, j = a, b
        while i < j:
            if _patch_response(patches[order[i]], clip, pairs[q]) < cut:
                i += 1
            else:
                j -= 1
                swap = order[i]
                order[i] = order[j]
                order[j] = swap
        if i == a or i == b:
            continue
        for k in range(4):
            test[node, k] = pairs[q, k]
        test[node, 4] = cut
        left[node] = nodes
        level[nodes], level[nodes + 1] = level[node] + 1, level[node] + 1
        stack[waiting, 0], stack[waiting, 1], stack[waiting, 2] = a, i, nodes
        stack[waiting + 1, 0], stack[waiting + 1, 1], stack[waiting + 1, 2] = i, b, nodes + 1
        waiting += 2
        nodes += 2
    return nodes


@kernel
def _patch_leaves(patches, clip, test, left, out):
    """out (S,) i4: the leaf of a tree of `_grow_tree` that each patch reaches."""
    for i in range(patches.shape[0]):
        n = 0
        while left[n] >= 0:
            n = left[n] + (0 if _patch_response(patches[i], clip, test[n]) < test[n, 4] else 1)
        out[i] = n
