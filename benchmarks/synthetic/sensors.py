"""Simulated depth sensors with skeleton tracking: a true motion in, the skeletons of several sensors out.

What goes wrong depends on what a sensor sees: jitter grows for oblique views and along the ray, a joint that the body
or a treadmill's bars hide is inferred (frozen to its parent, taken for the other arm, or pulled towards the trunk and
jumping), a sensor that sees the back exchanges the sides for a while, joints and whole persons are lost, depth maps
have holes. Apart from the noise of depth the figures are assumptions; results on these recordings compare methods, they
are not what a particular sensor will give.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from hypose.app.live.simulated_sensors import FRAME_RATE, rotated_about_vertical
from hypose.evidence.frame import INFERRED, NOT_TRACKED, TRACKED, SensorJoints
from hypose.fusion import joints as jt
from hypose.geometry import Array, se3_inverse, transform

BACKGROUND_M = 4.5
"""Distance of the wall behind the person."""
LARGEST_DEPTH_NOISE = 1.4e-3
"""m per m^2: depth noise of structured light grows with the square of the distance (Khoshelham & Elberink 2012)."""

# (joint, joint, radius m): a person of capsules; a joint is never hidden by capsules that hold it
_CAPSULES = (
    [(0, 0, 0.105), (0, 1, 0.06), (2, 5, 0.065), (1, 8, 0.115), (2, 9, 0.08), (5, 12, 0.08), (8, 8, 0.125)]
    + [(9, 12, 0.105), (2, 3, 0.05), (3, 4, 0.042), (4, 4, 0.048), (5, 6, 0.05), (6, 7, 0.042), (7, 7, 0.048)]
    + [(9, 10, 0.08), (10, 11, 0.055), (11, 11, 0.055), (12, 13, 0.08), (13, 14, 0.055), (14, 14, 0.055)]
)
_HOLDS = [[0, 1], [1, 0, 2, 3], [2, 8, 4], [3, 8, 9, 10], [9, 10], [2, 11, 5], [6, 11, 12, 13], [12, 13]] + [
    [3, 6, 4, 5, 7],
    [7, 14, 4],
    [14, 15],
    [15, 16],
    [7, 17, 5],
    [17, 18],
    [18, 19],
]
_ARMS = (jt.LEFT_ELBOW, jt.LEFT_HAND, jt.RIGHT_ELBOW, jt.RIGHT_HAND)
_LIMBS = (*_ARMS, jt.LEFT_KNEE, jt.LEFT_FOOT, jt.RIGHT_KNEE, jt.RIGHT_FOOT)
_LIVELY = (*_ARMS, jt.LEFT_FOOT, jt.RIGHT_FOOT)
HIDDEN_BELOW = 0.45
"""A joint is hidden when a sensor sees a smaller share of its surroundings."""


@dataclass(frozen=True)
class SensorModel:
    """What sensors do wrong. jitter_m: sd per axis of a joint seen frontally; bias_m: sd of each joint's constant error
    in the body's frame; jump_m: sd of the jumps of inferred joints; frozen: share of hidden episodes in which the joint
    rides with its parent; other_arm: share of the rest in which a hidden arm joint is taken for the other arm's;
    drop_out: chance per frame that the person is lost for 5-25 frames; gone: chance per frame that a fully hidden joint
    is reported missing; swaps: sides are exchanged in episodes when the back is seen; holes: share of joints without
    depth; flagged: chance that a hidden joint is reported as inferred; false_flag: that a visible one is."""

    jitter_m: float = 0.007
    bias_m: float = 0.015
    jump_m: float = 0.09
    frozen: float = 0.3
    other_arm: float = 0.4
    drop_out: float = 0.002
    gone: float = 0.1
    swaps: bool = True
    holes: float = 0.04
    flagged: float = 0.7
    false_flag: float = 0.05


@dataclass(frozen=True)
class SensorRecording:
    """What K sensors report of one person, with the truth. T frames, the 15 common joints.

    times (T,) s; positions (T, K, 15, 3) m in each sensor's frame (OpenCV camera axes), NaN missing; state
    (T, K, 15); joint_depth (T, K, 15) m, 0 = hole; truth (T, 15, 3) m world; heading (T,) rad, 0 = facing -y;
    camera_from_world (K, 4, 4); visible (T, K, 15) share that a sensor sees; error (T, K, 15) m of its joints."""

    times: Array
    positions: Array
    state: NDArray[np.uint8]
    joint_depth: Array
    truth: Array
    heading: Array
    camera_from_world: Array
    visible: Array
    error: Array

    def __len__(self) -> int:
        return len(self.times)

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """sensor0, sensor1, ..."""
        return tuple(f"sensor{k}" for k in range(self.positions.shape[1]))

    def frames(self) -> list[SensorJoints]:
        """The recording as evidence, one per frame."""
        return [
            SensorJoints(
                self.positions[t],
                self.state[t],
                np.full(len(self.sensor_names), self.times[t]),
                jt.COMMON,
                self.sensor_names,
                joint_depth=self.joint_depth[t],
            )
            for t in range(len(self))
        ]

    def truth_in(self, sensor: int) -> Array:
        """(T, 15, 3) true joints in a sensor's frame."""
        return transform(self.camera_from_world[sensor], self.truth)


