"""Interface of a detector of 2D key points, and the file in which its points are stored."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.evidence.pose_network import Crop, Sighting


class PoseDetector(Protocol):
    """Interface of a detector that finds people in the pictures of a view, one picture after the other."""

    @property
    def keypoint_set(self) -> str:
        """Name of the detector's set of key points, one of `hypose.evidence.keypoints.KEYPOINT_SETS`."""
        ...

    @property
    def identity(self) -> dict[str, Any]:
        """All values that determine the detector's results, as JSON values: program, version, model, settings."""
        ...

    @property
    def gives_masks(self) -> bool:
        """Whether the detector finds masks as well as key points; then several threads may call it at once."""
        ...

    def look(self, image: NDArray[np.uint8], number: int, before: Sequence[Crop], /) -> list[Sighting]:
        """Detect the people in a picture.

        image: (h, w, 3) BGR; pixel centres at integers.
        number: number of the picture in the video.
        before: expected places of the people of the previous picture.
        Returns: one item per person found; empty where there is none. It must depend on these arguments alone, so
            that interrupted work can be resumed.
        """
        ...


def openpose_document(people: ArrayLike) -> dict[str, Any]:
    """Convert people (P, K, 3), px and confidence, to OpenPose's JSON document; people without a confident point are
    left out.
    """
    seen = [p for p in np.asarray(people, dtype=np.float64) if (p[:, 2] > 0).any()]
    return {
        "version": 1.3,
        "program": "hypose",
        "people": [{"person_id": [-1], "pose_keypoints_2d": np.round(p, 3).ravel().tolist()} for p in seen],
    }
