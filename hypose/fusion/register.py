"""Registration: find where the sensors stand relative to each other, from the skeletons that they report of one person.

The method "published" registers every frame by the triangle of shoulders and torso (`by_triangles`). All other methods
estimate one transform per sensor robustly from all joints of many frames (`register`), because registering every frame
multiplies the jitter.
Source: Asteriadis et al. 2013, section 2.1, eq. 2-4. Deviations: R = V U^T is printed for H = sum reference . moving^T,
    which is the inverse rotation; moving to reference is U V^T. Three points make H of rank 2, so that half of all
    unguarded solutions are reflections; here the determinant is guarded (geometry.procrustes).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.losses import lorentzian_weight
from hypose.errors import InputError
from hypose.evidence.frame import TRACKED, SensorJoints
from hypose.fusion import joints as jt
from hypose.geometry import Array, frame_of, procrustes, transform, unit

LARGEST_RESIDUAL_M = 0.25
"""m, median distance after registration beyond which two sensors cannot see the same person."""
LARGEST_LENGTH_RATIO = 1.25
"""Ratio between the limb lengths of two skeletons (median over the bones) beyond which they cannot be of the same
person.
"""
FEWEST_PAIRS = 12
"""Least number of joints that two sensors must see in common to be registered."""
# Scale of the Cauchy weights, m.
_SCALE_M = 0.04


@dataclass(frozen=True)
class Registration:
    """Rigid transforms of K sensors to the common frame, which is that of the first sensor.

    common_from_sensor: (K, 4, 4).
    residual: (K,) m, median distance to the joints of the first sensor (or of the sensor that it was
        registered to), NaN where not registered.
    registered: (K,) bool.
    """

    common_from_sensor: Array
    residual: Array
    registered: NDArray[np.bool_]

    def apply(self, positions: ArrayLike) -> Array:
        """Transform positions (..., K, J, 3) m from the sensors' frames to the common frame; NaN for unregistered
        sensors.
        """
        out = transform(self.common_from_sensor, positions)
        if not self.registered.all():
            out[..., ~self.registered, :, :] = np.nan
        return out


def common_joints(frame: SensorJoints) -> SensorJoints:
    """Return a frame with the 15 common joints only, in the order of joints.COMMON.

    Raises: InputError where its joints form no known set.
    """
    if frame.joint_names == jt.COMMON:
        return frame
    pick = jt.joint_set(frame.joint_names).common
    return SensorJoints(
        frame.positions[:, pick],
        frame.state[:, pick],
        frame.times,
        jt.COMMON,
        frame.sensor_names,
        None if frame.joint_depth is None else frame.joint_depth[:, pick],
    )


def triangle_transform(reference: ArrayLike, moving: ArrayLike) -> Array:
    """Compute the rigid transform reference_from_moving (4, 4) that aligns two triangles (3, 3) of points in m.

    Source: Asteriadis et al. 2013, eq. 2-4. Deviation: (3) and (4) are printed as the transform from the reference to
        the moving skeleton; this is its inverse, with a guarded determinant.
    """
    return procrustes(moving, reference)[0]


def by_triangles(last: Registration, positions: ArrayLike) -> Registration:
    """Register one frame as published: align every sensor to the first by the triangle of shoulders and torso.

    last: registration of the frame before.
    positions: (K, 15, 3) m in the sensors' frames.
    Deviation: a sensor whose triangle is incomplete keeps its last transform, and stays unregistered before its first
    one (all sensors do where the triangle of the first is incomplete); the paper gives no rule.
    """
    triangles = np.asarray(positions, dtype=np.float64)[:, list(jt.TRIANGLE)]
    complete = np.asarray(np.isfinite(triangles).all(axis=(1, 2)))
    transforms, residual = last.common_from_sensor.copy(), last.residual.copy()
    target = triangles[0]
    new = complete & complete[0] & (np.arange(len(triangles)) > 0)
    for k in np.flatnonzero(new):
        transforms[k] = triangle_transform(target, triangles[k])
        residual[k] = np.median(np.linalg.norm(transform(transforms[k], triangles[k]) - target, axis=1))
    return Registration(transforms, residual, last.registered | new)


def register(positions: ArrayLike, state: ArrayLike | None = None, *, iterations: int = 15) -> Registration:
    """Estimate one rigid transform per sensor from a window of frames, robustly.

    positions: (T, K, J, 3) m in the sensors' frames, NaN where missing.
    state: (T, K, J) joint states, which weigh the joints: tracked 1, inferred 1/2; None: all weigh 1.
    iterations: largest number of iterations of the weighted Procrustes solve.
    Returns: the registration. A sensor that shares too few joints with the first is registered to a sensor already
        registered; one that shares too few with all stays unregistered.
    """
    s = np.asarray(positions, dtype=np.float64)
    sensors = s.shape[1]
    weight = np.asarray(np.isfinite(s).all(-1), dtype=np.float64)
    if state is not None:
        weight *= np.asarray(state) / TRACKED
    transforms, residual, done = np.tile(np.eye(4), (sensors, 1, 1)), np.full(sensors, np.nan), np.arange(sensors) == 0
    residual[0] = 0.0
    waiting = list(range(1, sensors))
    while waiting:
        shared = [
            (int(((weight[:, a] > 0) & (weight[:, k] > 0)).sum()), a, k) for k in waiting for a in np.flatnonzero(done)
        ]
        # the first sensor itself before others: a chain adds errors
        direct = [x for x in shared if x[1] == 0 and x[0] >= FEWEST_PAIRS]
        count, anchor, k = max(direct or shared)
        if count < FEWEST_PAIRS:
            break
        both = weight[:, anchor] * weight[:, k]
        use = both > 0
        a = transform(transforms[anchor], s[:, anchor][use])
        transforms[k], residual[k] = robust_motion(s[:, k][use], a, both[use], iterations)
        done[k] = True
        waiting.remove(k)
    return Registration(transforms, residual, done)


def robust_motion(moving: Array, target: Array, weight: Array, iterations: int) -> tuple[Array, float]:
    """Estimate a rigid motion between corresponding points with Cauchy weights.

    moving, target: (N, 3) m.
    weight: (N,) weights of the pairs.
    iterations: largest number of weighted Procrustes solves; with 1 it is plain least squares.
    Returns: target_from_moving (4, 4) and the median distance after it, m.
    """
    w, distance = weight, np.zeros(len(weight))
    motion = np.eye(4)
    for _ in range(iterations):
        before = motion
        motion = procrustes(moving, target, w)[0]
        distance = np.linalg.norm(transform(motion, moving) - target, axis=1)
        w = lorentzian_weight((distance / _SCALE_M) ** 2, weight)
        if np.abs(motion - before).max() < 1e-5:
            break
    return motion, float(np.median(distance))


def check_same_person(positions: ArrayLike, registration: Registration, names: Sequence[str]) -> None:
    """Raise InputError where two sensors cannot have seen the same person at the same time, or a sensor reports only a
    point.

    positions: (T, K, 15, 3) m in the sensors' frames.
    registration: registration of the sensors.
    names: names of the sensors, for the message.
    """
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
    for k in range(1, s.shape[1]):
        both = known[k] & known[0]
        if not both.any():
            continue
        ratio = float(np.median(typical[k][both] / np.maximum(typical[0][both], 1e-6)))
        far = registration.residual[k] > LARGEST_RESIDUAL_M
        if far or max(ratio, 1 / max(ratio, 1e-6)) > LARGEST_LENGTH_RATIO:
            reason = (
                f"their joints stay {100 * registration.residual[k]:.0f} cm apart after registration"
                if far
                else f"the limbs differ by {100 * abs(ratio - 1):.0f} %"
            )
            raise InputError(
                f"Sensors {names[0]!r} and {names[k]!r} do not seem to see the same person at the same time: {reason}; "
                "choose the recordings of one person, or check that both clocks agree."
            )


def upward(positions: ArrayLike) -> Array:
    """Compute the upward direction (3,): the median unit vector from hips to neck over registered positions (..., 15,
    3).
    """
    s = np.asarray(positions, dtype=np.float64).reshape(-1, 15, 3)
    trunk = s[:, jt.NECK] - (s[:, jt.LEFT_HIP] + s[:, jt.RIGHT_HIP]) / 2
    trunk = trunk[np.isfinite(trunk).all(1)]
    if not len(trunk):
        return np.array([0.0, -1.0, 0.0])
    return unit(np.median(trunk, axis=0))


def upright_axes(up: Array) -> Array:
    """Compute the rotation world_from_sensor (3, 3) whose z axis is `up` (3,) and whose y axis points away from the
    sensor.
    """
    _, y, left = frame_of(up, [1.0, 0.0, 0.0] if abs(up[2]) > 0.98 else [0.0, 0.0, 1.0]).T
    return np.stack([-left, y, up])


def alone(sensors: int) -> Registration:
    """Make the registration of K sensors before any person was seen, in which only the first sensor is registered.

    sensors: number K.
    """
    first = np.arange(sensors) == 0
    return Registration(np.tile(np.eye(4), (sensors, 1, 1)), np.where(first, 0.0, np.nan), first)
