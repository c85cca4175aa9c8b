"""How good a forest is while it is taught: new frames, false alarms; what a page may ask for."""

import numpy as np
import pytest

from hypose.app.studio.gesture_session import Controls, Judge
from hypose.errors import InputError
from hypose.gestures.depth_pictures import KINECT
from hypose.gestures.localise import Localisation

DEPTH = np.full((480, 640), 2000, np.uint16)


def found(score, x=320.0, y=240.0):
    return Localisation(1, x, y, score, None)


def test_a_test_with_known_truth_is_judged_by_place_and_score():
    judge = Judge(KINECT)
    judge.see(DEPTH, (320.0, 240.0), found(9.0))
    assert judge.reported()["on"] == "segments" and judge.reported()["ap"] is None  # nothing else was shown yet
    judge.see(DEPTH, None, found(6.0))
    judge.see(DEPTH, (320.0, 240.0), found(8.0, x=360.0))  # 40 px at 2 m are 14 cm: another place
    judge.see(DEPTH, (320.0, 240.0), found(7.0, x=330.0))
    reported = judge.reported()
    assert reported["on"] == "test" and (reported["frames"], reported["positives"]) == (4, 3)
    # of three found at 9, 8, 7 the second is wrong: precision 1 and 2/3 at recall 1/3 and 2/3
    assert reported["ap"] == pytest.approx((1 + 2 / 3) / 3)
    assert reported["scores"] == [9.0, 8.0, 7.0, 6.0]
    assert reported["precision"][2] == reported["recall"][2] == pytest.approx(2 / 3, abs=1e-4)


def test_segments_that_were_undone_do_not_count():
    judge = Judge(KINECT)
    for segment in (1, 2, 3):
        judge.see(DEPTH, (320.0, 240.0) if segment % 2 else None, found(9.0 / segment), segment)
    assert judge.reported()["frames"] == 3 and judge.reported([2])["ap"] is None


def test_false_alarms_count_over_the_time_of_movement():
    judge = Judge(KINECT)
    assert judge.reported()["false_per_min"] is None
    for k in range(100):
        judge.move(0.1 * k + (60 if k > 50 else 0), int(k == 20))
    reported = judge.reported()
    assert reported["false_per_min"] == pytest.approx(60 / 9.8, rel=1e-6) and reported["tested_s"] == 9.8


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
