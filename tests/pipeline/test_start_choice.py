"""Which of several starts is right is decided by all frames."""

import numpy as np
import pytest

from benchmarks.robustness.small_recordings import small_scene
from hypose.body.default_body import human
from hypose.errors import EvidenceError
from hypose.evidence.frame import Frame
from hypose.pipeline.start_choice import BestWays, StartTrial, best_ways, way_of
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.left_right import turned_around
from hypose.tracking.start_search import Start, by_their_ways
from hypose.tracking.starts import KNOWN_POSES, start_in_pose
from hypose.tracking.subject import scaled_to_height

RATE = 12.5


@pytest.fixture(scope="module")
def walk():
    """Frames of a walk at RATE, a start the right way round in the first, and one back to front."""
    scene = small_scene(1, 24)
    frames = list(scene.mask_frames())[::2]
    body = scaled_to_height(human(), scene.subject.stature)
    pose = start_in_pose(body, prepare(frames[0], body, np.zeros(body.skeleton.dof)), KNOWN_POSES).pose
    return scene, frames, Start(body, pose, 0.2), Start(body, turned_around(body, pose), 0.1)


def test_who_stands_back_to_front_costs_more_on_the_way_and_is_given_up(walk):
    scene, frames, right, turned = walk
    good, bad = way_of(right, 0, frames, RATE), way_of(turned, 0, frames, RATE)
    assert good.poses.shape == (len(frames), len(right.pose)) and good.cost < bad.cost
    away = np.linalg.norm(right.body.joints(good.poses) - scene.joints[:24:2], axis=-1)
    assert away.mean() < 0.06
    assert way_of(right, 0, frames, RATE, best=good) is not None
    elsewhere = right.pose.copy()
    elsewhere[:2] += 1.5  # from half a metre a person is found
    assert way_of(Start(right.body, elsewhere, 0.0), 0, frames, RATE, best=good) is None


def test_the_right_start_is_taken_whatever_is_tried_first(walk):
    scene, frames, right, turned = walk
    found = best_ways(human(), frames, RATE, height=scene.subject.stature, tried=[(0, turned), (0, right)])
    joints = found.starts.best.body.joints(found.starts.best.pose[None])[0]
    assert np.linalg.norm(joints - scene.joints[:24:2][found.at], axis=-1).mean() < 0.08
    costs = [w.cost for w in found.ways]
    assert costs == sorted(costs) and found.starts.weights.sum() == pytest.approx(1)


def test_a_start_of_another_frame_is_judged_by_where_its_way_has_it(walk):
    _, frames, right, _ = walk
    good, beside = way_of(right, 0, frames, RATE), right.pose.copy()
    beside[:2] += 0.4
    moved = Start(right.body, beside, 0.2)
    starts, _ = by_their_ways([moved], [good.poses], np.array([good.cost]))
    with pytest.raises(EvidenceError):
        BestWays(starts, 0).check(frames)
    BestWays(starts, 0, (StartTrial(moved, 0, good.poses, good.costs),)).check(frames)


def test_frames_without_a_hull_have_no_start(walk):
    _, frames, _, _ = walk
    s = frames[0].silhouettes
    empty = [Frame(f.time, f.index, type(s)(0 * s.masks, s.rig, s.usable, s.reasons)) for f in frames[:4]]
    with pytest.raises(EvidenceError):
        best_ways(human(), empty, RATE, shared=True)
