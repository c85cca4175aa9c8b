"""People in depth maps of a room that was not recorded empty: what stands on the floor, and what is none."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.evidence.depth_background import person_on_floor, unlike_people
from hypose.synthetic.depth_scenes import depth_scene
from hypose.synthetic.motions import act
from hypose.synthetic.performance import assemble
from hypose.synthetic.subjects import load_subjects
from tests.evidence.scenes import iou
from tests.standing_people import standing_at

FRAMES = 20


@pytest.fixture(scope="module")
def company():
    """Somebody who walks, somebody beside them who does not move at all, and a box that reaches to their chests."""
    subject = load_subjects()["neutral"]
    walk, wave = (act(name, subject, 0.8, 25.0, np.random.default_rng(4)) for name in ("walk", "wave"))
    still = [np.repeat(a[:1], FRAMES, axis=0) for a in (wave.rotations, wave.root)]
    stays = standing_at(assemble("stays", subject, walk.times, *still), (0.9, 0.4))
    scene = depth_scene(standing_at(walk, (-0.4, 0.0)), subject, "depth-2", seed=3)
    return replace(scene, others=((subject, stays),), furniture=((-1.2, 1.3, 0.6, 0.6, 1.1),))


@pytest.mark.parametrize("view", [0, 1])
def test_everybody_is_found_where_the_room_is_not_known(company, view):
    camera, maps = company.rig[view], [company.depth_map(view, t) for t in range(0, FRAMES, 2)]
    whole, walks = company.clean_map(view, 8)
    stands = whole < replace(company, others=()).clean_map(view, 8)[0] - 0.01
    room = unlike_people(maps, camera)
    people = (walks > 0) | stands
    assert iou(person_on_floor(maps[4], camera, room, several=True), people) > 0.85
    # who does not move is no part of the room; walls are
    assert stands.sum() > 1500 and (room[stands] > 0).mean() < 0.1
    walls = ((maps[4] > 0) & ~people)[: camera.size[1] // 4]
    assert (room[: len(walls)][walls] > 0).mean() > 0.8


def test_a_box_that_stands_still_is_nobody(company):
    camera = company.rig[0]
    maps = [company.depth_map(0, t) for t in range(0, FRAMES, 2)]
    box = company.clean_map(0, 8)[0] < replace(company, furniture=()).clean_map(0, 8)[0] - 0.01
    found = [person_on_floor(maps[4], camera, room, several=True)[box] for room in (None, unlike_people(maps, camera))]
    assert box.sum() > 800 and found[0].mean() > 0.5 and found[1].mean() < 0.1
