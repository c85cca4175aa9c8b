"""Bodies of people in each other's masks, fitted once more beside each other."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.body.anthropometry import SHAPE_FACTORS, body_of, entity
from hypose.body.default_body import human
from hypose.evidence.frame import Frame
from hypose.pipeline.people import AGAIN, fitted_again
from hypose.pipeline.subject import TrackedSubject
from hypose.pipeline.track_loop import TrackedPerson, body_shape, tracker_of
from hypose.pipeline.track_management import KnownPerson, without_doubles
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.scenes import make_scene
from hypose.tracking.start_search import known_pose
from tests.evidence.scenes import masks_of

RATE, FRAMES = 12.5, 14


def swinging(body, place, phase):
    """(T, D): somebody who stands and bends both arms."""
    s, base = body.skeleton, known_pose(body, "standing")
    base[2] -= body.skin(base)[:, 2].min()
    base[:2] += place
    poses = np.repeat(base[None], FRAMES, 0)
    for side in ("left", "right"):
        elbow = np.flatnonzero(np.asarray(s.joint_of_dof) == s.joint(f"{side}_elbow"))[0]
        bent = s.upper[elbow] if abs(s.upper[elbow]) > abs(s.lower[elbow]) else s.lower[elbow]
        poses[:, elbow] = bent * (0.35 + 0.3 * np.sin(0.5 * np.arange(FRAMES) + phase))
    return s.clamp(poses)


@pytest.fixture(scope="module")
def passing():
    """Two people of the template beside each other, as masks of both, and each with arms that were fitted too long."""
    rig, true = make_scene("walk", rig="humaneva-4", seconds=0.1).rig.pinhole().scaled(0.6), human()
    poses = [swinging(true, (-0.45, -0.1), 0.0), swinging(true, (0.45, 0.1), 2.0)]
    shapes = [[body_shape(true, way[t], rig) for way in poses] for t in range(FRAMES)]
    frames = [Frame(t / RATE, t, masks_of(shown, rig)) for t, shown in enumerate(shapes)]
    x = np.zeros(len(SHAPE_FACTORS))
    x[[entity("upper arm length"), entity("forearm length")]] = 0.15
    wrong, people = body_of(true, x), []
    for name, way in zip(("a", "b"), poses, strict=True):
        subject = TrackedSubject(wrong, None, way[0], ("fitted once",))
        tracker = tracker_of(subject, TrackOptions(evidence="silhouettes"), RATE)
        people.append(TrackedPerson.at_start(name, subject, tracker))
    return people, frames


def arms(body):
    """m: lengths of both parts of an arm."""
    s = body.skeleton
    return np.linalg.norm(s.rest_offsets[[s.joint("left_elbow"), s.joint("left_wrist")]], axis=1)


@pytest.mark.slow
def test_arms_that_were_fitted_too_long_are_put_right(passing):
    people, frames = passing
    found = fitted_again(people, frames.__getitem__, range(FRAMES), KnownPerson)
    assert sorted(found) == [0, 1]
    for k, subject in found.items():
        was, now = (np.abs(arms(b) - arms(human())).sum() for b in (people[k].subject.body, subject.body))
        assert now < 0.5 * was
        assert subject.notes == ("fitted once", AGAIN)
    again = [replace(p, subject=found[k]) for k, p in enumerate(people)]
    assert not fitted_again(again, frames.__getitem__, range(FRAMES), KnownPerson)


def test_a_given_body_and_who_is_alone_stay_as_they_are(passing):
    people, frames = passing
    given = {"a": KnownPerson("a", body=human()), "b": KnownPerson("b", body=human())}
    assert not fitted_again(people, frames.__getitem__, range(FRAMES), given.__getitem__)
    assert not fitted_again(people[:1], frames.__getitem__, range(FRAMES), KnownPerson)


@pytest.mark.parametrize("away", [(0.05, 0.0, 0.0), (0.28, 0.03, 0.0)], ids=["in one place", "between people"])
def test_of_two_who_are_one_the_better_one_stays_by_the_first_name(passing, away):
    people, frames = passing
    turned = people[0].subject.start.copy()
    turned[:3] += away
    turned[5] += np.pi / 2  # about the vertical
    double = replace(people[0], name="c", subject=replace(people[0].subject, start=turned))
    found = without_doubles([double, people[1], people[0]], frames[0])
    assert list(found) == ["c", "b"]
    assert found["c"] is people[0].subject and found["b"] is people[1].subject
    assert list(without_doubles(people, frames[0])) == ["a", "b"]
