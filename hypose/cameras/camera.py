"""Camera and CameraRig: pinhole cameras with lens distortion (OpenCV's model), world <-> pixel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.errors import CalibrationError
from hypose.geometry import Array, se3_inverse


@dataclass(frozen=True)
class Camera:
    """One camera.

    name.
    K (3, 3) px.
    distortion (k,) OpenCV coefficients (k1 k2 p1 p2 [k3 ...]; four fisheye coefficients when `fisheye`).
    camera_from_world (4, 4) m, x right, y down, z forward.
    size (width, height) px. Pixel centres lie at integer coordinates.
    """

    name: str
    K: Array
    distortion: Array
    camera_from_world: Array
    size: tuple[int, int]
    fisheye: bool = False

    def __post_init__(self) -> None:
        shapes = {"K": (3, 3), "camera_from_world": (4, 4)}
        for field_name, shape in shapes.items():
            value = getattr(self, field_name)
            if np.shape(value) != shape or not np.isfinite(value).all():
                raise CalibrationError(
                    f"Camera {self.name}: {field_name} must be a finite {shape} matrix, got shape {np.shape(value)}; "
                    "check this camera's entry in the calibration file."
                )
        if not np.isfinite(self.distortion).all():
            raise CalibrationError(
                f"Camera {self.name}: the distortion coefficients are not finite; check the calibration file."
            )
        if self.K[0, 0] <= 0 or self.K[1, 1] <= 0 or min(self.size) <= 0:
            raise CalibrationError(
                f"Camera {self.name}: focal lengths and image size must be positive, got f = ({self.K[0, 0]:g}, "
                f"{self.K[1, 1]:g}) and size {self.size}; check this camera's entry in the calibration file."
            )

    @property
    def position(self) -> Array:
        """Return (3,) camera centre in the world, m."""
        return se3_inverse(self.camera_from_world)[:3, 3]

    @property
    def projection(self) -> Array:
        """Return (3, 4) pinhole projection K [R | t] (no distortion)."""
        return self.K @ self.camera_from_world[:3]

    def project(self, points_world: ArrayLike) -> Array:
        """Pixels (..., 2) of points_world (..., 3), with lens distortion; NaN behind the camera."""
        p = np.asarray(points_world, dtype=np.float64)
        flat = p.reshape(-1, 3) @ self.camera_from_world[:3, :3].T + self.camera_from_world[:3, 3]
        front = flat[:, 2] > 1e-6
        behind = not front.all()
        if behind:
            flat[~front] = 0.0, 0.0, 1.0
        uv = self.through_lens(flat[:, :2] / flat[:, 2:])
        if behind:
            uv[~front] = np.nan
        return uv.reshape(*p.shape[:-1], 2)

    def through_lens(self, directions: Array) -> Array:
        """Pixels (N, 2) of points (N, 2) at depth 1 before the camera, with lens distortion."""
        if len(directions) == 0:
            return np.zeros((0, 2))
        if self.fisheye or len(self.distortion) > 8:  # thin prisms and tilted sensors
            points, zero = np.column_stack([directions, np.ones(len(directions))])[:, None], np.zeros(3)
            if self.fisheye:
                uv = cv2.fisheye.projectPoints(points, zero, zero, self.K, self.distortion[:4])[0]
            else:
                uv = cv2.projectPoints(points, zero, zero, self.K, self.distortion)[0]
            return np.asarray(uv, dtype=np.float64).reshape(-1, 2)
        # as OpenCV's projectPoints, which computes derivatives that are not needed and takes ten times as long
        x, y = u, v = np.ascontiguousarray(directions.T)
        if self.distortion.any():
            k1, k2, p1, p2, k3, k4, k5, k6 = np.concatenate([np.ravel(self.distortion), np.zeros(8)])[:8]
            r2 = x * x + y * y
            radial = (1 + ((k3 * r2 + k2) * r2 + k1) * r2) / (1 + ((k6 * r2 + k5) * r2 + k4) * r2)
            u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
            v = y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)
        return np.stack([self.K[0, 0] * u + self.K[0, 2], self.K[1, 1] * v + self.K[1, 2]], axis=1)

    def project_pinhole(self, points_world: ArrayLike) -> Array:
        """Undistorted pixels (..., 2) of points_world (..., 3); NaN behind the camera."""
        h = np.asarray(points_world, dtype=np.float64) @ self.projection[:, :3].T + self.projection[:, 3]
        z = np.where(h[..., 2:] > 1e-6, h[..., 2:], np.nan)
        return h[..., :2] / z

    def undistort_points(self, pixels: ArrayLike) -> Array:
        """Distorted pixels (..., 2) -> pixels of the ideal pinhole camera with the same K."""
        p = np.asarray(pixels, dtype=np.float64)
        if p.size == 0:
            return p.copy()
        flat = p.reshape(-1, 1, 2)
        if self.fisheye:
            out = cv2.fisheye.undistortPoints(flat, self.K, self.distortion[:4], P=self.K)
        else:
            criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-9)
            out = cv2.undistortPoints(flat, self.K, self.distortion, None, np.eye(3), self.K, criteria)
        return np.asarray(out, dtype=np.float64).reshape(p.shape)

    def rays(self, pixels: ArrayLike) -> tuple[Array, Array]:
        """Viewing rays of distorted pixels (..., 2): (origin (3,), unit directions (..., 3)) in the world."""
        u = self.undistort_points(pixels)
        d = np.concatenate([u, np.ones((*u.shape[:-1], 1))], -1) @ np.linalg.inv(self.K).T
        d = d @ self.camera_from_world[:3, :3]
        return self.position, d / np.linalg.norm(d, axis=-1, keepdims=True)

    def scaled(self, size: tuple[int, int]) -> Camera:
        """Return the same camera with images resampled to size (width, height); pixel centres at integers are kept."""
        sx, sy = size[0] / self.size[0], size[1] / self.size[1]
        k = np.diag([sx, sy, 1.0]) @ self.K
        k[0, 2] += 0.5 * sx - 0.5
        k[1, 2] += 0.5 * sy - 0.5
        return replace(self, K=k, size=(int(size[0]), int(size[1])))

    def pinhole(self) -> Camera:
        """Return the same camera without lens distortion."""
        return replace(self, distortion=np.zeros(5), fisheye=False)

    def undistort_maps(
        self, size: tuple[int, int], image_size: tuple[int, int] | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Maps for cv2.remap from a stored image of `image_size` (default: self.size) to the undistorted image of
        the pinhole camera `self.scaled(size).pinhole()`: (map_x, map_y) float32 (h, w).

        A stored image of another size than the calibration is taken as scaled (not cropped).
        """
        target = self.scaled(size)
        if self.fisheye:
            mx, my = cv2.fisheye.initUndistortRectifyMap(
                self.K, self.distortion[:4], np.eye(3), target.K, size, cv2.CV_32FC1
            )
        else:
            mx, my = cv2.initUndistortRectifyMap(self.K, self.distortion, np.eye(3), target.K, size, cv2.CV_32FC1)
        w, h = image_size or self.size
        if (w, h) != self.size:
            mx = (mx + 0.5) * (w / self.size[0]) - 0.5
            my = (my + 0.5) * (h / self.size[1]) - 0.5
        return np.asarray(mx, dtype=np.float32), np.asarray(my, dtype=np.float32)


