import numpy as np
import pytest

from hypose.errors import InputError
from hypose.evidence.background import BackgroundModel, from_frames
from hypose.evidence.silhouettes import (
    Segmenter,
    SilhouetteSettings,
    as_mask,
    flag_collapsed,
    make_silhouettes,
)
from tests.evidence.scenes import ellipse, iou, picture, ring, room

SHAPE = (240, 320)


def scene(grey, shadow=0.65):
    rng = np.random.default_rng(2)
    background = room(rng, SHAPE, grey)
    empty = [np.clip(background + rng.normal(0, 3, background.shape), 0, 255).astype(np.uint8) for _ in range(15)]
    truth = [ellipse(SHAPE, t) for t in np.linspace(0, 1, 8)]
    return from_frames(empty), [picture(rng, background, m, shadow, grey) for m in truth], truth


def test_walker_with_cast_shadow():
    model, film, truth = scene(grey=False)
    segment = Segmenter(model)
    assert np.mean([iou(segment(f), m) for f, m in zip(film, truth, strict=True)]) >= 0.95


def test_grey_scene_needs_the_shadow_test_off():
    model, film, truth = scene(grey=True, shadow=0)
    with_test = Segmenter(model, SilhouetteSettings(shadow=True))
    without = Segmenter(model, SilhouetteSettings(shadow=False))
    assert np.mean([iou(with_test(f), m) for f, m in zip(film, truth, strict=True)]) < 0.7
    assert np.mean([iou(without(f), m) for f, m in zip(film, truth, strict=True)]) > 0.85


def test_band_restricts_and_an_empty_band_means_nobody():
    model, film, truth = scene(grey=False)
    segment = Segmenter(model)
    band = np.zeros(SHAPE, np.uint8)
    band[:120] = 1
    masked = segment(film[2], band)
    assert not masked[120:].any()
    assert iou(masked[:120], truth[2][:120]) > 0.93
    assert not segment(film[2], np.zeros(SHAPE, np.uint8)).any()


def test_unknown_room_is_person_only_where_something_says_so():
    model, film, _ = scene(grey=False)
    valid = model.valid.copy()
    valid[:, 200:] = False
    segment = Segmenter(BackgroundModel(model.mean, model.sd, valid))
    assert not segment(film[-1])[:, 200:].any()
    band = np.zeros(SHAPE, np.uint8)
    band[100:160, 210:260] = 1
    assert segment(film[-1], band)[110:150, 215:255].all()


@pytest.mark.parametrize(
    "image",
    [
        np.array([[0, 255], [255, 0]], np.uint8),
        np.array([[0, 1], [1, 0]], np.uint8),
        np.array([[False, True], [True, False]]),
        np.array([[0.0, 1.0], [0.9, 0.2]]),
        np.array([[10, 60000], [40000, 0]], np.uint16),
        np.dstack([np.array([[3, 250], [200, 9]], np.uint8)] * 3),
        np.array([[[0], [200]], [[255], [100]]], np.uint8),
    ],
)
def test_masks_from_elsewhere(image):
    assert as_mask(image).tolist() == [[0, 1], [1, 0]]


def test_mask_of_a_wrong_shape_is_named():
    with pytest.raises(InputError, match=r"walk\.png has the shape \(2, 2, 2\)"):
        as_mask(np.zeros((2, 2, 2), np.uint8), "walk.png")


def test_collapsed_views_are_left_out_with_camera_and_frame():
    history = np.array([[100, 110, 90, 105]] * 4)
    reasons = flag_collapsed([100, 40, 0, 400], history, ("a", "b", "c", "d"), 37)
    assert reasons[0] == ""
    assert "b, frame 37" in reasons[1] and "collapsed (40 px, usually 102 px)" in reasons[1]
    assert "c, frame 37: the mask is empty" in reasons[2]
    assert "d, frame 37" in reasons[3] and "far too large" in reasons[3]
    assert flag_collapsed([5, 0], np.zeros((2, 0)), ("a", "b"), 0)[0] == ""


def test_silhouettes_are_padded_and_unusable_views_marked():
    from dataclasses import replace

    from hypose.cameras.camera import CameraRig

    rig = ring(3, size=(60, 40))
    rig = CameraRig((rig[0], replace(rig[1].scaled((30, 50)), name="tall"), rig[2]))
    s = make_silhouettes([np.ones((40, 60), np.uint8), np.ones((50, 30), np.uint8), None], rig)
    assert s.masks.shape == (3, 50, 60)
    assert s.areas.tolist() == [2400, 1500, 0]
    assert s.usable.tolist() == [True, True, False] and s.reasons == ("", "", "c3: no image")
    with pytest.raises(InputError, match="tall"):
        make_silhouettes([None, np.ones((40, 30), np.uint8), None], rig)


def test_options_are_checked():
    for bad in ({"threshold": 0}, {"shadow_range": (0.9, 0.4)}, {"keep_share": 2}):
        with pytest.raises(InputError):
            SilhouetteSettings(**bad)
    with pytest.raises(InputError, match="does not fit"):
        Segmenter(scene(grey=False)[0])(np.zeros((10, 10, 3), np.uint8))
