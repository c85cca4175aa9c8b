"""What a job is on the command line: the page's options, checked, as the arguments of a hypose command.

A job is the command itself in a process of its own, so the studio can do nothing that the command line cannot, and the
page can show the line that does the same again.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hypose.app.jobs.correct import read_correction
from hypose.app.studio.catalog import Catalog, Item
from hypose.errors import InputError
from hypose.io.file_names import natural_key

BOARDS = "board"
"""The folder of a recording in which the clips or photos of the calibration board lie, named by their cameras."""
CALIBRATION = "calibration.toml"
"""Where a recording keeps the calibration that is made of them."""


@dataclass(frozen=True)
class Plan:
    """arguments of `hypose`; title; recording, result: ids (the result may be not there yet); resumable: the same
    command with --resume goes on; folder: where a motion that is under way keeps its state; makes: id of a recording
    that comes of it."""

    arguments: tuple[str, ...]
    title: str
    recording: str | None = None
    result: str | None = None
    resumable: bool = False
    folder: Path | None = None
    makes: str | None = None


def _text(value: Any, name: str) -> str:
    # an option's value is one argument of its own; it must not pass for another option
    if not isinstance(value, str) or not value or len(value) > 200 or value.startswith("-") or not value.isprintable():
        raise InputError(f"The option {name} is not usable: {str(value)[:40]!r}.")
    return value


def _number(value: Any, name: str) -> str:
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value or abs(value) > 1e9:
        raise InputError(f"The option {name} must be a number, {str(value)[:40]!r} is none.")
    return str(int(value)) if value == int(value) else repr(value)


def _flag(value: Any, name: str) -> bool:
    if not isinstance(value, bool):
        raise InputError(f"The option {name} must be true or false.")
    return value


def _formats(value: Any, name: str) -> str:
    if not isinstance(value, list) or not value:
        raise InputError(f"The option {name} must be a list of formats.")
    return ",".join(_text(v, name) for v in value)


def _offsets(value: Any, name: str) -> str:
    if not isinstance(value, list) or not value:
        raise InputError(f"The option {name} must be a list of numbers, one per view.")
    return ",".join(_number(v, name) for v in value)


_Reader = Callable[[Any, str], str | bool]
_OPTIONS: Mapping[str, Mapping[str, tuple[str, _Reader]]] = {
    "calibrate": {
        "chessboard": ("--chessboard", _text),
        "charuco": ("--charuco", _text),
        "square": ("--square", _text),
        "marker": ("--marker", _text),
        "dictionary": ("--dictionary", _text),
        "inverted": ("--inverted", _flag),
        "fisheye": ("--fisheye", _flag),
        "floor": ("--floor", _number),
    },
    "sync": {"by": ("--by", _text), "largest": ("--largest", _number), "frames": ("--frames", _number)},
    "in_step": {"offsets": ("--offsets=", _offsets)},
    "check": {"samples": ("--samples", _number), "frames": ("--frames", _number)},
    "refine": {
        "using": ("--from", _text),
        "far": ("--far", _flag),
        "focal": ("--focal", _flag),
        "height": ("--height", _number),
    },
    "silhouettes": {"frames": ("--frames", _text)},
    "subject": {
        "height": ("--height", _number),
        "mass": ("--mass", _number),
        "start": ("--start", _text),
        "frames": ("--frames", _text),
        "poses": ("--poses", _number),
    },
    "track": {
        "recipe": ("--recipe", _text),
        "refine": ("--refine", _flag),
        "evidence": ("--evidence", _text),
        "start": ("--start", _text),
        "height": ("--height", _number),
        "frames": ("--frames", _text),
        "seed": ("--seed", _number),
        "formats": ("--formats", _formats),
        "camera": ("--camera", _text),
    },
    "correct": {"until": ("--until", _number)},
    "export": {"formats": ("--formats", _formats)},
    "demo": {"seconds": ("--seconds", _number), "seed": ("--seed", _number)},
    "fuse": {},
}
KINDS = tuple(_OPTIONS)
_TITLES = {
    "calibrate": "Calibrate the cameras of {}",
    "sync": "How late are the cameras of {}?",
    "in_step": "Bring {} in step",
    "check": "Check {}",
    "refine": "Refine the calibration of {}",
    "silhouettes": "Silhouettes of {}",
    "subject": "Measure the person in {}",
    "track": "Track {}",
    "correct": "Track {} again from frame {}",
    "export": "Export {}",
    "demo": "Make a demo recording and track it",
    "fuse": "Fuse {}",
}


def plan(kind: str, request: Mapping[str, Any], catalog: Catalog) -> Plan:
    """The command of a job that the page asks for: {"recording" or "result": id, "options": {...}}."""
    if kind not in _OPTIONS:
        raise InputError(f"There is no job {str(kind)[:40]!r}; the jobs are {', '.join(KINDS)}.")
    options = request.get("options") or {}
    if not isinstance(options, dict):
        raise InputError("A job's options must be an object.")
    own = {"track": {"name", "subject", "overlay"}, "correct": {"start"}}.get(kind, set())
    unknown = [str(o)[:40] for o in options if o not in _OPTIONS[kind] and o not in own]
    if unknown:
        raise InputError(f"The job {kind} has no option {unknown[0]!r}; it has {', '.join(_OPTIONS[kind])}.")
    arguments: list[str] = []
    for name, (flag, read) in _OPTIONS[kind].items():
        value = options.get(name)
        if value is None:
            continue
        given = read(value, name)
        # a value that may begin with a minus belongs to its option
        valued = [f"{flag}{given}"] if flag.endswith("=") else [flag, str(given)]
        arguments += [flag] if given is True else [] if given is False else valued
    if kind == "demo":
        out = free_folder(catalog.root, "demo")
        result = catalog.id_of("result", out / "results" / "default")
        return Plan(("demo", "--out", str(out), *arguments), _TITLES[kind], catalog.id_of("recording", out), result)
    if kind == "export":
        item = catalog.find("result", _id(request, "result"))
        return Plan(("export", str(item.path), *arguments), _TITLES[kind].format(item.path.name), None, item.id)
    if kind == "fuse":
        item = catalog.find("skeletons", _id(request, "skeletons"))
        out = fused_in(item.path)
        if not catalog.contains(out):
            raise InputError(f"The results of {item.path.name} lie outside the served folder; use the command line.")
        command = ("fuse", str(item.path), "--out", str(out))
        return Plan(command, _TITLES[kind].format(item.path.name), None, catalog.id_of("result", out), True)
    if kind == "correct":
        return _correct(catalog.find("result", _id(request, "result")), arguments, options, catalog)
    item = catalog.find("recording", _id(request, "recording"))
    if not all(catalog.contains(item.path / f) for f in ("results", "results/silhouettes", "subject")):
        raise InputError(f"The results of {item.path.name} lie outside the served folder; use the command line.")
    title = _TITLES[kind].format(item.path.name)
    if kind == "calibrate":
        return Plan(("calibrate", *_board_files(item.path), *arguments, *_calibrated(item.path)), title, item.id)
    if kind == "in_step":
        made = free_folder(item.path.parent, f"{item.path.name}-in-step")
        if "offsets" not in options or not catalog.contains(made):
            raise InputError("Say by how many frames each view is late.")
        command = ("sync", str(item.path), *arguments, "--out", str(made))
        return Plan(command, title, item.id, makes=catalog.id_of("recording", made))
    if kind == "track":
        return _track(item.path, item.id, arguments, options, title, catalog)
    extra = ("--refine",) if kind == "refine" else ()
    command = "check" if kind == "refine" else kind
    return Plan((command, str(item.path), *extra, *arguments), title, item.id)


def fused_in(skeletons: Path) -> Path:
    """Where a recording of live sensors is fused to."""
    return skeletons / "results" / "fuse-fit"


def _board_files(folder: Path) -> list[str]:
    """The clips or photo folders of the board, one per camera."""
    boards = folder / BOARDS
    found = sorted(boards.iterdir(), key=lambda p: natural_key(p.name)) if boards.is_dir() else []
    if not found:
        raise InputError(f"There are no clips of a board in {folder.name}; drop them with the videos.")
    return [str(p) for p in found]


def _calibrated(folder: Path) -> list[str]:
    """Where a calibration goes, and the picture of what was seen."""
    return ["--out", str(folder / CALIBRATION), "--sheet", str(folder / "results" / "calibration.png")]


def settled(kind: str, request: Mapping[str, Any], catalog: Catalog) -> Mapping[str, Any]:
    """A request with what it leaves open decided, so that it means the same when it is planned again: a new track takes
    a name under which nothing lies yet, since what was tracked before is not to be written over."""
    options = request.get("options") or {}
    if kind != "track" or not isinstance(options, dict):
        return request
    folder = catalog.find("recording", _id(request, "recording")).path / "results"
    return {**request, "options": {**options, "name": free_folder(folder, _result_name(options)).name}}


def _result_name(options: Mapping[str, Any]) -> str:
    name = options.get("name") or options.get("recipe") or "default"
    if not isinstance(name, str) or not is_name(name):
        raise InputError(f"{str(name)[:40]!r} is no name for a result; use letters, digits, -, _ and dots between.")
    return name


def _track(
    folder: Path, recording: str, arguments: list[str], options: Mapping[str, Any], title: str, catalog: Catalog
) -> Plan:
    out = folder / "results" / _result_name(options)
    if not catalog.contains(out):
        raise InputError(f"The results of {folder.name} lie outside the served folder; track them on the command line.")
    if isinstance(start := options.get("start"), str) and start.startswith("clicks:"):
        arguments[arguments.index("--start") + 1] = str(_clicked(folder, start.removeprefix("clicks:")))
    arguments += ["--out", str(out)]
    title += "" if out.name == "default" else f" as {out.name}"
    if options.get("subject") and _flag(options["subject"], "subject"):
        arguments += ["--subject", str(folder / "subject")]
    if options.get("overlay") is not None and not _flag(options["overlay"], "overlay"):
        arguments.append("--no-overlay")
    return Plan(("track", str(folder), *arguments), title, recording, catalog.id_of("result", out), True, out)


def _correct(item: Item, arguments: list[str], options: Mapping[str, Any], catalog: Catalog) -> Plan:
    folder, start = catalog.recording_of(item.path), options.get("start")
    if folder is None or not isinstance(start, str) or not start.startswith("clicks:"):
        raise InputError("Say which clicks the result is to be tracked again from.")
    clicks = _clicked(folder, start.removeprefix("clicks:"))
    original = re.sub(r"-corrected(-\d+)?$", "", item.path.name)
    out = free_folder(item.path.parent, f"{original}-corrected")
    title = _TITLES["correct"].format(item.path.name, read_correction(clicks).frame)
    command = ("correct", str(item.path), str(clicks), *arguments, "--out", str(out))
    return Plan(command, title, catalog.id_of("recording", folder), catalog.id_of("result", out))


def _clicked(folder: Path, name: str) -> Path:
    """The file of clicks that the page has saved under a name."""
    path = folder / "starts" / f"{name}.json"
    if not is_name(name) or not path.is_file():
        raise InputError(f"There are no clicks saved as {name[:40]!r} in {folder.name}; save them first.")
    return path


def _id(request: Mapping[str, Any], name: str) -> str:
    value = request.get(name)
    if not isinstance(value, str):
        raise InputError(f"Say which {name} is meant.")
    return value


def is_name(text: str) -> bool:
    """A name for a folder or file that means nothing else to any system."""
    plain = all(c.isascii() and (c.isalnum() or c in "-_.") for c in text)
    return plain and 0 < len(text) <= 80 and text[0] not in ".-" and text[-1] != "."


def free_folder(parent: Path, name: str) -> Path:
    """parent/name, or with a number behind it the first that is not taken: walk, walk-2, walk-3."""
    numbered = re.fullmatch(r"(.+)-(\d{1,4})", name)
    stem, number = (numbered[1], int(numbered[2]) + 1) if numbered else (name, 2)
    path = parent / name
    while path.exists():
        path, number = parent / f"{stem}-{number}", number + 1
    return path
