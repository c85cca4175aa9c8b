"""`hypose live`: what cannot be used is one sentence; a recording is followed, recorded, and solved again."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from benchmarks.robustness.small_recordings import small_scene
from hypose.io.calibrations.calibration_formats import write_calibration
from hypose.io.recordings.recording import load_recording
from hypose.synthetic.scenes import camera_rig, make_scene
from hypose.synthetic.write_recording import write_scene
from tests.app.conftest import fails
from tests.conftest import HANG_S, ROOT
from tests.live_scenes import in_step

TWO = ("--source", "cam1=0", "--source", "cam2=1")


@pytest.fixture
def calibration(tmp_path):
    write_calibration(small_scene(1, 2).rig, tmp_path / "calibration.toml")
    return tmp_path / "calibration.toml"


@pytest.mark.parametrize(
    ("arguments", "fragments"),
    [
        *((("--source", s), ("give CAMERA=WHERE, for example --source cam1=0",)) for s in ("cam1", "=0", "cam1=", "")),
        (("--source", "cam1=0", "--source", "cam1=1"), ("--source cam1=1 is not possible", "each once")),
        (("--source", "left=0"), ("There is no camera left", "cam1, cam2, cam3, cam4")),
        ((), ("Where are the cameras of", "--source cam1=0", "cam1, cam2, cam3, cam4")),
        (("--source", "cam1=0", "--ws", 0), ("needs two cameras or more", "--source: cam2")),
        *(((*TWO, "--ws", 0, o, "nowhere"), (f"{o} nowhere",)) for o in ("--udp", "--osc", "--vmc")),
    ],
)
def test_sources_and_targets_that_cannot_be(hypose, calibration, arguments, fragments):
    fails(hypose("live", calibration, *arguments), *fragments)


def test_two_cameras_in_one_place(hypose, calibration):
    fails(hypose("live", calibration, "--source", "cam1=0", "--source", "cam2=00"), "cam1 and cam2 are both at 00;")
    sources = [f"--source={name}=http://me:secret@10.0.0.1/video" for name in ("cam1", "cam2")]
    assert "secret" not in fails(hypose("live", calibration, *sources), "both at http://me:...@10.0.0.1/video;")


def test_without_its_extra_the_detector_says_what_installs_it(hypose, calibration, monkeypatch):
    monkeypatch.setitem(sys.modules, "ai_edge_litert.interpreter", None)
    code, _, err = hypose("live", calibration, *TWO, "--detector")
    assert code == 2 and 'pip install "hypose[detector]"' in " ".join(err.split())


def test_a_rig_that_is_not_there_or_none(hypose, tmp_path):
    fails(hypose("live", tmp_path / "nothing"), "does not exist; give a recording, or a calibration file")
    fails(hypose("live", tmp_path), "holds neither a recording nor a calibration")
    (tmp_path / "notes.txt").write_text("mine")
    fails(hypose("live", tmp_path / "notes.txt", "--source", "cam1=0"), "notes.txt")


def test_a_camera_that_is_not_there_is_named_and_no_folder_is_made_to_record_to(hypose, calibration, tmp_path):
    arguments = [calibration, "--ws", 0, "--record", tmp_path / "monday"]
    for name in ("cam1", "cam2"):
        arguments += ["--source", f"{name}={tmp_path / name}.mp4"]
    for _ in range(2):
        fails(hypose("live", *arguments), "There is no file", "cam1.mp4", "a camera is the number of a device")
        assert not (tmp_path / "monday").exists()


# ---- all of it, with files as cameras ----


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """24 s at 5 Hz: a film that is not over while a busy computer begins."""
    cameras = camera_rig("humaneva-4").scaled(0.25)
    scene = make_scene("walk", "neutral", cameras, seconds=24.0, frame_rate=5.0, seed=3, speed=0.3)
    return write_scene(scene, tmp_path_factory.mktemp("live") / "walk", background_frames=10)


def begun(*arguments):
    command = [sys.executable, "-m", "hypose.app", "live", *map(str, arguments)]
    return subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def test_a_recording_is_played_recorded_and_loaded(hypose, walk, tmp_path, monkeypatch):
    in_step(monkeypatch)
    code, out, err = hypose("live", walk, "--ws", 0, "--record", tmp_path / "monday")
    assert code == 0, err
    assert "Poses out:  ws://127.0.0.1:" in out and "Recorded as " in out and "Traceback" not in err
    rows = [json.loads(line) for line in (tmp_path / "monday" / "poses.jsonl").read_text().splitlines()]
    assert len(rows) > 60 and [r["n"] for r in rows] == list(range(len(rows)))
    assert all(len(r["people"]) == 1 for r in rows[20:])
    code, printed, err = hypose("silhouettes", tmp_path / "monday", "--out", tmp_path / "masks")
    assert code in (0, 1), err


@pytest.mark.skipif(sys.platform == "win32", reason="NOT tested: Ctrl-C in a console; run it on Linux")
def test_ctrl_c_in_a_terminal_ends_all_of_it_well_also_for_who_is_in_a_hurry(walk, tmp_path):
    rows = tmp_path / "monday" / "poses.jsonl"
    with begun(walk, "--ws", 0, "--record", tmp_path / "monday") as process:
        try:
            assert process.stdout is not None
            while process.stdout.readline().strip() != "Stop with Ctrl-C.":
                assert process.poll() is None
            while not rows.exists() or rows.read_text().count("\n") < 5:
                assert process.poll() is None
                time.sleep(0.05)
            for _ in range(2):
                os.killpg(process.pid, signal.SIGINT)  # as a terminal: to all its processes
                time.sleep(0.02)
            out, err = process.communicate(timeout=HANG_S)
        finally:
            process.kill()
    assert process.returncode == 0 and "error" not in err and "Traceback" not in err, err
    assert "poses. " in out and load_recording(tmp_path / "monday").n_frames >= 5
