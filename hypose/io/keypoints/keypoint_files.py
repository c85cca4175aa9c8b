"""Key-point files: the table of their formats, and the readers.

To add a format, write a reader and enter it in `KEYPOINTS`. A reader takes a `Source` and returns a KeypointTable, or
one for each camera of the file. New points need a set in `hypose.evidence.keypoints.KEYPOINT_SETS`.

Sources of the CSV layouts (those of the others are above their readers):
DeepLabCut: CSV of analysed videos, with three header lines scorer, bodyparts, coords; four with individuals.
Ensemble Kalman smoother (eks): the same layout with x_ens_var, x_posterior_var and so on next to x, y, likelihood.
SLEAP: analysis CSV with track, frame_idx, instance.score, then node.x, node.y, node.score.
Caliscope: xy_<tracker>.csv with sync_index, cam_id (port in old files), frame_index, frame_time, point_id (keypoint_id
    in new files), img_loc_x, img_loc_y, ...; one row per detected point, in pixels of the camera's picture, without
    scores.
"""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hypose.errors import InputError, extra
from hypose.evidence.keypoints import BLAZEPOSE_33, KEYPOINT_SETS
from hypose.geometry import Array
from hypose.io.calibrations.calibration_formats import read_plain_pickle
from hypose.io.file_names import last_number
from hypose.io.files import csv_rows, numbers_of, open_file, read_bytes, read_json, readable_size, text_lines
from hypose.io.formats import Format, FormatTable, Source
from hypose.io.motions.results import parse_array
from hypose.json_text import parse_json

# ---- keypoint table ------------------------------------------------------------------------------------------------
# The table that every reader of 2D key points returns for one camera, and common checks of numbers from files.


MAX_BYTES = 512 * 2**20
MAX_POINTS = 1000
MAX_POINT_FRAMES = 5_000_000
# Score below which tracking ignores a point.
_MIN_SCORE = 0.3
WEIGHED = 0.31
_SAMPLED = 60


@dataclass(frozen=True)
class KeypointTable:
    """Key points of one camera as a file gives them.

    layout: kind of file, for messages.
    people: (P, K, 3) per frame, by the file's own frame number: u, v, score >= 0; score 0 where a point is missing. K
        is the same in all frames with people.
    first: the file's number of the video's first frame; None where the layout does not define it, and then the smallest
        number of all views is used.
    names: names of the K points, where the file gives them.
    shares: positions are shares of the picture's width and height, not px.
    scored: the file has scores.
    spread: the scores come from standard deviations in the file (`scores_from_variance`).
    frame_rate: frames/s, where the file gives it.
    timed: frames are numbered as `VideoReader` counts them when it reads by time stamps.
    """

    layout: str
    people: Mapping[int, Array]
    first: int | None = None
    names: tuple[str, ...] | None = None
    shares: bool = False
    scored: bool = True
    spread: bool = False
    frame_rate: float | None = None
    timed: bool = False

    def sample(self) -> Array:
        """Collect the key points (N, K, 3) of all N people in at most 60 frames, evenly spread.

        Returns: u, v, score of each point; an array (0, 0, 3) where there are no people.
        """
        numbers = sorted(self.people)
        # every 60th part of the file gives one frame, its first with a person
        parts = np.array_split(np.array(numbers), min(_SAMPLED, max(1, len(numbers))))
        firsts = (next((p for n in part.tolist()[:200] if len(p := self.people[n])), None) for part in parts)
        found = [p for p in firsts if p is not None]
        if len({p.shape[1] for p in found}) > 1:
            raise InputError("people have different numbers of key points; export one model's.")
        return np.concatenate(found) if found else np.zeros((0, 0, 3))


def checked_people(values: Any, where: str) -> Array:
    """Convert nested numbers to key points (P, K, 3) float64.

    Points that are at (0, 0), not finite or without a score become missing (all 0).

    where: file and frame, for the error messages.
    Raises: InputError where the values are not key points.
    """
    with numbers_of(where):
        p = np.array(values, dtype=np.float64)
    if p.size == 0:
        return np.zeros((0, 0, 3))
    if p.ndim != 3 or p.shape[2] != 3 or not 1 <= p.shape[1] <= MAX_POINTS:
        raise InputError(f"{where}: key points have the shape {p.shape}, people x points x 3 is needed; export again.")
    if np.isinf(p).any():
        raise InputError(f"{where}: a key point is infinite; export it again.")
    missing = ~np.isfinite(p).all(-1) | ~(np.nan_to_num(p[..., 2]) > 0) | (p[..., :2] == 0).all(-1)
    return np.where(missing[..., None], 0.0, p)


