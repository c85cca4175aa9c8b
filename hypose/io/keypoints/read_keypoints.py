"""2D key points of any known program (`keypoint_files.KEYPOINTS`): choice of the key-point set, checks, notes for the
user.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import CameraRig
from hypose.errors import InputError, refuse
from hypose.evidence.keypoint_check import misread
from hypose.evidence.keypoints import IMPLAUSIBLE, KEYPOINT_SETS, arranged, bone_excess, keypoint_names, set_of_points
from hypose.geometry import Array
from hypose.io.files import file_name, match_names, read_json, write_text
from hypose.io.keypoints.keypoint_files import KEYPOINTS, MAX_POINT_FRAMES, KeypointTable, clock_file
from hypose.io.videos.video import evenly_spread

_OUTSIDE = 0.3  # share of points outside the picture above which its size must be wrong
_CHECKED = 80  # number of frames for the check of the views' agreement


@dataclass(frozen=True)
class ViewKeypoints:
    """Key points of one view and their set.

    path: file or folder.
    table: the key points that were read.
    keypoint_set: name of their set.
    first: the file's number of the video's first frame.
    score_scale: divisor of the scores.
    frames: stored frame of each frame of a video that is read by its time stamps; None where the numbers are equal.
    """

    path: Path
    table: KeypointTable
    keypoint_set: str
    first: int
    score_scale: float
    frames: NDArray[np.int64] | None = None

    @property
    def last(self) -> int:
        """The last frame of the video, from 0, for which the file has an entry; -1 where it is empty."""
        last = max(self.table.people, default=self.first - 1) - self.first
        return last if self.frames is None else int(np.searchsorted(self.frames, last, side="right")) - 1

    def frame(self, index: int, size: tuple[int, int], stored: tuple[int, int] | None = None) -> Array | None:
        """Get the people in a frame of the video, with points in the order of the set.

        index: frame of the video, from 0.
        size: width and height of the calibrated picture, px.
        stored: width and height of the pictures whose pixels the file uses, where they differ from `size`.
        Returns: (P, K, 3) px, px of the calibrated picture, confidence 0 to 1; None where the file has no entry for the
            frame.
        Raises: InputError where the number of points is not that of the set.
        """
        if self.frames is not None:
            index = int(self.frames[index]) if 0 <= index < len(self.frames) else -1
        found = self.table.people.get(index + self.first)
        if found is None:
            return None
        count = len(keypoint_names(self.keypoint_set))
        if len(found) == 0:
            return np.zeros((0, count, 3))
        if self.table.names is not None:
            found = arranged(self.table.names, found)[1]
        if found.shape[1] != count:
            raise InputError(
                f"{self.path}, frame {index + self.first}: {found.shape[1]} key points, {self.keypoint_set} has "
                f"{count}; name the detector's set with keypoint_set, or detect again."
            )
        out = found.copy()
        seen = out[..., 2] > 0
        if self.table.shares:
            out[..., :2] = np.where(seen[..., None], out[..., :2] * size - 0.5, 0.0)
        elif stored is not None:
            out[..., :2] = np.where(seen[..., None], (out[..., :2] + 0.5) * (np.array(size) / stored) - 0.5, 0.0)
        out[..., 2] = np.clip(out[..., 2] / self.score_scale, 0.0, 1.0)
        return out


def read_keypoints(path: Path) -> dict[str, KeypointTable]:
    """Read the key points of a file or folder of any known program.

    Returns: tables by camera; the name is "" where the file is of one camera.
    Raises: InputError where the path cannot be used.
    """
    parts = [path, clock_file(path)] if path.suffix.lower() == ".csv" else [path]
    states = [p.stat() for p in parts if p is not None and p.is_file()]
    return _read(path, tuple((s.st_mtime_ns, s.st_size) for s in states)) if states else _read.__wrapped__(path, ())


@lru_cache(maxsize=8)  # a recording is checked before it is processed
def _read(path: Path, state: tuple[tuple[int, int], ...]) -> dict[str, KeypointTable]:
    found = KEYPOINTS.read(path)
    return found if isinstance(found, dict) else {"": found}


def keypoints_of_views(
    paths: Sequence[Path | None],
    names: Sequence[str],
    cameras: Sequence[str],
    stated: str | None = None,
) -> tuple[list[ViewKeypoints | None], list[str]]:
    """Read the key points of all views, and determine their set.

    paths: file or folder of each view. One file of several cameras may be given for all views; each view then takes the
        camera of its name, or of its name in the calibration.
    names: names of the views.
    cameras: names of the views' cameras in the calibration.
    stated: name of the set that the user states.
    Returns: key points of each view, None where it has none, and notes that describe them.
    Raises: InputError where a file cannot be used or the views have different sets.
    """
    tables = [None if p is None else _of_view(p, i, names, cameras, paths) for i, p in enumerate(paths)]
    # frames of layouts that do not number them from the video's first begin with the smallest number of all views
    begin = min((min(t.people) for t in tables if t is not None and t.first is None and len(t.people)), default=0)
    samples = [np.zeros((0, 0, 3)) if t is None else t.sample() for t in tables]
    alike: dict[int, list[Array]] = {}  # views with as many points have one set
    for sample, table in zip(samples, tables, strict=True):
        if table is not None and table.names is None and len(sample):
            alike.setdefault(sample.shape[1], []).append(sample)
    out: list[ViewKeypoints | None] = []
    found: list[tuple[str, str]] = []
    for path, name, table, sample in zip(paths, names, tables, samples, strict=True):
        view = None
        if path is not None and table is not None and len(sample):
            first = begin if table.first is None else table.first
            try:
                view, how = _reported(path, table, first, sample, alike.get(sample.shape[1], []), stated)
            except InputError as problem:
                raise InputError(f"View {name}, key points {path}: {problem}") from None
            found.append((name, _described(view, how)))
        out.append(view)
    sets = {n: v.keypoint_set for n, v in zip(names, out, strict=True) if v is not None}
    if len(set(sets.values())) > 1:
        said = ", ".join(f"{n} {s}" for n, s in sets.items())
        raise InputError(f"The views have different sets of key points ({said}); detect all with one model.")
    empty = [n for n, p, v in zip(names, paths, out, strict=True) if p is not None and v is None]
    kind = next(iter(sets.values()), None)
    if kind is not None:  # views without a person have the set of the others
        out = [
            v if v is not None or p is None or t is None else ViewKeypoints(p, t, kind, t.first or 0, 1.0)
            for p, t, v in zip(paths, tables, out, strict=True)
        ]
    notes = [f"The key points of {', '.join(empty)} show no person."] if empty else []
    if len({text for _, text in found}) == 1:
        return out, [*notes, f"Key points: {found[0][1]}."]
    return out, notes + [f"Key points of {name}: {text}." for name, text in found]


def _of_view(
    path: Path, index: int, names: Sequence[str], cameras: Sequence[str], paths: Sequence[Path | None]
) -> KeypointTable:
    """Read the key points of one view.

    path: file or folder of the view.
    index: number of the view.
    names, cameras, paths: names, cameras and paths of all views, as for `keypoints_of_views`.
    Returns: the only table of the file, or the one of the view's camera.
    Raises: InputError where the cameras of the file do not fit the views that name it.
    """
    found = read_keypoints(path)
    if "" in found:
        return found[""]
    of_file = [i for i, p in enumerate(paths) if p == path]
    for wanted in (names, cameras):
        matched = match_names([wanted[i] for i in of_file], list(found))
        if None not in matched:
            place = matched[of_file.index(index)]
            return found[list(found)[place or 0]]
    if len(found) == len(of_file):
        return found[list(found)[of_file.index(index)]]
    raise InputError(
        f"{path} has the cameras {', '.join(found)}, and their names do not tell which belong to the views "
        f"{', '.join(names[i] for i in of_file)}; name each view like its camera."
    )


def _reported(
    path: Path,
    table: KeypointTable,
    first: int,
    sample: Array,
    alike: Sequence[Array],
    stated: str | None,
) -> tuple[ViewKeypoints, str]:
    """Determine the set, the unit and the scale of the scores of a view's key points.

    path: file or folder, for later messages.
    table: what the file holds.
    first: the file's number of the video's first frame.
    sample: (N, K, 3) people of some frames, at least one, as `KeypointTable.sample` gives them.
    alike: samples of all views with as many points without names, by whose bones the set is found.
    stated: name of the set that the user states.
    Returns: the key points, and how the set was found, as part of a note.
    Raises: InputError where the points belong to no set, or not to the stated one.
    """
    if (last := max(table.people)) - first > MAX_POINT_FRAMES:
        raise InputError(f"a frame has the number {last}, the first {first}; the file is damaged: export it again.")
    if table.names is not None:
        kind, sample, left = arranged(table.names, sample)
        how = "by their names" + (f", without {', '.join(left[:6])}{', ...' if len(left) > 6 else ''}" if left else "")
        faults = {
            f"named as they are ({kind}), their bones have impossible lengths; the names belong to other points, or "
            "the positions were changed: export them again": bone_excess(sample, kind) > IMPLAUSIBLE,
            f"their names are those of {kind}, not of {stated}; correct or remove keypoint_set": (
                stated is not None and keypoint_names(stated) != KEYPOINT_SETS[kind]
            ),
        }
        refuse("", faults)
    else:
        kind, how = set_of_points(alike, stated, ("BODY_25",))
    scores = sample[..., 2][sample[..., 2] > 0]
    high = float(np.quantile(scores, 0.995)) if len(scores) else 1.0
    # scores of RTMPose and AlphaPose are peaks of maps and may exceed 1; others are percent
    scale = float(np.quantile(scores, 0.95)) if high > 1.05 else 1.0
    if not table.shares and len(scores):
        seen = sample[sample[..., 2] > 0][:, :2]
        if seen.min() >= -0.5 and seen.max() <= 1.5 and np.ptp(seen) > 0.02:  # no person is as small as a pixel
            table = replace(table, shares=True)
    return ViewKeypoints(path, table, kind, first, scale), how


def _described(view: ViewKeypoints, how: str) -> str:
    """Describe what was assumed of the key points of a view, for a note. how: as of `_reported`."""
    table = view.table
    parts = [f"{table.layout}, {view.keypoint_set} ({how})"]
    if not table.scored:
        parts.append("without scores, so all count alike")
    elif view.score_scale != 1:
        parts.append(f"scores divided by {view.score_scale:.3g}, since they exceed 1")
    else:
        parts.append("scores 0 to 1")
    if table.shares:
        parts.append("positions as shares of the picture")
    parts.append(f"its frame {view.first} is the video's first")
    return ", ".join(parts)


def check_keypoints(
    views: Sequence[ViewKeypoints | None],
    names: Sequence[str],
    rig: CameraRig,
    frames: range,
    stored: Sequence[tuple[int, int] | None],
) -> None:
    """Check that key points lie in their pictures and agree between the views.

    views: key points of each view; None where it has none.
    names: names of the views.
    rig: calibrated cameras of the views.
    frames: frames of the video that are checked.
    stored: per view (width, height) of the pictures whose pixels the file uses, px; None where they are those of the
        calibrated picture.
    Raises: InputError where they were misread: another picture size, y upwards, or mirrored.
    """
    some = evenly_spread(frames.start, frames.stop, _CHECKED)
    people: list[list[Array | None]] = []
    for view, name, camera, size in zip(views, names, rig, stored, strict=True):
        found = [None if view is None else view.frame(i, camera.size, size) for i in some]
        people.append(found)
        seen = [p[p[..., 2] > 0.2][:, :2] for p in found if p is not None]
        uv = np.concatenate(seen) if seen else np.zeros((0, 2))
        outside = ((uv < -0.1 * np.array(camera.size)) | (uv > 1.1 * np.array(camera.size))).any(1)
        if view is not None and len(uv) > 50 and outside.mean() > _OUTSIDE:
            raise InputError(
                f"View {name}, key points {view.path}: they reach ({uv[:, 0].max():.0f}, {uv[:, 1].max():.0f}) px, the "
                f"pictures are calibrated for {camera.size[0]} x {camera.size[1]}; detect them in such pictures, or, "
                'if the video has their size, set keypoint_pixels = "image".'
            )
    kind = next((v.keypoint_set for v in views if v is not None), None)
    wrong = misread(people, keypoint_names(kind), rig) if kind is not None else None
    if wrong is not None:
        path = next(v.path for v in views if v is not None)
        raise InputError(
            f"The key points ({path}) do not fit the calibrated cameras: {wrong}; export them in pixels from the top "
            "left of the pictures that were calibrated."
        )


# ---- detected keypoints --------------------------------------------------------------------------------------------
# Key points and masks that `hypose keypoints` left in a recording's folder, and how the recording finds them.
#
# FOLDER/detector.json names the detector; FOLDER/VIEW/ holds one OpenPose file per frame, in pixels of the calibrated
# picture, numbered from the first frame of the video, and FOLDER/VIEW/masks the masks, if the detector gives any.


KEYPOINT_FOLDER = "keypoints"
"""Folder of the detected key points in the recording's folder."""
MASKS = "masks"
_SIDECAR = "detector.json"


