"""Two depth cameras of which the second is knocked while somebody moves before them, or stood elsewhere all along."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.depth_sensors.depth_passing import JointsOf
from benchmarks.synthetic.depth_frames import depth_frames
from hypose.body.motion import Motion
from hypose.calibration.depth_registration import place_error
from hypose.cameras.camera import CameraRig
from hypose.evidence.frame import Frame
from hypose.geometry import se3, so3_exp
from hypose.pipeline.run import track_source
from hypose.pipeline.track_loop import FrameList
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.depth_scenes import DepthScene
from hypose.synthetic.metrics import EVALUATED

_TURN_DEGREES, _STEP_M = 2.0, (0.04, 0.0, 0.0)


def knocked(scene: DepthScene) -> DepthScene:
    """The scene before a second camera that is turned about the vertical and stands a step beside."""
    camera = scene.rig[1]
    turn = se3(so3_exp(np.radians([0, 0, _TURN_DEGREES])), np.zeros(3))
    here, there = (se3(np.eye(3), p) for p in (-camera.position, camera.position + np.array(_STEP_M)))
    moved = replace(camera, camera_from_world=camera.camera_from_world @ np.linalg.inv(there @ turn @ here))
    return replace(scene, rig=CameraRig((scene.rig[0], moved, *list(scene.rig)[2:])))


def moved_sensor(scene: DepthScene, share: float, rate: float, seed: int, joints_of: JointsOf) -> dict[str, Any]:
    """place_deg, place_mm: how far off the second camera's place is at the end; moved_mm, told_mm: mean error with its
    place found anew, and as it is told. share: of the frames before it is knocked. What it sees is cut from the empty
    room as it sees that from where it stands."""
    other, frames = knocked(scene), list(depth_frames(scene))
    change = round(share * len(frames))
    frames[change:] = [_as_told(f, scene.rig) for f in list(depth_frames(other))[change:]]
    source, options = FrameList(frames, rate), TrackOptions(seed=seed)

    def away(motion: Motion) -> float:
        return 1e3 * float(np.linalg.norm(scene.joints - joints_of(motion, scene), axis=-1)[:, EVALUATED].mean())

    found = track_source(source, rate, options)
    now = found.places[-1].camera_from_world[1] if found.places else scene.rig[1].camera_from_world
    at = scene.joints[-1].mean(0)
    degrees, metres = place_error(now, other.rig[1].camera_from_world, at)
    told = track_source(source, rate, options, find_places=False)
    out = {"place_deg": degrees, "place_mm": 1e3 * metres, "moved_mm": away(found.motion)}
    return out | {"told_mm": away(told.motion)}


def _as_told(frame: Frame, rig: CameraRig) -> Frame:
    assert frame.silhouettes is not None and frame.depth is not None
    told = replace(frame.silhouettes, rig=rig)
    return replace(frame, silhouettes=told, depth=replace(frame.depth, rig=rig))
