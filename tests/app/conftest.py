"""A tiny synthetic recording (4 cameras, 160x120, 8 frames) that the whole command line can be run on in seconds."""

import os
import shutil
import time

import pytest

from hypose.app.cli import run_cli
from hypose.app.commands import console
from hypose.synthetic.scenes import camera_rig, make_scene
from hypose.synthetic.write_recording import write_scene
from tests.conftest import HANG_S


def write_tiny(folder, seconds):
    cameras = camera_rig("humaneva-4", distorted=True).scaled(0.25)
    scene = make_scene("walk", "neutral", cameras, seconds=seconds, seed=3)
    write_scene(scene, folder, background_frames=10)
    return folder


@pytest.fixture(scope="session")
def tiny(tmp_path_factory):
    """The recording; read only."""
    return write_tiny(tmp_path_factory.mktemp("tiny") / "walk", 0.32)


@pytest.fixture
def recording(tiny, tmp_path):
    """A copy of the recording that a test may spoil."""
    return shutil.copytree(tiny, tmp_path / "walk")


@pytest.fixture
def hypose(capsys):
    """hypose(*arguments) -> (exit code, stdout, stderr) of the command line, run in this process."""

    def run(*arguments):
        with pytest.raises(SystemExit) as stopped:
            run_cli([str(a) for a in arguments])
        printed = capsys.readouterr()
        code = stopped.value.code
        return (0 if code is None else code), printed.out, printed.err

    return run


@pytest.fixture(scope="session")
def tracked(tiny, tmp_path_factory):
    """Results folder of `hypose track` on the tiny recording, made once by one of the processes that test."""
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent
    claimed, done, out = (shared / f"tracked-{n}" for n in ("claimed", "done", "results"))
    try:
        claimed.touch(exist_ok=False)
    except FileExistsError:
        end = time.monotonic() + HANG_S
        while not done.exists():
            assert time.monotonic() < end
            time.sleep(0.1)
        return out
    with pytest.raises(SystemExit) as stopped:
        run_cli(["track", str(tiny), "--out", str(out)])
    assert stopped.value.code in (None, 0)
    done.touch()
    return out


@pytest.fixture(scope="session")
def walk_by_points(tmp_path_factory):
    """A recording of 1.2 s with key points; read only."""
    cameras = camera_rig("humaneva-4", distorted=True).scaled(0.25)
    folder = tmp_path_factory.mktemp("points") / "points"
    write_scene(
        make_scene("walk", "neutral", cameras, seconds=1.2, seed=3), folder, background_frames=10, keypoints=True
    )
    return folder


@pytest.fixture
def keypoint_recording(walk_by_points, tmp_path):
    """A copy of it that a test may spoil."""
    return shutil.copytree(walk_by_points, tmp_path / "points")


@pytest.fixture
def interrupted(hypose, monkeypatch):
    """interrupted(stage, done, *arguments): the command with Ctrl-C when the progress of `stage` reaches `done`."""

    def run(stage, done, *arguments):
        shown = console.Stages.__call__

        def call(self, now, count, total):
            if (now, count) == (stage, done):
                raise KeyboardInterrupt
            shown(self, now, count, total)

        with monkeypatch.context() as patch:
            patch.setattr(console.Stages, "__call__", call)
            return hypose(*arguments)

    return run


def fails(result, *fragments):
    """The command failed with one sentence that contains the fragments; returns the sentence."""
    code, _, err = result
    assert code == 2 and "Traceback" not in err, err
    sentence = err[err.index("error: ") :].strip()
    assert "\n" not in sentence and all(fragment in sentence for fragment in fragments), sentence
    return sentence
