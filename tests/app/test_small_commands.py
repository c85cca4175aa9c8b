"""`hypose init`, `warm-up` and `cite`."""

import shutil

import pytest

from hypose.app.commands.commands_results import papers_of
from hypose.compute import compiled, warming
from hypose.compute.warming import TRACKING_KERNELS, kept, warm_up
from hypose.errors import InputError
from hypose.fusion.fuse import FUSION_METHODS
from hypose.io.recordings.recording import load_recording
from hypose.tracking.recipes import RECIPES
from tests.app.conftest import fails

# ---- init


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
    assert all(v.files["background"].parent.name == "background" for v in made.views)
    before = (folder / "recording.toml").read_bytes()
    fails(hypose("init", folder), "exists and stays as it is", "hypose check")
    assert (folder / "recording.toml").read_bytes() == before


def test_cameras_of_other_names_are_taken_in_their_order(hypose, tiny, folder):
    text = (tiny / "calibration.toml").read_text()
    (folder / "calibration").mkdir()
    (folder / "calibration" / "Calib_of_the_room.toml").write_text(text.replace("cam", "left-"))
    code, out, err = hypose("init", folder)
    assert code == 0 and "hypose check" in out, err
    assert load_recording(folder).rig.names == ("left-1", "left-2", "left-3", "left-4")


def test_folders_without_one_recording_are_refused(hypose, folder, tmp_path):
    fails(hypose("init", tmp_path / "nowhere"), "nowhere is no folder")
    fails(hypose("init", tmp_path), "holds no video")
    shutil.copytree(folder / "videos", folder / "run")
    fails(hypose("init", folder), "several places", "run, videos")
    assert not (folder / "recording.toml").exists()


# ---- warm-up


@pytest.mark.slow
def test_nothing_is_left_to_compile_after_it(hypose, monkeypatch):
    had = kept(*TRACKING_KERNELS, "monocular", "depth")
    code, out, _ = hypose("warm-up")
    assert code == 0 and out.startswith("All of it had been compiled." if had else "Compiled; kept in ")
    began = []
    monkeypatch.setattr(warming, "_run", lambda parts: began.extend(parts))
    warm_up(load=False)
    assert not began
    assert hypose("warm-up")[1].startswith("All of it had been compiled.")


def test_without_a_place_one_sentence(hypose, monkeypatch):
    monkeypatch.setattr(compiled, "cache_folder", lambda: None)
    code, _, err = hypose("warm-up")
    assert code == 2 and "name a folder with HYPOSE_CACHE_DIR." in " ".join(err.split())


def test_what_cannot_be_kept_is_not_called_kept(hypose, monkeypatch):
    monkeypatch.setattr(warming, "warm_up", lambda *_, **__: 0.0)
    monkeypatch.setattr(warming, "kept", lambda *_: False)
    monkeypatch.setattr("hypose.app.jobs.job.run_job", lambda *_: None)
    code, out, err = hypose("warm-up")
    assert code == 2 and "could not all be kept in" in " ".join(err.split()) and "Compiled" not in out


# ---- cite


def test_every_recipe_and_fusion_has_its_papers():
    for name in (*RECIPES, *(f"fusion-{m}" for m in FUSION_METHODS)):
        assert papers_of(name)[0] == "hypose"
    assert papers_of("hpf")[1:] == ("alcoverro2014",)


def test_bibtex(hypose):
    code, out, _ = hypose("cite", "gesture", "--bibtex")
    assert code == 0
    assert out.count("@") == 3 and out.count("{") == out.count("}")
    assert "@phdthesis{alcoverro2014," in out and "year = {2009}" in out


def test_what_is_no_method(tmp_path):
    (tmp_path / "provenance.json").write_text("{}")
    with pytest.raises(InputError, match="tells no method"):
        papers_of(str(tmp_path))
