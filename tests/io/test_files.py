"""Files that others may have made are opened within bounds; files are written under random names."""

import io
import os
import zipfile

import numpy as np
import pytest

from hypose.errors import InputError
from hypose.io import files
from hypose.io.files import atomic_path, check_writable, open_file, read_json, read_text, write_bytes
from hypose.io.keypoints.read_keypoints import read_keypoints
from hypose.io.motions.results import load_archive, write_archive
from hypose.io.recordings.recording import load_recording
from hypose.io.sensors.skeleton_files import read_skeletons
from hypose.io.videos.video import read_image
from hypose.pipeline.gesture_files import load_model

READERS = {
    "motion.npz": lambda path: load_archive(path, "motion", "give another"),
    "model.npz": load_model,
    "points.npy": read_keypoints,
    "points.json": read_keypoints,
    "points.csv": read_keypoints,
    "session.json": lambda path: read_skeletons(path.parent),
    "recording.toml": lambda path: load_recording(path.parent),
    "image.png": read_image,
    "any": lambda path: open_file(path, "a file", 1000),
}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("kind", ["fifo", "device", "sparse"])
def test_what_is_no_file_of_that_size_is_refused_at_once(tmp_path, name, kind):
    path = tmp_path / name
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        with path.open("wb") as stream:
            stream.truncate(5 << 40)
    with pytest.raises(InputError, match=r"\.$"):
        READERS[name](path)


def test_a_fifo_that_takes_the_place_of_a_file_is_not_waited_for(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "a.json")
    monkeypatch.setattr("pathlib.Path.is_file", lambda path: True)  # as it was a moment before
    with pytest.raises(InputError):
        read_json(tmp_path / "a.json", "a file")


def test_text_is_utf8_and_json_is_json(tmp_path):
    path = tmp_path / "a.json"
    path.write_bytes(b"\xef\xbb\xbf[1,\r\n2]")
    assert read_text(path, "a file") == "[1,\n2]" and read_json(path, "a list") == [1, 2]
    path.write_bytes(b"\xff[")
    for read in (read_text, read_json):
        with pytest.raises(InputError, match=r"a\.json is not (a text file|JSON).*a list.*\.$"):
            read(path, "a list")


@pytest.mark.parametrize(
    ("dtype", "shape"),
    [("<U0", (2_000_000_000,)), ("|S0", (3,)), ("<f8", (2_000_000_000, 0)), ("|u1", (0, 2_000_000_000, 3))],
)
def test_elements_count_as_well_as_bytes(tmp_path, dtype, shape):
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": dtype, "fortran_order": False, "shape": shape})
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", header.getvalue())
    with pytest.raises(InputError, match="a (holds|has shape) .*; give another"):
        load_archive(tmp_path / "a.npz", "motion", "give another")


def test_a_list_of_contents_is_bounded_before_it_is_read(tmp_path):
    write_archive(tmp_path / "a.npz", {"a": np.zeros(3)})
    data = (tmp_path / "a.npz").read_bytes()
    with (tmp_path / "a.npz").open("wb") as stream:
        stream.truncate(3 << 30)
        stream.seek(0, os.SEEK_END)
        stream.write(data[-22:-10] + (3 << 30).to_bytes(4, "little") + data[-6:])
    with pytest.raises(InputError, match="lists too much"):
        load_archive(tmp_path / "a.npz", "motion", "give another")


def test_a_temporary_name_is_new_each_time_and_follows_no_link(tmp_path, monkeypatch):
    names = []
    for _ in range(2):
        with atomic_path(tmp_path / "a.txt") as temporary:
            names.append(temporary.name)
            assert temporary.stat().st_size == 0
    assert len(set(names)) == 2 and str(os.getpid()) not in names[0].split(".")
    outside = tmp_path / "outside"
    outside.write_text("kept")
    monkeypatch.setattr(files.secrets, "token_hex", lambda n: "foreseen")
    (tmp_path / ".a.foreseen.tmp.txt").symlink_to(outside)
    (tmp_path / ".write-test-foreseen").symlink_to(outside)
    with pytest.raises(InputError, match="exists"):
        write_bytes(tmp_path / "a.txt", b"new")
    with pytest.raises(InputError, match="exists"):
        check_writable(tmp_path)
    assert outside.read_text() == "kept"


def test_a_link_is_replaced_and_what_it_leads_to_stays(tmp_path):
    (tmp_path / "outside").write_text("kept")
    (tmp_path / "a.txt").symlink_to(tmp_path / "outside")
    write_bytes(tmp_path / "a.txt", b"new")
    assert (tmp_path / "a.txt").read_bytes() == b"new" and (tmp_path / "outside").read_text() == "kept"


def test_file_and_folder_are_on_the_disk_before_it_is_said(tmp_path, monkeypatch):
    happened = []
    real_fsync, real_replace = os.fsync, os.replace
    inode = tmp_path.stat().st_ino

    def fsync(number):
        happened.append("folder" if os.fstat(number).st_ino == inode else os.fstat(number).st_size)
        real_fsync(number)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", lambda a, b: (happened.append("renamed"), real_replace(a, b)))
    write_bytes(tmp_path / "a", b"12345")
    assert happened == [5, "renamed", "folder"]
    write_bytes(tmp_path / "a", b"12345", synced=False)
    assert happened[3:] == ["renamed"]
