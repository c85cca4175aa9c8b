"""What fusion has to beat: the best single sensor, confidence-weighted mean, median, Kalman, clustering with Kalman.

All take registered skeletons of a clip, positions (T, K, J, 3) m with NaN for missing, and return (T, J, 3) m without
gaps (the last value is held). Sources: weighted mean, Caon et al. 2011; DBSCAN of the sensors' candidates followed by a
Kalman filter, Sensors 2022, 22(9):3155 (largest cluster of at least two candidates; its temporal gate is replaced by
the nearest to the last result).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from hypose.evidence.frame import TRACKED, SensorJoints
from hypose.fusion.register import Registration, common_joints, register
from hypose.geometry import Array

BASELINES = ("best_single", "weighted_mean", "median", "kalman", "dbscan_kalman")


def fuse_baseline(frames: Sequence[SensorJoints], method: str, registration: Registration | None = None) -> Array:
    """(T, 15, 3) m: the joints of a clip, in the frame of the first sensor, by one of BASELINES."""
    raw = [common_joints(f) for f in frames]
    positions, states = np.stack([f.positions for f in raw]), np.stack([f.state for f in raw])
    world = (register(positions, states) if registration is None else registration).apply(positions)
    rate = 1 / float(np.median(np.diff([np.nanmax(f.times) for f in frames])))
    if method == "best_single":  # without the truth: the sensor with most tracked joints
        return single_sensor(world, int(np.where(np.isfinite(world[..., 0]), states, 0).sum((0, 2)).argmax()))
    if method == "median":
        return median(world)
    if method == "dbscan_kalman":
        return kalman(dbscan(world), rate)
    mean = confidence_mean(world, states)
    return mean if method == "weighted_mean" else kalman(mean, rate)


def held(positions: ArrayLike) -> Array:
    """Positions (T, ..., 3) with gaps filled by the last value, leading gaps by the first."""
    out = np.array(positions, dtype=np.float64)
    for order in (range(1, len(out)), range(len(out) - 2, -1, -1)):
        for t in order:
            previous = out[t - 1] if order.step > 0 else out[t + 1]
            out[t] = np.where(np.isfinite(out[t]), out[t], previous)
    return out


def single_sensor(positions: ArrayLike, sensor: int) -> Array:
    """One sensor alone."""
    return held(np.asarray(positions, dtype=np.float64)[:, sensor])


def weighted_mean(positions: ArrayLike, weights: ArrayLike) -> Array:
    """Mean weighted by weights (T, K, J), for example state / TRACKED."""
    s = np.asarray(positions, dtype=np.float64)
    w = np.where(np.isfinite(s[..., 0]), np.asarray(weights, dtype=np.float64), 0.0)
    total = w.sum(1)
    mean = (np.where(np.isfinite(s), s, 0.0) * w[..., None]).sum(1) / np.maximum(total, 1e-12)[..., None]
    return held(np.where(total[..., None] > 1e-12, mean, np.nan))


def confidence_mean(positions: ArrayLike, state: ArrayLike) -> Array:
    """Caon et al. 2011: the mean weighted by the SDK's confidence, tracked 1 and inferred 1/2."""
    return weighted_mean(positions, np.asarray(state) / TRACKED)


def median(positions: ArrayLike) -> Array:
    """Median of the sensors per coordinate."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a joint that no sensor sees: a gap
        return held(np.nanmedian(np.asarray(positions, dtype=np.float64), axis=1))


def kalman(
    measured: ArrayLike, frame_rate: float = 30.0, acceleration_sd: float = 20.0, measurement_sd_m: float = 0.025
) -> Array:
    """Constant-velocity Kalman filter of every coordinate: measured (T, J, 3) m, NaN = no measurement; acceleration_sd
    m/s^2."""
    z = np.asarray(measured, dtype=np.float64)
    dt, r, q = 1 / frame_rate, measurement_sd_m**2, acceleration_sd**2
    x = np.where(np.isfinite(z[0]), z[0], 0.0)
    v = np.zeros_like(x)
    a, b, c = np.full(len(x), r), np.zeros(len(x)), np.full(len(x), 1.0)
    out = np.empty_like(z)
    out[0] = x
    for t in range(1, len(z)):
        x = x + v * dt
        a, b, c = a + 2 * dt * b + dt**2 * c + q * dt**4 / 4, b + dt * c + q * dt**3 / 2, c + q * dt**2
        seen = np.isfinite(z[t, :, 0])
        ka, kb = np.where(seen, a / (a + r), 0.0), np.where(seen, b / (a + r), 0.0)
        e = np.where(seen[:, None], z[t], x) - x
        x, v = x + ka[:, None] * e, v + kb[:, None] * e
        c, b, a = c - kb * b, b * (1 - ka), a * (1 - ka)
        out[t] = x
    return out


def dbscan(positions: ArrayLike, radius_m: float = 0.15) -> Array:
    """Per joint and frame the mean of the largest cluster of sensors closer than radius_m to each other (chains count),
    of at least two; without one, the sensor nearest to the last result."""
    s = np.asarray(positions, dtype=np.float64)
    frames, sensors, joints, _ = s.shape
    near = np.linalg.norm(s[:, :, None] - s[:, None], axis=-1) < radius_m  # NaN is never near
    seen = np.isfinite(s[..., 0])
    label = np.broadcast_to(np.arange(sensors)[None, :, None], (frames, sensors, joints)).copy()
    for _ in range(sensors):
        label = np.where(near, label[:, None], sensors).min(2, initial=sensors)
        label = np.where(seen, label, sensors)
    size = (label[:, :, None] == label[:, None]).sum(2) * seen
    out = np.full((frames, joints, 3), np.nan)
    last = median(s[:1])[0]
    for t in range(frames):
        for j in range(joints):
            ok = np.flatnonzero(seen[t, :, j])
            if not len(ok):
                continue
            largest = size[t, ok, j].max()
            if largest >= 2:
                found = {int(label[t, k, j]) for k in ok if size[t, k, j] == largest}
                means = [s[t, label[t, :, j] == c, j].mean(0) for c in sorted(found)]
            else:
                means = list(s[t, ok, j])
            last[j] = (
                min(means, key=lambda p: float(((p - last[j]) ** 2).sum())) if np.isfinite(last[j, 0]) else means[0]
            )
            out[t, j] = last[j]
    return held(out)
