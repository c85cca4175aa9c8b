"""Stretches in which left and right were exchanged are found and tracked again; nothing else is touched."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.pipeline.frame_anomalies import view_statistics
from hypose.pipeline.retracking import correct_left_right, left_right_notes, retrack_start, start_notes
from hypose.pipeline.run import track_source
from hypose.pipeline.subject import TrackedSubject
from hypose.pipeline.track_options import TrackOptions
from hypose.tracking.left_right import turned_around
from hypose.tracking.start_search import known_pose
from tests.walking_clip import walking_clip

N = 45


@pytest.fixture(scope="module")
def clip():
    """A walk's frames, its tracker, and its estimates from a start the right way round."""
    scene, frames, tracker, start = walking_clip(N)
    return scene, frames, tracker, tracked(tracker, start, frames)


def tracked(tracker, start, frames):
    state, out, last = tracker.start(start), [], None
    for frame in frames:
        state, estimate = tracker.step(state, frame)
        out.append(replace(estimate, seen=view_statistics(estimate, tracker.body, frame, last)))
        last = frame
    return out


def reader(frames, read=None):
    """Frames by range; each range that is asked for is noted in `read`."""

    def of(numbers):
        if read is not None:
            read.append(numbers)
        return (frames[t] for t in numbers)

    return of


def turned_share(scene, tracker, estimates):
    """Share of the frames whose hips lie the other way round than the person's."""
    s = tracker.body.skeleton
    left, right = s.joint("left_hip"), s.joint("right_hip")
    joints = tracker.body.joints(np.stack([e.pose for e in estimates]))
    across, true = (j[:, left, :2] - j[:, right, :2] for j in (joints, scene.joints[: len(joints)]))
    return float(((across * true).sum(1) < 0).mean())


def test_what_is_the_right_way_round_stays_as_it_is(clip):
    scene, frames, tracker, good = clip
    read = []
    same, replaced = correct_left_right(
        tracker,
        good,
        reader(frames, read),
    )
    assert turned_share(scene, tracker, good) == 0
    assert replaced == [] and all(a is b for a, b in zip(same, good, strict=True))
    assert sum(len(r) for r in read) < N  # no more is read again than a look or two asks for


@pytest.mark.parametrize("span", [(0, N), (0, 25), (20, N)], ids=["whole", "begin", "end"])
def test_a_turned_stretch_is_tracked_again_and_only_that(clip, span):
    scene, frames, tracker, good = clip
    first, stop = span
    start = turned_around(tracker.body, good[first].pose)
    spoilt = [*good[:first], *tracked(tracker, start, frames[first:stop]), *good[stop:]]
    before = turned_share(scene, tracker, spoilt)
    assert before > 0.3, "the tracker finds the right way by itself: choose another scene"
    mended, replaced = correct_left_right(tracker, spoilt, reader(frames))
    assert turned_share(scene, tracker, mended) == 0
    assert len(replaced) == 1
    assert replaced[0].start >= first - 3 and replaced[0].stop <= stop + 3
    costs = [np.mean([e.cost for e in clip_]) for clip_ in (good, spoilt, mended)]
    assert costs[2] < costs[1] and costs[2] < costs[0] + 0.01
    assert [e.seen.shape for e in mended] == [e.seen.shape for e in good]
    assert f"{replaced[0].start}-{replaced[0].stop - 1}" in left_right_notes(replaced)[0]


def test_a_start_that_a_person_has_corrected_is_not_turned(clip):
    _, frames, tracker, good = clip
    spoilt = tracked(tracker, turned_around(tracker.body, good[0].pose), frames)
    same, replaced = correct_left_right(tracker, spoilt, reader(frames), sure_start=True)
    assert same[0] is spoilt[0] and all(r.start > 0 for r in replaced)


def test_a_recording_tracked_from_a_turned_start_comes_out_the_right_way_round(clip):
    scene, frames, tracker, good = clip

    class Source:
        def __len__(self):
            return len(frames)

        def frame(self, index):
            return frames[index]

    start = turned_around(tracker.body, good[0].pose)
    result = track_source(Source(), 25.0, TrackOptions(), subject=TrackedSubject(tracker.body, None, start, ("given",)))
    s = tracker.body.skeleton
    across = (result.motion.joints[:, s.joint(f"{side}_hip"), :2] for side in ("left", "right"))
    true = scene.joints[:N, s.joint("left_hip"), :2] - scene.joints[:N, s.joint("right_hip"), :2]
    left, right = across
    assert (((left - right) * true).sum(1) > 0).all()
    assert any("exchanged in frames 0-" in note for note in result.notes)


def test_what_the_start_got_wrong_is_tracked_again_from_what_came_after_it(clip):
    scene, frames, tracker, good = clip
    s, lost = tracker.body.skeleton, good[0].pose.copy()
    for arm in ("left_shoulder", "right_shoulder", "left_elbow", "right_elbow"):
        lost[s.dofs_of(arm)] = known_pose(tracker.body, "hands-up")[s.dofs_of(arm)]
    cost = good[0].cost + 0.1
    spoilt = [*(replace(e, pose=lost, cost=cost) for e in good[:6]), *good[6:]]
    mended, replaced = retrack_start(tracker, spoilt, reader(frames))
    # of the good frames behind them some may differ by more than counts as the same, and be as good
    assert replaced.start == 0 and 6 <= replaced.stop <= 25
    assert start_notes(replaced)[0].endswith("tracked again backwards")
    joints, before = (tracker.body.joints(np.stack([e.pose for e in es])) for es in (mended, good))
    assert np.linalg.norm(joints[:6] - before[:6], axis=-1).mean() < 0.02
    error, usual = (np.linalg.norm(j - scene.joints[:N], axis=-1).mean() for j in (joints, before))
    assert error < 1.1 * usual
    assert all(a is b for a, b in zip(mended[25:], good[25:], strict=True))
