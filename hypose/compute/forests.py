"""Forests of depth tests: the test, the arrays of a forest, and how its trees grow. forest_votes.py scans pictures with
them.

Depth is (h, w) uint16 in millimetres, 0 = hole, as sensors give it: tests compare whole millimetres, so that the same
picture gives the same result everywhere. A hole counts as far away (10 m), never as near. In kernels a picture is a
padded flat int16 array in millimetres whose holes and border are FAR_MM.
A test is (uy, ux, vy, vx, threshold) in millimetres: the clipped depth at the pixel + u minus that at the pixel + v
(the pixel itself where v = 0) goes left where it is below the threshold. An offset of m millimetres at depth d is
floor(m f / d + 0.5) pixels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.compiled import kernel

DepthImage = NDArray[np.uint16]
FAR_MM = 10000
"""Depth of a hole, of the outside of the picture, and of everything beyond, mm."""
UNCLIPPED_MM = 20000
"""Clipping distance that clips nothing, mm."""
MAX_NODES = 32766
"""Largest number of nodes of one tree: node numbers are 16-bit."""


class GrowingArrays(NamedTuple):
    """Arrays of a growing forest: nt trees of N nodes, S slots with T candidate tests per tree, C classes.

    test: (nt, N, 5) int16: uy, ux, vy, vx, threshold, mm.
    left: (nt, N) int16, left child or -1 (the right child is left + 1).
    seen: (nt, N, C) uint32, number of samples per class.
    level: (nt, N) uint8, depth of the node.
    slot: (nt, N) int16, slot of a leaf, or -1.
    size: (nt,) int32, number of nodes in use.
    free: (nt, S) int16, stack of unused slots.
    n_free: (nt,) int32, height of that stack.
    candidate: (nt, S, T, 5) int16, candidate tests.
    left_count: (nt, S, T, C) uint16, samples per class on the left side of each candidate.
    total: (nt, S, C) int32, samples per class in the slot.
    random: (nt,) uint64, state of each tree's random numbers.
    tally: (2,) int64, number of splits, and of leaves refused because no slot was free.
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


class PaddedDepth(NamedTuple):
    """Depth picture with a border of FAR_MM.

    flat: (n,) int16 mm, rows of the padded picture, one after the other.
    width: width of the padded picture, px.
    border: px on each side.
    rows, columns: size of the picture without border, px.
    focal: focal length, px.
    near_mm, reach_mm: tests of up to reach_mm may be read at pixels that are not nearer than near_mm.
    """

    flat: NDArray[np.int16]
    width: int
    border: int
    rows: int
    columns: int
    focal: float
    near_mm: int
    reach_mm: int

    def cells(self, rows: ArrayLike, columns: ArrayLike) -> NDArray[np.int64]:
        """Compute the indices (S,) in `flat` of pixels (rows (S,), columns (S,))."""
        r, c = np.asarray(rows, dtype=np.int64), np.asarray(columns, dtype=np.int64)
        return (r + self.border) * self.width + c + self.border


def pad_depth(
    depth: DepthImage, focal: float, near_mm: int, reach_mm: int, reuse: PaddedDepth | None = None
) -> PaddedDepth:
    """Pad a depth picture (h, w) uint16 mm with a border of FAR_MM; holes and far depths become FAR_MM too.

    focal: focal length, px.
    near_mm, reach_mm: the border is wide enough for tests of reach_mm at the depth near_mm.
    reuse: padded picture whose memory is overwritten where it has the same shape and border.
    """
    border = math.ceil(reach_mm * focal / near_mm) + 2
    h, w = depth.shape
    about = w + 2 * border, border, h, w
    same = reuse is not None and reuse[1:5] == about
    flat = reuse.flat if same else np.full((h + 2 * border) * (w + 2 * border), FAR_MM, np.int16)
    inner = flat.reshape(-1, w + 2 * border)[border : border + h, border : border + w]
    inner[:] = np.where((depth == 0) | (depth > FAR_MM), np.uint16(FAR_MM), depth)
    return PaddedDepth(flat, *about, float(focal), int(near_mm), int(reach_mm))


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
    """Update a growing forest, in place, with samples of a picture, in their order.

    cells, labels: (S,) indices in the padded picture's `flat`, and their classes.
    arrays: the forest.
    clip_mm: depth difference at which tests are clipped, mm.
    rate: mean of the Poisson number of repeats of a sample.
    alpha, beta: number of samples before a split, and least information gain of a split, bits.
    deepest: number of levels below the root.
    spread_mm: range of the thresholds, mm.
    """
    limits = clip_mm, picture.reach_mm, spread_mm, rate, alpha, beta, deepest
    _grow(picture.flat, picture.width, cells, labels, picture.focal, picture.near_mm, *limits, arrays)


f4 = np.float32
u8 = np.uint64
i4 = np.int32
SHIFT = 4096  # makes the truncation of a negative number a floor
HALF = f4(4096.5)


