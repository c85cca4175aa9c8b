"""Does the motion from one camera fit its picture? The key points say so, or the mask where there are none.

Nothing in one picture contradicts a wrong depth, so that the best that such a motion can be called is worth a look. A
body that does not even lie where the picture shows it is not to be trusted.
"""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np

from hypose.body.body import Body
from hypose.body.motion import Modes
from hypose.evidence.frame import Frame, Keypoints, Silhouettes
from hypose.evidence.keypoints import person_size
from hypose.geometry import Array
from hypose.pipeline.doubts import in_words, runs
from hypose.tracking.keypoint_evidence import MIN_CONFIDENCE, keypoint_model

FAR, OUTSIDE = 0.12, 0.04
"""Share of the person's size by which a key point lies elsewhere than on the body, and a joint outside of the mask:
detectors put necks and hips up to 0.07 beside the body's"""
BESIDE, BESIDE_FRAME = 0.15, 0.2
"""Share of the key points, or joints, that are elsewhere from which on a motion is not to be trusted, and a frame is
doubtful. Motions that lay on the person had 0.00 to 0.04, and 0.18 at most in a frame (four real cameras, four
simulated), those with limbs elsewhere, or key points half a second late, 0.30 to 0.65 (simulated)"""
_LEAST, _LIMBS = 4, ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
"""key points that tell, and of what: a face has many, beside which an arm would not count"""


def beside_the_picture(body: Body, poses: Array, frames: Iterable[Frame]) -> Array:
    """(T,): the share of what one camera shows that poses (T, D) put elsewhere in the picture; NaN where it shows
    nothing."""
    out = np.full(len(poses), np.nan)
    for t, frame in enumerate(frames):
        if not np.isfinite(poses[t]).all():
            continue
        if frame.keypoints is not None:
            out[t] = _far(body, poses[t], frame.keypoints)
        elif frame.silhouettes is not None:
            out[t] = _outside(body, poses[t], frame.silhouettes)
    return out


def against_the_picture(share: Array) -> tuple[str, ...]:
    """Sentences that make a motion not to be trusted, by `beside_the_picture`."""
    if not np.isfinite(share).any() or np.nanmean(share) <= BESIDE:
        return ()
    where = in_words(runs(np.nan_to_num(share) > BESIDE))
    return (
        f"{100 * np.nanmean(share):.0f} % of what the picture shows of the person lies elsewhere than on the body, "
        f"above all in {where}: look at the overlay, and whether key points and camera are those of this video; begin "
        "elsewhere with --frames, or give --start with clicked joints",
    )


def doubt_of_depth(modes: Modes) -> str:
    """A sentence for the verdict on what no picture contradicts."""
    return (
        f"one camera does not measure depth, which is known to +-{1e3 * float(np.nanmedian(modes.depth_sd)):.0f} mm (1 "
        "sd, median) as far as the lens and the person's size are right: see the notes"
    )


def _far(body: Body, pose: Array, keypoints: Keypoints) -> float:
    points = np.nan_to_num(keypoints.points[0])
    model = keypoint_model(body, keypoints.names)
    limb = np.array([n.startswith(("left_", "right_")) and n.endswith(_LIMBS) for n in keypoints.names])
    seen = limb & model.known & (points[:, 2] > MIN_CONFIDENCE)
    size = person_size(points)
    if seen.sum() < _LEAST or not size > 0:
        return np.nan
    uv = keypoints.rig[0].project_pinhole(model.positions(body, pose))
    return float((np.linalg.norm(uv - points[:, :2], axis=1)[seen] > FAR * size).mean())


def _outside(body: Body, pose: Array, silhouettes: Silhouettes) -> float:
    w, h = silhouettes.rig[0].size
    mask = np.minimum(silhouettes.masks[0, :h, :w], 1)
    if not silhouettes.usable[0] or not mask.any():
        return np.nan
    away = cv2.distanceTransform(1 - mask, cv2.DIST_L2, 3)
    uv = np.rint(silhouettes.rig[0].project_pinhole(body.joints(pose))).astype(int)
    inside = (uv >= 0).all(1) & (uv[:, 0] < w) & (uv[:, 1] < h)
    if not inside.any():
        return np.nan
    return float((away[uv[inside, 1], uv[inside, 0]] > OUTSIDE * max(cv2.boundingRect(mask)[2:])).mean())
