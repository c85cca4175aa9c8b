"""The simulated depth sensor and the people in front of it."""

import numpy as np
import pytest

from benchmarks.depth_gestures.gesture_pictures import TRAINING, picture
from benchmarks.depth_gestures.gesture_scores import area_under_curve
from hypose.compute import depth_sensor
from hypose.gestures.depth_pictures import KINECT, surface_depth
from hypose.gestures.events import average_precision
from hypose.synthetic.gesture_people import GESTURES

LENS = (KINECT.fx, KINECT.fy, KINECT.cx, KINECT.cy)


def wall(depth):
    points = np.array([[-5, -5, depth], [5, -5, depth], [5, 5, depth], [-5, 5, depth]], float)
    inverse = np.zeros((480, 640), np.float32)
    depth_sensor.draw(points, np.array([[0, 1, 2], [0, 2, 3]], np.int32), LENS, inverse)
    return inverse


def test_drawing_is_exact_on_planes():
    np.testing.assert_allclose(wall(2.0), 0.5, rtol=1e-6)
    # a slanted plane z = 2 + 0.5 x
    points = np.array([[x, y, 2 + 0.5 * x] for x, y in ((-2, -2), (2, -2), (2, 2), (-2, 2))], float)
    inverse = np.zeros((480, 640), np.float32)
    depth_sensor.draw(points, np.array([[0, 1, 2], [0, 2, 3]], np.int32), LENS, inverse)
    u = (np.arange(640) - KINECT.cx) / KINECT.fx
    np.testing.assert_allclose(inverse[240, 150:490], ((1 - 0.5 * u) / 2)[150:490], rtol=2e-4)


def test_the_sensor_is_right_on_average_and_coarser_far_away():
    rng = np.random.default_rng(0)
    spread = []
    for z in (1.0, 2.0, 4.0):
        d = depth_sensor.sense(wall(z), KINECT.fx, rng)
        measured = d[d > 0]
        assert abs(measured.mean() - 1000 * z) < 6 * z
        assert 0.9 < (d > 0).mean() < 1
        spread.append(measured.std())
    assert spread[0] < spread[1] < spread[2]


@pytest.mark.parametrize("name", GESTURES)
def test_the_annotated_point_lies_on_what_is_seen(name):
    rng = np.random.default_rng(3)
    for person in (3, 12):  # left-handed; short arms
        frame = picture(person, name, TRAINING, rng)
        assert frame.gesture == GESTURES.index(name) + 1
        d = surface_depth(frame.depth, frame.x, frame.y)
        assert d is not None and abs(d / 1000 - frame.position[2]) < 0.06
        np.testing.assert_allclose(KINECT.point(frame.x, frame.y, frame.position[2]), frame.position, atol=1e-6)


def test_average_precision_and_area_on_a_ranking_worked_out_by_hand():
    scores = np.array([0.9, 0.8, 0.7, 0.6, 0.0])
    correct = np.array([True, False, True, False, True])
    # precision at the hits: 1, 2/3; the fifth is no detection; four positives
    assert average_precision(scores, correct, 4) == pytest.approx((1 + 2 / 3) / 4)
    # recall 1/4 at 1 - precision 0 .. 1/3, then 1/2
    assert area_under_curve(scores, correct, 4) == pytest.approx(1 / 4 * 1 / 3 + 1 / 2 * 2 / 3)
    assert average_precision(np.zeros(3), np.ones(3, bool), 3) == 0
    # equal scores: the wrong one counts first
    assert average_precision(np.ones(2), np.array([True, False]), 1) == 0.5