def parse_openpose(document: str | bytes | Mapping[str, Any], source: str = "The key-point file") -> Array:
    """Read the people of one OpenPose-style JSON document.

    source: name of the file in error messages.
    Returns: (P, K, 3) u px, v px, score. A point at (0, 0), or without finite position and score, is missing: 0.
    Raises: InputError where it is no such document.
    """
    if isinstance(document, (str, bytes)):
        try:
            document = parse_json(document)
        except (ValueError, RecursionError) as problem:
            raise InputError(f"{source} is not JSON ({problem}); export it from the detector again.") from None
    found = document.get("people") if isinstance(document, Mapping) else None
    found = [] if found == {} else found  # some writers write an empty list so
    if not isinstance(found, list):
        raise InputError(
            f'{source} is not an OpenPose-style file: it needs a list "people"; export key points in the OpenPose '
            "format."
        )
    people = []
    for number, person in enumerate(found):
        keys = ("pose_keypoints_2d", "pose_keypoints")  # the latter: OpenPose 1.0
        flat = next((person[k] for k in keys if k in person), None) if isinstance(person, Mapping) else None
        if flat is None and person != {}:
            raise InputError(f'{source}, person {number}: "pose_keypoints_2d" is missing; export body key points.')
        try:
            values = np.array([] if flat is None else flat, dtype=np.float64).reshape(-1, 3)
        except (TypeError, ValueError):
            raise InputError(
                f'{source}, person {number}: "pose_keypoints_2d" must hold numbers only, three for each point; export '
                "it again."
            ) from None
        people += [values] if len(values) else []
    if len({len(p) for p in people}) > 1:
        raise InputError(f"{source}: the people have different numbers of key points.")
    return checked_people(people, source)


def scores_from_variance(points: Array, variance: Array) -> Array:
    """Replace the scores of points by weights from their variances.

    The weight is 1 for points at least as certain as the median point. For others it is the ratio of the median
    variance to their own, but at least `WEIGHED`, which distinguishes them from missing points. Points without a
    variance keep their scores.

    points: (..., 3) u, v, score.
    variance: (..., 2) of u and v, px^2.
    Returns: (..., 3).
    """
    given = np.isfinite(variance).all(-1) & (variance > 0).all(-1) & (points[..., 2] > _MIN_SCORE)
    if not given.any():
        return points
    spread = variance.mean(-1)
    share = np.clip(np.median(spread[given]) / np.where(given, spread, 1.0), WEIGHED, 1.0)
    out = points.copy()
    out[..., 2] = np.where(given, share, points[..., 2])
    return out


def scored_points(positions: Any, scores: Any, where: str) -> Array:
    """Combine the positions and scores of one person's key points.

    positions: (K, 2 to 4); u and v are the first two columns.
    scores: (K,); None: all are 1.
    where: file and frame, for the error messages.
    Returns: (K, 3) u, v, score.
    Raises: InputError where they are not numbers of this shape.
    """
    with numbers_of(where):
        xy = np.array(positions, dtype=np.float64)
        s = np.ones(len(xy)) if scores is None else np.array(scores, dtype=np.float64).ravel()
    if xy.ndim != 2 or not 2 <= xy.shape[1] <= 4 or not 1 <= len(xy) <= MAX_POINTS:
        raise InputError(f"{where}: key points have the shape {xy.shape}, points x 2 is needed; export them again.")
    if len(s) != len(xy):
        raise InputError(f"{where}: {len(xy)} key points but {len(s)} scores; export them again.")
    return np.column_stack([xy[:, :2], s])


def grouped(rows: Sequence[tuple[int, Array]], where: str) -> dict[int, Array]:
    """Group people (K, 3) by frame number.

    rows: frame number and points of each person, in any order.
    where: file, for the error messages.
    Returns: (P, K, 3) by frame number.
    Raises: InputError where people differ in the number of points.
    """
    counts = {len(points) for _, points in rows}
    if len(counts) > 1:
        raise InputError(
            f"{where}: people have {', '.join(map(str, sorted(counts)))} key points; export those of one model."
        )
    stacked = checked_people([points for _, points in rows], where)
    out: dict[int, list[Array]] = {}
    for (number, _), points in zip(rows, stacked, strict=True):
        out.setdefault(number, []).append(points)
    return {n: np.stack(p) for n, p in out.items()}


def whole_number(value: Any, where: str, what: str) -> int:
    """Check that a value is a frame number and return it.

    where, what: file and name of the value, for the error message.
    Raises: InputError where it is not a whole number.
    """
    fine = isinstance(value, int | float) and not isinstance(value, bool) and float(value).is_integer()
    if not fine or not 0 <= value < 2**40:
        raise InputError(f"{where}: {what} is {str(value)[:40]!r}, a whole number is needed; export it again.")
    return int(value)


