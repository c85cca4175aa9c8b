"""Recorded skeletons at the frames of cameras that saw the same person: on the cameras' clock, one body each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hypose.body.motion import Motion
from hypose.errors import InputError
from hypose.evidence.frame import SensorJoints
from hypose.fusion import joints as jt
from hypose.fusion.clocks import offset_by_movement
from hypose.geometry import Array
from hypose.io.sensors.skeleton_streams import (
    SensorStream,
    SkeletonRecording,
    one_person,
    resample,
    shifted,
)

_ALIKE = 0.5
"""correlation of movements below which two clocks cannot be brought together"""


def skeletons_at_frames(recording: SkeletonRecording, motion: Motion) -> list[SensorJoints]:
    """The skeletons of a recording at the frames of a motion of the same person. Their clock is set by the movement:
    one for all sensors, or one for each where they have their own. Of several persons the one that a sensor sees
    longest counts. An InputError when a clock cannot be set."""
    known = np.where(motion.lost[:, None, None], np.nan, motion.joints[:, jt.BODY_JOINT])
    rows = np.arange(len(motion))
    offset: float | None = None
    synced: list[SensorStream] = []
    for stream in recording.streams:
        if offset is None or not recording.common_clock:
            offset = _offset(motion, known, stream)
        synced.append(resample(shifted(stream, offset), motion.times))
    columns = [np.where((s.state[rows, c] > 0).any(1), c, -1) for s, c in ((s, _longest(s.state)) for s in synced)]
    if len({s.joint_names for s in synced}) > 1:
        raise InputError(
            f"The sensors of {recording.name} report different sets of joints; give them one after the other."
        )
    return one_person(synced, motion.times, columns)


def _longest(state: NDArray[np.uint8]) -> int:
    """Who is seen longest, of states (T, P, J)."""
    return int((state > 0).any(2).sum(0).argmax())


def _offset(motion: Motion, known: Array, stream: SensorStream) -> float:
    """s to add to a stream's times."""
    common = jt.joint_set(stream.joint_names).common
    begin = float(motion.times[0] - stream.times[0])
    seen = stream.positions[:, _longest(stream.state)][:, common]
    found, likeness = offset_by_movement(motion.times, known, stream.times + begin, seen)
    if likeness < _ALIKE:
        raise InputError(
            f"The skeletons of {stream.name} move otherwise than the person before the cameras (correlation "
            f"{likeness:.2f}), so their clock cannot be set; give recordings of one person at one time."
        )
    return begin + found
