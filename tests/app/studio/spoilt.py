"""A tracked recording with an arm spoilt on purpose, for the walks that find it and put it right."""

from dataclasses import replace

import numpy as np

from hypose.geometry import runs
from hypose.io.motions.results import load_motion, save_motion
from hypose.pipeline.assessment import assess

ARM = ("left_elbow", "left_wrist")
ROWS = slice(14, 26)


def spoil_arm(results, rows=ROWS, turn=1.3):
    """The left arm lifted by `turn` rad in some rows of a result, and doubted there as the audit doubts one."""
    motion = load_motion(results / "motion.npz")
    skeleton = motion.skeleton
    poses = motion.poses.copy()
    poses[rows, skeleton.dofs_of("left_shoulder")] += turn * np.array([0.0, 1.0, 0.3])
    _, joints = skeleton.forward(poses)
    low_confidence = np.zeros((len(motion), len(skeleton.joint_names)), dtype=bool)
    low_confidence[rows, [[skeleton.joint(n)] for n in ARM]] = True
    error_probability = np.where(low_confidence, np.float32(0.7), np.float32(0.01))
    spoilt = replace(
        motion,
        poses=poses,
        joints=joints,
        low_confidence=low_confidence.any(1),
        low_confidence_joints=low_confidence,
        error_probability=error_probability,
    )
    save_motion(spoilt, results / "motion.npz")
    (results / "assessment.json").unlink(missing_ok=True)
    assert assess(spoilt).word == "look" and runs(low_confidence.any(1)) == [range(rows.start, rows.stop)]
    return spoilt