# Columns of variances, px^2, by the ensemble Kalman smoother of Lightning Pose; the better ones first.
_VARIANCES = (("x_posterior_var", "y_posterior_var"), ("x_ens_var", "y_ens_var"))


def deeplabcut_table(
    columns: Sequence[tuple[str, ...]], numbers: Sequence[int], values: Array, where: str
) -> KeypointTable:
    """Build the table of key points from DeepLabCut's columns.

    columns: individual ("" where there is one), body part and coordinate (x, y, likelihood, ...) of each column.
    numbers: (T,) number of each frame.
    values: (T, columns) px and likelihoods.
    where: file, for messages.
    Points that are no parts of an individual are left out. Where all points have variances, they weigh the points.
    """
    parts: dict[str, dict[str, dict[str, int]]] = {}
    for i, (individual, part, coordinate) in enumerate(columns):
        parts.setdefault(individual, {}).setdefault(part, {})[coordinate] = i
    for part, at in ((part, at) for own in parts.values() for part, at in own.items()):
        if not {"x", "y", "likelihood"} <= at.keys():
            raise InputError(f"{where}: {part} lacks x, y or likelihood; analyse the video again.")
    if not parts or not 0 < len(numbers) <= MAX_POINT_FRAMES:
        raise InputError(f"{where} has {len(parts)} individuals and {len(numbers)} frames; analyse the video again.")
    names = tuple(max(parts.values(), key=len))
    people = [own for own in parts.values() if own.keys() == set(names)]  # not the single points
    found = [set(at) for own in parts.values() for at in own.values()]
    variances = next((v for v in _VARIANCES if all(set(v) <= at for at in found)), ())
    wanted = ("x", "y", "likelihood", *variances)
    whole = values[:, np.array([[[own[n][c] for c in wanted] for n in names] for own in people])]  # (T, P, K, 3 or 5)
    points = scores_from_variance(whole[..., :3], whole[..., 3:]) if variances else whole
    return KeypointTable(
        "DeepLabCut", _people_of_frames(numbers, points, where), min(numbers), names, spread=bool(variances)
    )


def _people_of_frames(numbers: Iterable[int], points: Array, where: str) -> dict[int, Array]:
    """Check the key points (T, P, K, 3) of numbered frames; people without any detected point are left out."""
    checked = {n: checked_people(row, f"{where}, frame {n}") for n, row in zip(numbers, points, strict=True)}
    return {n: people[(people[..., 2] > 0).any(1)] if people.size else people for n, people in checked.items()}


def _deeplabcut(source: Source) -> KeypointTable:
    first, rows = csv_rows(source.path, source.kind, MAX_BYTES)
    head = {"individuals": [""] * (len(first) - 1)}
    numbers: list[int] = []
    values: list[list[float]] = []
    for _, row in rows:
        if row[0] in ("individuals", "bodyparts", "coords"):
            head[row[0]] = row[1:]
            continue
        at = f"{source.path}, frame {row[0][:20]}"
        with numbers_of(at):
            numbers.append(whole_number(float(row[0]), at, "the frame's number"))
            values.append([float(c or "nan") for c in row[1:]])
    columns = list(zip(head["individuals"], head["bodyparts"], head["coords"], strict=True))
    return deeplabcut_table(columns, numbers, np.array(values), str(source.path))


def _rows_of(path: Path, kind: str, columns: Sequence[str]) -> Array:
    """Read the given columns of a CSV file as numbers (rows, columns); NaN for empty cells."""
    header, rows = csv_rows(path, kind, MAX_BYTES)
    with numbers_of(str(path)):
        at = [{name: i for i, name in enumerate(header)}[c] for c in columns]
    values: list[list[float]] = []
    for line, row in rows:
        with numbers_of(f"{path}, row {line}"):
            values.append([float(row[i] or "nan") for i in at])
    return np.array(values).reshape(-1, len(at))


def _sleap(source: Source) -> KeypointTable:
    names = [h[:-2] for h in source.header if h.endswith(".x") and not h.startswith("instance.")][:MAX_POINTS]
    scored = all(f"{n}.score" in source.header for n in names)
    where, parts = str(source.path), ("x", "y", "score") if scored else ("x", "y")
    values = _rows_of(source.path, source.kind, ["frame_idx", *(f"{n}.{c}" for n in names for c in parts)])
    points = values[:, 1:].reshape(len(values), len(names), len(parts))
    points = points if scored else np.concatenate([points, np.ones((*points.shape[:2], 1))], -1)
    found = [(whole_number(n, where, "frame_idx"), p) for n, p in zip(values[:, 0].tolist(), points, strict=True)]
    # frames without a person have no row, and SLEAP counts from 0
    return KeypointTable("SLEAP analysis", grouped(found, where), 0, tuple(names), scored=scored)


