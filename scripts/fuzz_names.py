"""Names and caches as targets of the fuzzer.

Views, cameras, sensors, gestures, recordings and folders are called anything; what is written because of such a name
must lie in its folder, and be found again under it. Files of the cache are spoilt; what they hold is compiled again or
is what was put in.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.robustness.small_recordings import small_scene, write_gesture_session, write_masks, write_skeletons
from hypose.compute.compiled import VARIABLE, KernelCache, cache_folder, kernel
from hypose.io.files import file_name, folder_for, text_of

_NAMES = ("cam 1", "Mädchen 走る", "../../x", "a\nb", "-rf", "C:\\con", "\x1b]0;t\x07", "n" * 120, 'it\'s "so" $(y)')
FOLDER = "names"


def write_good(folder: Path) -> None:
    """The good inputs: names, one per line, of which the first is used; what is called so; a file of the cache."""
    place = folder / FOLDER
    place.mkdir()
    for target in ("file", "view", "sensor", "gesture", "recording", "cache-folder"):
        (place / f"{target}.txt").write_text("\n".join(_NAMES), encoding="utf-8")
    write_masks(small_scene(1, 1), place / "walk")
    write_skeletons(place / "sensors", seconds=0.2)
    write_gesture_session(place / "session", "NAME")
    for path in place.glob("walk/*.toml"):
        path.write_text(re.sub(r'^(name|camera) = "cam2"', r'\1 = "NAME"', path.read_text(), flags=re.MULTILINE))
    for path in (place / "sensors").iterdir():
        path.write_text(path.read_text().replace("sensor1", "NAME"))
    compiled = kernel(total.py_func)
    compiled._cache = _cache_of(place / "total.kernel")
    compiled(np.zeros(3))


@kernel
def total(numbers):  # noqa: ANN001, ANN201, D103 (a kernel as those of compute)
    out = 0.0
    for x in numbers:
        out += x
    return out


def _cache_of(path: Path) -> KernelCache:
    """A kernel's cache whose only file is this one."""
    cache = KernelCache(total.py_func)
    cache._path = lambda sig: path  # type: ignore[method-assign]
    return cache


def read_kernel(path: Path) -> None:
    """Load the kernel of a file that may be spoilt: it adds, or it is not taken."""
    total(np.zeros(3))
    signature = total.signatures[0]
    found = _cache_of(path).load_overload(signature, total.targetctx)
    if found is not None:
        assert found.entry_point is not None and found.signature.args == signature


def _work(folder: Path) -> Path:
    """A folder to write to, empty."""
    work = folder / "work"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir()
    return work


def _texts(folder: Path, target: str) -> list[str]:
    return os.fsdecode((folder / f"{target}.txt").read_bytes()[:4000]).split("\n")


def _inside(read: Callable[[Path], None]) -> Callable[[Path], None]:
    """The reader, and then a look whether anything but `work` has changed beside and above its folder."""

    def reading(folder: Path) -> None:
        before = _listing(folder)
        try:
            read(folder)
        finally:
            shutil.rmtree(folder / "work", ignore_errors=True)
            assert (new := _listing(folder) - before) == set(), f"written outside: {sorted(new)[:3]}"

    return reading


def _listing(folder: Path) -> set[bytes]:
    top = os.fsencode(folder)
    above = {os.path.join(place, n) for place in (top, os.path.dirname(top)) for n in os.listdir(place)}
    below = {os.path.join(place, n) for place, _, names in os.walk(top) for n in names}
    return {p for p in above | below if not p.startswith(os.path.join(top, b"work"))}


def read_file_names(folder: Path) -> None:
    """Different texts give different files, each in the folder, on every system."""
    texts, work = _texts(folder, "file"), _work(folder)
    for text in set(texts):
        name = file_name(text)
        assert name == file_name(text) and len(name.encode()) <= 112 and name == Path(name).name, name
        (folder_for(work, text) / "file").touch()
        json.dumps(text_of(text)).encode("utf-8")
    assert len(os.listdir(work)) == len(set(texts)), "two texts have one name"


