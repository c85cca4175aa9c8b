"""The geometry around the two networks, with stand-ins that find bright discs: who is followed, and who is new."""

import cv2
import numpy as np
import pytest

from hypose.evidence.keypoints import BLAZEPOSE_33
from hypose.evidence.pose_network import _ANCHORS, CROP, DETECTOR, PoseNetwork

RADIUS = 40.0


class Discs:
    """Networks for people that are discs: red at the hips, 40 px around them the person."""

    def __init__(self):
        self.detected = self.looked = 0

    def detect(self, picture):
        self.detected += 1
        assert picture.shape == (1, DETECTOR, DETECTOR, 3) and picture.dtype == np.float32
        boxes, scores = np.zeros((2254, 12), np.float32), np.full(2254, -9.0, np.float32)
        red = (picture[0, ..., 0] > 0.5).astype(np.uint8)
        _, _, stats, middles = cv2.connectedComponentsWithStats(red)
        for n, (x, y) in enumerate(middles[1:]):
            scale = stats[1 + n, cv2.CC_STAT_WIDTH] / 13
            k = int(np.argmin(np.linalg.norm(DETECTOR * _ANCHORS - (x, y), axis=1)))
            boxes[k, 4:6] = (x, y) - DETECTOR * _ANCHORS[k]
            boxes[k, 6:8] = boxes[k, 4:6] - (0, RADIUS * scale)
            scores[k] = 5 - n
        return (boxes, scores)

    def landmarks(self, picture):
        self.looked += 1
        assert picture.shape == (1, CROP, CROP, 3) and 0 <= picture.min() <= picture.max() <= 1
        y, x = np.nonzero(picture[0, ..., 0] > 0.5)
        near = np.hypot(x - 127.5, y - 127.5) < 60
        presence = float(near.any())
        hips = (x[near].mean(), y[near].mean()) if near.any() else (0, 0)
        points = np.full((39, 5), 9.0, np.float32)
        points[:, :2] = hips
        points[34, 1] -= CROP / 2.5
        points[1, 3] = -9
        rows, columns = np.indices((CROP, CROP))
        mask = np.where(np.hypot(columns - hips[0], rows - hips[1]) < CROP / 2.5, 9.0, -9.0)
        return (points, presence, mask.astype(np.float32))


def picture(*hips, size=(320, 240)):
    out = np.zeros((size[1], size[0], 3), np.uint8)
    for x, y in hips:
        cv2.circle(out, (x, y), 6, (0, 0, 255), -1)
    return out


@pytest.fixture
def discs():
    stand_in = Discs()
    return stand_in, PoseNetwork(stand_in.detect, stand_in.landmarks, {}, every=10)


def test_a_person_is_detected_once_and_then_followed(discs):
    stand_in, network = discs
    (found,) = network.look(picture((100, 120)), 0)
    looked = stand_in.detected
    assert found.points.shape == (len(BLAZEPOSE_33), 3)
    np.testing.assert_allclose(found.points[0], [100, 120, 1], atol=0.7)
    assert found.points[1, 2] < 0.01  # what the network does not see
    assert found.following.radius == pytest.approx(RADIUS, abs=8)
    back = cv2.invertAffineTransform(found.crop.from_picture)
    shown = cv2.warpAffine(found.mask, back, (320, 240)) > 0.5
    assert shown.sum() == pytest.approx(np.pi * found.crop.radius**2, rel=0.05)
    (again,) = network.look(picture((110, 120)), 1, [found.following])
    assert stand_in.detected == looked
    np.testing.assert_allclose(again.following.hips, [110, 120], atol=0.7)


def test_newcomers_are_looked_for_now_and_then_and_nobody_twice(discs):
    stand_in, network = discs
    (one,) = network.look(picture((60, 120)), 0)
    assert len(network.look(picture((60, 120), (240, 120)), 1, [one.following])) == 1
    both = network.look(picture((60, 120), (240, 120)), 10, [one.following])
    assert [round(f.following.hips[0]) for f in both] == [60, 240]
    # crops that have come to show the same person
    assert len(network.look(picture((60, 120)), 11, [one.following, one.following])) == 1
    # a crop that lost its person is given up, and where nobody is left the detector looks
    before = stand_in.detected
    (new,) = network.look(picture((240, 120)), 12, [one.following])
    assert round(new.following.hips[0]) == 240 and stand_in.detected > before
    assert network.look(picture(), 13) == []


def test_a_person_who_leaves_the_picture(discs):
    _, network = discs

    def landmarks(crop):
        out = discs[0].landmarks(crop)
        out[0][0, 0] = -40  # left of the picture
        return out

    (found,) = PoseNetwork(network.detect, landmarks, {}).look(picture((20, 120)), 0)
    assert found.points[0, 0] < -1 and found.points[0, 2] == 0