def _caliscope(source: Source) -> dict[str, KeypointTable]:
    path, where, header = source.path, str(source.path), source.header
    camera, point = ("cam_id" if "cam_id" in header else "port", "point_id" if "point_id" in header else "keypoint_id")
    values = _rows_of(path, source.kind, [camera, "sync_index", point, "img_loc_x", "img_loc_y"])
    if not len(values):
        raise InputError(f"{where} holds no points; run the tracker again.")
    seen: dict[int, dict[int, dict[int, tuple[float, float]]]] = {}
    for *numbers, x, y in values.tolist():
        name, number, identity = (whole_number(n, where, "a number of camera, frame or point") for n in numbers)
        seen.setdefault(name, {}).setdefault(number, {})[identity] = (x, y)
    order = _point_order(path.stem.lower(), set(values[:, 2].astype(int).tolist()))
    numbers, rate = _clock(path)
    first = _first_frame([n for frames in seen.values() for n in frames], numbers, where)
    out = {}
    for name, frames in sorted(seen.items()):
        listed = [
            (n, np.array([(*points[i], 1.0) if i in points else (0, 0, 0) for i in order], dtype=np.float64))
            for n, points in frames.items()
        ]
        names = BLAZEPOSE_33 if len(order) == 33 else None
        people = grouped(listed, where)
        out[str(name)] = KeypointTable("Caliscope points", people, first, names, scored=False, frame_rate=rate)
    return out


def _first_frame(shown: Sequence[int], numbers: Sequence[int], where: str) -> int:
    """Determine the sync_index of the recording's first frame.

    shown: sync indices of all frames with points.
    numbers: the recording's own sync indices. Older versions count the points from 0, although the recording's times
        continue those of the calibration.
    """
    low, high = min(shown), max(shown)
    if not numbers:
        return low
    if numbers[0] <= low and high <= numbers[-1]:
        return numbers[0]
    if high <= numbers[-1] - numbers[0]:
        return 0
    raise InputError(
        f"{where}: its sync_index goes from {low} to {high}, the recording's times from {numbers[0]} to {numbers[-1]}; "
        "the two are of different recordings: copy the right table of times, or remove it."
    )


def _point_order(stem: str, ids: set[int]) -> list[int]:
    """Order the ids of points as in a key-point set.

    stem: name of the file without its ending, in lower case, which holds the tracker's name.
    ids: ids of all points in the file.

    MediaPipe's trackers number the body 0 to 32, the right hand from 100 and the left hand from 200. SIMPLE_HOLISTIC
    has no wrists but those of the hands.
    """
    if "holistic" in stem or "pose" in stem and "rtm" not in stem or max(ids) >= 200:
        order = list(range(33))
        order[15] = 15 if 15 in ids else 200
        order[16] = 16 if 16 in ids else 100
        return order
    return list(range(133 if max(ids) > 32 else 33 if max(ids) > 25 else 26 if max(ids) > 16 else 17))


def clock_file(path: Path) -> Path | None:
    """Find Caliscope's table of times next to its points or one folder above; None where there is none."""
    names = ("timestamps.csv", "frame_timestamps.csv", "frametimes.csv", "frame_time_history.csv")
    places = (folder / name for folder in (path.parent, path.parent.parent) for name in names)
    return next((p for p in places if p.is_file()), None)


def _clock(path: Path) -> tuple[list[int], float | None]:
    """Read the recording's sync indices and frame rate from its table of times."""
    table = clock_file(path)
    if table is None:
        return [], None
    times: dict[int, list[float]] = {}
    for number, time in _rows_of(table, "Caliscope's table of times", ["sync_index", "frame_time"]).tolist():
        times.setdefault(whole_number(number, str(table), "sync_index"), []).append(time)
    numbers = sorted(times)
    if len(numbers) > 1 and np.diff(numbers).max() > 10 + len(numbers) // 10:
        raise InputError(f"{table}: its sync_index jumps from one frame to another; copy the file again.")
    steps = np.diff([np.mean(times[n]) for n in numbers]) / np.maximum(np.diff(numbers), 1)
    rate = float(1 / np.median(steps)) if len(steps) and np.median(steps) > 0 else None
    return numbers, rate


