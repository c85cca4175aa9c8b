"""Hands and head by colour from the videos of a recording."""

import dataclasses

import numpy as np
import pytest

from benchmarks.multiview.action_scenes import known_subject
from hypose.errors import InputError
from hypose.evidence.body_parts import UNNAMED
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import load_recording
from hypose.pipeline.sources import ColourDetections, tracked_frames
from hypose.pipeline.track import track_source
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.scenes import camera_rig, make_scene
from hypose.synthetic.write_recording import write_scene


@pytest.fixture(scope="module")
def scene():
    made = make_scene("wave", "man_01", camera_rig("ring-4").scaled(0.6), seconds=0.24, seed=3)
    return dataclasses.replace(made, hands_only=True)


@pytest.fixture(scope="module")
def recording(scene, tmp_path_factory):
    return load_recording(write_scene(scene, tmp_path_factory.mktemp("wave")).parent)


@pytest.fixture(scope="module")
def silent(recording):
    """The recording without key points."""
    views = tuple(v.without("keypoints") for v in recording.views)
    return dataclasses.replace(recording, views=views, keypoint_set=None)


def test_hands_and_head_are_found_in_videos(scene, silent):
    subject = known_subject(scene)
    with FrameStream(silent) as stream:
        frames = list(
            tracked_frames(stream, range(len(stream)), ("silhouettes", "detections"), subject.body, subject.start)
        )
        alone = ColourDetections(stream, subject.body, subject.start)
        last = alone.frame(len(stream) - 1)
        alone.close()
        plain = next(iter(tracked_frames(stream, range(1), ("silhouettes",), subject.body, subject.start)))
    assert plain.detections is None
    found = 0
    for t, frame in enumerate(frames):
        assert frame.detections is not None and (frame.detections.part == UNNAMED).all()
        ends = scene.joints[t][[4, 8, 12]]
        if len(frame.detections.points):
            gap = np.linalg.norm(frame.detections.points[:, None] - ends, axis=2).min(0)
            found += int((gap < 0.2).sum())
    assert found >= len(frames)  # of three ends, one at least
    # a frame does not depend on those asked for before
    assert frames[-1].detections is not None and last.detections is not None
    np.testing.assert_array_equal(frames[-1].detections.points, last.detections.points)


def test_grey_videos_are_refused(scene, silent, monkeypatch):
    grey = lambda self, index, silhouettes: np.full((*silhouettes.masks.shape, 3), 90, np.uint8)  # noqa: E731
    monkeypatch.setattr(ColourDetections, "_images", grey)
    with FrameStream(silent) as stream, pytest.raises(InputError, match="grey"):
        track_source(stream, 25.0, TrackOptions(recipe="dd-hpf+"), subject=known_subject(scene))
