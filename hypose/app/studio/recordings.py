"""Recordings for the Set up and Click screens: facts, pictures, masks with trial settings, and edits of
recording.toml.
"""

from __future__ import annotations

import contextlib
import json
import re
import threading
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.app.studio.catalog import Catalog, Item, NotFound
from hypose.app.studio.http import request_choice, text, whole
from hypose.app.studio.http import request_number as number_of
from hypose.app.studio.job_kinds import (
    CALIBRATION,
    board_files,
    described,
    found_offsets,
    next_step,
    read_found,
    uncalibrated,
)
from hypose.app.studio.view_pictures import OpenRecording
from hypose.calibration.views import find_sources
from hypose.errors import HyposeError, InputError
from hypose.evidence.silhouettes import SilhouetteSettings
from hypose.geometry import Image, Mask
from hypose.io.files import read_text, read_toml, toml_value, write_text
from hypose.io.recordings.recording import (
    SILHOUETTE_KEYS,
    Recording,
    load_recording,
    silhouette_lines,
    silhouette_options,
    write_recording,
)
from hypose.json_text import parse_json

# ---- edits ---------------------------------------------------------------------------------------------------------
# Correct faults that a check has found by a change of recording.toml; its other lines stay unchanged. The text is split
# into tables: the lines of the recording itself, then of each [table] with its header.


_KINDS = (
    "accept_scaled", "leave_out", "take_back", "background", "board", "height", "use_refined", "keypoint_lag",
    "keypoint_pixels", "image_shift",
)  # fmt: skip
_VIEW, _AWAY = "[[view]]", "[[left_out]]"
"""Headers of the table of a view, and of one that is left out."""
_REFINED = "results/calibration_refined*.toml"
_Tables = list[list[str]]


def edit_recording(folder: Path, recording: Recording | None, asked: dict[str, Any], catalog: Catalog) -> None:
    """Correct a fault of a recording by an edit of recording.toml.

    folder: folder of the recording.
    recording: as it is read now; None where it cannot be read.
    asked: {"what": one of _KINDS, "view": name, "path": picture or video of an empty room, "frames": by which key
        points are early, "x", "y": px by which a view's pictures are moved, "metres": height}.
    catalog: catalog of the served folder, in which `path` must lie.
    Raises: InputError names the cause. Where the recording cannot be read with the edit, the old text is restored
        first; height and board are not checked in this way.
    """
    what = request_choice(asked.get("what"), "way to repair", _KINDS)
    path = _description(folder, recording)
    before = read_text(path, "a recording.toml")
    tables = _tables_of(before)
    if what == "use_refined":
        tables[0] = _with_calibration(tables[0], newest_refined_calibration(folder))
    elif what == "take_back":
        for lines in tables[1:]:
            lines[0] = lines[0].replace(_AWAY, _VIEW)
    elif what == "keypoint_pixels":
        tables[0] = _set(tables[0], "keypoint_pixels", "image")
    elif what == "height":
        metres = number_of(asked.get("metres"), "the height of the person (m)", 0.4, 2.8)
        tables[0] = _set(tables[0], "subject_height", metres)
    elif what == "keypoint_lag":
        frames = whole(asked.get("frames"), "the frames by which the key points are moved", -10_000, 10_000)
        lag = frames + (0 if recording is None else recording.keypoint_lag)
        tables[0] = _set(tables[0], "keypoint_lag", lag)
    else:
        _edit_view(tables, read_toml(path).get("view", []), what, asked, recording, folder, catalog)
    write_text(path, "\n".join(line for lines in tables for line in lines))
    if what not in ("height", "board"):
        try:
            load_recording(folder)
        except HyposeError as error:
            write_text(path, before)
            raise InputError(f"That does not repair it: {error}") from None


