"""Points of the body seen in one picture: key points of a detector and clicked joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body
from hypose.errors import InputError
from hypose.evidence.keypoints import landmark_of, person_size
from hypose.geometry import Array

_KEYPOINT_SHARE = 0.016
"""Standard deviation of a detector's point, as a share of the person's size in the picture."""
FEWEST_PX = 1.0
_MIN_CONFIDENCE = 0.3


@dataclass(frozen=True)
class MonoPoints:
    """Points of the body seen in one picture: key points of a detector or clicked joints.

    pixels: (P, 2) in the undistorted image, px.
    confidence: (P,) weights; 0 = not seen.
    joint: (P,) index of the joint to which the point is fixed.
    offset: (P, 3) position of the point in the joint's frame, m.
    scale_px: (P,) standard deviations, px.
    """

    pixels: Array
    confidence: Array
    joint: NDArray[np.int64]
    offset: Array
    scale_px: Array


def points_from_keypoints(
    body: Body, names: Sequence[str], keypoints: ArrayLike, *, scale_px: float = 4.0
) -> MonoPoints:
    """Place the key points of one view on a body.

    Key points that the body does not have, weak ones (confidence below _MIN_CONFIDENCE) and not finite ones get
    confidence 0.
    names: (K) names of the key points.
    keypoints: (K, 3) u px, v px, confidence.
    scale_px: standard deviation of a key point, px.
    Raises: InputError where the shape does not fit the names.
    """
    k = np.array(keypoints, dtype=np.float64)
    if k.shape != (len(names), 3):
        raise InputError(f"{len(names)} key points need the shape {(len(names), 3)} (u, v, confidence), got {k.shape}.")
    joint, offset, known = landmark_of(names, body)
    seen = known & np.isfinite(k).all(1) & (np.nan_to_num(k[:, 2]) >= _MIN_CONFIDENCE)
    pixels = np.where(seen[:, None], k[:, :2], 0.0)
    return MonoPoints(pixels, np.where(seen, k[:, 2], 0.0), joint, offset, np.full(len(k), scale_px))


def clicked_joints(body: Body, clicks: Mapping[str, tuple[float, float]], scale_px: float = 4.0) -> MonoPoints:
    """Convert clicked joints of a picture to points with confidence 1.

    clicks: joint name -> (u, v) px; scale_px: standard deviation of a click, px.
    Raises: InputError, listing the joints, where a name is not a joint of the body.
    """
    joint = np.array([body.skeleton.joint(name) for name in clicks], dtype=np.int64)
    pixels = np.array(list(clicks.values()), dtype=np.float64).reshape(-1, 2)
    n = len(joint)
    return MonoPoints(pixels, np.ones(n), joint, np.zeros((n, 3)), np.full(n, scale_px))


def keypoints_on(body: Body, names: Sequence[str], keypoints: Array) -> MonoPoints:
    """Place key points (K, 3) on a body, with the error that detectors usually have at that size of the person.

    names: (K) names of the key points.
    keypoints: (K, 3) u px, v px, confidence.
    """
    scale = max(FEWEST_PX, _KEYPOINT_SHARE * person_size(keypoints))
    return points_from_keypoints(body, names, keypoints, scale_px=scale)
