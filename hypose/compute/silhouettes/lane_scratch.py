"""Scratch memory of the block-wise silhouette scorer, kept by each thread: memory that is made anew for every call has
its pages touched for the first time, which takes as long as scoring a dozen poses."""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hypose.compute.silhouettes.lane_mesh import LaneMesh

_F4 = NDArray[np.float32]
_KEPT = 8  # two bodies with four limbs each


class SingleScratch(NamedTuple):
    """For one pose drawn the safe way (cpu_lanes.score_safely). difference is zero between calls."""

    vertices: _F4
    u: _F4
    v: _F4
    camera: _F4
    front: NDArray[np.uint8]
    start: NDArray[np.int32]
    end: NDArray[np.int32]
    difference: NDArray[np.int16]
    running: NDArray[np.int16]
    model: NDArray[np.uint16]
    hit: NDArray[np.uint16]


class LaneScratch(NamedTuple):
    """For cpu_lanes.silhouette_xor, `lanes` poses at a time. difference is zero between calls."""

    frames: NDArray[np.float64]
    centres: NDArray[np.float64]
    axis: NDArray[np.float64]
    turn: NDArray[np.float64]
    maps: _F4
    points: _F4
    u: _F4
    v: _F4
    camera: _F4
    bounds: _F4
    window: _F4
    origin: NDArray[np.int64]
    front: NDArray[np.uint16]
    union: NDArray[np.int32]
    edge: _F4
    columns: NDArray[np.int32]
    lists: NDArray[np.int32]
    ends: NDArray[np.int64]
    difference: NDArray[np.int8]
    counts: NDArray[np.int64]
    single: SingleScratch


_OWN = threading.local()


def lane_scratch(mesh: LaneMesh, image: tuple[int, int], lanes: int, strip: int) -> LaneScratch:
    """This thread's scratch for a mesh and images of (rows, columns); strip: as in cpu_vectors."""
    known: dict[tuple[int, ...], LaneScratch] | None = getattr(_OWN, "scratch", None)
    if known is None:
        known = _OWN.scratch = {}
    key = (len(mesh.needed), len(mesh.vertices), len(mesh.faces), len(mesh.edges), *image)
    if key not in known:
        if len(known) == _KEPT:
            known.clear()
        known[key] = _make(*key, lanes, strip)
    return known[key]


def _make(j: int, v: int, f: int, e: int, rows: int, columns: int, lanes: int, strip: int) -> LaneScratch:
    f4, f8 = np.float32, np.float64
    # columns of a window, which begins at a multiple of 8, in whole strips and an odd number of them (cpu_lanes)
    stride = strip * (((columns + 8 + strip - 1) // strip) | 1)
    single = SingleScratch(
        np.empty((v, 3), f4),
        np.empty(v, f4),
        np.empty(v, f4),
        np.empty((3, 4), f4),
        np.empty(f + 1, np.uint8),
        np.empty(e, np.int32),
        np.empty(e, np.int32),
        np.zeros((rows + 1, columns), np.int16),
        np.empty(columns, np.int16),
        np.empty(columns, np.uint16),
        np.empty(columns, np.uint16),
    )
    return LaneScratch(
        np.empty((j + 1, 9, lanes)),
        np.empty((j, 3, lanes)),
        np.empty((3, lanes), f8),
        np.empty((9, lanes), f8),
        np.empty((j, 12, lanes), f4),
        np.empty((v, 3, lanes), f4),
        np.empty((v, lanes), f4),
        np.empty((v, lanes), f4),
        np.empty((12, lanes), f4),
        np.empty((5, lanes), f4),
        np.zeros((5, lanes), f4),
        np.zeros((lanes, 4), np.int64),
        np.empty(f + 1, np.uint16),
        np.empty(e + 1, np.int32),
        np.empty((4, lanes), f4),
        np.empty(lanes, np.int32),
        # an outline crosses a column some 5 times each way; memory that is not touched costs nothing
        np.empty((2 * lanes, 16 * columns + 1024), np.int32),
        np.zeros(2 * lanes, np.int64),
        np.zeros((rows + 1) * stride, np.int8),
        np.zeros(3, np.int64),
        single,
    )
