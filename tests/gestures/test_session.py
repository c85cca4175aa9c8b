"""The session: phases in their order, undo, pause, threshold."""

import pytest

from hypose.errors import InputError
from hypose.gestures.trainer import Session, SessionSettings, advance

SETTINGS = SessionSettings(do_gesture_s=1, positive_s=2, release_s=1, negative_s=3, rounds=2)


def drive(commands=None, until=20.0, rate=10.0, settings=SETTINGS):
    s, seen = Session(), []
    for k in range(int(until * rate)):
        s, i = advance(s, settings, k / rate, (commands or {}).get(k, ()))
        seen.append(i)
    return s, seen


def test_the_published_order_of_phases():
    session, seen = drive()
    phases = [i.phase for i in seen]
    order = [p for k, p in enumerate(phases) if k == 0 or phases[k - 1] != p]
    assert order == ["do_gesture", "positive", "release", "negative"] * 2 + ["test"]
    assert phases.count("positive") == 2 * 20 and phases.count("negative") == 2 * 30
    assert session.segment == 4


def test_only_the_two_learning_phases_learn():
    _, seen = drive()
    for i in seen:
        assert i.learn == {"positive": "gesture", "negative": "negative"}.get(i.phase)
        assert (i.segment > 0) == (i.learn is not None)


def test_slow_frames_skip_no_learning_phase():
    _, seen = drive(rate=0.5, until=60)
    phases = [i.phase for i in seen]
    assert "positive" in phases and "negative" in phases


def test_undo_takes_the_last_segment_back_once():
    session, seen = drive({35: ["undo", "undo"]}, until=4)  # in "release", after the positive segment
    assert [i.restart for i in seen].count(True) == 1
    assert session.undone == (1,)


def test_pause_stops_the_clock_and_the_learning():
    _, plain = drive(until=6)
    session, seen = drive({15: ["pause"], 35: ["continue"]}, until=8)
    assert all(i.learn is None and i.prompt == "Paused" for i in seen[15:35])
    assert [i.phase for i in seen[35:75]] == [i.phase for i in plain[15:55]]
    assert session.paused is None


def test_unknown_commands_are_refused():
    with pytest.raises(InputError, match="commands are"):
        advance(Session(), SETTINGS, 0.0, ["jump"])  # type: ignore[list-item]
