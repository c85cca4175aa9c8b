"""What a camera adds: rings where all are alike, a camera that nobody misses, and the gap that one more would close."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.body.motion import Motion, isotropic
from hypose.cameras.camera import Camera, CameraRig
from hypose.pipeline.camera_worth import _looking, camera_worth

_K = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])


def ring(*degrees, distance=4.0, height=1.5):
    cameras = []
    for k, a in enumerate(np.radians(degrees)):
        place = np.array([distance * np.cos(a), distance * np.sin(a), height])
        cameras.append(Camera(f"c{k}", _K, np.zeros(5), _looking(place, np.array([0, 0, 0.9])), (640, 480)))
    return CameraRig(tuple(cameras))


@pytest.fixture(scope="module")
def standing():
    body = human()
    poses = np.tile(body.skeleton.rest_pose(), (5, 1))
    poses[:, 2] = 0.95
    joints, none = body.joints(poses), np.zeros(5, bool)
    return Motion(body.skeleton, np.arange(5) / 25, joints, poses, isotropic(np.full(joints.shape[:2], 0.01)), none,
                  none, np.full(5, 4), np.full(5, 0.1))  # fmt: skip


def test_cameras_of_a_regular_ring_are_worth_the_same(standing):
    worth, _ = camera_worth(standing, ring(0, 90, 180, 270))
    times = [w.times for w in worth]
    assert max(times) / min(times) < 1.05 and 1.02 < min(times) < 1.5
    assert [w.thin for w in worth] == [0, 0, 0, 0]


def test_a_camera_that_looks_away_adds_nothing(standing):
    rig = ring(0, 90, 180)
    away = replace(rig[2], camera_from_world=_looking(rig[2].position, 2 * rig[2].position))
    worth, _ = camera_worth(standing, CameraRig((rig[0], rig[1], away)))
    assert worth[2].times == pytest.approx(1) and worth[2].thin == 0


def test_nothing_is_said_without_frames_or_of_one_camera(standing):
    lost = Motion(**{**vars(standing), "lost": np.ones(5, bool)})
    assert camera_worth(lost, ring(0, 90)) == ([], None)
    assert camera_worth(standing, ring(0)) == ([], None)
