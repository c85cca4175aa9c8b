"""Simulate recordings of depth cameras: a known person who moves in a room with floor, walls and furniture.

The person is of another shape space than the tracker's body. The faults are those of time-of-flight sensors: noise that
grows with the square of the distance and at grazing angles, values between both sides of an edge (flying pixels), light
that arrives by other paths (multipath), a fixed pattern, holes in hair and at grazing surfaces, and interference by
other sensors. The parameters are checked against real frames in docs/depth.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import Camera, CameraRig
from hypose.compute.zbuffer import rasterize
from hypose.errors import InputError
from hypose.geometry import Array, DepthMap, so3_exp
from hypose.synthetic.performance import OfPerformance, Performance, assemble
from hypose.synthetic.scenes import box_mesh, circle, joined_meshes, smooth_noise
from hypose.synthetic.subjects import SyntheticSubject

KINECT_SIZE, FOCAL_PX = (320, 288), 252.0
"""Image size (px) and focal length (px) of the Azure Kinect's narrow binned mode."""
AZIMUTHS = {1: (0.0,), 2: (0.0, 90.0), 3: (0.0, 120.0, 240.0)}
"""By number of sensors, their azimuths in degrees, from straight in front of a person who faces -y towards the person's
left.
"""
_PATTERN, _EMPTY, _FRAME = range(3)


_CONSTANT_M, _SQUARE = 0.0015, 0.0012
"""The sd of a value is _CONSTANT_M + _SQUARE z^2, m."""
_PATTERN_M = 0.003
"""Sd of the fixed smooth pattern, m."""
_MULTIPATH = 0.02
"""Share of the surrounding depth that is mixed into a value."""
_FLYING, _HOLES, _HAIR = 0.6, 0.003, 0.25
"""Share of the pixels on an edge whose value lies between both sides (half of them are holes), and shares of holes: of
all pixels at random, and of those on the crown of the head."""
_GRAZING = 0.2
"""Cosine between ray and normal below which holes begin."""
_DISTURBED = 0.05
"""Share of the rows of a frame that each other sensor disturbs; there noise is three times as large and a tenth of the
pixels are holes."""
_NEAR_M, _FAR_M = 0.4, 5.5
"""Range of a sensor, m."""


def depth_rig(name: str) -> CameraRig:
    """Make a rig of depth sensors by name.

    name: depth-1 (in front), depth-2 (front and side), depth-3 (all round), or depth-N up to 8, in a ring; all stand
        2.7 m from the centre, 1.2 m above the floor.
    Raises: InputError for another name.
    """
    count = name.removeprefix("depth-")
    if not count.isdigit() or not 1 <= int(count) <= 8:
        raise InputError(f"There are no sensors {name!r}; give depth-1 to depth-8.")
    n = int(count)
    azimuths = AZIMUTHS.get(n) or tuple(360.0 * k / n for k in range(n))
    ring = circle([a - 90 for a in azimuths], 2.7, n * [1.2], FOCAL_PX, KINECT_SIZE, name="depth")
    return CameraRig(tuple(ring))


def turning(performance: Performance, subject: SyntheticSubject, heading: Array) -> Performance:
    """Turn the person of a performance about the vertical axis of the world, by another angle in each frame.

    performance, subject: motion, and body of the person.
    heading: (T,) angle in each frame, rad.
    """
    r = so3_exp(np.asarray(heading, dtype=np.float64)[:, None] * np.array([0, 0, 1.0]))
    rotations = np.einsum("tab,tjbc->tjac", r, performance.rotations)
    root = np.einsum("tab,tb->ta", r, performance.root)
    return assemble(performance.name, subject, performance.times, rotations, root)


def to_profile(frames: int, seed: int) -> Array:
    """Make a heading (T,) rad over T = frames: facing the first sensor, one profile, back, the other profile, and back.

    seed: decides which profile is first.
    """
    x = np.linspace(0, 1, frames)
    side = 1.0 if seed % 2 else -1.0
    return side * np.radians(90) * np.sin(2 * np.pi * x)


