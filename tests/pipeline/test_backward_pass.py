"""An arm that was lost until it jumped back is found from behind; what needs nothing is left as it is."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.pipeline.retracking import backward_pass
from tests.walking_clip import walking_clip

N, LOST = 30, range(12, 18)


@pytest.fixture(scope="module")
def clip():
    """A walk's frames, its tracker, its estimates, and where the right wrist (T, 3) is."""
    scene, frames, tracker, start = walking_clip(N)
    wrist = scene.joints[:, tracker.body.skeleton.joint("right_wrist")]
    return frames, tracker, [e for _, e in tracker.follow(tracker.start(start), frames)], wrist


def reader(frames, read):
    def of(numbers):
        read.extend(numbers)
        return (frames[t] for t in numbers)

    return of


def wrists(tracker, estimates):
    s = tracker.body.skeleton
    return tracker.body.joints(np.stack([e.pose for e in estimates]))[:, s.joint("right_wrist")]


def with_a_lost_arm(tracker, estimates):
    """The estimates with the right arm held out to the side, where no mask is, in the frames LOST."""
    own = tracker.body.skeleton.dofs_of("right_shoulder", "right_elbow")
    out = list(estimates)
    for t in LOST:
        pose = out[t].pose.copy()
        pose[own] = 0.0
        out[t] = replace(out[t], pose=pose)
    return out


def test_an_arm_is_found_from_behind(clip):
    frames, tracker, estimates, true = clip
    lost = with_a_lost_arm(tracker, estimates)
    usual, off = (np.linalg.norm(wrists(tracker, e) - true[:N], axis=1) for e in (estimates, lost))
    assert off[LOST].min() > usual.max() + 0.1
    read = []
    found, moved = backward_pass(tracker, lost, reader(frames, read))
    assert np.linalg.norm(wrists(tracker, found) - true[:N], axis=1).max() < usual.max() + 0.02
    assert moved >= len(LOST)
    after = LOST.stop + 4
    assert all(a is b for a, b in zip(found[after:], lost[after:], strict=True)) and max(read) < after
    assert all(e.audit.size and np.isfinite(e.pose).all() for e in (found[t] for t in LOST))
    again, _ = backward_pass(tracker, lost, reader(frames, read))
    np.testing.assert_array_equal([e.pose for e in again], [e.pose for e in found])


def test_arms_that_do_not_jump_are_left_alone(clip):
    frames, tracker, estimates, _ = clip
    still = [estimates[20]] * N
    read = []
    found, moved = backward_pass(tracker, still, reader(frames, read))
    assert moved == 0 and not read and all(a is b for a, b in zip(found, still, strict=True))
