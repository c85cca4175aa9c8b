"""Convert depth pictures into the input of forests, and refuse unusable ones with a clear message."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.forests import DepthImage
from hypose.errors import InputError, refuse

_SMALLEST, _LARGEST = 32, 4096
"""Least and largest side of a picture, px."""
_NEAR_METRES = 20.0


@dataclass(frozen=True)
class DepthLens:
    """Pinhole model of a depth camera.

    fx, fy: focal lengths, px; fx scales the tests.
    cx, cy: principal point, px.
    Raises: InputError where a value is implausible.
    """

    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        if not all(np.isfinite([self.fx, self.fy, self.cx, self.cy])) or not 20 <= self.fx <= 20000 or self.fy <= 0:
            raise InputError(
                f"The depth camera's lens (fx {self.fx}, fy {self.fy}, cx {self.cx}, cy {self.cy}) is unusable; give fx"
                " and fy between 20 and 20000 pixels and the picture's centre."
            )

    def point(self, x: float, y: float, depth_m: float) -> NDArray[np.float64]:
        """Compute the point (3,) m in the camera's frame (x right, y down, z forward) at pixel (x, y) and depth_m."""
        return np.array([(x - self.cx) / self.fx * depth_m, (y - self.cy) / self.fy * depth_m, depth_m])

    def scaled(self, factor: float) -> DepthLens:
        """Return the lens of the picture resized by `factor`; the centres of pixels are at whole numbers."""
        cx, cy = (self.cx + 0.5) * factor - 0.5, (self.cy + 0.5) * factor - 0.5
        return DepthLens(self.fx * factor, self.fy * factor, cx, cy)


KINECT = DepthLens(575.8, 575.8, 319.5, 239.5)
"""Nominal lens of the first Kinect's depth camera at 640 x 480."""


def millimetres(depth: ArrayLike, where: str = "The depth picture") -> DepthImage:
    """Convert a depth picture (h, w) to uint16 millimetres, 0 = hole.

    depth: whole numbers in millimetres, or floats in metres.
    where: name of the picture in messages.
    Raises: InputError where it is not a picture, or its values cannot be in that unit.
    """
    d = np.asarray(depth)
    if d.ndim != 2 or not all(_SMALLEST <= n <= _LARGEST for n in d.shape):
        raise InputError(
            f"{where} has shape {d.shape}; a depth picture is (height, width) with {_SMALLEST} to {_LARGEST} pixels a "
            "side."
        )
    if d.dtype.kind == "f":
        v = np.nan_to_num(np.asarray(d, dtype=np.float64), nan=0.0, posinf=0.0, neginf=0.0)
        top = float(v.max())
        if top > 200:  # metres reach 65 m at most; a room in millimetres starts at hundreds
            raise InputError(
                f"{where} holds floating-point numbers up to {top:.0f}, which cannot be metres; give metres as floats "
                "or millimetres as 16-bit whole numbers."
            )
        return np.clip(np.rint(v * 1000), 0, 65535).astype(np.uint16)
    if d.dtype.kind not in "iu":
        raise InputError(f"{where} holds {d.dtype}; give metres as floats or millimetres as whole numbers.")
    top, low = int(d.max()), int(d.min())
    faults = {
        f" holds values from {low} to {top}; millimetres lie between 0 (no measurement) and 65535": (
            low < 0 or top > 65535
        ),
        f" holds whole numbers up to {top}: that is metres, and whole numbers must be millimetres; multiply the metres "
        "by 1000 before rounding, or give them as floats": 0 < top <= _NEAR_METRES,
    }
    refuse(where, faults)
    return np.ascontiguousarray(d, dtype=np.uint16)


def surface_depth(depth: DepthImage, x: float, y: float, radius: int = 6, near_mm: int = 400) -> float | None:
    """Compute the depth of the nearer surface around a pixel: the 30th percentile of a window.

    depth: (h, w) picture, mm.
    x, y: pixel.
    radius: half side of the window, px.
    near_mm: smaller values do not count.
    Returns: mm; None where the window has fewer than 5 values.
    """
    i, j = round(y), round(x)
    window = depth[max(0, i - radius) : max(0, i + radius + 1), max(0, j - radius) : max(0, j + radius + 1)]
    values = window[window >= near_mm]
    return None if len(values) < 5 else float(np.percentile(values, 30))
