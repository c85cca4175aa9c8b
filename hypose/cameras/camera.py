"""Pinhole cameras with lens distortion (OpenCV's model): projection of points, viewing rays, triangulation.

Pixel coordinates are (u to the right, v down); the centre of the upper left pixel is (0, 0). The undistorted image is
the one that the same camera would take without lens distortion.
"""

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
    """Calibrated pinhole camera with lens distortion.

    name: name of the camera.
    K: (3, 3) intrinsic matrix, px.
    distortion: (k,) OpenCV's coefficients k1 k2 p1 p2 [k3 ...]; four fisheye coefficients when `fisheye`.
    camera_from_world: (4, 4) rigid transform of points in the world to the camera's frame, m; its axes: x right, y
        down, z forward.
    size: image width and height, px.
    fisheye: whether the distortion is that of OpenCV's fisheye model.
    Raises: CalibrationError where K, distortion or camera_from_world is not finite or has the wrong shape, or where a
        focal length or the size is not positive.
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
        """Centre of the camera (3,) in the world, m."""
        return se3_inverse(self.camera_from_world)[:3, 3]

    @property
    def projection(self) -> Array:
        """Pinhole projection matrix K [R | t] (3, 4): points in the world, m, to undistorted px (homogeneous)."""
        return self.K @ self.camera_from_world[:3]

    def depths(self, points_world: ArrayLike) -> Array:
        """Compute how far points are in front of the camera, along its viewing direction (z).

        points_world: (..., 3) m.
        Returns: (...) m, negative behind the camera.
        """
        return np.asarray(points_world, dtype=np.float64) @ self.camera_from_world[2, :3] + self.camera_from_world[2, 3]

    def project(self, points_world: ArrayLike) -> Array:
        """Project points in the world to pixels of the camera's image, with lens distortion.

        points_world: (..., 3) m.
        Returns: (..., 2) px, also outside the image; NaN for points behind the camera.
        """
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
        """Compute the pixels at which directions in the camera's frame are seen, with lens distortion.

        directions: (N, 2) = (x / z, y / z) of points in the camera's frame.
        Returns: (N, 2) px of the camera's image.
        """
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
        """Project points in the world to pixels of the undistorted image.

        points_world: (..., 3) m.
        Returns: (..., 2) px, also outside the image; NaN for points behind the camera.
        """
        h = np.asarray(points_world, dtype=np.float64) @ self.projection[:, :3].T + self.projection[:, 3]
        z = np.where(h[..., 2:] > 1e-6, h[..., 2:], np.nan)
        return h[..., :2] / z

    def undistort_points(self, pixels: ArrayLike) -> Array:
        """Convert pixels of the camera's image to pixels of the undistorted image.

        pixels: (..., 2) px of the camera's image, with lens distortion.
        Returns: (..., 2) px of the undistorted image, which has the same K.
        """
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
        """Compute the viewing rays of pixels.

        pixels: (..., 2) px of the camera's image, with lens distortion.
        Returns: the camera centre (3,), m, where all rays begin, and their unit directions (..., 3), both in the world.
        """
        u = self.undistort_points(pixels)
        d = np.concatenate([u, np.ones((*u.shape[:-1], 1))], -1) @ np.linalg.inv(self.K).T
        d = d @ self.camera_from_world[:3, :3]
        return self.position, d / np.linalg.norm(d, axis=-1, keepdims=True)

    def scaled(self, size: tuple[int, int]) -> Camera:
        """Copy the camera for images that were resampled to another size.

        size: new (width, height), px.
        Returns: the camera with K and size of the resampled images; the place and the distortion stay.
        """
        sx, sy = size[0] / self.size[0], size[1] / self.size[1]
        k = np.diag([sx, sy, 1.0]) @ self.K
        k[0, 2] += 0.5 * sx - 0.5
        k[1, 2] += 0.5 * sy - 0.5
        return replace(self, K=k, size=(int(size[0]), int(size[1])))

    def pinhole(self) -> Camera:
        """Copy the camera without lens distortion: the camera of the undistorted image."""
        return replace(self, distortion=np.zeros(5), fisheye=False)

    def undistort_maps(
        self, size: tuple[int, int], image_size: tuple[int, int] | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Compute the two maps with which cv2.remap undistorts a stored image.

        size: (width, height) of the undistorted image, px; its camera is `self.scaled(size).pinhole()`.
        image_size: (width, height) of the stored image, px; None: `self.size`. An image of another size is taken for
            the whole image resampled, not for a part of it.
        Returns: map_x and map_y, float32 (height, width): the column and row in the stored image of each pixel of the
            undistorted one.
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
    """Cameras of one synchronised recording.

    cameras: C cameras, one per view of the recording, in the order of the views.
    Raises: CalibrationError where there is no camera or two cameras have the same name.
    """

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
        """Names of the C cameras."""
        return tuple(c.name for c in self.cameras)

    @property
    def projections(self) -> Array:
        """Pinhole projection matrix of each camera (C, 3, 4), see `Camera.projection`."""
        return self._made[0].copy()

    @property
    def positions(self) -> Array:
        """Centre of each camera (C, 3) in the world, m."""
        return self._made[1].copy()

    @property
    def sizes(self) -> NDArray[np.int64]:
        """Image width and height (C, 2), px."""
        return self._made[2].copy()

    @cached_property
    def _made(self) -> tuple[Array, Array, NDArray[np.int64]]:
        """Projections, positions and sizes, computed once because every frame needs them several times."""
        sizes = np.array([c.size for c in self.cameras], dtype=np.int64)
        return np.stack([c.projection for c in self.cameras]), np.stack([c.position for c in self.cameras]), sizes

    def select(self, names: Sequence[str]) -> CameraRig:
        """Make a rig of some of the cameras.

        names: names of the cameras, in the order of the new rig.
        Raises: CalibrationError that lists the names of the rig, where a name is not among them.
        """
        by_name = {c.name: c for c in self.cameras}
        missing = [n for n in names if n not in by_name]
        if missing:
            raise CalibrationError(
                f"The calibration has no camera {', '.join(missing)}; it has {', '.join(self.names)}. "
                "Rename the camera in recording.toml or in the calibration file."
            )
        return CameraRig(tuple(by_name[n] for n in names))

    def pinhole(self) -> CameraRig:
        """Copy the rig without lens distortion: the cameras of the undistorted images."""
        return CameraRig(tuple(c.pinhole() for c in self.cameras))

    def scaled(self, factor: float) -> CameraRig:
        """Copy the rig for images that were resampled.

        factor: factor of both sides of each image; the new sizes are rounded to whole pixels, at least 1.
        """
        return CameraRig(
            tuple(
                c.scaled((max(1, round(c.size[0] * factor)), max(1, round(c.size[1] * factor)))) for c in self.cameras
            )
        )


def triangulate(
    rig: CameraRig, pixels: ArrayLike, confidence: ArrayLike, min_views: int = 2
) -> tuple[Array, NDArray[np.int64]]:
    """Triangulate points from several views by linear least squares, weighted by confidence (direct linear transform).

    rig: C cameras.
    pixels: (C, ..., 2) px of the undistorted images.
    confidence: (C, ...) weight of each view of a point, >= 0; 0 where the view does not see it.
    min_views: least number of views from which a point is computed.
    Returns: points in the world (..., 3), m, NaN where fewer than `min_views` views see them; and the number of views
        that see each point (...).
    Source: Hartley and Zisserman 2004, section 12.2.
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
"""Sine of 15 degrees. Two viewing rays at a smaller angle hardly determine how far away their point is."""


def widest_angle(rig: CameraRig, pixels: ArrayLike, confidence: ArrayLike) -> Array:
    """Compute the sine of the largest angle between any two viewing rays of each point.

    rig: C cameras.
    pixels: (C, ..., 2) px of the undistorted images.
    confidence: (C, ...) 0 where the view does not see the point, else positive.
    Returns: (...) sines; 0 for points that fewer than two views see.
    """
    uv, seen = np.nan_to_num(np.asarray(pixels, dtype=np.float64)), np.asarray(confidence) > 0
    rays = np.stack([camera.rays(p)[1] for camera, p in zip(rig.pinhole(), uv, strict=True)])
    sine = np.linalg.norm(np.cross(rays[:, None], rays[None]), axis=-1)
    widest: Array = np.where(seen[:, None] & seen[None], sine, 0.0).max((0, 1))
    return widest
