"""Which of several starts is right is decided by all frames."""

import numpy as np
import pytest

from benchmarks.robustness.small_recordings import small_scene
from hypose.body.default_body import human
from hypose.errors import EvidenceError
from hypose.evidence.frame import Frame
from hypose.pipeline.start_choice import best_ways
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.left_right import turned_around
from hypose.tracking.start_search import Start, scaled_to_height, starts_in_frame

RATE = 12.5


@pytest.fixture(scope="module")
def walk():
    """Frames of a walk at RATE, a start the right way round in the first, and one back to front."""
    scene = small_scene(1, 24)
    frames = list(scene.mask_frames())[::2]
    body = scaled_to_height(human(), scene.subject.stature)
    pose = starts_in_frame(body, prepare(frames[0], body, np.zeros(body.skeleton.dof)), body.stature)[0].pose
    return scene, frames, Start(body, pose, 0.2), Start(body, turned_around(body, pose), 0.1)


def test_the_right_start_is_taken_whatever_is_tried_first(walk):
    scene, frames, right, turned = walk
    found = best_ways(human(), frames, RATE, height=scene.subject.stature, tried=[(0, turned), (0, right)])
    joints = found.starts.best.body.joints(found.starts.best.pose[None])[0]
    assert np.linalg.norm(joints - scene.joints[:24:2][found.at], axis=-1).mean() < 0.08
    costs = [w.cost for w in found.ways]
    assert costs == sorted(costs) and found.starts.weights.sum() == pytest.approx(1)


def test_frames_without_a_hull_have_no_start(walk):
    _, frames, _, _ = walk
    s = frames[0].silhouettes
    empty = [Frame(f.time, f.index, type(s)(0 * s.masks, s.rig, s.usable, s.reasons)) for f in frames[:4]]
    with pytest.raises(EvidenceError):
        best_ways(human(), empty, RATE, shared=True)
