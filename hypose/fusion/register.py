"""Registration: where the sensors stand relative to each other, from the skeletons they report of the same person.

Source: Asteriadis et al. 2013, section 2.1, eq. 2-4 (per frame, on the triangle of shoulders and torso). Printed there
is R = V U^T for H = sum reference . moving^T, which is the rotation the other way round; moving to reference is U V^T.
Three points make H of rank 2, so that the sign of one singular vector is arbitrary and half of all unguarded solutions
are reflections: the determinant is guarded (geometry.procrustes). The method "published" registers so (`by_triangles`);
all others take one transform per sensor from a window of frames, robustly, on all joints (`register`), because
registering every frame multiplies the jitter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.losses import lorentzian_weight
from hypose.errors import InputError
from hypose.evidence.frame import INFERRED, TRACKED, SensorJoints
from hypose.fusion import joints as jt
from hypose.geometry import Array, procrustes, se3, transform

LARGEST_RESIDUAL_M = 0.25
"""Median distance after registration beyond which two sensors cannot be looking at the same person."""
LARGEST_LENGTH_RATIO = 1.25
"""Ratio of two persons' limb lengths (median over the bones) that the same person never shows."""
FEWEST_PAIRS = 12
"""Joints seen by both sensors below which a registration is not attempted."""


@dataclass(frozen=True)
class Registration:
    """Registration.

    common_from_sensor (K, 4, 4): the common frame is the reference sensor's.
    residual (K,) m median distance to the reference (or the sensor it was tied to), NaN when not registered.
    registered (K,) bool.
    reference: its index.
    """

    common_from_sensor: Array
    residual: Array
    registered: NDArray[np.bool_]
    reference: int

    def apply(self, positions: ArrayLike) -> Array:
        """Positions (..., K, J, 3) in the sensors' frames -> common frame; NaN for sensors that are not registered."""
        out = transform(self.common_from_sensor, positions)
        if not self.registered.all():
            out[..., ~self.registered, :, :] = np.nan
        return out


def common_joints(frame: SensorJoints) -> SensorJoints:
    """Return the frame with the 15 common joints in their order; an InputError when its joints are no known set."""
    if frame.joint_names == jt.COMMON:
        return frame
    pick = jt.joint_set(frame.joint_names).common
    return SensorJoints(
        frame.positions[:, pick],
        frame.state[:, pick],
        frame.times,
        jt.COMMON,
        frame.sensor_names,
        frame.depth,
        frame.intrinsics,
        None if frame.joint_depth is None else frame.joint_depth[:, pick],
    )


