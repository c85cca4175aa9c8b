"""Twelve environments times three commands: one sentence and code 2, or success; never a traceback, never another
code, never a file outside the folder that was asked for."""

import json
import os
import re
import shutil
import stat

import pytest

from benchmarks.robustness.circumstances import Circumstances, possible
from benchmarks.robustness.fork_server import ForkServer
from benchmarks.robustness.programs import Program, run
from benchmarks.robustness.small_recordings import small_scene, write_masks, write_skeletons
from hypose.body.default_body import human
from hypose.compute.compiled import cache_folder
from hypose.compute.warming import warm_up
from hypose.io.motions.results import save_body
from tests import missing
from tests.conftest import HANG_S

LIGHT = ("--no-overlay", "--no-smooth", "--formats", "trc", "--subject")
UNSET = ("HOME", "TMPDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "LANG", "LC_ALL", "LC_CTYPE", "PYTHONIOENCODING")
COMMANDS = {
    "track": (lambda inputs: ("track", inputs / "walk", *LIGHT, inputs / "anna"), "motion.npz"),
    "fuse": (lambda inputs: ("fuse", inputs / "sensors", "--formats", "trc"), "motion.trc"),
    "export": (lambda inputs: ("export", inputs / "done", "--formats", "trc,bvh"), "motion.bvh"),
}


class Box:
    """One folder with everything that a command reads and may write. inputs: what is read; out: where results go; free:
    more places that may change; the rest becomes the run's `Circumstances`."""

    def __init__(self, root, inputs, cache):
        self.root, self.warm, self.inputs, self.out = root, cache, root / "inputs", root / "out"
        self.free, self.file_bytes, self.small_disk = [], None, None
        shutil.copytree(inputs, self.inputs)
        for name in ("home", "tmp", "cwd"):
            (root / name).mkdir()
        self.variables = dict.fromkeys(UNSET) | {
            "HOME": str(root / "home"),
            "TMPDIR": str(root / "tmp"),
            "HYPOSE_CACHE_DIR": str(cache),
            "LC_ALL": "C.UTF-8",
            "PYTHONDONTWRITEBYTECODE": "1",
        }

    def circumstances(self):
        folder = str(self.root / "cwd")
        return Circumstances(self.variables, folder, self.file_bytes, obeys=True, small_disk=self.small_disk)

    def contents(self):
        """Sizes and times of all files outside of the places that may change."""
        found, free = {}, tuple(os.fsencode(p) for p in (self.out, *self.free))
        for place, folders, names in os.walk(os.fsencode(self.root)):
            folders[:] = [n for n in folders if os.path.join(place, n) not in free]
            for name in (*folders, *names):
                status = os.lstat(os.path.join(place, name))
                same = stat.S_ISDIR(status.st_mode) or (status.st_size, status.st_mtime_ns)
                found[os.fsdecode(os.path.join(place, name))] = same
        return found

    def take_away(self, *places):
        """The places, and all below them, may be read only."""
        for top in places:
            for path in [top, *top.rglob("*")]:
                path.chmod(0o555 if path.is_dir() else 0o444)

    def give_back(self):
        for place, folders, _ in os.walk(os.fsencode(self.root)):
            for name in folders:
                os.chmod(os.path.join(place, name), 0o700)

    def own_cache(self):
        """A copy of the cache; what cannot be kept there is kept in the home."""
        cache = shutil.copytree(self.warm, self.root / "cache")
        self.variables["HYPOSE_CACHE_DIR"] = str(cache)
        self.free += [cache, self.root / "home" / ".cache"]
        return cache


# ---- environments: each spoils a box ----


def no_cache(box):
    box.variables["HYPOSE_CACHE_DIR"] = None
    box.take_away(box.root / "home", box.root / "tmp")


def damaged_cache(box):
    """Every seventh file is empty, cut, garbage, a folder, or may not be read."""
    for k, path in enumerate(sorted(p for p in box.own_cache().rglob("*") if p.is_file())[::7]):
        data = path.read_bytes()
        if k % 5 < 3:
            path.write_bytes((b"", data[: len(data) // 2], b"\x80\x05cos\n")[k % 5])
        elif k % 5 == 3:
            path.unlink()
            path.mkdir()
        else:
            path.chmod(0)


def no_home(box):
    box.variables["HOME"] = None


def no_temporary_folder(box):
    (box.root / "tmp").rmdir()


def largest_file(size):
    def spoil(box):
        box.file_bytes = size

    return spoil


def small_disk(box):
    box.out.mkdir()
    box.small_disk = (str(box.out), 16 << 10)


def closed_results(box):
    box.out.mkdir()
    box.take_away(box.out)


def named(name, inside=True):
    """The folders of the recordings, of the results, and (inside) a camera and a sensor have this name."""

    def spoil(box):
        text = os.fsdecode(name)
        (box.root / text).mkdir()
        box.inputs = box.inputs.rename(box.root / text / text)
        box.free.append(box.root / "out")
        box.out = box.root / "out" / text
        if inside:
            call_view(box, "cam2", text)
            session = box.inputs / "sensors" / "session.json"
            session.write_text(session.read_text().replace('"sensor1"', json.dumps(text)))

    return spoil


def call_view(box, old, new):
    name = json.dumps(new, ensure_ascii=not new.isprintable())
    for path in box.inputs.glob("walk/*.toml"):
        text = path.read_text()
        path.write_text(re.sub(f'^(name|camera) = "{old}"', lambda m: f"{m[1]} = {name}", text, flags=re.MULTILINE))


# a process that is forked later would not notice these
YOUNG = {
    "no cache can be written": no_cache,
    "the cache may only be read": lambda box: box.take_away(box.own_cache()),
    "the cache is damaged": damaged_cache,
    "no HOME": no_home,
    "no TMPDIR": no_temporary_folder,
}
ENVIRONMENTS = YOUNG | {
    "full: files of 0 bytes": largest_file(0),
    "full: files of 3000 bytes": largest_file(3000),
    "full: a disk of 16 kB": small_disk,
    "read-only: everything that is read": lambda box: box.take_away(box.inputs),
    "read-only: the results' folder": closed_results,
    "name: not UTF-8": named(b"caf\xe9", inside=False),
    "name: newline, terminal escapes, quotes, alphabets": named('a\n\x1b[31mred\x07 it\'s "so" $(y) 走る %s {0}'),
}


@pytest.fixture(scope="module")
def warm():
    """The folder of the cache, with all that is compiled."""
    warm_up()
    folder = cache_folder()
    for thing in (Circumstances(obeys=True), Circumstances(small_disk=(str(folder), 1 << 14))):
        if folder is None or not possible(thing):
            missing.skip("folders that may not be written, full disks", "a system that lets the tests make them")
    return folder


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    write_masks(small_scene(1, 4), folder / "walk")
    write_skeletons(folder / "sensors", seconds=0.5)
    save_body(human(), folder / "anna" / "body.npz")
    ended = run(["track", folder / "walk", "--out", folder / "done", *LIGHT, folder / "anna"])
    assert ended.code == 0, ended.err
    return folder


@pytest.fixture(scope="module")
def server(warm):
    with ForkServer(warm=True) as server:
        yield server


@pytest.fixture
def box(warm, inputs, tmp_path):
    box = Box(tmp_path / "box", inputs, warm)
    yield box
    box.give_back()


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_it_ends_in_a_result_or_in_one_sentence(environment, command, box, server):
    ENVIRONMENTS[environment](box)
    arguments, result = COMMANDS[command]
    line, before = [*arguments(box.inputs), "--out", box.out], box.contents()
    start = Program if environment in YOUNG else server.start
    program = start(line, box.circumstances())
    ended = program.wait(HANG_S) or program.kill()
    said = ended.out + ended.err
    assert ended.code in (0, 2) and "Traceback" not in said and "should not have happened" not in said, said
    assert not [c for c in said if c < " " and c not in "\n\r\t"]
    if ended.code == 2:
        assert ended.err.splitlines()[-1].startswith("error: ") and ended.err.count("error: ") == 1, ended.err
    assert box.contents() == before
    if ended.code == 0 and not box.small_disk:
        assert (box.out / result).exists()
