"""From a decoded picture to a mask: shrink and undistort, difference from the room with the shadow cone, clean-up.

The numpy (and OpenCV) versions here are the definitions; cpu_images.py does the same in one pass each, inside a box.
Images are BGR uint8, a box is (y0, y1, x0, x1), half open, px. The functions release the GIL and keep no state, so each
camera can have its own thread.
"""

from __future__ import annotations

import threading
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute import selection
from hypose.compute.native import native
from hypose.errors import InputError

Image = NDArray[np.uint8]
Mask = NDArray[np.uint8]
Box = tuple[int, int, int, int]


class Lens(NamedTuple):
    """How stored pictures of one camera become undistorted ones (h, w) of the working size.

    stored: (width, height) of the stored pictures. First they are shrunk by area: across, down > 0: blocks of that many
    pixels are averaged; 0: working column x is the sum over k of column_weights[x, k] / 256 times stored column
    columns[x] + k, rows alike before, rounded to 16ths; columns (w,), column_weights (w, K), rows (h,), row_weights
    (h, L). corner (h, w): number of the pixel up and left of the undistorted one in the shrunk picture, in rows with
    one pixel of black on the left and two on the right (one above, two below); parts (h, w, 2) u1: further right and
    down, in 32nds of a pixel. row_reach (h, 2), column_reach (w, 2): first and last shrunk row (column) that the
    corners of an undistorted row (column) lie in. straight: the shrunk picture is the undistorted one.
    """

    stored: tuple[int, int]
    across: int
    down: int
    columns: NDArray[np.int64]
    column_weights: NDArray[np.uint16]
    rows: NDArray[np.int64]
    row_weights: NDArray[np.uint16]
    corner: NDArray[np.int32]
    parts: NDArray[np.uint8]
    row_reach: NDArray[np.int64]
    column_reach: NDArray[np.int64]
    straight: bool


class Room(NamedTuple):
    """What the empty room looks like: low, high (h, w, 3) u1, the grey levels that are still the room; mean (h, w, 3)
    f4 and square (h, w) f4, its squared length (at least 1), for the shadow test; shadow: whether that is made;
    darkest, lightest: brightness of a shadow relative to the lit room; chroma: squared colour distance a shadow may
    have, grey levels."""

    low: Image
    high: Image
    mean: NDArray[np.float32]
    square: NDArray[np.float32]
    shadow: bool
    darkest: float
    lightest: float
    chroma: float


