"""Who came back, where those who were tracked may have been drawn to them."""

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.evidence.hull_people import HullPerson
from hypose.pipeline import track_management
from hypose.pipeline.first_frame import TrackedSubject
from hypose.pipeline.track_management import back_again, identity_switches
from hypose.pipeline.tracked_people import Followed
from hypose.synthetic.scenes import make_scene
from hypose.tracking.recipes import recipe
from hypose.tracking.several import Member
from hypose.tracking.starts import known_pose
from hypose.tracking.tracker import Tracker, TrackerSettings

RATE, FRAMES, SINCE = 25.0, 40, 34


class FoundAt:
    """Somebody in the hull, as far as it is asked here."""

    def __init__(self, x: float) -> None:
        self.axis = np.array([x, 0.0])


def found_at(x: float) -> HullPerson:
    return cast(Any, FoundAt(x))


def followed(name: str, x: np.ndarray, present: np.ndarray) -> Followed:
    """Somebody who was tracked along x (T,) m, in the frames in which they were there."""
    body = human()
    tracker = Tracker(body, recipe("default", body, frame_rate=RATE), TrackerSettings(frame_rate=RATE))
    frame = next(iter(make_scene("walk", seconds=0.1).mask_frames(0.2))).unseen()
    pose = known_pose(body, "standing")
    pose[0] = x[-1]
    member = Member(tracker, tracker.start(pose), bool(present[-1]))
    estimate = tracker.step(member.state, frame)[1]
    poses = np.repeat(pose[None], len(x), 0)
    poses[:, 0] = x
    estimates = [replace(estimate, pose=p) for p in poses]
    subject = TrackedSubject(body, None, pose, ())
    return Followed(name, subject, member, None, True, estimates, present.tolist(), [False] * len(x))


@pytest.fixture
def anna() -> Followed:
    """Stands at 0 and is tracked 1.2 m beside it within a few frames."""
    x = np.zeros(FRAMES)
    x[SINCE:] = np.linspace(0.7, 1.2, FRAMES - SINCE)
    return followed("anna", x, np.ones(FRAMES, dtype=bool))


@pytest.fixture
def bert() -> Followed:
    """Went away at 2 m."""
    return followed("bert", np.full(FRAMES, 2.0), np.arange(FRAMES) < 10)


def test_who_moves_faster_than_anybody_from_where_somebody_is_found_was_drawn_away(anna, bert):
    assert identity_switches(found_at(0.05), [bert, anna], RATE) == (anna, SINCE)
    assert identity_switches(found_at(1.2), [bert, anna], RATE) is None  # the one who came beside them
    walks = followed("carl", np.linspace(-1.0, 0.8, FRAMES), np.ones(FRAMES, dtype=bool))
    assert identity_switches(found_at(0.4), [walks], RATE) is None  # 1.2 m/s: came past there


def test_who_was_drawn_to_somebody_new_goes_on_where_they_had_stood(anna, monkeypatch):
    again = known_pose(human(), "standing")
    monkeypatch.setattr(track_management, "returned", lambda *_: None)
    monkeypatch.setattr(track_management, "found_again", lambda *_: (None, again))
    frame = next(iter(make_scene("walk", seconds=0.1).mask_frames(0.2)))
    back = back_again(found_at(0.05), frame, [anna], RATE)
    assert back is not None and back[0] is anna and back[1] is again
    assert all(e.lost for e in anna.estimates[SINCE:]) and not any(e.lost for e in anna.estimates[:SINCE])
    assert all(anna.present) and all(anna.hidden[SINCE:]) and not any(anna.hidden[:SINCE])
    assert "another person was taken for them from frame 34 to 39" in anna.said[0]
    assert back_again(found_at(-2.0), frame, [anna], RATE) is None