def _renamed(folder: Path, what: str, text: str) -> Path:
    """A copy of a recording in which a part has a name."""
    copy = Path(shutil.copytree(folder / what, _work(folder) / what))
    for path in (*copy.glob("*.toml"), *copy.glob("*.json"), *copy.glob("*.csv")):
        put = json.dumps(text) if path.suffix != ".csv" else text
        old = '"NAME"' if path.suffix != ".csv" else "NAME"
        data = path.read_text(encoding="utf-8").replace(old, put)
        path.write_text(data, encoding="utf-8", errors="surrogateescape", newline="")
    return copy


def read_view(folder: Path) -> None:
    """A view and its camera have the name; the recording is read, written again, and its masks have their folders."""
    from hypose.io.recordings.recording import load_recording, write_recording

    copy = _renamed(folder, "walk", _texts(folder, "view")[0])
    recording = load_recording(copy)
    for view in recording.views:
        folder_for(folder / "work" / "masks", view.name)
    write_recording(recording, folder / "work" / "again")
    assert load_recording(folder / "work" / "again").rig.names == recording.rig.names


def read_sensor(folder: Path) -> None:
    """A sensor has the name; its skeletons are read, written again and read again."""
    from benchmarks.synthetic.skeleton_folders import write_folder
    from hypose.io.sensors.skeleton_files import read_skeletons

    skeletons = read_skeletons(_renamed(folder, "sensors", _texts(folder, "sensor")[0]))
    write_folder(skeletons, folder / "work" / "again")
    names = [s.name for s in skeletons.streams]
    assert [s.name for s in read_skeletons(folder / "work" / "again").streams] == names


def read_gesture(folder: Path) -> None:
    """A gesture has the name; its session is read, and recorded again."""
    from hypose.pipeline.gesture_files import SessionWriter, read_recording

    session = read_recording(_renamed(folder, "session", _texts(folder, "gesture")[0]))
    names = list(session.gestures)
    writer = SessionWriter(folder / "work" / "again", names, session.lens, (32, 24))
    writer.add(0.0, np.full((24, 32), 900, np.uint16), "positive", 0, 1, (16.0, 12.0))
    writer.close()
    assert list(read_recording(folder / "work" / "again").gestures) == names


def read_recording_folder(folder: Path) -> None:
    """A recording lies in a folder of the name, and a picture in it has the name; both are read."""
    from hypose.io.recordings.recording import load_recording
    from hypose.io.videos.video import read_image

    name = _texts(folder, "recording")[0].replace("/", "_").replace("\0", "_")
    place = _work(folder) / f"x{name}"
    picture = place / f"y{name}.png"
    try:
        shutil.copytree(folder / "walk", place)
        shutil.copy(folder / "walk" / "cam1" / "00000.png", picture)
    except OSError:  # a name that no file can have
        return
    assert read_image(picture).size
    load_recording(place)


def read_cache_folder(folder: Path) -> None:
    """The variable that names the cache holds anything: some folder is chosen, or none, and nothing is raised."""
    text = _texts(folder, "cache-folder")[0].replace("\0", "").lstrip("/")
    place = os.path.normpath(os.path.join(_work(folder), text))
    if not place.startswith(os.path.join(str(folder), "work")):
        return
    kept = os.environ.get(VARIABLE)
    try:
        os.environ[VARIABLE] = place
        cache_folder.cache_clear()
        chosen = cache_folder()
        assert chosen is None or chosen.is_dir()
    finally:
        os.environ.pop(VARIABLE)
        if kept is not None:
            os.environ[VARIABLE] = kept
        cache_folder.cache_clear()


ALLOWED = ("wrote", "pickle.find_class", "shutil.rmtree", "ctypes.dlopen")
"""What these may do that readers may not; where they write is looked at by themselves."""

READS: dict[str, tuple[str, str, Callable[[Path], Any]]] = {
    **{
        f"name-{target}": (f"{FOLDER}/{target}.txt", FOLDER, _inside(read))
        for target, read in (
            ("file", read_file_names),
            ("view", read_view),
            ("sensor", read_sensor),
            ("gesture", read_gesture),
            ("recording", read_recording_folder),
            ("cache-folder", read_cache_folder),
        )
    },
    "cache-kernel": (f"{FOLDER}/total.kernel", f"{FOLDER}/total.kernel", read_kernel),
}
"""target: the file that is spoilt, what the reader gets, the reader."""