@kernel(inline=True)
def response(flat, width, c, d, s, lo, hi, uy, ux, vy, vx):
    """Compute the response of a depth test: the difference of the depths, mm, at two pixels near cell c.

    flat, width: padded picture, and its width.
    c, d: index of the cell in flat, and its depth, mm.
    uy, ux, vy, vx: offsets of the two pixels, mm.
    s: focal length / d, px per mm.
    lo, hi: bounds to which depths are clipped.
    """
    y = i4(f4(uy) * s + HALF) - SHIFT
    x = i4(f4(ux) * s + HALF) - SHIFT
    a = i4(flat[u8(np.int64(c) + y * width + x)])
    a = min(max(a, lo), hi)
    b = d
    if vy != 0 or vx != 0:
        y = i4(f4(vy) * s + HALF) - SHIFT
        x = i4(f4(vx) * s + HALF) - SHIFT
        b = i4(flat[u8(np.int64(c) + y * width + x)])
        b = min(max(b, lo), hi)
    return a - b


@kernel(inline=True)
def _bits(state, t):
    """Draw 64 random bits of tree t by splitmix64 (Steele, Lea, Flood 2014); its state is one word, saved with the
    forest.
    """
    state[t] = state[t] + u8(0x9E3779B97F4A7C15)
    z = state[t]
    z = (z ^ (z >> u8(30))) * u8(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> u8(27))) * u8(0x94D049BB133111EB)
    return z ^ (z >> u8(31))


@kernel(inline=True)
def uniform(state, t):
    """Draw a random number in [0, 1) of tree t."""
    return np.float64(_bits(state, t) >> u8(11)) * (1.0 / 9007199254740992.0)


@kernel
def _poisson(state, t, rate):
    """Draw a Poisson number of mean `rate`, at most 100, of tree t."""
    k, p = 0, math.exp(-rate)
    total, u = p, uniform(state, t)
    while u > total and k < 100:
        k += 1
        p *= rate / k
        total += p
    return k


@kernel(inline=True)
def _offset(state, t, half):
    """Draw a whole number from -half to half, mm, of tree t."""
    return int(uniform(state, t) * (2 * half + 1)) - half


@kernel
def draw_test(state, t, half, spread, test):
    """Draw a random depth test (5,) into `test`. Its two offsets are uniform in a square; in half of the tests one
    offset is 0, the pixel itself.

    state, t: states of the random numbers, and the tree.
    half: largest offset, mm.
    spread: largest threshold, mm.
    The threshold is a product of two uniform numbers, so that small differences are the most frequent.
    """
    test[0], test[1] = _offset(state, t, half), _offset(state, t, half)
    if uniform(state, t) < 0.5:
        test[2], test[3] = _offset(state, t, half), _offset(state, t, half)
    else:
        test[2], test[3] = 0, 0
    test[4] = int((2 * uniform(state, t) - 1) * spread * uniform(state, t))


@kernel
def _entropy(counts, n):
    """Compute the entropy in bits of counts (C,) with the sum n; 0 for n = 0."""
    h = 0.0
    if n > 0:
        for c in range(counts.shape[0]):
            p = counts[c] / n
            if p > 0:
                h -= p * math.log2(p)
    return h


@kernel
def best_test(left, total, side):
    """Find the candidate test of largest information gain (Alcoverro 2014, eq. 3.2).

    left: (T, C) counts of the left side per candidate.
    total: (C,) counts of both sides.
    side: (2, C), scratch.
    Returns: (index, gain in bits); index -1 where no candidate gains.
    Deviation: the entropy before the split is added, which eq. 3.2 omits, so that beta of Algorithm 6 is a gain.
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
    """Give leaf n of tree t a free slot with new candidates; return the slot, or -1 where none is free.

    g: GrowingArrays, changed in place.
    half, spread: reach of the tests and range of the thresholds, mm.
    """
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
    """Take the slot from leaf n of tree t, and mark it as free; g: GrowingArrays, changed in place."""
    g.slot[t, n] = -1
    g.free[t, g.n_free[t]] = slot
    g.n_free[t] += 1


@kernel
def _split(g, t, n, slot, q):
    """Make the winning candidate the test of a node; the children start with the class counts of their side.

    g: GrowingArrays, changed in place.
    t, n: tree and node.
    slot: slot of the node; it is free afterwards.
    q: index of the winning candidate in the slot.
    """
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
    """Update a growing forest with samples by Algorithm 6 (Alcoverro 2014).

    flat, width: padded picture, and its width.
    cells: (S,) i8 of the flat padded picture.
    labels: (S,) i4 classes.
    focal: focal length, px.
    near: nearest depth of a sample, mm; nearer ones are omitted, and those without depth.
    clip, half, spread: clipping distance of depths, reach of the tests, range of the thresholds, mm.
    rate, alpha, beta, deepest: as in `gestures.forest.ForestSettings`.
    g: GrowingArrays, changed in place.
    Deviations: a leaf gets candidates only after two samples of each of two classes, and counts |S_j| from then on. A
    slot without a gainful test after 3 alpha samples is returned and drawn again. The Poisson number of repeats is
    added at once, so that a split waits for all of them. The numbers of nodes and of leaves with candidates are
    bounded, which bounds the memory.
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
