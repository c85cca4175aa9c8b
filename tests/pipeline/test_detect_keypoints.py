"""Masks and points of a network, in files: where they lie, how work goes on, and what tracking takes of them."""

import cv2
import numpy as np
import pytest

from hypose.evidence.pose_network import CROP, Crop, Sighting
from hypose.io.keypoints.read_keypoints import load_detected
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import keypoints_of_recording, load_recording
from hypose.pipeline.detect_keypoints import detect_keypoints, wants_detector
from hypose.pipeline.track_options import TrackOptions
from tests.io.recordings import SIZE, frame_number, make_recording


class Network:
    """Sees a disc whose middle moves by a pixel a frame, from where it was expected."""

    keypoint_set, identity, gives_masks = "BLAZEPOSE_33", {"detector": "stand-in"}, True

    def __init__(self):
        self.asked = []

    def look(self, image, number, before):
        assert abs(frame_number(image) - number) <= 1
        self.asked.append(number)
        hips = before[0].hips if before else np.array([20.0, 24.0])
        crop = Crop(hips, hips - (0, 12))
        rows, columns = np.indices((CROP, CROP)) - (CROP / 2 - 0.5)
        mask = (np.hypot(rows, columns) < CROP / 2.5).astype(np.float32)
        points = np.zeros((33, 3))
        points[23:25] = [*hips, 0.9]  # too few to be no body
        return [Sighting(points, mask, crop, Crop(hips + (1.25, 0), hips + (1.25, -12)))]


@pytest.fixture
def folder(tmp_path):
    return make_recording(tmp_path / "rec")


def test_masks_and_points_are_found_again_and_tracked_together(folder):
    recording = load_recording(folder)
    assert wants_detector(recording) and not recording.detected
    found = detect_keypoints(recording, Network(), folder / "keypoints")
    assert found.covers(recording.frames) and load_detected(folder / "keypoints") == found
    again = load_recording(folder)
    assert again.detected and not wants_detector(again) and again.keypoint_set == "BLAZEPOSE_33"
    assert TrackOptions().suited_to(again).looks_at == "both"
    assert TrackOptions(evidence="silhouettes").suited_to(again).looks_at == "silhouettes"
    with FrameStream(again) as stream:
        for t in (0, 5):
            mask = stream.frame(t).silhouettes.masks[0]
            middle = recording.rig[0].undistort_points(np.array([[20 + 1.25 * t, 24.0]]))[0]
            np.testing.assert_allclose(np.argwhere(mask).mean(0)[::-1], middle, atol=0.7)
            assert mask.sum() == pytest.approx(np.pi * 12**2, rel=0.1)


def test_where_the_room_is_known_its_masks_stay(folder, tmp_path):
    cv2.imwrite(str(folder / "room.png"), np.zeros((SIZE[1], SIZE[0], 3), np.uint8))
    toml = folder / "recording.toml"
    toml.write_text(toml.read_text().replace("[[view]]", '[[view]]\nbackground = "room.png"'))
    recording = load_recording(folder)
    assert not wants_detector(recording)
    detect_keypoints(recording, Network(), folder / "keypoints")
    again = load_recording(folder)
    assert again.keypoint_set == "BLAZEPOSE_33" and not any("masks" in v.files for v in again.views)


def test_what_was_stopped_goes_on_as_if_it_had_not(folder, tmp_path):
    recording = load_recording(folder)
    whole = detect_keypoints(recording, Network(), tmp_path / "whole")

    def stop(done, total):
        if done == 9:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        detect_keypoints(recording, Network(), tmp_path / "parts", progress=stop)
    assert not load_detected(tmp_path / "parts").complete
    second = Network()
    parts = detect_keypoints(recording, second, tmp_path / "parts", resume=True)
    assert len(second.asked) < 2 * recording.n_frames - 7
    for view in recording.views:
        for t in recording.frames:
            assert whole.file(view.name, t).read_bytes() == parts.file(view.name, t).read_bytes()
            assert whole.mask(view.name, t).read_bytes() == parts.mask(view.name, t).read_bytes()


def test_frames_in_the_middle_keep_their_numbers(folder):
    recording = load_recording(folder)
    network = Network()
    found = detect_keypoints(recording, network, folder / "keypoints", frames=range(4, 7))
    assert sorted(set(network.asked)) == [4, 5, 6] and found.covers(range(5, 7)) and not found.covers(range(3, 7))
    again = load_recording(folder)
    assert again.n_frames == recording.n_frames
    with FrameStream(again) as stream:
        assert stream.frame(5).silhouettes.usable.all()
        assert not stream.frame(2).silhouettes.usable.any()
    view = keypoints_of_recording(again)[0]
    assert view.first == 0 and len(view.frame(5, SIZE)) == 1 and view.frame(2, SIZE) is None