# ---- keypoint json -------------------------------------------------------------------------------------------------
# Key points of a whole video in one JSON file: MMPose, COCO results and annotations, AlphaPose.
#
# Sources: MMPose 1.3 (structures/utils.py split_instances, demo/topdown_demo_with_mmdet.py, whose frames count from 1;
# apis/inferencers, whose frames count from 0); AlphaPose (utils/pPose_nms.py write_json); the COCO result format.


def read_document(path: Path) -> Any:
    """Read the value of a JSON file of limited size; InputError where it cannot be read."""
    return read_json(path, "a file or folder of key points", MAX_BYTES)


def _lists(source: Source, key: str) -> bool:
    """Test whether a document is a table with a list of this name."""
    return isinstance(source.document, Mapping) and isinstance(source.document.get(key), list)


def _all_hold(source: Source, *keys: str) -> bool:
    """Test whether a document is a list, or a table that is not empty, of tables with one of the keys."""
    document = source.document
    found = list(document.values()) or [None] if isinstance(document, Mapping) else document
    return isinstance(found, list) and all(isinstance(v, Mapping) and v.keys() & set(keys) for v in found)


def _mmpose(source: Source) -> KeypointTable:
    document, where = source.document, str(source.path)
    frames, meta = (
        (document["instance_info"], document.get("meta_info")) if isinstance(document, dict) else (document, None)
    )
    rows: list[tuple[int, Array]] = []
    numbers: list[int] = []
    scored = True
    for i, frame in enumerate(frames):
        with numbers_of(f"{where}, entry {i}"):
            numbers.append(number := whole_number(frame.get("frame_id", i), f"{where}, entry {i}", "frame_id"))
            for person in frame["instances"]:
                scores = person.get("keypoint_scores")
                scored = scored and scores is not None
                rows.append((number, scored_points(person["keypoints"], scores, f"{where}, frame {number}")))
    people = dict.fromkeys(numbers, np.zeros((0, 0, 3))) | grouped(rows, where)
    kind = "MMPose results" if meta is not None else "MMPose predictions"
    # all frames are listed, so the smallest number is the first frame's
    return KeypointTable(kind, people, min(numbers, default=0), _names_of_meta(meta), scored=scored)


def _names_of_meta(meta: Any) -> tuple[str, ...] | None:
    """Get the names of the points from MMPose's meta_info; None where they are not all there."""
    table = meta.get("keypoint_id2name") if isinstance(meta, Mapping) else None
    if not isinstance(table, Mapping) or not all(isinstance(v, str) for v in table.values()):
        return None
    names = [table.get(str(i)) for i in range(len(table))]
    return tuple(n for n in names if n is not None) if all(names) else None


def _coco(source: Source) -> KeypointTable:
    document, where = source.document, str(source.path)
    found, images = (
        (document["annotations"], document.get("images")) if isinstance(document, dict) else (document, None)
    )
    numbers = _image_numbers(images)
    rows: list[tuple[int, Array]] = []
    for i, person in enumerate(found):
        at = f"{where}, entry {i}"
        with numbers_of(at):
            identity, points = person["image_id"], np.array(person["keypoints"], dtype=np.float64).reshape(-1, 3)
        if isinstance(identity, str):
            number = last_number(Path(identity).stem)
            if number is None:
                raise InputError(f"{at}: image_id {identity[:40]!r} has no frame number; export the results again.")
        else:
            number = whole_number(identity, at, "image_id")
            number = numbers.get(number, number)
        if images is not None:  # annotations by hand: 0 not there, 1 hidden, 2 seen
            points[:, 2] = np.where(points[:, 2] > 0, 0.5 * np.minimum(points[:, 2], 2), 0)
        rows.append((number, points))
    kind = "AlphaPose results" if any("box" in p or "idx" in p for p in found) else "COCO results"
    counted = bool(rows) and _counted([person["image_id"] for person in found])
    return KeypointTable(kind, grouped(rows, where), 0 if counted else None, scored=images is None)


def _counted(names: Iterable[Any]) -> bool:
    """Test whether frames are named 0.jpg, 1.jpg, ..., as AlphaPose names the frames of a video."""
    return all(isinstance(n, str) and re.fullmatch(r"(0|[1-9]\d*)\.(jpg|png)", n) for n in names)


def _image_numbers(images: Any) -> dict[int, int]:
    """Map image ids to frame numbers; empty unless every image has an id and a file name with a number of its own."""
    listed = images if isinstance(images, list) else []
    numbers = {i.get("id"): last_number(Path(str(i.get("file_name", ""))).stem) for i in listed}
    known = {n for n in numbers.values() if n is not None}
    return {i: n for i, n in numbers.items() if n is not None} if len(known) == len(listed) else {}


