"""Key-point files: the table of their formats, and the readers.

To add a format, write a reader and enter it in `KEYPOINTS`. A reader takes a `Source` and returns a KeypointTable, or
one for each camera of the file. New points need a set in `hypose.evidence.keypoints.KEYPOINT_SETS`.

Sources of the CSV layouts (those of the others are above their readers):
DeepLabCut: CSV of analysed videos, with three header lines scorer, bodyparts, coords; four with individuals.
    Lightning Pose writes the same layout; its columns of variances are not used.
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
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hypose.errors import InputError, refuse
from hypose.evidence.keypoints import BLAZEPOSE_33, KEYPOINT_SETS
from hypose.geometry import Array
from hypose.io.files import (
    csv_rows,
    distinct_numbers,
    last_number,
    numbers_of,
    open_file,
    read_bytes,
    read_json,
    read_text,
)
from hypose.io.formats import Format, FormatTable, Source
from hypose.io.motions.results import parse_array
from hypose.json_text import parse_json

# ---- keypoint table ------------------------------------------------------------------------------------------------
# The table that every reader of 2D key points returns for one camera, and common checks of numbers from files.


MAX_BYTES = 512 * 2**20
MAX_POINTS = 1000
MAX_POINT_FRAMES = 5_000_000
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
    frame_rate: frames/s, where the file gives it.
    timed: frames are numbered as `VideoReader` counts them when it reads by time stamps.
    """

    layout: str
    people: Mapping[int, Array]
    first: int | None = None
    names: tuple[str, ...] | None = None
    shares: bool = False
    scored: bool = True
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
        if len(counts := {len(points) for points in values}) > 1:
            said = ", ".join(map(str, sorted(counts)))
            raise InputError(f"{where}: people have {said} key points; export those of one model.")
        p = np.array(values, dtype=np.float64)
    if p.size == 0:
        return np.zeros((0, 0, 3))
    faults = {
        f"key points have the shape {p.shape}, people x points x 3 is needed; export again": (
            p.ndim != 3 or p.shape[2] != 3 or not 1 <= p.shape[1] <= MAX_POINTS
        ),
        "a key point is infinite; export it again": np.isinf(p).any(),
    }
    refuse(f"{where}: ", faults)
    missing = ~np.isfinite(p).all(-1) | ~(np.nan_to_num(p[..., 2]) > 0) | (p[..., :2] == 0).all(-1)
    return np.where(missing[..., None], 0.0, p)


def parse_openpose(document: str | bytes | Mapping[str, Any], source: str = "The key-point file") -> Array:
    """Read the people of one OpenPose-style JSON document.

    source: name of the file in error messages.
    Returns: (P, K, 3) u px, v px, score. A point at (0, 0), or without finite position and score, is missing: 0.
    Raises: InputError where it is no such document.
    """
    with numbers_of(source):
        found = (parse_json(document) if isinstance(document, (str, bytes)) else document)["people"]
        people = dict(enumerate(found)) if isinstance(found, list) else dict(found)  # some write an empty list as {}
    for number, person in people.items():
        with numbers_of(f"{source}, person {number}"):
            key = "pose_keypoints" if "pose_keypoints" in person else "pose_keypoints_2d"  # the former: OpenPose 1.0
            people[number] = np.array(person[key] if person else [], dtype=np.float64).reshape(-1, 3)
    return checked_people([p for p in people.values() if len(p)], source)


def scored_points(positions: Any, scores: Any = None) -> Array:
    """Combine positions and scores of key points.

    positions: (..., K, 2 or more); u and v are the first two columns.
    scores: (..., K) in any shape; None: all are 1.
    Returns: (..., K, 3) u, v, score.
    Raises: ValueError where they are not numbers of these shapes.
    """
    uv = np.array(positions, dtype=np.float64)[..., :2]
    given = np.ones(uv.shape[:-1]) if scores is None else np.array(scores, dtype=np.float64).reshape(uv.shape[:-1])
    return np.concatenate([uv, given[..., None]], axis=-1)


