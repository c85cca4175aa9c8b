"""What the others leave of the masks, by their hulls and by their rough bodies."""

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.evidence.frame import Frame, Silhouettes
from hypose.pipeline.person_paths import follow_places
from hypose.pipeline.rough_bodies import RoughTrack, frame_of_person, rough_bodies
from hypose.pipeline.start_choice import best_ways
from hypose.synthetic.scenes import make_scene
from hypose.tracking.several import shape_of
from hypose.tracking.starts import known_pose

FRAMES, RATE = 8, 12.5


@pytest.fixture(scope="module")
def beside():
    """Two of the template's bodies beside each other in four views; their poses (T, 2, D), and the silhouettes of each
    alone (T, 2, C, h, w)."""
    rig, body = make_scene("walk", rig="humaneva-4", seconds=0.1).rig.pinhole().scaled(0.6), human()
    size, base = rig.sizes.max(0), known_pose(human(), "standing")
    base[2] -= body.skin(base)[:, 2].min()
    frames, truth, alone = [], [], []
    for t in range(FRAMES):
        poses, masks = [], np.zeros((2, len(rig), size[1], size[0]), np.uint8)
        for k, x in enumerate((-0.4, 0.4)):
            pose = base.copy()
            pose[:2] += (x, 0.03 * t)
            poses.append(pose)
            shape = shape_of(body, pose, rig)
            for c, (y0, y1, x0, x1) in enumerate(shape.boxes):
                masks[k, c, y0:y1, x0:x1] = shape.drawn(c)
        s = Silhouettes(masks.max(0), rig, np.ones(len(rig), bool), ("",) * len(rig))
        frames.append(Frame(t / RATE, t, s))
        truth.append(np.stack(poses))
        alone.append(masks)
    paths = follow_places(lambda t: frames[t], range(FRAMES), RATE)
    order = np.argsort([p.axis(0)[0] for p in paths])
    assert len(paths) == 2
    return frames, np.stack(truth), np.stack(alone), [paths[k] for k in order]


def test_a_rough_body_hides_what_it_covers_and_hardly_more(beside):
    frames, truth, alone, paths = beside
    rough = [RoughTrack(human(), dict(enumerate(truth[:, k]))) for k in range(2)]
    for t in (0, FRAMES - 1):
        by_hull, by_body = frame_of_person(frames[t], t, 0, paths), frame_of_person(frames[t], t, 0, paths, rough)
        left = [f.silhouettes.informative for f in (by_hull, by_body)]
        own, other = alone[t, 0] > 0, alone[t, 1] > 0
        foreign = [int((m[other & ~own] > 0).sum()) for m in left]
        assert foreign[1] == 0  # nothing of the other one is taken for this one
        kept = [(m > 0)[own & ~other].sum() / (own & ~other).sum() for m in left]
        assert kept[1] > 0.9 and kept[1] > kept[0] - 0.01
        assert (by_body.visible_share > 0.3).all()


@pytest.mark.slow
def test_both_are_found_roughly_and_then_where_they_are(beside):
    """They stand still, arms hanging: beside the others' hulls even front and back are not sure."""
    frames, truth, _, paths = beside
    height, numbers = human().stature, range(FRAMES)
    rough = rough_bodies(lambda t: frames[t], numbers, paths, RATE, [(human(), height)] * 2)
    for k, one in enumerate(rough):
        true = human().joints(truth[:, k])
        joints = human().joints(np.stack(list(one.poses.values())))
        assert np.linalg.norm(joints[:, 0] - true[:, 0], axis=-1).mean() < 0.1
        own = [frame_of_person(frames[t], t, k, paths, rough) for t in numbers]
        found = best_ways(human(), own, RATE, height=height, shared=True, tried=one.starts(numbers)).ways[0]
        assert np.linalg.norm(human().joints(found.poses) - true, axis=-1).mean() < 0.03
