"""Scan depth pictures with forests of depth tests (forests.py), with early rejection, and compute the density of the
votes.

A grid cell (i, j) of stride n stands for pixel (i n + n // 2, j n + n // 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hypose.compute.compiled import kernel
from hypose.compute.forests import FAR_MM, PaddedDepth, f4, i4, response, u8

PROBABILITY = 10000
"""Probabilities are whole multiples of 1 / PROBABILITY."""


@kernel
def _pack(test, left, count, size, records, shares):
    """Write the scanning layout of trees; probabilities in ten-thousandths, and a node without samples is background.

    records: (trees, N, 8) i2 gets test, left child, share of class 1, 0.
    shares: (trees, N, C) u2 gets the shares of all classes.
    """
    classes = count.shape[2]
    for t in range(left.shape[0]):
        for n in range(size[t]):
            total = np.float64(0.0)
            for c in range(classes):
                total += count[t, n, c]
            for j in range(5):
                records[t, n, j] = test[t, n, j]
            records[t, n, 5] = left[t, n]
            for c in range(classes):
                p = count[t, n, c] / total if total > 0 else (1.0 if c == 0 else 0.0)
                shares[t, n, c] = int(p * PROBABILITY + 0.5)
            records[t, n, 6] = shares[t, n, 1]


@kernel(inline=True)
def _leaf(flat, width, c, d, s, lo, hi, records, base):
    n = base
    while True:
        child = records[n, u8(5)]
        if child < 0:
            return n
        f = response(
            flat, width, c, d, s, lo, hi, records[n, u8(0)], records[n, u8(1)], records[n, u8(2)], records[n, u8(3)]
        )
        n = base + u8(child) + u8(0 if f < records[n, u8(4)] else 1)


@kernel
def _leaves(flat, width, cells, focal, clip, records, trees, out):
    """Find the leaf that each cell of the padded picture reaches in each tree, into out (S, trees) i4."""
    nodes = u8(records.shape[0] // trees)
    for i in range(cells.shape[0]):
        c = u8(cells[i])
        d = i4(flat[c])
        s = f4(focal / d)
        for t in range(trees):
            base = u8(t) * nodes
            out[i, t] = _leaf(flat, width, c, d, s, d - clip, d + clip, records, base) - base


@kernel(inline=True)
def _place(raster, i, j, stride):
    """Return the index of grid cell (i, j) in the flat picture; -1 where it is outside or its depth is not within
    near..far.
    """
    y, x = i * stride + stride // 2, j * stride + stride // 2
    if y >= raster.rows or x >= raster.columns:
        return -1
    c = (y + raster.border) * raster.width + x + raster.border
    d = raster.flat[u8(c)]
    return c if raster.near <= d <= raster.far else -1


@kernel
def _coarse_pass(raster, records, table, first, least, stride, wanted):
    """Scan a coarse grid with the first trees only, and mark the cells worth a full scan.

    records: (R, 8) i2 of all forests.
    table: (G, 4) i8: first record, nodes per tree, trees, clipping distance.
    wanted: (ceil(rows / stride), ...) u4 gets bit g where the mean of forest g's first trees' shares, at the cell or at
        a neighbour, reaches `least`.
    """
    rows, columns = wanted.shape
    wanted[:] = 0
    for i in range(rows):
        for j in range(columns):
            c = _place(raster, i, j, stride)
            if c < 0:
                continue
            d = i4(raster.flat[u8(c)])
            s = f4(raster.focal / d)
            for g in range(table.shape[0]):
                base, nodes, trees, clip = u8(table[g, 0]), u8(table[g, 1]), min(first, table[g, 2]), i4(table[g, 3])
                a = 0
                for _ in range(trees):
                    a += records[
                        _leaf(raster.flat, raster.width, u8(c), d, s, d - clip, d + clip, records, base), u8(6)
                    ]
                    base += nodes
                if a >= least * PROBABILITY * trees:
                    for u in range(max(0, i - 1), min(rows, i + 2)):
                        for v in range(max(0, j - 1), min(columns, j + 2)):
                            wanted[u, v] |= np.uint32(1) << np.uint32(g)


@kernel
def _scan(raster, records, table, first, least, stride, wanted, ratio, out):
    """Compute the mean share of class 1 of each forest on the grid, into out (G, ceil(rows / stride), ...) f4.

    records, table: as in `_coarse_pass`.
    first, least: a cell is rejected where the mean over the first trees stays below `least`, or that over twice as many
        below 1.5 `least` (first = 0: no rejection).
    wanted, ratio: result of `_coarse_pass`, and grid cells per coarse cell (0: not used).

    It is 0 where there is no depth, where the forest's bit in wanted is not set, and where the cell is rejected.
    """
    rows, columns = out.shape[1:]
    limit1, limit2 = least * PROBABILITY * first, 1.5 * least * PROBABILITY * 2 * first
    out[:] = 0
    for i in range(rows):
        for j in range(columns):
            bits = wanted[i // ratio, j // ratio] if ratio > 0 else np.uint32(0xFFFFFFFF)
            if bits == 0:
                continue
            c = _place(raster, i, j, stride)
            if c < 0:
                continue
            d = i4(raster.flat[u8(c)])
            s = f4(raster.focal / d)
            for g in range(table.shape[0]):
                if (bits >> np.uint32(g)) & np.uint32(1) == 0:
                    continue
                base, nodes, trees, clip = u8(table[g, 0]), u8(table[g, 1]), table[g, 2], i4(table[g, 3])
                lo, hi, a = d - clip, d + clip, 0
                for t in range(trees):
                    a += records[_leaf(raster.flat, raster.width, u8(c), d, s, lo, hi, records, base), u8(6)]
                    base += nodes
                    if (t + 1 == first and a < limit1) or (t + 1 == 2 * first and a < limit2):
                        a = 0
                        break
                out[g, i, j] = a / f4(PROBABILITY * trees)


@kernel
def _scan_classes(raster, records, shares, trees, clip, first, least, stride, out):
    """Compute the mean share of the winning class, into out (C - 1, rows, columns) f4: where a gesture wins over the
    background and the other gestures, else 0.

    Cells are rejected early by the summed share of all gestures, as in `_scan`.
    """
    rows, columns = out.shape[1:]
    classes = shares.shape[1]
    nodes = u8(records.shape[0] // trees)
    limit1, limit2 = least * PROBABILITY * first, 1.5 * least * PROBABILITY * 2 * first
    sums, scale = np.empty(classes, np.int32), f4(1.0 / (PROBABILITY * trees))
    out[:] = 0
    for i in range(rows):
        for j in range(columns):
            c = _place(raster, i, j, stride)
            if c < 0:
                continue
            d = i4(raster.flat[u8(c)])
            s, base, kept = f4(raster.focal / d), u8(0), True
            sums[:] = 0
            for t in range(trees):
                n = _leaf(raster.flat, raster.width, u8(c), d, s, d - clip, d + clip, records, base)
                for k in range(classes):
                    sums[k] += shares[n, k]
                base += nodes
                a = PROBABILITY * (t + 1) - sums[0]
                if (t + 1 == first and a < limit1) or (t + 1 == 2 * first and a < limit2):
                    kept = False
                    break
            if kept:
                best = 0
                for k in range(1, classes):
                    if sums[k] > sums[best]:
                        best = k
                if best > 0:
                    out[best - 1, i, j] = sums[best] * scale


@kernel
def _parzen(raster, stride, scores, majority, sigma, sums, out):
    """Compute the density of the votes on the grid, into out (rows, columns) f4: m^2 of surface per grid cell around
    it.

    majority: a cell votes where scores > majority.
    sigma: of the Gaussian kernel of unit sum, cells; cut at 3 sigma.
    sums: (rows, columns), scratch.
    Returns: index of the largest value.
    Deviation: the weight of a vote is score^3 x (z stride / focal)^2, where the thesis counts votes. This is the
    surface for which it stands, so that the sum over a gesture does not depend on its distance. The cube lets the
    confident middle of a gesture decide where it is, not the weak votes along a limb.
    """
    rows, columns = scores.shape
    r = int(3 * sigma + 0.5)
    kernel = np.exp(-0.5 * (np.arange(-r, r + 1) / sigma) ** 2)
    kernel = (kernel / kernel.sum()).astype(np.float32)
    sums[:] = 0
    out[:] = 0
    unit = f4((0.001 * stride / raster.focal) ** 2)
    for i in range(rows):
        for j in range(columns):
            p = scores[i, j]
            if p > majority:
                y, x = i * stride + stride // 2 + raster.border, j * stride + stride // 2 + raster.border
                d = f4(raster.flat[u8(y * raster.width + x)])
                v = p * p * p * d * d * unit
                for q in range(max(-r, -j), min(r, columns - 1 - j) + 1):
                    sums[i, j + q] += v * kernel[q + r]
    for i in range(rows):
        for j in range(columns):
            v = sums[i, j]
            if v != 0:
                for q in range(max(-r, -i), min(r, rows - 1 - i) + 1):
                    out[i + q, j] += v * kernel[q + r]
    best, at = f4(-1.0), 0
    for i in range(rows):
        for j in range(columns):
            if out[i, j] > best:
                best, at = out[i, j], i * columns + j
    return at


class Packed(NamedTuple):
    """Forest in the memory layout for scanning.

    records: (nt, N, 8) int16: test, left child, share of class 1 in ten-thousandths, 0.
    shares: (nt, N, C) uint16, shares of all classes.
    """

    records: NDArray[np.int16]
    shares: NDArray[np.uint16]


class Raster(NamedTuple):
    """Padded picture as the scan reads it.

    flat: (n,) int16 mm.
    width, border: of the padded picture, px.
    rows, columns: of the picture.
    near, far: range of the depths that are scanned, mm.
    focal: focal length, px.
    """

    flat: NDArray[np.int16]
    width: int
    border: int
    rows: int
    columns: int
    near: int
    far: int
    focal: float


def pack(
    test: NDArray[np.int16], left: NDArray[np.int16], count: NDArray[np.uint32], size: NDArray[np.int32]
) -> Packed:
    """Convert trees to the scanning layout: test (nt, N, 5), left (nt, N), count (nt, N, C), size (nt,)."""
    n = int(size.max())
    records = np.zeros((len(left), n, 8), np.int16)
    shares = np.zeros((len(left), n, count.shape[2]), np.uint16)
    _pack(test, left, count, size, records, shares)
    return Packed(records, shares)


def leaves(picture: PaddedDepth, cells: NDArray[np.int64], packed: Packed, clip_mm: int) -> NDArray[np.int32]:
    """Find the leaf (S, nt) that each of S cells reaches in each of nt trees.

    picture: padded depth picture.
    cells: (S,) indices in its `flat`.
    packed, clip_mm: forest, and its clipping distance.
    """
    out = np.empty((len(cells), len(packed.records)), np.int32)
    records = packed.records.reshape(-1, 8)
    _leaves(picture.flat, picture.width, cells, picture.focal, clip_mm, records, len(packed.records), out)
    return out


@dataclass(frozen=True)
class ScanPlan:
    """Settings of where and how thoroughly a picture is scanned.

    stride: every stride-th pixel is scanned.
    near_mm, far_mm: range of depths that are scanned, mm.
    first: number of trees after which a pixel may be rejected (0: no rejection).
    least: a mean share below this is rejected after `first` trees, below 1.5 times this after twice as many.
    coarse: > 0: the first trees scan a grid `coarse` times wider, and only the neighbourhood of the cells that they
        keep is scanned finely.
    """

    stride: int = 4
    near_mm: int = 500
    far_mm: int = 4000
    first: int = 3
    least: float = 0.25
    coarse: int = 2


def grid_shape(shape: tuple[int, int], stride: int) -> tuple[int, int]:
    """Return rows and columns of the scanning grid; cell (i, j) stands for pixel (i, j) stride + stride // 2."""
    return -(-shape[0] // stride), -(-shape[1] // stride)


def _raster(picture: PaddedDepth, near_mm: int, far_mm: int) -> Raster:
    h, w = picture.shape
    near = max(near_mm, picture.near_mm)
    return Raster(picture.flat, picture.width, picture.border, h, w, near, far_mm, picture.focal)


MOST_FORESTS = 32
"""Largest number of forests in one scan."""


def scan(picture: PaddedDepth, packed: Sequence[Packed], clip_mm: Sequence[int], plan: ScanPlan) -> NDArray[np.float32]:
    """Compute the mean share of class 1 of several forests on the grid.

    picture: padded depth picture.
    packed, clip_mm: forests, and their clipping distances.
    plan: where to scan.
    Returns: (G, rows, columns), 0 where rejected. All forests share one coarse pass and one walk over the picture.
    """
    raster = _raster(picture, plan.near_mm, plan.far_mm)
    records = [p.records.reshape(-1, 8) for p in packed]
    starts = np.cumsum([0, *(len(r) for r in records)])
    table = np.array(
        [(a, p.records.shape[1], len(p.records), c) for a, p, c in zip(starts, packed, clip_mm, strict=False)], np.int64
    )
    joined = records[0] if len(records) == 1 else np.concatenate(records)
    shape = grid_shape(picture.shape, plan.stride)
    out, wanted = np.empty((len(packed), *shape), np.float32), np.zeros((1, 1), np.uint32)
    wide = plan.coarse if plan.first else 0
    if wide:
        wanted = np.empty(grid_shape(picture.shape, plan.stride * wide), np.uint32)
        _coarse_pass(raster, joined, table, plan.first, plan.least, plan.stride * wide, wanted)
    _scan(raster, joined, table, plan.first, plan.least, plan.stride, wanted, wide, out)
    return out


def scan_classes(picture: PaddedDepth, packed: Packed, clip_mm: int, plan: ScanPlan) -> NDArray[np.float32]:
    """Compute the mean share (C - 1, rows, columns) of each gesture of one forest where it wins, else 0.

    picture: padded depth picture.
    packed, clip_mm: forest of C classes, and its clipping distance.
    plan: where to scan.
    """
    raster = _raster(picture, plan.near_mm, plan.far_mm)
    shares = packed.shares.reshape(-1, packed.shares.shape[2])
    out = np.empty((shares.shape[1] - 1, *grid_shape(picture.shape, plan.stride)), np.float32)
    records, trees = packed.records.reshape(-1, 8), len(packed.records)
    _scan_classes(raster, records, shares, trees, clip_mm, plan.first, plan.least, plan.stride, out)
    return out


def parzen(
    picture: PaddedDepth, scores: NDArray[np.float32], stride: int, majority: float, sigma_px: float
) -> tuple[NDArray[np.float32], int]:
    """Compute the density of the votes on the scanning grid.

    picture: padded depth picture.
    scores: (rows, columns) mean shares.
    stride: of the grid, px.
    majority: share that a cell needs to vote.
    sigma_px: standard deviation of the Gaussian kernel, px.
    Returns: m^2 of voting surface per cell (rows, columns), and the flat index of the largest value.
    """
    sums, out = np.empty_like(scores), np.empty_like(scores)
    raster = _raster(picture, 0, FAR_MM)
    return out, int(_parzen(raster, stride, scores, majority, sigma_px / stride, sums, out))