def _alphapose_frames(source: Source) -> KeypointTable:
    where, people = str(source.path), dict[int, Array]()
    for name, frame in source.document.items():
        number = last_number(Path(name).stem)
        if number is None:
            raise InputError(f"{where}: the frame {name[:40]!r} has no number; export the results again.")
        if isinstance(bodies := frame.get("bodies"), list):  # form "cmu": Panoptic's keys, OpenPose's 18 points
            frame = {"people": [{"pose_keypoints_2d": b.get("joints")} for b in bodies if isinstance(b, Mapping)]}
        people[number] = parse_openpose(frame, f"{where}, frame {name}")
    first = 0 if _counted(source.document) else None
    return KeypointTable("AlphaPose results (form open or cmu)", people, first)


# ---- keypoint folder -----------------------------------------------------------------------------------------------
# Key points with one file per frame: OpenPose (also of Pose2Sim, RTMLib, AlphaPose), EasyMocap, Ultralytics.
#
# Files are read when they are needed. Sources: OpenPose's JSON output; EasyMocap (annotator/file_utils.py);
# Ultralytics (engine/results.py save_txt): `class x y w h`, then per point x y and, if the model has it, confidence,
# then confidence and track id of the person if asked for; positions are shares of the picture, and a frame without
# people has no file.


_MAX_FILE = 5_000_000
_COUNTS = sorted({len(names) for names in KEYPOINT_SETS.values()})


class _FrameFiles(Mapping[int, Array]):
    """People by frame number; each file is read when its frame is requested."""

    def __init__(self, files: Mapping[int, Path], read: Callable[[Path], Array]) -> None:
        self.files, self._read = files, read

    def __getitem__(self, number: int) -> Array:
        return self._read(self.files[number])

    def __iter__(self) -> Iterator[int]:
        return iter(self.files)

    def __len__(self) -> int:
        return len(self.files)


def _first_holds(source: Source, key: str) -> bool:
    """Test whether the first file of a folder holds a table with this key."""
    files = source.files(".json")
    return bool(files) and key in (document if isinstance(document := read_document(files[0]), Mapping) else ())


def _openpose(source: Source) -> KeypointTable:
    def read(path: Path) -> Array:
        return parse_openpose(read_bytes(path, "the people of one frame", _MAX_FILE), str(path))

    files = source.files(".json")
    if not source.path.is_dir():
        raise InputError(
            f"{source.path} holds the people of one frame; name the folder that has one such file per frame."
        )
    timed = read_document(files[0]).get("program") == "hypose"
    return KeypointTable("OpenPose files", _FrameFiles(numbered_files(files), read), timed=timed)


def numbered_files(paths: list[Path]) -> dict[int, Path]:
    """Number files by the last number in their names, or by their order where these numbers are not unique.

    paths: files in natural order.
    Returns: files by frame number.
    """
    # OpenPose's names end in _keypoints; a number of the view may stand before the frame's
    numbers = [last_number(p.stem) for p in paths]
    if None in numbers or len(set(numbers)) < len(numbers):
        return dict(enumerate(paths))
    return {n: p for n, p in zip(numbers, paths, strict=True) if n is not None}


def _easymocap(source: Source) -> KeypointTable:
    def read(path: Path) -> Array:
        with numbers_of(str(path)):
            people = [person["keypoints"] for person in read_document(path)["annots"]]
        return checked_people([p for p in people if p], str(path))

    return KeypointTable("EasyMocap annotations", _FrameFiles(numbered_files(source.files(".json")), read))


def _ultralytics(source: Source) -> KeypointTable:
    files = numbered_files(source.files(".txt"))
    widths = {len(line.split()) for p in list(files.values())[:100] for line in text_lines_or_none(p)}
    # the numbers of each point, and of what may follow: the person's confidence, its track where it is followed
    for per_point, count in itertools.product((3, 2), _COUNTS):
        if widths and all(0 <= width - 5 - per_point * count <= 2 for width in widths):
            layout = f"Ultralytics labels ({'with' if per_point == 3 else 'without'} confidences)"
            people = _FrameFiles(files, _row_reader(count, per_point))
            return KeypointTable(layout, people, min(1, *files), shares=True, scored=per_point == 3)
    raise InputError(
        f"The files in {source.path} have {', '.join(map(str, sorted(widths))) or 'no'} numbers a line, which is no "
        f"pose of {', '.join(map(str, _COUNTS))} points; write labels of a pose model (class x y w h, then the points)."
    )


def text_lines_or_none(path: Path) -> list[str]:
    """Read the lines of a file that are not blank; an empty file has none."""
    if path.stat().st_size == 0:
        return []
    return [line for line in text_lines(path, "a label file of Ultralytics", _MAX_FILE) if line.strip()]


