"""By how many frames board videos are late against each other: the speed of the board, which is the same seen from
everywhere, is compared over time. Rough (about half the distance of the frames looked at); it serves to name the cause
when boards contradict each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hypose.calibration.boards import Board, Sighting
from hypose.calibration.intrinsics import board_poses
from hypose.cameras.camera import Camera
from hypose.geometry import Array, transform

_LEAST = 12  # moments with a known speed in both cameras
_CLEAR = 0.7  # correlation of the speeds at the right lag
_BETTER = 0.1  # by how much it must exceed that without lag


def estimate_lags(
    cameras: Sequence[Camera], sightings: Sequence[Mapping[int, Sighting]], board: Board, longest: int = 150
) -> dict[int, int]:
    """Frames by which cameras (by index) are late against the camera that saw most boards; only those that are clearly
    not synchronous with it. Frame i + lag of such a camera shows what frame i of that one shows."""
    speeds = [_speed(c, s, board) for c, s in zip(cameras, sightings, strict=True)]
    base = int(np.argmax([len(s[0]) for s in speeds]))
    out = {}
    for c in range(len(cameras)):
        if c == base or len(speeds[c][0]) < _LEAST or len(speeds[base][0]) < _LEAST:
            continue
        step = float(np.median(np.diff(speeds[base][0])))
        tried = np.arange(-longest, longest + 1, max(1, round(step / 2)))
        scores = np.array([_correlation(speeds[base], speeds[c], int(lag), 2.5 * step) for lag in tried])
        if not np.isfinite(scores).any():
            continue
        best = int(np.nanargmax(scores))
        none = _correlation(speeds[base], speeds[c], 0, 2.5 * step)
        if scores[best] > _CLEAR and scores[best] > np.nan_to_num(none) + _BETTER and tried[best] != 0:
            out[c] = int(tried[best])
    return out


def _speed(camera: Camera, sightings: Mapping[int, Sighting], board: Board) -> tuple[Array, Array]:
    """Moments (n,) in frames and the board's middle's speed (n,) there, m per frame, from neighbouring looks."""
    frames = sorted(sightings)
    if len(frames) < 3:
        return np.zeros(0), np.zeros(0)
    middle = board.points.mean(0)[None]
    places = np.concatenate([transform(board_poses(camera, sightings[f], board.points)[0][0], middle) for f in frames])
    gap = np.diff(frames)
    near = gap <= 2 * np.median(gap)
    speed = np.linalg.norm(np.diff(places, axis=0), axis=1) / gap
    moments = np.array(frames[:-1]) + gap / 2
    return moments[near], speed[near]


def _correlation(base: tuple[Array, Array], other: tuple[Array, Array], lag: int, reach: float) -> float:
    """Correlation of the logarithms of the speeds, the other's taken `lag` frames later, where both are known."""
    when, value = base
    t = when + lag
    known = np.interp(t, other[0], other[1], left=np.nan, right=np.nan)
    after = np.clip(np.searchsorted(other[0], t), 1, len(other[0]) - 1)
    known[other[0][after] - other[0][after - 1] > reach] = np.nan  # a gap in which the board was not seen
    ok = np.isfinite(known)
    if ok.sum() < _LEAST:
        return float("nan")
    a, b = np.log(value[ok] + 1e-3), np.log(known[ok] + 1e-3)
    spread = float(a.std() * b.std())
    return float(((a - a.mean()) * (b - b.mean())).mean() / spread) if spread > 1e-9 else float("nan")
