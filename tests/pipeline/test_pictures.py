"""Frames of one camera with its picture: the one before, on either way, and a track of frames in memory."""

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.evidence.frame import Frame, Keypoints, Picture
from hypose.pipeline.sources import FrameList
from hypose.pipeline.track import track
from hypose.pipeline.track_options import TrackOptions
from tests.monocular.pictures import camera, mask, picture, wall

NAMES = tuple(f"{s}_{j}" for s in ("left", "right") for j in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle"))


@pytest.fixture(scope="module")
def clip():
    """A body, its poses, and frames in memory with pictures, masks and key points."""
    body = human()
    s, view = body.skeleton, camera(body)
    poses = np.tile(s.rest_pose(), (4, 1))
    poses[:, s.dofs_of("left_elbow")] += 0.1 * np.arange(4)[:, None]
    background, frames = wall(clutter=6), []
    for i, q in enumerate(poses):
        seen = view.project(body.joints(q))[[s.joint(n) for n in NAMES]]
        points = Keypoints(np.column_stack([seen, np.ones(len(NAMES))])[None], NAMES, CameraRig((view,)))
        shown = Picture(view, picture(body, q, view, background), None, mask(body, q, view))
        frames.append(Frame(i / 25, i, keypoints=points, picture=shown))
    return body, poses, FrameList(frames)


@pytest.mark.parametrize("evidence", ["auto", "edges"])
def test_frames_in_memory_are_tracked_as_those_of_a_recording(clip, evidence):
    body, poses, frames = clip
    options = TrackOptions("monocular", evidence=evidence, particles=2)
    found = track(frames, options, body=body)
    assert found.complete and found.modes is not None and len(found.modes) == len(found.motion) == 4
    assert any("start from the key points of frame 0" in n for n in found.notes)
    assert any("one camera does not measure depth" in n for n in found.notes)
    assert (found.motion.n_views == 1).all() and not found.motion.extrapolated.any()
    apart = np.linalg.norm(found.motion.joints - body.joints(poses), axis=-1)
    assert np.median(apart) < 0.1


def test_clicks_belong_to_a_recording(clip, tmp_path):
    (tmp_path / "clicks.json").write_text("{}")
    with pytest.raises(InputError, match="frames in memory start from their key points"):
        track(clip[2], TrackOptions("monocular", start=str(tmp_path / "clicks.json")), body=clip[0])
