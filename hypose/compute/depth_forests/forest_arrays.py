"""Forests of depth tests: the arrays they live in, and what is computed with them (kernels in cpu_forests.py and
cpu_forest_votes.py).

Depth here is (h, w) uint16 in millimetres, 0 = hole, as sensors give it: tests compare whole millimetres, so that the
same picture gives the same answer everywhere. A hole counts as far away (10 m), never as near.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.native import native

Depth = NDArray[np.uint16]
FAR_MM = 10000
"""What a hole, the outside of the picture and everything beyond counts as."""
UNCLIPPED_MM = 20000
"""A clipping distance that clips nothing."""
MAX_NODES = 32766
"""Of one tree: node numbers are 16-bit."""


class GrowingArrays(NamedTuple):
    """A forest that grows: nt trees of N nodes, S slots with T candidate tests per tree, C classes.

    test (nt, N, 5) i2: uy, ux, vy, vx, threshold in mm; left (nt, N) i2: left child or -1 (right = left + 1); seen
    (nt, N, C) u4: samples seen; level (nt, N) u1: depth of the node; slot (nt, N) i2 or -1; size (nt,) i4: nodes in
    use; free (nt, S) i2 and n_free (nt,) i4: stack of unused slots; candidate (nt, S, T, 5) i2; left_count (nt, S, T,
    C) u2; total (nt, S, C) i4; random (nt,) u8: state of each tree's random numbers; tally (2,) i8: splits, refusals
    for want of a slot.
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


class Packed(NamedTuple):
    """A forest laid out for scanning: records (nt, N, 8) i2: the test, the left child, the share of class 1 in
    ten-thousandths; shares (nt, N, C) u2: those of all classes."""

    records: NDArray[np.int16]
    shares: NDArray[np.uint16]


@dataclass(frozen=True)
class PaddedDepth:
    """A depth picture with a border of FAR_MM: values (h + 2 border, w + 2 border) i2; focal length px; tests of up to
    reach_mm may be read at pixels not nearer than near_mm."""

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


class Raster(NamedTuple):
    """A padded picture as scanning reads it: flat (n,) i2 mm, its width and border; rows and columns of the picture;
    depths from near to far (mm) are looked at; focal length px."""

    flat: NDArray[np.int16]
    width: int
    border: int
    rows: int
    columns: int
    near: int
    far: int
    focal: float


