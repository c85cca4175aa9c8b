"""The fused skeleton of `hypose fuse --live` as an avatar's pose: turns of VRM's bones from fifteen joints.

Points tell where limbs point, not how they turn about themselves: trunk and hips turn with the lines of shoulders and
hips, an upper limb turns so that elbow or knee bend as they do, the more the limb is bent; hands and feet follow.
"""

from __future__ import annotations

import numpy as np

from hypose.app.live.humanoid_bones import BONES, rest_offsets
from hypose.app.live.osc import OscTarget
from hypose.app.live.vmc import vmc_messages
from hypose.body.ready_bodies import human
from hypose.fusion import joints as jt
from hypose.fusion.live import LiveFrame
from hypose.fusion.register import upright_axes
from hypose.geometry import Array, rotation_between, so3_exp, so3_log
from hypose.io.motions.animation import Y_UP

_UP_S, _FLOOR_DOWN_S, _FLOOR_UP_S = 10.0, 0.3, 30.0
"""Time constants: the person's mean upright is what is up; the floor follows the lowest foot down at once, up
slowly, so a jump is a jump."""
_FOOT_M = 0.08  # an ankle above the ground
_BENT = (0.2, 0.6)
"""Sine of elbow and knee from which on, and at which wholly, the bend says how the upper limb is turned."""
_ARM, _LEG = np.array([1.0, 0.0, 0.0]), np.array([0.0, -1.0, 0.0])
# upper bone, lower bone, joints, where the upper one points in the T pose (left), where the lower one bends to
_LIMBS = (
    ("UpperArm", "LowerArm", (jt.LEFT_SHOULDER, jt.LEFT_ELBOW, jt.LEFT_HAND), _ARM, np.array([0.0, 0.0, 1.0])),
    ("UpperLeg", "LowerLeg", (jt.LEFT_HIP, jt.LEFT_KNEE, jt.LEFT_FOOT), _LEG, np.array([0.0, 0.0, -1.0])),
)


class VmcLive:
    """Sends the person with the smallest number, and stays with it while it is there."""

    def __init__(self, target: OscTarget) -> None:
        self._target, self._offsets = target, rest_offsets(human())
        self._turns = np.tile(np.eye(3), (len(BONES), 1, 1))
        self._person = -1
        self._up: Array | None = None
        self._floor = 0.0
        self._begin = self._last = 0.0

    def send(self, frame: LiveFrame) -> None:
        """One frame; without a person the last pose is held, and said to be so."""
        if self._up is None:
            self._begin = self._last = frame.time
        found = {p.id: p for p in frame.people}
        person = found.get(self._person) or (found[min(found)] if found else None)
        if person is not None:
            self._person = person.id
            self._pose(person.joints, frame.time - self._last)
        self._last = frame.time
        tracked = person is not None and person.seen
        self._target.send(vmc_messages(self._offsets, self._turns, frame.time - self._begin, tracked))

    def close(self) -> None:
        """Let go of the socket."""
        self._target.close()

    def _pose(self, joints: Array, passed: float) -> None:
        middle = joints[[jt.LEFT_HIP, jt.RIGHT_HIP]].mean(0)
        trunk = joints[jt.NECK] - middle
        if not np.isfinite(trunk).all():
            return
        first = self._up is None
        mean: Array = trunk if self._up is None else self._up + (trunk - self._up) * _share(passed, _UP_S)
        self._up = mean / np.linalg.norm(mean)
        upright = joints @ (Y_UP @ upright_axes(mean / np.linalg.norm(mean))).T
        feet = upright[[jt.LEFT_FOOT, jt.RIGHT_FOOT], 1]
        lowest = float(feet[np.isfinite(feet)].min(initial=np.inf)) - _FOOT_M
        if np.isfinite(lowest):
            time = _FLOOR_DOWN_S if lowest < self._floor else _FLOOR_UP_S
            self._floor += (lowest - self._floor) * (1.0 if first else _share(passed, time))
        self._turns = bone_turns_of_points(upright)
        hips = upright[[jt.LEFT_HIP, jt.RIGHT_HIP]].mean(0)
        self._offsets[0] = [hips[0], hips[1] - self._floor, hips[2]]


