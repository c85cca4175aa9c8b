"""Skeletons of sensors as evidence beside cameras: where their sensors stand, which sides they exchange, one solve."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.robustness.small_recordings import small_scene
from hypose.body.default_body import human
from hypose.body.motion import Motion
from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.evidence.frame import Frame, SensorJoints
from hypose.evidence.silhouettes import make_silhouettes
from hypose.fitting.articulated import fit_pose
from hypose.fusion import joints as jt
from hypose.geometry import se3, se3_inverse, so3_exp, transform
from hypose.io.sensors.skeleton_files import SensorStream, SkeletonRecording
from hypose.pipeline.sensor_skeletons import fuse_mixture, skeleton_rows, skeletons_at_frames
from hypose.pipeline.sources import FrameList
from hypose.pipeline.track import track_source
from hypose.pipeline.track_options import TrackOptions
from hypose.tracking.refinement import anatomical_prior
from hypose.tracking.start_search import known_pose

FRAMES = 40
PLACE = se3(so3_exp(np.array([0.3, -1.2, 0.4])), np.array([0.5, 0.2, 2.4]))


def swinging(times):
    """Poses (T, D) at these times (T,), s, of a body that stands in place and swings all its joints."""
    body, waves = human(), np.random.default_rng(7)
    pose = known_pose(body, "standing")
    pose[:3] = 0, 0, 0.95
    rates, phases = waves.uniform(1, 5, len(pose)), waves.uniform(0, 6, len(pose))
    return body.skeleton.clamp(pose + 0.3 * np.sin(times[:, None] * rates + phases))


def motion_of(frames):
    body, times = human(), np.arange(frames) / 25
    poses, none = swinging(times), np.zeros(frames, np.bool_)
    joints = body.joints(poses)
    around = np.full((*joints.shape[:2], 3, 3), np.nan, np.float32)
    views, cost = np.ones(frames, np.int64), np.zeros(frames)
    return Motion(body.skeleton, times, joints, poses, around, none, none, views, cost, {})


@pytest.fixture
def walked(rng):
    """A motion of the body, and its joints as a sensor reports them: a little off, sides exchanged in some frames."""
    motion = motion_of(FRAMES)
    seen = motion.joints[:, jt.BODY_JOINT] + 0.005 * rng.standard_normal((FRAMES, 15, 3))
    seen[10:15] = seen[10:15][:, jt.MIRROR]
    reported = transform(PLACE, seen)
    state = np.full((1, 15), 2, np.uint8)
    return motion, [
        SensorJoints(p[None], state, np.array([t / 25]), jt.COMMON, ("side",)) for t, p in enumerate(reported)
    ]


def test_a_sensor_is_placed_by_the_motion_and_its_sides_are_put_right(walked):
    motion, skeletons = walked
    rows, place = skeleton_rows(motion, skeletons, range(FRAMES))
    assert np.allclose(place.common_from_sensor[1], se3_inverse(PLACE), atol=0.01)
    assert np.nanmax(np.linalg.norm(rows.points - motion.joints[:, jt.BODY_JOINT], axis=-1)) < 0.04
    assert (rows.weight > 0).all()
    assert np.linalg.norm(rows.offset, axis=-1).max() < 0.01


def test_the_true_pose_costs_least_and_a_solve_on_the_rows_finds_it(walked):
    motion, skeletons = walked
    body, frame = human(), Frame(0.2, 5)
    rows, _ = skeleton_rows(motion, skeletons, range(FRAMES))
    away = body.skeleton.clamp(motion.poses[5] + 0.1)
    true, other = rows.energy(body, np.stack([motion.poses[5], away]), frame)
    assert true < other
    found = fit_pose(body, away, [rows.rows(body, frame)], priors=(anatomical_prior(body.skeleton),)).pose
    assert np.linalg.norm(body.joints(found) - motion.joints[5], axis=-1)[jt.BODY_JOINT].mean() < 0.02
    assert rows.rows(body, Frame(9.0, 900)) is None


def test_a_sensor_that_saw_something_else_is_no_evidence(walked, rng):
    """One that tells the truth, one that filmed at another time, and one that saw nobody."""
    motion, skeletons = walked
    other = transform(PLACE, 0.5 * rng.standard_normal((FRAMES, 15, 3)))
    three = [
        replace(
            s,
            positions=np.stack([s.positions[0], o, np.full((15, 3), np.nan)]),
            state=np.repeat(s.state, 3, 0),
            times=np.repeat(s.times, 3),
            sensor_names=("side", "other", "blind"),
        )
        for s, o in zip(skeletons, other, strict=True)
    ]
    rows, place = skeleton_rows(motion, three, range(FRAMES))
    assert place.registered.tolist() == [True, True, False, False]
    used = (rows.weight > 0).reshape(FRAMES, 3, 15)
    assert used[:, 0].all() and not used[:, 1:].any()


@pytest.mark.slow
def test_cameras_and_skeletons_become_one_motion(rng):
    """Two cameras that leave depth open, and a sensor of another place that reports joints."""
    scene = small_scene(1, 25)
    rig = CameraRig(tuple(scene.given_rig.pinhole()[k] for k in (0, 1)))
    frames = []
    for frame in scene.mask_frames():
        s = frame.silhouettes
        frames.append(replace(frame, silhouettes=make_silhouettes(list(s.masks[:2]), rig)))
    seen = scene.joints[:, jt.BODY_JOINT] + 0.01 * rng.standard_normal((len(frames), 15, 3))
    state = np.full((1, 15), 2, np.uint8)
    skeletons = [
        SensorJoints(p[None], state, np.array([f.time]), jt.COMMON, ("side",))
        for p, f in zip(transform(PLACE, seen), frames, strict=True)
    ]
    alone = track_source(FrameList(frames, 25.0), 25.0, TrackOptions())
    found = fuse_mixture(FrameList(frames, 25.0), 25.0, skeletons, TrackOptions())
    before, after = (np.linalg.norm(m.joints - scene.joints, axis=-1).mean() for m in (alone.motion, found.motion))
    assert len(found.motion) == 25 and not found.motion.lost.any()
    assert after < before


BEGUN, AHEAD = 1.2, 100.0
"""A recorded sensor begins later than the cameras, s, and its clock is so far ahead."""


@pytest.fixture
def recorded():
    """A motion of the cameras, and the same movement in a sensor's recording."""
    own = BEGUN + np.arange(120) / 30
    points = transform(PLACE, human().joints(swinging(own))[:, jt.BODY_JOINT])[:, None]
    state, ids = np.full(points.shape[:3], 2, np.uint8), np.zeros((len(own), 1), np.int64)
    stream = SensorStream("side", own + AHEAD, points, state, ids, jt.COMMON)
    return motion_of(150), SkeletonRecording("some", (stream,), "side", {})


def test_the_clock_of_a_recording_is_set_and_frames_without_a_skeleton_have_none(recorded):
    motion, recording = recorded
    found = skeletons_at_frames(recording, motion)
    first = next(t for t, f in enumerate(found) if np.isfinite(f.positions).all())
    assert len(found) == 150 and abs(first / 25 - BEGUN) < 0.08
    # what the sensor saw at a frame's time is what the cameras saw, as lengths tell wherever it stands
    both = motion.joints[first + 40, jt.BODY_JOINT], found[first + 40].positions[0]
    apart = [np.linalg.norm(p[jt.LEFT_HAND] - p[jt.RIGHT_HAND]) for p in both]
    assert abs(apart[0] - apart[1]) < 0.02


def test_a_recording_of_who_moves_otherwise_is_refused(recorded, rng):
    motion, recording = recorded
    stream = recording.streams[0]
    still = np.repeat(stream.positions[:1], len(stream.times), 0) + 1e-3 * rng.standard_normal(stream.positions.shape)
    with pytest.raises(InputError, match="clock cannot be set"):
        skeletons_at_frames(SkeletonRecording("some", (replace(stream, positions=still),), "side", {}), motion)