@dataclass(frozen=True)
class DepthScene(OfPerformance):
    """Synthetic recording of depth sensors with known truth.

    name: name of the scene.
    subject: body of the person (dressed).
    performance: motion of the person.
    rig: the sensors, pinhole.
    seed: seed of all random numbers.
    furniture: boxes that may hide the person: x, y of the middle, width along x, along y, height, m.
    others: further people with their motions.
    """

    name: str
    subject: SyntheticSubject
    performance: Performance
    rig: CameraRig
    seed: int = 0
    furniture: tuple[tuple[float, float, float, float, float], ...] = ()
    others: tuple[tuple[SyntheticSubject, Performance], ...] = ()

    def clean_map(self, view: int, index: int) -> tuple[DepthMap, NDArray[np.uint8]]:
        """Render frame `index` of sensor `view` without faults.

        Returns: depth (h, w) m, and the pixels of the person (h, w) 0/1.
        """
        camera, room = self.rig[view], self._rooms[view]
        own = _drawn(camera, self.vertices(index), self.subject.faces)
        for body, does in self.others:
            room = np.minimum(room, _drawn(camera, body.skin(does.rotations[index], does.root[index]), body.faces))
        return np.minimum(own, room), (own < room).astype(np.uint8)

    def depth_map(self, view: int, index: int) -> DepthMap:
        """Render frame `index` of sensor `view` with its faults: (h, w) m, 0 = hole, rounded to millimetres."""
        camera, vertices = self.rig[view], self.vertices(index)
        clean, person = self.clean_map(view, index)
        rng = np.random.default_rng([self.seed, _FRAME, view, index])
        head, drawn = self.joints[index, 4], np.zeros(clean.shape, np.uint8)
        crown = vertices[(np.linalg.norm(vertices - head, axis=1) < 0.25) & (vertices[:, 2] > head[2] + 0.08)]
        if len(crown):
            hull = cv2.convexHull(np.rint(camera.project_pinhole(crown)).astype(np.int32))
            cv2.fillConvexPoly(drawn, np.asarray(hull), 1)
        hair = (drawn > 0) & (person > 0)
        return sensed(clean, camera, self._patterns[view], rng, len(self.rig) - 1, hair)

    def empty_map(self, view: int, index: int) -> DepthMap:
        """Render the empty room from sensor `view` with its faults: (h, w) m, 0 = hole."""
        rng = np.random.default_rng([self.seed, _EMPTY, view, index])
        return sensed(self._rooms[view], self.rig[view], self._patterns[view], rng, len(self.rig) - 1, None)

    @cached_property
    def _rooms(self) -> list[DepthMap]:
        things = _things(np.random.default_rng([self.seed, _PATTERN]), self.furniture)
        return [_room(camera, things) for camera in self.rig]

    @cached_property
    def _patterns(self) -> list[DepthMap]:
        """Fixed pattern (h, w) of each sensor, m."""
        out = []
        for c, camera in enumerate(self.rig):
            rng = np.random.default_rng([self.seed, _PATTERN, c + 1])
            shape = (camera.size[1], camera.size[0])
            out.append((_PATTERN_M / 0.8 * smooth_noise(rng, shape, 40)).astype(np.float32))
        return out


def depth_scene(
    performance: Performance,
    subject: SyntheticSubject,
    sensors: str | CameraRig,
    *,
    seed: int = 0,
) -> DepthScene:
    """Make the scene of a subject's performance in front of depth sensors.

    performance, subject: motion, and body of the person.
    sensors: name of a rig (`depth_rig`), or a rig.
    seed: seed of all random numbers.
    """
    rig = depth_rig(sensors) if isinstance(sensors, str) else sensors
    what = sensors if isinstance(sensors, str) else f"{len(rig)} sensors"
    name = f"{performance.name}-{subject.name}-{what}-{seed}"
    return DepthScene(name, subject, performance, rig, seed=seed)


