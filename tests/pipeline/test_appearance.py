"""Who is who: by the clothes after a meeting, and where somebody came whom another one may have been drawn to."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.evidence.colours import COLOURS
from hypose.evidence.frame import Colours, Frame, Silhouettes
from hypose.pipeline import track_management
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.subject import TrackedSubject
from hypose.pipeline.track_loop import Member, TrackedPerson, body_shape
from hypose.pipeline.track_management import back_again, identity_switches, swap_identities, update_appearance
from hypose.synthetic.scenes import camera_rig as named_rig
from hypose.tracking.part_colours import FEW, NO_CLOTHES, appearance_in, likeness
from hypose.tracking.recipes import recipe
from hypose.tracking.start_search import known_pose
from hypose.tracking.tracker import Tracker, TrackerSettings

RIG = named_rig("ring-3").scaled(0.5).pinhole()
BODY = human()
RED, BLUE = (np.eye(COLOURS, dtype=np.float32)[[k, k]] * 1000 for k in (40, 300))


def standing(x):
    pose = known_pose(BODY, "standing")
    pose[2] -= BODY.skin(pose)[:, 2].min()
    pose[0] += x
    return pose


def frame_of(people):
    """Whoever stands at (x, colour) m, as all cameras see it."""
    w, h = RIG.sizes.max(0)
    masks, codes = np.zeros((len(RIG), h, w), np.uint8), np.zeros((len(RIG), h, w), np.uint16)
    for x, colour in people:
        shape = body_shape(BODY, standing(x), RIG)
        for c, (y0, y1, x0, x1) in enumerate(shape.boxes):
            drawn = shape.drawn(c) > 0
            masks[c, y0:y1, x0:x1] |= drawn
            codes[c, y0:y1, x0:x1][drawn] = colour
    seen = np.ones(len(RIG), bool)
    return Frame(0.0, 0, Silhouettes(masks, RIG, seen, ("",) * len(RIG)), colours=Colours(codes, seen))


def followed(name, places, frames=None):
    """Somebody who was at these x, m, in one frame after the other, and is there in the first `frames` of them."""
    tracker = Tracker(BODY, recipe("default", BODY, frame_rate=25.0), TrackerSettings(frame_rate=25.0))
    state = tracker.start(standing(places[-1]))
    _, estimate = tracker.step(state, frame_of([]).unseen())
    out = TrackedPerson(name, TrackedSubject(BODY, None, standing(places[0]), ()), Member(tracker, state))
    out.estimates = [replace(estimate, pose=standing(x)) for x in places]
    out.present, out.hidden = [frames is None or t < frames for t in range(len(places))], [False] * len(places)
    return out


def test_what_a_person_wears_is_what_the_pictures_show_where_the_body_is():
    red, blue = (appearance_in(BODY, standing(0.0), frame_of([(0.0, code)])) for code in (40, 300))
    assert (red.sum(1) >= FEW).all()
    assert likeness(red, red) == pytest.approx(1.0)
    assert likeness(red, blue) < 0.2
    assert not appearance_in(BODY, standing(0.0), replace(frame_of([(0.0, 40)]), colours=None)).any()
    assert np.isnan(likeness(red, NO_CLOTHES))


def met(anna, bert):
    """They were nearest in the frame before the last; since then both were looked at often enough."""
    since = len(anna.estimates) - 2
    for p, q in ((anna, bert), (bert, anna)):
        p.appearance.met, p.appearance.looks = {q.name: since}, SETTINGS.wardrobe_looks


def test_two_who_wear_each_others_clothes_after_a_meeting_were_exchanged():
    anna, bert = followed("anna", [-1.0, -0.2, -1.0]), followed("bert", [1.0, 0.2, 1.0])
    met(anna, bert)
    anna.appearance.worn, anna.appearance.lately = RED, BLUE
    bert.appearance.worn, bert.appearance.lately = BLUE, RED
    (found,) = update_appearance([anna, bert], [replace(frame_of([]), colours=None)] * 2)
    assert {found[0].name, found[1].name} == {"anna", "bert"} and found[2] == 1
    swap_identities(*found)
    assert [round(e.pose[0] - standing(0)[0], 1) for e in anna.estimates] == [-1.0, 0.2, 1.0]
    assert anna.member.state.pose[0] == pytest.approx(standing(1.0)[0])
    assert anna.hidden == bert.hidden == [False, True, True]
    assert "taken for bert from frame 1 to 2" in anna.said[0]
    assert likeness(anna.appearance.worn, RED) > 0.99  # and they are not exchanged again
    assert update_appearance([anna, bert], [replace(frame_of([]), colours=None)] * 2) == []


def test_two_who_wear_their_own_or_the_same_clothes_stay_who_they_are():
    for worn, other in ((RED, BLUE), (RED, RED)):
        anna, bert = followed("anna", [-1.0, -0.2, -1.0]), followed("bert", [1.0, 0.2, 1.0])
        met(anna, bert)
        anna.appearance.worn = anna.appearance.lately = worn
        bert.appearance.worn = bert.appearance.lately = other
        assert update_appearance([anna, bert], [replace(frame_of([]), colours=None)] * 2) == []
        assert not anna.appearance.met and (anna.appearance.worn.sum(1) >= FEW).all()


RATE, FRAMES, SINCE = 25.0, 40, 34


def found_at(x):
    """Somebody in the hull, as far as it is asked here."""
    return SimpleNamespace(axis=np.array([x, 0.0]))


@pytest.fixture
def drawn_away():
    """Stands at 0 and is tracked 1.2 m beside it within a few frames."""
    return followed("anna", [*np.zeros(SINCE), *np.linspace(0.7, 1.2, FRAMES - SINCE)])


def test_who_moves_faster_than_anybody_from_where_somebody_is_found_was_drawn_away(drawn_away):
    bert = followed("bert", np.full(FRAMES, 2.0), frames=10)  # went away at 2 m
    assert identity_switches(found_at(0.05), [bert, drawn_away], RATE) == (drawn_away, SINCE)
    assert identity_switches(found_at(1.2), [bert, drawn_away], RATE) is None  # the one who came beside them
    walks = followed("carl", np.linspace(-1.0, 0.8, FRAMES))
    assert identity_switches(found_at(0.4), [walks], RATE) is None  # 1.2 m/s: came past there


def test_who_was_drawn_to_somebody_new_goes_on_where_they_had_stood(drawn_away, monkeypatch):
    anna, again = drawn_away, standing(0.0)
    monkeypatch.setattr(track_management, "returned", lambda *_: None)
    monkeypatch.setattr(track_management, "found_again", lambda *_: (None, again))
    back = back_again(found_at(0.05), frame_of([]), [anna], RATE)
    assert back is not None and back[0] is anna and back[1] is again
    assert all(e.lost for e in anna.estimates[SINCE:]) and not any(e.lost for e in anna.estimates[:SINCE])
    assert all(anna.present) and all(anna.hidden[SINCE:]) and not any(anna.hidden[:SINCE])
    assert "another person was taken for them from frame 34 to 39" in anna.said[0]
    assert back_again(found_at(-2.0), frame_of([]), [anna], RATE) is None
