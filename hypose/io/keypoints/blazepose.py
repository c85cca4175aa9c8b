"""Key points by MediaPipe's Pose Landmarker. Needs mediapipe (an extra) and a model file of the user's own.

Pictures are looked at one by one (running mode IMAGE): the mode for videos filters its points over time, and a filter's
lag is the last thing that a solve over the whole clip needs.

Source: the Pose Landmarker guide for Python, ai.google.dev/edge/mediapipe/solutions/vision/pose_landmarker/python.
"""

from __future__ import annotations

import contextlib
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.errors import InputError, extra
from hypose.evidence.keypoints import BLAZEPOSE_33
from hypose.geometry import Array
from hypose.io.files import open_file
from hypose.io.recordings.provenance import file_identity

_MAX_BYTES = 2**30
_INSIDE = "pose_landmarks_detector.tflite"
"""What every bundle of a Pose Landmarker holds."""
_KIND = "a model bundle of MediaPipe's Pose Landmarker (.task)"


@dataclass(frozen=True)
class BlazePose:
    """The landmarker as a `PoseDetector`; opened by `open_blazepose`."""

    library: Any
    landmarker: Any
    identity: dict[str, Any]
    keypoint_set: str = "BLAZEPOSE_33"

    def detect(self, image: NDArray[np.uint8], /) -> Array:
        """People (P, 33, 3) in a picture (h, w, 3) BGR."""
        rgb = np.ascontiguousarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
        found = self.landmarker.detect(self.library.Image(image_format=self.library.ImageFormat.SRGB, data=rgb))
        people = [[_point(p) for p in person] for person in found.pose_landmarks]
        return to_pixels(
            np.array(people, dtype=np.float64).reshape(-1, len(BLAZEPOSE_33), 3), rgb.shape[1], rgb.shape[0]
        )


@contextlib.contextmanager
def open_blazepose(model: str | Path, people: int = 3) -> Iterator[BlazePose]:
    """The landmarker with a model file, for at most `people` persons in a picture. An InputError when the file is none
    of its models or mediapipe is missing."""
    path = Path(model)
    if not 1 <= people <= 20:
        raise InputError(f"{people} people cannot be looked for; give 1 to 20.")
    digest = _checked_model(path)
    library = _library()
    vision = library.tasks.vision
    options = vision.PoseLandmarkerOptions(
        base_options=library.tasks.BaseOptions(model_asset_path=str(path)),
        running_mode=vision.RunningMode.IMAGE,
        num_poses=people,
    )
    try:
        landmarker = vision.PoseLandmarker.create_from_options(options)
    except (RuntimeError, ValueError, OSError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(
            f"mediapipe {_version(library)} cannot use the model {path} ({reason}); give {_KIND} that belongs to "
            "this version."
        ) from None
    identity = {"detector": "mediapipe", "version": _version(library), "model": digest, "people": people}
    with landmarker:
        yield BlazePose(library, landmarker, identity)


def _point(landmark: Any) -> tuple[float, float, float]:
    """x and y in shares of the picture, and confidence: that the point is in the picture and nothing is before it."""
    likely = [p for p in (landmark.visibility, landmark.presence) if p is not None]
    return float(landmark.x), float(landmark.y), float(np.prod(likely)) if likely else 1.0


def to_pixels(people: Array, width: int, height: int) -> Array:
    """Shares of the picture's sides (P, K, 3) as pixels; what was guessed outside of the picture is not kept."""
    share = people[..., :2]
    inside = np.asarray(np.isfinite(people).all(-1) & (share >= 0).all(-1) & (share <= 1).all(-1))
    out = np.empty_like(people)
    out[..., :2] = share * (width, height) - 0.5
    out[..., 2] = np.clip(people[..., 2], 0.0, 1.0)
    return np.where(inside[..., None], out, 0.0)


def _checked_model(path: Path) -> str:
    """SHA-256 of a model bundle; an InputError when the file is something else."""
    try:
        with open_file(path, _KIND, _MAX_BYTES) as stream, zipfile.ZipFile(stream) as bundle:
            inside = bundle.namelist()
    except zipfile.BadZipFile:
        raise InputError(f"{path} is no model bundle; give {_KIND}, which is a zip archive.") from None
    if _INSIDE not in inside:
        raise InputError(f"{path} is no model of a pose (it holds no {_INSIDE}); give {_KIND}.")
    return str(file_identity(path)["sha256"])


def _library() -> Any:
    named = "name the key points of any other detector in recording.toml (docs/recordings.md)"
    return extra("mediapipe", "Detecting key points", "mediapipe", or_else=named)


def _version(library: Any) -> str:
    return str(getattr(library, "__version__", "of an unknown version"))
