"""Sixty environments that a command may find itself in, and the commands that are tried in each.

A `Box` is one folder with everything that a command reads and may write; an environment spoils it before the command
runs. What a command leaves is compared with what was there before.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import stat
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.robustness.circumstances import Circumstances
from benchmarks.robustness.programs import Ended, run
from benchmarks.robustness.small_recordings import (
    small_scene,
    write_board_pictures,
    write_gesture_session,
    write_masks,
    write_skeletons,
)
from hypose.body.ready_bodies import human
from hypose.io.motions.bodies import save_body
from hypose.synthetic.rigs import rig
from hypose.synthetic.scenes import make_scene
from hypose.synthetic.write_recording import write_scene

VARIABLES = ("HOME", "TMPDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "LANG", "LC_ALL", "LC_CTYPE", "PYTHONIOENCODING")


@dataclass
class Box:
    """root: the folder of one run; inputs: what commands read; out: what they may write; cache: an own copy of the
    cache is made when an environment asks for it; the rest becomes the run's `Circumstances`."""

    root: Path
    warm_cache: Path
    inputs: Path
    out: Path
    name: str = "pause"  # of a gesture
    given_out: bool = True
    environment: dict[str, str | None] = field(default_factory=dict)
    file_bytes: int | None = None
    small_disk: tuple[str, int] | None = None
    own_places: list[Path] = field(default_factory=list)

    @classmethod
    def new(cls, root: Path, inputs: Path, cache: Path) -> Box:
        """A box with copies of the inputs, and an environment in which everything is in order."""
        shutil.copytree(inputs, root / "inputs")
        for name in ("home", "tmp", "cwd", "config"):
            (root / name).mkdir()
        box = cls(root, cache, root / "inputs", root / "out")
        box.environment = {
            **dict.fromkeys(VARIABLES),
            "HOME": str(root / "home"),
            "TMPDIR": str(root / "tmp"),
            "HYPOSE_CACHE_DIR": str(cache),
            "XDG_CONFIG_HOME": str(root / "config"),
            "LC_ALL": "C.UTF-8",
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        return box

    @property
    def cache(self) -> Path:
        return self.root / "cache"

    def circumstances(self) -> Circumstances:
        return Circumstances(
            self.environment, str(self.root / "cwd"), self.file_bytes, obeys=True, small_disk=self.small_disk
        )

    def contents(self) -> dict[str, tuple[int, int]]:
        """Everything outside of the places that the command may write to: sizes and times of files."""
        found = {}
        own = tuple(os.fsencode(p) for p in (self.out, *self.own_places))
        for place, folders, names in os.walk(os.fsencode(self.root)):
            folders[:] = [n for n in folders if os.path.join(place, n) not in own]
            for name in (*folders, *names):
                path = os.path.join(place, name)
                if path not in own:
                    status = os.lstat(path)
                    folder = stat.S_ISDIR(status.st_mode)
                    found[os.fsdecode(path)] = (0, 0) if folder else (status.st_size, status.st_mtime_ns)
        return found

    def take_away(self, *places: Path) -> None:
        """The places, and all below them, may be read only."""
        for top in places:
            for path in [top, *top.rglob("*")]:
                path.chmod(0o555 if path.is_dir() else 0o444)

    def give_back(self) -> None:
        """Everything may be written again, so that it can be removed."""
        for place, folders, _ in os.walk(os.fsencode(self.root)):
            for name in folders:
                path = os.path.join(place, name)
                if not os.path.islink(path):
                    os.chmod(path, 0o700)

    def own_cache(self, filled: bool = True) -> Path:
        if filled:
            shutil.copytree(self.warm_cache, self.cache)
        else:
            self.cache.mkdir()
        self.cache.chmod(0o700)
        self.environment["HYPOSE_CACHE_DIR"] = str(self.cache)
        self.own_places += [self.cache, self.root / "home" / ".cache"]  # the next place, where this one is not taken
        return self.cache


def write_inputs(folder: Path) -> Path:
    """What the commands read; needs some seconds."""
    write_masks(small_scene(1, 4), folder / "walk")
    write_skeletons(folder / "sensors", seconds=0.5)
    write_board_pictures(folder, frames=5)
    save_body(human(), folder / "anna" / "body.npz")
    write_gesture_session(folder / "session")
    cameras = rig("humaneva-4", distorted=True).scaled(0.25)
    write_scene(make_scene("walk", "neutral", cameras, seconds=0.16, seed=3), folder / "film", background_frames=4)
    light = ("--subject", folder / "anna", "--no-overlay", "--no-smooth", "--formats", "trc")
    ended = run(["track", folder / "walk", "--out", folder / "done", *light])
    assert ended.code == 0, ended.err
    sweep = 'recordings = ["walk"]\nformats = ["trc"]\n[settings]\nsubject = "anna"\n[[set]]\nname = "s"\nseed = [0]\n'
    (folder / "sweep.toml").write_text(sweep)
    return folder


# ---- commands ----


@dataclass(frozen=True)
class Command:
    """arguments(inputs) without the place of the results; option: how that place is given (None: as an argument at the
    end); result: what there must be in the place after a success; a place that ends in one file has it in `file`;
    spare: it works without being told the place; judges: code 1 is the answer that something is wrong in the input."""

    arguments: Callable[[Box], tuple[str | Path, ...]]
    result: str = ""
    option: str | None = "--out"
    file: str = ""
    spare: bool = True
    judges: bool = False

    def line(self, box: Box) -> list[str | Path]:
        """The whole command line."""
        place = box.out / self.file if self.file else box.out
        if box.given_out or not self.spare:
            return [*self.arguments(box), *([self.option] if self.option else []), place]
        return list(self.arguments(box))


def _light(box: Box) -> tuple[str | Path, ...]:
    return ("--subject", box.inputs / "anna", "--no-overlay", "--no-smooth", "--formats", "trc")


def _boards(box: Box) -> tuple[str | Path, ...]:
    lenses = ("--intrinsics", box.inputs / "lenses.toml")
    return ("calibrate", box.inputs / "boards", "--chessboard", "6x5", "--square", "12cm", "--floor", "0", *lenses)


COMMANDS: dict[str, Command] = {
    "demo": Command(lambda box: ("demo", "--seconds", "0.1"), "results/default/motion.npz"),
    "check": Command(
        lambda box: ("check", box.inputs / "walk", "--samples", "1", "--frames", "0"),
        "check.png",
        file="check.png",
        judges=True,
    ),
    "calibrate": Command(_boards, "calibration.toml", file="calibration.toml"),
    "silhouettes": Command(lambda box: ("silhouettes", box.inputs / "film"), "cam1/000000.png"),
    "subject": Command(lambda box: ("subject", box.inputs / "walk", "--poses", "1", "--frames", "0:2"), "body.npz"),
    "track": Command(lambda box: ("track", box.inputs / "walk", *_light(box)), "motion.npz"),
    "fuse": Command(lambda box: ("fuse", box.inputs / "sensors", "--formats", "trc"), "motion.trc"),
    "gesture": Command(
        lambda box: ("gesture", "train", "--gesture", box.name, "--recording", box.inputs / "session"),
        "model.npz",
        option=None,
        file="model.npz",
        spare=False,
    ),
    "view": Command(lambda box: ("view", "--port", free_port(), "--no-browser"), option=None, spare=False),
    "export": Command(lambda box: ("export", box.inputs / "done", "--formats", "trc,bvh"), "motion.bvh"),
    "synth": Command(
        lambda box: ("synth", "--rig", "ring-2", "--seconds", "0.1"), "recording.toml", option=None, spare=False
    ),
    "batch": Command(lambda box: ("batch", box.inputs / "sweep.toml", "--workers", "1"), "results.csv", judges=True),
}


def free_port() -> str:
    """A port of this computer that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return str(probe.getsockname()[1])


# ---- environments ----


@dataclass(frozen=True)
class Environment:
    """spoil(box); young: it matters while a process starts, so one that is forked later would not notice; cold: all
    kernels have to be compiled."""

    spoil: Callable[[Box], object]
    young: bool = False
    cold: bool = False


def _every_cached_file(box: Box, change: Callable[[Path], object]) -> None:
    for path in sorted(p for p in box.own_cache().rglob("*") if p.is_file()):
        change(path)


def _some_cached_files(change: Callable[[Path], object], every: int = 7) -> Callable[[Box], object]:
    def spoil(box: Box) -> None:
        for path in sorted(p for p in box.own_cache().rglob("*") if p.is_file())[::every]:
            change(path)

    return spoil


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _turn(path: Path) -> None:
    """Garbage behind a head that is as it should be."""
    data = bytearray(path.read_bytes())
    data[len(data) // 3 : 2 * len(data) // 3] = b"\xa5" * (2 * len(data) // 3 - len(data) // 3)
    path.write_bytes(data)


def _in_its_place(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _cache_below_read_only(box: Box) -> None:
    (box.root / "closed").mkdir()
    box.take_away(box.root / "closed")
    box.environment["HYPOSE_CACHE_DIR"] = str(box.root / "closed" / "cache")
    box.own_places += [box.root / "home" / ".cache"]


def _cache_on_a_full_disk(box: Box) -> None:
    box.small_disk = (str(box.own_cache(filled=False)), 1 << 14)


def _cache_is_a_file(box: Box) -> None:
    box.cache.write_text("no folder\n")
    box.environment["HYPOSE_CACHE_DIR"] = str(box.cache)
    box.own_places += [box.root / "home" / ".cache"]


def _cache_of_everybody(box: Box) -> None:
    box.own_cache().chmod(0o777)


def _cache_nowhere(box: Box) -> None:
    box.environment["HYPOSE_CACHE_DIR"] = None
    box.take_away(box.root / "home", box.root / "tmp")


def _cache_among_temporary_ones(box: Box) -> None:
    box.environment |= {"HYPOSE_CACHE_DIR": None, "HOME": str(box.root / "nowhere")}
    box.take_away(box.root)
    box.root.chmod(0o755)
    for name in ("tmp", "cwd"):
        (box.root / name).chmod(0o755)
    box.own_places += [box.root / "tmp" / f"hypose-cache-{os.getuid()}"]


def _home(value: str | None, make: Callable[[Path], object] | None = None) -> Callable[[Box], object]:
    def spoil(box: Box) -> None:
        home = box.root / "home"
        if make:
            home.rmdir()
            make(home)
        box.environment["HOME"] = value and str(box.root / value)

    return spoil


def _set(**variables: str | None) -> Callable[[Box], object]:
    return lambda box: box.environment.update(variables)


def _temporary(make: Callable[[Path], object]) -> Callable[[Box], object]:
    def spoil(box: Box) -> None:
        (box.root / "tmp").rmdir()
        make(box.root / "tmp")

    return spoil


def _temporary_is_full(box: Box) -> None:
    box.small_disk = (str(box.root / "tmp"), 1 << 12)


def _full(limit: int) -> Environment:
    def spoil(box: Box) -> None:
        box.file_bytes = limit

    return Environment(spoil)


def _full_disk(size: int) -> Environment:
    def spoil(box: Box) -> None:
        box.out.mkdir()
        box.small_disk = (str(box.out), size)

    return Environment(spoil)


def _read_only(*places: str) -> Environment:
    return Environment(lambda box: box.take_away(*(box.root / p for p in places)))


def _default_place(box: Box) -> None:
    """Nothing is said about where results go, and where they would go nothing may be written."""
    box.given_out = False
    box.take_away(box.inputs, box.root / "cwd")


def _read_only_out(box: Box) -> None:
    box.out.mkdir()
    box.take_away(box.out)


def _below_read_only(box: Box) -> None:
    (box.root / "closed").mkdir()
    box.take_away(box.root / "closed")
    box.out = box.root / "closed" / "a" / "b"


def _filled_with_read_only(box: Box) -> None:
    """Results of before, each file read-only, as a careful person leaves them."""
    shutil.copytree(box.inputs / "done", box.out)
    for path in box.out.rglob("*"):
        path.chmod(0o444 if path.is_file() else 0o755)


def _named(name: str | bytes, inside: bool = True) -> Environment:
    """The folders of the recordings, of the results, and (inside) a camera, a sensor and a gesture have this name."""

    def spoil(box: Box) -> None:
        text = os.fsdecode(name)
        moved = box.root / text
        moved.mkdir(exist_ok=True)
        box.inputs = box.inputs.rename(moved / text)
        box.out = box.root / "out" / text
        box.own_places.append(box.root / "out")
        if inside:
            box.name = text
            for path in box.inputs.glob("*/*.toml"):
                call_view(path, text)
            for path in (box.inputs / "sensors" / "session.json", box.inputs / "session" / "session.json"):
                text_in = path.read_text().replace('"sensor1"', json.dumps(text)).replace('"pause"', json.dumps(text))
                path.write_text(text_in)

    return Environment(spoil)


def call_view(path: Path, text: str, old: str = "cam2") -> None:
    """Call a view and its camera by another name in a TOML file."""
    name = json.dumps(text, ensure_ascii=not text.isprintable())  # TOML knows no halves of pairs
    found = re.sub(f'^(name|camera) = "{old}"', lambda m: f"{m[1]} = {name}", path.read_text(), flags=re.MULTILINE)
    path.write_text(found, newline="")


def _dots(box: Box) -> None:
    """Names that lead out of their folder."""
    _named("up").spoil(box)
    for path in box.inputs.glob("*/*.toml"):
        call_view(path, "../../../up", "up")
    box.out = box.out / ".." / "out" / ".." / "up"


def _file(path: Path) -> None:
    path.write_text("a file\n")


def _closed(path: Path) -> None:
    path.mkdir()
    path.chmod(0o555)


ENVIRONMENTS: dict[str, Environment] = {
    # the cache
    "cache: none yet": Environment(lambda box: box.own_cache(filled=False), young=True, cold=True),
    "cache: a folder is missing that may not be made": Environment(_cache_below_read_only, young=True, cold=True),
    "cache: read-only, empty": Environment(
        lambda box: box.take_away(box.own_cache(filled=False)), young=True, cold=True
    ),
    "cache: read-only, filled": Environment(lambda box: box.take_away(box.own_cache()), young=True),
    "cache: empty files": Environment(_some_cached_files(lambda p: p.write_bytes(b"")), young=True),
    "cache: truncated files": Environment(_some_cached_files(_cut), young=True),
    "cache: garbage in files": Environment(_some_cached_files(_turn), young=True),
    "cache: garbage for files": Environment(_some_cached_files(lambda p: p.write_bytes(b"\x80\x05cos\n")), young=True),
    "cache: unreadable files": Environment(_some_cached_files(lambda p: p.chmod(0)), young=True),
    "cache: folders in place of files": Environment(_some_cached_files(_in_its_place), young=True),
    "cache: a file in place of the folder": Environment(_cache_is_a_file, young=True, cold=True),
    "cache: on a full disk": Environment(_cache_on_a_full_disk, young=True, cold=True),
    "cache: of everybody": Environment(_cache_of_everybody, young=True, cold=True),
    "cache: among temporary files": Environment(_cache_among_temporary_ones, young=True, cold=True),
    "cache: nowhere": Environment(_cache_nowhere, young=True, cold=True),
    # HOME
    "HOME: unset": Environment(_home(None), young=True),
    "HOME: missing": Environment(_home("nowhere"), young=True),
    "HOME: read-only": Environment(_home("home", _closed), young=True),
    "HOME: a file": Environment(_home("home", _file), young=True),
    # TMPDIR
    "TMPDIR: missing": Environment(_temporary(lambda path: None), young=True),
    "TMPDIR: read-only": Environment(_temporary(_closed), young=True),
    "TMPDIR: a file": Environment(_temporary(_file), young=True),
    "TMPDIR: full": Environment(_temporary_is_full, young=True),
    # locale
    "locale: C": Environment(_set(LC_ALL="C"), young=True),
    "locale: POSIX": Environment(_set(LC_ALL="POSIX"), young=True),
    "locale: C without UTF-8": Environment(_set(LC_ALL="C", PYTHONUTF8="0"), young=True),
    "locale: C without UTF-8, not coerced": Environment(
        _set(LC_ALL="C", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0"), young=True
    ),
    "locale: tr_TR": Environment(_set(LC_ALL="tr_TR.UTF-8"), young=True),
    "locale: unknown": Environment(_set(LC_ALL="xx_YY", PYTHONUTF8="0"), young=True),
    "locale: ASCII output": Environment(_set(PYTHONIOENCODING="ascii"), young=True),
    # the disk is full at ten moments
    **{f"full: files of {n} bytes": _full(n) for n in (0, 1, 100, 600, 3000, 10_000, 40_000, 150_000)},
    **{f"full: a disk of {n} kB": _full_disk(n << 10) for n in (16, 128)},
    # read-only in ten places
    "read-only: the recording": _read_only("inputs/walk", "inputs/film", "inputs/sensors", "inputs/boards"),
    "read-only: everything that is read": _read_only("inputs"),
    "read-only: where results go by themselves": Environment(_default_place),
    "read-only: masks": _read_only(*(f"inputs/walk/cam{k}" for k in (1, 2, 3, 4))),
    "read-only: calibration, videos": _read_only("inputs/walk/calibration.toml", "inputs/film/videos", "inputs/boards"),
    "read-only: subject, results of before": _read_only("inputs/anna", "inputs/done", "inputs/session"),
    "read-only: the results' folder": Environment(_read_only_out),
    "read-only: above the results' folder": Environment(_below_read_only),
    "read-only: each file of the results": Environment(_filled_with_read_only),
    "read-only: the working folder": _read_only("cwd"),
    # names
    "name: spaces": _named(" a  b "),
    "name: leading dash": _named("-x"),
    "name: not UTF-8": _named(b"caf\xe9", inside=False),
    "name: newline": _named("a\nb"),
    "name: very long": _named("n" * 250),
    "name: terminal escapes": _named("\x1b[31mred\x1b]0;title\x07"),
    "name: many alphabets": _named("Mädchen 走る 🏃 עברית"),
    "name: leads out": Environment(_dots),
    "name: quotes": _named('it\'s "so" `x` $(y)'),
    "name: percent": _named("100%s %n {0}"),
}


# ---- what may come out ----


def complaint(command: Command, box: Box, ended: Ended, before: dict[str, tuple[int, int]]) -> str:
    """What is wrong with how a command ended; empty when all is well."""
    said = ended.out + ended.err
    if "Traceback" in said or "should not have happened" in said:
        return "a traceback: " + " ".join(said.split())[-500:]
    judged = ended.code == 1 and command.judges and "error: " not in ended.err
    if ended.code == 2:
        lines = [line for line in ended.err.splitlines() if line.lower().startswith("error: ")]
        if len(lines) != 1 or not ended.err.rstrip().endswith(lines[0].rstrip()):
            return f"not one sentence at the end: {ended.err[-500:]!r}"
    elif ended.code != 0 and not judged:
        return f"code {ended.code}: {said[-500:]!r}"
    if any(c < " " and c not in "\n\r\t" for c in said):
        return f"control characters: {said[-300:]!r}"
    after = box.contents()
    changed = sorted(p for p in {*before, *after} if before.get(p) != after.get(p))
    if changed:
        return f"files outside: {changed[:5]}"
    place = box.out if box.given_out and not box.small_disk else None
    if ended.code == 0 and command.result and place and not (place / command.result).exists():
        return f"a success without {command.result}: {sorted(place.rglob('*'))[:5]}"
    return ""
