"""Recordings for the Set up and Click screens: facts, pictures, masks with trial settings, edits of recording.toml, and
folders that become recordings.
"""

from __future__ import annotations

import contextlib
import json
import re
import threading
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.app.reports.result_pictures import jpeg
from hypose.app.studio.catalog import Catalog, Item, NotFound, changed, is_recording
from hypose.app.studio.http import NotNow, object_of, request_choice, text, whole
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
from hypose.app.studio.pictures import OpenRecording
from hypose.calibration.views import find_sources
from hypose.errors import HyposeError, InputError
from hypose.evidence.silhouettes import SilhouetteSettings
from hypose.geometry import Image, Mask
from hypose.io.calibrations.calibration_formats import read_any
from hypose.io.files import natural_key, read_text, read_toml, text_of, toml_lines, toml_text, write_text
from hypose.io.keypoints.read_keypoints import read_keypoints
from hypose.io.recordings.recording import (
    Recording,
    changed_settings,
    load_recording,
    silhouette_options,
    write_recording,
)
from hypose.io.videos.video import IMAGE_ENDINGS, VIDEO_ENDINGS, open_video

# ---- edits ---------------------------------------------------------------------------------------------------------
# Correct faults that a check has found by a change of recording.toml; its other lines stay unchanged. The text is split
# into tables: that of the recording itself, then each [table] with its header.


_KINDS = (
    "accept_scaled", "leave_out", "take_back", "background", "board", "height", "use_refined", "keypoint_lag",
    "keypoint_pixels", "image_shift",
)  # fmt: skip
_VIEW, _AWAY = "[[view]]", "[[left_out]]"
"""Headers of the table of a view, and of one that is left out."""
_REFINED = "results/calibration_refined*.toml"
_BEFORE_TABLE = re.compile(r"(?m)^(?=[ \t]*\[)")
"""Place before a header, at which the text is split."""


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
    tables = _BEFORE_TABLE.split(before)
    match what:
        case "use_refined":
            if (refined := newest_refined_calibration(folder)) is None:
                raise InputError("There is no refined calibration yet; refine it first.")
            # it is in metres with z up
            tables[0] = _set(tables[0], calibration=refined, calibration_unit=None, world_up=None)
        case "take_back":
            tables = [table.replace(_AWAY, _VIEW, 1) if _header(table) == _AWAY else table for table in tables]
        case "keypoint_pixels":
            tables[0] = _set(tables[0], keypoint_pixels="image")
        case "height":
            metres = number_of(asked.get("metres"), "the height of the person (m)", 0.4, 2.8)
            tables[0] = _set(tables[0], subject_height=metres)
        case "keypoint_lag":
            frames = whole(asked.get("frames"), "the frames by which the key points are moved", -10_000, 10_000)
            tables[0] = _set(tables[0], keypoint_lag=frames + (0 if recording is None else recording.keypoint_lag))
        case _:
            _edit_view(tables, read_toml(path).get("view", []), what, asked, recording, folder, catalog)
    write_text(path, "".join(tables))
    if what not in ("height", "board"):
        try:
            load_recording(folder)
        except HyposeError as error:
            write_text(path, before)
            raise InputError(f"That does not repair it: {error}") from None


