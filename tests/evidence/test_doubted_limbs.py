"""Where a mask does not confirm a limb of the skeleton, the band is as wide as the limb reaches."""

import cv2
import numpy as np

from hypose.evidence.keypoints import COCO_17
from hypose.evidence.silhouettes import with_doubted_limbs

HEIGHT = 200.0
PLACES = {
    "left_shoulder": (130, 60),
    "left_elbow": (150, 100),
    "left_wrist": (155, 140),
    "right_shoulder": (90, 60),
    "right_elbow": (70, 100),
    "right_wrist": (65, 140),
    "left_hip": (122, 130),
    "left_knee": (124, 180),
    "left_ankle": (124, 225),
    "right_hip": (98, 130),
    "right_knee": (96, 180),
    "right_ankle": (96, 225),
}


def points(**moved):
    out = np.zeros((len(COCO_17), 3))
    for name, at in {**PLACES, **moved}.items():
        out[COCO_17.index(name)] = (*at, 0.0 if at == (0, 0) else 0.9)
    return out


def person():
    mask = np.zeros((260, 220), np.uint8)
    for side in ("left", "right"):
        for limb in (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle")):
            for a, b in zip(limb[:-1], limb[1:], strict=True):
                cv2.line(mask, PLACES[f"{side}_{a}"], PLACES[f"{side}_{b}"], 1, 14)
    cv2.rectangle(mask, (90, 55), (130, 135), 1, -1)
    return mask


def test_what_the_mask_confirms_is_left_alone():
    mask = person()
    assert with_doubted_limbs(mask, mask, points(), COCO_17, HEIGHT) is None
    # an arm in front of the trunk lies in the mask as well
    folded = points(left_elbow=(120, 100), left_wrist=(100, 90))
    assert with_doubted_limbs(mask, mask, folded, COCO_17, HEIGHT) is None


def test_an_arm_that_is_elsewhere_opens_its_reach_and_no_more():
    mask = person()
    wrong = points(left_elbow=(175, 45), left_wrist=(205, 20))
    band = with_doubted_limbs(np.zeros_like(mask), mask, wrong, COCO_17, HEIGHT)
    assert band is not None and band[140, 155] == 1 and band[60, 215] == 1
    assert band[225, 96] == 0 and band[150, 60] == 0


def test_a_skeleton_that_is_somewhere_else_cuts_nothing():
    mask = person()
    aside = points()
    aside[aside[:, 2] > 0, 0] += 40
    band = with_doubted_limbs(np.zeros_like(mask), mask, aside, COCO_17, HEIGHT)
    assert band is not None and band.all()
