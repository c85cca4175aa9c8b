"""What a wrong calibration leaves in the masks as a whole."""

import cv2
import numpy as np
import pytest

from hypose.tracking.joint_features import shift_of_mask

METRE = 80.0  # px


def figure(x: float, y: float):
    """Somebody with an arm stretched out, about 1.6 m tall, drawn at (x, y) px."""
    fine = np.zeros((1600, 1280), np.uint8)
    lines = ((0, -50), (0, 10), 24), ((0, 10), (-12, 64), 11), ((0, 10), (12, 64), 11), ((0, -35), (40, -30), 8)
    for *ends, width in lines:
        first, last = ((round(8 * (x + a)), round(8 * (y + b))) for a, b in ends)
        cv2.line(fine, first, last, 1, 8 * width)
    return (cv2.resize(fine.astype(np.float32), (160, 200), interpolation=cv2.INTER_AREA) > 0.5).astype(np.uint8)


@pytest.mark.parametrize("away", [(0.0, 0.0), (3.0, 0.0), (-2.0, 2.5), (0.5, -1.5)])
def test_the_shift_of_a_mask_is_found(away):
    found = shift_of_mask(figure(80 + away[0], 90 + away[1]), figure(80, 90), METRE)
    assert found * METRE == pytest.approx(away, abs=0.3)


def test_what_is_lost_or_not_of_the_body_moves_nothing(rng):
    mask, body = figure(82, 90), figure(80, 90)
    spoilt = mask.copy()
    spoilt[50:75, 95:150] = 0  # the arm is lost
    cv2.rectangle(spoilt, (40, 80), (70, 150), 1, -1)  # something stands beside
    assert shift_of_mask(spoilt, body, METRE) * METRE == pytest.approx((2, 0), abs=0.8)
    ignored = np.zeros_like(mask)
    ignored[78:153, 38:78] = 1
    assert shift_of_mask(spoilt, body, METRE, ignored) * METRE == pytest.approx((2, 0), abs=0.5)
