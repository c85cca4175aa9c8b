"""Small worlds for the trackers: the template seen by four cameras, its silhouettes drawn exactly."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from hypose.body.body import Body
from hypose.body.default_body import human
from hypose.cameras.camera import CameraRig
from hypose.compute.parts import covered
from hypose.evidence.frame import Frame
from hypose.evidence.silhouettes import make_silhouettes
from hypose.geometry import Array
from hypose.synthetic.scenes import camera_rig
from hypose.tracking.start_search import known_pose

FrameOf = Callable[..., Frame]


@pytest.fixture(scope="session")
def body() -> Body:
    return human()


@pytest.fixture(scope="session")
def small_rig() -> CameraRig:
    """Four cameras around the origin, 240 x 180 px: the person is about 100 px tall."""
    return camera_rig("humaneva-4").scaled(0.375)


@pytest.fixture(scope="session")
def standing(body: Body) -> Array:
    """The body standing on the floor at the origin, arms hanging, turned by 40 degrees."""
    pose = known_pose(body, "standing")
    pose[5] = 0.7
    pose[2] -= body.skin(pose)[:, 2].min()
    return pose


@pytest.fixture(scope="session")
def frame_of(small_rig: CameraRig) -> FrameOf:
    """frame_of(body, pose, index=0, dead=()): exact silhouettes of the body; the views in `dead` are empty."""

    def draw(body: Body, pose: Array, index: int = 0, dead: Sequence[int] = ()) -> Frame:
        vertices = body.skin(pose)
        masks = []
        for c, camera in enumerate(small_rig):
            depth = vertices @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
            mask = covered(camera.project_pinhole(vertices), depth, body.coarse.faces, camera.size[::-1])
            masks.append(np.zeros_like(mask) if c in dead else mask.astype(np.uint8))
        return Frame(index / 25, index, silhouettes=make_silhouettes(masks, small_rig))

    return draw
