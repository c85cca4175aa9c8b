"""The points that data sets and sensors report, on our body: every point is a mean of joints and landmarks of the rest
pose, carried by one joint.

| set | points | source of the definition |
| --- | --- | --- |
| OPENNI_15 | the joints of OpenNI/NiTE's skeleton | head = middle of the skull, hand = middle of the palm |
| BODY_25 | OpenPose's body model | neck = middle of the shoulders, mid_hip = middle of the hips |
| HUMANEVA_15 | the virtual markers over which HumanEva averages | ends of limbs, pelvis, thorax, head |
| IXMAS_5 | hands, head and feet, as annotated by hand | Alcoverro 2014, section 2.5.2 |

OpenNI, HumanEva and IXMAS print no offsets; those here are ours, chosen from what annotators and sensors point at.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hypose.body.body import Body, Landmarks
from hypose.errors import InputError

Rule = tuple[str, tuple[str, ...]]
"""(the joint that carries the point, the joints and landmarks of which it is the mean at rest)."""

_FACE: dict[str, Rule] = {n: ("head", (n,)) for n in ("nose", "left_eye", "right_eye", "left_ear", "right_ear")}
_NECK: Rule = ("chest", ("left_shoulder", "right_shoulder"))
_MID_HIP: Rule = ("pelvis", ("left_hip", "right_hip"))
_SKULL: Rule = ("head", ("left_ear", "right_ear", "head_top", "nose"))


def _limbs(**parts: tuple[str, tuple[str, ...]]) -> dict[str, Rule]:
    return {
        f"{s}_{name}": (f"{s}_{carrier}", tuple(f"{s}_{p}" for p in points))
        for s in ("left", "right")
        for name, (carrier, points) in parts.items()
    }


_SHOULDER, _ELBOW, _WRIST = ("clavicle", ("shoulder",)), ("elbow", ("elbow",)), ("wrist", ("wrist",))
_KNEE, _ANKLE = ("knee", ("knee",)), ("ankle", ("ankle",))
_PALM = ("wrist", ("wrist", "knuckle", "knuckle"))
_HIPS: dict[str, Rule] = {f"{s}_hip": ("pelvis", (f"{s}_hip",)) for s in ("left", "right")}

_BODY_25_ORDER = (
    "nose neck right_shoulder right_elbow right_wrist left_shoulder left_elbow left_wrist mid_hip right_hip right_knee "
    "right_ankle left_hip left_knee left_ankle right_eye left_eye right_ear left_ear left_big_toe left_small_toe "
    "left_heel right_big_toe right_small_toe right_heel"
).split()
_ALL_25 = {
    **_FACE,
    "neck": _NECK,
    "mid_hip": _MID_HIP,
    **_HIPS,
    **_limbs(
        shoulder=_SHOULDER,
        elbow=_ELBOW,
        wrist=_WRIST,
        knee=_KNEE,
        ankle=_ANKLE,
        big_toe=("ankle", ("big_toe",)),
        small_toe=("ankle", ("small_toe",)),
        heel=("ankle", ("heel",)),
    ),
}

# the order of fusion.joints, which the reports of sensors are brought to
_OPENNI_ORDER = (
    "head neck left_shoulder left_elbow left_hand right_shoulder right_elbow right_hand torso left_hip left_knee "
    "left_foot right_hip right_knee right_foot"
).split()
_OPENNI: dict[str, Rule] = {
    "head": _SKULL,
    "neck": _NECK,
    # the point between neck and hips that NiTE calls torso moves with the belly
    "torso": ("spine", ("left_shoulder", "right_shoulder", "left_hip", "right_hip")),
    **_limbs(shoulder=_SHOULDER, elbow=_ELBOW, hand=_PALM),
    **_HIPS,
    **_limbs(knee=_KNEE, foot=("ankle", ("ankle", "ankle", "big_toe"))),
}

LANDMARK_SETS: Mapping[str, Mapping[str, Rule]] = {
    "OPENNI_15": {n: _OPENNI[n] for n in _OPENNI_ORDER},
    "BODY_25": {n: _ALL_25[n] for n in _BODY_25_ORDER},
    "HUMANEVA_15": {
        "pelvis": _MID_HIP,
        "thorax": _NECK,
        "head": ("head", ("left_ear", "right_ear", "head_top", "head_top")),
        **_limbs(shoulder=_SHOULDER, elbow=_ELBOW, wrist=_WRIST),
        **_HIPS,
        **_limbs(knee=_KNEE, ankle=_ANKLE),
    },
    "IXMAS_5": {
        "head": _SKULL,
        **_limbs(hand=_PALM),
        **_limbs(foot=("ankle", ("heel", "big_toe"))),
    },
}
"""name -> {point: (carrying joint, joints and landmarks of which it is the mean)}."""


def landmark_set(body: Body, name: str) -> Landmarks:
    """The points of a set on a body, as joints and offsets (m, in the joint's rest frame): replace(body,
    landmarks=...) has them at every pose. An InputError lists the sets, or names the point that the body lacks."""
    rules = LANDMARK_SETS.get(name.strip().upper().replace("-", "_"))
    if rules is None:
        raise InputError(f"There is no landmark set {name!r}; the sets are {', '.join(LANDMARK_SETS)}.")
    rest, marks = body.skeleton.rest_joints, body.landmarks
    # landmarks first: where a joint has a landmark's name, the joint is meant
    place = {n: rest[marks.joint[k]] + marks.offset[k] for k, n in enumerate(marks.names)}
    place |= {n: rest[k] for k, n in enumerate(body.skeleton.joint_names)}
    joint, offset = [], []
    for point, (carrier, sources) in rules.items():
        missing = [n for n in (*sources, carrier) if n not in place]
        if missing:
            raise InputError(f"The body {body.name!r} has no {missing[0]}, which {name}'s point {point!r} is made of.")
        joint.append(body.skeleton.joint(carrier))
        offset.append(np.mean([place[n] for n in sources], axis=0) - rest[joint[-1]])
    return Landmarks(tuple(rules), np.array(joint, dtype=np.int64), np.array(offset))
