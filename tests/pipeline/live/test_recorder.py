"""What was seen live is a recording like any other."""

import json
from dataclasses import replace
from pathlib import Path
from time import sleep

import pytest

from hypose.errors import InputError
from hypose.evidence.silhouettes import SilhouetteSettings
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import load_recording
from hypose.io.videos.video import open_video
from hypose.pipeline.live import recorder as recorder_module
from hypose.pipeline.live.capture import LiveView
from hypose.pipeline.live.recorder import LiveRecorder
from hypose.pipeline.settings import SETTINGS
from tests.conftest import HANG_S
from tests.live_scenes import follow, people_for, seen


@pytest.fixture(scope="module")
def poses(frames):
    from tests.live_scenes import Beside

    executor = Beside()
    return follow(people_for(frames, executor), frames[:30], executor)


def recorder(folder, walk, **of_views):
    views = [LiveView(name, "", **of_views) for name in walk.given_rig.names]
    return LiveRecorder(folder, walk.given_rig, views, SilhouetteSettings(), 1.8)


def masks_of(recording):
    return [f.silhouettes for f in FrameStream(recording)]


def test_what_is_recorded_is_loaded_with_the_masks_that_were_seen(tmp_path, walk, frames, poses):
    made = recorder(tmp_path / "live", walk)
    by_frame = {p.frame: p for p in poses}
    sent = [seen(frame, by_frame.get(frame.index)) for frame in frames[:20]]
    for one in sent:
        made.seen(one)
    assert made.close() and made.written == 20 and made.left_out == 0
    recording = load_recording(tmp_path / "live")
    assert recording.n_frames == 20 and recording.frame_rate == pytest.approx(25.0)
    assert recording.rig.names == walk.given_rig.names and recording.subject_height == 1.8
    for kept, frame in zip(masks_of(recording), frames, strict=False):
        assert (kept.masks == frame.silhouettes.masks).all() and kept.usable.all()
    written = [p.read_bytes() for p in sorted(recording.views[1].source.glob("*.jpg"))]
    assert written == [one.captured.jpegs[1] for one in sent]  # byte for byte what the camera sent
    rows = [json.loads(line) for line in (tmp_path / "live" / "poses.jsonl").read_text().splitlines()]
    assert [r["n"] for r in rows] == list(range(20))
    assert [r["time"] for r in rows] == pytest.approx([f.time for f in frames[:20]])
    reported = [{"n": r["n"], **p} for r in rows for p in r["people"]]
    assert [p["id"] for p in reported] == [1] * len(reported)
    assert len(reported) == sum(n < 20 for n in by_frame) > 0
    for row in reported:
        assert row["joints"] == pytest.approx(by_frame[row["n"]].joints, abs=1e-5) and row["lost"] is False


def test_who_is_killed_has_recorded_too(tmp_path, walk, frames, monkeypatch):
    monkeypatch.setattr(recorder_module, "SETTINGS", replace(SETTINGS, recorder_describe_s=0.0))
    made = recorder(tmp_path / "live", walk)
    for frame in frames[:8]:
        made.seen(seen(frame, None))
    while made.written < 8:
        sleep(0.01)
    assert load_recording(tmp_path / "live").n_frames >= 7  # and nothing was closed
    made.close()


def test_a_missing_camera_repeats_its_picture_and_has_an_empty_mask(tmp_path, walk, frames):
    made = recorder(tmp_path / "live", walk)
    for k, frame in enumerate(frames[:6]):
        made.seen(seen(frame, None, missing=(2,) if k in (0, 3, 4) else (), grey=20 * k + 20))
    assert made.close()
    recording = load_recording(tmp_path / "live")
    usable = [m.usable.tolist() for m in masks_of(recording)]
    assert usable == [[True, True, k not in (0, 3, 4), True] for k in range(6)]
    with open_video(recording.views[2].source) as reader:
        greys = [round(float(p.mean())) for p in reader]
    assert greys == pytest.approx([0, 40, 60, 60, 60, 120], abs=1)  # black, as long as there was none


def test_a_damaged_picture_is_not_recorded(tmp_path, walk, frames):
    made = recorder(tmp_path / "live", walk)
    for k, frame in enumerate(frames[:4]):
        one = seen(frame, None)
        if k == 2:  # it came, and could not be decoded
            captured = replace(
                one.captured,
                views=(None, *one.captured.views[1:]),
                jpegs=(b"\xff\xd8 damaged", *one.captured.jpegs[1:]),
            )
            one = replace(one, captured=captured)
        made.seen(one)
    assert made.close()
    with open_video(load_recording(tmp_path / "live").views[0].source) as reader:
        assert [round(float(p.mean())) for p in reader] == [90] * 4


def test_a_folder_that_holds_something_is_refused(tmp_path, walk):
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="old is not empty; give a new folder"):
        recorder(tmp_path / "old", walk)
    with pytest.raises(InputError, match=r"notes\.txt is a file"):
        recorder(tmp_path / "old" / "notes.txt", walk)
    with pytest.raises(InputError, match="live cannot be written .not a directory.; choose another folder"):
        recorder(tmp_path / "old" / "notes.txt" / "live", walk)
    assert [p.name for p in (tmp_path / "old").iterdir()] == ["notes.txt"]


def test_what_was_written_before_the_disk_was_full_is_a_recording(tmp_path, walk, frames, poses, monkeypatch):
    """The disk is full in the middle of an instant, of which nothing is left."""
    made, write, place = recorder(tmp_path / "live", walk), Path.write_bytes, walk.given_rig.names[2]

    def until_full(path, data):
        if path.stem == "000005" and path.parent.name == place:
            raise OSError(28, "No space left on device")
        return write(path, data)

    monkeypatch.setattr(Path, "write_bytes", until_full)
    for frame in frames[:8]:
        made.seen(seen(frame, poses[-1]))
    with pytest.raises(InputError, match="No space left on device.; the recording ends there; the 5 instants before"):
        made.close()
    assert "the recording ends there" in made.failed
    assert load_recording(tmp_path / "live").n_frames == 5
    assert [len(list(p.glob("*.*g"))) for p in sorted((tmp_path / "live").glob("*/*"))] == [5] * 8
    rows = (tmp_path / "live" / "poses.jsonl").read_text().splitlines()
    assert [json.loads(row)["n"] for row in rows] == list(range(5))


def test_a_disk_that_is_too_slow_costs_instants_and_nobody_waits(tmp_path, walk, frames, monkeypatch):
    from threading import Event

    made, go, write = recorder(tmp_path / "live", walk), Event(), LiveRecorder._write

    def slow(seen, poses):
        go.wait(HANG_S)
        write(made, seen, poses)

    monkeypatch.setattr(made, "_write", slow)
    one = seen(frames[0], None)
    for k in range(120):
        made.seen(replace(one, frame=replace(frames[0], time=k / 25)))
    go.set()
    assert made.close() and made.left_out in (29, 30) and made.written + made.left_out == 120
