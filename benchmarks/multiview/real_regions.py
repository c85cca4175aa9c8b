"""Do the regions of a real clip hold its triangulated key points?"""

from __future__ import annotations

import numpy as np

from benchmarks.bench_report import Row
from benchmarks.multiview.real_recordings import LIMBS
from benchmarks.multiview.spread_fit import covered, level_error, squares
from hypose.body.motion import Motion
from hypose.evidence.keypoints import BODY_25B
from hypose.geometry import Array
from hypose.tracking.pose_covariance import joint_group


def regions_of_balancing(motion: Motion, evidence: str, reference: Array) -> list[Row]:
    """Coverage and level error of the regions of 12 limb joints against triangulated key points (T, 25, 3) m of the
    balancing clip, where a detector's points and the body's joints are brought to the same definition by one offset
    per joint, learnt over the clip; what the reference errs by itself counts as the motion's."""
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
        m2 = squares(away[known], covariance[known, j], 1.0, 0.0)
        for group in (joint_group(name), "all"):
            found.setdefault(group, []).append(m2)
    rows = []
    for group, parts in found.items():
        m2, case = np.concatenate(parts), f"{evidence}/balancing/{group}"
        rows += [
            Row("coverage_90", case, covered(m2, 3), "1", n=len(m2)),
            Row("ece", case, level_error(m2, 3), "1", n=len(m2)),
        ]
    return rows
