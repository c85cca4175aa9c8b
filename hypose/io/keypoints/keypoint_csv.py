"""Key points as tables: DeepLabCut, SLEAP and Caliscope CSV.

Sources: DeepLabCut's CSV of analysed videos (three header lines scorer, bodyparts, coords; four with individuals),
the ensemble Kalman smoother's in the same layout (eks: x_ens_var, x_posterior_var and so on beside x, y, likelihood);
SLEAP's analysis CSV (track, frame_idx, instance.score, then node.x, node.y, node.score); Caliscope's xy_<tracker>.csv
(sync_index, cam_id - port in old ones -, frame_index, frame_time, point_id - keypoint_id in new ones -, img_loc_x,
img_loc_y, ...), one row per point that was found, pixels of the picture as the camera delivers it, no scores.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from hypose.errors import InputError
from hypose.evidence.keypoints import BLAZEPOSE_33
from hypose.geometry import Array
from hypose.io.keypoints.keypoint_table import (
    MAX_BYTES,
    MAX_FRAMES,
    MAX_POINTS,
    KeypointTable,
    checked_people,
    grouped,
    weighed,
    whole_number,
)
from hypose.io.text_in import bounded_lines

_KIND = "a CSV of key points of DeepLabCut, SLEAP or Caliscope"
_VARIANCES = (("x_posterior_var", "y_posterior_var"), ("x_ens_var", "y_ens_var"))
"""px^2, by the ensemble Kalman smoother of Lightning Pose; the better first."""


def read_keypoint_csv(path: Path) -> dict[str, KeypointTable]:
    """Key points by camera; the name is "" where the file is of one camera."""
    lines = bounded_lines(path, _KIND, MAX_BYTES)
    header = _cells(next(lines, ""))
    rows = (_cells(line) for line in lines if line.strip())
    if header and header[0] == "scorer":
        return {"": _deeplabcut(header, rows, str(path))}
    if "sync_index" in header:
        return _caliscope(path, header, rows)
    if "frame_idx" in header:
        return {"": _sleap(header, rows, str(path))}
    raise InputError(
        f"{path} is not {_KIND}: its first line begins with {','.join(header)[:60]!r}; export the key points again."
    )


def _cells(line: str) -> list[str]:
    return [c.strip().strip('"') for c in line.split(",")]


def _number(cell: str) -> float:
    """NaN for an empty cell; a ValueError for text."""
    return float(cell) if cell else math.nan


def by_individual(columns: Sequence[tuple[str, ...]], where: str) -> dict[str, list[tuple[str, list[int]]]]:
    """DeepLabCut's columns (individual, body part, coordinate) -> per individual the body parts with the places of
    x, y, likelihood, and of the variances of x and y where all parts have them."""
    people: dict[str, dict[str, dict[str, int]]] = {}
    for i, (individual, part, coordinate) in enumerate(columns):
        people.setdefault(individual, {}).setdefault(part, {})[coordinate] = i
    out: dict[str, list[tuple[str, list[int]]]] = {}
    every = [set(at) for parts in people.values() for at in parts.values()]
    variances = next((v for v in _VARIANCES if all(set(v) <= at for at in every)), ())
    for individual, parts in people.items():
        for part, at in parts.items():
            if not {"x", "y", "likelihood"} <= at.keys():
                raise InputError(f"{where}: {part} lacks x, y or likelihood; analyse the video again.")
            out.setdefault(individual, []).append((part, [at[c] for c in ("x", "y", "likelihood", *variances)]))
    names = [tuple(p for p, _ in parts) for parts in out.values()]
    return {k: v for k, v in out.items() if {p for p, _ in v} == set(max(names, key=len))}  # not the single points


def deeplabcut_table(
    columns: Sequence[tuple[str, ...]], numbers: Sequence[int], values: Array, where: str
) -> KeypointTable:
    """The table of DeepLabCut's columns (individual, body part, coordinate) and values (T, columns)."""
    people = by_individual(columns, where)
    if not people:
        raise InputError(f"{where} has no body parts; analyse the video again.")
    names = tuple(p for p, _ in next(iter(people.values())))
    places = np.array([[dict(parts)[n] for n in names] for parts in people.values()])  # (P, K, 3 or 5)
    whole = values[:, places]
    spread = places.shape[2] == 5
    points = weighed(whole[..., :3], whole[..., 3:]) if spread else whole
    found = {}
    for number, row in zip(numbers, points, strict=True):
        people_there = checked_people(row, f"{where}, frame {number}")
        found[number] = people_there[(people_there[..., 2] > 0).any(1)]
    return KeypointTable("DeepLabCut", found, min(found, default=0), names, spread=spread)


