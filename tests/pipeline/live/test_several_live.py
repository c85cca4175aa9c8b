"""Two people in the same masks, live: found together, told apart, and one goes."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.multiview.action_scenes import subject_of_seed
from hypose.pipeline.live.live_people import STATE_TRACKING, LivePeople, LivePersonOptions
from hypose.synthetic.motions import act
from hypose.synthetic.performance import moved
from hypose.synthetic.scenes import camera_rig, make_scene
from tests.live_scenes import RATE, Beside, at

TOGETHER, ALONE = 40, 75
"""frames in which both are there, and in which one is"""

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scenes():
    """Somebody who boxes and, 1.1 m beside, somebody who waves; four cameras of 320 x 240 px."""
    out = []
    for k, (name, x) in enumerate((("box", -0.55), ("wave", 0.55))):
        subject = subject_of_seed(7 + k)
        p = act(name, subject, (TOGETHER + ALONE) / RATE, RATE, np.random.default_rng(k))
        out.append(make_scene(moved(p, 0.0, (x, 0.0)), subject, camera_rig("humaneva-4").scaled(0.5), seed=k))
    return out


@pytest.fixture(scope="module")
def followed(scenes):
    """The poses of every frame, and how many were followed then."""
    both = replace(scenes[0], others=((scenes[1].subject, scenes[1].performance),))
    frames = [*list(both.mask_frames())[:TOGETHER], *list(scenes[0].mask_frames())[TOGETHER:]]
    executor = Beside()
    people = LivePeople(frames[0].silhouettes.rig, RATE, LivePersonOptions(), executor, None, 3)
    out = []
    for frame in frames:
        tracked = people.step(at(frame, frame.index / RATE))
        out.append([p.pose() for p in tracked])
        for p in tracked:
            p.judge()
        if not people.people:
            executor.work()
        else:
            executor.waiting.clear()  # no duels here, and nobody more is searched
    assert people.phase == STATE_TRACKING
    return out


def test_two_are_found_at_once_and_each_is_followed_by_a_number_of_their_own(scenes, followed):
    first = next(k for k, poses in enumerate(followed) if poses)
    assert first < 15
    where = {}
    for k in range(first, TOGETHER):
        assert [p.person for p in followed[k]] == [1, 2]
        for p in followed[k]:
            off = [np.linalg.norm(p.joints - s.joints[k], axis=-1).mean() for s in scenes]
            where.setdefault(p.person, []).append(int(np.argmin(off)))
            assert not p.lost and min(off) < 0.3  # their sides may be exchanged
    assert {frozenset(w) for w in where.values()} == {frozenset({0}), frozenset({1})}


def test_who_goes_is_given_up_and_who_stays_keeps_the_number(scenes, followed):
    (left,) = followed[-1]
    assert np.linalg.norm(left.joints - scenes[0].joints[-1], axis=-1).mean() < 0.3
    before = [p for p in followed[TOGETHER - 1] if p.person == left.person]
    assert np.linalg.norm(before[0].joints - scenes[0].joints[TOGETHER - 1], axis=-1).mean() < 0.3
