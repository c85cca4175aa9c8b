"""Masks of one camera that contradict those of all others in every frame are left out; right ones are kept."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.pipeline.sources import FrameList
from hypose.pipeline.track import track_source
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.metrics import EVALUATED
from hypose.synthetic.scenes import camera_rig, make_scene

WRONG = 4


@pytest.fixture(scope="module")
def scene():
    return make_scene("walk", "broad", camera_rig("ring-5").scaled(0.4), seconds=0.48, seed=3)


def tracked(frames):
    return track_source(FrameList(frames), 25.0, TrackOptions(evidence="both", start="keypoints"))


def left_out(result):
    return [f.views for f in result.findings if f.kind == "masks"]


def shifted(frame):
    """The frame with the mask of one camera a third of the person's height too low."""
    masks = frame.silhouettes.masks.copy()
    rows = int(np.ptp(np.flatnonzero(masks[WRONG].any(1)))) // 3
    masks[WRONG] = np.roll(masks[WRONG], rows, axis=0)
    return replace(frame, silhouettes=replace(frame.silhouettes, masks=masks))


def test_masks_that_contradict_all_others_are_left_out(scene):
    frames = list(scene.mask_frames(1.0, keypoints=True))
    right, spoilt = tracked(frames), tracked([shifted(f) for f in frames])
    assert left_out(right) == [] and left_out(spoilt) == [(scene.rig.names[WRONG],)]
    error = [
        np.linalg.norm(r.motion.joints[:, EVALUATED] - scene.joints[:, EVALUATED], axis=-1).mean()
        for r in (right, spoilt)
    ]
    assert error[1] < error[0] + 0.005
