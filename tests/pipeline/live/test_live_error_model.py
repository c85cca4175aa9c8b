"""What is doubtful about the newest frame is told with what is known by then."""

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.pipeline.live.live_people import LiveErrorModel
from hypose.pipeline.subject import TrackedSubject
from hypose.pipeline.track_loop import tracker_of
from hypose.pipeline.track_options import TrackOptions
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.start_search import scaled_to_height, starts_in_frame
from tests.live_scenes import RATE


@pytest.fixture(scope="module")
def followed(walk, frames):
    """A tracker, and (frame, estimate) of one second."""
    body = scaled_to_height(human(), walk.subject.stature)
    tracker = tracker_of(TrackedSubject(body, None, np.zeros(body.skeleton.dof), ()), TrackOptions(), RATE)
    start = starts_in_frame(body, prepare(frames[0], body, np.zeros(body.skeleton.dof)), body.stature)[0].pose
    state, out = tracker.start(start), []
    for frame in frames[:25]:
        state, estimate = tracker.step(state, frame)
        out.append((frame, estimate))
    return tracker, out


def test_the_first_frame_is_doubtful_and_then_it_is_known(followed):
    tracker, known = followed
    doubt, reported = LiveErrorModel(), []
    for frame, estimate in known:
        reported.append(doubt.reported(tracker, estimate, frame))
        doubt.look(tracker, estimate, frame)
    first, last = reported[0], reported[-1]
    assert (
        first.low_confidence_joints is not None
        and first.low_confidence_joints.all()
        and (first.error_probability >= 0.5).all()
    )
    assert not last.low_confidence_joints.all() and np.median(last.error_probability) < 0.3
    for motion in reported:
        assert len(motion) == 1 and motion.joints.shape[1] == motion.error_probability.shape[1]
        assert np.isfinite(motion.joint_sd).all() and (motion.joint_sd > 0).all()
        assert ((motion.error_probability >= 0) & (motion.error_probability <= 1)).all()