def _deeplabcut(first: list[str], rows: Iterator[list[str]], where: str) -> KeypointTable:
    head = {first[0]: first[1:]}
    numbers: list[int] = []
    values: list[list[float]] = []
    for row in rows:
        if row[0] in ("individuals", "bodyparts", "coords"):
            head[row[0]] = row[1:]
            continue
        if "coords" not in head or "bodyparts" not in head:
            raise InputError(f"{where}: the lines bodyparts and coords are missing; analyse the video again.")
        at = f"{where}, frame {row[0][:20]}"
        try:
            numbers.append(whole_number(float(row[0]), at, "the frame's number"))
            values.append([_number(c) for c in row[1:]])
        except ValueError:
            raise InputError(f"{at}: it holds something that is not a number; analyse the video again.") from None
        if len(values[-1]) != len(head["coords"]) or len(numbers) > MAX_FRAMES:
            raise InputError(f"{at}: {len(row) - 1} cells, the header has {len(head['coords'])}; the file may be cut.")
    parts = head.get("bodyparts", [])
    people = head.get("individuals", [""] * len(parts))
    coords = head.get("coords", [])
    if not len(parts) == len(people) == len(coords) or not numbers:
        raise InputError(f"{where} has no frames, or header lines of different lengths; analyse the video again.")
    columns = list(zip(people, parts, coords, strict=True))
    return deeplabcut_table(columns, numbers, np.array(values), where)


def _sleap(header: list[str], rows: Iterator[list[str]], where: str) -> KeypointTable:
    names = [h[:-2] for h in header if h.endswith(".x") and not h.startswith("instance.")]
    at = {h: i for i, h in enumerate(header)}
    if not names or any(f"{n}.y" not in at for n in names) or len(names) > MAX_POINTS:
        raise InputError(f"{where} is not SLEAP's analysis CSV: it needs node.x and node.y; export it again.")
    scored = all(f"{n}.score" in at for n in names)
    found: list[tuple[int, Array]] = []
    for row in rows:
        try:
            number = whole_number(float(row[at["frame_idx"]]), where, "frame_idx")
            points = np.array([[_number(row[at[f"{n}.{c}"]]) for c in "xy"] for n in names])
            scores = [_number(row[at[f"{n}.score"]]) for n in names] if scored else [1.0] * len(names)
        except (ValueError, IndexError):
            raise InputError(f"{where}, row {len(found) + 2}: it is cut off or holds text; export it again.") from None
        found.append((number, np.column_stack([points, scores])))
    # frames without anybody have no row, and SLEAP counts from 0
    return KeypointTable("SLEAP analysis", grouped(found, where), 0, tuple(names), scored=scored)


