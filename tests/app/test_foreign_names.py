"""Names of views, cameras and files from elsewhere: nothing is written outside, nothing crashes, no terminal obeys."""

import errno
import json
import os
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest

from benchmarks.robustness.small_recordings import small_scene, write_masks
from hypose.app.commands import console
from hypose.app.studio.catalog import Catalog
from hypose.app.studio.job_kinds import plan_job
from hypose.app.studio.recordings import Recordings
from hypose.app.studio.view_bundle import json_values
from hypose.errors import InputError
from hypose.io.files import claimed
from hypose.io.keypoints.detectors import OwnDetector
from hypose.io.recordings.recording import load_recording
from hypose.pipeline.detect_keypoints import detect_keypoints
from tests.app.conftest import fails

STRANGE = os.fsdecode(b"b\xff\x1b[31m")
on_linux = pytest.mark.skipif(sys.platform != "linux", reason="NOT tested: names that are no UTF-8; run it on Linux")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return write_masks(small_scene(1, 6), tmp_path_factory.mktemp("names") / "walk")


@pytest.fixture
def masks(made, tmp_path):
    """Six frames of masks in tmp_path/a/b/walk, with names of views that a test may change."""
    return shutil.copytree(made, tmp_path / "a" / "b" / "walk")


def rename_views(recording, names):
    """Give the views other names, written as TOML."""
    toml = recording / "recording.toml"
    text = toml.read_text(encoding="utf-8")
    for k, name in enumerate(names, 1):
        text = re.sub(rf'(\[\[view\]\]\nname = )"cam{k}"', lambda m, n=name: m[1] + json.dumps(n), text)
    toml.write_text(text, encoding="utf-8")


def hostile(recording, tmp_path):
    """Make names of views lead out of every folder; the result gives the files that were written since then."""
    rename_views(recording, ["../../../../up", str(tmp_path / "absolute"), "x\x1b]0;t\x07", "cam4"])
    before = everything(tmp_path)
    return lambda: everything(tmp_path) - before


def everything(folder):
    return {p for p in folder.rglob("*") if not p.is_dir()}


@pytest.mark.parametrize("command", [("silhouettes",), ("sync", "--offsets", "0,0,1,0")])
def test_masks_stay_in_the_folder(hypose, masks, tmp_path, command):
    written = hostile(masks, tmp_path)
    code, out, err = hypose(command[0], masks, *command[1:], "--out", tmp_path / "out" / "deep")
    assert code == 0 and "\x1b" not in out + err
    assert written() and all(p.is_relative_to(tmp_path / "out" / "deep") for p in written())
    if command[0] == "sync":  # a recording, whose views have their names and find their masks
        again = load_recording(tmp_path / "out" / "deep")
        assert [v.name for v in again.views] == [v.name for v in load_recording(masks).views]


def test_detected_key_points_stay_in_the_folder_and_are_found_again(tiny, tmp_path):
    recording = shutil.copytree(tiny, tmp_path / "a" / "b" / "walk")
    written = hostile(recording, tmp_path)

    class Detector:
        def detect(self, image):
            return np.ones((1, 25, 3))

    detector = OwnDetector(Detector(), "BODY_25", {"model": "a"}, "here")
    detect_keypoints(load_recording(recording), detector, recording / "keypoints")
    assert written() and all(p.is_relative_to(recording / "keypoints") for p in written())
    assert all("keypoints" in v.files for v in load_recording(recording).views)


def test_the_studio_begins_no_job_that_writes_outside(masks, tmp_path):
    catalog = Catalog(tmp_path / "a")
    id = catalog.items("recording")[0].id
    assert plan_job("silhouettes", {"recording": id}, catalog).arguments[0] == "silhouettes"
    (tmp_path / "outside").mkdir()
    (masks / "results").symlink_to(tmp_path / "outside")
    for kind in ("silhouettes", "check", "track"):
        with pytest.raises(InputError, match="outside the served folder"):
            plan_job(kind, {"recording": id}, catalog)


@on_linux
def test_the_studio_lists_what_is_no_utf8(masks, tmp_path):
    shutil.copytree(masks, tmp_path / "a" / STRANGE)
    catalog = Catalog(tmp_path / "a")
    items = catalog.items("recording")
    shown = [json_values(Recordings(catalog).shown(i, [])) for i in items]
    assert sorted(s["path"] for s in shown) == ["b/walk", "b\\xff\\x1b[31m"]
    assert json.dumps(shown, ensure_ascii=False).encode()


@on_linux
@pytest.mark.parametrize("name", ["Küche".encode(), b"K\xff"])
def test_a_locale_that_knows_ascii_only(masks, tmp_path, name):
    folder = tmp_path / os.fsdecode(name)
    shutil.copytree(masks, folder)
    rename_views(folder, ["Küche"])
    (folder / "cam1").rename(folder / "Küche")
    toml = folder / "recording.toml"
    toml.write_text(toml.read_text(encoding="utf-8").replace('masks = "cam1"', 'masks = "Küche"'), encoding="utf-8")
    command = [sys.executable, "-m", "hypose.app", "silhouettes", folder, "--out", tmp_path / "Maße"]
    environment = {**os.environ, "LC_ALL": "C"}
    done = subprocess.run(command, env=environment, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "Maße" / "Küche").glob("*.png"))) == 6


def test_no_name_steers_the_terminal(hypose, tmp_path, capsys):
    text = "a\x1b[2J\x1b]0;x\x07\x9b31m\r\u202eb\udcff"
    console.say(text)
    console.print_note(text)
    console.error(text)
    code, _, err = hypose("track", tmp_path / text)
    printed = "".join(capsys.readouterr()) + err
    assert code == 2 and not set(printed) & set("\x1b\x07\x9b\r\u202e\udcff") and "a\\x1b[2J" in printed


@pytest.mark.parametrize("command", ["silhouettes", "subject", "track", "export", "check"])
def test_a_folder_that_cannot_be_written_is_told_before_the_work(
    hypose, masks, tracked, tmp_path, command, monkeypatch
):
    (tmp_path / "file").write_text("in the way")
    out = tmp_path / "file" / ("x.png" if command == "check" else "x")
    monkeypatch.setattr("hypose.io.recordings.frames.FrameStream.__init__", lambda *_: pytest.fail("work was begun"))
    refused = hypose(command, tracked if command == "export" else masks, "--out", out)
    fails(refused, "cannot be written", "with --out.")


@pytest.mark.parametrize("command", ["silhouettes", "subject", "track", "sync"])
def test_two_runs_into_one_folder(hypose, masks, tmp_path, command):
    more = ("--offsets", "0,0,0,0") if command == "sync" else ()
    with claimed(tmp_path / "out"):
        refused = hypose(command, masks, *more, "--out", tmp_path / "out")
    fails(refused, "is being written to by another run of hypose")


@pytest.mark.parametrize("number", [errno.EROFS, errno.EACCES, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO])
def test_whatever_the_system_refuses_is_one_sentence(hypose, masks, tmp_path, monkeypatch, number):
    def refuse(*_, **__):
        raise OSError(number, os.strerror(number), str(tmp_path / "some.file"))

    monkeypatch.setattr("hypose.io.recordings.recording.load_recording", refuse)
    assert "should not have happened" not in fails(hypose("silhouettes", masks), "some.file")


@on_linux
def test_output_to_a_full_disk_is_one_sentence():
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "hypose", "--version"]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("error: The output cannot be written (no space left on device)")
    assert "Exception" not in done.stderr
