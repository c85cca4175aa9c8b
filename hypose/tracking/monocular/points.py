"""Points of the body seen in one picture: key points of a detector and clicked joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body
from hypose.errors import EvidenceError, InputError
from hypose.evidence.keypoints import landmark_of, person_size
from hypose.geometry import Array

KEYPOINT_SHARE = 0.016
"""1 sd of a detector's point, as a share of the person's size in the picture."""
FEWEST_PX = 1.0


@dataclass(frozen=True)
class MonoPoints:
    """Points of the body seen in the image: key points of a detector and clicked joints.

    pixels (P, 2) of the undistorted image; confidence (P,) the weight, 0 = not seen; joint (P,), offset (P, 3) m in
    the joint's frame: where the point sits on the body; scale_px (P,): 1 sd."""

    pixels: Array
    confidence: Array
    joint: NDArray[np.int64]
    offset: Array
    scale_px: Array

    def __post_init__(self) -> None:
        p = len(self.pixels)
        shapes = [np.shape(a) for a in (self.pixels, self.confidence, self.joint, self.offset, self.scale_px)]
        if shapes != [(p, 2), (p,), (p,), (p, 3), (p,)]:
            raise InputError(
                "Points need pixels (P, 2), confidence (P,), joint (P,), offset (P, 3) and scale_px (P,), got "
                f"{', '.join(map(str, shapes))}."
            )
        bad = (self.confidence > 0) & ~np.isfinite(self.pixels).all(1)
        if bad.any():
            raise EvidenceError(
                f"Point {int(bad.argmax())} of {p} has a confidence but no finite position; give missing points "
                "confidence 0."
            )
        if not (np.asarray(self.scale_px) > 0).all():
            raise InputError("Every point needs a scale_px above 0: its standard deviation in pixels.")


def points_from_keypoints(
    body: Body,
    names: Sequence[str],
    keypoints: ArrayLike,
    *,
    scale_px: float = 4.0,
    min_confidence: float = 0.3,
    joint: NDArray[np.int64] | None = None,
    offset: Array | None = None,
) -> MonoPoints:
    """Key points (K, 3) = (u px, v px, confidence) of one view. Those that the body does not know, that are weaker than
    min_confidence or not finite get confidence 0. joint (K,), offset (K, 3): learnt places instead of the usual ones.
    """
    k = np.array(keypoints, dtype=np.float64)
    if k.shape != (len(names), 3):
        raise InputError(f"{len(names)} key points need the shape {(len(names), 3)} (u, v, confidence), got {k.shape}.")
    on_joint, at, known = landmark_of(names, body)
    if joint is not None and offset is not None:
        on_joint, at = np.asarray(joint), np.asarray(offset)
    seen = known & np.isfinite(k).all(1) & (np.nan_to_num(k[:, 2]) >= min_confidence)
    pixels = np.where(seen[:, None], k[:, :2], 0.0)
    return MonoPoints(pixels, np.where(seen, k[:, 2], 0.0), on_joint, at, np.full(len(k), scale_px))


def clicked_joints(body: Body, clicks: Mapping[str, tuple[float, float]], scale_px: float = 4.0) -> MonoPoints:
    """Joints clicked in an image: name -> (u, v) px; an InputError lists the joints."""
    joint = np.array([body.skeleton.joint(name) for name in clicks], dtype=np.int64)
    pixels = np.array(list(clicks.values()), dtype=np.float64).reshape(-1, 2)
    n = len(joint)
    return MonoPoints(pixels, np.ones(n), joint, np.zeros((n, 3)), np.full(n, scale_px))


def keypoints_on(body: Body, names: Sequence[str], keypoints: Array) -> MonoPoints:
    """Key points (K, 3) on a body, with the error that detectors have at that size."""
    scale = max(FEWEST_PX, KEYPOINT_SHARE * person_size(keypoints))
    return points_from_keypoints(body, names, keypoints, scale_px=scale)
