"""What a check has found, mended by a change of recording.toml, in whose other lines nothing changes.

Every change is tried: where the recording cannot be read with it, the text is as it was, and the sentence says why.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

from hypose.app.studio.answers import request_choice, text, whole
from hypose.app.studio.answers import request_number as number_of
from hypose.app.studio.catalog import Catalog
from hypose.errors import HyposeError, InputError
from hypose.io.files import read_text, read_toml, toml_value, write_text
from hypose.io.recordings.recording import Recording, load_recording

_KINDS = (
    "accept_scaled", "leave_out", "take_back", "background", "use_refined", "keypoint_lag", "keypoint_pixels",
    "image_shift",
)  # fmt: skip
_AWAY = "#left out# "
"""Stands before every line of a view that is left out, so that it can be taken back."""
_REFINED = "results/calibration_refined*.toml"


def mend(folder: Path, recording: Recording | None, asked: dict[str, Any], catalog: Catalog) -> None:
    """Do what is asked: {"what": one of KINDS, "view": name, "path": picture or video of an empty room, "frames": by
    which key points come too early, "x", "y": px by which a view's pictures have to move}.
    recording: as it is read now, None where it cannot be."""
    what = request_choice(asked.get("what"), "way to mend", _KINDS)
    path = folder / "recording.toml"
    if not path.is_file():
        raise InputError(f"{folder.name} has no recording.toml to be changed; a Pose2Sim project is only read.")
    before = read_text(path, "a recording.toml")
    if what == "use_refined":
        return _try(path, before, _with_calibration(before, newest_refined_calibration(folder)))
    if what == "take_back":
        return _try(path, before, "\n".join(line.removeprefix(_AWAY) for line in before.split("\n")))
    if what == "keypoint_pixels":
        return _try(path, before, _at_top(before, "keypoint_pixels", "image"))
    if what == "keypoint_lag":
        frames = whole(asked.get("frames"), "the frames by which the key points are moved", -10_000, 10_000)
        lag = frames + (0 if recording is None else recording.keypoint_lag)
        return _try(path, before, _at_top(before, "keypoint_lag", lag))
    names = _names(path, recording)
    name = request_choice(asked.get("view"), "view", names)
    number, value = names.index(name), cast(Any, True)
    if what == "leave_out":
        if len(names) < 2:
            raise InputError(f"{name} is the only view; a recording needs one.")
        return _try(path, before, _changed(before, number, lambda b: [_AWAY + t if t.strip() else t for t in b]))
    if what == "image_shift":
        old = (0.0, 0.0) if recording is None else recording.views[number].image_shift
        by = (number_of(asked.get(k), f"the shift of the pictures in {k} (px)", -1e4, 1e4) for k in ("x", "y"))
        value = [round(a + b, 1) for a, b in zip(old, by, strict=True)]
    if what == "background":
        room = catalog.inside(text(asked.get("path"), "picture of the empty room", 1000, "choose one"), folder)
        value = (room.relative_to(folder) if room.is_relative_to(folder) else room).as_posix()
    line = f"{what} = {toml_value(value)}"
    _try(path, before, _changed(before, number, lambda b: [*_set_aside(b, what), line]))


def _names(path: Path, recording: Recording | None) -> list[str]:
    """The names of the views, also of a recording that cannot be read as it is."""
    if recording is not None:
        return [v.name for v in recording.views]
    tables = read_toml(path).get("view", [])
    return [str(t.get("name", t.get("camera", k))) for k, t in enumerate(tables, 1) if isinstance(t, dict)]


def excluded_views(folder: Path) -> list[str]:
    """Names of the views that have been left out of a recording."""
    try:
        lines = read_text(folder / "recording.toml", "a recording.toml").split("\n")
    except InputError:
        return []
    away = [line.removeprefix(_AWAY) for line in lines if line.startswith(_AWAY)]
    found = [re.match(r"""\s*(?:name|camera)\s*=\s*["'](.+?)["']""", line) for line in away]
    blocks = sum(line.strip() == "[[view]]" for line in away)
    names = list(dict.fromkeys(m[1] for m in found if m))
    return names if len(names) == blocks else [f"{blocks} views"] if blocks else []


def newest_refined_calibration(folder: Path) -> str | None:
    """The newest refined calibration of a recording, relative to it."""
    files = sorted(folder.glob(_REFINED), key=lambda p: p.stat().st_mtime)
    return files[-1].relative_to(folder).as_posix() if files else None


def _try(path: Path, before: str, after: str) -> None:
    write_text(path, after)
    try:
        load_recording(path.parent)
    except HyposeError as error:
        write_text(path, before)
        raise InputError(f"That does not mend it: {error}") from None


def _changed(whole: str, number: int, change: Callable[[list[str]], list[str]]) -> str:
    """The text with the lines of its view `number` changed."""
    lines = whole.split("\n")
    heads = [i for i, line in enumerate(lines) if line.split("#")[0].strip() == "[[view]]"]
    if number >= len(heads):
        raise InputError("The views are not written as [[view]] in recording.toml; change it by hand.")
    first = heads[number]
    following = (i for i in range(first + 1, len(lines)) if lines[i].lstrip().startswith("["))
    stop = next(following, len(lines))
    while stop > first + 1 and not lines[stop - 1].strip():
        stop -= 1
    return "\n".join([*lines[:first], *change(lines[first:stop]), *lines[stop:]])


def _at_top(whole: str, key: str, value: Any) -> str:
    """The text with a key of the recording itself."""
    lines = whole.split("\n")
    end = next((i for i, line in enumerate(lines) if line.lstrip().startswith("[")), len(lines))
    return "\n".join([f"{key} = {toml_value(value)}", *_set_aside(lines[:end], key), *lines[end:]])


def _set_aside(lines: list[str], key: str) -> list[str]:
    return [line for line in lines if not re.match(rf"\s*{key}\s*=", line)]


def _with_calibration(whole: str, name: str | None) -> str:
    """The text with another calibration, in metres and z up, and that of before behind a #."""
    if name is None:
        raise InputError("There is no refined calibration yet; refine it first.")
    lines = whole.split("\n")
    end = next((i for i, line in enumerate(lines) if line.lstrip().startswith("[")), len(lines))
    old = re.compile(r"\s*(calibration|calibration_unit|world_up)\s*=")
    head = [f"# before: {line.strip()}" if old.match(line) else line for line in lines[:end]]
    return "\n".join([f"calibration = {toml_value(name)}", *head, *lines[end:]])
