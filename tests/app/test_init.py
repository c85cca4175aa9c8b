"""`hypose init`: the recording.toml of a folder with videos."""

import shutil

import pytest

from hypose.io.recordings.recording import load_recording
from tests.app.conftest import fails


@pytest.fixture
def folder(tiny, tmp_path):
    """Videos as they are copied from cameras, without a recording.toml."""
    for place in ("videos", "background"):
        shutil.copytree(tiny / place, tmp_path / "session" / place)
    return tmp_path / "session"


def test_a_folder_of_videos_becomes_a_recording(hypose, tiny, folder):
    fails(hypose("track", folder), "holds videos", "hypose init")
    code, out, err = hypose("init", folder)
    assert code == 0 and "hypose calibrate" in out, err
    shutil.copy(tiny / "calibration.toml", folder)
    made, original = load_recording(folder), load_recording(tiny)
    assert [v.name for v in made.views] == [v.name for v in original.views]
    assert all(v.background is not None and v.background.parent.name == "background" for v in made.views)
    before = (folder / "recording.toml").read_bytes()
    fails(hypose("init", folder), "exists and stays as it is", "hypose check")
    assert (folder / "recording.toml").read_bytes() == before


def test_cameras_of_other_names_are_taken_in_their_order(hypose, tiny, folder):
    text = (tiny / "calibration.toml").read_text()
    (folder / "calibration.toml").write_text(text.replace("cam", "left-"))
    code, out, err = hypose("init", folder)
    assert code == 0 and "hypose check" in out and "camera left-1" in out, err
    assert load_recording(folder).rig.names == ("left-1", "left-2", "left-3", "left-4")


def test_folders_without_one_recording_are_refused(hypose, folder, tmp_path):
    fails(hypose("init", tmp_path / "nowhere"), "nowhere is no folder")
    fails(hypose("init", tmp_path), "holds no video")
    shutil.copytree(folder / "videos", folder / "run")
    fails(hypose("init", folder), "several places", "run, videos")
    assert not (folder / "recording.toml").exists()
