"""What a monocular tracker may know of a synthetic subject: a body measured beforehand, with the errors of measuring.

The template gets the subject's lengths and girths, each wrong by an error of a few per cent; the mesh, the joint
centres and the skinning of the truth stay unknown to the tracker.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import BONE_END, Body, deform
from hypose.body.default_body import JOINT_NAMES
from hypose.body.skeleton import Skeleton
from hypose.evidence.terms import PointTerm
from hypose.fitting.articulated import SolveSettings, fit_pose
from hypose.geometry import Array, so3_log
from hypose.synthetic.subjects import SyntheticSubject
from hypose.tracking.refinement import anatomical_prior
from hypose.tracking.subject import PAIRED, shape_from_keypoints

LIMBS = tuple(f"{side}_{a}" for side in ("left", "right") for pair in PAIRED.values() for a in pair)
"""The joints whose distances are the measured lengths."""
GIRTHS: dict[str, tuple[tuple[str, int | None], ...]] = {
    "torso width": tuple((j, 0) for j in ("pelvis", "spine", "chest")),
    "torso depth": tuple((j, 1) for j in ("pelvis", "spine", "chest")),
    "upper arms": (("left_shoulder", None), ("right_shoulder", None)),
    "forearms": (("left_elbow", None), ("right_elbow", None)),
    "thighs": (("left_hip", None), ("right_hip", None)),
    "shanks": (("left_knee", None), ("right_knee", None)),
    "hands": (("left_wrist", None), ("right_wrist", None)),
    "feet": (("left_ankle", None), ("right_ankle", None)),
    "head": (("head", None),),
    "neck": (("neck", None),),
}
"""Girths that are wrong together: (joint, model axis or None for all three)."""


@dataclass(frozen=True)
class MeasuringError:
    """length: relative sd of every segment's length, girth: largest relative error of every girth (uniform)."""

    length: float = 0.02
    girth: float = 0.07


def measured_body(template: Body, subject: SyntheticSubject, error: MeasuringError, rng: np.random.Generator) -> Body:
    """The template with the lengths and girths of a (dressed) subject, left and right alike, wrong by `error`."""
    names = tuple(dict.fromkeys(LIMBS))
    points = subject.joints[[JOINT_NAMES.index(n) for n in names]]
    shape = shape_from_keypoints(template, points[None], names)
    wrong = {part: float(np.exp(rng.normal(0, error.length))) for part in PAIRED}
    length = dict(shape.length)
    for part, (joint, _) in PAIRED.items():
        for side in ("left", "right"):
            length[f"{side}_{joint}"] *= wrong[part]
    shape = replace(shape, scale=shape.scale * float(np.exp(rng.normal(0, error.length))), length=length)
    return deform(template, replace(shape, girth=_girths(deform(template, shape), subject, error.girth, rng)))


def _girths(
    body: Body, subject: SyntheticSubject, error: float, rng: np.random.Generator
) -> dict[str, float | tuple[float, float, float]]:
    """Girth factors (x, y, z) per joint that give the body's parts the mean thickness of the subject's."""
    ours = _thickness(body.fine.vertices, body.fine.main_joint, body.skeleton.rest_joints)
    theirs = _thickness(subject.vertices, subject.main_joint, subject.joints)
    girth: dict[str, list[float]] = {}
    for members in GIRTHS.values():
        ratios = []
        for name, axis in members:
            j, across = JOINT_NAMES.index(name), (0, 1) if axis is None else (axis,)
            ratios += [theirs[j, a] / ours[j, a] for a in across]
        factor = float(np.median(ratios)) * (1 + rng.uniform(-error, error))
        for name, axis in members:
            row = girth.setdefault(name, [1.0, 1.0, 1.0])
            for k in range(3) if axis is None else (axis,):
                row[k] = factor
    return {name: (row[0], row[1], row[2]) for name, row in girth.items()}


