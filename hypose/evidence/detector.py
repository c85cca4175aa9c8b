"""What a detector of 2D key points has to offer, and the file that its points are kept in."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.geometry import Array


class PoseDetector(Protocol):
    """Finds people in one picture. What it finds depends on that picture alone, so that frames can be looked at in any
    order and work can go on where it stopped."""

    @property
    def keypoint_set(self) -> str:
        """Name of its set of key points, one of `hypose.evidence.keypoints.KEYPOINT_SETS`."""
        ...

    @property
    def identity(self) -> dict[str, Any]:
        """Everything that decides what it finds, as JSON values: program, version, model, settings."""
        ...

    def detect(self, image: NDArray[np.uint8], /) -> Array:
        """People (P, K, 3) in a picture (h, w, 3) BGR: u, v in px of the picture (pixel centres at integers) and
        confidence 0..1, 0 where a point was not found."""
        ...


def openpose_document(people: ArrayLike) -> dict[str, Any]:
    """People (P, K, 3) as OpenPose writes them; who has no point with confidence is left out."""
    seen = [p for p in np.asarray(people, dtype=np.float64) if (p[:, 2] > 0).any()]
    return {
        "version": 1.3,
        "people": [{"person_id": [-1], "pose_keypoints_2d": np.round(p, 3).ravel().tolist()} for p in seen],
    }
