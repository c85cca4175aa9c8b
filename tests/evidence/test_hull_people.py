"""People in the hull: who stands there, who is explained already, and nobody who does not stand there."""

import numpy as np
import pytest

from hypose.body.ready_bodies import human
from hypose.evidence.frame import Silhouettes
from hypose.evidence.hull_people import people_in_hull
from hypose.evidence.shared_masks import Other
from hypose.synthetic.scenes import make_scene
from hypose.tracking.several import shape_of
from hypose.tracking.starts import known_pose


def standing(places, rig):
    body, shapes = human(), []
    size = rig.sizes.max(0)
    masks = np.zeros((len(rig), size[1], size[0]), np.uint8)
    for x, y in places:
        pose = known_pose(body, "standing")
        pose[:3] += (x, y, -body.skin(pose)[:, 2].min())
        shapes.append(shape_of(body, pose, rig))
        for c, (y0, y1, x0, x1) in enumerate(shapes[-1].boxes):
            masks[c, y0:y1, x0:x1] |= shapes[-1].drawn(c)
    return Silhouettes(masks, rig, np.ones(len(rig), bool), ("",) * len(rig)), shapes


@pytest.fixture(scope="module")
def rig():
    return make_scene("walk", rig="humaneva-4", seconds=0.1).rig.pinhole()


@pytest.mark.parametrize("places", [[(0.0, 0.0)], [(-0.5, 0.1), (0.5, 0.0)], [(-0.6, 0.0), (0.5, 0.5), (0.3, -0.8)]])
def test_everybody_is_found_where_they_stand_and_nobody_else(rig, places):
    silhouettes, _ = standing(places, rig)
    found = people_in_hull(silhouettes)
    assert len(found) == len(places)
    for place in places:
        assert min(np.linalg.norm(p.axis - place) for p in found) < 0.12
    assert all(40 < p.litres < 200 for p in found)


def test_who_is_explained_is_not_found_again(rig):
    silhouettes, shapes = standing([(-0.5, 0.1), (0.5, 0.0)], rig)
    found = people_in_hull(silhouettes, [Other(shapes[0])])
    assert len(found) == 1 and np.linalg.norm(found[0].axis - (0.5, 0.0)) < 0.15
    assert people_in_hull(silhouettes, [Other(s) for s in shapes]) == []


def test_what_floats_or_is_seen_by_two_views_alone_is_nobody(rig):
    silhouettes, _ = standing([(0.0, 0.0)], rig)
    assert people_in_hull(silhouettes, floor=-1.0) == []  # the floor lies a metre below the feet
    two = silhouettes.masks.copy()
    two[:2] = 0
    assert people_in_hull(Silhouettes(two, rig, silhouettes.usable, silhouettes.reasons)) == []


def test_a_persons_shape_lies_in_the_masks(rig):
    silhouettes, _ = standing([(0.2, -0.1)], rig)
    shape = people_in_hull(silhouettes)[0].shape(rig)
    for c in range(len(rig)):
        inside = (shape.masks[c] & silhouettes.masks[c]).sum()
        assert inside > 0.85 * silhouettes.masks[c].sum() and inside > 0.6 * shape.masks[c].sum()