def _thickness(vertices: Array, part: NDArray[np.int64], joints: Array) -> Array:
    """(19, 2) m: mean distance of a part's vertices from its bone (limbs), or from the joint along x and y (others)."""
    out = np.full((len(joints), 2), np.nan)
    for j, name in enumerate(JOINT_NAMES):
        mine = vertices[part == j] - joints[j]
        if len(mine) == 0:
            continue
        if name in BONE_END:
            axis = joints[JOINT_NAMES.index(BONE_END[name])] - joints[j]
            axis = axis / np.linalg.norm(axis)
            out[j] = np.linalg.norm(mine - (mine @ axis)[:, None] * axis, axis=1).mean()
        else:
            out[j] = np.abs(mine[:, :2]).mean(0)
    return out


HAND_MARKS = ("hand_tip", "knuckle", "thumb_tip")


def pose_of_truth(body: Body, rotations: Array, joints: Array) -> Array:
    """(D,) the body's pose nearest to a subject's true rotations (19, 3, 3) and joint centres (19, 3) m of one frame.

    Twists of forearms and hands show in no joint centre, so points on the hands turn with the true wrists.
    """
    marks = body.landmarks
    on_hands = [marks.index(f"{side}_{name}") for side in ("left", "right") for name in HAND_MARKS]
    carrier, offset = marks.joint[on_hands], marks.offset[on_hands]
    hands = joints[carrier] + np.einsum("kab,kb->ka", rotations[carrier], offset)
    joint = np.concatenate([np.arange(len(joints)), carrier])
    term = PointTerm(
        np.concatenate([joints, hands]),
        np.concatenate([np.ones(len(joints)), np.full(len(hands), 0.5)]),
        joint,
        np.concatenate([np.zeros((len(joints), 3)), offset]),
        0.05,
    )
    start = np.zeros(body.skeleton.dof)
    start[:3], start[3:6] = joints[0], so3_log(rotations[0])
    options = SolveSettings(iterations=60, coarse_iterations=30)
    return fit_pose(body, start, [term], priors=(anatomical_prior(body.skeleton),), options=options).pose


# degrees: lower, upper, usual motion per frame at 25 fps
_TWIST, _BEND, _DEVIATION = (-80.0, 80.0, 5.0), (-70.0, 70.0, 5.0), (-35.0, 35.0, 4.0)


def arm_dofs(skeleton: Skeleton, side: str = "right") -> NDArray[np.int64]:
    """The dof of one arm: 7 on a body made by `with_hand` (shoulder 3, elbow 1, forearm twist 1, wrist 2), else 4."""
    return skeleton.dofs_of(*(f"{side}_{part}" for part in ("shoulder", "elbow", "wrist")))


def with_hand(body: Body, side: str = "right") -> Body:
    """The body with three dof more in one arm: the forearm turns about its length after the elbow bends, and the wrist
    bends about the elbow's axis and deviates across it. Limits are those of everyday motion."""
    s = body.skeleton
    elbow, wrist = s.joint(f"{side}_elbow"), s.joint(f"{side}_wrist")
    bend = s.axes[s.dofs_of(f"{side}_elbow")[0]]
    along = s.rest_joints[wrist] - s.rest_joints[elbow]
    along = along / np.linalg.norm(along)
    across = np.cross(bend, along)
    new = (
        (f"{side}_elbow_twist", elbow, along, _TWIST),
        (f"{side}_wrist_flexion", wrist, bend, _BEND),
        (f"{side}_wrist_deviation", wrist, across, _DEVIATION),
    )
    joint = np.concatenate([s.joint_of_dof, [n[1] for n in new]])
    order = np.argsort(joint, kind="stable")
    limits = np.radians([n[3] for n in new])
    names = s.dof_names + tuple(n[0] for n in new)
    skeleton = replace(
        s,
        axes=np.concatenate([s.axes, [n[2] for n in new]])[order],
        joint_of_dof=joint[order],
        dof_names=tuple(names[i] for i in order),
        lower=np.concatenate([s.lower, limits[:, 0]])[order],
        upper=np.concatenate([s.upper, limits[:, 1]])[order],
        sigma=np.concatenate([s.sigma, limits[:, 2]])[order],
    )
    return replace(body, skeleton=skeleton)