def _edit_view(
    tables: _Tables,
    parsed: Sequence[Mapping[str, Any]],
    what: str,
    asked: Mapping[str, Any],
    recording: Recording | None,
    folder: Path,
    catalog: Catalog,
) -> None:
    """Change the table of one view; arguments as in `edit_recording`.

    tables: tables of recording.toml; the table is changed in place.
    parsed: values of the views.
    """
    views = [k for k, lines in enumerate(tables) if _header(lines) == _VIEW]
    if len(views) != len(parsed):
        raise InputError("The views are not written as [[view]] in recording.toml; change it by hand.")
    names = [str(v.get("name") or f"view{k}") for k, v in enumerate(parsed, 1)]
    name = request_choice(asked.get("view"), "view", names)
    number, value = names.index(name), cast(Any, True)
    lines = tables[views[number]]
    if what == "leave_out":
        if len(names) < 2:
            raise InputError(f"{name} is the only view; a recording needs one.")
        lines[0] = lines[0].replace(_VIEW, _AWAY)
        return
    if what == "image_shift":
        old = (0.0, 0.0) if recording is None else recording.views[number].image_shift
        by = (number_of(asked.get(k), f"the shift of the pictures in {k} (px)", -1e4, 1e4) for k in ("x", "y"))
        value = [round(a + b, 1) for a, b in zip(old, by, strict=True)]
    if what in ("background", "board"):
        room = catalog.inside(text(asked.get("path"), "file of a view", 1000, "choose one"), folder)
        value = (room.relative_to(folder) if room.is_relative_to(folder) else room).as_posix()
    tables[views[number]] = _set(lines, what, value)


def tick_findings(folder: Path, numbers: Sequence[Any]) -> None:
    """Mark findings of the last check, by their numbers, as corrected, and the check as no longer up to date."""
    found = read_found(folder, "check.json")
    if found is not None:
        for number, finding in enumerate(found["findings"]):
            finding["done"] = number in numbers or finding.get("done") is True
        write_text(folder / "results" / "check.json", json.dumps({**found, "stale": True}))


def _description(folder: Path, recording: Recording | None) -> Path:
    """Return the path of a recording's recording.toml; for a Pose2Sim project without one, write it first."""
    if not (folder / "recording.toml").is_file() and recording is not None:
        write_recording(recording, folder)
    return folder / "recording.toml"


def newest_refined_calibration(folder: Path) -> str | None:
    """Return the newest refined calibration of a recording, as a path relative to it; None without one."""
    files = sorted(folder.glob(_REFINED), key=lambda p: p.stat().st_mtime)
    return files[-1].relative_to(folder).as_posix() if files else None


def _tables_of(text: str) -> _Tables:
    """Split a TOML text into the lines of its tables, the first without a header."""
    tables: _Tables = [[]]
    for line in text.split("\n"):
        if line.lstrip().startswith("["):
            tables.append([])
        tables[-1].append(line)
    return tables


def _header(lines: Sequence[str]) -> str:
    """Return the header of a table, without a comment; "" where it is empty."""
    return lines[0].split("#")[0].strip() if lines else ""


def _set(lines: Sequence[str], key: str, value: Any) -> list[str]:
    """Return the lines of a table with a key set; an older line of it is removed."""
    at = int(_header(lines).startswith("["))
    others = [line for line in lines[at:] if not re.match(rf"\s*{key}\s*=", line)]
    return [*lines[:at], f"{key} = {toml_value(value)}", *others]


def _with_calibration(lines: Sequence[str], name: str | None) -> list[str]:
    """Return the lines of the recording itself with another calibration, in metres with z up; the old ones become
    comments.

    name: path of the calibration, relative to the recording.
    Raises: InputError where it is None.
    """
    if name is None:
        raise InputError("There is no refined calibration yet; refine it first.")
    old = re.compile(r"\s*(calibration|calibration_unit|world_up)\s*=")
    kept = [f"# before: {line.strip()}" if old.match(line) else line for line in lines]
    return [f"calibration = {toml_value(name)}", *kept]


_OPEN, _QUALITY = 128 << 20, 85
"""Most bytes of all open recordings, beyond which only the last used one stays open; JPEG quality."""
_EDGE = (70, 60, 255)  # BGR; the same pink as in the report


