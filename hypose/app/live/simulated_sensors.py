"""Simulate depth sensors for a first try of the live server: an artificial person who boxes and turns, as lines."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from itertools import count

import numpy as np
from numpy.typing import ArrayLike

from hypose.evidence.frame import TRACKED, SensorReport
from hypose.fusion import joints as jt
from hypose.geometry import Array, so3_exp, transform
from hypose.io.sensors.skeleton_files import format_line
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


def simulated_sensors(sensors: int, rng: np.random.Generator) -> Array:
    """Simulate what several sensors see of the artificial person at 30 Hz, in a loop of 16 s.

    sensors: number K, 2 to 4; they stand at the angles `_ANGLES`.
    Returns: (T, K, 15, 3) m, the 15 common joints in each sensor's frame of reference.
    """
    there = builtin_joints("box", _SECONDS / 2, rng)
    there -= there[:, jt.TORSO].mean(0) * [1, 1, 0]
    joints = np.concatenate([there, there[::-1]])  # forth and back, so that the loop has no jump
    heading = _TURN * np.sin(2 * np.pi * np.arange(len(joints)) / len(joints))
    joints, seen = rotated_about_vertical(joints, heading), []
    for camera in ring_sensors(_ANGLES[sensors]):
        bias = np.broadcast_to(rng.normal(0, _BIAS_M, joints.shape[1:]), joints.shape)
        noise = rotated_about_vertical(bias, heading) + rng.normal(0, _JITTER_M, joints.shape)
        seen.append(transform(camera, joints + noise))
    return np.stack(seen, 1)


async def send(seen: Array, take: Callable[[str], object], rng: np.random.Generator) -> None:
    """Send the sensors' lines in real time, repeated until cancelled. Like real sensors they report at different
    instants, each with a clock of its own.

    seen: (T, K, 15, 3) m, see `simulated_sensors`.
    take: receives each line.
    rng: chooses the instants and the clocks.
    """
    loop = asyncio.get_running_loop()
    phases, clocks = rng.uniform(0, 1 / FRAME_RATE, seen.shape[1]), rng.uniform(0, 1000, seen.shape[1])
    state, began = np.full(len(jt.COMMON), TRACKED, dtype=np.uint8), loop.time()
    for n in count():
        for k in np.argsort(phases).tolist():
            at = n / FRAME_RATE + float(phases[k])
            await asyncio.sleep(max(0.0, began + at - loop.time()))
            report = SensorReport(f"sensor{k}", float(clocks[k]) + at, 0, jt.COMMON, seen[n % len(seen), k], state)
            take(format_line(report))


def ring_sensors(angles_deg: ArrayLike, distance: float = 2.5, height: float = 1.1) -> Array:
    """Place sensors in a circle around the origin, all turned to a point 1 m above it.

    angles_deg: (K,) degrees, 0 = in front of a person who faces -y, positive towards the person's left.
    distance: from the vertical axis through the origin, m.
    height: above the floor, m.
    Returns: camera_from_world (K, 4, 4).
    """
    at = np.radians(np.asarray(angles_deg, dtype=np.float64))
    eyes = np.stack([np.sin(at) * distance, -np.cos(at) * distance, np.full(len(at), height)], 1)
    return np.stack([look_at("", eye, (0, 0, 1.0), FOCAL_PX, KINECT_SIZE).camera_from_world for eye in eyes])


def builtin_joints(name: str, seconds: float, rng: np.random.Generator) -> Array:
    """Generate the joints of a built-in motion of a random test subject at 30 Hz.

    name: name of the motion.
    seconds: length.
    Returns: (T, 15, 3) m of the common joints, world, z up.
    """
    subjects = list(load_subjects().values())
    performance = act(name, subjects[int(rng.integers(len(subjects)))], seconds, FRAME_RATE, rng)
    j = performance.joints[:, jt.BODY_JOINT].copy()
    shoulders, hips = j[:, [jt.LEFT_SHOULDER, jt.RIGHT_SHOULDER]], j[:, [jt.LEFT_HIP, jt.RIGHT_HIP]]
    j[:, jt.TORSO] = (shoulders.mean(1) + hips.mean(1)) / 2
    return j


def rotated_about_vertical(joints: Array, heading: Array) -> Array:
    """Rotate joints about the vertical axis through the origin.

    joints: (T, 15, 3) m.
    heading: (T,) rad.
    """
    r = so3_exp(heading[:, None] * np.array([0, 0, 1.0]))
    return np.einsum("tij,tnj->tni", r, joints)