@dataclass(frozen=True)
class CameraRig:
    """Several cameras of one synchronised recording, in the order of the recording's views."""

    cameras: tuple[Camera, ...]

    def __post_init__(self) -> None:
        names = [c.name for c in self.cameras]
        if not names:
            raise CalibrationError("The camera rig is empty; at least one calibrated camera is needed.")
        if len(set(names)) < len(names):
            raise CalibrationError(f"Camera names must differ, got {names}; rename one in the calibration file.")

    def __len__(self) -> int:
        return len(self.cameras)

    def __iter__(self) -> Iterator[Camera]:
        return iter(self.cameras)

    def __getitem__(self, index: int) -> Camera:
        return self.cameras[index]

    @property
    def names(self) -> tuple[str, ...]:
        """Return the C camera names."""
        return tuple(c.name for c in self.cameras)

    @property
    def projections(self) -> Array:
        """Return (C, 3, 4) pinhole projection matrices."""
        return self._made[0].copy()

    @property
    def positions(self) -> Array:
        """Return (C, 3) camera centres in the world, m."""
        return self._made[1].copy()

    @property
    def sizes(self) -> NDArray[np.int64]:
        """Return (C, 2) image width and height, px."""
        return self._made[2].copy()

    @cached_property
    def _made(self) -> tuple[Array, Array, NDArray[np.int64]]:
        """Projections, positions and sizes, which every frame asks for several times."""
        sizes = np.array([c.size for c in self.cameras], dtype=np.int64)
        return np.stack([c.projection for c in self.cameras]), np.stack([c.position for c in self.cameras]), sizes

    def select(self, names: Sequence[str]) -> CameraRig:
        """Return the rig of the named cameras in that order; a CalibrationError lists what exists."""
        by_name = {c.name: c for c in self.cameras}
        missing = [n for n in names if n not in by_name]
        if missing:
            raise CalibrationError(
                f"The calibration has no camera {', '.join(missing)}; it has {', '.join(self.names)}. "
                "Rename the camera in recording.toml or in the calibration file."
            )
        return CameraRig(tuple(by_name[n] for n in names))

    def pinhole(self) -> CameraRig:
        """Return the same rig without lens distortion."""
        return CameraRig(tuple(c.pinhole() for c in self.cameras))

    def scaled(self, factor: float) -> CameraRig:
        """Return the rig with every image resampled by `factor` (sizes rounded to whole pixels)."""
        return CameraRig(
            tuple(
                c.scaled((max(1, round(c.size[0] * factor)), max(1, round(c.size[1] * factor)))) for c in self.cameras
            )
        )


