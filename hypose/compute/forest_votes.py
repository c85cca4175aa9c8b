"""Scan depth pictures with forests of depth tests (forests.py), with early rejection, and compute the density of the
votes.

A grid cell (i, j) of stride n stands for pixel (i n + n // 2, j n + n // 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.compute.compiled import kernel
from hypose.compute.forests import PaddedDepth, f4, i4, response, u8

PROBABILITY = 10000
"""Probabilities are whole multiples of 1 / PROBABILITY."""


@kernel(inline=True)
def _leaf(flat, width, c, d, s, lo, hi, records, base):
    """Find the leaf that cell c reaches in the tree whose root is record `base`; return its record.

    The other arguments are as for `forests.response`.
    """
    n = base
    while True:
        child = records[n, u8(5)]
        if child < 0:
            return n
        f = response(
            flat, width, c, d, s, lo, hi, records[n, u8(0)], records[n, u8(1)], records[n, u8(2)], records[n, u8(3)]
        )
        n = base + u8(child) + u8(0 if f < records[n, u8(4)] else 1)


@kernel(inline=True)
def _place(picture, span, i, j, stride):
    """Return the index of grid cell (i, j) in the flat picture; -1 where it is outside or its depth is not in the span.

    span: nearest and farthest depth, mm.
    """
    y, x = i * stride + stride // 2, j * stride + stride // 2
    if y >= picture.rows or x >= picture.columns:
        return -1
    c = (y + picture.border) * picture.width + x + picture.border
    d = picture.flat[u8(c)]
    return c if span[0] <= d <= span[1] else -1


@kernel
def _scan(picture, span, records, table, first, least, stride, wanted, ratio, out):
    """Compute the mean share of class 1 of each forest on the grid, into out (G, ceil(rows / stride), ...) f4.

    wanted: (ceil(rows / ratio), ...) u4, bit g is set in the cells of the coarse grid that forest g scans.
    picture, span: padded depth picture, and the nearest and farthest depth to scan, mm.
    records: (R, 8) i2 of all forests.
    table: (G, 4) i8: first record, nodes per tree, trees, clipping distance.
    first, least: a cell is rejected where the mean over the first trees stays below `least`, or that over twice as many
        below 1.5 `least` (first = 0: no rejection).
    ratio: grid cells per coarse cell (0: all cells are scanned).

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
            c = _place(picture, span, i, j, stride)
            if c < 0:
                continue
            d = i4(picture.flat[u8(c)])
            s = f4(picture.focal / d)
            for g in range(table.shape[0]):
                if (bits >> np.uint32(g)) & np.uint32(1) == 0:
                    continue
                base, nodes, trees, clip = u8(table[g, 0]), u8(table[g, 1]), table[g, 2], i4(table[g, 3])
                lo, hi, a = d - clip, d + clip, 0
                for t in range(trees):
                    a += records[_leaf(picture.flat, picture.width, u8(c), d, s, lo, hi, records, base), u8(6)]
                    base += nodes
                    if (t + 1 == first and a < limit1) or (t + 1 == 2 * first and a < limit2):
                        a = 0
                        break
                out[g, i, j] = a / f4(PROBABILITY * trees)


def pack(
    test: NDArray[np.int16], left: NDArray[np.int16], count: NDArray[np.uint32], size: NDArray[np.int32]
) -> NDArray[np.int16]:
    """Convert nt decision trees of up to N nodes to the memory layout for scanning; a node without samples counts as
    background.

    test: (nt, N, 5) depth tests of the nodes.
    left: (nt, N) left children, -1 for a leaf.
    count: (nt, N, C) samples per class.
    size: (nt,) number of nodes in use.
    Returns: (nt, N, 8) records, one per node: depth test (5 numbers), index of the left child, share of class 1 in
        ten-thousandths, 0.
    """
    n = int(size.max())
    number = count[:, :n].astype(np.float64)
    number[number.sum(2) == 0, 0] = 1.0
    records = np.zeros((len(left), n, 8), np.int16)
    records[..., :5], records[..., 5] = test[:, :n], left[:, :n]
    records[..., 6] = number[..., 1] / number.sum(2) * PROBABILITY + 0.5
    return records


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


