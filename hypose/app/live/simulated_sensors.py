"""Simulate depth sensors for a first try of the live server: an artificial person who walks on the spot and turns, as
lines.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter1d

from hypose.evidence.frame import TRACKED, SensorReport
from hypose.fusion import joints as jt
from hypose.geometry import Array, so3_exp, transform
from hypose.io.sensors.skeleton_streams import format_line
from hypose.synthetic.depth_scenes import FOCAL_PX, KINECT_SIZE
from hypose.synthetic.motions import act
from hypose.synthetic.scenes import look_at
from hypose.synthetic.subjects import load_subjects

FRAME_RATE = 30.0
MAX_SIMULATED = 4
_SECONDS = 16
_ANGLES = {2: (0, 70), 3: (0, 65, -65), 4: (0, 80, -80, 180)}
"""Degrees around the person at which so many sensors stand; 0 = in front."""
_JITTER_M, _BIAS_M = 0.007, 0.015
"""Standard deviation per axis (m) of a joint's error in a frame, and of its constant error, which rotates with the
body.
"""
_TURN = 0.9
"""Angle to which the person turns to either side, rad."""
_HURRIES, _HASTE = 4, 0.85
"""How often the person walks faster and slower in a loop, and by which share. Why: from a completely regular walk the
clock offsets of sensors cannot be found.
"""


@dataclass(frozen=True)
class SensorRecording:
    """Simulated reports of K sensors on one person in T frames, with the 15 common joints.

    positions: (T, K, 15, 3) m in each sensor's frame of reference.
    truth: (T, 15, 3) m, world.
    """

    positions: Array
    truth: Array

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Names: sensor0, sensor1, ..."""
        return tuple(f"sensor{k}" for k in range(self.positions.shape[1]))


def simulated_sensors(sensors: int, rng: np.random.Generator) -> SensorRecording:
    """Simulate what several sensors see of the artificial person at 30 Hz, in a loop of about 16 s.

    sensors: number, 2 to 4; they stand at the angles `_ANGLES`.
    """
    walk = on_treadmill(builtin_joints("walk", 6, rng))
    again = looped(walk, 4 * len(walk))
    period = int(np.flatnonzero((again[1:] == again[0]).all((1, 2)))[0]) + 1
    frames = period * max(1, round(_SECONDS * FRAME_RATE / period))
    share = 2 * np.pi * np.arange(frames) / frames
    heading = _TURN * np.sin(share)
    ahead = _HASTE * frames / (2 * np.pi * _HURRIES) * np.sin(_HURRIES * share)
    step = np.rint(np.arange(frames) + ahead).astype(int) % frames
    joints = rotated_about_vertical(looped(walk, frames)[step], heading)
    seen = []
    for camera in ring_sensors(_ANGLES[sensors]):
        bias = np.broadcast_to(rng.normal(0, _BIAS_M, joints.shape[1:]), joints.shape)
        seen.append(
            transform(camera, joints + rotated_about_vertical(bias, heading) + rng.normal(0, _JITTER_M, joints.shape))
        )
    return SensorRecording(np.stack(seen, 1), joints)


async def send(recording: SensorRecording, take: Callable[[str], object], rng: np.random.Generator) -> None:
    """Send the sensors' lines in real time, repeated until cancelled. Like real sensors they report at different
    instants, each with a clock of its own.

    take: receives each line.
    rng: chooses the instants and the clocks.
    """
    loop = asyncio.get_running_loop()
    sensors = recording.sensor_names
    phases = rng.uniform(0, 1 / FRAME_RATE, len(sensors))
    clocks = rng.uniform(0, 1000, len(sensors))
    state, began = np.full(len(jt.COMMON), TRACKED, dtype=np.uint8), loop.time()
    for n in count():
        for k in np.argsort(phases).tolist():
            at = n / FRAME_RATE + float(phases[k])
            await asyncio.sleep(max(0.0, began + at - loop.time()))
            joints = recording.positions[n % len(recording), k]
            take(format_line(SensorReport(sensors[k], float(clocks[k]) + at, 0, jt.COMMON, joints, state)))


