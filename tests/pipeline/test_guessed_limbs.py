"""A body is found where one of two views is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.robustness.small_recordings import small_scene
from hypose.cameras.camera import CameraRig
from hypose.pipeline.first_frame import SubjectOptions, find_subject

SCENE = small_scene(1, 10, "box")
FRAMES = list(SCENE.mask_frames(1.0, keypoints=True))


def with_points(change, views=slice(None)):
    """The frames of some of the views, with `change(points)` of each."""
    out = []
    for f in FRAMES:
        k, s = f.keypoints, f.silhouettes
        points, numbers = k.points[views].copy(), range(len(k.rig))[views]
        change(points)
        rig, small = (CameraRig(tuple(r[c] for c in numbers)) for r in (k.rig, s.rig))
        masks = replace(s, masks=s.masks[views], usable=s.usable[views], reasons=s.reasons[views], rig=small)
        out.append(replace(f, keypoints=replace(k, points=points, rig=rig), silhouettes=masks))
    return out


def body_of(frames):
    return find_subject(lambda i: frames[i], len(frames), SubjectOptions("keypoints", frame_rate=25.0)).body


@pytest.mark.slow
def test_a_body_is_found_where_one_of_two_views_is_wrong_as_a_whole():
    def aside(points):
        seen = points[1, :, 2] > 0
        points[1, seen, 0] += 30

    body = body_of(with_points(aside, slice(2)))
    assert np.isfinite(list(body.segment_lengths().values())).all() and 1.5 < body.stature < 2.0