def measured_joint_depth(frame: SensorJoints) -> Array | None:
    """Return (K, J) m depth map value at each joint's pixel, 0 where there is none (hole, outside); None without
    depth."""
    if frame.joint_depth is not None:
        return frame.joint_depth
    if frame.depth is None or frame.intrinsics is None:
        return None
    z = frame.positions[..., 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        u = frame.intrinsics[:, 0, 0, None] * frame.positions[..., 0] / z + frame.intrinsics[:, 0, 2, None]
        v = frame.intrinsics[:, 1, 1, None] * frame.positions[..., 1] / z + frame.intrinsics[:, 1, 2, None]
    height, width = frame.depth.shape[1:]
    ok = np.isfinite(u) & np.isfinite(v) & (z > 0) & (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5)
    x, y = np.where(ok, np.rint(u), 0).astype(np.intp), np.where(ok, np.rint(v), 0).astype(np.intp)
    return np.where(ok, frame.depth[np.arange(len(z))[:, None], y, x], 0.0).astype(np.float64)


def triangle_transform(reference: ArrayLike, moving: ArrayLike) -> Array:
    """reference_from_moving (4, 4) that aligns two triangles (3, 3) of points, eq. 2-4.

    Deviation: (3) and (4) are printed as the transform from the reference to the moving skeleton; this is its inverse,
    with a guarded determinant.
    """
    return procrustes(moving, reference)[0]


def by_triangles(last: Registration, positions: ArrayLike) -> Registration:
    """Return the published registration of one frame: positions (K, 15, 3) m in the sensors' frames.

    Every sensor is aligned on the reference by the triangle of shoulders and torso of this frame alone. Deviation: a
    sensor whose triangle is not complete keeps its last transform, and is missing before its first (so do all when the
    reference's is not), of which the paper says nothing.
    """
    triangles = np.asarray(positions, dtype=np.float64)[:, list(jt.TRIANGLE)]
    complete = np.asarray(np.isfinite(triangles).all(axis=(1, 2)))
    transforms, residual = last.common_from_sensor.copy(), last.residual.copy()
    target = triangles[last.reference]
    new = complete & complete[last.reference] & (np.arange(len(triangles)) != last.reference)
    for k in np.flatnonzero(new):
        transforms[k] = triangle_transform(target, triangles[k])
        residual[k] = np.median(np.linalg.norm(transform(transforms[k], triangles[k]) - target, axis=1))
    return Registration(transforms, residual, last.registered | new, last.reference)


def register(
    positions: ArrayLike,
    state: ArrayLike | None = None,
    *,
    reference: int = 0,
    joints: Sequence[int] = tuple(range(15)),
    scale_m: float = 0.04,
    iterations: int = 15,
    start: Registration | None = None,
) -> Registration:
    """Return one transform per sensor from positions (T, K, J, 3) m of a window, in the sensors' frames.

    Iterated Procrustes with Cauchy weights of scale `scale_m`, times the states' confidences (T, K, J): tracked 1,
    inferred 1/2. A sensor that shares too little with the reference is tied to a sensor already registered; one that
    shares too little with all keeps `start`'s transform, or stays unregistered.
    """
    s = np.asarray(positions, dtype=np.float64)[:, :, list(joints)]
    sensors = s.shape[1]
    if not 0 <= reference < sensors:
        raise InputError(f"There are {sensors} sensors, the reference cannot be number {reference}.")
    weight = np.asarray(np.isfinite(s).all(-1), dtype=np.float64)
    if state is not None:
        weight *= np.asarray(state)[:, :, list(joints)] / TRACKED
    transforms = np.tile(np.eye(4), (sensors, 1, 1)) if start is None else start.common_from_sensor.copy()
    residual, done = np.full(sensors, np.nan), np.zeros(sensors, dtype=np.bool_)
    done[reference], residual[reference] = True, 0.0
    transforms[reference] = np.eye(4)
    waiting = [k for k in range(sensors) if k != reference]
    while waiting:
        shared = [
            (int(((weight[:, a] > 0) & (weight[:, k] > 0)).sum()), a, k) for k in waiting for a in np.flatnonzero(done)
        ]
        # the reference itself first: a chain adds errors
        direct = [x for x in shared if x[1] == reference and x[0] >= FEWEST_PAIRS]
        count, anchor, k = max(direct or shared)
        if count < FEWEST_PAIRS:
            break
        both = weight[:, anchor] * weight[:, k]
        use = both > 0
        a = transform(transforms[anchor], s[:, anchor][use])
        before = transforms[k] if start is not None and start.registered[k] else None
        transforms[k], residual[k] = _robust(s[:, k][use], a, both[use], scale_m, iterations, before)
        done[k] = True
        waiting.remove(k)
    if start is not None:
        done |= start.registered
    return Registration(transforms, residual, done, reference)


def _robust(
    moving: Array, target: Array, weight: Array, scale: float, iterations: int, start: Array | None = None
) -> tuple[Array, float]:
    """From plain least squares, or from the weights that a known motion `start` gives (then a few iterations do)."""
    w, distance = weight, np.zeros(len(weight))
    motion = np.eye(4)
    if start is not None:
        off = np.linalg.norm(transform(start, moving) - target, axis=1)
        if np.median(off) < 3 * scale:  # else the sensor was moved
            w, motion = lorentzian_weight((off / scale) ** 2, weight), start
    for _ in range(iterations):
        before = motion
        motion = procrustes(moving, target, w)[0]
        distance = np.linalg.norm(transform(motion, moving) - target, axis=1)
        w = lorentzian_weight((distance / scale) ** 2, weight)
        if np.abs(motion - before).max() < 1e-5:
            break
    return motion, float(np.median(distance))


def check_same_person(
    positions: ArrayLike, registration: Registration, names: Sequence[str], residual_m: float = LARGEST_RESIDUAL_M
) -> None:
    """Raise InputError when two sensors cannot have seen the same person at the same time: positions (T, K, 15, 3) m in
    the sensors' frames are too far apart after registration, or the limbs' lengths differ too much; and when a sensor
    reports no body but a point."""
    s = np.asarray(positions, dtype=np.float64)
    a, b = jt.SKELETON_BONES[:, 0], jt.SKELETON_BONES[:, 1]
    with np.errstate(invalid="ignore"):
        lengths = np.linalg.norm(s[:, :, a] - s[:, :, b], axis=-1)
    known = [np.isfinite(lengths[:, k]).sum(0) > 10 for k in range(s.shape[1])]
    typical = [np.nanmedian(np.where(known[k], lengths[:, k], 0.0), axis=0) for k in range(s.shape[1])]
    for k in range(s.shape[1]):
        if known[k].any() and np.median(typical[k][known[k]]) < 0.01:
            raise InputError(
                f"The sensor {names[k]!r} reports all joints at one point; record it again, or leave the sensor out."
            )
    r = registration.reference
    for k in range(s.shape[1]):
        both = known[k] & known[r]
        if k == r or not both.any():
            continue
        ratio = float(np.median(typical[k][both] / np.maximum(typical[r][both], 1e-6)))
        far = registration.residual[k] > residual_m
        if far or max(ratio, 1 / max(ratio, 1e-6)) > LARGEST_LENGTH_RATIO:
            reason = (
                f"their joints stay {100 * registration.residual[k]:.0f} cm apart after registration"
                if far
                else f"the limbs differ by {100 * abs(ratio - 1):.0f} %"
            )
            raise InputError(
                f"Sensors {names[r]!r} and {names[k]!r} do not seem to see the same person at the same time: {reason}; "
                "choose the recordings of one person, or check that both clocks agree."
            )


def confidence_of(state: ArrayLike, inferred: float = 0.5) -> Array:
    """Weights of joint states (...): tracked 1, inferred `inferred`, not tracked 0."""
    s = np.asarray(state)
    return np.where(s == TRACKED, 1.0, np.where(s == INFERRED, inferred, 0.0))


def horizontal_axes(up: ArrayLike) -> tuple[Array, Array]:
    """Return two unit vectors (3,) that span the plane across `up`."""
    u = np.asarray(up, dtype=np.float64)
    u = u / np.linalg.norm(u)
    x = np.asarray(np.cross(u, np.eye(3)[int(np.abs(u).argmin())]), dtype=np.float64)
    x /= np.linalg.norm(x)
    return x, np.asarray(np.cross(u, x), dtype=np.float64)


def upward(positions: ArrayLike) -> Array:
    """Return (3,) unit vector from the hips to the neck, median over registered positions (..., 15, 3)."""
    s = np.asarray(positions, dtype=np.float64).reshape(-1, 15, 3)
    trunk = s[:, jt.NECK] - (s[:, jt.LEFT_HIP] + s[:, jt.RIGHT_HIP]) / 2
    trunk = trunk[np.isfinite(trunk).all(1)]
    if not len(trunk):
        return np.array([0.0, -1.0, 0.0])
    up = np.median(trunk, axis=0)
    return up / np.linalg.norm(up)


def upright_axes(up: Array) -> Array:
    """Return (3, 3) world_from_sensor rotation of which z is `up` (3,) and y points away from the sensor."""
    away: Array = np.array([0.0, 0.0, 1.0]) - up[2] * up
    if np.linalg.norm(away) < 0.2:  # the sensor looks straight down
        away = np.array([1.0, 0.0, 0.0]) - up[0] * up
    y: Array = away / np.linalg.norm(away)
    return np.stack([np.cross(y, up), y, up]).astype(np.float64)


def alone(sensors: int, reference: int = 0) -> Registration:
    """Before anything was seen: only the reference is registered."""
    return Registration(
        np.tile(np.eye(4), (sensors, 1, 1)),
        np.where(np.arange(sensors) == reference, 0.0, np.nan),
        np.arange(sensors) == reference,
        reference,
    )


def identity_registration(sensors: int, reference: int = 0) -> Registration:
    """Sensors that report in a common frame already."""
    return Registration(
        np.tile(se3(np.eye(3), np.zeros(3)), (sensors, 1, 1)),
        np.zeros(sensors),
        np.ones(sensors, dtype=np.bool_),
        reference,
    )
