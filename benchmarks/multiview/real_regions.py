"""Do the regions of a real clip hold its triangulated key points?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.bench_report import Row
from benchmarks.multiview.real_recordings import LIMBS
from benchmarks.multiview.spread_fit import held_rows, squares
from hypose.body.motion import Motion
from hypose.evidence.frame import Frame
from hypose.evidence.keypoints import BODY_25B
from hypose.geometry import Array
from hypose.tracking.keypoint_evidence import MIN_CONFIDENCE
from hypose.tracking.pose_covariance import joint_group


def regions_of_balancing(motion: Motion, evidence: str, reference: Array, reference_error: Array | None) -> list[Row]:
    """Coverage and level error of the regions of 12 limb joints against triangulated key points (T, 25, 3) m of the
    balancing clip, where a detector's points and the body's joints are brought to the same definition by one offset
    per joint, learnt over the clip. reference_error (T, 25, 3, 3) m^2: what the reference errs by itself, as
    `errors_of_points` has it; None: that counts as the motion's, as it must where both come from the same points."""
    assert motion.poses is not None
    rotations, centres = motion.skeleton.forward(motion.poses[1:])  # key-point file t belongs to video frame t + 1
    covariance = motion.joint_covariance[1:].astype(np.float64)
    found: dict[str, list[Array]] = {}
    for k in LIMBS:
        name = BODY_25B[k]
        j = motion.skeleton.joint(name)
        local = np.einsum("tba,tb->ta", rotations[:, j], reference[: len(centres), k] - centres[: len(reference), j])
        away = np.einsum("tab,tb->ta", rotations[:, j], local - np.nanmean(local, 0))
        known = np.isfinite(away).all(1)
        around = covariance[: len(away), j]
        if reference_error is not None:
            around = around + reference_error[: len(away), k]
            known &= np.isfinite(around).all((1, 2))
        m2 = squares(away[known], around[known], 1.0, 0.0)
        for group in (joint_group(name), "all"):
            found.setdefault(group, []).append(m2)
    rows: list[Row] = []
    for group, parts in found.items():
        rows += held_rows(np.concatenate(parts), 3, f"{evidence}/balancing/{group}")
    return rows


def errors_of_points(frames: Sequence[Frame], points_world: Array) -> Array:
    """(T, K, 3, 3) m^2, NaN where a point is not seen twice: covariances of points (T, K, 3) m that were triangulated
    from the key points of frames, from what these leave in each view."""
    found = [f.keypoints for f in frames]
    rig = next(k for k in found if k is not None).rig
    shape = points_world.shape[:2]
    seen = np.stack([np.zeros((len(rig), shape[1], 3)) if k is None else np.nan_to_num(k.points) for k in found], 1)
    information = np.zeros((*shape, 3, 3))
    for c in range(len(rig)):
        p = rig.projections[c]
        h = points_world @ p[:, :3].T + p[:, 3]
        uv = h[..., :2] / h[..., 2:]
        slope = (p[:2, :3] - uv[..., None] * p[2, :3]) / h[..., 2, None, None]
        use = (seen[c, ..., 2] > MIN_CONFIDENCE) & np.isfinite(uv).all(-1)
        left = np.linalg.norm(seen[c, ..., :2] - uv, axis=-1)[use]
        # the median of a Rayleigh distance is 1.18 sd; of 2 C coordinates a point has taken 3
        sd = float(np.median(left)) / 1.177 / np.sqrt((2 * len(rig) - 3) / (2 * len(rig)))
        rows = np.where(use[..., None, None], np.nan_to_num(slope), 0.0) / sd
        information += np.einsum("tkia,tkib->tkab", rows, rows)
    twice = (seen[..., 2] > MIN_CONFIDENCE).sum(0) > 1
    out = np.linalg.inv(information + 1e-9 * np.eye(3))
    return np.where(twice[..., None, None], out, np.nan)
