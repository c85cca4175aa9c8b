"""Which degrees of freedom a single view can estimate: the body's 30, and an arm's 7."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.skeleton import Skeleton

# degrees: lower, upper, usual motion per frame at 25 fps
_TWIST, _BEND, _DEVIATION = (-80.0, 80.0, 5.0), (-70.0, 70.0, 5.0), (-35.0, 35.0, 4.0)


def body_dofs(skeleton: Skeleton) -> NDArray[np.int64]:
    """The 30 dof of a whole body: all but clavicles and the inversion of the ankles (and forearm twists and wrists),
    which one view does not show."""
    hidden = ("clavicle", "inversion", "twist", "wrist")
    return np.flatnonzero([not any(h in name for h in hidden) for name in skeleton.dof_names])


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
