"""Several people are told in masks without a calibration."""

import cv2
import numpy as np
import pytest

from hypose.evidence.frame import Silhouettes
from hypose.pipeline.recorded_frames import several_apart
from hypose.pipeline.settings import SETTINGS
from hypose.synthetic.scenes import camera_rig

CAMERAS = camera_rig("ring-3").scaled(0.25).pinhole()


def masks_with(*boxes, views=(0, 1)):
    """Boxes (x, y, width, height) px in some of three views, and one person alone in the others."""
    w, h = CAMERAS[0].size
    out = np.zeros((3, h, w), np.uint8)
    for c in range(3):
        for x, y, a, b in boxes if c in views else boxes[:1]:
            cv2.rectangle(out[c], (x, y), (x + a, y + b), 1, -1)
    return Silhouettes(out, CAMERAS, np.ones(3, bool), ("",) * 3)


PERSON, BESIDE = (20, 20, 14, 60), (80, 30, 10, 40)


def test_two_who_stand_beside_each_other_in_two_views_are_several():
    assert several_apart([masks_with(PERSON, BESIDE)] * 3)


@pytest.mark.parametrize(
    "other", [(80, 70, 14, 8), (22, 82, 12, 35), (80, 30, 2, 40)], ids=["low", "cut off below", "thin"]
)
def test_pieces_of_one_person_are_not(other):
    assert not several_apart([masks_with(PERSON, other)] * 3)


def test_what_one_view_shows_is_nobody():
    assert not several_apart([masks_with(PERSON, BESIDE, views=(2,))] * 3)


def test_who_is_there_now_and_then_is_left_to_the_rays():
    now_and_then = [masks_with(PERSON, BESIDE), masks_with(PERSON), masks_with(PERSON)]
    assert not several_apart(now_and_then) and several_apart(now_and_then, SETTINGS.several_now_and_then)