def grouped(numbers: Iterable[Any], points: Any, where: str, frames: Iterable[int] = ()) -> dict[int, Array]:
    """Group the key points of people by frame number.

    numbers: frame number of each person, in any order.
    points: (N, K, 3) u, v, score of each person; people without any point are left out.
    where: file, for the error messages.
    frames: numbers of further frames, which may show no person.
    Returns: (P, K, 3) by frame number.
    Raises: InputError where they are not key points, people differ in their number, or a frame number is not whole.
    """
    out: dict[int, list[Array]] = {n: [] for n in frames}
    for number, person in zip(numbers, checked_people(points, where), strict=True):
        of_frame = out.setdefault(whole_number(number), [])
        if person[:, 2].any():
            of_frame.append(person)
    return {n: np.stack(people) if people else np.zeros((0, 0, 3)) for n, people in out.items()}


def whole_number(value: Any) -> int:
    """Check that a value is a frame number and return it; ValueError where it is not a whole number."""
    if isinstance(value, bool) or int(value) != value or not 0 <= value < 2**40:
        raise ValueError(f"{str(value)[:40]!r} is not the whole number of a frame or point")
    return int(value)


def _deeplabcut(source: Source) -> KeypointTable:
    first, rows = csv_rows(source.path, source.kind, MAX_BYTES)
    head = {"individuals": [""] * (len(first) - 1)}
    values: list[list[float]] = []
    for line, row in rows:
        if row[0] in ("individuals", "bodyparts", "coords"):
            head[row[0]] = row[1:]
            continue
        with numbers_of(f"{source.path}, line {line}"):
            values.append([float(c or "nan") for c in row])
    parts: dict[str, dict[str, dict[str, int]]] = {}
    for i, (who, part, what) in enumerate(zip(head["individuals"], head["bodyparts"], head["coords"], strict=True), 1):
        parts.setdefault(who, {}).setdefault(part, {})[what] = i
    names = tuple(max(parts.values(), key=len))
    people = [own for own in parts.values() if own.keys() == set(names)]  # not the single points
    with numbers_of(f"{source.path}: a body part"):
        chosen = [[[own[n][c] for c in ("x", "y", "likelihood")] for n in names] for own in people]
    table = np.array(values)
    points = table[:, np.array(chosen)].reshape(-1, len(names), 3)
    by_frame = grouped(np.repeat(table[:, 0], len(people)).tolist(), points, str(source.path))
    return KeypointTable("DeepLabCut", by_frame, min(by_frame), names)


def _rows_of(path: Path, kind: str, columns: Sequence[str]) -> Array:
    """Read the given columns of a CSV file as numbers (rows, columns); NaN for empty cells."""
    header, rows = csv_rows(path, kind, MAX_BYTES)
    with numbers_of(str(path)):
        at = [{name: i for i, name in enumerate(header)}[c] for c in columns]
    values: list[list[float]] = []
    for line, row in rows:
        with numbers_of(f"{path}, line {line}"):
            values.append([float(row[i] or "nan") for i in at])
    return np.array(values).reshape(-1, len(at))


def _sleap(source: Source) -> KeypointTable:
    names = [h[:-2] for h in source.header if h.endswith(".x") and not h.startswith("instance.")][:MAX_POINTS]
    scored = all(f"{n}.score" in source.header for n in names)
    parts = ("x", "y", "score") if scored else ("x", "y")
    values = _rows_of(source.path, source.kind, ["frame_idx", *(f"{n}.{c}" for n in names for c in parts)])
    points = values[:, 1:].reshape(len(values), len(names), len(parts))
    found = grouped(values[:, 0].tolist(), points if scored else scored_points(points), str(source.path))
    # frames without a person have no row, and SLEAP counts from 0
    return KeypointTable("SLEAP analysis", found, 0, tuple(names), scored=scored)