def sensed(
    clean: DepthMap,
    camera: Camera,
    pattern: DepthMap,
    rng: np.random.Generator,
    others: int,
    hair: NDArray[np.bool_] | None,
) -> DepthMap:
    """Add the faults of a sensor to a depth map.

    clean: (h, w) m without faults.
    camera: camera of the sensor.
    pattern: (h, w) m, fixed pattern of the sensor.
    others: number of other sensors that disturb it.
    hair: (h, w) pixels of hair, or None.
    Returns: (h, w) m, 0 = hole, rounded to millimetres.
    """
    z = clean.astype(np.float32)
    h, w = z.shape
    kernel = np.ones((3, 3), np.uint8)
    near, far = cv2.erode(z, kernel), cv2.dilate(z, kernel)
    edge = far - near > 0.08
    out = z + pattern * (z / 2.5) + np.float32(0.4 * _PATTERN_M) * np.sin(z * np.float32(2 * np.pi / 0.75))
    round_about = cv2.boxFilter(np.clip(z, near.min(), _FAR_M), -1, (21, 21))
    out = out + np.float32(_MULTIPATH) * np.clip(round_about - z, -0.1, 0.4)
    # the cosine between ray and normal, from the smaller of the two one-sided differences of depth
    ax = np.minimum(np.abs(np.diff(z, axis=1, append=z[:, -1:])), np.abs(np.diff(z, axis=1, prepend=z[:, :1])))
    ay = np.minimum(np.abs(np.diff(z, axis=0, append=z[-1:])), np.abs(np.diff(z, axis=0, prepend=z[:1])))
    slope = np.hypot(ax * camera.K[0, 0] / z, ay * camera.K[1, 1] / z)
    cosine = (1 / np.sqrt(1 + slope**2)).astype(np.float32)
    sd = (_CONSTANT_M + _SQUARE * z * z) / np.maximum(cosine, 0.15)
    wild = np.ones((h, w), np.float32)
    gone = rng.random((h, w), dtype=np.float32) < _HOLES
    for _ in range(others):
        rows = rng.random((h, 1), dtype=np.float32) < _DISTURBED  # beats fall on rows
        wild = np.where(rows, 3.0, wild).astype(np.float32)
        gone |= rows & (rng.random((h, w), dtype=np.float32) < 0.1)
    out = out + sd * wild * rng.standard_normal((h, w), dtype=np.float32)
    gone |= rng.random((h, w), dtype=np.float32) > np.clip(cosine / _GRAZING, 0, 1)
    if hair is not None:
        gone |= hair & (rng.random((h, w), dtype=np.float32) < _HAIR)
    mixed = edge & (rng.random((h, w), dtype=np.float32) < _FLYING)
    share = rng.random((h, w), dtype=np.float32)
    out = np.where(mixed, share * near + (1 - share) * far, out)
    gone |= mixed & (rng.random((h, w), dtype=np.float32) < 0.5)
    gone |= (out < _NEAR_M) | (out > _FAR_M)
    return np.where(gone, 0, np.rint(1000 * out) / 1000).astype(np.float32)


def _drawn(camera: Camera, vertices: Array, faces: NDArray[np.int32]) -> DepthMap:
    """Render a mesh: depth (h, w) m, infinite where nothing is drawn; vertices (V, 3) m world, faces (F, 3)."""
    return rasterize(camera.project_pinhole(vertices), camera.depths(vertices), faces, camera.size)[0]


def _room(camera: Camera, things: tuple[Array, NDArray[np.int32]]) -> DepthMap:
    """Render floor, four walls, ceiling and the things in the room: (h, w) m."""
    v, u = np.indices((camera.size[1], camera.size[0]))
    k, r = camera.K, camera.camera_from_world[:3, :3]
    rays = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones(u.shape)], -1) @ r
    eye = camera.position
    depth = np.full(u.shape, np.inf)
    for axis, low, high in ((0, -3.4, 3.4), (1, -3.4, 3.4), (2, 0.0, 2.8)):
        with np.errstate(divide="ignore"):
            t = np.maximum((low - eye[axis]) / rays[..., axis], (high - eye[axis]) / rays[..., axis])
        depth = np.minimum(depth, np.where(t > 0, t, np.inf))
    return np.minimum(depth.astype(np.float32), _drawn(camera, *things))


def _things(
    rng: np.random.Generator, furniture: Sequence[tuple[float, float, float, float, float]]
) -> tuple[Array, NDArray[np.int32]]:
    """Make the mesh of boxes on the floor, outside the space of the people and away from the sensors of AZIMUTHS, plus
    the furniture.
    """
    corners, sides = box_mesh((-0.5, -0.5, 0.0), (0.5, 0.5, 1.0))
    vertices = []
    for azimuth in (45, 160, 200, 285, 315):
        angle, away = np.radians(azimuth) + rng.uniform(-0.15, 0.15), rng.uniform(2.4, 2.9)
        size = rng.uniform((0.3, 0.3, 0.3), (0.8, 0.8, 1.2))
        turned = (corners * size) @ so3_exp(np.array([0, 0, rng.uniform(0, 3)])).T
        vertices.append(turned + [away * np.sin(angle), -away * np.cos(angle), 0])
    vertices += [corners * [wide, deep, tall] + [x, y, 0] for x, y, wide, deep, tall in furniture]
    every, faces = joined_meshes([(v, sides) for v in vertices])
    return every, np.concatenate([faces, faces[:, ::-1]])  # seen from either side
