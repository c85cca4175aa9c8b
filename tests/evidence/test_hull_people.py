"""People in the hull: who stands there, who is explained already, and nobody who does not stand there."""

import numpy as np
import pytest
import trimesh

from hypose.body.default_body import human
from hypose.evidence.frame import Frame, Silhouettes
from hypose.evidence.people import BodyShape, people_in_hull
from hypose.pipeline.track_loop import body_shape
from hypose.pipeline.track_management import follow_places
from hypose.synthetic.scenes import make_scene
from hypose.tracking.start_search import scaled_to_height
from tests.evidence.scenes import masks_of, on_floor


def standing(places, rig, body=None):
    body = body or human()
    shapes = [body_shape(body, on_floor(body, place), rig) for place in places]
    return masks_of(shapes, rig), shapes


def boxes(*corners):
    """Vertices and faces of boxes from one corner to the other, m."""
    parts = [trimesh.creation.box(bounds=c) for c in corners]
    faces = [part.faces + 8 * k for k, part in enumerate(parts)]
    return np.concatenate([part.vertices for part in parts]), np.concatenate(faces).astype(np.int32)


CHAIR = boxes(
    [(-0.22, -0.22, 0.42), (0.22, 0.22, 0.46)],
    [(-0.22, 0.18, 0.46), (0.22, 0.22, 0.95)],
    *([(x - 0.02, y - 0.02, 0), (x + 0.02, y + 0.02, 0.42)] for x in (-0.2, 0.2) for y in (-0.2, 0.2)),
)
DOG = boxes(
    [(-0.4, -0.12, 0.35), (0.4, 0.12, 0.62)],
    [(0.35, -0.08, 0.55), (0.6, 0.08, 0.85)],
    *([(x - 0.04, y - 0.04, 0), (x + 0.04, y + 0.04, 0.35)] for x in (-0.35, 0.35) for y in (-0.08, 0.08)),
)
BIN = boxes([(-0.17, -0.17, 0), (0.17, 0.17, 0.9)])


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


@pytest.mark.parametrize("height", [0.9, 1.0, 1.1])
def test_a_child_is_found_alone_and_beside_a_grown_up(rig, height):
    child = scaled_to_height(human(), height)
    alone, shapes = standing([(0.5, 0.1)], rig, child)
    found = people_in_hull(alone)
    assert len(found) == 1 and np.linalg.norm(found[0].axis - (0.5, 0.1)) < 0.12
    _, grown = standing([(-0.4, -0.2)], rig)
    both = people_in_hull(masks_of([*shapes, *grown], rig))
    assert sorted(p.hull.height > 1.3 for p in both) == [False, True]
    paths = follow_places(lambda t: Frame(t / 25, t, masks_of([*shapes, *grown], rig)), range(3), 25.0)
    assert [len(p.found) for p in paths] == [3, 3]


@pytest.mark.parametrize("thing", [CHAIR, DOG, BIN], ids=["chair", "dog", "bin"])
def test_a_thing_as_low_as_a_child_is_nobody(rig, thing):
    assert people_in_hull(masks_of([BodyShape(thing[0] + (0.3, 0.1, 0.0), thing[1], rig)], rig)) == []


def test_what_floats_or_is_seen_by_two_views_alone_is_nobody(rig):
    silhouettes, _ = standing([(0.0, 0.0)], rig)
    assert people_in_hull(silhouettes, floor=-1.0) == []  # the floor lies a metre below the feet
    two = silhouettes.masks.copy()
    two[:2] = 0
    assert people_in_hull(Silhouettes(two, rig, silhouettes.usable, silhouettes.reasons)) == []
