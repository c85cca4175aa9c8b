"""Joint sets that depth sensors report, and the fifteen joints on which fusion works.

Sets: OpenNI/NITE (15), Kinect v2 (25), Azure Kinect (32). Fusion works on the 15 of OpenNI (Fig. 2 of Asteriadis et al.
    2013), because every SDK has them; the other joints of a larger set are carried along with them. Names are compared
    without case, spaces and underscores, and the side may stand before or after ("ShoulderLeft" = "SHOULDER_LEFT" =
    "left_shoulder").
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hypose.errors import InputError

COMMON = (
    "head",
    "neck",
    "left_shoulder",
    "left_elbow",
    "left_hand",
    "right_shoulder",
    "right_elbow",
    "right_hand",
    "torso",
    "left_hip",
    "left_knee",
    "left_foot",
    "right_hip",
    "right_knee",
    "right_foot",
)
"""The 15 joints of OpenNI in the order of this package (the paper's Fig. 2 counts the head as 1)."""

HEAD, NECK, LEFT_SHOULDER, LEFT_ELBOW, LEFT_HAND, RIGHT_SHOULDER, RIGHT_ELBOW, RIGHT_HAND = range(8)
TORSO, LEFT_HIP, LEFT_KNEE, LEFT_FOOT, RIGHT_HIP, RIGHT_KNEE, RIGHT_FOOT = range(8, 15)
TRUNK_JOINTS = (HEAD, NECK, LEFT_SHOULDER, RIGHT_SHOULDER, TORSO, LEFT_HIP, RIGHT_HIP)
"""Joints that every sensor finds reliably."""
TRIANGLE = (LEFT_SHOULDER, RIGHT_SHOULDER, TORSO)
"""Joints of the triangle by which the paper registers sensors (Asteriadis et al. 2013, section 2.1)."""
MIRROR = np.array([0, 1, 5, 6, 7, 2, 3, 4, 8, 12, 13, 14, 9, 10, 11])
"""(15,) index of the same joint on the other side."""
PARENT = np.array([1, 8, 1, 2, 3, 1, 5, 6, -1, 8, 9, 10, 8, 12, 13])
"""(15,) index of the neighbour towards the torso, -1 for the torso."""
SKELETON_BONES = np.array(
    [(0, 1), (1, 2), (2, 3), (3, 4), (1, 5), (5, 6), (6, 7), (1, 8), (8, 9), (9, 10), (10, 11), (8, 12), (12, 13)]
    + [(13, 14), (2, 5), (9, 12), (2, 8), (5, 8)]
)
"""(18, 2) pairs of joints whose distance hardly changes: bones, and distances within the trunk."""
BODY_JOINT = np.array([4, 3, 6, 7, 8, 10, 11, 12, 1, 13, 14, 15, 16, 17, 18])
"""(15,) index of the joint of the 19-joint body at (or next to) each common joint: the wrist for the hand, the ankle
for the foot, the spine for the torso.
"""


@dataclass(frozen=True)
class JointSet:
    """Description of the joints that a type of sensor reports.

    name: name of the set.
    joint_names: (J,) as the SDK writes them.
    common: (15,) index of each common joint in the set.
    parent: (J,) index of the parent, -1 for the root.
    """

    name: str
    joint_names: tuple[str, ...]
    common: NDArray[np.int64]
    parent: NDArray[np.int64]


def plain_name(name: str) -> str:
    """Normalise the name of a joint for comparison: lower case, letters only, the side in front."""
    letters = re.sub(r"[^a-z]", "", name.lower())
    for side in ("left", "right"):
        if side in letters:
            return side + letters.replace(side, "", 1)
    return letters


def joint_sets() -> tuple[JointSet, ...]:
    """Return the known joint sets: OpenNI (15), Kinect v2 (25), Azure Kinect (32)."""
    kinect_2 = (
        "SpineBase SpineMid Neck Head ShoulderLeft ElbowLeft WristLeft HandLeft ShoulderRight ElbowRight WristRight "
        "HandRight HipLeft KneeLeft AnkleLeft FootLeft HipRight KneeRight AnkleRight FootRight SpineShoulder "
        "HandTipLeft ThumbLeft HandTipRight ThumbRight",
        [-1, 0, 20, 2, 20, 4, 5, 6, 20, 8, 9, 10, 0, 12, 13, 14, 0, 16, 17, 18, 1, 7, 6, 11, 10],
        "Head SpineShoulder ShoulderLeft ElbowLeft HandLeft ShoulderRight ElbowRight HandRight SpineMid HipLeft "
        "KneeLeft AnkleLeft HipRight KneeRight AnkleRight",
    )
    azure = (
        "PELVIS SPINE_NAVEL SPINE_CHEST NECK CLAVICLE_LEFT SHOULDER_LEFT ELBOW_LEFT WRIST_LEFT HAND_LEFT HANDTIP_LEFT "
        "THUMB_LEFT CLAVICLE_RIGHT SHOULDER_RIGHT ELBOW_RIGHT WRIST_RIGHT HAND_RIGHT HANDTIP_RIGHT THUMB_RIGHT "
        "HIP_LEFT KNEE_LEFT ANKLE_LEFT FOOT_LEFT HIP_RIGHT KNEE_RIGHT ANKLE_RIGHT FOOT_RIGHT HEAD NOSE EYE_LEFT "
        "EAR_LEFT EYE_RIGHT EAR_RIGHT",
        [-1, 0, 1, 2, 2, 4, 5, 6, 7, 8, 7, 2, 11, 12, 13, 14, 15, 14, 0, 18, 19, 20, 0, 22, 23, 24, 3] + [26] * 5,
        "HEAD NECK SHOULDER_LEFT ELBOW_LEFT HAND_LEFT SHOULDER_RIGHT ELBOW_RIGHT HAND_RIGHT SPINE_NAVEL HIP_LEFT "
        "KNEE_LEFT ANKLE_LEFT HIP_RIGHT KNEE_RIGHT ANKLE_RIGHT",
    )
    openni = " ".join(COMMON), PARENT.tolist(), " ".join(COMMON)
    return tuple(_set(n, *of) for n, of in (("OpenNI", openni), ("Kinect v2", kinect_2), ("Azure Kinect", azure)))


@lru_cache(64)
def joint_set(names: tuple[str, ...]) -> JointSet:
    """Find the joint set that these joint names form, in any order.

    Returns: the set; its common and parent are indices into `names`.
    Raises: InputError that names the missing joints where the names form no known set.
    """
    given = [plain_name(n) for n in names]
    best: tuple[int, str] = (10**6, "")
    for known in joint_sets():
        wanted = [plain_name(n) for n in known.joint_names]
        missing = [n for n, w in zip(known.joint_names, wanted, strict=True) if w not in given]
        if not missing and len(given) == len(wanted):
            at = {w: given.index(w) for w in wanted}
            order = np.array([at[w] for w in wanted])
            back = np.argsort(order)
            parent = np.where(known.parent[back] >= 0, order[known.parent[back]], -1)
            return JointSet(known.name, names, order[known.common], parent)
        best = min(best, (len(missing) + abs(len(given) - len(wanted)), f"{known.name} lacks {', '.join(missing)}"))
    raise InputError(
        f"{len(names)} joints ({', '.join(names[:4])}, ...) are none of the known sets (OpenNI 15, Kinect v2 25, Azure "
        f"Kinect 32; {best[1]}); give all joints of one set with the SDK's names."
    )


def _set(name: str, joints: str, parent: Sequence[int], common: str) -> JointSet:
    """Make a joint set; joints, common: the names of its joints, and of those that are the common ones, in order."""
    at = {plain_name(n): i for i, n in enumerate(joints.split())}
    of_common = np.array([at[plain_name(n)] for n in common.split()])
    return JointSet(name, tuple(joints.split()), of_common, np.array(parent))
