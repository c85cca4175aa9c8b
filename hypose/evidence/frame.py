"""Frame: one instant of evidence; every piece is optional and has its own type."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import CameraRig
from hypose.geometry import Array


@dataclass(frozen=True)
class Silhouettes:
    """Masks of the person, one per view, undistorted (pinhole), at one working size.

    masks: (C, h, w) uint8, 1 = person; views of different size are padded with 0 to the common (h, w), `rig.sizes`
    tells each view's own size. rig: the pinhole cameras of these masks. usable: (C,) bool, False for a view that is
    left out (empty, collapsed, or its camera delivered no frame). reasons: (C,) short text, "" when usable.
    """

    masks: NDArray[np.uint8]
    rig: CameraRig
    usable: NDArray[np.bool_]
    reasons: tuple[str, ...]

    @property
    def areas(self) -> NDArray[np.int64]:
        """(C,) foreground pixels."""
        return self.masks.reshape(len(self.masks), -1).sum(1, dtype=np.int64)


@dataclass(frozen=True)
class Keypoints:
    """2D key points of one person in every view.

    points: (C, K, 3) = (u px, v px, confidence 0..1), undistorted pixels of `rig`; confidence 0 where missing.
    names: K key-point names (hypose.evidence.keypoints documents the sets). rig: pinhole cameras of these pixels.
    """

    points: Array
    names: tuple[str, ...]
    rig: CameraRig


@dataclass(frozen=True)
class Detections:
    """Detected parts: points (M, 3) m world, score (M,), part (M,) index of the part. The bridge from detectors to
    kernels."""

    points: Array
    score: Array
    part: NDArray[np.int32]


@dataclass(frozen=True)
class Frame:
    """One instant. time: s, index: frame number; the pieces are None when this frame has no such evidence."""

    time: float
    index: int
    silhouettes: Silhouettes | None = None
    keypoints: Keypoints | None = None
    detections: Detections | None = None
