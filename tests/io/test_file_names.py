"""Files' names out of foreign text."""

import os
import string
from pathlib import Path

import numpy as np
import pytest

from hypose.errors import InputError, visible
from hypose.io.file_names import file_name, folder_for, utf8_path

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
