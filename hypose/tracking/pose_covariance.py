"""Compute the uncertainty of a frame's pose: from the curvature of the solved cost, or from the spread of a weighted
set.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body
from hypose.body.motion import Modes
from hypose.fitting.articulated import SolveSettings
from hypose.geometry import Array, so3_exp, so3_log
from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.frame_evidence import PreparedFrame
from hypose.tracking.refinement import RIVAL, refine

# Rows of one contour err together, so do detections in neighbouring frames, a body is only nearly right, and lost limbs
# make tails: how far the curvature is from the truth is measured, not derived. With these factors the 90 % regions
# (ellipsoids) held the truth in 90 % of the joints of each group on synthetic scenes (walk, box, run, combo): from
# silhouettes on 64 scenes of the seeds 20 to 35, without the six worst for arms and legs, where a limb is lost; the
# others on 24 of the seeds 20 to 25. Those with silhouettes belong to the default weight of a contour row (0.05).
CURVATURE_FACTOR: Mapping[str, Mapping[str, float]] = {
    "silhouettes": {"torso": 0.70, "arms": 0.58, "legs": 0.49, "head": 0.14},
    "keypoints": {"torso": 0.48, "arms": 0.44, "legs": 0.42, "head": 0.60},
    "both": {"torso": 0.55, "arms": 0.51, "legs": 0.41, "head": 0.63},
    # with depth cameras the whole calibration is that of hypose.tracking.covariance_calibration
    "depth": {"torso": 0.5, "arms": 0.5, "legs": 0.5, "head": 0.5},
}
FLOOR = 0.004
"""m; smallest sd of a joint centre. With more, the regions of a head seen in silhouettes would hold more than 90 %."""
_SET_FLOOR = 0.02
"""rad, m; smallest sd of a coordinate of a weighted set, however few of its members survived."""


@dataclass(frozen=True)
class PoseUncertainty:
    """Uncertainty of one frame's pose; arrays are float32, since long recordings have many frames.

    joint_covariance: (J, 3, 3) covariance of each joint centre, m^2, world.
    information: (D (D + 1) / 2,) lower triangle of the inverse covariance of the pose from this frame alone, without
        the pull to the prediction, with the root's rotation as a small rotation in the world; for solving whole
        clips.
        Zero: no information.
    modes: the distinct poses that the frame allows (one row); None for methods without them.
    """

    joint_covariance: NDArray[np.float32]
    information: NDArray[np.float32]
    modes: Modes | None = None


def uncertainty_of_pose(pose: Array, h: Hypotheses, frame: PreparedFrame, /) -> PoseUncertainty:
    """Compute the uncertainty of a solved pose (D,) from the inverse of the cost's Hessian.

    h: hypotheses with the roles SOLVED and RIVAL; frame: prepared, with the fit of the pose.
    Covariance of the joints = factor^2 H^-1 (CURVATURE_FACTOR), with the priors in H, so a joint that no view sees
    keeps the prior's spread. Each hypothesis with the role RIVAL adds its weight times the square of its joints'
    distances.
    """
    body = frame.body
    fit = frame.fits.get(body, pose)
    if fit is None:
        fit = refine(body, pose[None], frame, SolveSettings(iterations=0, coarse_iterations=0))[0]
    information = fit.information - frame.prediction_weight * np.eye(len(pose))
    around = joint_covariance_of(body, pose, fit.information, frame.kind)
    if (rivals := h.has(RIVAL)).any():
        joints = body.joints(np.concatenate([pose[None], h.values[rivals]]))
        apart = joints[1:] - joints[0]
        around = around + np.einsum("n,nja,njb->jab", h.weights[rivals], apart, apart).astype(np.float32)
        for weight, other in zip(h.weights[rivals], h.values[rivals], strict=True):
            step = other - pose
            step[3:6] = so3_log(so3_exp(other[3:6]) @ so3_exp(pose[3:6]).T)
            information = _less_sure(information, step, float(weight))
    return PoseUncertainty(around, packed(information))


def _less_sure(information: Array, step: Array, weight: float) -> Array:
    """Update the information (D, D) for a covariance that grows by weight x step step^T, step (D,).

    Source: Sherman & Morrison 1950.
    """
    seen = information @ step
    return information - np.outer(seen, seen) * (weight / (1 + weight * (seen @ step)))


def joint_covariance_of(body: Body, pose: Array, information: Array, evidence: str) -> NDArray[np.float32]:
    """Compute the covariances (J, 3, 3) of the joint centres, m^2, at a solved pose (D,).

    information: (D, D) inverse covariance of the pose, see `PoseFit.information`.
    evidence: kind of evidence in the cost, a key of CURVATURE_FACTOR.
    """
    factor = _factors(evidence, tuple(body.skeleton.joint_names))
    curvature = body.skeleton.informed_joint_covariances(pose, information)
    return (factor[:, None, None] ** 2 * curvature + FLOOR**2 * np.eye(3)).astype(np.float32)


def from_neighbours(around: NDArray[np.float32], frame_rate: float) -> NDArray[np.float32]:
    """Bound the covariances of joints in a solved clip by those of neighbouring frames.

    frame_rate: Hz.
    Why: a joint that a frame hardly shows lies between its places in the neighbouring frames; the bound is their
        covariance plus how far the path may bend in between (NEIGHBOUR_M_S2).
    around: (T, J, 3, 3) covariances computed from each frame by itself, m^2; NaN where a frame has none.
    Returns: (T, J, 3, 3) m^2.
    """
    given, out = around.astype(np.float64), around.astype(np.float64)
    least = np.trace(out, axis1=2, axis2=3)
    least[np.isnan(least)] = np.inf
    for k in range(1, min(round(NEIGHBOUR_S * frame_rate), len(out) - 1) + 1):
        bend = (0.5 * NEIGHBOUR_M_S2 * (k / frame_rate) ** 2) ** 2 * np.eye(3)
        for at, there in ((slice(k, None), slice(None, -k)), (slice(None, -k), slice(k, None))):
            other = given[there] + bend
            size = np.trace(other, axis1=2, axis2=3)
            better = size < least[at]
            out[at][better], least[at][better] = other[better], size[better]
    return out.astype(np.float32)


NEIGHBOUR_S, NEIGHBOUR_M_S2 = 0.25, 20.0
"""s to the furthest neighbours that are used; m/s^2, usual acceleration of a limb's joint"""


