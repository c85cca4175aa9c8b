"""Depth sensors that are not there, for a first try: a made-up person who walks on the spot and turns, as lines."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from itertools import count

import numpy as np

from hypose.evidence.frame import SensorReport
from hypose.fusion.joints import COMMON
from hypose.io.sensors.skeleton_streams import format_line
from hypose.synthetic.sensors import (
    FRAME_RATE,
    SensorModel,
    SensorRecording,
    builtin_joints,
    looped,
    on_treadmill,
    ring_sensors,
    simulate,
    turned,
)

MOST = 4
_SECONDS = 16
_ANGLES = {2: (0, 70), 3: (0, 65, -65), 4: (0, 80, -80, 180)}
"""Degrees around the person at which so many sensors stand; 0 = in front."""
_MILD = SensorModel(jump_m=0.02, frozen=0.0, other_arm=0.0, drop_out=0.0, swaps=False)
"""Sensors on a good day: what they get wholly wrong hides when it was, and a recording is brought in step by that."""
_TURN = 0.9
"""Radians to which the person turns to either side."""
_HURRIES, _HASTE = 4, 0.85
"""How often the person walks faster and slower meanwhile, and by which share: a walk that is always the same tells
nobody whose clock is how late."""


def simulated_sensors(sensors: int, rng: np.random.Generator) -> SensorRecording:
    """What 2 to 4 sensors (`_ANGLES`) see of the person at 30 Hz, for about 16 s, after which it begins again: the walk
    is cut where it repeats, and the person then faces forward as at the start."""
    walk = on_treadmill(builtin_joints("walk", 6, rng))
    again = looped(walk, 4 * len(walk))
    period = int(np.flatnonzero((again[1:] == again[0]).all((1, 2)))[0]) + 1
    frames = period * max(1, round(_SECONDS * FRAME_RATE / period))
    share = 2 * np.pi * np.arange(frames) / frames
    heading = _TURN * np.sin(share)
    ahead = _HASTE * frames / (2 * np.pi * _HURRIES) * np.sin(_HURRIES * share)
    step = np.rint(np.arange(frames) + ahead).astype(int) % frames
    joints = turned(looped(walk, frames)[step], heading)
    return simulate(joints, heading, ring_sensors(_ANGLES[sensors]), rng, _MILD, np.zeros((0, 7)))


async def send(recording: SensorRecording, take: Callable[[str], object], rng: np.random.Generator) -> None:
    """Hand the sensors' lines to `take` as they come, again and again until this is cancelled. Sensors are not in step,
    and each has its own clock, as real ones do."""
    loop = asyncio.get_running_loop()
    sensors = recording.sensor_names
    phases = rng.uniform(0, 1 / FRAME_RATE, len(sensors))
    clocks = rng.uniform(0, 1000, len(sensors))
    began = loop.time()
    for n in count():
        for k in np.argsort(phases).tolist():
            at = n / FRAME_RATE + float(phases[k])
            await asyncio.sleep(max(0.0, began + at - loop.time()))
            take(_line(recording, n % len(recording), k, sensors, float(clocks[k]) + at))


def _line(recording: SensorRecording, frame: int, sensor: int, names: Sequence[str], time: float) -> str:
    positions, state = recording.positions[frame, sensor], recording.state[frame, sensor]
    seen = 0 if np.isfinite(positions).all(1).any() else None
    return format_line(SensorReport(names[sensor], time, seen, COMMON, positions, state))
