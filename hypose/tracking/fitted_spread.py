"""Standard deviations that hold: of joint centres and of joint angles, from what the evidence says and what it cannot.

The curvature of a cost tells how well the evidence fixes a pose, not how far the body's joint lies from the
anatomical one. So the variance is a^2 V + b^2: V from the curvature, a because rows err together, b for the definition
and the body, the same all along. a and b were fitted to errors on scenes (scripts/train_doubt.py), per joint, angle and
kind of evidence, so that regions of 90 % hold 90 % of them, and others theirs (`hypose.body.motion`). What lasts in
the residuals of key points is added to b^2 (`hypose.tracking.systematic_error`). Views that
contradict each other as a whole (`hypose.tracking.view_shifts`) by more than they do in such scenes add (c x)^2, x
being what is beyond: calibrations, lags and bodies that are wrong are wrong in all frames.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import ArrayLike

from hypose.body.joint_angles import ANGLE_NAMES, angles_of_frames
from hypose.body.motion import Motion
from hypose.body.skeleton import Skeleton
from hypose.geometry import Array, so3_exp, so3_log
from hypose.tracking.audit import views_apart

_STEP = 1e-4
_LEAST = 0.05  # information that anatomy gives every coordinate, 1 / rad^2: nothing turns more than it can
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
"""Angles by the beginnings of their names, and the joints whose coordinates they depend on."""


def kind_of(name: str) -> str:
    """A joint's or an angle's name without its side."""
    return name.removeprefix("left_").removeprefix("right_").removesuffix("_l").removesuffix("_r")


@cache
def fitted() -> Mapping[str, Mapping[str, Mapping[str, tuple[float, float]]]]:
    """{"joints" or "angles": {evidence: {kind: (a, b)}}}; b in m, or rad."""
    kept = _kept()
    return {
        what: {e: {k: (a, b) for k, (a, b) in own.items()} for e, own in kept[what].items()}
        for what in ("joints", "angles")
    }


@cache
def _kept() -> Mapping[str, Mapping[str, Mapping[str, tuple[float, ...]]]]:
    return json.loads(files("hypose.assets").joinpath("spread.json").read_text(encoding="utf-8"))


def apart_factors(evidence: str) -> tuple[float, float, float]:
    """m, by how much views contradict each other as a rule, and c of joints, and of angles in rad / m; (inf, 0, 0) with
    key points, whose solve finds the view that is wrong and gives it less weight."""
    usual, joints, angles = _kept()["apart"].get(evidence, {}).get("all", (float("inf"), 0.0, 0.0))
    return usual, joints, angles


def beyond_usual(audit: ArrayLike, evidence: str) -> float:
    """m, by how much the views of a clip with this audit (T, J, A) contradict each other beyond what is usual."""
    return float(np.sqrt(max(views_apart(audit) ** 2 - apart_factors(evidence)[0] ** 2, 0.0)))


def with_fitted_joints(motion: Motion, evidence: str, beyond: float = 0.0) -> Motion:
    """The motion with covariances a^2 V + S + (b^2 + c^2 beyond^2) I, all but the first of which is systematic; its own
    systematic_covariance is S, what is known of it besides (None: nothing); beyond: m, see `beyond_usual`."""
    own = fitted()["joints"][evidence]
    pairs = np.array([own.get(kind_of(n), (1.0, 0.0)) for n in motion.skeleton.joint_names])
    a, b = pairs[:, 0], pairs[:, 1]
    floor = b**2 + (apart_factors(evidence)[1] * beyond) ** 2
    lasting = np.zeros_like(motion.joint_covariance) + floor[:, None, None] * np.eye(3)
    if motion.systematic_covariance is not None:
        lasting += motion.systematic_covariance
    around = a[:, None, None] ** 2 * motion.joint_covariance + lasting
    return replace(motion, joint_covariance=around.astype(np.float32), systematic_covariance=lasting.astype(np.float32))


def with_fitted_angles(motion: Motion, covariance: Array, evidence: str, beyond: float = 0.0) -> Motion:
    """The motion with the sd of its angles, from the covariances (T, D, D) of its poses; beyond: as for joints."""
    assert motion.poses is not None
    return with_angle_variance(motion, angle_variance(motion.skeleton, motion.poses, covariance), evidence, beyond)


def with_angle_variance(motion: Motion, variance: Array, evidence: str, beyond: float = 0.0) -> Motion:
    """The same from the variances (T, A) rad^2 that the curvature says."""
    own = fitted()["angles"][evidence]
    pairs = np.array([own.get(kind_of(n), (1.0, 0.0)) for n in ANGLE_NAMES])
    floor = pairs[:, 1] ** 2 + (apart_factors(evidence)[2] * beyond) ** 2
    return replace(motion, angle_sd=np.sqrt(pairs[:, 0] ** 2 * variance + floor).astype(np.float32))


def pose_covariance(information: Array) -> Array:
    """(T, D, D) from what is known of poses (T, D, D): inverse, with the little that anatomy knows."""
    least = np.diag(np.r_[np.zeros(3) + 1e-2, np.full(information.shape[-1] - 3, _LEAST)])
    return np.asarray(np.linalg.inv(information + least), dtype=np.float64)


def angle_variance(skeleton: Skeleton, poses: Array, covariance: Array) -> Array:
    """(T, A) rad^2, and m^2 of positions: J C J^T of the angles at poses (T, D) with covariances C (T, D, D), the
    root's rotation as a small turn in the world.

    J by differences; coordinates of sets of joints that share no angle are moved together."""
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
    """Is the angle one of a set: 'hip_r' holds hip_flexion_r, 'pelvis' pelvis_tilt?"""
    part, _, side = begin.rpartition("_")
    return name.startswith(f"{part}_") and name.endswith(f"_{side}") if part else name.startswith(f"{begin}_")
