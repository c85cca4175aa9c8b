"""Poses in which a person may be found: standing, sitting, crouching, kneeling, with the arms anywhere; as directions
of limbs, posed on a body by its own bones and limits."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hypose.body.body import Body
from hypose.evidence.terms import PointTerm
from hypose.fitting.articulated import SolveSettings, fit_pose
from hypose.geometry import Array, so3_exp
from hypose.tracking.refinement import anatomical_prior

Vector = tuple[float, float, float]
_LEGS: dict[str, tuple[float, Vector, Vector, Vector, Vector]] = {
    "standing": (0, (0.1, 0, -1), (0.05, 0.05, -1), (-0.1, 0, -1), (-0.05, 0.05, -1)),
    "left step": (4, (0.05, -0.45, -0.9), (0, -0.1, -1), (-0.05, 0.25, -0.97), (0, 0.55, -0.8)),
    "right step": (4, (0.05, 0.25, -0.97), (0, 0.55, -0.8), (-0.05, -0.45, -0.9), (0, -0.1, -1)),
    "wide": (3, (0.4, -0.1, -0.9), (0.3, 0.15, -0.9), (-0.4, -0.1, -0.9), (-0.3, 0.15, -0.9)),
    "sitting": (3, (0.15, -1, -0.05), (0, 0, -1), (-0.15, -1, -0.05), (0, 0, -1)),
    "sitting wide": (3, (0.3, -1, -0.05), (0.05, -0.05, -1), (-0.3, -1, -0.05), (-0.05, -0.05, -1)),
    "sitting back": (-10, (0.15, -1, 0.05), (0, -0.5, -0.85), (-0.15, -1, 0.05), (0, -0.5, -0.85)),
    "sitting forward": (20, (0.15, -1, -0.1), (0, 0.3, -0.95), (-0.15, -1, -0.1), (0, 0.3, -0.95)),
    "crouching": (35, (0.2, -0.8, -0.6), (0, 0.45, -0.9), (-0.2, -0.8, -0.6), (0, 0.45, -0.9)),
    "squatting": (35, (0.3, -0.9, 0.2), (0, 0.4, -0.9), (-0.3, -0.9, 0.2), (0, 0.4, -0.9)),
    "kneeling": (5, (0.1, -0.05, -1), (0, 1, -0.1), (-0.1, -0.05, -1), (0, 1, -0.1)),
    "left knee": (8, (0.1, 0.05, -1), (0, 0.95, -0.2), (-0.1, -1, -0.05), (0, 0, -1)),
    "right knee": (8, (0.1, -1, -0.05), (0, 0, -1), (-0.1, 0.05, -1), (0, 0.95, -0.2)),
    "on the floor": (5, (0.15, -1, 0.1), (0, -1, -0.1), (-0.15, -1, 0.1), (0, -1, -0.1)),
    "cross-legged": (8, (0.7, -0.65, 0.1), (-0.8, -0.2, -0.2), (-0.7, -0.65, 0.1), (0.8, -0.2, -0.2)),
    "bowing": (60, (0.1, 0.1, -1), (0.05, 0, -1), (-0.1, 0.1, -1), (-0.05, 0, -1)),
}
"""Lean of the trunk (degrees), and the directions of left thigh and shank, right thigh and shank: x = the person's
left, y = backward, z = up."""
_ARMS: dict[str, tuple[Vector, Vector]] = {
    "hanging": ((0.15, 0, -1), (0.08, -0.15, -1)),
    "apart": ((0.6, 0, -0.8), (0.5, -0.1, -0.8)),
    "sideways": ((1, 0, 0), (1, 0, 0)),
    "up": ((0.25, 0, 1), (0.05, -0.05, 1)),
    "forward": ((0.1, -1, -0.05), (0, -1, 0)),
    "folded": ((0.2, -0.45, -0.9), (-0.9, -0.4, 0.1)),
    "guard": ((0.15, -0.35, -0.95), (-0.15, -0.65, 0.75)),
    "forearms forward": ((0.15, -0.05, -1), (0, -1, -0.1)),
    "on thighs": ((0.15, -0.35, -0.95), (-0.1, -0.85, -0.45)),
    "on hips": ((0.7, 0.3, -0.65), (-0.65, -0.45, -0.6)),
    "behind head": ((0.9, -0.15, 0.45), (-0.75, 0.2, 0.6)),
}
"""Directions of the left upper arm and forearm; the right ones mirror them."""
_HANDS_BUSY = ("hanging", "on thighs", "folded", "forward", "up", "guard")
_TOGETHER: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("standing", tuple(_ARMS)),
    ("left step", ("hanging", "guard")),
    ("right step", ("hanging", "guard")),
    ("wide", ("hanging", "forearms forward", "up")),
    ("sitting", (*_HANDS_BUSY, "sideways")),
    ("sitting wide", ("hanging", "on thighs", "guard")),
    ("sitting back", ("hanging", "on thighs")),
    ("sitting forward", ("hanging", "on thighs", "forward")),
    ("crouching", ("hanging", "forward", "guard", "up")),
    ("squatting", ("hanging", "forward")),
    ("kneeling", ("hanging", "forearms forward", "up")),
    ("left knee", ("hanging", "forearms forward")),
    ("right knee", ("hanging", "forearms forward")),
    ("on the floor", ("hanging", "on thighs")),
    ("cross-legged", ("on thighs",)),
    ("bowing", ("hanging", "forward")),
)
_ONE_ARM = ("up", "forward", "sideways")
"""What one arm alone does, of a person who stands or sits."""
_TO_JOINTS = SolveSettings(iterations=30, coarse_iterations=15)


def posture_names() -> tuple[str, ...]:
    """Of `postures`, in their order."""
    names = [f"{legs}, arms {arms}" for legs, all_ in _TOGETHER for arms in all_]
    names += [f"{legs}, {side} arm {arm}" for legs in ("standing", "sitting") for arm in _ONE_ARM for side in _SIDES]
    return tuple(names)


_SIDES = ("left", "right")


def postures(body: Body) -> Array:
    """(N, D) poses of a body at the origin, facing -y, within its limits; `posture_names` names them."""
    return _postures(_Key(body))


class _Key:
    """A body by its identity: the postures of one are asked for again and again."""

    def __init__(self, body: Body) -> None:
        self.body = body

    def __hash__(self) -> int:
        return id(self.body)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and other.body is self.body


@lru_cache(4)
def _postures(key: _Key) -> Array:
    body, out = key.body, []
    for legs, all_ in _TOGETHER:
        out += [_posed(body, legs, arms, arms) for arms in all_]
    for legs, rest in (("standing", "hanging"), ("sitting", "on thighs")):
        for arm in _ONE_ARM:
            out += [_posed(body, legs, arm, rest), _posed(body, legs, rest, arm)]
    return np.stack(out)


def _posed(body: Body, legs: str, left_arm: str, right_arm: str) -> Array:
    """(D,) the pose whose joints lie where the directions put them, as far as anatomy allows."""
    s = body.skeleton
    lean, *directions = _LEGS[legs]
    trunk = so3_exp([np.radians(lean), 0.0, 0.0])
    rest = s.rest_joints
    wanted = rest @ trunk.T
    (left_upper, left_fore), (right_upper, right_fore) = _ARMS[left_arm], _ARMS[right_arm]
    chains = [
        ("left", ("hip", "knee", "ankle"), directions[:2]),
        ("right", ("hip", "knee", "ankle"), directions[2:]),
        ("left", ("shoulder", "elbow", "wrist"), [left_upper, left_fore]),
        ("right", ("shoulder", "elbow", "wrist"), [_mirrored(right_upper), _mirrored(right_fore)]),
    ]
    for side, chain, ways in chains:
        joints = [s.joint(f"{side}_{part}") for part in chain]
        for a, b, way in zip(joints[:-1], joints[1:], ways, strict=True):
            d = np.array(way) / np.linalg.norm(way)
            wanted[b] = wanted[a] + np.linalg.norm(rest[b] - rest[a]) * d
    start = np.zeros(s.dof)
    start[3] = np.radians(lean)
    for side in _SIDES:  # bent knees and hips to begin with: straight ones may bend either way
        start[s.dofs_of(f"{side}_hip")[0]] = -0.4
        start[s.dofs_of(f"{side}_knee")] = 0.4
    count = len(rest)
    points = PointTerm(wanted, np.ones(count), np.arange(count), np.zeros((count, 3)), 0.05)
    return fit_pose(body, s.clamp(start), [points], priors=(anatomical_prior(s),), options=_TO_JOINTS).pose


def _mirrored(way: Vector) -> Vector:
    return -way[0], way[1], way[2]