def body_capsules(joints: Array) -> Array:
    """Joints (..., 15, 3) -> capsules (..., 20, 7) = a, b, radius, m."""
    a, b = (np.array([c[i] for c in _CAPSULES]) for i in (0, 1))
    radius = np.broadcast_to(np.array([c[2] for c in _CAPSULES])[:, None], (*joints.shape[:-2], len(_CAPSULES), 1))
    return np.concatenate([joints[..., a, :], joints[..., b, :], radius], -1)


compiled = numba.njit(error_model="numpy")
_FAR = 1e9
"""Distance along a ray that meets nothing."""


@compiled
def _capsule(origin: Array, dx: float, dy: float, dz: float, capsule: Array, c: int) -> float:
    """Distance along a unit ray to capsule c (a, b, radius), _FAR when it misses. After I. Quilez's closed form."""
    ax, ay, az = capsule[c, 0], capsule[c, 1], capsule[c, 2]
    bx, by, bz = capsule[c, 3] - ax, capsule[c, 4] - ay, capsule[c, 5] - az
    ox, oy, oz = origin[0] - ax, origin[1] - ay, origin[2] - az
    r2 = capsule[c, 6] * capsule[c, 6]
    length = bx * bx + by * by + bz * bz
    if length > 1e-12:
        bd = bx * dx + by * dy + bz * dz
        bo = bx * ox + by * oy + bz * oz
        rd = dx * ox + dy * oy + dz * oz
        oo = ox * ox + oy * oy + oz * oz
        a = length - bd * bd
        q = length * rd - bo * bd
        s = q * q - a * (length * oo - bo * bo - r2 * length)
        if a > 1e-12:
            if s < 0:
                return _FAR
            t = (-q - math.sqrt(s)) / a
            y = bo + t * bd
            if 0 < y < length and t > 0:
                return t
            if y > 0:
                ox, oy, oz = ox - bx, oy - by, oz - bz
    rd = dx * ox + dy * oy + dz * oz
    s = rd * rd - (ox * ox + oy * oy + oz * oz - r2)
    if s > 0:
        t = -rd - math.sqrt(s)
        if t > 0:
            return t
    return _FAR


@compiled
def cast_rays(origin: Array, directions: Array, capsules: Array, out: Array) -> None:
    """Unit directions (N, 3) from origin (3,) against capsules (C, 7) = a, b, radius in m -> out (N,) distance along
    the ray to the first surface, _FAR when there is none."""
    for n in range(directions.shape[0]):
        nearest = _FAR
        for c in range(capsules.shape[0]):
            t = _capsule(origin, directions[n, 0], directions[n, 1], directions[n, 2], capsules, c)
            if t < nearest:
                nearest = t
        out[n] = nearest


