import os
from typing import get_args

import pytest

from hypose.app.studio.catalog import Catalog, Kind, NotFound
from hypose.app.studio.gesture_session import models_shown, sources_shown


def make(root):
    (root / "a" / "results" / "default").mkdir(parents=True)
    (root / "a" / "recording.toml").write_text("")
    (root / "a" / "results" / "default" / "motion.npz").write_bytes(b"")
    (root / "gestures" / "tee").mkdir(parents=True)
    for name in ("session.json", "frames.csv"):
        (root / "gestures" / "tee" / name).write_text("")
    return Catalog(root)


def test_kinds_are_told_apart_and_ids_say_nothing(tmp_path):
    catalog = make(tmp_path)
    found = {kind: catalog.items(kind) for kind in ("recording", "result", "session", "model")}
    assert {k: [catalog.shown(i.path) for i in v] for k, v in found.items()} == {
        "recording": ["a"],
        "result": ["a/results/default"],
        "session": ["gestures/tee"],
        "model": [],
    }
    result = found["result"][0]
    assert len(result.id) == 12 and catalog.find("result", result.id) == result
    assert catalog.recording_of(result.path) == (tmp_path / "a").resolve()
    assert Catalog(tmp_path).id_of("result", result.path) == result.id  # an address stays good over a restart
    with pytest.raises(NotFound):
        catalog.find("recording", result.id)


def test_a_recording_is_found_whatever_it_is_called(tmp_path):
    """Folders of frames are passed over by their names, recordings are not."""
    catalog = make(tmp_path)
    for name in ("depth", "videos"):
        (tmp_path / name / "images" / "cam1").mkdir(parents=True)
        (tmp_path / name / "recording.toml").write_text("")
    assert {catalog.shown(i.path) for i in catalog.items("recording")} == {"a", "depth", "videos"}


def test_links_hidden_folders_and_depths_are_not_followed(tmp_path):
    outside, root = tmp_path / "outside", tmp_path / "root"
    make(outside)
    root.mkdir()
    os.symlink(outside, root / "link")
    os.symlink(root, root / "circle")
    make(root / ".hidden")
    deep = root.joinpath(*"abcdefgh")
    make(deep)
    assert Catalog(root).items("recording") == []


def test_a_folder_swapped_for_a_link_has_no_id_any_more(tmp_path):
    root = tmp_path / "root"
    catalog = make(root)
    (item,) = catalog.items("recording")
    (root / "a").rename(tmp_path / "a")
    os.symlink(tmp_path / "a", root / "a")
    with pytest.raises(NotFound):
        catalog.find("recording", item.id)


def test_what_is_no_file_or_leads_out_is_not_listed_and_holds_nothing_up(tmp_path):
    """FIFOs, devices, links out of the folder and files that say they are huge, under the names of hypose's files."""
    root, outside = tmp_path / "root", tmp_path / "outside"
    for k, name in enumerate(("motion.npz", "session.json", "frames.csv", "model.npz", "recording.toml")):
        for kind in ("fifo", "device", "link", "sparse"):
            place = root / f"{kind}{k}"
            place.mkdir(parents=True)
            if name == "frames.csv":
                (place / "session.json").write_text("{}")
            if kind == "fifo":
                os.mkfifo(place / name)
            elif kind == "sparse":
                with (place / name).open("wb") as stream:
                    stream.truncate(5 << 40)
            else:
                outside.mkdir(exist_ok=True)
                (outside / name).write_text("secret")
                (place / name).symlink_to("/dev/zero" if kind == "device" else outside / name)
    catalog = Catalog(root)
    found = {kind: [catalog.shown(i.path) for i in catalog.items(kind)] for kind in get_args(Kind)}
    assert all(path.startswith("sparse") for paths in found.values() for path in paths)
    assert models_shown(catalog) == []
    assert [s["gestures"] for s in sources_shown(catalog) if s["value"].startswith("session:")] == [[]]
