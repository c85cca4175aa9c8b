"""A body is found where one of two views is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.robustness.small_recordings import small_scene
from hypose.cameras.camera import CameraRig
from hypose.pipeline.subject import SubjectOptions, find_subject


@pytest.mark.slow
def test_a_body_is_found_where_one_of_two_views_is_wrong_as_a_whole():
    frames = []
    for f in small_scene(1, 10, "box").mask_frames(1.0, keypoints=True):
        k, s, points = f.keypoints, f.silhouettes, f.keypoints.points[:2].copy()
        points[1, points[1, :, 2] > 0, 0] += 30
        rig, small = CameraRig(tuple(k.rig)[:2]), CameraRig(tuple(s.rig)[:2])
        masks = replace(s, masks=s.masks[:2], usable=s.usable[:2], reasons=s.reasons[:2], rig=small)
        frames.append(replace(f, keypoints=replace(k, points=points, rig=rig), silhouettes=masks))
    options = SubjectOptions("keypoints", frame_rate=25.0)
    body = find_subject(lambda i: frames[i], len(frames), options).body
    assert np.isfinite(list(body.segment_lengths().values())).all() and 1.5 < body.stature < 2.0
