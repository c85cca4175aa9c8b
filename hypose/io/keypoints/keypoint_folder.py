"""Key points with one file per frame: OpenPose (also of Pose2Sim, RTMLib, AlphaPose), EasyMocap, Ultralytics.

Files are read when they are asked for. Sources: OpenPose's JSON output; EasyMocap (annotator/file_utils.py);
Ultralytics (engine/results.py save_txt): `class x y w h`, then per point x y and, if the model has it, confidence, then
confidence and track id of the person if asked for; positions are shares of the picture, and a frame without people has
no file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hypose.errors import InputError
from hypose.evidence.keypoints import KEYPOINT_SETS, parse_openpose
from hypose.geometry import Array
from hypose.io.calibrations.calibration_toml import natural_key
from hypose.io.files import read_bytes, text_lines
from hypose.io.keypoints.keypoint_json import read_document
from hypose.io.keypoints.keypoint_table import KeypointTable, checked_people, scored_points

_MAX_FILE = 5_000_000
_COUNTS = sorted({len(names) for names in KEYPOINT_SETS.values()})


class _FrameFiles(Mapping[int, Array]):
    """People by frame number, each read from its file when it is asked for."""

    def __init__(self, files: Mapping[int, Path], read: Callable[[Path], Array]) -> None:
        self.files, self._read = files, read

    def __getitem__(self, number: int) -> Array:
        return self._read(self.files[number])

    def __iter__(self) -> Iterator[int]:
        return iter(self.files)

    def __len__(self) -> int:
        return len(self.files)


def read_keypoint_folder(folder: Path) -> KeypointTable:
    """The key points of a folder with one file per frame; an InputError names what cannot be used."""
    files = sorted(folder.glob("*.json"))
    if files:
        numbered = numbered_files(files)
        if "annots" in _first_document(files):
            return KeypointTable("EasyMocap annotations", _FrameFiles(numbered, _easymocap))
        return KeypointTable("OpenPose files", _FrameFiles(numbered, _openpose))
    texts = sorted(folder.glob("*.txt"))
    if texts:
        return _ultralytics(folder, numbered_files(texts))
    raise InputError(
        f"The folder {folder} holds no key points (.json or .txt, one per frame); detect them, or name another folder "
        "or file."
    )


def numbered_files(paths: list[Path]) -> dict[int, Path]:
    """Files by the last number in their names; by order where that does not tell them apart."""
    numbers = []
    for p in paths:
        digits = "".join(c if c.isdigit() and c.isascii() else " " for c in p.stem).split()
        # OpenPose's names end in _keypoints; a number of the view may stand before the frame's
        numbers.append(int(digits[-1]) if digits and len(digits[-1]) <= 15 else -1)
    if len(set(numbers)) < len(numbers) or -1 in numbers:
        return dict(enumerate(sorted(paths, key=lambda p: natural_key(p.name))))
    return dict(zip(numbers, paths, strict=True))


def _first_document(files: list[Path]) -> Mapping[str, Any]:
    document = read_document(files[0])
    if not isinstance(document, Mapping) or not ({"people", "annots"} & document.keys()):
        raise InputError(
            f'{files[0]} is not OpenPose JSON: people[].pose_keypoints_2d (or EasyMocap\'s "annots") is needed; detect '
            "the key points again."
        )
    return document


def _openpose(path: Path) -> Array:
    return parse_openpose(read_bytes(path, "the people of one frame", _MAX_FILE), source=str(path), raw=True)


def _easymocap(path: Path) -> Array:
    document = read_document(path)
    found = document.get("annots") if isinstance(document, Mapping) else None
    if not isinstance(found, list):
        raise InputError(f'{path}: the list "annots" is missing; export the annotations again.')
    people = []
    for person in found:
        points = person.get("keypoints") if isinstance(person, Mapping) else None
        if not isinstance(points, list) or not all(isinstance(p, list) and len(p) == 3 for p in points):
            raise InputError(f"{path}: keypoints must be x, y, score for each point; export the annotations again.")
        if points:
            people.append(points)
    return checked_people(people, str(path))


def _ultralytics(folder: Path, files: dict[int, Path]) -> KeypointTable:
    columns = {len(line.split()) for p in list(files.values())[:100] for line in text_lines_or_none(p)}
    if not columns:
        raise InputError(f"The files in {folder} name nobody; detect people again, or choose another folder.")
    if len(columns) > 1:
        raise InputError(
            f"The files in {folder} have lines of {', '.join(map(str, sorted(columns)))} numbers; write all with the "
            "same settings of save_conf and tracking."
        )
    (width,) = columns
    for per_point, name in ((3, "with confidences"), (2, "without confidences")):
        for extra in (0, 1, 2):  # the person's confidence, its track
            count, rest = divmod(width - 5 - extra, per_point)
            if rest == 0 and count in _COUNTS:
                read = _row_reader(width, count, per_point)
                return KeypointTable(
                    f"Ultralytics labels ({name})",
                    _FrameFiles(files, read),
                    min(1, *files) if files else 1,
                    shares=True,
                    scored=per_point == 3,
                )
    raise InputError(
        f"The files in {folder} have {width} numbers a line, which is no pose of "
        f"{', '.join(map(str, _COUNTS))} points; write labels of a pose model (class x y w h, then the points)."
    )


def text_lines_or_none(path: Path) -> list[str]:
    """The lines with something on them; none for an empty file."""
    if path.stat().st_size == 0:
        return []
    return [line for line in text_lines(path, "a label file of Ultralytics", _MAX_FILE) if line.strip()]


def _row_reader(width: int, count: int, per_point: int) -> Callable[[Path], Array]:
    def read(path: Path) -> Array:
        people = []
        for line in text_lines_or_none(path):
            cells = line.split()
            try:
                values = np.array([float(c) for c in cells])
            except ValueError:
                raise InputError(f"{path} holds something that is not a number; write the labels again.") from None
            if len(values) != width:
                raise InputError(f"{path}: a line has {len(values)} numbers, the others {width}; write them again.")
            points = values[5 : 5 + count * per_point].reshape(count, per_point)
            if np.nanmax(np.abs(points[:, :2])) > 1.5:
                raise InputError(f"{path}: positions must be shares of the picture (0 to 1); write the labels again.")
            people.append(scored_points(points[:, :2], points[:, 2] if per_point == 3 else None, str(path)))
        return checked_people(people, str(path))

    return read
