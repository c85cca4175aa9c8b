"""Depth as evidence: points of the surface, noise, the person before the room or on the floor, and the floor itself."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.synthetic.depth_frames import depth_frames, empty_rooms
from hypose.body.default_body import human
from hypose.errors import EvidenceError, InputError
from hypose.evidence.depth_background import (
    learn_background,
    person_before,
    person_on_floor,
    with_still_things,
)
from hypose.evidence.depth_evidence import Depth, camera_on_floor
from hypose.evidence.frame import Frame
from hypose.evidence.people import occupied_space
from hypose.geometry import se3, se3_inverse
from hypose.synthetic.depth_scenes import depth_scene
from hypose.synthetic.motions import act
from hypose.synthetic.performance import assemble, moved
from hypose.synthetic.scenes import look_at
from hypose.synthetic.subjects import load_subjects
from hypose.tracking.start_search import known_pose
from tests.depth_pictures import frame_of, seen_in_room, sensors
from tests.evidence.scenes import iou


def standing(place=(0.0, 0.0, 0.95)):
    body = human()
    pose = known_pose(body, "standing")
    pose[:3] = place
    return body, pose


def test_points_lie_on_the_surface_that_the_sensor_sees():
    body, pose = standing()
    depth = frame_of(body, pose, sensors()).depth
    found = depth.surface
    assert 150 < found.first[1] <= 200 and found.first[-1] == len(found.points)
    vertices = body.skin(pose)
    corners = vertices[body.coarse.faces]
    gap = np.array([np.linalg.norm(corners.mean(1) - p, axis=1).min() for p in found.points])
    assert np.percentile(gap, 95) < 0.06  # the mesh's faces are some centimetres wide
    for c, camera in enumerate(depth.rig):
        own = slice(*found.first[c : c + 2])
        ray = found.points[own] - camera.position
        assert ((found.normals[own] * ray).sum(1) < 0).all()
        assert np.abs(np.linalg.norm(found.normals[own], axis=1) - 1).max() < 1e-9


def test_a_view_without_depth_gives_no_points():
    body, pose = standing()
    depth = frame_of(body, pose, sensors(2)).depth
    half = Depth(depth.maps, depth.person, depth.rig, np.array([False, True]))
    assert half.surface.first.tolist()[:2] == [0, 0]
    nobody = Depth(depth.maps, 0 * depth.person, depth.rig, depth.usable)
    assert len(nobody.surface.points) == 0
    with pytest.raises(EvidenceError, match="no depth camera|No depth camera"):
        occupied_space(Frame(0.0, 0, depth=nobody))


@pytest.fixture(scope="module")
def scene():
    subject = load_subjects()["neutral"]
    p = act("walk", subject, 0.4, 25.0, np.random.default_rng(4))
    return depth_scene(p, subject, "depth-2", seed=3)


def test_the_person_before_a_room_that_was_learnt(scene):
    rooms = empty_rooms(scene, 8)
    for view in (0, 1):
        found = person_before(scene.depth_map(view, 4), rooms[view])
        assert iou(found, scene.clean_map(view, 4)[1]) > 0.9
        assert person_before(scene.empty_map(view, 99), rooms[view]).sum() < 60


def test_the_person_on_the_floor_where_the_room_is_not_known(scene):
    for view in (0, 1):
        found = person_on_floor(scene.depth_map(view, 4), scene.rig[view])
        assert iou(found, scene.clean_map(view, 4)[1]) > 0.85
    assert person_on_floor(np.zeros((288, 320), np.float32), scene.rig[0]).sum() == 0
    floor = np.where(scene.empty_map(0, 5) < 2.6, scene.empty_map(0, 5), 0).astype(np.float32)
    assert person_on_floor(floor, scene.rig[0]).sum() == 0


def test_a_table_before_the_person_says_nothing_of_their_legs(scene):
    free = next(depth_frames(scene)).silhouettes
    assert free.ignored is None
    with_table = replace(scene, furniture=((0.0, -1.0, 1.0, 0.4, 0.7),))
    hidden = next(depth_frames(with_table)).silhouettes
    person = scene.clean_map(0, 0)[1] > 0
    behind = person & (with_table.clean_map(0, 0)[1] == 0)
    assert behind.sum() > 300  # of the legs, from in front
    assert hidden.ignored[0][behind].mean() > 0.9
    assert hidden.informative[0][person & ~behind].mean() > 0.85
    assert hidden.areas[0] < free.areas[0] < 1.5 * hidden.expected.areas[0]


@pytest.mark.slow
def test_things_that_were_not_in_the_empty_room_are_told_by_who_walks_about():
    subject = load_subjects()["neutral"]
    walk = act("walk", subject, 2.0, 25.0, np.random.default_rng(3))
    empty = depth_scene(moved(walk, 0.0, tuple(-walk.root[:, :2].mean(0))), subject, "depth-2", seed=4)
    chair = replace(empty, furniture=((0.5, 0.5, 0.5, 0.5, 0.9),))
    for view, room in enumerate(empty_rooms(empty, 8)):
        camera, at = chair.rig[view], range(0, len(walk), 4)
        again, area = with_still_things(room, [empty.depth_map(view, k) for k in at], camera)
        assert again is room and area == 0
        furnished, area = with_still_things(room, [chair.depth_map(view, k) for k in at], camera)
        assert 0.2 < area < 0.6
        truth = chair.clean_map(view, 25)[1]
        assert iou(person_before(chair.depth_map(view, 25), furnished, camera.K[0, 0]), truth) > 0.85
        assert iou(person_before(chair.depth_map(view, 25), room, camera.K[0, 0]), truth) < 0.75
    root = walk.root * [0, 0, 1]
    stays = replace(chair, performance=assemble("stays", subject, walk.times, walk.rotations, root))
    room = empty_rooms(empty, 8)[0]  # who stays beside a thing cannot be told from it
    assert with_still_things(room, [stays.depth_map(0, k) for k in range(0, 50, 4)], stays.rig[0])[0] is room


def test_rooms_of_another_size_or_without_maps_are_named(scene):
    room = learn_background([scene.empty_map(0, 0)])
    with pytest.raises(InputError, match="same mode"):
        person_before(np.zeros((10, 20), np.float32), room)
    with pytest.raises(InputError, match="at least one"):
        learn_background([])
    with pytest.raises(InputError, match="one size"):
        learn_background([np.ones((4, 4), np.float32), np.ones((4, 5), np.float32)])


def test_the_floor_tells_which_way_is_up_and_how_high_the_sensor_hangs(scene):
    for view, camera in enumerate(scene.rig):
        found = camera_on_floor(scene.empty_map(view, 0), camera)
        up = camera.camera_from_world[:3, :3] @ [0, 0, 1.0]
        assert np.degrees(np.arccos(min(found[:3, 2] @ up, 1.0))) < 0.3
        assert abs(se3_inverse(found)[2, 3] - camera.position[2]) < 0.01
        assert np.allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3), atol=1e-9)
        assert np.linalg.det(found[:3, :3]) == pytest.approx(1.0)
    with pytest.raises(EvidenceError, match="floor"):
        camera_on_floor(np.zeros((20, 30), np.float32), scene.rig[0])


def test_a_table_is_not_the_floor():
    own = look_at("d", (0, 0, 1.4), (0, 2.0, 0.4), 110.0, (160, 120))
    floor = seen_in_room(own, person=False)
    higher = replace(own, camera_from_world=own.camera_from_world @ se3(np.eye(3), np.array([0, 0, 0.75])))
    table = seen_in_room(higher, person=False)  # the same, but its floor is 0.75 m up
    seen = np.where(np.arange(160) < 110, np.minimum(table, floor), floor).astype(np.float32)
    assert (seen < floor).mean() > 2 * ((seen == floor) & (floor < 3.3)).mean()
    assert se3_inverse(camera_on_floor(seen, own))[2, 3] == pytest.approx(1.4, abs=0.01)
