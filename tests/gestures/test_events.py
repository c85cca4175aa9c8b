"""Events: hold, hysteresis, once, rest."""

from hypose.gestures.events import EventSettings, EventState, detect_events
from hypose.gestures.localise import Localisation

SETTINGS = [EventSettings(10.0, release=0.6, hold_s=0.15, let_go_s=0.15, refractory_s=0.5)]


def run(scores, rate=20.0, settings=SETTINGS):
    state, out = EventState(), []
    for k, s in enumerate(scores):
        state, events = detect_events(state, [Localisation(1, 5.0, 6.0, s, None)], k / rate, settings)
        out += [(e.kind, round(e.time, 3)) for e in events]
    return out, state


def test_a_held_gesture_starts_once_and_ends_once():
    events, state = run([0] * 5 + [15] * 40 + [0] * 10)
    assert events == [("start", 0.4), ("end", 2.4)]
    assert not any(w.on for w in state.watches.values())
    assert run([7] * 40 + [12] * 10 + [7] * 40)[0] == [("start", 2.15)]  # nothing changes between the two thresholds


def test_rest_after_the_end():
    scores = [15] * 10 + [0] * 6 + [15] * 40
    events, _ = run(scores)
    (_, ended), (kind, again) = events[1], events[2]
    assert kind == "start" and again - ended >= 0.5 + 0.15 - 1e-6


def test_gestures_do_not_disturb_each_other():
    state, seen = EventState(), []
    for k in range(20):
        found = [Localisation(1, 0.0, 0.0, 15.0 if k < 10 else 0.0, None), Localisation(2, 0.0, 0.0, 15.0, None)]
        state, events = detect_events(state, found, k / 20, SETTINGS * 2)
        seen += [(e.kind, e.gesture) for e in events]
    assert seen == [("start", 1), ("start", 2), ("end", 1)]