@lru_cache(8)
def _factors(evidence: str, joint_names: tuple[str, ...]) -> Array:
    """Look up CURVATURE_FACTOR (J,) of each joint for a kind of evidence."""
    return np.array([CURVATURE_FACTOR[evidence][joint_group(name)] for name in joint_names])


def joint_group(name: str) -> str:
    """Return the group of a joint by its name: arms (elbow, wrist), legs (knee, ankle), head, or torso (all others)."""
    if name.endswith(("elbow", "wrist")):
        return "arms"
    if name.endswith(("knee", "ankle")):
        return "legs"
    return "head" if name == "head" else "torso"


def uncertainty_of_set(pose: Array, h: Hypotheses, frame: PreparedFrame, /) -> PoseUncertainty:
    """Compute the uncertainty of a pose from the spread of a weighted set (N, D).

    h: the set with its weights; frame: prepared for the body.
    """
    joints = frame.body.joints(h.values)
    apart = joints - np.einsum("n,nja->ja", h.weights, joints)
    around = np.einsum("n,nja,njb->jab", h.weights, apart, apart) + FLOOR**2 * np.eye(3)
    off = h.values - h.weights @ h.values
    turned = so3_log(so3_exp(h.values[:, 3:6]) @ so3_exp(pose[3:6]).T)
    off[:, 3:6] = turned - h.weights @ turned
    covariance = np.einsum("n,nd,ne->de", h.weights, off, off) + _SET_FLOOR**2 * np.eye(off.shape[1])
    return PoseUncertainty(around.astype(np.float32), packed(np.linalg.inv(covariance)))


def nothing_known(joint_covariance: NDArray[np.float32], dof: int) -> PoseUncertainty:
    """Build the uncertainty of a frame without evidence.

    joint_covariance: (J, 3, 3) m^2, from the frames before; the information on the pose (D = dof) is zero.
    """
    return PoseUncertainty(joint_covariance, packed(np.zeros((dof, dof))))


def packed(information: Array) -> NDArray[np.float32]:
    """Pack a symmetric matrix (D, D) as its lower triangle (D (D + 1) / 2,), float32."""
    return information[_triangle(len(information))].astype(np.float32)


@lru_cache(8)
def _triangle(dof: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the indices of the lower triangle of a matrix (D, D); D = dof."""
    return np.tril_indices(dof)


def unpacked(triangles: ArrayLike, dof: int) -> Array:
    """Unpack lower triangles (T, D (D + 1) / 2) to symmetric matrices (T, D, D)."""
    triangles = np.asarray(triangles, dtype=np.float64)
    rows, columns = _triangle(dof)
    out = np.zeros((len(triangles), dof, dof))
    out[:, rows, columns] = out[:, columns, rows] = triangles
    return out
