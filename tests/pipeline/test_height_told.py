"""A height that is given and that masks refute is told; a right one is not."""

import numpy as np
import pytest

from benchmarks.synthetic.noisy_masks import noisy_scene
from hypose.body.default_body import human
from hypose.pipeline.assessment import UNTRUSTED
from hypose.pipeline.run import track_source
from hypose.pipeline.subject import measured_height
from hypose.pipeline.track_loop import FrameList
from hypose.pipeline.track_options import TrackOptions


@pytest.fixture(scope="module")
def scene():
    return noisy_scene("wave", rig="ring-3", seconds=1.6, seed=53)


@pytest.mark.slow
@pytest.mark.parametrize("share", [1.0, 0.87])
def test_a_height_that_the_masks_refute_makes_a_motion_not_to_be_trusted(scene, share):
    given = share * scene.subject.stature
    assessment = track_source(
        FrameList(list(scene.mask_frames(0.5))), 25.0, TrackOptions(seed=1, height=given)
    ).assessment
    said = f"the person is {scene.subject.stature:.2f} m tall by what the cameras see, not {given:.2f} m as given"
    assert (said in assessment.sentence) == (share < 1)
    assert assessment.word == UNTRUSTED or share == 1


def test_what_was_not_seen_tells_no_height(scene):
    frames = list(scene.mask_frames(0.5))
    body = human()
    poses = np.zeros((len(frames), body.skeleton.dof))
    assert measured_height(lambda i: frames[i], body, poses, np.full(len(frames), np.nan)) is None