@dataclass(frozen=True)
class DetectedKeypoints:
    """The folder with the results of a detection.

    keypoint_set: name of the set of the points.
    identity: detector and settings that determine the result.
    complete: all of the frames were processed in every view.
    frames: frames of the videos that were to be processed.
    with_masks: there are masks as well.
    """

    folder: Path
    keypoint_set: str
    identity: Mapping[str, Any]
    complete: bool
    frames: range
    with_masks: bool

    def view(self, name: str) -> Path:
        """Return the path of a view's folder of key points."""
        return self.folder / file_name(name)

    def file(self, view: str, frame: int) -> Path:
        """Return the path of the key-point file of a view and frame."""
        return self.view(view) / f"{file_name(view)}_{frame:012d}_keypoints.json"

    def masks(self, view: str) -> Path:
        """Return the path of a view's folder of masks."""
        return self.view(view) / MASKS

    def mask(self, view: str, frame: int) -> Path:
        """Return the path of the mask file of a view and frame."""
        return self.masks(view) / f"{frame:06d}.png"

    def covers(self, frames: range) -> bool:
        """Test whether all of the given frames were processed."""
        return self.complete and self.frames.start <= frames.start and frames.stop <= self.frames.stop

    def save(self) -> None:
        """Write these properties to the folder's detector.json."""
        said = {
            "keypoint_set": self.keypoint_set,
            "complete": self.complete,
            "frames": [self.frames.start, self.frames.stop],
            "masks": self.with_masks,
            **self.identity,
        }
        write_text(self.folder / _SIDECAR, json.dumps(said, indent=2) + "\n")