def _share(passed: float, constant: float) -> float:
    """How much of a difference a first-order filter takes over in `passed` s."""
    return 1.0 - float(np.exp(-max(passed, 0.0) / constant))


def bone_turns_of_points(points: Array) -> Array:
    """(B, 3, 3) rotations of VRM's bones against their parents, in the order of BONES, of the 15 joints (15, 3) of
    `hypose.fusion.joints.COMMON` with y up; bones that no point tells of keep the T pose."""
    order = list(BONES)
    out = np.tile(np.eye(3), (len(order), 1, 1))
    middle = points[[jt.LEFT_HIP, jt.RIGHT_HIP]].mean(0)
    centre = points[jt.TORSO] if np.isfinite(points[jt.TORSO]).all() else (middle + points[jt.NECK]) / 2
    hips = _frame(centre - middle, points[jt.LEFT_HIP] - points[jt.RIGHT_HIP])
    chest = _frame(points[jt.NECK] - centre, points[jt.LEFT_SHOULDER] - points[jt.RIGHT_SHOULDER])
    out[0] = hips
    out[order.index("spine")] = out[order.index("chest")] = _half(hips.T @ chest)
    head = _swing(chest, np.array([0.0, 1.0, 0.0]), points[jt.HEAD] - points[jt.NECK])
    out[order.index("neck")] = out[order.index("head")] = _half(chest.T @ head)
    for upper, lower, joints, along, bend in _LIMBS:
        trunk = chest if upper == "UpperArm" else hips
        for side, sign in (("left", 1.0), ("right", -1.0)):
            a, b, c = points[[j if sign > 0 else jt.MIRROR[j] for j in joints]]
            way = along * [sign, 1, 1]
            above = _turned_to_bend(_swing(trunk, way, b - a), b - a, c - b, bend)
            out[order.index(side + upper)] = trunk.T @ above
            out[order.index(side + lower)] = above.T @ _swing(above, way, c - b)
    return out


def _frame(up: Array, left: Array) -> Array:
    """(3, 3) rotation of which y is `up` and x as near to `left` as it can be; upright where they are not known."""
    z = np.cross(left, up)
    if not np.isfinite(z).all() or np.linalg.norm(z) < 1e-9:
        return np.eye(3)
    y, z = up / np.linalg.norm(up), z / np.linalg.norm(z)
    return np.stack([np.cross(y, z), y, z], -1)


def _swing(turn: Array, rest: Array, direction: Array) -> Array:
    """`turn`, turned on the shortest way so that a bone with the direction `rest` in it points along `direction`."""
    if not np.isfinite(direction).all() or np.linalg.norm(direction) < 1e-9:
        return turn
    return rotation_between(turn @ rest, direction) @ turn


def _turned_to_bend(turn: Array, upper: Array, lower: Array, bend: Array) -> Array:
    """`turn` of an upper limb, turned about it so that the lower one bends towards `bend` of it."""
    if not (np.isfinite(upper).all() and np.isfinite(lower).all()):
        return turn
    axis = upper / max(float(np.linalg.norm(upper)), 1e-9)
    aside = lower / max(float(np.linalg.norm(lower)), 1e-9)
    aside = aside - (aside @ axis) * axis
    low, high = _BENT
    weight = float(np.clip((np.linalg.norm(aside) - low) / (high - low), 0.0, 1.0))
    here = turn @ bend
    angle = np.arctan2(axis @ np.cross(here, aside), here @ aside)
    return so3_exp(weight * angle * axis) @ turn


def _half(turn: Array) -> Array:
    return so3_exp(so3_log(turn) / 2)
