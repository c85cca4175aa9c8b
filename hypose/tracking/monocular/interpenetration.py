"""Spheres inside a body's parts, and which of them must keep apart: limbs from the trunk and from each other."""

from __future__ import annotations

import numpy as np

from hypose.body.body import BONE_END, Body
from hypose.compute import SphereArrays
from hypose.geometry import Array

TOLERANCE = 0.02
"""m: two parts that overlap by this much cost one half (weight 1)"""
FIRM = 0.85
"""share of the radii's sum that counts: skin gives way, and spheres are rounder than limbs"""
_TRUNK = ("pelvis", "spine", "chest", "head")
_ARM, _LEG = ("elbow", "wrist"), ("hip", "knee", "ankle")


def part_spheres(body: Body, weight: float) -> SphereArrays:
    """Spheres of the trunk, forearms, hands and legs of a body at rest, and the pairs that may not run into each other.

    Limb spheres sit on the bones with the median distance of the skin as radius, trunk spheres side by side with half
    the trunk's depth. Pairs: arms with trunk, with thighs and with each other; one leg with the other. Where parts
    touch at rest already, the rest distance counts.
    """
    names = body.skeleton.joint_names
    parts: list[str] = []
    joint: list[int] = []
    offset: list[Array] = []
    radius: list[float] = []
    for j, name in enumerate(names):
        skin = body.coarse.vertices[body.coarse.main_joint == j] - body.skeleton.rest_joints[j]
        if len(skin) < 4 or not (name in _TRUNK or name.split("_")[-1] in _ARM + _LEG):
            continue
        for centre, r in _spheres(body, name, skin):
            parts.append(name)
            joint.append(j)
            offset.append(centre)
            radius.append(r)
    at = body.skeleton.rest_joints[joint] + np.array(offset).reshape(-1, 3)
    pairs, apart = [], []
    for a in range(len(parts)):
        for b in range(a):
            if not _may_meet(parts[a], parts[b]):
                continue
            rest = float(np.linalg.norm(at[a] - at[b]))
            pairs.append((a, b))
            apart.append(min(FIRM * (radius[a] + radius[b]), 0.95 * rest))
    return SphereArrays(
        np.array(joint, dtype=np.int64),
        np.array(offset, dtype=np.float64).reshape(-1, 3),
        np.array(pairs, dtype=np.int64).reshape(-1, 2),
        np.array(apart, dtype=np.float64),
        weight / TOLERANCE**2,
    )


def _spheres(body: Body, name: str, skin: Array) -> list[tuple[Array, float]]:
    """(centre in the joint's rest frame, radius) of one part's spheres; skin (V, 3) in the same frame."""
    end = BONE_END.get(name)
    if end is not None:
        s = body.skeleton
        bone = s.rest_joints[s.joint(end)] - s.rest_joints[s.joint(name)]
        along = bone / np.linalg.norm(bone)
        r = float(np.median(np.linalg.norm(skin - (skin @ along)[:, None] * along, axis=1)))
        return [(k * bone, r) for k in (0.25, 0.5, 0.75, 1.0)]
    low, high = skin.min(0), skin.max(0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if name in ("pelvis", "spine", "chest"):
        r = float(half[1])
        side = max(float(half[0]) - r, 0.0)
        return [(middle + [k * side, 0, 0], r) for k in (-1.0, 0.0, 1.0)]
    return [(middle, float(np.median(half)))]


def _may_meet(a: str, b: str) -> bool:
    """Whether two parts can run into each other and are not neighbours."""
    kind_a, kind_b = a.split("_")[-1], b.split("_")[-1]
    if a in _TRUNK:
        a, b, kind_a, kind_b = b, a, kind_b, kind_a
    if b in _TRUNK:
        return kind_a in _ARM
    same_side = a.split("_")[0] == b.split("_")[0]
    if kind_a in _ARM and kind_b in _ARM or kind_a in _LEG and kind_b in _LEG:
        return not same_side
    return {kind_a, kind_b} in ({"wrist", "hip"}, {"elbow", "hip"})
