"""People in the same masks are found roughly, each in what the others leave of the masks, and then where they are."""

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.evidence.frame import Frame
from hypose.pipeline.people import frame_of_person, rough_bodies
from hypose.pipeline.start_choice import best_ways
from hypose.pipeline.track_loop import body_shape
from hypose.pipeline.track_management import follow_places
from hypose.synthetic.scenes import make_scene
from hypose.tracking.start_search import known_pose
from tests.evidence.scenes import masks_of

FRAMES, RATE = 8, 12.5


@pytest.fixture(scope="module")
def beside():
    """Two of the template's bodies beside each other in four views; their poses (T, 2, D) and paths."""
    rig, body = make_scene("walk", rig="humaneva-4", seconds=0.1).rig.pinhole().scaled(0.6), human()
    base = known_pose(human(), "standing")
    base[2] -= body.skin(base)[:, 2].min()
    frames, truth = [], []
    for t in range(FRAMES):
        poses = np.stack([base, base])
        poses[:, :2] += ((-0.4, 0.03 * t), (0.4, 0.03 * t))
        frames.append(Frame(t / RATE, t, masks_of([body_shape(body, pose, rig) for pose in poses], rig)))
        truth.append(poses)
    paths = follow_places(lambda t: frames[t], range(FRAMES), RATE)
    order = np.argsort([p.axis(0)[0] for p in paths])
    assert len(paths) == 2
    return frames, np.stack(truth), [paths[k] for k in order]


@pytest.mark.slow
def test_both_are_found_roughly_and_then_where_they_are(beside):
    """They stand still, arms hanging: beside the others' hulls even front and back are not sure."""
    frames, truth, paths = beside
    height, numbers = human().stature, range(FRAMES)
    rough = rough_bodies(lambda t: frames[t], numbers, paths, RATE, [(human(), height)] * 2)
    for k, one in enumerate(rough):
        true = human().joints(truth[:, k])
        joints = human().joints(np.stack(list(one.poses.values())))
        assert np.linalg.norm(joints[:, 0] - true[:, 0], axis=-1).mean() < 0.1
        own = [frame_of_person(frames[t], t, k, paths, rough) for t in numbers]
        found = best_ways(human(), own, RATE, height=height, shared=True, tried=one.starts(numbers)).ways[0]
        assert np.linalg.norm(human().joints(found.poses) - true, axis=-1).mean() < 0.03