@compiled
def seen_share(
    origin: Array,
    joints: Array,
    offsets: Array,
    capsules: Array,
    own: NDArray[np.bool_],
    margin: float,
    out: Array,
) -> None:
    """Share of the points joint + offset (offsets (Q, 3) m) that a sensor at origin sees: joints (J, 3), capsules
    (C, 7), own (J, C): capsules that hold the joint and never hide it -> out (J,)."""
    for j in range(joints.shape[0]):
        seen = 0
        for q in range(offsets.shape[0]):
            dx = joints[j, 0] + offsets[q, 0] - origin[0]
            dy = joints[j, 1] + offsets[q, 1] - origin[1]
            dz = joints[j, 2] + offsets[q, 2] - origin[2]
            d = math.sqrt(dx * dx + dy * dy + dz * dz)
            hidden = False
            for c in range(capsules.shape[0]):
                if not own[j, c] and _capsule(origin, dx / d, dy / d, dz / d, capsules, c) < d - margin:
                    hidden = True
                    break
            if not hidden:
                seen += 1
        out[j] = seen / offsets.shape[0]


# ---------------------------------------------------------------- what sensors make of it


def simulate(
    joints: Array, heading: Array, camera_from_world: Array, rng: np.random.Generator, model: SensorModel, bars: Array
) -> SensorRecording:
    """Skeletons of the sensors camera_from_world (K, 4, 4) for joints (T, 15, 3) m of a person with heading (T,) rad
    among bars (M, 7)."""
    frames, sensors = len(joints), len(camera_from_world)
    out = np.full((frames, sensors, 15, 3), np.nan)
    state = np.zeros((frames, sensors, 15), dtype=np.uint8)
    depth, visible = np.zeros((frames, sensors, 15)), np.zeros((frames, sensors, 15))
    error = np.full((frames, sensors, 15), np.nan)
    body = body_capsules(joints)
    scene = np.concatenate([body, np.broadcast_to(bars, (frames, *bars.shape))], 1)
    for k, camera in enumerate(camera_from_world):
        eye = se3_inverse(camera)[:3, 3].copy()
        seen, seen_past_body = _seen(joints, eye, scene), _seen(joints, eye, body)
        visible[:, k] = seen
        from_front = np.abs((heading - np.arctan2(eye[0], -eye[1]) + np.pi) % (2 * np.pi) - np.pi)
        world = joints + _tracking_noise(joints, heading, from_front, eye, model, rng)
        _infer_hidden(world, joints, seen, seen_past_body, model, rng)
        if model.swaps:
            _swap_sides(world, from_front, rng)
        depth[:, k] = _depth_at(world, eye, camera[2, :3], scene, model, rng)
        hidden = seen < HIDDEN_BELOW
        flag = rng.random(seen.shape) < np.where(hidden, model.flagged, model.false_flag)
        state[:, k] = np.where(flag, INFERRED, TRACKED)
        lost = _lost_frames(frames, model.drop_out, rng)
        gone = lost[:, None] | ((seen < 0.1) & (rng.random(seen.shape) < model.gone))
        depth[lost, k] = 0
        world[gone] = np.nan
        state[:, k][gone] = NOT_TRACKED
        out[:, k] = transform(camera, world)
        error[:, k] = np.linalg.norm(world - joints, axis=-1)
    times = np.arange(frames) / FRAME_RATE
    return SensorRecording(times, out, state, depth, joints, heading, np.array(camera_from_world), visible, error)


def _seen(joints: Array, eye: Array, capsules: Array) -> Array:
    own = np.zeros((15, capsules.shape[1]), dtype=np.bool_)
    for j, held in enumerate(_HOLDS):
        own[j, held] = True
    offsets = 0.028 * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    out = np.empty(joints.shape[:2])
    for t in range(len(joints)):
        seen_share(eye, joints[t], offsets, capsules[t], own, 0.02, out[t])
    return out


def _autoregressive(rng: np.random.Generator, frames: int, shape: tuple[int, ...], rho: float) -> Array:
    """(frames, *shape) of unit variance with correlation rho between neighbours."""
    e = rng.normal(0, np.sqrt(1 - rho * rho), (frames, *shape))
    e[0] = rng.normal(0, 1, shape)
    for t in range(1, frames):
        e[t] += rho * e[t - 1]
    return e