def _caliscope(source: Source) -> dict[str, KeypointTable]:
    path, where, header = source.path, str(source.path), source.header
    camera, point = ("cam_id" if "cam_id" in header else "port", "point_id" if "point_id" in header else "keypoint_id")
    values = _rows_of(path, source.kind, [camera, "sync_index", point, "img_loc_x", "img_loc_y"])
    if not len(values):
        raise InputError(f"{where} holds no points; run the tracker again.")
    cameras, frames, ids = ([whole_number(v) for v in column] for column in values[:, :3].T.tolist())
    order = {identity: k for k, identity in enumerate(_point_order(path.stem.lower(), set(ids)))}
    seen: dict[int, dict[int, Array]] = {}
    for name, number, identity, place in zip(cameras, frames, ids, values[:, 3:], strict=True):
        points = seen.setdefault(name, {}).setdefault(number, np.zeros((len(order), 3)))
        if identity in order:
            points[order[identity]] = *place, 1.0
    numbers, rate = _clock(path)
    first = _first_frame(frames, numbers, where)
    names = BLAZEPOSE_33 if len(order) == 33 else None
    return {
        str(name): KeypointTable(
            "Caliscope points", grouped(of, list(of.values()), where), first, names, scored=False, frame_rate=rate
        )
        for name, of in sorted(seen.items())
    }


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
        times.setdefault(whole_number(number), []).append(time)
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
    document = source.document
    frames, meta = (
        (document["instance_info"], document.get("meta_info")) if isinstance(document, dict) else (document, None)
    )
    numbers, of_people = list[int](), list[int]()
    people = list[Array]()
    scored = True
    for i, frame in enumerate(frames):
        with numbers_of(f"{source.path}, entry {i}"):
            numbers.append(whole_number(frame.get("frame_id", i)))
            for person in frame["instances"]:
                scores = person.get("keypoint_scores")
                scored = scored and scores is not None
                people.append(scored_points(person["keypoints"], scores))
                of_people.append(numbers[-1])
    found = grouped(of_people, people, str(source.path), numbers)
    kind = "MMPose results" if meta is not None else "MMPose predictions"
    # all frames are listed, so the smallest number is the first frame's
    return KeypointTable(kind, found, min(numbers, default=0), _names_of_meta(meta), scored=scored)


def _names_of_meta(meta: Any) -> tuple[str, ...] | None:
    """Get the names of the points from MMPose's meta_info; None where they are not all there."""
    table = meta.get("keypoint_id2name") if isinstance(meta, Mapping) else None
    if not isinstance(table, Mapping) or not all(isinstance(v, str) for v in table.values()):
        return None
    names = [table.get(str(i)) for i in range(len(table))]
    return tuple(n for n in names if n is not None) if all(names) else None


def _coco(source: Source) -> KeypointTable:
    document = source.document
    found, images = (
        (document["annotations"], document.get("images")) if isinstance(document, dict) else (document, None)
    )
    numbers: dict[Any, int] = _image_numbers(images)
    of_people, people = list[int](), list[Array]()
    for i, person in enumerate(found):
        with numbers_of(f"{source.path}, entry {i}"):
            identity, points = person["image_id"], np.array(person["keypoints"], dtype=np.float64).reshape(-1, 3)
            number = last_number(Path(identity).stem) if isinstance(identity, str) else whole_number(identity)
            of_people.append(whole_number(numbers.get(identity, number)))
        if images is not None:  # annotations by hand: 0 not there, 1 hidden, 2 seen
            points[:, 2] = np.where(points[:, 2] > 0, 0.5 * np.minimum(points[:, 2], 2), 0)
        people.append(points)
    kind = "AlphaPose results" if any("box" in p or "idx" in p for p in found) else "COCO results"
    first = 0 if people and _counted([person["image_id"] for person in found]) else None
    return KeypointTable(kind, grouped(of_people, people, str(source.path)), first, scored=images is None)


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
    people = dict[int, Array]()
    for name, frame in source.document.items():
        at = f"{source.path}, frame {name[:40]}"
        if isinstance(bodies := frame.get("bodies"), list):  # form "cmu": Panoptic's keys, OpenPose's 18 points
            frame = {"people": [{"pose_keypoints_2d": b.get("joints")} for b in bodies if isinstance(b, Mapping)]}
        with numbers_of(at):
            people[whole_number(last_number(Path(name).stem))] = parse_openpose(frame, at)
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
    numbers = distinct_numbers(paths)
    return dict(enumerate(paths) if numbers is None else zip(numbers, paths, strict=True))


