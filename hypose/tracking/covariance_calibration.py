"""Calibrate the standard deviations of joint centres and joint angles, so that 90 % regions hold 90 % of the errors.

The curvature of a cost gives the covariance V of a pose, but not how far the body's joint lies from the anatomical one.
So the variance is a^2 V + b^2: a because errors of neighbouring residuals are correlated, b for the definition of the
joint and for the body, the same in all frames. a and b were fitted to errors on scenes (scripts/train_error_model.py),
per joint, angle and kind of evidence (`hypose.body.motion`). Two terms are added: the lasting residuals of key points
(`systematic_covariance`), and (c x)^2, where x is by how much more than usual the views contradict each other
(`hypose.tracking.joint_features`): wrong calibrations, delays and bodies are wrong in all frames.

The systematic error of joints from key points does not average out over frames. The share that differs between views
stays in the residuals of single views over the whole clip, where it is measured. The share that is the same in all
views (where the detector places this person's joint) leaves no residual; it is assumed to be proportional to the other.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import ArrayLike

from hypose.body.body import Body
from hypose.body.joint_angles import ANGLE_NAMES, angles_of_frames
from hypose.body.motion import Motion
from hypose.body.skeleton import Skeleton
from hypose.evidence.frame import Keypoints
from hypose.evidence.keypoints import BLAZEPOSE_33
from hypose.geometry import Array, so3_exp, so3_log
from hypose.tracking.frame_evidence import KeypointModel
from hypose.tracking.joint_features import columns_of_joints, views_apart
from hypose.tracking.keypoint_offsets import residual_rows

LASTING_S = 0.5
"""s from which two residuals of one point in one view share only their lasting component: errors of detections are
correlated over a few tenths of a second."""
SHARED = 2.0
"""Ratio of the sd of the error that all views share, per axis, to the sd of a usual view's lasting residuals. Chosen on
the Shelf recording (Belagiannis et al. 2014), people annotated in most frames: 90 % regions hold .48 to .49 of the
annotations with 2, .15 to .17 with 0; annotations by hand have errors of 20 mm themselves.
"""
MOST_SHARED_M = 0.03
"""m per axis: largest shared error. Detectors' hips and knees lie 30 to 50 mm from the joints' centres (Needham et al.
2021, doi 10.1038/s41598-021-00212-x); larger residuals come from the calibration."""
_USUAL_SD = 0.03  # m, of points whose noise was not measured
_LOOSE = 0.1
_FRAMES = 500  # at once


def lasting_residuals(
    body: Body, model: KeypointModel, keypoints: Sequence[Keypoints | None], poses: Array, frame_rate: float
) -> tuple[Array, Array]:
    """Estimate the lasting component of the key points' residuals, of each view and point over a clip.

    frame_rate: Hz.
    It is the weighted mean product of residuals that are LASTING_S or more apart; noise cancels in it. Views and points
    are assumed to have independent factors.
    model: where key points sit on the body.
    keypoints: T frames, None where there are none.
    poses: (T, D) the solved clip.
    Returns: (C, K) variances per axis, m^2, 0 where there are too few residuals; (T, C, K) weights of the points in the
        solve, 1 / (1 + (r / 2 sd)^2), 0 where not used.
    """
    there = [t for t, k in enumerate(keypoints) if k is not None]
    rows = residual_rows(body, replace(model, view=None), [k for k in keypoints if k is not None], poses[there])
    away, scale = rows.residual / rows.size[..., None, None], 2 * (_USUAL_SD if model.sd is None else model.sd)
    weights, residual = np.zeros((len(poses), *away.shape[1:3])), np.zeros((len(poses), *away.shape[1:]))
    weights[there] = (rows.confidence > 0) / (1 + (away**2).sum(-1) / scale**2)
    residual[there] = weights[there][..., None] * away
    apart = max(1, min(round(LASTING_S * frame_rate), len(poses) // 2))

    def later(values: Array) -> Array:
        """Sum values (T, ...) over the frames that are at least `apart` frames later."""
        total = np.zeros_like(values)
        total[:-apart] = values[apart:][::-1].cumsum(0)[::-1]
        return total

    pairs = (weights * later(weights)).sum(0)
    power = 0.5 * (residual * later(residual)).sum((0, 3))
    views = (weights > 0).any(0).sum(0)
    left = np.maximum(2 * views - 3, 1) / np.maximum(2 * views, 1)  # share of the errors that a fit leaves as residual
    power = np.where(pairs > 0, power / np.maximum(pairs, 1e-9), 0.0) / left
    of_view, of_point = np.maximum(power.sum(1), 0.0), np.maximum(power.sum(0), 0.0)
    # where only noise is left, terms of both signs cancel, so their sum cannot be the divisor
    whole = max(float(power.sum()), float(of_view.sum()), float(of_point.sum()), 1e-12)
    return np.outer(of_view, of_point) / whole, weights


def systematic_covariance(
    body: Body, model: KeypointModel, keypoints: Sequence[Keypoints | None], poses: Array, frame_rate: float
) -> Array:
    """Compute the systematic error of the joints of a clip that was solved on key points.

    frame_rate: Hz.
    model: where key points sit on the body; keypoints: T frames, None where there are none; poses: (T, D) the solved
        clip.
    Returns: (T, J, 3, 3) covariances, m^2.
    The error of single views is propagated through the triangulation of the views that see the point, weighted as in
    the solve. The shared error (SHARED) is the same in all directions. Joints without a key point of their own get the
    mean of all. For BlazePose, whose weight is lower when there are masks too, the result is reduced by that weight.
    """
    lasting, weights = lasting_residuals(body, model, keypoints, poses, frame_rate)
    first = next(k for k in keypoints if k is not None)
    usual = weights.sum(0) / np.maximum((weights > 0).sum(0), 1) * model.worse(len(first.rig))[:, None] ** -2.0
    centres = np.stack([camera.position for camera in first.rig])
    shared = np.minimum(SHARED**2 * np.median(lasting, 0), MOST_SHARED_M**2)
    cue_weight = model.cue_weight if model.names == BLAZEPOSE_33 else None
    said = np.ones(len(model.names)) if cue_weight is None else cue_weight.max(0)
    own = columns_of_joints(tuple(body.skeleton.joint_names), model.names)
    some = (own >= 0) & model.known[own]
    out = np.zeros((len(poses), len(own), 3, 3))
    for begin in range(0, len(poses), _FRAMES):
        part = slice(begin, begin + _FRAMES)
        away = model.positions(body, poses[part])[:, None] - centres[:, None]
        away /= np.linalg.norm(away, axis=-1, keepdims=True)
        across = (weights[part, ..., None, None] > 0) * (np.eye(3) - away[..., None] * away[..., None, :])
        normal = np.einsum("ck,tckab->tkab", usual, across) + _LOOSE * np.eye(3)
        inside = np.einsum("ck,tckab->tkab", usual**2 * lasting, across)
        back = np.linalg.inv(normal)
        points = said[:, None, None] * (back @ inside @ back + (shared[:, None, None] * np.eye(3)))
        mean = points[:, model.known].mean(1)
        for j in range(len(own)):
            out[part, j] = points[:, own[j, some[j]]].mean(1) if some[j].any() else mean
    return out


_STEP = 1e-4
_PRIOR_INFORMATION = 0.05  # 1 / rad^2: information of the joint limits
_SETS = {
    "pelvis": (("pelvis",), ("pelvis",)),
    "lumbar": (("lumbar",), ("spine", "chest")),
    "neck": (("neck",), ("neck", "head")),
    **{
        f"{part}_{s}": ((f"{angle}_{s}",), tuple(f"{side}_{j}" for j in joints))
        for s, side in (("r", "right"), ("l", "left"))
        for part, angle, joints in (
            ("hip", "hip", ("hip",)),
            ("knee", "knee", ("knee",)),
            ("ankle", "ankle", ("ankle",)),
            ("subtalar", "subtalar", ("ankle",)),
            ("arm", "arm", ("clavicle", "shoulder")),
            ("elbow", "elbow", ("elbow",)),
        )
    },
}
"""Sets of angles by the beginnings of their names, and the joints on whose coordinates they depend."""


def kind_of(name: str) -> str:
    """Remove the side from the name of a joint or an angle."""
    return name.removeprefix("left_").removeprefix("right_").removesuffix("_l").removesuffix("_r")


@cache
def fitted_spread_table() -> Mapping[str, Mapping[str, Mapping[str, Sequence[float]]]]:
    """Load the fitted factors.

    Returns: {"joints" or "angles": {evidence: {kind: (a, b)}}}, b in m or rad; "apart": see `apart_factors`.
    """
    return json.loads(files("hypose.assets").joinpath("spread.json").read_text(encoding="utf-8"))


def apart_factors(evidence: str) -> tuple[float, float, float]:
    """Look up how contradictions between views widen the standard deviations, for a kind of evidence.

    Returns: usual contradiction, m; factor c of joints; factor c of angles, rad / m. Returns (inf, 0, 0) with key
        points: their solve finds the wrong view and lowers its weight.
    """
    usual, joints, angles = fitted_spread_table()["apart"].get(evidence, {}).get("all", (float("inf"), 0.0, 0.0))
    return usual, joints, angles


def beyond_usual(audit: ArrayLike, evidence: str) -> float:
    """Compute by how much the views of a clip with this audit (T, J, A) contradict each other beyond the usual, m.

    audit: features of the error model, see `joint_features.AUDITED`.
    evidence: kind of evidence; the result is 0 for kinds whose usual contradiction was not measured.
    """
    return float(np.sqrt(max(views_apart(audit) ** 2 - apart_factors(evidence)[0] ** 2, 0.0)))


def with_fitted_joints(motion: Motion, evidence: str, beyond: float = 0.0) -> Motion:
    """Calibrate a motion's joint covariances: a^2 V + S + (b^2 + c^2 beyond^2) I.

    evidence: kind of evidence, a key of `fitted_spread_table`.
    V is the motion's joint covariance, S its systematic covariance (None: zero). All but a^2 V becomes the new
    systematic covariance.
    beyond: contradiction between the views, m, see `beyond_usual`.
    """
    own = fitted_spread_table()["joints"][evidence]
    pairs = np.array([own.get(kind_of(n), (1.0, 0.0)) for n in motion.skeleton.joint_names])
    a, b = pairs[:, 0], pairs[:, 1]
    floor = b**2 + (apart_factors(evidence)[1] * beyond) ** 2
    lasting = np.zeros_like(motion.joint_covariance) + floor[:, None, None] * np.eye(3)
    if motion.systematic_covariance is not None:
        lasting += motion.systematic_covariance
    around = a[:, None, None] ** 2 * motion.joint_covariance + lasting
    return replace(motion, joint_covariance=around.astype(np.float32), systematic_covariance=lasting.astype(np.float32))


def with_fitted_angles(motion: Motion, covariance: Array, evidence: str, beyond: float = 0.0) -> Motion:
    """Set a motion's calibrated standard deviations of angles, computed from the covariances (T, D, D) of its poses.

    evidence: kind of evidence, a key of `fitted_spread_table`.
    beyond: contradiction between the views, m, see `beyond_usual`.
    """
    assert motion.poses is not None
    return with_angle_variance(motion, angle_variance(motion.skeleton, motion.poses, covariance), evidence, beyond)


def with_angle_variance(motion: Motion, variance: Array, evidence: str, beyond: float = 0.0) -> Motion:
    """Calibrate a motion's standard deviations of angles from their variances (T, A), rad^2, before calibration.

    evidence: kind of evidence, a key of `fitted_spread_table`.
    beyond: contradiction between the views, m, see `beyond_usual`.
    """
    own = fitted_spread_table()["angles"][evidence]
    pairs = np.array([own.get(kind_of(n), (1.0, 0.0)) for n in ANGLE_NAMES])
    floor = pairs[:, 1] ** 2 + (apart_factors(evidence)[2] * beyond) ** 2
    return replace(motion, angle_sd=np.sqrt(pairs[:, 0] ** 2 * variance + floor).astype(np.float32))


def pose_covariance(information: Array) -> Array:
    """Invert the information (T, D, D) of poses, with a weak prior, to covariances (T, D, D)."""
    least = np.diag(np.r_[np.zeros(3) + 1e-2, np.full(information.shape[-1] - 3, _PRIOR_INFORMATION)])
    return np.asarray(np.linalg.inv(information + least), dtype=np.float64)


def angle_variance(skeleton: Skeleton, poses: Array, covariance: Array) -> Array:
    """Compute the variances (T, A) of the angles, rad^2 (m^2 of positions), from the covariances of poses: J C J^T.

    poses: (T, D) pose vectors, rad and m.
    covariance: C, (T, D, D), the root's rotation as a small rotation in the world.
    J is computed by differences; coordinates that share no angle are moved together.
    """
    sets = [
        (
            np.array([k for k, n in enumerate(ANGLE_NAMES) if any(_belongs(n, b) for b in begins)]),
            np.flatnonzero(np.isin(skeleton.joint_of_dof, [skeleton.joint(j) for j in joints])),
        )
        for begins, joints in _SETS.values()
    ]
    out = np.zeros((len(poses), len(ANGLE_NAMES)))
    base = angles_of_frames(skeleton, *skeleton.forward(poses))
    slopes = np.zeros((len(poses), len(ANGLE_NAMES), poses.shape[1]))
    for k in range(max(len(dofs) for _, dofs in sets)):
        moved = poses.copy()
        chosen = np.unique([dofs[k] for _, dofs in sets if k < len(dofs)])
        moved[:, chosen] += _STEP
        if (axis := chosen[(chosen >= 3) & (chosen < 6)] - 3).size:
            moved[:, 3:6] = so3_log(so3_exp(_STEP * np.eye(3)[axis].sum(0)) @ so3_exp(poses[:, 3:6]))
        step = angles_of_frames(skeleton, *skeleton.forward(moved)) - base
        step = (step + np.pi) % (2 * np.pi) - np.pi
        for angles, dofs in sets:
            if k < len(dofs):
                slopes[:, angles, dofs[k]] = step[:, angles] / _STEP
    for angles, dofs in sets:
        j, c = slopes[:, angles][..., dofs], covariance[:, dofs[:, None], dofs]
        out[:, angles] = np.einsum("tad,tde,tae->ta", j, c, j)
    return out


def _belongs(name: str, begin: str) -> bool:
    """Decide whether an angle is in a set: 'hip_r' holds hip_flexion_r, 'pelvis' holds pelvis_tilt.

    name: name of the angle; begin: begin of the set, see _SETS.
    """
    part, _, side = begin.rpartition("_")
    return name.startswith(f"{part}_") and name.endswith(f"_{side}") if part else name.startswith(f"{begin}_")
