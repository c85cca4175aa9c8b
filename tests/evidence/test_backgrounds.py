import numpy as np
import pytest

from hypose.errors import InputError
from hypose.evidence.background import from_frames, from_plates, from_recording
from hypose.evidence.silhouettes import Segmenter
from tests.evidence.scenes import ellipse, iou, picture, room

SHAPE = (240, 320)


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(1)
    background = room(rng, SHAPE)
    empty = [np.clip(background + rng.normal(0, 3, background.shape), 0, 255).astype(np.uint8) for _ in range(15)]
    truth = [ellipse(SHAPE, t) for t in np.linspace(0, 1, 40)]
    film = np.stack([picture(rng, background, m) for m in truth])
    return background, empty, film, truth


def test_recording_with_covers_needs_no_plate(scene):
    background, _, film, truth = scene
    covered = np.stack([_shadow_too(m) for m in truth])
    model = from_recording(film, covered)
    assert model.valid.all()
    assert np.abs(model.mean - background).mean() < 1.2


def _shadow_too(mask):
    import cv2

    return cv2.dilate(mask, np.ones((61, 81), np.uint8))


def test_pixels_that_are_never_free_come_from_the_photo_else_are_invalid(scene):
    background, empty, film, truth = scene
    covered = np.stack([_shadow_too(m) for m in truth])
    covered[:, 100:120, 150:180] = 1
    alone = from_recording(film, covered)
    assert not alone.valid[100:120, 150:180].any()
    assert "covered by the person in every frame" in alone.note
    with_photo = from_recording(film, covered, from_plates(empty[:1]))
    assert with_photo.valid.all()
    assert np.abs(with_photo.mean[100:120, 150:180] - background[100:120, 150:180]).mean() < 4


def test_moved_thing_and_stranger_in_the_photo_are_cured_without_key_points(scene):
    background, empty, film, truth = scene
    photo = empty[0].copy()
    photo[20:60, 20:60] = (20, 30, 240)  # an observer in the photo
    moved = film.copy()
    moved[:, 10:40, 250:290] = (240, 240, 20)  # a box put there after the photo
    model = from_recording(moved, None, from_plates([photo]))
    segment = Segmenter(model)
    assert np.mean([iou(segment(f), m) for f, m in zip(moved[::4], truth[::4], strict=True)]) > 0.93


def test_somebody_who_sways_on_the_spot_stays_foreground(scene):
    background, empty, _, _ = scene
    rng = np.random.default_rng(3)
    truth = [ellipse(SHAPE, 0.5 + 0.02 * np.sin(k)) for k in range(30)]
    film = np.stack([picture(rng, background, m, shadow=0) for m in truth])
    segment = Segmenter(from_recording(film, None, from_plates(empty[:1])))
    assert min(iou(segment(f), m) for f, m in zip(film, truth, strict=True)) > 0.9


def test_somebody_who_never_moves_is_not_taken_for_room(scene):
    background, empty, _, _ = scene
    rng = np.random.default_rng(3)
    truth = ellipse(SHAPE, 0.5)
    film = np.stack([picture(rng, background, truth, shadow=0) for _ in range(20)])
    model = from_recording(film, None, from_plates(empty[:1]))
    assert iou(Segmenter(model)(film[3]), truth) > 0.9
    assert "Hardly anything moves" in model.note


def test_faults_are_named(scene):
    with pytest.raises(InputError, match="background clip holds no readable image"):
        from_frames([])
    with pytest.raises(InputError, match="same orientation"):
        from_recording(scene[2], None, from_plates([np.zeros((320, 240, 3), np.uint8)]))
