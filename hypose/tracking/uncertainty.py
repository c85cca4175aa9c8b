"""Uncertainty of joints: from the curvature of the solved cost, or from the spread of a weighted set."""

from __future__ import annotations

import numpy as np

from hypose import compute
from hypose.body.body import Body
from hypose.fitting.articulated import SolveOptions
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.evidence import PreparedFrame, posed
from hypose.tracking.refinement import refine

# The default weight of a contour row (0.05) already makes up for rows that err together and for a body whose shape is
# only nearly right: nominal 90 % regions held the truth in 94 % on dressed subjects of another shape space (walk and
# box, four subjects). A factor that is measured, not derived; another weight needs another one.
CURVATURE_INFLATION = 1.0
FLOOR = 0.005
"""m; no joint centre of a fitted body is known better than this."""


def joint_sd_of_pose(body: Body, pose: Array, frame: PreparedFrame) -> Array:
    """(J,) sd per axis (m) of the joint centres at a solved pose (D,), from the inverse of the cost's Hessian.

    Covariance = inflation^2 H^-1 with the priors in H, so a joint that no view sees keeps the prior's spread.
    """
    hessian = frame.known.hessians.get(posed(body, pose))
    if hessian is None:
        hessian = refine(body, pose[None], frame, SolveOptions(iterations=0, coarse_iterations=0))[0].hessian
    sd = compute.joint_spread(pose, body.skeleton.tree, hessian)
    return np.hypot(CURVATURE_INFLATION * sd, FLOOR)


def joint_sd_of_set(body: Body, h: Hypotheses) -> Array:
    """(J,) sd per axis (m) of the joint centres over a weighted set (N, D)."""
    joints = body.joints(h.values)
    w = h.weights[:, None, None]
    mean = (w * joints).sum(0)
    return np.hypot(np.sqrt((w * (joints - mean) ** 2).sum((0, 2)) / 3), FLOOR)
