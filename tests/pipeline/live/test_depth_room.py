"""Depth cameras of the live engine: rooms, what is kept of a frame, addresses, and one camera alone."""

import threading
import time

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.errors import InputError
from hypose.evidence.frame import Frame
from hypose.evidence.silhouettes import SilhouetteSettings
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import load_recording
from hypose.io.sensors.depth import is_depth, open_depth_camera, write_depth_png
from hypose.io.videos.video import StreamEnded
from hypose.pipeline.live.background_models import DepthViewBackground
from hypose.pipeline.live.background_work import KeptFrame
from hypose.pipeline.live.capture import CaptureOptions, CaptureRequest, LiveView
from hypose.pipeline.live.engine import LiveResult
from hypose.pipeline.live.recorder import LiveRecorder
from hypose.tracking.start_search import known_pose
from tests.depth_pictures import WALL_M, frame_of, sensors
from tests.live_scenes import in_step


@pytest.fixture(scope="module")
def frame():
    body = human()
    pose = known_pose(body, "standing")
    pose[:3] = 0.0, 0.0, 0.95
    return frame_of(body, pose, sensors(2))


def test_the_person_stands_before_the_room_that_was_learnt(frame):
    camera = frame.depth.rig[0]
    room = DepthViewBackground(camera, camera, (0.0, 0.0))
    room.learn([np.full(camera.size[::-1], WALL_M, np.float32)] * 3)
    assert not room.moved
    mask, outline = room.mask(frame.depth.maps[0])
    person = frame.depth.person[0]
    assert outline is not None and (mask != person).sum() < 0.05 * person.sum()
    assert np.abs(room.seen / 1000 - frame.depth.maps[0]).max() < 0.001
    assert room.mask(np.full(camera.size[::-1], WALL_M, np.float32))[1] is None


def test_depth_is_kept_of_the_person(frame):
    again = KeptFrame.of(frame).frame().depth
    person = frame.depth.person > 0
    assert np.array_equal(again.person, frame.depth.person)
    assert np.abs(again.maps - frame.depth.maps)[person].max() < 0.001
    assert not again.maps[~person.any(0)[None].repeat(2, 0)].any()


def test_a_folder_of_maps_is_played_at_its_pace(tmp_path):
    for k in range(3):
        write_depth_png(tmp_path / f"{k:03d}.png", np.full((4, 6), 1.0 + k))
    begin = time.monotonic()
    source = open_depth_camera(f"depth:{tmp_path}", 20.0, begin)
    shots = [source.read() for _ in range(3)]
    assert shots[-1].arrival - begin >= 0.1
    assert [round(float(s.picture.mean())) for s in shots] == [1, 2, 3]
    assert shots[0].picture.shape == (4, 6)
    with pytest.raises(StreamEnded, match="is over"):
        source.read()


def test_addresses_of_depth_cameras(tmp_path):
    assert [is_depth(a) for a in ("realsense", "realsense:123", "depth:x", "0", "clip.mp4")] == [True] * 3 + [False] * 2
    with pytest.raises(InputError, match="There is no folder"):
        open_depth_camera(f"depth:{tmp_path / 'none'}", 30.0)


def test_what_is_recorded_keeps_the_empty_room(tmp_path, monkeypatch):
    rig = sensors(1)
    w, h = rig[0].size
    empty = np.full((h, w), 3.0)
    someone = empty.copy()
    someone[h // 4 : 3 * h // 4, w // 3 : w // 2] = 2.0
    (tmp_path / "maps").mkdir()
    for k in range(90):
        write_depth_png(tmp_path / "maps" / f"{k:03d}.png", empty if k < 75 else someone)
    view = LiveView(rig.names[0], f"depth:{tmp_path / 'maps'}", depth=True)
    capture = in_step(monkeypatch)(rig, [view], CaptureOptions(30.0, 0.0), threading.Event())
    recorder = LiveRecorder(tmp_path / "live", rig, [view], SilhouetteSettings())
    try:
        capture.ask(CaptureRequest(pictures=True))
        while (captured := capture.answer()) is not None:
            if np.isfinite(captured.time):
                recorder.seen(LiveResult(captured, Frame(captured.time, recorder.written), ()))
    finally:
        capture.close()
    assert recorder.close()
    recording = load_recording(tmp_path / "live")
    room = recording.views[0].files["background"]
    assert room is not None and len(list(room.glob("*.png"))) >= 3
    masks = [f.silhouettes.masks[0] for f in FrameStream(recording) if f.silhouettes is not None]
    assert max(m.sum() for m in masks) > 0.9 * (someone < 3).sum()
