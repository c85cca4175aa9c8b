"""What `warm_up` compiles for one camera is what a tracker uses: nothing is compiled again at the first picture."""

import sys

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.cameras.camera import CameraRig
from hypose.compute.warming import warm_up
from hypose.evidence.frame import Frame, Keypoints, Picture
from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.monocular.picture_search import PictureSearch
from hypose.tracking.monocular.recipe import picture_recipe
from hypose.tracking.tracker import Tracker, TrackerSettings
from tests.monocular.pictures import camera, mask, picture, wall


def signatures() -> dict[str, int]:
    """How often each kernel has been compiled or loaded."""
    modules = [m for name, m in sys.modules.items() if name.startswith("hypose.compute.")]
    kernels = [v for m in modules for v in vars(m).values() if hasattr(v, "py_func")]
    return {f"{k.py_func.__module__}.{k.py_func.__qualname__}": len(k.signatures) for k in kernels}


@pytest.mark.slow
def test_nothing_is_compiled_again() -> None:
    warm_up("solver", "scorer", "pictures", "monocular")
    body = human()
    view, pose = camera(body), body.skeleton.rest_pose()
    image, shape = picture(body, pose, view, wall()), mask(body, pose, view)
    seen = np.array([[[100.0, 60.0, 1.0], [101.0, 130.0, 1.0]]])
    points = Keypoints(seen, ("head", "left_knee"), CameraRig((view,)))
    here = PictureSearch(body)
    tracker = Tracker(body, picture_recipe(here), TrackerSettings("auto"))
    start = tracker.start(Hypotheses.uniform(pose[None]))
    known = signatures()
    for frame in (
        Frame(0.04, 1, keypoints=points, picture=Picture(view, image, image, shape)),
        Frame(0.04, 1, picture=Picture(view, image, image)),
    ):
        tracker.step(start, frame)
    here.optimise(pose[None], Frame(0.0, 0, picture=Picture(view, image)), iterations=1)
    assert signatures() == known
