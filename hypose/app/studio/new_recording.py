"""What the page asks for as a new recording: which dropped file goes where, and the recording.toml that says so."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hypose.app.studio.job_kinds import BOARDS, CALIBRATION, is_name
from hypose.errors import InputError
from hypose.io.files import toml_value

_ROLES = {
    "video": ("video", "image"),
    "background": ("video", "image"),
    "masks": ("video",),
    "keypoints": ("keypoints",),
    "board": ("video", "image"),
}
"""What a view may be given, and the kinds of files that are such."""


@dataclass(frozen=True)
class Upload:
    """A file that lies ready: id, name as it was dropped (made harmless), path, facts for the page, with its "kind"."""

    id: str
    name: str
    path: Path
    facts: Mapping[str, Any]


@dataclass(frozen=True)
class Layout:
    """moves: upload's id -> place in the recording's folder; text: its recording.toml; calibrated: a calibration is
    among the files."""

    name: str
    moves: Mapping[str, str]
    text: str
    calibrated: bool


def layout_of(wanted: Mapping[str, Any], find: Callable[[str], Upload]) -> Layout:
    """The recording that a page asks for (docs/studio-protocol.md). find(id): the upload, or NotFound."""
    name = wanted.get("name")
    if not isinstance(name, str) or not is_name(name):
        raise InputError("Give the recording a name of letters, digits, - and _.")
    views = wanted.get("views")
    if not isinstance(views, list) or not views or not all(isinstance(v, dict) for v in views):
        raise InputError("A recording needs at least one video; drop them onto the page.")
    moves: dict[str, str] = {}
    boards = [v for v in views if v.get("board") is not None]
    calibrated = wanted.get("calibration") is not None or not boards
    lines = [f"name = {toml_value(name)}"]
    if calibrated:
        calibration = _given(wanted, "calibration", find)
        moves[calibration.id] = f"calibration/{calibration.name}"
        lines.append(f"calibration = {toml_value(moves[calibration.id])}")
    else:
        lines.append(f"calibration = {toml_value(CALIBRATION)}")
        missing = [v.get("name", "?") for v in views if v not in boards]
        if missing:
            raise InputError(
                f"There is no clip of the board of {missing[0]}; drop it, or a calibration of all cameras."
            )
    lines += [
        f"{key} = {toml_value(wanted[key])}"
        for key in ("calibration_unit", "world_up", "frame_rate", "subject_height")
        if isinstance(wanted.get(key), str | int | float)
    ]
    cameras = [v["camera"] for v in views if isinstance(v.get("camera"), str)]
    twice = next((c for k, c in enumerate(cameras) if c in cameras[:k]), None)
    if twice is not None:
        raise InputError(f"Two videos are of the camera {twice}; give every camera one.")
    for view in views:
        lines += ["", "[[view]]", *_view_lines(view, moves, find, calibrated)]
    return Layout(name, moves, "\n".join(lines) + "\n", calibrated)


def camera_file(camera: str) -> str:
    """A camera's name as the name of its board's file, which is what the calibration then calls the camera."""
    plain = re.sub(r"[^A-Za-z0-9_.-]", "_", camera)[:60].strip(".")
    return plain if plain and not plain.startswith("-") else f"camera_{plain}"


def _view_lines(
    view: Mapping[str, Any], moves: dict[str, str], find: Callable[[str], Upload], calibrated: bool
) -> list[str]:
    camera = view.get("camera")
    out = [f"name = {toml_value(view['name'])}"] if isinstance(view.get("name"), str) else []
    if isinstance(camera, str):
        out.append(f"camera = {toml_value(camera if calibrated else camera_file(camera))}")
    out += ["accept_scaled = true"] if view.get("accept_scaled") is True else []
    if not any(view.get(k) is not None for k in ("video", "masks", "keypoints")):
        raise InputError("A recording needs a video here; drop the file onto the page.")
    for role, kinds in _ROLES.items():
        if view.get(role) is None:
            continue
        upload = _given(view, role, find)
        kind = upload.facts["kind"]
        if kind not in kinds:
            raise InputError(f"{upload.name} cannot be used as {role}; choose what it is on the page.")
        if upload.id in moves:
            raise InputError(f"{upload.name} is given twice; give every view a file of its own.")
        if role == "board":
            moves[upload.id] = f"{BOARDS}/{camera_file(str(camera))}.{upload.name.rpartition('.')[2]}"
            continue
        moves[upload.id] = f"{_FOLDERS.get(role, role + 's')}/{len(moves):02d}_{upload.name}"
        out.append(f"{role} = {toml_value(moves[upload.id])}")
    return out


_FOLDERS = {"masks": "masks", "keypoints": "keypoints"}


def _given(table: Mapping[str, Any], key: str, find: Callable[[str], Upload]) -> Upload:
    value = table.get(key)
    if not isinstance(value, str):
        raise InputError(f"A recording needs a {key} here; drop the file onto the page.")
    return find(value)
