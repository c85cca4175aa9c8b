"""What goes wrong with the key points of real detectors, done to the key points of a scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.evidence.frame import Frame, Keypoints
from hypose.geometry import Array, se3, so3_exp

_CHAINS = (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle", "big_toe", "small_toe", "heel"))


def _size(points: Array) -> Array:
    """(C,) px: the person's usual height in each view of points (T, C, K, 3)."""
    seen = points[..., 2] > 0.3
    high = np.where(seen, points[..., 1], -np.inf).max(2)
    low = np.where(seen, points[..., 1], np.inf).min(2)
    height = np.where(seen.sum(2) > 5, high - low, np.nan)
    return np.nan_to_num(np.nanmedian(np.where(np.isfinite(height), height, np.nan), axis=0), nan=100.0)


def _slow(rng: np.random.Generator, shape: tuple[int, ...], every: int) -> Array:
    """Noise of sd 1 over the first axis, correlated over `every` frames."""
    knots = rng.normal(size=(shape[0] // every + 3, *shape[1:]))
    at = np.arange(shape[0]) / every
    low = at.astype(int)
    s = (at - low).reshape(-1, *[1] * (len(shape) - 1))
    return ((1 - s) * knots[low] + s * knots[low + 1]) / np.sqrt((1 - s) ** 2 + s**2)


def _stretches(rng: np.random.Generator, frames: int, share: float, length: int) -> NDArray[np.bool_]:
    """(T,) bool: stretches of about `length` frames that fill about a share of the clip."""
    out = np.zeros(frames, dtype=bool)
    for _ in range(int(rng.poisson(share * frames / length))):
        first = int(rng.integers(-length + 1, frames))
        out[max(first, 0) : first + int(rng.integers(length // 2, 2 * length))] = True
    return out


def detector(points: Array, names: Sequence[str], rng: np.random.Generator) -> Array:
    """Errors as a detector's: correlated in time, 3 % of the points elsewhere on the person, 5 % missing, sides of a
    limb exchanged now and then. points (T, C, K, 3)."""
    out, size = points.copy(), _size(points)
    t, c, k, _ = out.shape
    out[..., :2] += _slow(rng, (t, c, k, 2), 8) * (0.02 * size)[None, :, None, None]
    wild = rng.random((t, c, k)) < 0.03
    to = rng.integers(0, k, (t, c, k))
    elsewhere = np.take_along_axis(points[..., :2], to[..., None].repeat(2, -1), 2)
    out[..., :2] = np.where(wild[..., None], elsewhere, out[..., :2])
    out[rng.random((t, c, k)) < 0.05] = 0.0
    return swapped(out, names, rng, 0.05)


def like_a_detector(
    points: Array, names: Sequence[str], rng: np.random.Generator, frame_rate: float, sd_px: float = 4.0
) -> Array:
    """Errors as a detector's in pixels of the pictures, however large the person: sd_px per axis, correlated over
    0.2 s, 3 % of the points ten times as far off, 5 % missing, the sides of a limb exchanged in bursts that fill 5 %.
    Scores say nothing of it. points (T, C, K, 3) at frame_rate Hz."""
    out = points.copy()
    t, c, k, _ = out.shape
    error = sd_px * _slow(rng, (t, c, k, 2), max(1, round(0.2 * frame_rate)))
    angle = rng.uniform(0, 2 * np.pi, (t, c, k))
    far = 10 * sd_px * np.stack([np.cos(angle), np.sin(angle)], -1)
    out[..., :2] += np.where((rng.random((t, c, k)) < 0.03)[..., None], far, error)
    out[..., 2] = np.where(points[..., 2] > 0, np.clip(rng.normal(0.8, 0.08, (t, c, k)), 0.05, 1.0), 0.0)
    out[(rng.random((t, c, k)) < 0.05) | (points[..., 2] <= 0)] = 0.0
    return swapped(out, names, rng, 0.05)


def dropped(points: Array, names: Sequence[str], rng: np.random.Generator) -> Array:
    """60 % of the points missing."""
    return np.where(rng.random(points.shape[:3])[..., None] < 0.6, 0.0, points)


def swapped(points: Array, names: Sequence[str], rng: np.random.Generator, share: float = 0.3) -> Array:
    """Left and right of a limb's points exchanged, in stretches that fill about a share of each view."""
    out, column = points.copy(), {n: i for i, n in enumerate(names)}
    for view in range(points.shape[1]):
        for chain in _CHAINS:
            at = _stretches(rng, len(points), share, 12)
            for part in chain:
                a, b = column.get(f"left_{part}"), column.get(f"right_{part}")
                if a is not None and b is not None:
                    out[at, view, a], out[at, view, b] = points[at, view, b], points[at, view, a]
    return out


def shifted(points: Array, names: Sequence[str], rng: np.random.Generator) -> Array:
    """One view's points off by 8 % of the person's height."""
    out, view = points.copy(), int(rng.integers(points.shape[1]))
    angle = rng.uniform(0, 2 * np.pi)
    out[:, view, :, :2] += 0.08 * _size(points)[view] * np.array([np.cos(angle), np.sin(angle)])
    return np.where(points[..., 2:] > 0, out, 0.0)


def late(points: Array, names: Sequence[str], rng: np.random.Generator) -> Array:
    """One view's points six frames late."""
    out, view = points.copy(), int(rng.integers(points.shape[1]))
    out[6:, view], out[:6, view] = points[:-6, view], points[0, view]
    return out


def noisy(points: Array, names: Sequence[str], rng: np.random.Generator) -> Array:
    """Scatter of 4 % of the person's height, half of it slow."""
    out = points.copy()
    noise = (_slow(rng, out[..., :2].shape, 8) + rng.normal(size=out[..., :2].shape)) / np.sqrt(2)
    out[..., :2] += noise * (0.04 * _size(points))[None, :, None, None]
    return np.where(points[..., 2:] > 0, out, 0.0)


def outliers(points: Array, names: Sequence[str], rng: np.random.Generator) -> Array:
    """15 % of the points anywhere on the person, as confident as the others."""
    out, (t, c, k, _) = points.copy(), points.shape
    to = rng.integers(0, k, (t, c, k))
    elsewhere = np.take_along_axis(points, to[..., None].repeat(3, -1), 2)
    return np.where((rng.random((t, c, k)) < 0.15)[..., None], elsewhere, out)


def hidden_arm(points: Array, names: Sequence[str], rng: np.random.Generator) -> Array:
    """Elbow and wrist of one side not seen in stretches that fill about 40 % of the clip."""
    out, side = points.copy(), "left" if rng.random() < 0.5 else "right"
    at = _stretches(rng, len(points), 0.4, 20)
    for part in ("elbow", "wrist"):
        if f"{side}_{part}" in names:
            out[at, :, list(names).index(f"{side}_{part}")] = 0.0
    return out


def guessed(points: Array, names: Sequence[str], rng: np.random.Generator) -> Array:
    """One limb in one or two views where it is not, as sure as what is seen: detectors without a score for what they
    cannot see guess it, and go on guessing. For the whole clip, or in stretches that fill about 40 % of it."""
    out, size, views = points.copy(), _size(points), points.shape[1]
    limb = _limb(names, rng)
    for view in rng.permutation(views)[: int(rng.integers(1, 3))].tolist():
        at = np.ones(len(points), bool) if rng.random() < 0.5 else _stretches(rng, len(points), 0.4, 20)
        out[:, view] = _guess(points[:, view], limb, at, float(size[view]), rng)
    return out


def close_up(points: Array, names: Sequence[str], rng: np.random.Generator) -> Array:
    """One limb, or both legs, in the pictures of two views only, and mostly guessed in one of these two."""
    out, size = points.copy(), _size(points)
    part = _limb(names, rng)
    if rng.random() < 0.5:
        part = [k for k, n in enumerate(names) if n.endswith(_CHAINS[1][1:])]
    two = rng.permutation(points.shape[1])[:2]
    out[:, np.setdiff1d(np.arange(points.shape[1]), two)[:, None], part] = 0.0
    if rng.random() < 0.7:
        view, always = int(two[0]), np.ones(len(points), bool)
        out[:, view] = _guess(out[:, view], part, always, float(size[view]), rng)
    return out


def _limb(names: Sequence[str], rng: np.random.Generator) -> list[int]:
    """Columns of one limb's points, without its root."""
    chain, side = _CHAINS[int(rng.integers(2))][1:], "left" if rng.random() < 0.5 else "right"
    return [k for k, n in enumerate(names) if n.removeprefix(f"{side}_") in chain]


def _guess(points: Array, part: list[int], at: NDArray[np.bool_], size: float, rng: np.random.Generator) -> Array:
    """Points (T, K, 3) of one view with those of a part off by about a sixth of the height at these frames, the same
    way for long, more so further from the root."""
    out, t = points.copy(), len(points)
    angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(0.06, 0.25) * size
    way = far * np.array([np.cos(angle), np.sin(angle)]) + 0.04 * size * _slow(rng, (t, 2), 15)
    reach = np.linspace(0.6, 1.1, max(len(part), 1))
    for k, share in zip(part, reach, strict=False):
        out[at, k, :2] += share * way[at]
    return np.where(points[..., 2:] > 0, out, 0.0)


def bystander(points: Array, names: Sequence[str], rng: np.random.Generator) -> Array:
    """In one view the points of somebody else, who does the same a little later and 60 % of the height aside, in
    stretches that fill about 40 % of the clip."""
    out, view = points.copy(), int(rng.integers(points.shape[1]))
    at = _stretches(rng, len(points), 0.4, 12)
    other = points[np.maximum(np.arange(len(points)) - 5, 0), view].copy()
    other[..., 0] += 0.6 * _size(points)[view] * rng.choice((-1, 1))
    out[at, view] = np.where(other[at, :, 2:] > 0, other[at], 0.0)
    return out


SPOILS: Mapping[str, Callable[[Array, Sequence[str], np.random.Generator], Array]] = {
    "detector": detector,
    "dropped": dropped,
    "swapped": swapped,
    "shifted": shifted,
    "late": late,
    "noisy": noisy,
    "outliers": outliers,
    "hidden_arm": hidden_arm,
    "guessed": guessed,
    "close_up": close_up,
    "bystander": bystander,
}
"""All of them by name. `moved_camera` is the calibration's."""


def spoilt(frames: Sequence[Frame], how: str, rng: np.random.Generator) -> list[Frame]:
    """The frames of a scene with their key points spoilt; an InputError lists the ways."""
    if how not in SPOILS:
        raise InputError(f"Key points cannot be spoilt by {how!r}; choose one of {', '.join(SPOILS)}.")
    known = [f.keypoints for f in frames if f.keypoints is not None]
    if len(known) != len(frames):
        raise InputError("Only frames that all carry key points can have them spoilt; make the scene with them.")
    points = SPOILS[how](np.stack([k.points for k in known]), known[0].names, rng)
    return [replace(f, keypoints=Keypoints(p, k.names, k.rig)) for f, k, p in zip(frames, known, points, strict=True)]


def moved_camera(
    rig: CameraRig, view: int, rng: np.random.Generator, metres: float = 0.06, degrees: float = 1.5
) -> CameraRig:
    """The rig with one camera elsewhere than it is: as after somebody has knocked against it."""
    axis, way = rng.normal(size=3), rng.normal(size=3)
    turn = so3_exp(np.radians(degrees) * axis / np.linalg.norm(axis))
    knock = se3(turn, metres * way / np.linalg.norm(way))
    cameras = list(rig)
    cameras[view] = replace(cameras[view], camera_from_world=knock @ cameras[view].camera_from_world)
    return CameraRig(tuple(cameras))