def _caliscope(path: Path, header: list[str], rows: Iterator[list[str]]) -> dict[str, KeypointTable]:
    where = str(path)
    at = {h: i for i, h in enumerate(header)}
    camera = next((at[n] for n in ("cam_id", "port") if n in at), None)
    point = next((at[n] for n in ("point_id", "keypoint_id") if n in at), None)
    if camera is None or point is None or not {"img_loc_x", "img_loc_y"} <= at.keys():
        raise InputError(
            f"{where} is not Caliscope's xy table: cam_id (or port), point_id, img_loc_x and img_loc_y are needed; "
            "name its xy_<tracker>.csv."
        )
    seen: dict[str, dict[int, dict[int, tuple[float, float]]]] = {}
    ids: set[int] = set()
    for count, row in enumerate(rows):
        if len(row) != len(header):
            raise InputError(
                f"{where}, row {count + 2}: {len(row)} cells, the header has {len(header)}; export it again."
            )
        try:
            name = str(whole_number(float(row[camera]), where, "cam_id"))
            number = whole_number(float(row[at["sync_index"]]), where, "sync_index")
            identity = whole_number(float(row[point]), where, "point_id")
            xy = (_number(row[at["img_loc_x"]]), _number(row[at["img_loc_y"]]))
        except (ValueError, IndexError):
            raise InputError(f"{where}, row {count + 2}: it is cut off or holds text; export it again.") from None
        seen.setdefault(name, {}).setdefault(number, {})[identity] = xy
        ids.add(identity)
    if not ids:
        raise InputError(f"{where} holds no points; run the tracker again.")
    order = _point_order(path.stem.lower(), ids)
    numbers, rate = _clock(path)
    first = _first_frame([n for frames in seen.values() for n in frames], numbers, where)
    out = {}
    for name, frames in sorted(seen.items(), key=lambda item: int(item[0])):
        listed = [
            (n, np.array([(*points[i], 1.0) if i in points else (0, 0, 0) for i in order], dtype=np.float64))
            for n, points in frames.items()
        ]
        out[name] = KeypointTable(
            "Caliscope points",
            grouped(listed, where),
            first,
            BLAZEPOSE_33 if len(order) == 33 else None,
            scored=False,
            frame_rate=rate,
        )
    return out


def _first_frame(shown: Sequence[int], numbers: Sequence[int], where: str) -> int:
    """The sync_index of the points that is the recording's first frame. numbers: the recording's own; older versions
    count the points from 0 where the recording's times go on from the calibration's."""
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
    """The ids of the points in the order of a set. MediaPipe's trackers number the body 0 to 32, the right hand from
    100 and the left from 200 on, and SIMPLE_HOLISTIC's only wrists are those of the hands."""
    if "holistic" in stem or "pose" in stem and "rtm" not in stem or max(ids) >= 200:
        order = list(range(33))
        order[15] = 15 if 15 in ids else 200
        order[16] = 16 if 16 in ids else 100
        return order
    return list(range(133 if max(ids) > 32 else 33 if max(ids) > 25 else 26 if max(ids) > 16 else 17))


def clock_file(path: Path) -> Path | None:
    """Caliscope's table of times beside its points, or one folder above; None when there is none."""
    names = ("timestamps.csv", "frame_timestamps.csv", "frametimes.csv", "frame_time_history.csv")
    places = (folder / name for folder in (path.parent, path.parent.parent) for name in names)
    return next((p for p in places if p.is_file()), None)


def _clock(path: Path) -> tuple[list[int], float | None]:
    """The recording's sync indices and frame rate, of its table of times."""
    table = clock_file(path)
    if table is None:
        return [], None
    lines = bounded_lines(table, "Caliscope's table of times", MAX_BYTES)
    header = _cells(next(lines, ""))
    if not {"sync_index", "frame_time"} <= set(header):
        raise InputError(f"{table} has no columns sync_index and frame_time; copy it again, or remove it.")
    times: dict[int, list[float]] = {}
    for line in lines:
        row = _cells(line)
        try:
            times.setdefault(int(row[header.index("sync_index")]), []).append(float(row[header.index("frame_time")]))
        except (ValueError, IndexError):
            raise InputError(f"{table}: the line {line[:40]!r} is damaged; copy the file again.") from None
    numbers = sorted(times)
    if len(numbers) > 1 and np.diff(numbers).max() > 10 + len(numbers) // 10:
        raise InputError(f"{table}: its sync_index jumps from one frame to another; copy the file again.")
    steps = np.diff([np.mean(times[n]) for n in numbers]) / np.maximum(np.diff(numbers), 1)
    rate = float(1 / np.median(steps)) if len(steps) and np.median(steps) > 0 else None
    return numbers, rate