def pad_depth(depth: Depth, focal: float, near_mm: int, reach_mm: int, reuse: PaddedDepth | None = None) -> PaddedDepth:
    """The padded picture; written into `reuse` when that has the same shape and border."""
    border = math.ceil(reach_mm * focal / near_mm) + 2
    h, w = depth.shape
    shape = (h + 2 * border, w + 2 * border)
    if reuse is not None and reuse.values.shape == shape and reuse.border == border:
        values = reuse.values
    else:
        values = np.full(shape, FAR_MM, np.int16)
    native("depth_forests.forests").pad(np.require(depth, np.uint16, ["C", "W", "A"]), border, values)
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
    native("depth_forests.forests").grow(
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


def pack(
    test: NDArray[np.int16], left: NDArray[np.int16], count: NDArray[np.uint32], size: NDArray[np.int32]
) -> Packed:
    """The scanning layout of trees: test (nt, N, 5), left (nt, N), count (nt, N, C), size (nt,)."""
    n = int(size.max())
    records = np.zeros((len(left), n, 8), np.int16)
    shares = np.zeros((len(left), n, count.shape[2]), np.uint16)
    native("depth_forests.forest_votes").pack(test, left, count, size, records, shares)
    return Packed(records, shares)


def leaves(picture: PaddedDepth, cells: NDArray[np.int64], packed: Packed, clip_mm: int) -> NDArray[np.int32]:
    """(S, nt) the leaf that each cell reaches in each tree."""
    out = np.empty((len(cells), len(packed.records)), np.int32)
    records = packed.records.reshape(-1, 8)
    native("depth_forests.forest_votes").leaves(
        picture.flat, picture.width, cells, picture.focal, clip_mm, records, len(packed.records), out
    )
    return out


@dataclass(frozen=True)
class ScanPlan:
    """Where and how thoroughly a picture is scanned: every stride-th pixel between near and far; after `first` trees a
    mean share below `least` is dropped, after twice as many one below 1.5 `least`. coarse > 0: the first trees look on
    a grid `coarse` times wider first, and only the neighbourhood of what they keep is scanned."""

    stride: int = 4
    near_mm: int = 500
    far_mm: int = 4000
    first: int = 3
    least: float = 0.25
    coarse: int = 2


def grid_shape(shape: tuple[int, int], stride: int) -> tuple[int, int]:
    """Rows and columns of the scanning grid; cell (i, j) stands for pixel (i, j) stride + stride // 2."""
    return -(-shape[0] // stride), -(-shape[1] // stride)


def _raster(picture: PaddedDepth, near_mm: int, far_mm: int) -> Raster:
    h, w = picture.shape
    near = max(near_mm, picture.near_mm)
    return Raster(picture.flat, picture.width, picture.border, h, w, near, far_mm, picture.focal)


MOST_FORESTS = 32
"""Looked with at a time."""


def scan(
    picture: PaddedDepth, packed: Sequence[Packed], clip_mm: Sequence[int], plan: ScanPlan
) -> tuple[NDArray[np.float32], int]:
    """Mean share (G, rows, columns) of class 1 of each of at most 32 forests on the grid (0 where rejected), and the
    number of tree descents. All forests share one coarse pass and one walk over the picture."""
    raster = _raster(picture, plan.near_mm, plan.far_mm)
    records = [p.records.reshape(-1, 8) for p in packed]
    starts = np.cumsum([0, *(len(r) for r in records)])
    table = np.array(
        [(a, p.records.shape[1], len(p.records), c) for a, p, c in zip(starts, packed, clip_mm, strict=False)], np.int64
    )
    joined = records[0] if len(records) == 1 else np.concatenate(records)
    shape = grid_shape(picture.shape, plan.stride)
    out, wanted, spent = np.empty((len(packed), *shape), np.float32), np.zeros((1, 1), np.uint32), 0
    wide = plan.coarse if plan.first else 0
    votes = native("depth_forests.forest_votes")
    if wide:
        wanted = np.empty(grid_shape(picture.shape, plan.stride * wide), np.uint32)
        spent = votes.coarse_pass(raster, joined, table, plan.first, plan.least, plan.stride * wide, wanted)
    spent += votes.scan(raster, joined, table, plan.first, plan.least, plan.stride, wanted, wide, out)
    return out, int(spent)


def scan_classes(picture: PaddedDepth, packed: Packed, clip_mm: int, plan: ScanPlan) -> tuple[NDArray[np.float32], int]:
    """(C - 1, rows, columns): mean share of each gesture where it wins, else 0; and the number of tree descents."""
    raster = _raster(picture, plan.near_mm, plan.far_mm)
    shares = packed.shares.reshape(-1, packed.shares.shape[2])
    out = np.empty((shares.shape[1] - 1, *grid_shape(picture.shape, plan.stride)), np.float32)
    records, trees = packed.records.reshape(-1, 8), len(packed.records)
    spent = native("depth_forests.forest_votes").scan_classes(
        raster, records, shares, trees, clip_mm, plan.first, plan.least, plan.stride, out
    )
    return out, int(spent)


def parzen(
    picture: PaddedDepth, scores: NDArray[np.float32], stride: int, majority: float, sigma_px: float
) -> tuple[NDArray[np.float32], int]:
    """Density (rows, columns) of the votes: m^2 of voting surface per cell; and the index of its largest value."""
    sums, out = np.empty_like(scores), np.empty_like(scores)
    raster = _raster(picture, 0, FAR_MM)
    return out, int(
        native("depth_forests.forest_votes").parzen(raster, stride, scores, majority, sigma_px / stride, sums, out)
    )


def cut_patches(picture: PaddedDepth, cells: NDArray[np.int64], step_mm: int) -> NDArray[np.int16]:
    """(S, P, P) depth relative to the centre's, mm, every step_mm over the square that tests may reach."""
    side = 2 * (picture.reach_mm // step_mm) + 1
    out = np.empty((len(cells), side, side), np.int16)
    native("depth_forests.forests").cut_patches(picture.flat, picture.width, cells, picture.focal, step_mm, out)
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
    """One tree from the patches named in `order` (with repetitions), by information gain (eq. 3.2)."""
    room = min(MAX_NODES, 2 * len(order) + 1)
    tree = TreeArraysOffline(
        np.zeros((room, 5), np.int16),
        np.full(room, -1, np.int16),
        np.zeros((room, classes), np.uint32),
        np.zeros(room, np.uint8),
    )
    state = rng.integers(0, 2**63, 1).astype(np.uint64)
    n = native("depth_forests.forests").grow_tree(
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
    """(S,) the leaf that each patch reaches."""
    out = np.empty(len(patches), np.int32)
    native("depth_forests.forests").patch_leaves(patches, clip_mm, tree.test, tree.left, out)
    return out
