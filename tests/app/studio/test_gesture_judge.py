"""How good a forest is while it is taught: the frames kept from it, false alarms, and what a page may ask for."""

import numpy as np
import pytest

from hypose.app.studio.gesture_session import read_start
from hypose.app.studio.gesture_training import Controls, FalseAlarms, HeldBack
from hypose.errors import InputError
from hypose.gestures.depth_pictures import KINECT
from hypose.gestures.localise import Localisation

DEPTH = np.full((480, 640), 2000, np.uint16)


def found(score, x=320.0, y=240.0):
    return Localisation(1, x, y, score, None)


def test_a_test_with_known_truth_is_judged_by_place_and_score():
    held = HeldBack(KINECT)
    held.test(DEPTH, (320.0, 240.0), found(9.0))
    assert held.result(5.0) is None  # nothing that does not show the gesture yet
    held.test(DEPTH, None, found(6.0))
    held.test(DEPTH, (320.0, 240.0), found(8.0, x=360.0))  # 40 px at 2 m are 14 cm: another place
    held.test(DEPTH, (320.0, 240.0), found(7.0, x=330.0))
    reported = held.result(6.5)
    assert reported["on"] == "test" and (reported["frames"], reported["positives"]) == (4, 3)
    # of three found at 9, 8, 7 the second is wrong: precision 1 and 2/3 at recall 1/3 and 2/3
    assert reported["ap"] == pytest.approx((1 + 2 / 3) / 3)
    assert reported["at"] == {"precision": pytest.approx(2 / 3, abs=1e-4), "recall": pytest.approx(2 / 3, abs=1e-4)}
    assert held.result(99.0)["at"] == {"precision": 1.0, "recall": 0.0}


def test_false_alarms_count_events_not_frames_of_movement():
    alarms = FalseAlarms()
    for k in range(100):
        alarms.see(0.1 * k, found(9.0 if 20 <= k < 40 else 0.0), 5.0, 0.15)
    assert alarms.reported() == {"false_per_min": pytest.approx(60 / 9.9, rel=1e-6), "tested_s": 9.9}
    other = FalseAlarms()
    other.see(0.0, found(9.0), None, 0.15)  # no threshold yet
    assert other.reported() == {"false_per_min": None, "tested_s": 0.0}


@pytest.mark.parametrize(
    ("message", "part"),
    [
        ({"mode": "dance"}, "choose train or run"),
        ({"mode": "train"}, "no source"),
        ({"mode": "train", "source": "simulated:0", "gesture": " "}, "no name of the gesture"),
        (
            {"mode": "train", "source": "simulated:0", "gesture": "tee", "rounds": 0},
            "rounds cannot be 0; give a whole number from 1 to 1000",
        ),
        ({"mode": "train", "source": "simulated:0", "gesture": "tee", "seconds": {"positive": "x"}}, "positive"),
        ({"mode": "train", "source": "simulated:0", "gesture": "tee", "seed": -1}, "whole number"),
        ({"mode": "run", "source": "simulated:0", "models": []}, "teach one first"),
    ],
)
def test_a_start_that_cannot_be_is_a_sentence(message, part):
    with pytest.raises(InputError, match=part):
        read_start(message)


def test_what_a_page_changes_is_kept_within_bounds():
    controls = Controls()
    assert controls.change({"t": "box", "x": 1e9, "y": -3}, (640, 480))
    assert controls.box == (639.0, 0.0)
    assert controls.change({"t": "threshold", "value": 4}, (640, 480)) and controls.threshold == 4.0
    assert controls.change({"t": "threshold", "value": None}, (640, 480)) and controls.threshold is None
    assert not controls.change({"t": "command", "command": "next"}, (640, 480))
    for message in (
        {"t": "threshold", "value": 0},
        {"t": "hold", "seconds": 11},
        {"t": "box", "x": float("nan"), "y": 0},
    ):
        with pytest.raises(InputError):
            controls.change(message, (640, 480))
