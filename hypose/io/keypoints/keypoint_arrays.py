"""Key points as arrays: FreeMoCap's npy, npz of RTMLib's arrays, HDF5 of DeepLabCut and SLEAP.

Sources: FreeMoCap 1.x (mediapipe_2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy: (cameras, frames, points, 2 or
3), the body's 33 BlazePose points first, NaN where nothing was found, cameras in the order of their videos' names);
DeepLabCut's analysed video (pandas, df_with_missing, format table or fixed); SLEAP's analysis export
(info/write_tracking_h5.py: tracks (tracks, 2, nodes, frames), transposed for MATLAB, node_names, point_scores).
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from hypose.errors import InputError, extra
from hypose.geometry import Array
from hypose.io.calibrations.calibration_opencap import read_plain_pickle
from hypose.io.files import open_file, readable_size
from hypose.io.keypoints.keypoint_csv import deeplabcut_table
from hypose.io.keypoints.keypoint_table import (
    MAX_BYTES,
    MAX_FRAMES,
    MAX_POINTS,
    KeypointTable,
    checked_people,
    whole_number,
)
from hypose.io.motions.results import parse_array

_KIND = "an array of key points"


def read_keypoint_npy(path: Path) -> dict[str, KeypointTable]:
    """Key points by the camera's place in the array ("0", "1", ...)."""
    try:
        with open_file(path, _KIND, MAX_BYTES) as stream:
            data = parse_array("it", stream, os.fstat(stream.fileno()).st_size)
        kind, shape = data.dtype.kind, data.shape
    except (ValueError, OSError, MemoryError) as problem:
        raise InputError(f"{path} is no array of numpy ({str(problem)[:80]}); export it again.") from None
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


def read_keypoint_h5(path: Path) -> KeypointTable:
    """Key points of one camera out of HDF5. An InputError says what cannot be used, or that h5py is needed."""
    readable_size(path, _KIND, MAX_BYTES)
    h5py = _library()
    try:
        with h5py.File(path, "r") as file:
            if "tracks" in file and "node_names" in file:
                return _sleap(file, str(path))
            key = next((k for k in file if "table" in file[k] or "block0_values" in file[k]), None)
            if key is not None:
                return _deeplabcut(file[key], str(path))
    except (OSError, ValueError, KeyError, TypeError, RuntimeError, AttributeError, IndexError, MemoryError) as problem:
        reason = " ".join(str(problem).split())[:100]
        raise InputError(f"{path} cannot be read as HDF5 ({reason}); export the key points again.") from None
    raise InputError(
        f"{path} holds neither DeepLabCut's table nor SLEAP's tracks; export DeepLabCut's analysis or SLEAP's "
        "analysis.h5."
    )


def _library() -> Any:
    return extra("h5py", "Reading HDF5", "h5", or_else="export CSV, which needs nothing")


def _sized(dataset: Any, where: str) -> Any:
    """A dataset that fits into memory: a compressed file may promise anything."""
    if dataset.size * dataset.dtype.itemsize > 4 * MAX_BYTES:
        raise InputError(f"{where}: {dataset.name} unpacks to more than 2 GiB; cut the recording into pieces.")
    return dataset[()]


def _sleap(file: Any, where: str) -> KeypointTable:
    names = tuple(n.decode(errors="replace") for n in _sized(file["node_names"], where).tolist())
    tracks = np.asarray(_sized(file["tracks"], where), dtype=np.float64)
    if tracks.ndim != 4 or not names:
        raise InputError(f"{where}: tracks have the shape {tracks.shape}, four dimensions are needed; export again.")
    if tracks.shape[1:3] != (2, len(names)):  # written without the transposition
        tracks = tracks.T
    if tracks.shape[1:3] != (2, len(names)):
        raise InputError(f"{where}: tracks {tracks.shape} do not belong to {len(names)} nodes; export them again.")
    scores = np.asarray(_sized(file["point_scores"], where), dtype=np.float64) if "point_scores" in file else None
    if scores is not None and scores.shape != (tracks.shape[0], len(names), tracks.shape[3]):
        scores = scores.T
    if scores is not None and scores.shape != (tracks.shape[0], len(names), tracks.shape[3]):
        raise InputError(f"{where}: point_scores {scores.shape} do not belong to the tracks; export them again.")
    scored = scores is not None and bool(np.isfinite(scores).any())  # none where people were marked by hand
    points = np.ones((tracks.shape[3], tracks.shape[0], len(names), 3))
    points[..., :2] = tracks.transpose(3, 0, 2, 1)
    if scores is not None and scored:
        points[..., 2] = scores.transpose(2, 0, 1)
    people = {t: _somebody(checked_people(frame, where)) for t, frame in enumerate(points)}
    return KeypointTable("SLEAP analysis", people, 0, names, scored=scored)


def _somebody(points: Array) -> Array:
    return points[(points[..., 2] > 0).any(1)] if points.size else points


def _deeplabcut(group: Any, where: str) -> KeypointTable:
    if "table" in group:
        table = _sized(group["table"], where)
        block = next(n for n in table.dtype.names if n.startswith("values_block"))
        values, numbers = np.asarray(table[block], dtype=np.float64), table["index"]
        raw = group.attrs["non_index_axes"]  # a pickle, of which only plain text, numbers and tuples are followed
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
    if len(numbers) > MAX_FRAMES:
        raise InputError(f"{where} has {len(numbers)} frames, too many; cut the recording into pieces.")
    named = [(c[1] if len(c) == 4 else "", c[-2], c[-1]) for c in wide]
    counted = [whole_number(n, where, "a frame's number") for n in np.asarray(numbers).tolist()]
    return deeplabcut_table(named, counted, values, where)
