"""Key points and masks that `hypose keypoints` left in a recording's folder: where they lie, how the recording finds
them.

FOLDER/detector.json says what made them; FOLDER/VIEW/ holds one OpenPose file per frame, in pixels of the calibrated
picture, numbered from the first frame of the video, and FOLDER/VIEW/masks the masks, if the detector gives any.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hypose.errors import InputError
from hypose.io.file_names import file_name
from hypose.io.files import read_json, write_text

FOLDER = "keypoints"
"""In the recording's folder."""
MASKS = "masks"
_SIDECAR = "detector.json"
ALL_FRAMES = 10**9
"""Frames of a detection that does not say which; an older one looked at all."""


@dataclass(frozen=True)
class DetectedKeypoints:
    """The folder of a detection.

    keypoint_set: name of the points' set.
    identity: what decides what was found.
    complete: each of the frames was looked at in every view.
    frames: of the videos.
    with_masks: there are masks, too."""

    folder: Path
    keypoint_set: str
    identity: Mapping[str, Any]
    complete: bool
    frames: range
    with_masks: bool

    def view(self, name: str) -> Path:
        """The folder of a view."""
        return self.folder / file_name(name)

    def file(self, view: str, frame: int) -> Path:
        """The file of a frame."""
        return self.view(view) / f"{file_name(view)}_{frame:012d}_keypoints.json"

    def masks(self, view: str) -> Path:
        """The folder of a view's masks."""
        return self.view(view) / MASKS

    def mask(self, view: str, frame: int) -> Path:
        """The mask of a frame."""
        return self.masks(view) / f"{frame:06d}.png"

    def covers(self, frames: range) -> bool:
        """Whether these frames were looked at."""
        return self.complete and self.frames.start <= frames.start and frames.stop <= self.frames.stop

    def save(self) -> None:
        """Write what says all this."""
        said = {
            "keypoint_set": self.keypoint_set,
            "complete": self.complete,
            "frames": [self.frames.start, self.frames.stop],
            "masks": self.with_masks,
            **self.identity,
        }
        write_text(self.folder / _SIDECAR, json.dumps(said, indent=2) + "\n")


def load_detected(folder: Path) -> DetectedKeypoints | None:
    """What a folder says of itself, None when it is not one of these."""
    path = folder / _SIDECAR
    if not path.is_file():
        return None
    try:
        identity = dict(read_json(path, "what hypose keypoints wrote"))
        points, complete = str(identity.pop("keypoint_set")), bool(identity.pop("complete"))
        first, stop = identity.pop("frames", (0, ALL_FRAMES))
        frames, masks = range(int(first), int(stop)), bool(identity.pop("masks", False))
    except (InputError, ValueError, KeyError, TypeError):
        raise InputError(
            f"{path} is damaged; delete the folder {folder} and detect again with hypose keypoints."
        ) from None
    return DetectedKeypoints(folder, points, identity, complete, frames, masks)


def with_detected(folder: Path, settings: Mapping[str, Any], notes: list[str]) -> Mapping[str, Any]:
    """The settings of a recording (keys of recording.toml) with the key points that were detected for it, unless it
    names its own, and with the detector's masks, unless it says where masks come from."""
    tables = settings.get("view", [])
    if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
        return settings  # which the recording's own check tells
    if any("keypoints" in t for t in tables):
        return settings
    found = load_detected(folder / FOLDER)
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