class Recordings:
    """Recordings that the studio has open; several threads may use it."""

    def __init__(self, catalog: Catalog) -> None:
        self._catalog, self._lock = catalog, threading.Lock()
        self._open: dict[Hashable, OpenRecording] = {}  # the last used one is last

    def load(self, item: Item) -> Recording:
        """Load the recording of an item.

        Raises: InputError names the cause.
        """
        with self.opened(item.path) as opened:
            return opened.recording

    def shown(self, item: Item, results: Sequence[str]) -> dict[str, Any]:
        """Collect the facts about a recording that the page shows.

        results: ids of the recording's results.
        Returns: JSON values.
        """
        made = item.path.with_name(f"{item.path.name}-in-step")
        common = {
            "in_step": self._catalog.id_of("recording", made) if (made / "recording.toml").is_file() else None,
            "id": item.id,
            "path": self._catalog.shown(item.path),
            "results": list(results),
            "board": board_of(item.path),
            "sync": read_found(item.path, "sync.json"),
            "check": read_found(item.path, "check.json"),
            "subject": read_subject(item.path),
            "left_out": _excluded_views(item.path),
            "refined": _unused(item.path),
            "starts": sorted(p.stem for p in (item.path / "starts").glob("*.json")),
        }
        try:
            r = self.load(item)
        except HyposeError as error:
            nothing: dict[str, Any] = {k: [] for k in ("views", "cameras", "notes")}
            nothing |= {"frame_rate": 0.0, "frames": 0, "frame_range": None, "subject_height": None}
            nothing |= {"mask_settings": asdict(SilhouetteSettings()), "next": None, "offsets": None}
            return {**nothing, **common, "name": item.path.name, "problem": str(error)}
        step = next_step(item.path, r)
        return {
            **common,
            "next": step and step[0],
            "offsets": found_offsets(item.path, [v.name for v in r.views]),
            "name": r.name,
            "problem": None,
            "frame_rate": r.frame_rate,
            "frames": r.n_frames,
            "frame_range": r.frame_range,
            "subject_height": r.subject_height,
            "views": [
                {
                    "name": v.name,
                    "camera": c.name,
                    "video": v.source.name if v.source else None,
                    **dict.fromkeys(("background", "masks", "keypoints", "depth")),
                    **{k: p.name for k, p in v.files.items() if k not in ("video", "images")},
                }
                for v, c in zip(r.views, r.rig, strict=True)
            ],
            "cameras": [  # pinhole cameras, which belong to undistorted pictures
                {
                    "name": c.name,
                    "K": c.K,
                    "camera_from_world": c.camera_from_world,
                    "size": list(c.size),
                    "pictures": v.source is not None,
                }
                for v, c in zip(r.views, r.rig, strict=True)
            ],
            "notes": r.notes,
            "mask_settings": asdict(r.silhouettes),
        }

    def picture(
        self, item: Item, camera: str, frame: int, width: int, shown: str, settings: Mapping[str, str]
    ) -> bytes:
        """Encode an undistorted picture as JPEG, with the mask that `settings` (over the recording's own) would give.

        item: the recording.
        camera: its name.
        frame: number of the frame, from 0.
        width: width of the picture, px; at most that of the camera.
        shown: "none", or the mask as "edge", "fill" or "only".
        settings: settings of the mask, texts by their names.
        Raises: NotFound or InputError where there is no such picture.
        """
        with self.opened(item.path) as opened:
            r = opened.recording
            if camera not in r.rig.names:
                raise NotFound(f"{r.name} has no camera {camera[:40]!r}; it has {', '.join(r.rig.names)}.")
            opened.check(frame, width)
            view, options = r.rig.names.index(camera), _with_query(r.silhouettes, settings)
            full = r.rig[view]
            w = min(width, full.size[0])
            small = full.scaled((w, max(1, round(full.size[1] * w / full.size[0])))).pinhole()
            if r.views[view].source is None and shown == "none":
                raise NotFound(f"{camera} has masks only, no pictures.")
            masked = [] if shown == "none" else [opened.mask(view, frame, options)]
            image = opened.undistorted(view, frame, small) if r.views[view].source else None
        for person in masked:
            image = _draw_mask(np.full((*person.shape, 3), 40, np.uint8) if image is None else image, person, shown)
        assert image is not None
        return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()

    def save_settings(self, item: Item, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Write the table [silhouettes] into recording.toml, without a change of other lines; return all settings."""
        options = silhouette_options("The settings", settings)
        path = _description(item.path, self.load(item))
        read_toml(path)
        tables = _tables_of(read_text(path, "a recording.toml"))
        kept = [line for lines in tables if _header(lines) != "[silhouettes]" for line in lines]
        write_text(path, "\n".join(["\n".join(kept).rstrip("\n"), *silhouette_lines(options)]) + "\n")
        return asdict(options)

    @contextlib.contextmanager
    def opened(self, folder: Path, frames: tuple[int, int] | None = None) -> Iterator[OpenRecording]:
        """Open a recording, or return the open one; it stays open while the block runs, and then as long as there is
        memory for it.

        folder: folder of the recording.
        frames: frame of the first row, and the frame after that of the last row; None: all frames.
        """
        key = folder, frames, _stamp(folder)
        opened = self._open.get(key)
        if opened is None:  # reading it may take seconds, which others need not wait for; it opens no video yet
            opened = OpenRecording(load_recording(folder, uncalibrated=uncalibrated(folder)), frames)
        with self._lock:
            opened = self._open.pop(key, opened)
            self._open[key] = opened
            opened.users += 1
        try:
            yield opened
        finally:
            with self._lock:
                opened.users -= 1
                for unused in [k for k, o in self._open.items() if not o.users][:-1]:
                    if sum(o.held for o in self._open.values()) > _OPEN:
                        self._open.pop(unused).close()

    def drop(self) -> None:
        """Close the recordings that are not in use, since some systems cannot move open files."""
        with self._lock:
            for unused in [k for k, o in self._open.items() if not o.users]:
                self._open.pop(unused).close()


def _draw_mask(image: Image, mask: Mask, shown: str) -> Image:
    """Draw a mask, of any size with the same proportions, on a picture.

    image: (h, w, 3) BGR.
    mask: (h2, w2) 0/1.
    shown: "edge", "fill" or "only" (the mask alone, white on black).
    Returns: a new picture (h, w, 3).
    """
    h, w = image.shape[:2]
    whole = np.asarray(cv2.resize(mask * np.uint8(255), (w, h), interpolation=cv2.INTER_LINEAR) > 127, np.uint8)
    if shown == "only":
        return np.repeat((whole * np.uint8(255))[..., None], 3, 2)
    out = image.copy()
    if shown == "fill":
        out[whole > 0] = (0.5 * out[whole > 0] + 0.5 * np.array(_EDGE)).astype(np.uint8)
    outlines: Sequence[NDArray[Any]] = cv2.findContours(whole, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]
    cv2.drawContours(out, outlines, -1, _EDGE, max(2, w // 240), cv2.LINE_AA)
    return out


def _with_query(options: SilhouetteSettings, settings: Mapping[str, str]) -> SilhouetteSettings:
    """Return the options with settings from a query: texts as in JSON, lists as numbers with commas."""
    table: dict[str, Any] = {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(options).items()}
    for key, value in settings.items():
        kind = SILHOUETTE_KEYS.get(key)
        try:
            table[key] = value if kind is str else parse_json(f"[{value}]" if kind is list else value)
        except (ValueError, RecursionError):
            raise InputError(f"The mask setting {key[:40]} cannot be {value[:40]!r}.") from None
    return silhouette_options("The settings", table)


def board_of(folder: Path) -> dict[str, Any] | None:
    """Describe the calibration by a board: cameras with clips of the board (none where they are calibrated from the
    person), whether they are calibrated, and the time (s) of the contact sheet, None without one. None where neither
    applies.
    """
    sheet, names = folder / "results" / "calibration.png", list[str]()
    with contextlib.suppress(HyposeError):
        names = [s.name for s in find_sources(board_files(folder))]
    made = sheet.stat().st_mtime if sheet.is_file() else None
    calibrated = (folder / CALIBRATION).is_file()
    return {"cameras": names, "calibrated": calibrated, "sheet": made} if names or uncalibrated(folder) else None


def _excluded_views(folder: Path) -> list[str]:
    """List the names of the views that were left out of a recording."""
    away = described(folder).get("left_out", [])
    return [str(v.get("name") or v.get("camera")) for v in away if isinstance(v, dict)]


def _unused(folder: Path) -> str | None:
    """Return a refined calibration that the recording does not use yet."""
    found = newest_refined_calibration(folder)
    return found if described(folder).get("calibration") != found else None


def read_subject(folder: Path) -> dict[str, Any] | None:
    """Read stature_m (m) and sizes_cm (cm by name) of the measured person; None where nothing usable was measured."""
    with contextlib.suppress(HyposeError, TypeError, ValueError, KeyError, AttributeError):
        in_cm = {str(k): float(v["cm"]) for k, v in read_toml(folder / "subject" / "subject.toml")["sizes"].items()}
        return {"stature_m": in_cm.get("stature", float("nan")) / 100, "sizes_cm": in_cm}
    return None


def _stamp(folder: Path) -> float:
    """Return a number that changes when the recording's description changes, or the detector has run."""
    names = ("recording.toml", "Config.toml", "calibration.toml", "subject", "keypoints/detector.json")
    return sum(p.stat().st_mtime for n in names if (p := folder / n).exists())
