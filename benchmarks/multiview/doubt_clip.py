"""Does the solve over a whole clip make joints wrong that were right frame by frame? Scenes with noisy key points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.multiview.doubt_scenes import CASES, Case, scene_without_masks
from benchmarks.multiview.product import aligned_joints
from benchmarks.synthetic.spoilt_keypoints import spoilt
from hypose.pipeline.first_frame import SubjectOptions, find_subject
from hypose.pipeline.run import track_source
from hypose.pipeline.track_loop import FrameList
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.metrics import EVALUATED

MOTIONS: dict[str, Case] = {
    "boxing": CASES["boxing"],
    "box": CASES["box"],
    "punch": replace(CASES["punch"], rig="humaneva-4"),
    "serve": CASES["serve"],
    "run": CASES["run"],
}
FAR_M = 0.15


def before_and_after(
    name: str, seed: int, seconds: float = 3.0, how: Sequence[str] = ("noisy",)
) -> tuple[int, int, int]:
    """Joint-frames further than FAR_M off before the clip's solve and after it, and how many there are."""
    scene, frames = scene_without_masks(MOTIONS[name], seed, seconds)
    for one in how:
        frames = spoilt(frames, one, np.random.default_rng([seed, 7]))
    source = FrameList(frames, scene.frame_rate)
    options = SubjectOptions("keypoints", frame_rate=scene.frame_rate, girths=False)
    subject = find_subject(source.frame, len(source), options)
    result = track_source(source, scene.frame_rate, TrackOptions(evidence="keypoints"), subject=subject)
    assert result.one_by_one is not None
    own = replace(result.motion, poses=result.one_by_one, joints=result.body.joints(result.one_by_one))
    error = [
        np.linalg.norm(aligned_joints(m, scene) - scene.joints, axis=-1)[:, EVALUATED] for m in (own, result.motion)
    ]
    return int((error[0] > FAR_M).sum()), int((error[1] > FAR_M).sum()), error[0].size
