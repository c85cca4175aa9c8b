"""The detector's models: fetched once, checked, and found; with the real ones where they are."""

import hashlib
import json
import socket
import subprocess
import zipfile
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from benchmarks.multiview.detector_bench import bare
from benchmarks.multiview.real_recordings import balancing_recording
from hypose.app.__main__ import main
from hypose.app.cli import run_cli
from hypose.errors import InputError
from hypose.io.keypoints import detectors as pose_models
from hypose.io.keypoints.detectors import fetch_models, have_models, models_folder, open_network
from tests import missing
from tests.io.recordings import make_recording

CONTENT = {name: name.encode() for name in pose_models._MODELS}


@pytest.fixture
def package(monkeypatch, tmp_path):
    """A package with other models, which pip would download; returns the commands that were run."""
    ran = []
    known = {n: (folder, hashlib.sha256(CONTENT[n]).hexdigest()) for n, (folder, _) in pose_models._MODELS.items()}
    monkeypatch.setattr(pose_models, "_MODELS", known)
    monkeypatch.setenv(pose_models.MODELS_VARIABLE, str(tmp_path / "models"))

    def run(command, **more):
        ran.append(command)
        with zipfile.ZipFile(Path(command[command.index("--dest") + 1]) / "mediapipe.whl", "w") as wheel:
            for name, (folder, _) in known.items():
                wheel.writestr(f"{folder}/{name}", CONTENT[name])
        return SimpleNamespace(returncode=0, stdout="", stderr="")

    monkeypatch.setattr(subprocess, "run", run)
    return ran


def test_models_are_fetched_from_the_package(package, tmp_path):
    assert not have_models()
    assert fetch_models() == tmp_path / "models" == models_folder()
    assert have_models() and (tmp_path / "models" / "pose_detection.tflite").read_bytes() == b"pose_detection.tflite"
    (command,) = package
    assert command[-1] == pose_models.PACKAGE and "--no-deps" in command


def test_what_fails_is_one_sentence(package, monkeypatch, tmp_path):
    other = {n: (folder, "0" * 64) for n, (folder, _) in pose_models._MODELS.items()}
    with monkeypatch.context() as m:
        m.setattr(pose_models, "_MODELS", other)
        with pytest.raises(InputError, match="is damaged or another version"):
            fetch_models()
    assert not have_models()
    with monkeypatch.context() as m:
        failed = SimpleNamespace(returncode=1, stdout="", stderr="ERROR: no network\n")
        m.setattr(subprocess, "run", lambda command, **more: failed)
        with pytest.raises(InputError, match=r"cannot download mediapipe==.* \(ERROR: no network\).*HYPOSE_MODELS"):
            fetch_models()
    (tmp_path / "models").write_text("a file")
    with pytest.raises(InputError, match="cannot be written"):
        fetch_models()


@pytest.mark.parametrize(("command", "said"), [("keypoints", "Finding people"), ("track", "Tracking videos alone")])
def test_nothing_is_fetched_without_being_asked(command, said, tmp_path, monkeypatch, capsys):
    folder = make_recording(tmp_path / "rec")
    monkeypatch.setenv(pose_models.MODELS_VARIABLE, str(tmp_path / "models"))
    monkeypatch.setattr(subprocess, "run", lambda *a, **more: pytest.fail("something was run"))
    monkeypatch.setattr("hypose.app.jobs.person_job.runtime", lambda why: None)
    with pytest.raises(SystemExit) as caught:
        run_cli([command, str(folder)])
    reported = capsys.readouterr().err
    assert caught.value.code == 2 and said in reported and "again with --yes to agree" in reported
    assert not (tmp_path / "models").exists()


def test_without_the_runtime_the_command_that_installs_it_is_named(tmp_path, monkeypatch, capsys):
    folder = make_recording(tmp_path / "rec")
    monkeypatch.setitem(__import__("sys").modules, "ai_edge_litert.interpreter", None)
    with pytest.raises(SystemExit) as caught:
        run_cli(["track", str(folder)])
    reported = " ".join(capsys.readouterr().err.split())
    assert caught.value.code == 2 and 'run: pip install "hypose[detector]"' in reported


@pytest.fixture
def network():
    what = "the detector's networks"
    missing.module("ai_edge_litert.interpreter", what, "pip install ai-edge-litert")
    if not have_models():
        missing.skip(what, "fetch the models by hypose keypoints RECORDING --yes")
    return open_network()


def test_the_real_networks_find_nobody_in_grey(network, capfd, monkeypatch):
    monkeypatch.setattr(socket, "socket", lambda *a, **more: pytest.fail("the network was asked"))
    assert network.look(np.full((120, 160, 3), 128, np.uint8), 0) == []
    noise = np.random.default_rng(0).integers(0, 255, (240, 320, 3), dtype=np.uint8)
    assert network.look(cv2.blur(noise, (5, 5)), 0) == []
    assert capfd.readouterr().err == ""  # the runtime is quiet


@pytest.mark.slow
def test_four_videos_are_tracked_with_the_network_refused(network, shared_data, tmp_path, monkeypatch, capsys):
    folder = tmp_path / "rec"
    bare(balancing_recording(shared_data("pose2sim_balancing")), folder)
    for name in ("connect", "connect_ex"):
        monkeypatch.setattr(socket.socket, name, lambda *a: pytest.fail("the network was asked"))
    monkeypatch.setattr(socket, "getaddrinfo", lambda *a, **more: pytest.fail("the network was asked"))
    with pytest.raises(SystemExit) as stopped:
        main(["track", str(folder), "--frames", "0:8", "--formats", "trc", "--no-overlay", "--no-report"])
    told = capsys.readouterr()
    assert stopped.value.code in (0, None), told.err
    assert "the detector finds people" in told.err and "Verdict: Good" in told.out
    assert len(list(folder.glob("keypoints/*/masks/*.png"))) == 4 * 8
    (results,) = folder.glob("results/*")
    assert (results / "motion.trc").exists() and json.loads((results / "verdict.json").read_text())["verdict"] == "good"