def triangulate(
    rig: CameraRig, pixels: ArrayLike, confidence: ArrayLike, min_views: int = 2
) -> tuple[Array, NDArray[np.int64]]:
    """Confidence-weighted linear triangulation (DLT).

    pixels (C, ..., 2) undistorted px of the rig's pinhole cameras.
    confidence (C, ...) >= 0, 0 = not seen.

    Returns points_world (..., 3), NaN with fewer than min_views views, and the number of views (...). Source: Hartley &
    Zisserman 2004, section 12.2.
    """
    uv, w = np.asarray(pixels, dtype=np.float64), np.asarray(confidence, dtype=np.float64)
    w = np.where(np.isfinite(uv).all(-1), w, 0.0)
    uv = np.nan_to_num(uv)
    rows = []
    for c, p in enumerate(rig.projections):
        s = (w[c] / np.linalg.norm(p[:2, :3]))[..., None]
        rows += [s * (uv[c, ..., :1] * p[2] - p[0]), s * (uv[c, ..., 1:] * p[2] - p[1])]
    v = np.linalg.svd(np.stack(rows, -2))[2][..., -1, :]
    n = (w > 0).sum(0)
    with np.errstate(divide="ignore", invalid="ignore"):
        points = v[..., :3] / v[..., 3:]
    return np.where((n >= min_views)[..., None], points, np.nan), n


PARALLEL = 0.26
"""Sine of the angle between two rays (15 degrees) below which they hardly tell how far away their point is."""


def widest_angle(rig: CameraRig, pixels: ArrayLike, confidence: ArrayLike) -> Array:
    """Return (...) sine of the angle between those two rays through pixels (C, ..., 2) with confidence (C, ...) > 0
    that are least parallel; undistorted px of the rig's pinhole cameras; 0 with fewer than two."""
    uv, seen = np.nan_to_num(np.asarray(pixels, dtype=np.float64)), np.asarray(confidence) > 0
    rays = np.stack([camera.rays(p)[1] for camera, p in zip(rig.pinhole(), uv, strict=True)])
    sine = np.linalg.norm(np.cross(rays[:, None], rays[None]), axis=-1)
    widest: Array = np.where(seen[:, None] & seen[None], sine, 0.0).max((0, 1))
    return widest
