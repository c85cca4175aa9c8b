"""Which way round two cameras see a board that looks the same turned by 180 degrees and lies still: seen from above,
the floor around it must look the same in both pictures (what stands on the floor does not, but seldom says the
opposite)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.calibration.boards import Board
from hypose.cameras.camera import Camera
from hypose.geometry import Array

Picture = NDArray[np.uint8]

_REACH = 4.0  # board lengths around its middle
_CELLS = 320
_MIN_SHARE = 0.06  # of the square: less common floor says nothing
_LEAST_RISE = 0.12  # sine of the lowest viewing angle: floor seen flatter is a smear


def floor_likelihood(
    images: Mapping[int, Picture],
    cameras: Sequence[Camera],
    camera_from_board: Mapping[int, Array],
    board: Board,
    c: int,
    d: int,
    d_from_c: Array,
    other: Array,
) -> float:
    """How many times better the floor of cameras c and d agrees under d_from_c than under `other` (both (4, 4)):
    quotient of the unexplained shares 1 - correlation; 1 when there is nothing to compare.

    images: by camera, BGR (h, w, 3) with the board lying still; camera_from_board: its pose in each."""
    base = camera_from_board[c]
    one = _from_above(images[c], replace(cameras[c], camera_from_world=base), board)
    scores = []
    for motion in (d_from_c, other):
        two = _from_above(images[d], replace(cameras[d], camera_from_world=motion @ base), board)
        scores.append(_correlation(one, two))
    if not np.isfinite(scores).all():
        return 1.0
    return float((1 - scores[1]) / max(1 - scores[0], 1e-6))


def _from_above(image: Picture, camera: Camera, board: Board) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """The floor around the board as seen from above (n, n, 3), and where it is seen well. camera: in the board's
    frame."""
    low, high = board.points.min(0), board.points.max(0)
    middle, length = 0.5 * (low + high), float((high - low).max())
    line = np.linspace(-_REACH * length, _REACH * length, _CELLS)
    x, y = np.meshgrid(line + middle[0], line + middle[1])
    points = np.stack([x, y, np.zeros_like(x)], -1)
    uv = camera.project(points)
    # a lens model says anything far outside the picture: only points whose pinhole image is near count
    plain = camera.project_pinhole(points)
    size = np.array(camera.size)
    with np.errstate(invalid="ignore"):
        seen = ((uv > 1) & (uv < size - 2) & (plain > -0.5 * size) & (plain < 1.5 * size)).all(-1)
    towards = camera.position - points
    seen &= np.abs(towards[..., 2]) / np.linalg.norm(towards, axis=-1) > _LEAST_RISE
    margin = 1.5 * board.square
    seen &= ~(((points[..., :2] > low[:2] - margin) & (points[..., :2] < high[:2] + margin)).all(-1))
    map_x, map_y = (np.where(seen, uv[..., i], 0).astype(np.float32) for i in (0, 1))
    top = cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR).astype(np.float32)
    return top, seen


def _correlation(
    one: tuple[NDArray[np.float32], NDArray[np.bool_]], two: tuple[NDArray[np.float32], NDArray[np.bool_]]
) -> float:
    """Mean correlation of the colours over the common floor, each colour relative to its surroundings so that shading
    does not count; NaN with too little in common."""
    mask = one[1] & two[1]
    if mask.mean() < _MIN_SHARE:
        return float("nan")
    weight = mask.astype(np.float32)
    spread = cv2.GaussianBlur(weight, (0, 0), 24)
    parts = []
    for image, _ in (one, two):
        smooth = cv2.GaussianBlur(image, (0, 0), 2.5)
        local = cv2.GaussianBlur(smooth * weight[..., None], (0, 0), 24) / np.maximum(spread, 1e-3)[..., None]
        parts.append((smooth - local)[mask])
    a, b = parts
    a, b = a - a.mean(0), b - b.mean(0)
    norm = np.sqrt((a**2).sum() * (b**2).sum())
    return float((a * b).sum() / norm) if norm > 1e-6 else float("nan")
