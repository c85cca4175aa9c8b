"""List folders of this computer for the page, and make a folder a recording by writing its recording.toml."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hypose.app.reports.result_pictures import jpeg
from hypose.app.studio.catalog import Catalog, is_recording
from hypose.app.studio.http import NotNow, text
from hypose.app.studio.job_kinds import CALIBRATION
from hypose.calibration.views import find_sources
from hypose.errors import HyposeError, InputError
from hypose.io.calibrations.calibration_formats import read_any
from hypose.io.file_names import natural_key, text_of
from hypose.io.files import toml_lines, write_text
from hypose.io.keypoints.read_keypoints import read_keypoints
from hypose.io.recordings.recording import load_recording
from hypose.io.videos.video import IMAGE_ENDINGS, VIDEO_ENDINGS, open_video

_MOST_LISTED, _DEPTH = 60, 3
"""Most files of a folder that are listed, and depth of subfolders that are searched."""
_SERIES = 3
"""Number of pictures or key-point files in a folder from which they count as the frames of one camera."""
_CALIBRATION_ENDINGS = (".toml", ".yml", ".yaml", ".xml")
_TABLE_ENDINGS = (".json", ".csv", ".h5", ".hdf5", ".npy", ".npz", ".txt", ".pickle")
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
        missing = [c for c, v in zip(cameras, views, strict=True) if v not in boards]
        if missing:
            raise InputError(f"There is no clip of the board of {missing[0]}; add it, or a calibration of all cameras.")
        cameras = [s.name for s in find_sources([_placed(catalog, folder, v, "board") for v in views])]
    calibration = text(CALIBRATION if calibration is None else calibration, "calibration", 1000, "choose one")
    said = {k: wanted[k] for k in _SETTINGS if isinstance(wanted.get(k), str | int | float)}
    head = {"name": text(wanted.get("name"), "name", 80, "give one"), "calibration": calibration, **said}
    lines = toml_lines(head)
    for view, camera in zip(views, cameras, strict=True):
        table = {"name": text(view.get("name"), "name of a view", 200, "give one"), "camera": camera}
        table |= {"accept_scaled": True} if view.get("accept_scaled") is True else {}
        for role in (r for r in _ROLES if view.get(r) is not None):
            path = _placed(catalog, folder, view, role)
            key = "images" if role == "video" and path.is_dir() else role
            table[key] = path.relative_to(folder).as_posix()
        lines += ["", "[[view]]", *toml_lines(table)]
    write_text(target, "\n".join(lines) + "\n")
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
    path = catalog.inside(text(view.get(role), role, 1000, "choose one"), folder)
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
