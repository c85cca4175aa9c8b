"""What each camera adds to a motion, and where another one would help most, by geometry: which joints a camera sees, at
which angle, how large. Noise is the same share of every picture's width; what covers what is not counted.

A joint's information is the sum over the cameras that have it in their picture, J^T J / s^2 with J (2, 3) the
derivative of its pixel; without a camera it is the sum of the others. A weak prior keeps what is left open finite.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.body.motion import Motion
from hypose.cameras.camera import CameraRig
from hypose.geometry import Array
from hypose.pipeline.settings import SETTINGS


@dataclass(frozen=True)
class CameraWorth:
    """name; times: how many times the standard deviation of a joint grows without this camera (root mean square over
    joints and frames); thin: share of the joints in which fewer than two cameras are left."""

    name: str
    times: float
    thin: float


@dataclass(frozen=True)
class BestPlace:
    """Where one more camera helps most: azimuth rad about the person from the world's x, place (3,) m, and how many
    times the standard deviation of a joint shrinks to."""

    azimuth: float
    place: Array
    times: float


def camera_worth(motion: Motion, rig: CameraRig) -> tuple[list[CameraWorth], BestPlace | None]:
    """Every camera of a rig of two or more, and the best place for one more; nothing of fewer, or of a motion without
    known frames. The new camera is as far away, as high and has the lens of the median of those there are."""
    points = _points(motion)
    if len(rig) < 2 or not len(points):
        return [], None
    pinhole = rig.pinhole()
    seen, information = zip(*(_information(points, c.K, c.camera_from_world, c.size) for c in pinhole), strict=True)
    views, each = np.array(seen), np.array(information)
    whole = each.sum(0)
    now = _spread(whole)
    out = []
    for c, camera in enumerate(pinhole):
        mine = views[c]
        thin = float((mine & (views.sum(0) - mine < 2)).mean())
        out.append(CameraWorth(camera.name, _spread(whole - each[c]) / now, thin))
    return out, _best_place(points, pinhole, whole, now)


def _best_place(points: Array, rig: CameraRig, whole: Array, now: float) -> BestPlace:
    middle = np.median(points, axis=0)
    places = np.array([c.position for c in rig])
    away = float(np.median(np.linalg.norm((places - middle)[:, :2], axis=1)))
    height = float(np.median(places[:, 2]))
    lens = sorted(rig, key=lambda c: c.K[0, 0] / max(c.size))[len(rig) // 2]
    tried = []
    for azimuth in np.linspace(-np.pi, np.pi, SETTINGS.worth_places, endpoint=False).tolist():
        place = np.array([middle[0] + away * np.cos(azimuth), middle[1] + away * np.sin(azimuth), height])
        _, more = _information(points, lens.K, _looking(place, middle), lens.size)
        tried.append(BestPlace(azimuth, place, _spread(whole + more) / now))
    return min(tried, key=lambda p: p.times)


def _points(motion: Motion) -> Array:
    """(N, 3) m: joints of frames that are known."""
    known = np.flatnonzero(~(motion.lost | motion.extrapolated).astype(bool) & np.isfinite(motion.joints).all((1, 2)))
    chosen = (
        known[np.linspace(0, len(known) - 1, min(SETTINGS.worth_frames, len(known))).astype(int)]
        if len(known)
        else known
    )
    return np.asarray(motion.joints[chosen], dtype=np.float64).reshape(-1, 3)


def _information(
    points: Array, k: Array, camera_from_world: Array, size: tuple[int, int]
) -> tuple[NDArray[np.bool_], Array]:
    """Seen (N,) and information (N, 3, 3) 1/m^2 of points (N, 3) in one pinhole camera."""
    local = points @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
    z = np.where(local[:, 2] > 0.05, local[:, 2], np.nan)
    uv = local[:, :2] / z[:, None] * [k[0, 0], k[1, 1]] + k[:2, 2]
    with np.errstate(invalid="ignore"):
        seen = np.isfinite(z) & (uv >= 0).all(1) & (uv < np.array(size)).all(1)
    derivative = np.zeros((len(points), 2, 3))
    derivative[:, 0, 0], derivative[:, 1, 1] = k[0, 0] / z, k[1, 1] / z
    derivative[:, :, 2] = -local[:, :2] / z[:, None] ** 2 * [k[0, 0], k[1, 1]]
    j = np.where(seen[:, None, None], derivative @ camera_from_world[:3, :3], 0.0) / (SETTINGS.worth_noise * max(size))
    return np.asarray(seen, dtype=np.bool_), np.swapaxes(j, 1, 2) @ j


def _spread(information: Array) -> float:
    """m: root mean square over the points of their standard deviation per axis."""
    covariance = np.linalg.inv(information + np.eye(3) / SETTINGS.worth_prior**2)
    return float(np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean() / 3))


def _looking(place: Array, at: Array) -> Array:
    """camera_from_world (4, 4) of an upright camera."""
    z = (at - place) / np.linalg.norm(at - place)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z])
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, -rotation @ place
    return out
