"""What a detector of 2D key points has to offer, and the file that its points are kept in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.evidence.pose_network import Crop, Sighting


class PoseDetector(Protocol):
    """Finds people in the pictures of a view, one after the other."""

    @property
    def keypoint_set(self) -> str:
        """Name of its set of key points, one of `hypose.evidence.keypoints.KEYPOINT_SETS`."""
        ...

    @property
    def identity(self) -> dict[str, Any]:
        """Everything that decides what it finds, as JSON values: program, version, model, settings."""
        ...

    @property
    def gives_masks(self) -> bool:
        """Whether it finds masks as well; then it may be called by several threads at once."""
        ...

    def look(self, image: NDArray[np.uint8], number: int, before: Sequence[Crop], /) -> list[Sighting]:
        """People in a picture (h, w, 3) BGR with its number in the video, pixel centres at integers; before: where the
        people of the picture before it are expected. The result depends on these alone, so that work can go on where
        it stopped."""
        ...


def openpose_document(people: ArrayLike) -> dict[str, Any]:
    """People (P, K, 3) as OpenPose writes them; who has no point with confidence is left out."""
    seen = [p for p in np.asarray(people, dtype=np.float64) if (p[:, 2] > 0).any()]
    return {
        "version": 1.3,
        "program": "hypose",
        "people": [{"person_id": [-1], "pose_keypoints_2d": np.round(p, 3).ravel().tolist()} for p in seen],
    }