def _grid_shape(picture: PaddedDepth, stride: int) -> tuple[int, int]:
    """Return rows and columns of the scanning grid; cell (i, j) stands for pixel (i, j) stride + stride // 2."""
    return -(-picture.rows // stride), -(-picture.columns // stride)


def _span(picture: PaddedDepth, plan: ScanPlan) -> tuple[int, int]:
    """Return the nearest and the farthest depth to scan, mm: those of the plan that tests can reach."""
    return max(plan.near_mm, picture.near_mm), plan.far_mm


MOST_FORESTS = 32
"""Largest number of forests in one scan."""


def scan(
    picture: PaddedDepth, packed: Sequence[NDArray[np.int16]], clip_mm: Sequence[int], plan: ScanPlan
) -> NDArray[np.float32]:
    """Compute, at each cell of the scanning grid, the share of class 1 (the gesture) of several forests, mean over
    the trees.

    picture: padded depth picture.
    packed, clip_mm: records of G forests (`pack`), and the depth difference at which the tests of each are clipped, mm.
    plan: where to scan.
    Returns: (G, rows, columns), 0 where a cell was rejected. All forests share one coarse pass and one walk over the
        picture.
    """
    span = _span(picture, plan)
    records = [p.reshape(-1, 8) for p in packed]
    starts = np.cumsum([0, *(len(r) for r in records)])
    table = np.array([(a, p.shape[1], len(p), c) for a, p, c in zip(starts, packed, clip_mm, strict=False)], np.int64)
    joined = records[0] if len(records) == 1 else np.concatenate(records)
    shape = _grid_shape(picture, plan.stride)
    out, wanted = np.empty((len(packed), *shape), np.float32), np.zeros((1, 1), np.uint32)
    wide = plan.coarse if plan.first else 0
    if wide:  # the first trees alone; a cell is worth a full scan where it or a neighbour has a large share
        few = np.array(table)
        few[:, 2] = np.minimum(few[:, 2], plan.first)
        rough = np.empty((len(packed), *_grid_shape(picture, plan.stride * wide)), np.float32)
        _scan(picture, span, joined, few, 0, plan.least, plan.stride * wide, wanted, 0, rough)
        near = [cv2.dilate((g >= np.float32(plan.least)).view(np.uint8), np.ones((3, 3), np.uint8)) for g in rough]
        wanted = np.bitwise_or.reduce([g.astype(np.uint32) << np.uint32(k) for k, g in enumerate(near)])
    _scan(picture, span, joined, table, plan.first, plan.least, plan.stride, wanted, wide, out)
    return out


def parzen(
    picture: PaddedDepth, scores: NDArray[np.float32], stride: int, majority: float, sigma_px: float
) -> tuple[NDArray[np.float32], int]:
    """Compute the density of the votes for a gesture on the scanning grid (Parzen window estimate).

    picture: padded depth picture.
    scores: (rows, columns) mean shares.
    stride: stride of the grid, px.
    majority: share that a cell needs to vote.
    sigma_px: standard deviation of the Gaussian kernel, px.
    Returns: m^2 of voting surface per cell (rows, columns), and the flat index of the largest value.
    Deviation: the weight of a vote is share^3 x (z stride / focal)^2, where the thesis counts votes. This is the
        surface for which it stands, so that the sum over a gesture does not depend on its distance. The cube lets the
        confident middle of a gesture decide where it is, not the weak votes along a limb.
    """
    rows, columns = (np.arange(n) * stride + stride // 2 for n in scores.shape)
    depth = picture.flat[picture.cells(rows[:, None], columns[None])] * np.float32(0.001 * stride / picture.focal)
    votes = np.where(scores > majority, scores**3 * depth**2, np.float32(0))
    sigma = sigma_px / stride
    reach = int(3 * sigma + 0.5)
    gauss = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    gauss = (gauss / gauss.sum()).astype(np.float32)
    out = cv2.sepFilter2D(votes, -1, gauss, gauss, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(out, dtype=np.float32), int(np.argmax(out))