def make_lens(stored: tuple[int, int], map_x: ArrayLike, map_y: ArrayLike) -> Lens:
    """Lens for stored pictures (width, height) from maps (h, w) in pixels of the working size: where in a picture
    shrunk to that size each undistorted pixel lies (as for cv2.remap). Pictures are never enlarged: an InputError."""
    mx, my = np.asarray(map_x, dtype=np.float64), np.asarray(map_y, dtype=np.float64)
    h, w = mx.shape
    if stored[0] < w or stored[1] < h:
        raise InputError(f"A picture of {stored} px cannot be enlarged to {(w, h)} px; choose a smaller working size.")
    whole = stored[0] % w == 0 and stored[1] % h == 0 and (stored[0] // w) * (stored[1] // h) <= 257
    across, down = (stored[0] // w, stored[1] // h) if whole else (0, 0)
    columns, column_weights = _averages(stored[0], w)
    rows, row_weights = _averages(stored[1], h)
    i = np.clip(np.nan_to_num(np.rint(32 * mx), nan=-1e6), -32, 32 * w).astype(np.int64)
    j = np.clip(np.nan_to_num(np.rint(32 * my), nan=-1e6), -32, 32 * h).astype(np.int64)
    corner = ((j // 32 + 1) * (w + 3) + i // 32 + 1).astype(np.int32)
    parts = np.stack([i % 32, j % 32], -1).astype(np.uint8)
    row_reach, column_reach = _reach(j // 32 + 1, 1), _reach(i // 32 + 1, 0)
    straight = bool((i == 32 * np.arange(w)).all() and (j == 32 * np.arange(h)[:, None]).all())
    return Lens(
        stored,
        across,
        down,
        columns,
        column_weights,
        rows,
        row_weights,
        corner,
        parts,
        row_reach,
        column_reach,
        straight,
    )


def _reach(at: NDArray[np.int64], axis: int) -> NDArray[np.int64]:
    return np.stack([at.min(axis), at.max(axis)], -1)


def _averages(source: int, target: int) -> tuple[NDArray[np.int64], NDArray[np.uint16]]:
    """First source pixel and weights (sum 256) of each of `target` boxes."""
    step = source / target
    taps = min(int(np.ceil(step)) + (source % target != 0), source)
    first = np.minimum(np.floor(np.arange(target) * step + 1e-9).astype(np.int64), source - taps)
    edges = np.clip(first[:, None] + np.arange(taps + 1), np.arange(target)[:, None] * step, None)
    edges = np.minimum(edges, (np.arange(target)[:, None] + 1) * step)
    cumulative = np.rint(256 * (edges - edges[:, :1]) / step).astype(np.int64)
    return first, np.diff(cumulative, axis=1).astype(np.uint16)


def shrink_undistort(image: Image, lens: Lens, box: Box | None = None) -> Image:
    """Stored picture (H, W, 3) -> undistorted (h, w, 3) of the working size, black where the camera does not see, and
    outside `box` (default: everywhere) undefined."""
    h, w = lens.corner.shape
    if image.shape != (lens.stored[1], lens.stored[0], 3) or image.dtype != np.uint8:
        raise InputError(f"A picture of {image.shape[1::-1]} px was given where {lens.stored} px are stored.")
    y0, y1, x0, x1 = box or (0, h, 0, w)
    if y1 <= y0 or x1 <= x0:
        return np.zeros((h, w, 3), np.uint8)
    if selection.backend() == "numpy":
        small = np.zeros((h + 3, w + 3, 3), np.uint8)
        small[1 : h + 1, 1 : w + 1] = _shrink(image, lens)
        return small[1 : h + 1, 1 : w + 1].copy() if lens.straight else _remap(small, lens)
    kernels, image = native("pictures.images"), np.require(image, np.uint8, ["C", "W"])
    packed = _scratch(h + 3, w + 3)
    a0, a1, b0, b1 = (y0, y1, x0, x1) if lens.straight else _needed(lens, box)
    if a1 > a0 and b1 > b0:
        if lens.across:
            kernels.shrink_blocks(image, lens.across, lens.down, a0, a1, b0, b1, packed)
        else:
            weights = lens.columns, lens.column_weights, lens.rows, lens.row_weights
            kernels.shrink_weighted(image, *weights, a0, a1, b0, b1, packed)
    out = np.empty((h, w, 3), np.uint8)
    if lens.straight:
        kernels.unpack(packed, y0, y1, x0, x1, out)
    else:
        kernels.remap(packed, lens.corner, lens.parts, y0, y1, x0, x1, out)
    return out


_OWN = threading.local()


def _scratch(h: int, w: int) -> NDArray[np.uint64]:
    """This thread's memory for packed pixels, its rim zero: new memory of this size costs as much as the shrinking."""
    known = getattr(_OWN, "packed", None)
    if known is None or known.shape != (h, w):
        known = _OWN.packed = np.zeros((h, w), np.uint64)
    return known


def _needed(lens: Lens, box: Box | None) -> Box:
    """A part of the shrunk picture that holds all that undistorted pixels in the box are made of."""
    h, w = lens.corner.shape
    if box is None:
        return 0, h, 0, w
    rows, columns = lens.row_reach[box[0] : box[1]], lens.column_reach[box[2] : box[3]]
    return (
        max(int(rows[:, 0].min()) - 1, 0),
        min(int(rows[:, 1].max()) + 1, h),
        max(int(columns[:, 0].min()) - 1, 0),
        min(int(columns[:, 1].max()) + 1, w),
    )


def _shrink(image: Image, lens: Lens) -> Image:
    h, w = lens.corner.shape
    if lens.across:
        n = lens.across * lens.down
        blocks = image.reshape(h, lens.down, w, lens.across, 3).sum((1, 3), dtype=np.uint64)
        inverse = np.uint64((16777216 + n // 2) // n)
        return ((blocks * inverse + np.uint64(8388608)) >> np.uint64(24)).astype(np.uint8)
    lines = np.zeros((h, image.shape[1], 3), np.uint32)
    for k in range(lens.row_weights.shape[1]):
        lines += lens.row_weights[:, k, None, None] * image[lens.rows + k].astype(np.uint32)
    lines = (lines + np.uint32(8)) >> np.uint32(4)
    total = np.zeros((h, w, 3), np.uint32)
    for k in range(lens.column_weights.shape[1]):
        total += lens.column_weights[:, k, None] * lines[:, lens.columns + k]
    return ((total + np.uint32(2048)) >> np.uint32(12)).astype(np.uint8)


def _remap(small: Image, lens: Lens) -> Image:
    flat, step = small.reshape(-1, 3).astype(np.int32), small.shape[1]
    at = lens.corner
    fx, fy = lens.parts[..., :1].astype(np.int32), lens.parts[..., 1:].astype(np.int32)
    upper = (32 - fx) * flat[at] + fx * flat[at + 1]
    lower = (32 - fx) * flat[at + step] + fx * flat[at + step + 1]
    return (((32 - fy) * upper + fy * lower + 512) >> 10).astype(np.uint8)


def differences(image: Image, room: Room, box: Box | None = None) -> Mask:
    """(h, w) u1 of an undistorted picture (h, w, 3): 0 = the room (and outside the box), 1 = something else, 2 = the
    room's colour but darker."""
    h, w = room.square.shape
    y0, y1, x0, x1 = box or (0, h, 0, w)
    out = np.zeros((h, w), np.uint8)
    limits = (np.float32(room.darkest), np.float32(room.lightest), np.float32(room.chroma))
    if selection.backend() != "numpy":
        image = np.require(image, np.uint8, ["C", "W"])
        native("pictures.images").differ(image, *room[:4], bool(room.shadow), *limits, y0, y1, x0, x1, out)
        return out
    s = np.s_[y0:y1, x0:x1]
    part = image[s]
    other = ((part < room.low[s]) | (part > room.high[s])).any(2)
    out[s] = other
    if room.shadow:
        colour, mean = part.astype(np.float32), room.mean[s]
        brightness = (colour * mean).sum(2) / room.square[s]
        rest = colour - brightness[..., None] * mean
        dark = (brightness > limits[0]) & (brightness < limits[1]) & ((rest * rest).sum(2) < limits[2])
        out[s] = np.where(other & dark, 2, other)
    return out


def without_shadows(codes: Mask) -> Mask:
    """Foreground (h, w) of what `differences` found: all that is not the room, less the shadows. A shadow is an area:
    single twos along the edge of dark clothing before a bright wall are mixed pixels, so twos are opened 3 x 3."""
    if selection.backend() != "numpy":
        out = np.empty(codes.shape, np.uint8)
        native("pictures.images").without_shadows(np.require(codes, np.uint8, ["C", "W"]), out)
        return out
    shadow = cv2.morphologyEx((codes == 2).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    return np.asarray(np.minimum(codes, 1) & (1 - shadow), dtype=np.uint8)


def clean_regions(mask: Mask, hole_px: int, keep_share: float, keep_gap: float) -> Mask:
    """mask (h, w) of 0 and 1 with its holes of at most hole_px filled (background connected over edges only), then only
    the biggest region (connected over corners too) and those of at least keep_share times its area whose boxes are not
    farther from its box than keep_gap times the longer side of that. keep_share >= 1: the biggest region alone."""
    if selection.backend() != "numpy":
        out = np.zeros_like(mask)
        gap = float(min(keep_gap, 1e9))
        native("pictures.images").clean_regions(
            np.array(mask, dtype=np.uint8), int(hole_px), float(keep_share), gap, out
        )
        return out
    part = mask.copy()
    if hole_px:
        _, label, stats, _ = cv2.connectedComponentsWithStats(1 - part, connectivity=4)
        small = stats[:, cv2.CC_STAT_AREA] <= hole_px
        small[0] = False  # label 0 is the foreground here
        part |= small[np.asarray(label, dtype=np.int64)].astype(np.uint8)
    count, label, stats, _ = cv2.connectedComponentsWithStats(part, connectivity=8)
    if count < 2:
        return part
    area = stats[:, cv2.CC_STAT_AREA].astype(np.int64)
    area[0] = 0
    main = int(area.argmax())
    keep = (area >= max(keep_share * area[main], 1)) & (area > 0)
    if keep_share >= 1:
        keep = np.arange(count) == main
    start = stats[:, [cv2.CC_STAT_LEFT, cv2.CC_STAT_TOP]].astype(np.int64)
    size = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].astype(np.int64)
    gap = np.maximum(np.maximum(start - (start + size)[main], start[main] - (start + size)), 0).max(1)
    keep &= gap <= keep_gap * size[main].max()
    return keep[np.asarray(label, dtype=np.int64)].astype(np.uint8)


def order_statistic(stack: NDArray[np.uint8], hidden: NDArray[np.bool_] | None, rank: NDArray[np.int64]) -> Image:
    """Of stack (N, P, 3) u1, per pixel and channel the value with `rank` (P,) values below it in order (0: the
    smallest), over the frames that are not hidden (N, P): (P, 3) u1; 255 where the rank is not below their number."""
    n, p, _ = stack.shape
    if selection.backend() != "numpy":
        out = np.empty((p, 3), np.uint8)
        none = np.zeros((0, p), np.bool_)
        seen = none if hidden is None else np.require(hidden, np.bool_, ["C", "W"])
        native("pictures.images").order_statistic(
            np.require(stack, np.uint8, ["C", "W"]), seen, rank.astype(np.uint16), out
        )
        return out
    values = stack.astype(np.int16)
    if hidden is not None:
        values = np.where(hidden[..., None], np.int16(255), values)
    picked = np.take_along_axis(np.sort(values, 0), np.minimum(rank, n - 1)[None, :, None], 0)[0]
    count = np.full(p, n) if hidden is None else (~hidden).sum(0)
    return np.where((rank >= count)[:, None], 255, picked).astype(np.uint8)


def warm_up_masks() -> None:
    """Compile (or load from disk) what masks from files need on a toy mask."""
    picture, (x, y) = np.zeros((24, 30, 3), np.uint8), np.meshgrid(np.arange(15.0), np.arange(12.0))
    clean_regions(shrink_undistort(picture, make_lens((30, 24), x, y))[..., 0], 1, 0.5, 1.0)


def warm_up() -> None:
    """Compile (or load from disk) every kernel of this module on a toy picture."""
    picture, (x, y) = np.zeros((24, 30, 3), np.uint8), np.meshgrid(np.arange(15.0), np.arange(12.0))
    for lens in (make_lens((30, 24), x, y), make_lens((30, 24), x + 0.3, y), make_lens((30, 24), x[:, :13], y[:, :13])):
        small = shrink_undistort(picture, lens)
        mean = small.astype(np.float32)
        codes = differences(small, Room(small, small, mean, mean[..., 0] + 1, True, 0.5, 0.9, 100.0))
        clean_regions(without_shadows(codes), 1, 0.5, 1.0)
    order_statistic(picture, None, np.zeros(30, np.int64))
    order_statistic(picture, np.zeros((24, 30), np.bool_), np.zeros(30, np.int64))