def _row_reader(count: int, per_point: int) -> Callable[[Path], Array]:
    """Make the reader of a label file: a function of its path that returns people (P, K, 3), as shares of the picture.

    count: number K of points of a person.
    per_point: numbers of each point, 2 or 3.
    """

    def read(path: Path) -> Array:
        people = []
        for line in text_lines_or_none(path):
            with numbers_of(str(path)):
                values = np.array([float(c) for c in line.split()])
            if not 0 <= len(values) - 5 - count * per_point <= 2:
                raise InputError(
                    f"{path}: a line has {len(values)} numbers, which are not {count} points; write it again."
                )
            points = values[5 : 5 + count * per_point].reshape(count, per_point)
            if np.nanmax(np.abs(points[:, :2])) > 1.5:
                raise InputError(f"{path}: positions must be shares of the picture (0 to 1); write the labels again.")
            people.append(scored_points(points[:, :2], points[:, 2] if per_point == 3 else None, str(path)))
        return checked_people(people, str(path))

    return read


# ---- keypoint arrays -----------------------------------------------------------------------------------------------
# Key points as arrays: FreeMoCap's npy, HDF5 of DeepLabCut and SLEAP.
#
# Sources: FreeMoCap 1.x (mediapipe_2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy: (cameras, frames, points, 2
# or 3), the body's 33 BlazePose points first, NaN where nothing was found, cameras in the order of their videos'
# names); DeepLabCut's analysed video (pandas, df_with_missing, format table or fixed); SLEAP's analysis export
# (info/write_tracking_h5.py: tracks (tracks, 2, nodes, frames), transposed for MATLAB, node_names, point_scores).


def _freemocap(source: Source) -> dict[str, KeypointTable]:
    path = source.path
    with open_file(path, source.kind, MAX_BYTES) as stream:
        data = parse_array("the array", stream, os.fstat(stream.fileno()).st_size)
    kind, shape = data.dtype.kind, data.shape
    if kind not in "fiu" or data.ndim != 4 or shape[3] not in (2, 3) or not 17 <= shape[2] <= MAX_POINTS:
        raise InputError(
            f"{path} has the shape {shape}, FreeMoCap's is (cameras, frames, points, 2 or 3); name its "
            "...2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy."
        )
    values = np.array(data[..., :2], dtype=np.float64)
    body = 33 if shape[2] >= 33 else shape[2]  # MediaPipe's hands and face come after the body
    out = {}
    for c, frames in enumerate(values[:, :, :body]):
        people = checked_people(np.concatenate([frames, np.ones((*frames.shape[:2], 1))], -1), str(path))
        out[str(c)] = KeypointTable("FreeMoCap", dict(enumerate(people[:, None])), 0, scored=False)
    return out


@contextmanager
def _h5(source: Source) -> Iterator[Any]:
    """Open an HDF5 file within a with block; errors of the library become an InputError."""
    readable_size(source.path, source.kind, MAX_BYTES)
    h5py = extra("h5py", "Reading HDF5", "h5", or_else="export CSV, which needs nothing")
    try:
        with h5py.File(source.path, "r") as file:
            yield file
    except (OSError, ValueError, KeyError, TypeError, RuntimeError, AttributeError, IndexError, MemoryError) as problem:
        reason = " ".join(str(problem).split())[:100]
        raise InputError(f"{source.path} cannot be read as HDF5 ({reason}); export the key points again.") from None


def _h5_holds(source: Source, wanted: Callable[[Any], Any]) -> bool:
    """Test whether an HDF5 file fulfils a condition; wanted: function of the opened file."""
    with _h5(source) as file:
        return bool(wanted(file))


def _deeplabcut_group(file: Any) -> str | None:
    """Find the name of DeepLabCut's table in an HDF5 file."""
    return next((k for k in file if "table" in file[k] or "block0_values" in file[k]), None)


def _sized(dataset: Any, where: str) -> Any:
    """Read a dataset after checking its size, because a compressed file can unpack to any size."""
    if dataset.size * dataset.dtype.itemsize > 4 * MAX_BYTES:
        raise InputError(f"{where}: {dataset.name} unpacks to more than 2 GiB; cut the recording into pieces.")
    return dataset[()]


def _fitted(array: Array, shape: tuple[int | None, ...], where: str) -> Array:
    """Transpose an array where that gives it the shape, in which None stands for any number; InputError otherwise."""
    for found in (array, array.T):
        if found.ndim == len(shape) and all(b in (None, a) for a, b in zip(found.shape, shape, strict=True)):
            return found
    raise InputError(f"{where}: an array of shape {array.shape} does not belong to the nodes; export it again.")


