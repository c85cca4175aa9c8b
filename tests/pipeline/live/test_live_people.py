"""Somebody is found, followed, lost and found again; work beside is done when the test says so."""

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.pipeline.live.live_people import STATE_EMPTY, STATE_LOST, STATE_SEARCHING, STATE_TRACKING
from hypose.tracking.left_right import turned_around
from hypose.tracking.start_search import scaled_to_height
from tests.conftest import HANG_S
from tests.live_scenes import RATE, at, follow, nobody, people_for


def errors(poses, walk):
    """m, mean over the joints, of each pose whose frame's number is that of the scene."""
    return np.array([np.linalg.norm(p.joints - walk.joints[p.frame], axis=-1).mean() for p in poses])


def test_somebody_is_found_without_a_pose_asked_and_followed(walk, frames, executor):
    people = people_for(frames, executor)
    assert people.phase == STATE_EMPTY
    poses = follow(people, frames, executor)
    assert people.phase == STATE_TRACKING and len(poses) > 80
    assert [p.frame for p in poses] == list(range(poses[0].frame, 100))
    off = errors(poses, walk)
    assert off[5:].mean() < 0.06 and off[5:].max() < 0.15
    assert all(p.views.all() and not p.lost for p in poses)
    assert not people.fitted  # nothing was measured


def test_the_same_frames_give_the_same_poses(frames, executor):
    first, second = (follow(people_for(frames, executor), frames[:30], executor) for _ in range(2))
    assert first and all((a.joints == b.joints).all() for a, b in zip(first, second, strict=True))


def test_an_empty_room_is_nobody(frames, executor):
    people = people_for(frames, executor)
    assert follow(people, [nobody(f) for f in frames[:30]], executor) == []
    assert people.phase == STATE_EMPTY and not executor.waiting


@pytest.mark.slow
def test_masks_that_are_nobody_are_searched_and_left(frames, executor):
    people = people_for(frames, executor)

    def noise(frame):
        s = frame.silhouettes
        masks = np.zeros_like(s.masks)
        masks[:, 10:110, 10:150] = 1
        return replace(frame, silhouettes=replace(s, masks=masks))

    assert follow(people, [noise(f) for f in frames[:40]], executor) == []
    assert people.phase in (STATE_SEARCHING, STATE_EMPTY)
    later = [at(f, f.time + 10, f.index) for f in frames[:40]]
    assert follow(people, later, executor)  # somebody who comes after that is found


def test_who_is_lost_is_told_and_looked_for_as_at_the_start(walk, frames, executor):
    people = people_for(frames, executor)
    follow(people, frames[:30], executor)
    away = [at(nobody(frames[30 + k % 60]), 30 / RATE + k / RATE) for k in range(150)]
    phases = []
    for frame in away:
        stepped = people.step(frame)
        phases.append(people.phase)
        assert (not stepped) == (people.phase == STATE_EMPTY)
        if stepped and people.phase == STATE_LOST:
            reported = stepped[0].pose()
            assert (
                reported.lost
                and reported.motion.low_confidence_joints is not None
                and reported.motion.low_confidence_joints.all()
            )
    assert STATE_LOST in phases and phases[-1] == STATE_EMPTY
    back = [at(f, 20.0 + f.time) for f in frames[40:]]
    poses = follow(people, back, executor)
    assert people.phase == STATE_TRACKING and errors(poses[5:], walk).mean() < 0.06


def test_a_gap_in_the_pictures_is_survived(walk, frames, executor):
    people = people_for(frames, executor)
    follow(people, frames[:40], executor)
    poses = follow(people, [at(f, f.time + 0.2) for f in frames[46:]], executor)  # a moment without pictures
    assert errors(poses[8:], walk).mean() < 0.07


def test_frames_at_half_the_rate_are_followed_at_that_rate(walk, frames):
    with ThreadPoolExecutor(1) as pool:
        people = people_for(frames, pool)
        poses = [s.pose() for f in frames[::2] for s in step_with_duels(people, f)]
        assert people.people[0].member.tracker.settings.frame_rate == pytest.approx(12.5, rel=0.35)
        end_duel(people)
    # so few pictures of so few pixels may be taken for somebody who turns around: not for long
    off = errors(poses, walk)
    assert len(poses) > 35 and np.median(off) < 0.04 and off[-8:].mean() < 0.06


def test_a_missing_view_is_not_among_the_views(frames, executor):
    people = people_for(frames, executor)
    follow(people, frames[:30], executor)
    s = frames[30].silhouettes
    usable = s.usable.copy()
    usable[2] = False
    gone = replace(s, usable=usable, reasons=("", "", "no picture", ""))
    (pose,) = follow(people, [replace(frames[30], silhouettes=gone)], executor)
    assert pose.views.tolist() == [True, True, False, True] and not pose.lost


def test_a_known_body_is_followed_as_it_is(walk, frames, executor):
    body = scaled_to_height(human(), walk.subject.stature)
    people = people_for(frames, executor, body=body)
    poses = follow(people, frames[:50], executor)
    assert all(p.body.stature == pytest.approx(body.stature, rel=1e-6) for p in poses)


def step_with_duels(people, frame):
    """A step, and what there is to do beside, so that nothing depends on how fast this computer is."""
    stepped, end = people.step(frame), time.monotonic() + HANG_S
    if people._search._search is not None:
        people._search._search.result(HANG_S)
    duel = people.people[0]._duel if people.people else None
    while duel is not None and not duel.won.done() and duel.frames.qsize() and time.monotonic() < end:
        time.sleep(0.002)
    return stepped


def end_duel(people):
    if people.people[0]._duel is not None:
        people.people[0]._duel.won.result(HANG_S)


# ---- who was started back to front ----


def test_the_duel_turns_a_body_that_was_started_back_to_front(walk, frames):
    with ThreadPoolExecutor(1) as pool:
        people = people_for(frames, pool, height=walk.subject.stature)
        k = next(f.index for f in frames if step_with_duels(people, f))
        (person,) = people.people
        body = person.member.tracker.body
        turned = person.member.tracker.start(turned_around(body, person.member.state.pose))
        person.member = replace(person.member, state=turned)
        s = body.skeleton
        left, right = s.joint("left_hip"), s.joint("right_hip")
        turned, duels = [], 0
        for frame in frames[k + 1 :]:
            (stepped,) = step_with_duels(people, frame)
            joints = stepped.pose().joints
            duels += person._duel is not None
            across = joints[left] - joints[right]
            true = walk.joints[frame.index, left] - walk.joints[frame.index, right]
            turned.append(float(across[:2] @ true[:2]) < 0)
        assert turned[0] and not any(turned[-10:]) and duels
        end_duel(people)


# ---- small things ----
