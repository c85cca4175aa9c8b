"""Stretches in which left and right were exchanged are found and tracked again; nothing else is touched."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.pipeline.doubts import what_was_seen
from hypose.pipeline.first_frame import Subject
from hypose.pipeline.mend_sides import mend_sides, read_once, sides_notes
from hypose.pipeline.run import TrackOptions, track_source
from hypose.tracking.exchanged_sides import turned_around
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
        out.append(replace(estimate, seen=what_was_seen(estimate, tracker.body, frame, last)))
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
    same, replaced = mend_sides(
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
    mended, replaced = mend_sides(tracker, spoilt, reader(frames))
    assert turned_share(scene, tracker, mended) == 0
    assert len(replaced) == 1
    assert replaced[0].start >= first - 3 and replaced[0].stop <= stop + 3
    costs = [np.mean([e.cost for e in clip_]) for clip_ in (good, spoilt, mended)]
    assert costs[2] < costs[1] and costs[2] < costs[0] + 0.01
    assert [e.seen.shape for e in mended] == [e.seen.shape for e in good]
    assert f"{replaced[0].start}-{replaced[0].stop - 1}" in sides_notes(replaced)[0]


def test_the_same_again_gives_the_same(clip):
    _, frames, tracker, good = clip
    spoilt = tracked(tracker, turned_around(tracker.body, good[0].pose), frames)
    a, b = (mend_sides(tracker, spoilt, reader(frames))[0] for _ in range(2))
    assert all((x.pose == y.pose).all() for x, y in zip(a, b, strict=True))


def test_a_start_that_a_person_has_corrected_is_not_turned(clip):
    _, frames, tracker, good = clip
    spoilt = tracked(tracker, turned_around(tracker.body, good[0].pose), frames)
    same, replaced = mend_sides(tracker, spoilt, reader(frames), sure_start=True)
    assert same[0] is spoilt[0] and all(r.start > 0 for r in replaced)


def test_a_recording_tracked_from_a_turned_start_comes_out_the_right_way_round(clip):
    scene, frames, tracker, good = clip

    class Source:
        def __len__(self):
            return len(frames)

        def frame(self, index):
            return frames[index]

    start = turned_around(tracker.body, good[0].pose)
    result = track_source(Source(), 25.0, TrackOptions(), subject=Subject(tracker.body, None, start, ("given",)))
    s = tracker.body.skeleton
    across = (result.motion.joints[:, s.joint(f"{side}_hip"), :2] for side in ("left", "right"))
    true = scene.joints[:N, s.joint("left_hip"), :2] - scene.joints[:N, s.joint("right_hip"), :2]
    left, right = across
    assert (((left - right) * true).sum(1) > 0).all()
    assert any("exchanged in frames 0-" in note for note in result.notes)


def test_frames_of_the_last_block_are_read_once(clip):
    frames, read = clip[1], []

    def of(numbers):
        read.append(numbers)
        return (frames[t] for t in numbers)

    once = read_once(of)
    for first, stop in ((15, 40), (15, 40), (10, 31), (0, 5), (12, 20)):
        found = list(once(range(first, stop)))
        assert len(found) == stop - first and all(a is b for a, b in zip(found, frames[first:stop], strict=True))
    assert read == [range(15, 40), range(10, 15), range(0, 5), range(12, 20)]
