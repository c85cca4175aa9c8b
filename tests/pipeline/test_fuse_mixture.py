"""Skeletons of sensors as evidence beside cameras: where their sensors stand, which sides they exchange, one solve."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.robustness.small_recordings import small_scene
from hypose.body.default_body import human
from hypose.body.motion import Motion
from hypose.cameras.camera import CameraRig
from hypose.evidence.frame import Frame, SensorJoints
from hypose.evidence.silhouettes import make_silhouettes
from hypose.fitting.articulated import fit_pose
from hypose.fusion import joints as jt
from hypose.geometry import se3, se3_inverse, so3_exp, transform
from hypose.pipeline.run import track_source
from hypose.pipeline.sensor_skeletons import fuse_mixture, skeleton_rows
from hypose.pipeline.track_loop import FrameList
from hypose.pipeline.track_options import TrackOptions
from hypose.tracking.refinement import anatomical_prior
from hypose.tracking.starts import known_pose

FRAMES = 40
PLACE = se3(so3_exp(np.array([0.3, -1.2, 0.4])), np.array([0.5, 0.2, 2.4]))


@pytest.fixture
def walked(rng):
    """A motion of the body, and its joints as a sensor reports them: a little off, sides exchanged in some frames."""
    body = human()
    pose = known_pose(body, "standing")
    pose[:3] = 0, 0, 0.95
    steps = np.linspace(0, 1, FRAMES)[:, None] * np.pi
    poses = pose + 0.3 * np.sin(steps * rng.uniform(1, 4, len(pose)) + rng.uniform(0, 3, len(pose)))
    poses = body.skeleton.clamp(poses)
    joints = body.joints(poses)
    none = np.zeros(FRAMES, np.bool_)
    around = np.full((*joints.shape[:2], 3, 3), np.nan, np.float32)
    views, cost = np.ones(FRAMES, np.int64), np.zeros(FRAMES)
    motion = Motion(body.skeleton, np.arange(FRAMES) / 25, joints, poses, around, none, none, views, cost, {})
    seen = joints[:, jt.BODY_JOINT] + 0.005 * rng.standard_normal((FRAMES, 15, 3))
    seen[10:15] = seen[10:15][:, jt.MIRROR]
    reported = transform(PLACE, seen)
    state = np.full((1, 15), 2, np.uint8)
    skeletons = [SensorJoints(p[None], state, np.array([t / 25]), jt.COMMON, ("side",)) for t, p in enumerate(reported)]
    return body, motion, skeletons


def test_a_sensor_is_placed_by_the_motion_and_its_sides_are_put_right(walked):
    body, motion, skeletons = walked
    rows, place = skeleton_rows(motion, skeletons, range(FRAMES))
    assert np.allclose(place.common_from_sensor[1], se3_inverse(PLACE), atol=0.01)
    assert np.nanmax(np.linalg.norm(rows.points - motion.joints[:, jt.BODY_JOINT], axis=-1)) < 0.04
    assert (rows.weight > 0).all()
    assert np.linalg.norm(rows.offset, axis=-1).max() < 0.01


def test_the_true_pose_costs_least_and_a_solve_on_the_rows_finds_it(walked):
    body, motion, skeletons = walked
    rows, _ = skeleton_rows(motion, skeletons, range(FRAMES))
    frame = Frame(0.2, 5)
    away = body.skeleton.clamp(motion.poses[5] + 0.1)
    energy = rows.energy(body, np.stack([motion.poses[5], away]), frame)
    assert energy[0] < energy[1]
    points = rows.rows(body, frame)
    found = fit_pose(body, away, [points], priors=(anatomical_prior(body.skeleton),)).pose
    off = np.linalg.norm(body.joints(found) - motion.joints[5], axis=-1)[jt.BODY_JOINT]
    assert off.mean() < 0.02
    assert rows.rows(body, Frame(9.0, 900)) is None
    assert rows.energy(body, away[None], Frame(9.0, 900)) == pytest.approx(0)


def test_a_sensor_that_saw_something_else_is_no_evidence(walked, rng):
    """One that tells the truth, one that filmed at another time, and one that saw nobody."""
    _, motion, skeletons = walked
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
