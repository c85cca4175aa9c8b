"""Names of joints in other programs: export under their names, and convert rigs of other programs to the 19 joints."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body
from hypose.body.default_body import JOINT_NAMES, human
from hypose.body.motion import Motion
from hypose.body.skeleton import Skeleton
from hypose.errors import InputError
from hypose.geometry import Array, procrustes, transform

MIXAMO: Mapping[str, str] = {
    "pelvis": "Hips",
    "spine": "Spine",
    "chest": "Spine1",
    "neck": "Neck",
    "head": "Head",
    **{
        f"{side.lower()}_{joint}": side + bone
        for side in ("Left", "Right")
        for joint, bone in {
            "clavicle": "Shoulder",
            "shoulder": "Arm",
            "elbow": "ForeArm",
            "wrist": "Hand",
            "hip": "UpLeg",
            "knee": "Leg",
            "ankle": "Foot",
        }.items()
    },
}
"""Bone of a Mixamo rig that starts at each joint (without the prefix "mixamorig:")."""

SMPL_JOINTS: tuple[str, ...] = tuple(
    "pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 left_foot right_foot "
    "neck left_collar right_collar head left_shoulder right_shoulder left_elbow right_elbow left_wrist "
    "right_wrist".split()
)
"""The first 22 joints of SMPL, SMPL-H and SMPL-X; those after them are hands and face."""

_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
# names of each joint without its side; "shoulder" means the collar bone where the arm has its own name
_CALLED = {
    "pelvis": ("pelvis", "hips", "hip"),
    "neck": ("neck", "neck1", "neck01"),
    "head": ("head",),
    "clavicle": ("clavicle", "collar", "collarbone"),
    "shoulder": ("upperarm", "uparm", "arm"),
    "elbow": ("forearm", "lowerarm", "elbow"),
    "wrist": ("hand", "wrist"),
    "hip": ("upleg", "thigh", "upperleg", "hip"),
    "knee": ("leg", "calf", "shin", "lowerleg", "knee"),
    "ankle": ("foot", "ankle"),
}


def renamed_skeleton(skeleton: Skeleton, names: Mapping[str, str]) -> Skeleton:
    """Rename the joints of a skeleton.

    names: new name by old name; joints that are not in it keep theirs.
    Raises: InputError where two joints would get the same name.
    """
    new = tuple(names.get(n, n) for n in skeleton.joint_names)
    if len(set(new)) < len(new):
        twice = next(n for n in new if new.count(n) > 1)
        raise InputError(f"Two joints would be called {twice!r}; give each its own name.")
    return replace(skeleton, joint_names=new)


def renamed_motion(motion: Motion, names: Mapping[str, str]) -> Motion:
    """Rename the joints of a motion, for export under the names of another program.

    names: new name by old name, for example MIXAMO; joints that are not in it keep theirs.
    """
    return replace(motion, skeleton=renamed_skeleton(motion.skeleton, names))


def renamed_body(body: Body, names: Mapping[str, str]) -> Body:
    """Rename the joints of a body, for export with a motion that `renamed_motion` renamed by the same names."""
    return replace(body, skeleton=renamed_skeleton(body.skeleton, names))


@dataclass(frozen=True)
class MatchedRig:
    """Rig of another program, converted to the 19 joints of the human body.

    joints: (19, 3) joint centres in the units of the rig.
    weights: (V, 19) skinning weights.
    absent: names of joints that the rig lacks; they are placed by the template's proportions and have no weight.
    """

    joints: Array
    weights: Array
    absent: tuple[str, ...]


def match_rig(
    names: Sequence[str], parents: ArrayLike, joints: ArrayLike, weights: ArrayLike, where: str
) -> MatchedRig:
    """Convert joints and weights of a rig of Mixamo, Rigify, SMPL, OpenSim or this package to the 19 joints.

    names: (n) names of the rig's joints.
    parents: (n,) index of each parent, -1 for none, in any order.
    joints: (n, 3) joint centres.
    weights: (V, n) skinning weights.
    where: name of the file, for messages.
    Returns: the matched rig. Fingers, toes, twist bones and others are added to the nearest ancestor among the 19; the
        joints of the trunk are chosen by their position between pelvis and neck.
    Raises: InputError that names the limbs, pelvis or head that were not found, or counts vertices without weight.
    """
    p, at = np.asarray(parents, dtype=np.int64), np.asarray(joints, dtype=np.float64)
    found = _by_name(names)
    needed = ["pelvis", "head", *(f"{s}_{k}" for s in ("left", "right") for k in _LIMBS)]
    missing = [n for n in needed if n not in found]
    if missing:
        some = ", ".join(list(names)[:12])
        raise InputError(
            f"{where}: the rig's joints {', '.join(missing)} were not recognised among {some}, ...; rename the bones "
            "as in docs/own-body.md, or rig the mesh again without its skin."
        )
    found |= _trunk(found, p, at)
    # each joint's weight goes to itself if it is one of the 19 joints, else to its nearest ancestor that is
    ours = {k: JOINT_NAMES.index(n) for n, k in found.items()}
    owner = [next((ours[a] for a in _chain(k, p) if a in ours), 0) for k in range(len(p))]
    dense = np.asarray(weights, dtype=np.float64)
    out = np.zeros((len(dense), len(JOINT_NAMES)))
    np.add.at(out.T, owner, dense.T)
    total = out.sum(1, keepdims=True)
    if not (total > 1e-6).all():
        raise InputError(
            f"{where}: {int((total <= 1e-6).sum())} vertices have no skinning weight; give them weights first."
        )
    absent = tuple(n for n in JOINT_NAMES if n not in found)
    # the joints that the rig lacks are placed by the similarity that brings the template's nearest to the rig's
    rest, have, there = human().skeleton.rest_joints, [JOINT_NAMES.index(n) for n in found], at[list(found.values())]
    placed = transform(procrustes(rest[have], there, scale=True)[0], rest)
    placed[have] = there
    return MatchedRig(placed, out / total, absent)


def _plain(name: str) -> tuple[str, str]:
    """Split a joint's name into (side, rest): ("left", "upperarm") for "mixamorig:LeftUpperArm", "upper_arm.L",
    "upperarm_l".
    """
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", name.split(":")[-1])
    tokens = [
        t for t in re.split(r"[^A-Za-z0-9]+", words.lower()) if t and t not in ("def", "bip01", "bip", "j", "jnt")
    ]
    side = ""
    for word, sides in (("left", ("left", "l")), ("right", ("right", "r"))):
        if any(t in sides for t in tokens):
            side, tokens = word, [t for t in tokens if t not in sides]
            break
    return side, "".join(tokens)


def _by_name(names: Sequence[str]) -> dict[str, int]:
    """Find the joints of a rig whose names are known: index in the rig by our name."""
    plain = [_plain(n) for n in names]
    out: dict[str, int] = {}
    for ours, called in _CALLED.items():
        for side in ("left", "right") if ours not in ("pelvis", "neck", "head") else ("",):
            for word in called:
                if (side, word) in plain:
                    out[f"{side}_{ours}" if side else ours] = plain.index((side, word))
                    break
    for side in ("left", "right"):
        if (side, "shoulder") in plain:
            k = plain.index((side, "shoulder"))
            out.setdefault(f"{side}_shoulder" if f"{side}_shoulder" not in out else f"{side}_clavicle", k)
    return out


def _chain(k: int, parents: NDArray[np.int64]) -> list[int]:
    """List a joint and its ancestors; stops after as many as there are joints.

    k: index of the joint.
    parents: (n,) index of each parent, -1 for none.
    """
    out: list[int] = []
    while k >= 0 and len(out) <= len(parents):
        out.append(k)
        k = int(parents[k])
    return out


def _trunk(found: Mapping[str, int], parents: NDArray[np.int64], at: Array) -> dict[str, int]:
    """Find spine and chest among the joints between pelvis and head (or neck).

    found: index in the rig by our name.
    parents: (n,) index of each parent.
    at: (n, 3) joint centres.
    Returns: index by name; a joint is left out where none lies near its usual share of the way.
    """
    top, pelvis = found.get("neck", found["head"]), found["pelvis"]
    chain = _chain(top, parents)
    between = chain[1 : chain.index(pelvis)] if pelvis in chain else chain[1:]
    rest, whole, out = human().skeleton.rest_joints, at[top] - at[pelvis], dict[str, int]()
    neck = rest[JOINT_NAMES.index("neck")]
    for name in ("chest", "spine"):
        own = rest[JOINT_NAMES.index(name)] @ neck / (neck @ neck)
        free = [k for k in between if k not in (*found.values(), *out.values())]
        shares = [abs(float((at[k] - at[pelvis]) @ whole) / max(float(whole @ whole), 1e-12) - own) for k in free]
        if free and min(shares) < 0.2:
            out[name] = free[int(np.argmin(shares))]
    return out
