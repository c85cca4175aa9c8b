"""Videos that lost frames, or whose rate varies or differs, are read by their time stamps."""

import json
from fractions import Fraction

import numpy as np
import pytest

from hypose.cameras.camera import CameraRig
from hypose.io.calibrations.calibration_formats import write_calibration
from hypose.io.recordings.recording import keypoints_of_recording, load_recording
from hypose.io.recordings.recording_views import open_pictures
from hypose.io.videos.video import frame_times, open_video
from hypose.synthetic.scenes import camera_rig

av = pytest.importorskip("av", reason="NOT tested: time stamps of videos; pip install 'hypose[azure]'")
RATE, COUNT, TICKS = 30, 90, 3_000


def film(path, times):
    """A video whose frames have these times (s) and are as bright as the time is late."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=RATE)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = 64, 48, "yuv420p", 4_000_000
        stream.codec_context.time_base = stream.time_base = Fraction(1, TICKS)
        for t in times:
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), shade(t), np.uint8), format="bgr24")
            frame.pts, frame.time_base = round(t * TICKS), Fraction(1, TICKS)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def shade(t):
    return round(20 + 200 * t * RATE / COUNT)


STEADY = np.arange(COUNT) / RATE
WAYS = {
    "lost": np.delete(STEADY, [20, 21, 47, 60, 75]),
    "a gap": np.delete(STEADY, np.arange(30, 42)),
    "jittered": STEADY + np.r_[0, np.random.default_rng(5).uniform(-0.4, 0.4, COUNT - 1)] / RATE,
    "slower": np.arange(75) / 25,
    "drifting": STEADY * 1.003 * (1 + 0.01 * np.sin(STEADY)),
}


def recording(folder, ways, more=""):
    rig = CameraRig(tuple(camera_rig("humaneva-4"))[:2]).scaled(0.1)
    write_calibration(rig, folder / "calibration.toml")
    text = 'calibration = "calibration.toml"\n'
    for camera, times in zip(rig, ways, strict=True):
        film(folder / f"{camera.name}.mp4", times)
        text += f'[[view]]\nname = "{camera.name}"\nvideo = "{camera.name}.mp4"\n{more}'
    (folder / "recording.toml").write_text(text)
    return load_recording(folder)


@pytest.mark.parametrize("way", WAYS)
def test_frames_are_those_of_their_time(tmp_path, way):
    found = recording(tmp_path, [STEADY, WAYS[way]])
    rate = found.frame_rate
    assert rate == pytest.approx(25 if way == "slower" else RATE, rel=0.01)
    assert any("time stamps" in n for n in found.notes) == (way != "jittered")  # by less than half a frame
    film(tmp_path / "truth.mp4", STEADY)
    with open_video(tmp_path / "truth.mp4") as reader:
        shades = [float(image.mean()) for image in reader]
    for view in found.views:
        with open_pictures(view) as reader:
            seen = np.array([float(image.mean()) for image in reader])[: len(found.frames)]
        off = RATE * np.abs(np.interp(seen, shades, STEADY) - np.arange(len(seen)) / rate)
        shown = np.delete(off, np.arange(29, 43)) if way == "a gap" else off
        assert shown.max() <= (2.1 if way == "lost" else 1.2) and np.median(off) <= 0.5, (way, shown.max())
        for part in np.array_split(off, 3):  # a lag at the beginning, in the middle, at the end
            assert np.median(part) <= 0.5


def test_steady_videos_are_read_frame_by_frame(tmp_path):
    found = recording(tmp_path, [STEADY, STEADY[:-3]])
    assert all(v.rate is None for v in found.views) and not any("time stamps" in n for n in found.notes)
    assert np.allclose(frame_times(found.views[0].files["video"]), STEADY, atol=1e-3)


def test_key_points_of_other_programs_are_numbered_by_the_stored_frames(tmp_path):
    for k in range(COUNT):
        point = [1.0 + 0.5 * k, 20.0, 0.9]
        people = [{"pose_keypoints_2d": point * 25}] if k < len(WAYS["lost"]) else []
        (tmp_path / "pose").mkdir(exist_ok=True)
        (tmp_path / "pose" / f"x_{k:04d}_keypoints.json").write_text(json.dumps({"people": people}))
    found = recording(tmp_path, [STEADY, WAYS["lost"]], 'keypoints = "pose"\n')
    steady, lost = (np.array([k.frame(n, (64, 48))[0, 0, 0] for n in range(80)]) for k in keypoints_of_recording(found))
    stored = np.searchsorted(WAYS["lost"], STEADY[:80] + 1e-6, side="right") - 1
    assert np.allclose(steady, 1 + 0.5 * np.arange(80)) and np.allclose(lost, 1 + 0.5 * stored)


def test_going_back_and_standing_still(tmp_path):
    film(tmp_path / "a.mp4", WAYS["lost"])
    with open_video(tmp_path / "a.mp4", rate=RATE) as reader:
        forwards = [reader.read().copy() for _ in range(reader.n_frames)]
    with open_video(tmp_path / "a.mp4", rate=RATE) as reader:
        for k in (50, 21, 20, 22, 21, 89, 0):
            assert np.array_equal(reader.read(k), forwards[k]), k
    assert np.array_equal(forwards[20], forwards[19]) and len(forwards) == COUNT
