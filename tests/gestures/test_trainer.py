"""The trainer: a whole session on toys, undo, threshold."""

import numpy as np
import pytest

from benchmarks.depth_gestures.gesture_data import teach
from hypose.gestures.forest import ForestSettings
from hypose.gestures.localise import localise
from hypose.gestures.online import Learner
from hypose.gestures.trainer import SessionSettings, Trainer, balanced

from .test_model import toy_examples
from .toys import LENS

SETTINGS = SessionSettings(do_gesture_s=0.2, positive_s=1, release_s=0.1, negative_s=1, rounds=3)


def new_trainer():
    return Trainer(Learner.new(np.random.default_rng(1), ForestSettings(alpha=60, candidates=30)), SETTINGS)


def drive(trainer, frames=90, commands=None, rate=10.0):
    both = toy_examples(2 * frames, 4)
    shown, empty = [e for e in both if e.gesture], [e for e in both if not e.gesture]
    feedback, phase = [], "do_gesture"
    for k in range(frames):
        e = (shown if phase in ("do_gesture", "positive") else empty)[k % len(shown)]
        # the person follows the prompt of the frame before, hence one frame late
        f = trainer.frame(k / rate, e.depth, LENS, (e.x, e.y), (commands or {}).get(k, ()))
        phase = f.instruction.phase
        feedback.append(f)
    return feedback


def test_a_session_teaches_and_finds_a_threshold():
    trainer = new_trainer()
    feedback = drive(trainer)
    assert feedback[-1].instruction.phase == "test" and feedback[-1].found is not None
    threshold = trainer.final_threshold()
    assert threshold is not None and threshold > 0
    forest = trainer.learner.forest.freeze()
    new = toy_examples(20, 77)
    scores = [localise(e.depth, LENS, [forest])[0].score for e in new]
    shown = np.array([bool(e.gesture) for e in new])
    accepted = np.array(scores) >= threshold
    assert accepted[shown].mean() >= 0.7 and accepted[~shown].mean() <= 0.2


def test_what_was_taken_back_has_no_say_in_the_forest_and_the_threshold():
    examples = toy_examples(40, 6)
    whole, without = new_trainer(), new_trainer()
    for k, e in enumerate(examples):
        whole.frame(0.01 * k, e.depth, LENS, (e.x, e.y), ["next"] if k in (0, 30) else [])  # positive, release
        if k < 30:
            without.learn("gesture", e.depth, LENS, (e.x, e.y))
    for k, e in enumerate(toy_examples(40, 7)):
        whole.frame(1 + 0.01 * k, e.depth, LENS, (e.x, e.y), ["next"] if k in (0, 20) else [])  # negative, do_gesture
        if k < 20:
            without.learn("negative", e.depth, LENS, (0, 0))
    before, forest = whole.final_threshold(), [a.copy() for a in whole.learner.forest.arrays]
    for k, e in enumerate(examples):  # another positive segment, taken back at its end
        command = {0: ["next"], 39: ["undo"]}.get(k, [])
        whole.frame(2 + 0.01 * k, e.depth, LENS, (e.x, e.y), command)  # type: ignore[arg-type]
    assert whole.session.undone == (3,)
    for a, b in zip(forest, whole.learner.forest.arrays, strict=True):
        np.testing.assert_array_equal(a, b)
    assert whole.final_threshold() == before == without.final_threshold()


def test_the_threshold_lies_between_movement_and_the_gesture():
    rng = np.random.default_rng(0)
    movement = np.where(rng.random(200) < 0.6, 0.0, rng.exponential(1.0, 200)).tolist()
    gestures = rng.normal(9, 1, 20).tolist()
    limit = balanced(gestures, movement)
    assert np.quantile(movement, 0.9) < limit < min(gestures)
    assert balanced([3 * g for g in gestures], [3 * m for m in movement]) == pytest.approx(3 * limit)
    assert balanced(gestures, [2 * m for m in movement]) > limit
    # one strong frame of two hundred hardly matters
    assert balanced(gestures, [*movement, 9.0]) < 1.1 * limit


def test_positives_are_learned_where_the_surface_is():
    e = toy_examples(1, 3)[0]
    learner = Learner.new(np.random.default_rng(0))
    taught = learner.show(e.depth, LENS, e.x, e.y)
    assert taught is not None and taught.learned[1] == learner.settings.positives
    assert learner.show(np.zeros_like(e.depth), LENS, e.x, e.y) is None


def test_hard_negatives_are_taken_at_the_maximum_and_in_proportion_to_it():
    learner = Learner.new(np.random.default_rng(0), ForestSettings(alpha=60, candidates=30))
    teach(learner, toy_examples(60, 5))
    shown = toy_examples(1, 8)[0]
    strong = learner.reject(shown.depth, LENS)  # calling the gesture itself movement is the worst of errors
    assert strong.mined
    found = strong.found
    assert np.hypot(found.x - shown.x, found.y - shown.y) < 8
    settings, strength = learner.settings, learner.strength
    expected = int(np.ceil(settings.hard * min(1.0, found.score / strength)))
    assert strong.learned[0] <= expected + settings.few
    assert strong.learned[0] >= 0.8 * expected
