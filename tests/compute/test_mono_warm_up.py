"""What `warm_up` compiles for one camera is what a tracker uses: nothing is compiled again at the first picture."""

import numpy as np
import pytest

from hypose import compute
from hypose.body.ready_bodies import human
from hypose.compute.native import native
from hypose.evidence.flow import optical_flow
from hypose.monocular.tracker import MonoTracker
from hypose.monocular.types import MonoFrame, MonoHypotheses, clicked_joints
from tests.monocular.pictures import camera, mask, picture, wall

KERNELS = {
    "monocular.mono_search": ("search", "score", "full_cost", "draw_still", "symmetric_eigen"),
    "monocular.mono_images": ("strongest_gradient", "saturate", "weigh", "flow_error", "boundary_map"),
}


@pytest.mark.slow
def test_nothing_is_compiled_again() -> None:
    compute.warm_up(monocular=True)
    body = human()
    view, pose = camera(body), body.skeleton.rest_pose()
    image, shape = picture(body, pose, view, wall()), mask(body, pose, view)
    points = clicked_joints(body, {"head": (100.0, 60.0), "left_knee": (101.0, 130.0)})
    tracker = MonoTracker(body, view, threads=1)
    for frame in (MonoFrame(1, 0.04, image, shape, points), MonoFrame(1, 0.04, image)):
        state = tracker.start(MonoHypotheses.at(pose), MonoFrame(0, 0.0, image))
        tracker.step(state, frame, np.random.default_rng(0))
    tracker.optimise(MonoHypotheses.at(pose), MonoFrame(0, 0.0, image), iterations=1)
    optical_flow(image[..., 0].copy(), image[..., 1].copy())
    for room, names in KERNELS.items():
        kernels = native(room)
        for name in names:
            assert len(getattr(kernels, name).signatures) == 1, name
