"""People before depth cameras: found as clusters, and which pixels are whose."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Frame
from hypose.evidence.people import BodyShape, Other, own_frame, people_seen
from hypose.evidence.silhouettes import make_silhouettes
from tests.depth_pictures import WALL_M, drawn, sensors
from tests.evidence.scenes import on_floor

PLACES = ((-0.5, 0.0), (0.45, 0.3))


def both_before(body, rig, places):
    """Poses of people at places; what each sensor measures of each alone (2, C, h, w) m; the frame of both."""
    poses = [on_floor(body, p) for p in places]
    alone = np.stack([drawn(body, q, rig)[0] for q in poses])
    maps = alone.min(0)
    silhouettes = make_silhouettes(list((maps < WALL_M).astype(np.uint8)), rig)
    depth = Depth(maps, silhouettes.masks, rig, np.ones(len(rig), bool))
    return poses, alone, Frame(0.0, 0, silhouettes, depth=depth)


@pytest.fixture(scope="module", params=[1, 2], ids=["one sensor", "two sensors"])
def scene(request):
    """Two people, poses; rig; the frame of both; each one's own pixels (2, C, h, w)."""
    body, rig = human(), sensors(request.param)
    poses, alone, frame = both_before(body, rig, PLACES)
    return body, poses, rig, frame, (alone < WALL_M) & (alone == frame.depth.maps)


def test_two_people_are_two_clusters_where_they_stand(scene):
    _, _, _, frame, owners = scene
    found = people_seen(frame)
    assert len(found) == 2
    for place, own in zip(PLACES, owners, strict=True):
        person = min(found, key=lambda p: np.linalg.norm(p.axis - place))
        assert np.linalg.norm(person.axis - place) < 0.25  # their surface is nearer to the sensors than they are
        # values at edges are nobody's, for they may lie between both sides
        assert (person.seen[own] > 0).mean() > 0.6 and own[person.seen > 0].mean() > 0.99


@pytest.mark.parametrize("who", [0, 1])
def test_pixels_belong_to_whose_body_is_nearest(scene, who):
    body, poses, rig, frame, owners = scene
    moved = [q + np.eye(len(q))[0] * 0.06 for q in poses]  # they are expected 6 cm beside
    shapes = [BodyShape(body.skin(q), body.coarse.faces, rig) for q in moved]
    own = own_frame(frame, shapes[who], [Other(shapes[1 - who])])
    mask, others = own.silhouettes.masks > 0, owners[1 - who]
    assert mask[owners[who]].mean() > 0.97 and mask[others].mean() < 0.02
    assert np.array_equal(own.depth.person, own.silhouettes.masks)
    assert np.array_equal(own.depth.maps, frame.depth.maps)  # nobody is before what was seen of the others either
    assert np.linalg.norm(np.median(own.depth.surface.points, axis=0)[:2] - PLACES[who]) < 0.2


def test_others_before_a_person_say_nothing_of_them_and_others_behind_do():
    """One behind the other, 0.9 m apart: who stands in front is seen as if alone."""
    body, rig = human(), sensors(1)
    poses, alone, frame = both_before(body, rig, ((0.0, -0.45), (0.2, 0.45)))
    shapes = [BodyShape(body.skin(q), body.coarse.faces, rig) for q in poses]
    front = own_frame(frame, shapes[0], [Other(shapes[1])]).silhouettes
    assert front.ignored is None or front.ignored[0].mean() < 0.002
    behind = own_frame(frame, shapes[1], [Other(shapes[0])]).silhouettes
    hidden = (alone[1][0] < WALL_M) & (alone[0][0] < WALL_M)
    assert hidden.sum() > 300 and behind.ignored[0][hidden].mean() > 0.97


@pytest.mark.parametrize("who", [0, 1])
def test_a_colour_camera_beside_shows_what_the_other_body_leaves(who):
    """The second view has a mask of both and no map."""
    body, rig = human(), sensors(2)
    poses, alone, frame = both_before(body, rig, ((-0.5, -0.2), (0.45, 0.2)))
    owners, first, there = alone < WALL_M, np.array([1, 0], np.uint8)[:, None, None], np.array([True, False])
    frame = replace(frame, depth=Depth(frame.depth.maps * first, frame.depth.person * first, rig, there))
    shapes = [BodyShape(body.skin(q), body.coarse.faces, rig) for q in poses]
    own = own_frame(frame, shapes[who], [Other(shapes[1 - who])])
    told, mine, theirs = own.silhouettes.informative[1] > 0, owners[who, 1], owners[1 - who, 1]
    assert own.silhouettes.usable.all() and own.depth.usable.tolist() == [True, False]
    assert told[mine & ~theirs].mean() > 0.8 and told[theirs].sum() == 0
    blind = replace(frame, silhouettes=replace(frame.silhouettes, usable=there))
    without_colour = own_frame(blind, shapes[who], [Other(shapes[1 - who])]).silhouettes
    assert np.array_equal(own.silhouettes.informative[0], without_colour.informative[0])
    # whoever is only known by what depth cameras measure is not looked for in pictures
    seen = own_frame(frame, people_seen(frame)[0].shape(rig), [])
    assert seen.silhouettes.usable.tolist() == [True, False]