def _tracking_noise(
    joints: Array, heading: Array, from_front: Array, eye: Array, model: SensorModel, rng: np.random.Generator
) -> Array:
    """Jitter, doubled along the ray and larger for hands and oblique views, and each joint's constant error, which
    rides with the body."""
    frames = len(joints)
    sd = model.jitter_m * np.where(np.isin(np.arange(15), _LIVELY), 1.5, 1.0)
    sd = sd[None] * (1 + 0.6 * np.sin(np.minimum(from_front, np.pi / 2)))[:, None]
    ray = joints - eye
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    out = _autoregressive(rng, frames, (15, 3), 0.5) * sd[..., None]
    out += _autoregressive(rng, frames, (15, 1), 0.5) * sd[..., None] * ray
    bias = np.broadcast_to(rng.normal(0, model.bias_m, (15, 3)), (frames, 15, 3))
    return out + rotated_about_vertical(bias, heading)


def _infer_hidden(
    world: Array, joints: Array, seen: Array, past_body: Array, model: SensorModel, rng: np.random.Generator
) -> None:
    """Replaces hidden joints, episode by episode (gaps of up to two frames do not end one), in place."""
    frames = len(joints)
    slow = _autoregressive(rng, frames, (15, 3), 0.95) * 0.6 * model.jump_m
    for j in range(15):
        hidden = seen[:, j] < HIDDEN_BELOW
        limb = j in _LIMBS
        t = 0
        while t < frames:
            if not hidden[t]:
                t += 1
                continue
            end = t
            while end < frames and (hidden[end] or (end + 2 < frames and hidden[end + 1 : end + 3].any())):
                end += 1
            n, parent, before = end - t, jt.PARENT[j] if limb else jt.TORSO, max(t - 1, 0)
            by_body = past_body[t:end, j].mean() < HIDDEN_BELOW
            if rng.random() < model.frozen:
                rides = joints[t:end, parent] + world[before, j] - joints[before, parent]
                world[t:end, j] = rides + rng.normal(0, 0.6 * model.jitter_m, (n, 3))
            elif j in _ARMS and by_body and rng.random() < model.other_arm:
                drift = _autoregressive(rng, n, (3,), 0.5) * model.jitter_m * 25 / 7
                world[t:end, j] = joints[t:end, jt.MIRROR[j]] + drift
            else:
                pull = rng.uniform(0.15, 0.45) * (1.0 if limb else 0.1)
                jumps, jump = np.zeros((n, 3)), np.zeros(3)
                for i in range(n):
                    if rng.random() < 0.2:
                        jump = rng.normal(0, model.jump_m, 3)
                    jumps[i] = jump
                inward = pull * (joints[t:end, jt.TORSO] - joints[t:end, j])
                # the trunk is inferred well
                world[t:end, j] += (1.0 if limb else 0.35) * (inward + jumps + slow[t:end, j])
            t = end


def _swap_sides(world: Array, from_front: Array, rng: np.random.Generator) -> None:
    """Exchanges left and right in episodes of 10-60 frames while the sensor sees the back, in place."""
    t = 0
    while t < len(world):
        if from_front[t] > np.radians(105) and rng.random() < 0.05:
            end = min(t + int(rng.integers(10, 60)), len(world))
            behind = np.flatnonzero(from_front[t:end] > np.radians(100)) + t
            world[behind] = world[behind][:, jt.MIRROR]
            t = end
        else:
            t += 1


def _depth_at(
    reported: Array, eye: Array, axis: Array, capsules: Array, model: SensorModel, rng: np.random.Generator
) -> Array:
    """(T, 15) m along the optical axis: what a depth map holds at the pixels of the reported joints, with noise and
    holes (0)."""
    ray = reported - eye
    distance = np.linalg.norm(ray, axis=-1)
    direction = ray / distance[..., None]
    hit = np.empty(distance.shape)
    for t in range(len(reported)):
        cast_rays(eye, direction[t], capsules[t], hit[t])
    hit = np.minimum(hit, BACKGROUND_M)
    hit += rng.normal(0, 1, hit.shape) * LARGEST_DEPTH_NOISE * hit * hit
    out = hit * (direction @ axis)
    out[rng.random(out.shape) < model.holes] = 0
    return out


def _lost_frames(frames: int, chance: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    out = np.zeros(frames, dtype=np.bool_)
    t = 0
    while t < frames:
        if rng.random() < chance:
            n = int(rng.integers(5, 25))
            out[t : t + n] = True
            t += n
        t += 1
    return out