def ring_sensors(angles_deg: ArrayLike, distance: float = 2.5, height: float = 1.1) -> Array:
    """Place sensors around the origin, looking at it 1 m above the floor.

    angles_deg: 0 = in front of a person who faces -y, positive towards the person's left.
    distance, height: m.
    Returns: camera_from_world (K, 4, 4).
    """
    at = np.radians(np.asarray(angles_deg, dtype=np.float64))
    eyes = np.stack([np.sin(at) * distance, -np.cos(at) * distance, np.full(len(at), height)], 1)
    return np.stack([look_at("", eye, (0, 0, 1.0), FOCAL_PX, KINECT_SIZE).camera_from_world for eye in eyes])


def builtin_joints(name: str, seconds: float, rng: np.random.Generator) -> Array:
    """Generate the joints of a built-in motion of a random test subject at 30 Hz.

    name: of the motion.
    seconds: length.
    Returns: (T, 15, 3) m of the common joints, world, z up.
    """
    subjects = list(load_subjects().values())
    performance = act(name, subjects[int(rng.integers(len(subjects)))], seconds, FRAME_RATE, rng)
    j = performance.joints[:, jt.BODY_JOINT].copy()
    shoulders, hips = j[:, [jt.LEFT_SHOULDER, jt.RIGHT_SHOULDER]], j[:, [jt.LEFT_HIP, jt.RIGHT_HIP]]
    j[:, jt.TORSO] = (shoulders.mean(1) + hips.mean(1)) / 2
    return j


def on_treadmill(joints: Array) -> Array:
    """Remove travel and turning from a motion (T, 15, 3) m in any axes: the result has z up, faces -y, and stands on
    the floor.
    """
    hips = (joints[:, jt.LEFT_HIP] + joints[:, jt.RIGHT_HIP]) / 2
    up = np.median(joints[:, jt.NECK] - hips, axis=0)
    up /= np.linalg.norm(up)
    side = joints[:, jt.LEFT_SHOULDER] - joints[:, jt.RIGHT_SHOULDER] + joints[:, jt.LEFT_HIP] - joints[:, jt.RIGHT_HIP]
    side = gaussian_filter1d(side, 15, axis=0, mode="nearest")
    side -= (side @ up)[:, None] * up
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    back = np.cross(up, side)
    r = np.stack([side, back, np.broadcast_to(up, side.shape)], 1)
    centre = gaussian_filter1d(hips, 12, axis=0, mode="nearest")
    centre = centre - (centre @ up)[:, None] * up
    out = np.einsum("tij,tnj->tni", r, joints - centre[:, None])
    out[..., 2] -= np.percentile(out[:, [jt.LEFT_FOOT, jt.RIGHT_FOOT], 2], 2) - 0.08
    return out


def looped(joints: Array, frames: int, blend: int = 8) -> Array:
    """Repeat a clip for `frames` frames: it is cut between its two most similar frames and cross-faded over `blend`
    frames.
    """
    t = len(joints)
    flat = joints.reshape(t, -1)
    velocity = np.diff(flat, axis=0, append=flat[-1:])
    best = (np.inf, 0, t - 1)
    for a in range(2, max(3, t // 3)):
        b = np.arange(max(a + 20, t // 2), t - blend - 1)
        if len(b):
            d = ((flat[b] - flat[a]) ** 2).sum(1) + 25 * ((velocity[b] - velocity[a]) ** 2).sum(1)
            if d.min() < best[0]:
                best = (float(d.min()), a, int(b[d.argmin()]))
    _, a, b = best
    segment = joints[a:b].copy()
    m = min(blend, a)
    for i in range(m):
        w = (i + 1) / (m + 1)
        segment[len(segment) - m + i] = (1 - w) * segment[len(segment) - m + i] + w * joints[a - m + i]
    return np.concatenate([segment] * (frames // len(segment) + 1))[:frames]


def rotated_about_vertical(joints: Array, heading: Array) -> Array:
    """Rotate joints about the vertical axis through the origin.

    joints: (T, 15, 3) m.
    heading: (T,) rad.
    """
    r = so3_exp(heading[:, None] * np.array([0, 0, 1.0]))
    return np.einsum("tij,tnj->tni", r, joints)