def _sleap_h5(source: Source) -> KeypointTable:
    where = str(source.path)
    with _h5(source) as file:
        names = tuple(n.decode(errors="replace") for n in _sized(file["node_names"], where).tolist())
        tracks = np.asarray(_sized(file["tracks"], where), dtype=np.float64)
        scores = np.asarray(_sized(file["point_scores"], where), dtype=np.float64) if "point_scores" in file else None
    tracks = _fitted(tracks, (None, 2, len(names), None), where)
    people, _, _, frames = tracks.shape
    scores = None if scores is None else _fitted(scores, (people, len(names), frames), where)
    scored = scores is not None and bool(np.isfinite(scores).any())  # none where people were marked by hand
    confidence = scores if scores is not None and scored else np.ones((people, len(names), frames))
    points = np.concatenate([tracks.transpose(3, 0, 2, 1), confidence.transpose(2, 0, 1)[..., None]], axis=-1)
    found = _people_of_frames(range(frames), points, where)
    return KeypointTable("SLEAP analysis", found, 0, names, scored=scored)


def _deeplabcut_h5(source: Source) -> KeypointTable:
    """Read the table that pandas stored, in its format "table" or "fixed"."""
    where = str(source.path)
    with _h5(source) as file:
        group = file[_deeplabcut_group(file)]
        if "table" in group:
            table = _sized(group["table"], where)
            block = next(n for n in table.dtype.names if n.startswith("values_block"))
            values, numbers = np.asarray(table[block], dtype=np.float64), table["index"]
            raw = group.attrs["non_index_axes"]  # a pickle, of which only plain text, numbers and tuples are read
            columns = read_plain_pickle(bytes(raw))[0][1]
        else:
            values = np.asarray(_sized(group["block0_values"], where), dtype=np.float64)
            numbers = _sized(group["axis1"], where)
            levels = sorted(k for k in group if k.startswith("block0_items_level"))
            labels = sorted(k for k in group if k.startswith(("block0_items_label", "block0_items_code")))
            words = [[w.decode(errors="replace") for w in _sized(group[k], where).tolist()] for k in levels]
            found = ([w[i] for i in _sized(group[k], where)] for w, k in zip(words, labels, strict=True))
            columns = list(zip(*found, strict=True))
    wide = [tuple(str(c) for c in column) for column in columns]
    if not wide or {len(c) for c in wide} - {3, 4} or values.shape != (len(numbers), len(wide)):
        raise InputError(f"{where}: its columns are not scorer, body part and coordinate; analyse the video again.")
    named = [(c[1] if len(c) == 4 else "", c[-2], c[-1]) for c in wide]
    counted = [whole_number(n, where, "a frame's number") for n in np.asarray(numbers).tolist()]
    return deeplabcut_table(named, counted, values, where)


KEYPOINTS = FormatTable(
    "a file or folder of key points",
    "detect them, or export them again",
    (
        Format(
            "OpenPose, Pose2Sim, RTMLib, AlphaPose", ("/",), _openpose, lambda source: _first_holds(source, "people")
        ),
        Format("EasyMocap", ("/",), _easymocap, lambda source: _first_holds(source, "annots")),
        Format("Ultralytics", ("/",), _ultralytics, lambda source: source.files(".txt")),
        Format(
            "MMPose",
            (".json",),
            _mmpose,
            lambda source: _lists(source, "instance_info") or _all_hold(source, "instances"),
        ),
        Format(
            "COCO, AlphaPose",
            (".json",),
            _coco,
            lambda source: _lists(source, "annotations") or _all_hold(source, "keypoints"),
        ),
        Format(
            "AlphaPose (forms open and cmu)",
            (".json",),
            _alphapose_frames,
            lambda source: _all_hold(source, "people", "bodies"),
        ),
        Format("OpenPose (one frame)", (".json",), _openpose, lambda source: _lists(source, "people")),
        Format("DeepLabCut, Lightning Pose", (".csv",), _deeplabcut, lambda source: source.header[0] == "scorer"),
        Format("Caliscope", (".csv",), _caliscope, lambda source: "sync_index" in source.header),
        Format("SLEAP", (".csv",), _sleap, lambda source: "frame_idx" in source.header),
        Format("FreeMoCap", (".npy",), _freemocap),
        Format(
            "SLEAP",
            (".h5", ".hdf5"),
            _sleap_h5,
            lambda source: _h5_holds(source, lambda file: "tracks" in file and "node_names" in file),
        ),
        Format("DeepLabCut", (".h5", ".hdf5"), _deeplabcut_h5, lambda source: _h5_holds(source, _deeplabcut_group)),
    ),
    read_document,
)
"""Key points: readers of a source that return a table, or tables by camera."""
