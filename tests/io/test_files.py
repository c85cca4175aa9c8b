"""Files that others may have made are opened within bounds; files are written under random names."""

import io
import os
import string
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from hypose.errors import InputError, visible
from hypose.io import files
from hypose.io.files import (
    LOCK,
    atomic_path,
    check_writable,
    claimed,
    file_name,
    folder_for,
    open_file,
    read_json,
    read_text,
    utf8_path,
    write_bytes,
)
from hypose.io.keypoints.read_keypoints import read_keypoints
from hypose.io.motions.results import Archive, write_archive
from hypose.io.recordings.recording import load_recording
from hypose.io.sensors.skeleton_files import read_skeletons
from hypose.io.videos.video import read_image
from hypose.pipeline.gesture_files import load_model

READERS = {
    "motion.npz": Archive("motion", "give another").load,
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
        Archive("motion", "give another").load(tmp_path / "a.npz")


def test_a_list_of_contents_is_bounded_before_it_is_read(tmp_path):
    write_archive(tmp_path / "a.npz", {"a": np.zeros(3)})
    data = (tmp_path / "a.npz").read_bytes()
    with (tmp_path / "a.npz").open("wb") as stream:
        stream.truncate(3 << 30)
        stream.seek(0, os.SEEK_END)
        stream.write(data[-22:-10] + (3 << 30).to_bytes(4, "little") + data[-6:])
    with pytest.raises(InputError, match="lists too much"):
        Archive("motion", "give another").load(tmp_path / "a.npz")


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


# ---- test claims ---------------------------------------------------------------------------------------------------
# Two runs never write into one folder.


HOLD = "import sys; from hypose.io.files import claimed\nwith claimed(sys.argv[1]): print('held', flush=True); input()"


@pytest.fixture
def holder(tmp_path):
    """A process that holds tmp_path/out until its input ends."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, tmp_path / "out"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_the_second_run_ends_at_once_and_says_who_is_first(holder, tmp_path):
    sentence = rf"out is being written to by another run of hypose .process {holder.pid} on .*--to"
    with pytest.raises(InputError, match=sentence), claimed(tmp_path / "out", "--to"):
        raise AssertionError
    holder.communicate("\n")
    assert list((tmp_path / "out").iterdir()) == []
    with claimed(tmp_path / "out"):
        assert (tmp_path / "out" / LOCK).read_text().startswith(f"process {os.getpid()} on ")


def test_a_killed_run_holds_nothing(holder, tmp_path):
    holder.kill()
    holder.wait()
    assert (tmp_path / "out" / LOCK).exists()
    with claimed(tmp_path / "out"):
        pass
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="NOT tested: flock; run the tests on Linux")
def test_a_file_system_without_locks_costs_nothing(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr("fcntl.flock", refuse)
    with claimed(tmp_path), claimed(tmp_path):
        pass


@pytest.mark.skipif(sys.platform == "win32", reason="NOT tested: links; run the tests on Linux")
def test_a_link_in_the_place_of_the_lock_is_not_followed(tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / LOCK).symlink_to(victim)
    with claimed(tmp_path / "out"):
        pass
    assert victim.read_text() == "precious"


# ---- test file names -----------------------------------------------------------------------------------------------
# Files' names out of foreign text.


HOSTILE = (
    "", ".", "..", "../../x", "/etc/passwd", "C:\\x", "a/b", "a\\b", "-rf", "--flag", ".hidden", "~root", "a\nb",
    "a\0b", "\x1b[31m", "con", "COM1.txt", "lpt9", "a.", "a ", " a", "x" * 300, "ü" * 90, "a\udcff", "\u202egpj.exe",
    'a"b', "a|b",
)  # fmt: skip


@pytest.mark.parametrize("name", ["cam01", "Cam-01_left", "a b", "Küche", "相机", "cam.2", "x" * 100, "walk in step"])
def test_an_ordinary_name_stays_as_it_is(name):
    assert file_name(name) == name


@pytest.mark.parametrize("text", HOSTILE)
def test_any_text_gives_a_harmless_name(text, tmp_path):
    name = file_name(text)
    assert name == Path(name).name and name[0] not in ".-~ " and name[-1] not in ". " and len(name.encode()) <= 112
    assert not set(name) & set('/\\:*?"<>|') and visible(name) == name and "\n" not in name
    assert name.split(".")[0].lower() not in ("con", "com1", "lpt9")
    (tmp_path / name).mkdir()
    assert [p.name for p in tmp_path.iterdir()] == [name]
    assert file_name(text) == name  # and the next run finds it


def test_different_texts_give_different_names(rng):
    letters = [*string.ascii_lowercase[:3], "/", ".", "\\", "\n", "~", "é", "\udcff"]
    texts = {"".join(rng.choice(letters, rng.integers(0, 6))) for _ in range(3000)} | set(HOSTILE)
    texts |= {file_name(t) for t in texts}  # a name that another text gets is a text, too
    assert len({file_name(t) for t in texts}) == len(texts)


def test_a_folder_is_made_inside_and_a_link_out_is_refused(tmp_path):
    assert folder_for(tmp_path / "out", "../../x").parent == tmp_path / "out"
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out" / "cam1").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="cam1 is a link that leads out of"):
        folder_for(tmp_path / "out", "cam1")
    (tmp_path / "link").symlink_to(tmp_path / "out")  # the user's own choice
    assert folder_for(tmp_path / "link", "cam2").is_dir()
    (tmp_path / "out" / "cam3").write_text("in the way")
    with pytest.raises(InputError, match="cam3 cannot be made"):
        folder_for(tmp_path / "out", "cam3")


@pytest.mark.skipif(os.name == "nt", reason="NOT tested: names that are no UTF-8; run the tests on Linux")
def test_a_path_that_is_no_utf8_is_reached_by_a_link(tmp_path, monkeypatch):
    plain, strange = tmp_path / "a.mp4", tmp_path / os.fsdecode(b"b\xff.mp4")
    with utf8_path(plain) as name:
        assert name == str(plain)
    strange.write_bytes(np.arange(5, dtype=np.uint8).tobytes())
    with utf8_path(strange) as name:
        assert name.endswith(".mp4") and name.isascii() and Path(name).read_bytes() == strange.read_bytes()
    assert not os.path.lexists(name)

    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(os, "symlink", refuse)
    with pytest.raises(InputError, match=r"b\\xff\.mp4 is not UTF-8; rename"), utf8_path(strange):
        pass
