"""The covariances of the curvature, as they were before they were calibrated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hypose.body.joint_angles import ANGLE_NAMES
from hypose.body.motion import Motion
from hypose.tracking.fitted_spread import apart_factors, fitted, kind_of


def as_curved(motion: Motion, evidence: str, beyond: float = 0.0) -> Motion:
    """What `with_fitted_joints` and `with_fitted_angles` were given of V: for fitting anew."""
    joints, angles = (fitted()[what][evidence] for what in ("joints", "angles"))
    _, by_joint, by_angle = apart_factors(evidence)
    a, b = np.array([joints.get(kind_of(n), (1.0, 0.0)) for n in motion.skeleton.joint_names]).T
    floor = b**2 + (by_joint * beyond) ** 2
    assert motion.systematic_covariance is not None
    around = (motion.joint_covariance - motion.systematic_covariance) / a[:, None, None] ** 2
    known = motion.systematic_covariance - floor[:, None, None] * np.eye(3)
    c, d = np.array([angles.get(kind_of(n), (1.0, 0.0)) for n in ANGLE_NAMES]).T
    least = d**2 + (by_angle * beyond) ** 2
    sd = None if motion.angle_sd is None else np.sqrt(np.maximum(motion.angle_sd**2 - least, 0.0)) / c
    return replace(
        motion,
        joint_covariance=around.astype(np.float32),
        systematic_covariance=known.astype(np.float32),
        angle_sd=None if sd is None else sd.astype(np.float32),
    )
