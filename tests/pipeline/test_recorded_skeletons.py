"""Recorded skeletons are set on the cameras' clock by the movement."""

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.body.motion import Motion
from hypose.errors import InputError
from hypose.fusion import joints as jt
from hypose.geometry import se3, so3_exp, transform
from hypose.io.sensors.skeleton_streams import SensorStream, SkeletonRecording
from hypose.pipeline.sensor_skeletons import skeletons_at_frames
from hypose.tracking.starts import known_pose

FRAMES, RATE, BEGUN, AHEAD = 150, 25.0, 1.2, 100.0
"""the sensor begins later than the cameras, s, and its clock is so far ahead"""


def moved(times, body, rng):
    pose = known_pose(body, "standing")
    pose[:3] = 0, 0, 0.95
    waves = np.random.default_rng(7)
    rates, phases = waves.uniform(1, 5, len(pose)), waves.uniform(0, 6, len(pose))
    return body.skeleton.clamp(pose + 0.3 * np.sin(times[:, None] * rates + phases))


@pytest.fixture
def seen(rng):
    body = human()
    times = np.arange(FRAMES) / RATE
    poses = moved(times, body, rng)
    none = np.zeros(FRAMES, np.bool_)
    joints = body.joints(poses)
    around = np.full((*joints.shape[:2], 3, 3), np.nan, np.float32)
    views, cost = np.ones(FRAMES, np.int64), np.zeros(FRAMES)
    motion = Motion(body.skeleton, times, joints, poses, around, none, none, views, cost, {})
    own = BEGUN + np.arange(120) / 30
    place = se3(so3_exp(np.array([0.3, -1.2, 0.4])), np.array([0.5, 0.2, 2.4]))
    points = transform(place, body.joints(moved(own, body, rng))[:, jt.BODY_JOINT])[:, None]
    state = np.full(points.shape[:3], 2, np.uint8)
    ids = np.zeros((len(own), 1), np.int64)
    stream = SensorStream("side", own + AHEAD, points, state, ids, jt.COMMON)
    return motion, SkeletonRecording("some", (stream,), "side", {})


def test_the_clock_is_set_and_frames_without_a_skeleton_have_none(seen):
    motion, recording = seen
    found = skeletons_at_frames(recording, motion)
    assert len(found) == FRAMES
    there = np.array([np.isfinite(f.positions).all() for f in found])
    first = int(np.flatnonzero(there)[0])
    assert abs(first / RATE - BEGUN) < 0.08
    # what the sensor saw at a frame's time is what the cameras saw, as lengths tell wherever it stands
    at = first + 40
    mine = motion.joints[at, jt.BODY_JOINT]
    theirs = found[at].positions[0]
    apart = [np.linalg.norm(p[jt.LEFT_HAND] - p[jt.RIGHT_HAND]) for p in (mine, theirs)]
    assert abs(apart[0] - apart[1]) < 0.02


def test_who_moves_otherwise_is_refused(seen, rng):
    motion, recording = seen
    stream = recording.streams[0]
    still = np.repeat(stream.positions[:1], len(stream.times), 0) + 1e-3 * rng.standard_normal(stream.positions.shape)
    other = SensorStream("side", stream.times, still, stream.state, stream.person_ids, stream.joint_names)
    with pytest.raises(InputError, match="clock cannot be set"):
        skeletons_at_frames(SkeletonRecording("some", (other,), "side", {}), motion)
