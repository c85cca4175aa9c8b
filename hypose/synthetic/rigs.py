"""Camera rigs of the synthetic scenes: humaneva-4, humaneva-7, ixmas-5, court-4 and ring-N.

They follow the set-ups that the published figures come from: azimuths, heights, image sizes and the person's
apparent size, not the original calibrations.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import InputError
from hypose.geometry import Array, se3

RIG_NAMES = ("humaneva-4", "humaneva-7", "ixmas-5", "court-4", "ring-N")
DISTORTION = np.array([-0.18, 0.06, 0.0008, -0.0006, 0.0])
"""A common wide lens: barrel distortion of about 20 px in the corners of a 640x480 image."""
_HEIGHTS = (1.6, 2.0, 1.3, 1.8, 1.5, 1.9, 1.4, 2.2)


def look_at(
    name: str,
    position: ArrayLike,
    target: ArrayLike,
    focal_px: float,
    size: tuple[int, int],
    distortion: Array | None = None,
) -> Camera:
    """A camera at `position` (3,) m that looks at `target` (3,) m, upright."""
    c, t = np.asarray(position, dtype=np.float64), np.asarray(target, dtype=np.float64)
    forward = (t - c) / np.linalg.norm(t - c)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.999 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    r = np.stack([right, np.cross(forward, right), forward])
    k = np.array([[focal_px, 0, (size[0] - 1) / 2], [0, focal_px, (size[1] - 1) / 2], [0, 0, 1.0]])
    return Camera(name, k, np.zeros(5) if distortion is None else distortion, se3(r, -r @ c), size)


def circle(
    azimuths_deg: Sequence[float],
    radius: float,
    heights: Sequence[float],
    focal_px: float,
    size: tuple[int, int],
    target: ArrayLike = (0.0, 0.0, 0.95),
    distortion: Array | None = None,
) -> list[Camera]:
    """Cameras cam1, cam2, ... on a circle of `radius` m about the z axis that look at `target`."""
    return [
        look_at(
            f"cam{k + 1}",
            [radius * np.cos(np.radians(a)), radius * np.sin(np.radians(a)), h],
            target,
            focal_px,
            size,
            distortion,
        )
        for k, (a, h) in enumerate(zip(azimuths_deg, heights, strict=True))
    ]


def rig(name: str, *, distorted: bool = False) -> CameraRig:
    """A rig by name: humaneva-4, humaneva-7, ixmas-5, court-4, or ring-N with N from 1 to 16.

    The volume is centred at the world's origin; a person within about 1 m of it (court-4: 3 m) is seen whole
    by every camera. distorted: with the lens distortion DISTORTION instead of ideal pinholes. humaneva-*:
    640x480, indoor corners, 4.1 m away, the person about 270 px tall. ixmas-5: 390x291, four cameras high on
    the walls and one overhead. court-4: 640x480, 14 m away in the court's corners 5 m up, the person about 80
    px tall.
    """
    d = DISTORTION if distorted else None
    ring = re.fullmatch(r"ring-(\d+)", name)
    if name == "humaneva-4":
        cameras = circle((35, 145, 215, 325), 4.1, _HEIGHTS[:4], 600, (640, 480), distortion=d)
    elif name == "humaneva-7":
        azimuths = (35, 145, 215, 325, 5, 120, 245)
        cameras = circle(azimuths, 4.1, _HEIGHTS[:7], 600, (640, 480), distortion=d)
    elif name == "ixmas-5":
        cameras = circle((20, 70, 150, 225), 3.8, (2.0, 2.5, 1.8, 2.3), 340, (390, 291), distortion=d)
        cameras.append(look_at("cam5", (0.25, 0.45, 4.9), (0.0, 0.0, 0.9), 330, (390, 291), d))
    elif name == "court-4":
        cameras = circle((40, 140, 220, 320), 13.5, (5.0, 5.0, 5.0, 5.0), 640, (640, 480), distortion=d)
    elif ring and 1 <= int(ring[1]) <= 16:
        n = int(ring[1])
        azimuths = [20 + 360 * k / n for k in range(n)]
        cameras = circle(azimuths, 4.1, [_HEIGHTS[k % 8] for k in range(n)], 600, (640, 480), distortion=d)
    else:
        raise InputError(
            f"There is no camera rig {name!r}; the rigs are {', '.join(RIG_NAMES)} (N = 1 to 16 cameras in a ring)."
        )
    return CameraRig(tuple(cameras))
