"""What a clip's solve made of a limb is given up where the frame's own evidence refutes it."""

from dataclasses import replace

import numpy as np

from hypose.tracking.kept_limbs import with_tracked_limbs
from hypose.tracking.tracker import Tracker, TrackerSettings, motion_of
from tests.walking_clip import walking_clip


def test_a_limb_that_the_evidence_refutes_is_as_it_was_tracked_and_no_other():
    _, frames, tracker, start = walking_clip(3)
    tracker = Tracker(tracker.body, tracker.recipe, TrackerSettings(evidence="both"))
    right = [e for _, e in tracker.follow(tracker.start(start), frames)]
    s = tracker.body.skeleton
    lost = right[1].pose.copy()
    lost[s.dofs_of("left_shoulder")] += (1.4, 0.3, 0.0)
    wrong = [right[0], replace(right[1], pose=s.clamp(lost)), right[2]]
    good, bad = (motion_of(tracker.body, np.arange(3) / 25, estimates) for estimates in (right, wrong))
    hand = s.joint("left_wrist")
    assert np.linalg.norm(good.joints[1, hand] - bad.joints[1, hand]) > 0.3

    def read(numbers):
        return (frames[t] for t in numbers)

    mended = with_tracked_limbs(tracker, good, bad, read)
    np.testing.assert_array_equal(mended.poses, good.poses)
    np.testing.assert_allclose(mended.joints, good.joints, atol=1e-9)
    assert with_tracked_limbs(tracker, bad, good, read) is good
    alone = replace(tracker, settings=TrackerSettings(evidence="silhouettes"))
    assert with_tracked_limbs(alone, good, bad, read) is bad