def load_detected(folder: Path) -> DetectedKeypoints | None:
    """Read the properties of a detection from its folder; None where the folder is not one of a detection.

    Raises: InputError where they are damaged.
    """
    path = folder / _SIDECAR
    if not path.is_file():
        return None
    try:
        identity = dict(read_json(path, "what hypose keypoints wrote"))
        points, complete = str(identity.pop("keypoint_set")), bool(identity.pop("complete"))
        first, stop = identity.pop("frames")
        frames, masks = range(int(first), int(stop)), bool(identity.pop("masks", False))
    except (InputError, ValueError, KeyError, TypeError):
        raise InputError(
            f"{path} is damaged; delete the folder {folder} and detect again with hypose keypoints."
        ) from None
    return DetectedKeypoints(folder, points, identity, complete, frames, masks)


def with_detected(folder: Path, settings: Mapping[str, Any], notes: list[str]) -> Mapping[str, Any]:
    """Add the detected key points and masks of a recording to its settings.

    Key points are added where the settings have none. Masks are added where the settings have no masks, background or
    depth.

    folder: folder of the recording.
    settings: keys of recording.toml.
    notes: list to which sentences about this are added.
    Returns: the changed settings.
    """
    tables = settings.get("view", [])
    if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
        return settings  # the check of the recording reports it
    if any("keypoints" in t for t in tables):
        return settings
    found = load_detected(folder / KEYPOINT_FOLDER)
    if found is None:
        return settings
    if not found.complete:
        notes.append(f"The key points in {found.folder} are not complete and not used; see hypose keypoints --resume.")
        return settings
    views = []
    masks = found.with_masks and not any(t.keys() & {"masks", "background", "depth"} for t in tables)
    for table in tables:
        name = str(table.get("name", ""))
        path = found.view(name)
        more = {"keypoints": str(path.absolute())}
        more |= {"masks": str(found.masks(name).absolute())} if masks else {}
        views.append({**table, **more} if name and path.is_dir() else table)
    what = f"Key points ({found.keypoint_set}){' and masks' if masks else ''}"
    notes.append(f"{what} are those that hypose keypoints wrote to {found.folder}.")
    own = {"keypoint_set": found.keypoint_set, "keypoint_lag": 0, "keypoint_pixels": "calibration"}
    return {**settings, **own, "view": views}