def _edit_view(
    tables: list[str],
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
    views = [k for k, table in enumerate(tables) if _header(table) == _VIEW]
    if len(views) != len(parsed):
        raise InputError("The views are not written as [[view]] in recording.toml; change it by hand.")
    names = [str(v.get("name") or f"view{k}") for k, v in enumerate(parsed, 1)]
    name = request_choice(asked.get("view"), "view", names)
    number = names.index(name)
    if what == "leave_out":
        if len(names) < 2:
            raise InputError(f"{name} is the only view; a recording needs one.")
        tables[views[number]] = tables[views[number]].replace(_VIEW, _AWAY, 1)
        return
    value: Any = True
    if what == "image_shift":
        old = (0.0, 0.0) if recording is None else recording.views[number].image_shift
        by = (number_of(asked.get(k), f"the shift of the pictures in {k} (px)", -1e4, 1e4) for k in ("x", "y"))
        value = [round(a + b, 1) for a, b in zip(old, by, strict=True)]
    elif what != "accept_scaled":
        room = catalog.inside(text(asked.get("path"), "file of a view", 1000, "choose one"), folder)
        value = (room.relative_to(folder) if room.is_relative_to(folder) else room).as_posix()
    tables[views[number]] = _set(tables[views[number]], **{what: value})


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


def _header(table: str) -> str:
    """Return the header of a table, without a comment; "" for the values of the recording itself."""
    first = table.split("\n")[0].split("#")[0].strip()
    return first if first.startswith("[") else ""


def _set(table: str, **values: Any) -> str:
    """Return a table with keys set, or removed where they are None; the last line of each becomes a comment."""
    keys, at = "|".join(values), table.find("\n") + 1 if _header(table) else 0
    kept = re.sub(rf"(?m)^# before: ({keys}) =.*\n?", "", table[at:])
    new = "".join(f"{line}\n" for line in toml_lines(values))
    return table[:at] + new + re.sub(rf"(?m)^[ \t]*({keys})\s*=", r"# before: \1 =", kept)


_OPEN, _QUALITY = 2, 85
"""Recordings that stay open when they are not used, as their videos need memory; JPEG quality."""
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
        return self.opened(item.path).recording

    def shown(self, item: Item, results: Sequence[str]) -> dict[str, Any]:
        """Collect the facts about a recording that the page shows.

        results: ids of the recording's results.
        Returns: JSON values.
        """
        made, said = item.path.with_name(f"{item.path.name}-in-step"), described(item.path)
        refined, away = newest_refined_calibration(item.path), said.get("left_out", [])
        common = {
            "in_step": self._catalog.id_of("recording", made) if (made / "recording.toml").is_file() else None,
            "id": item.id,
            "path": self._catalog.shown(item.path),
            "results": list(results),
            "board": board_of(item.path),
            "sync": read_found(item.path, "sync.json"),
            "check": read_found(item.path, "check.json"),
            "subject": read_subject(item.path),
            "left_out": [str(v.get("name") or v.get("camera")) for v in away if isinstance(v, dict)],
            "refined": refined if said.get("calibration") != refined else None,
            "starts": sorted(p.stem for p in (item.path / "starts").glob("*.json")),
        }
        try:
            r = self.load(item)
        except HyposeError as error:
            return {
                **common,
                **dict.fromkeys(("views", "cameras", "notes"), []),
                **dict.fromkeys(("frame_range", "subject_height", "next", "offsets")),
                **dict.fromkeys(("frame_rate", "frames"), 0),
                "mask_settings": asdict(SilhouetteSettings()),
                "name": item.path.name,
                "problem": str(error),
            }
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

    def picture(self, item: Item, camera: str, frame: int, width: int, shown: str, settings: str | None) -> bytes:
        """Encode an undistorted picture as JPEG, with the mask that `settings` would give.

        item: the recording.
        camera: its name.
        frame: number of the frame, from 0.
        width: width of the picture, px; at most that of the camera.
        shown: "none", or the mask as "edge", "fill" or "only".
        settings: JSON object of the settings of the mask; None: those of the recording.
        Raises: NotFound or InputError where there is no such picture.
        """
        opened = self.opened(item.path)
        r = opened.recording
        if camera not in r.rig.names:
            raise NotFound(f"{r.name} has no camera {camera[:40]!r}; it has {', '.join(r.rig.names)}.")
        opened.check(frame, width)
        view, options = r.rig.names.index(camera), r.silhouettes
        if settings is not None:
            options = silhouette_options("The settings", object_of(settings, "value of settings"))
        full, pictured = r.rig[view], r.views[view].source is not None
        w = min(width, full.size[0])
        small = full.scaled((w, max(1, round(full.size[1] * w / full.size[0])))).pinhole()
        if shown == "none" and not pictured:
            raise NotFound(f"{camera} has masks only, no pictures.")
        grey = np.full((*small.size[::-1], 3), 40, np.uint8)
        image = opened.undistorted(view, frame, small) if pictured else grey
        if shown != "none":
            image = _draw_mask(image, opened.mask(view, frame, options), shown)
        return jpeg(image, w, _QUALITY)

    def save_settings(self, item: Item, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Write the table [silhouettes] into recording.toml, without a change of other lines; return all settings."""
        options = silhouette_options("The settings", settings)
        path = _description(item.path, self.load(item))
        read_toml(path)
        tables = _BEFORE_TABLE.split(read_text(path, "a recording.toml"))
        kept = "".join(table for table in tables if _header(table) != "[silhouettes]")
        changed = changed_settings(options)
        added = [toml_text({"silhouettes": changed})] if changed else []
        write_text(path, "\n".join([kept.rstrip("\n") + "\n", *added]))
        return asdict(options)

    def opened(self, folder: Path, frames: tuple[int, int] | None = None) -> OpenRecording:
        """Open a recording, or return the open one; the last ones that were used stay open.

        folder: folder of the recording.
        frames: frame of the first row, and the frame after that of the last row; None: all frames.
        """
        key = folder, frames, _stamp(folder)
        opened = self._open.get(key)
        if opened is None:  # reading it may take seconds, which others need not wait for; it opens no video yet
            opened = OpenRecording(load_recording(folder, uncalibrated=uncalibrated(folder)), frames)
        with self._lock:
            opened = self._open[key] = self._open.pop(key, opened)
            old = [self._open.pop(k) for k in list(self._open)[:-_OPEN]]
        for one in old:  # where it is still in use, it opens what it needs again
            one.close()
        return opened

    def close(self) -> None:
        """Close all recordings, since some systems cannot move open files; they open again when they are used."""
        for one in list(self._open.values()):
            one.close()


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


def board_of(folder: Path) -> dict[str, Any] | None:
    """Describe the calibration by a board: cameras with clips of the board (none where they are calibrated from the
    person), whether they are calibrated, and the time (s) of the contact sheet, None without one. None where neither
    applies.
    """
    sheet, names = changed(folder / "results" / "calibration.png"), list[str]()
    with contextlib.suppress(HyposeError):
        names = [s.name for s in find_sources(board_files(folder))]
    calibrated = (folder / CALIBRATION).is_file()
    return {"cameras": names, "calibrated": calibrated, "sheet": sheet} if names or uncalibrated(folder) else None


def read_subject(folder: Path) -> dict[str, Any] | None:
    """Read stature_m (m) and sizes_cm (cm by name) of the measured person; None where nothing usable was measured."""
    with contextlib.suppress(HyposeError, TypeError, ValueError, KeyError, AttributeError):
        in_cm = {str(k): float(v["cm"]) for k, v in read_toml(folder / "subject" / "subject.toml")["sizes"].items()}
        return {"stature_m": in_cm.get("stature", float("nan")) / 100, "sizes_cm": in_cm}
    return None


def _stamp(folder: Path) -> float:
    """Return a number that changes when the recording's description changes, or the detector has run."""
    names = ("recording.toml", "Config.toml", "calibration.toml", "subject", "keypoints/detector.json")
    return sum(changed(folder / name) or 0.0 for name in names)


# ---- folders -------------------------------------------------------------------------------------------------------
# List folders of this computer for the page, and make a folder a recording by writing its recording.toml.


_MOST_LISTED, _DEPTH = 60, 3
"""Most files of a folder that are listed, and depth of subfolders that are searched."""
_SERIES = 3
"""Number of pictures or key-point files in a folder from which they count as the frames of one camera."""
_CALIBRATION_ENDINGS = (".toml", ".yml", ".yaml", ".xml")
_TABLE_ENDINGS = (".json", ".csv", ".npy", ".npz", ".txt", ".pickle")
_LARGEST_CALIBRATION = 20 << 20
_PICTURE_PX = 320
_SETTINGS = ("calibration_unit", "world_up", "frame_rate", "subject_height")
_ROLES = ("video", "background", "masks", "keypoints", "board")


def list_folder(catalog: Catalog, folder: Path, within: bool) -> dict[str, Any]:
    """List the content of a folder for the page.

    catalog: items of the served folder.
    within: whether to list the files in and below the folder too.
    Returns: JSON values with the subfolders and, with `within`, the files that can be part of a recording, each with
        relative path and kind.
    """
    entries = _entries(folder)
    found = list(_usable(entries, _DEPTH)) if within else []
    facts = [(p, _facts(p)) for p in found[:_MOST_LISTED]]
    return {
        "name": text_of(folder.name),
        "path": catalog.shown(folder) if folder != catalog.root else "",
        "recording": catalog.id_of("recording", folder) if is_recording(folder) else None,
        "folders": [{"name": text_of(p.name), "path": catalog.shown(p)} for p in entries if p.is_dir()],
        "files": [{"path": text_of(p.relative_to(folder).as_posix()), **f} for p, f in facts if f],
        "left_out": max(0, len(found) - _MOST_LISTED),
    }


def first_picture(catalog: Catalog, where: str) -> bytes:
    """Read the first picture of a video, an image or a folder of images as a small JPEG.

    catalog: catalog of the served folder.
    where: path in it.
    """
    with open_video(catalog.inside(where)) as reader:
        return jpeg(reader.read(0), _PICTURE_PX)


def make_recording(catalog: Catalog, wanted: Mapping[str, Any]) -> Path:
    """Write recording.toml into a folder as a page requests it (docs/studio-protocol.md); its files stay in place.

    A recording without a calibration, whose cameras are found later from a board or the person, is not checked further.
    catalog: catalog of the served folder.
    wanted: the request: folder, name, views, calibration and settings.
    Returns: the folder.
    Raises: InputError or NotNow where it cannot be used; then nothing is left behind.
    """
    folder = catalog.inside(text(wanted.get("folder"), "folder", 1000, "choose one"))
    target = folder / "recording.toml"
    if target.exists():
        raise NotNow(f"{folder.name} is a recording already; choose it in the list of recordings.")
    views = wanted.get("views")
    if not isinstance(views, list) or not views or not all(isinstance(v, dict) for v in views):
        raise InputError("A recording needs at least one video; choose a folder that holds one.")
    calibration, boards = wanted.get("calibration"), [v for v in views if v.get("board") is not None]
    cameras = [text(v.get("camera"), "camera of a video", 200, "choose it") for v in views]
    if calibration is None and boards:
        cameras = [s.name for s in find_sources([_placed(catalog, folder, v, "board") for v in views])]
    calibration = text(CALIBRATION if calibration is None else calibration, "calibration", 1000, "choose one")
    said = {k: wanted[k] for k in _SETTINGS if isinstance(wanted.get(k), str | int | float)}
    head = {"name": text(wanted.get("name"), "name", 80, "give one"), "calibration": calibration, **said}
    tables = []
    for view, camera in zip(views, cameras, strict=True):
        table = {"name": text(view.get("name"), "name of a view", 200, "give one"), "camera": camera}
        table |= {"accept_scaled": True} if view.get("accept_scaled") is True else {}
        for role in (r for r in _ROLES if view.get(r) is not None):
            path = _placed(catalog, folder, view, role)
            key = "images" if role == "video" and path.is_dir() else role
            table[key] = path.relative_to(folder).as_posix()
        tables.append(table)
    write_text(target, toml_text({**head, "view": tables}))
    try:
        if wanted.get("calibration") is not None:
            catalog.inside(calibration, folder)
            load_recording(folder)
    except HyposeError as error:
        target.unlink()
        raise InputError(str(error).replace(f"{folder}/", "")) from None
    return folder


def _placed(catalog: Catalog, folder: Path, view: Mapping[str, Any], role: str) -> Path:
    """Resolve the file of a view, which must lie in its recording's folder.

    catalog: catalog of the served folder.
    folder: folder of the recording.
    view: view of the request.
    role: key of the file in it, one of _ROLES.
    """
    path = catalog.inside(text(view.get(role), f"{role} of {view.get('camera')}", 1000, "choose one"), folder)
    if not path.is_relative_to(folder):
        raise InputError(f"{path.name} does not lie in {folder.name}; choose a folder that holds all files.")
    return path


def _entries(folder: Path) -> list[Path]:
    """List a folder in natural order, without hidden files and links."""
    try:
        found = [p for p in folder.iterdir() if not p.name.startswith(".") and not p.is_symlink()]
    except OSError as error:
        raise InputError(f"{folder.name} cannot be read ({(error.strerror or str(error)).lower()}).") from None
    return sorted(found, key=lambda p: natural_key(p.name))


def _usable(entries: list[Path], depth: int) -> Iterator[Path]:
    """Yield files, and folders with a file per frame, that can be part of a recording; other recordings are skipped.

    entries: entries of a folder.
    depth: number of levels of subfolders that are searched.
    """
    for path in entries:
        if path.is_dir() and path.name != "results":
            below = _entries(path)
            if any(sum(p.suffix.lower() in e for p in below) >= _SERIES for e in (IMAGE_ENDINGS, (".json",))):
                yield path
            elif depth and not is_recording(path):
                yield from _usable(below, depth - 1)
        elif path.suffix.lower() in (*VIDEO_ENDINGS, *IMAGE_ENDINGS, *_CALIBRATION_ENDINGS, *_TABLE_ENDINGS):
            yield path


def _facts(path: Path) -> dict[str, Any] | None:
    """Inspect a file and describe it; None for a file that cannot be part of a recording."""
    ending, pictures = path.suffix.lower(), path.is_dir() and not any(path.glob("*.json"))
    try:
        if pictures or ending in VIDEO_ENDINGS + IMAGE_ENDINGS:
            kind = "images" if pictures else "video" if ending in VIDEO_ENDINGS else "image"
            with open_video(path) as reader:
                return {
                    "kind": kind,
                    "size": list(reader.size),
                    "frames": reader.n_frames,
                    "frame_rate": reader.frame_rate,
                }
        if path.is_dir() or ending in _TABLE_ENDINGS:
            with contextlib.suppress(HyposeError):
                if frames := max((len(t.people) for t in read_keypoints(path).values()), default=0):
                    return {"kind": "keypoints", "frames": frames}
        if path.is_file() and path.stat().st_size <= _LARGEST_CALIBRATION:
            return {"kind": "calibration", "cameras": list(read_any(path)[0].names)}
    except HyposeError as error:
        if ending not in _TABLE_ENDINGS:
            return {"kind": "other", "problem": str(error).replace(f"{path.parent}/", "")}
    return None
