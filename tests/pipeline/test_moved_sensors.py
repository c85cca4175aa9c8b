"""Depth cameras that stand elsewhere than is told, from some frame on or all along, are found and put right."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.calibration.depth_registration import place_error
from hypose.cameras.camera import CameraRig
from hypose.geometry import se3, so3_exp
from hypose.pipeline.moved_sensors import moved_sensors
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.sources import FrameList, placed, placed_source
from hypose.tracking.start_search import known_pose
from tests.depth_pictures import frame_of, sensors

BODY, RIG, RATE = human(), sensors(2), 15.0
HERE = np.array([0, 0, 1.0])


def elsewhere(degrees=2.0, metres=0.04):
    """The rig with its second camera turned about the vertical where it stands, and moved along the floor."""
    own = RIG[1].camera_from_world
    turned = se3(so3_exp(np.radians([0, 0, degrees])), np.zeros(3))
    about = se3(np.eye(3), -RIG[1].position), se3(np.eye(3), RIG[1].position + [metres, 0, 0])
    return CameraRig((RIG[0], replace(RIG[1], camera_from_world=own @ about[1] @ turned @ about[0])))


def recording(change, count=24):
    """Frames before the rig, from frame `change` on before the other one, all said to be before the rig; the poses."""
    frames, poses = [], []
    for t in range(count):
        pose = known_pose(BODY, "standing")
        pose[:3] = 0.15 * np.sin(0.5 * t), 0.15 * np.cos(0.3 * t), 0.95
        pose[3:6] = 0, 0, 0.2 * t
        frame = frame_of(BODY, pose, elsewhere() if t >= change else RIG, t)
        frames.append(placed(frame, np.stack([c.camera_from_world for c in RIG])))
        poses.append(pose)
    return FrameList(frames, RATE), np.stack(poses)


def test_nothing_is_said_of_cameras_that_stand_where_they_should():
    source, poses = recording(24)
    assert moved_sensors(source, BODY, poses, np.full(24, 0.9), RATE) == ((), ())


@pytest.mark.slow
def test_a_camera_that_stands_elsewhere_is_found_and_put_right():
    change = 14
    source, poses = recording(change)
    places, said = moved_sensors(source, BODY, poses, np.full(24, 0.9), RATE)
    assert [abs(p.since - change) <= 1 for p in places] == [True]
    degrees, metres = place_error(places[0].camera_from_world[1], elsewhere()[1].camera_from_world, HERE)
    assert degrees < 0.5 and metres < SETTINGS.moved_off_m / 2
    assert np.array_equal(places[0].camera_from_world[0], RIG[0].camera_from_world)
    assert len(said) == 1 and said[0].text.startswith("d1 stood") and "from frame" in said[0].text
    right = placed_source(source, places)
    last = right.frame(23)
    assert last.depth is not None and last.silhouettes is not None
    assert last.depth.rig[1].camera_from_world == pytest.approx(places[0].camera_from_world[1])
    assert last.silhouettes.rig is last.depth.rig and len(right) == 24
    assert right.frame(0) is source.frame(0)
