"""The empty room of a view: learnt, followed while it changes, and never a place in which somebody stands."""

import numpy as np
import pytest

from hypose.cameras.camera import Camera
from hypose.evidence.pose_network import CROP, Crop, Sighting
from hypose.evidence.silhouettes import SilhouetteSettings
from hypose.pipeline.live.background_models import NetworkBackground, ViewBackground
from hypose.synthetic.scenes import camera_rig

W, H = 160, 120
PERSON = (slice(30, 100), slice(40, 62))
CHAIR = (slice(70, 100), slice(110, 135))


@pytest.fixture
def camera() -> Camera:
    return camera_rig("humaneva-4").scaled(0.25)[0]


@pytest.fixture
def wall(rng):
    """(H, W, 3): a room with a pattern."""
    coarse = rng.integers(60, 190, (H // 10, W // 10, 3)).astype(np.float32)
    return np.repeat(np.repeat(coarse, 10, 0), 10, 1)


def picture(wall, rng, gain=1.0, *things):
    """The room under a light, with noise, and things of one colour in it."""
    out = wall * gain
    for where, colour in things:
        out = out.copy()
        out[where] = colour
    return np.clip(out + rng.normal(0, 2, out.shape), 0, 255).astype(np.uint8)


@pytest.fixture
def room(camera, wall, rng):
    made = ViewBackground(camera, camera, (0.0, 0.0), SilhouetteSettings())
    assert made.background is None
    made.learn([picture(wall, rng) for _ in range(12)])
    return made


RED, BLUE = (10, 20, 240), (240, 30, 10)


def marked(mask, where):
    return float(mask[where].mean())


def test_what_stands_in_the_room_is_found_with_its_outline(room, wall, rng):
    mask, outline = room.mask(picture(wall, rng, 1.0, (PERSON, RED)))
    assert mask.shape == (H, W) and outline is not None
    assert marked(mask, PERSON) > 0.95 and mask.sum() < 1.15 * mask[PERSON].size
    empty, none = room.mask(picture(wall, rng))
    assert empty.sum() < 0.002 * empty.size
    assert none is None or empty.any()


def test_light_that_changes_is_followed(room, wall, rng):
    """The light of a window falls upon the left half: not what the gain of a camera explains."""
    before = np.asarray(room.background.mean).copy()
    lamp = wall.copy()
    for second in range(60):
        lamp[:, : W // 2] = wall[:, : W // 2] * (1 + 0.35 * second / 60)
        room.follow(picture(lamp, rng), float(second), None)
    mask, _ = room.mask(picture(lamp, rng, 1.0, (PERSON, RED)))
    away = np.abs(np.asarray(room.background.mean) - lamp).mean()
    assert away < 0.5 * np.abs(before - lamp).mean()
    assert marked(mask, PERSON) > 0.95 and mask.sum() < 1.3 * mask[PERSON].size


@pytest.mark.parametrize("known", [True, False])
def test_who_stands_still_stays_out_of_the_room(room, wall, rng, known):
    person = np.zeros((H, W), np.uint8)
    person[PERSON] = 1
    for second in range(120):
        room.follow(picture(wall, rng, 1.0, (PERSON, RED)), float(second), person if known else None)
    mask, _ = room.mask(picture(wall, rng, 1.0, (PERSON, RED)))
    assert marked(mask, PERSON) > 0.95
    gone, _ = room.mask(picture(wall, rng))
    assert gone.sum() < 0.01 * gone.size  # and leaves no hole


def test_a_chair_that_was_moved_becomes_a_part_of_the_room_outside_the_person(room, wall, rng):
    person = np.zeros((H, W), np.uint8)
    person[PERSON] = 1
    things = ((CHAIR, BLUE), (PERSON, RED))
    assert marked(room.mask(picture(wall, rng, 1.0, (CHAIR, BLUE)))[0], CHAIR) > 0.9
    for second in range(120):
        room.follow(picture(wall, rng, 1.0, *things), float(second), person)
    assert room.mask(picture(wall, rng, 1.0, (CHAIR, BLUE)))[0].mean() < 0.002
    assert marked(room.mask(picture(wall, rng, 1.0, *things))[0], PERSON) > 0.95


def test_a_network_needs_no_empty_room():
    """Its masks lie where the person is in the undistorted picture, and it looks next where the person was."""
    camera = camera_rig("humaneva-4").scaled(0.5)[0]
    small, asked = camera.pinhole().scaled((160, 120)), []

    class Network:
        def look(self, image, number, before):
            asked.append((number, len(before)))
            assert image.shape == (240, 320, 3)
            crop = Crop(np.array([160.0, 120.0]), np.array([160.0, 60.0]))
            return [Sighting(np.ones((33, 3)), np.full((CROP, CROP), number < 2, np.float32), crop, crop)]

    room = NetworkBackground(camera, small, (8.0, 0.0), Network())
    room.learn([])
    mask, outline = room.mask(np.zeros((240, 320, 3), np.uint8))
    assert mask.shape == small.size[::-1] and outline is not None
    middle = camera.undistort_points(np.array([[160.0 + 8, 120.0]]))[0] / 2
    np.testing.assert_allclose(np.argwhere(mask).mean(0)[::-1], middle, atol=1.0)
    assert mask.sum() == pytest.approx(75**2, rel=0.1)  # half side 1.25 x 60 px, in half the size
    room.mask(np.zeros((240, 320, 3), np.uint8))
    assert asked == [(0, 0), (1, 1)]