def _easymocap(source: Source) -> KeypointTable:
    def read(path: Path) -> Array:
        with numbers_of(str(path)):
            people = [person["keypoints"] for person in read_document(path)["annots"]]
        return checked_people([p for p in people if p], str(path))

    return KeypointTable("EasyMocap annotations", _FrameFiles(numbered_files(source.files(".json")), read))


def _ultralytics(source: Source) -> KeypointTable:
    files = numbered_files(source.files(".txt"))
    widths = {len(row) for p in list(files.values())[:100] for row in _labels(p)}
    # the numbers of each point, and of what may follow: the person's confidence, its track where it is followed
    for per_point, count in itertools.product((3, 2), _COUNTS):
        if widths and all(0 <= width - 5 - per_point * count <= 2 for width in widths):
            layout = f"Ultralytics labels ({'with' if per_point == 3 else 'without'} confidences)"
            people = _FrameFiles(files, partial(_labelled_people, count=count, per_point=per_point))
            return KeypointTable(layout, people, min(1, *files), shares=True, scored=per_point == 3)
    raise InputError(
        f"The files in {source.path} have {', '.join(map(str, sorted(widths))) or 'no'} numbers a line, which is no "
        f"pose of {', '.join(map(str, _COUNTS))} points; write labels of a pose model (class x y w h, then the points)."
    )


def _labels(path: Path) -> list[Array]:
    """Read the numbers of each line of a label file, which may be empty."""
    with numbers_of(str(path)):
        lines = read_text(path, "a label file of Ultralytics", _MAX_FILE).splitlines()
        return [np.array(line.split(), dtype=np.float64) for line in lines if line.strip()]


def _labelled_people(path: Path, count: int, per_point: int) -> Array:
    """Read the people (P, K, 3) of a label file, as shares of the picture.

    count: number K of points of a person.
    per_point: numbers of each point, 2 or 3.
    """
    size = count * per_point
    with numbers_of(str(path)):
        # at most two numbers follow the points: with more, the shape is another
        points = [row[5 : max(5 + size, len(row) - 2)].reshape(count, per_point) for row in _labels(path)]
        people = checked_people([p if per_point == 3 else scored_points(p) for p in points], str(path))
    if np.abs(people[..., :2]).max(initial=0) > 1.5:
        raise InputError(f"{path}: positions must be shares of the picture (0 to 1); write the labels again.")
    return people


# ---- keypoint arrays -----------------------------------------------------------------------------------------------
# Key points as arrays: FreeMoCap's npy.
#
# Source: FreeMoCap 1.x (mediapipe_2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy: (cameras, frames, points, 2
# or 3), the body's 33 BlazePose points first, NaN where nothing was found, cameras in the order of their videos'
# names).


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
    body = scored_points(data[:, :, : 33 if shape[2] >= 33 else None])  # MediaPipe's hands and face come after the body
    found = {str(c): grouped(range(shape[1]), frames, str(path)) for c, frames in enumerate(body)}
    return {name: KeypointTable("FreeMoCap", people, 0, scored=False) for name, people in found.items()}


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
    ),
    read_document,
)
"""Key points: readers of a source that return a table, or tables by camera."""
