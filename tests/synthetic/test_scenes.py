from dataclasses import replace

import cv2
import numpy as np
import pytest

from benchmarks.synthetic.noisy_masks import noisy
from hypose.errors import InputError
from hypose.synthetic.motions import act
from hypose.synthetic.render_rgb import Sensor, shadow_mask
from hypose.synthetic.scenes import RIG_NAMES, camera_rig, make_scene

RIGS = [n.replace("ring-N", "ring-6") for n in RIG_NAMES]


def scene(person, what=(), **more):
    return make_scene("walk", person, "humaneva-4", seconds=1.0, seed=3, corruption=what, **more)


@pytest.mark.parametrize("name", RIGS)
def test_rigs_see_the_whole_body(person, name):
    """Standing with raised arms anywhere within 0.8 m of the centre."""
    p = act("wave", person, 2.0, 10.0)
    v = np.concatenate([person.skin(p.rotations[t], p.root[t]) for t in (0, 8, 12)])
    for camera in camera_rig(name):
        for a in np.linspace(0, 6.28, 8):
            uv = camera.project(v + [0.8 * np.cos(a), 0.8 * np.sin(a), 0])
            assert (uv >= 0).all() and (uv <= np.array(camera.size) - 1).all(), (camera.name, a)


def test_rigs_are_upright_distinct_and_optionally_distorted():
    plain, bent = camera_rig("humaneva-7"), camera_rig("humaneva-7", distorted=True)
    heights = [camera.project([[0, 0, 0.5], [0, 0, 1.5]])[:, 1] for camera in plain]
    assert len(heights) == 7 and all(high < low for low, high in heights)  # image y points down
    corner = plain[0].rays(np.array([2.0, 2.0]))
    point = corner[0] + 3 * corner[1]
    assert np.linalg.norm(bent[0].project(point) - plain[0].project(point)) > 8
    for bad in ("ring-0", "ring-99", "mars"):
        with pytest.raises(InputError, match="humaneva-4"):
            camera_rig(bad)
    with pytest.raises(InputError, match="subjects are"):
        make_scene("walk", "nobody", "humaneva-4")


def test_same_seed_same_scene_in_any_order(person):
    a, b = noisy(scene(person)), noisy(scene(person))
    fa, fb = list(a.mask_frames(0.5)), list(b.mask_frames(0.5))
    assert all(np.array_equal(x.silhouettes.masks, y.silhouettes.masks) for x, y in zip(fa, fb, strict=True))
    late = b.rgb_frame(1, 7)
    assert np.array_equal(a.rgb_frame(1, 2), b.rgb_frame(1, 2))
    assert np.array_equal(a.rgb_frame(1, 7), late)
    assert np.array_equal(a.background_frames(2, 3)[2], b.background_frames(2, 3)[2])
    other = make_scene("walk", person, "humaneva-4", seconds=1.0, seed=4)
    assert not np.array_equal(other.joints, a.joints)


def test_dead_camera_is_flagged_and_black(person):
    s = scene(person, ("dead-camera",))
    frames = list(s.mask_frames(0.25))
    assert frames[0].silhouettes.usable.all()
    assert frames[20].silhouettes.usable.tolist() == [True, False, True, True]
    assert frames[20].silhouettes.reasons[1] == "black image" and frames[20].silhouettes.areas[1] == 0
    assert s.rgb_frame(1, 20).max() == 0 and s.rgb_frame(0, 20).max() > 0


def test_desynchronised_cameras_are_late(person):
    s, synchronous = scene(person, ("desync",)), scene(person)
    late, true = list(s.mask_frames(0.5)), list(synchronous.mask_frames(0.5))
    for c, delay in enumerate((0, 1, 0, 2)):
        assert np.array_equal(late[10].silhouettes.masks[c], true[10 - delay].silhouettes.masks[c])


def test_occluders_cut_the_person_in_some_view(person):
    s, free = scene(person, ("table",)), scene(person)
    lost = [1 - s.clean_mask(c, 5).sum() / free.clean_mask(c, 5).sum() for c in range(4)]
    # lower legs and feet in the camera behind the table, hardly anything elsewhere
    assert max(lost) > 0.05 and min(lost) >= 0
    plain, table = (x.background_frames(2, 1)[0].astype(int) for x in (free, s))
    assert (np.abs(table - plain).max(2) > 30).sum() > 300


def test_pictures_differ_from_the_empty_room_exactly_where_body_and_shadow_are(person):
    s = replace(scene(person), sensor=Sensor(noise_sd=0.0, drift=0.0))
    for c in (0, 3):
        room = s.background_frames(c, 1)[0].astype(int)
        changed = np.abs(s.rgb_frame(c, 6).astype(int) - room).max(2) > 6
        body = s.clean_mask(c, 6) > 0
        shadow = shadow_mask(s.rig[c], s.subject.faces, s.vertices(6)) > 0
        near = cv2.dilate((body | shadow).astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
        assert not (changed & ~near).any()
        assert (changed & body).sum() > 0.9 * body.sum()
        assert shadow.sum() > 200 and (changed & shadow & ~body).sum() > 0.5 * (shadow & ~body).sum()


def test_distorted_pictures_agree_with_the_undistorted_masks(person):
    s = scene(person, distorted=True)
    camera = s.rig[1]
    maps = camera.undistort_maps(camera.size)
    difference = np.abs(s.rgb_frame(1, 4).astype(np.int16) - s.background_frames(1, 1)[0]).max(2).astype(np.uint8)
    straight = cv2.remap(difference, *maps, cv2.INTER_LINEAR)
    mask = s.clean_mask(1, 4)
    assert (straight[mask > 0] > 15).mean() > 0.9
    assert (straight[:150][mask[:150] == 0] > 15).mean() < 0.01  # above the floor: no shadow there
