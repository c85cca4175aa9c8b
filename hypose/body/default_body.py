"""Default body: the 36-dof human on the template mesh, and the definition of its degrees of freedom."""

from __future__ import annotations

from functools import lru_cache
from importlib import resources

import numpy as np

from hypose.body.body import Body, Landmarks, Mesh
from hypose.body.skeleton import Skeleton
from hypose.geometry import Array

JOINTS = (
    ("pelvis", -1),
    ("spine", 0),
    ("chest", 1),
    ("neck", 2),
    ("head", 3),
    ("left_clavicle", 2),
    ("left_shoulder", 5),
    ("left_elbow", 6),
    ("left_wrist", 7),
    ("right_clavicle", 2),
    ("right_shoulder", 9),
    ("right_elbow", 10),
    ("right_wrist", 11),
    ("left_hip", 0),
    ("left_knee", 13),
    ("left_ankle", 14),
    ("right_hip", 0),
    ("right_knee", 16),
    ("right_ankle", 17),
)
JOINT_NAMES = tuple(n for n, _ in JOINTS)
PARENTS = np.array([p for _, p in JOINTS], dtype=np.int64)

# Limits of a ball's rotation-vector components (degrees) and usual motion per frame at 25 fps (degrees, 1 sd).
# Magnitudes beyond +-180 are never needed because the vector's norm is the rotation angle.
_BALLS = {"spine": (45, 1.5), "neck": (50, 2.0), "shoulder": (150, 5.0), "hip": (115, 4.0)}
# joint: ((axis name, lower, upper, sigma), ...) in degrees; the elbow's axis comes from the template's bent arm
_HINGES = {
    "clavicle": (("y", -23, 23, 0.6), ("z", -23, 23, 0.6)),
    "elbow": (("flexion", -55, 105, 6.0),),
    "knee": (("flexion", -12, 140, 5.0),),
    "ankle": (("flexion", -45, 45, 3.0), ("inversion", -30, 30, 0.8)),
}
_ROOT_SIGMA = (0.010, 0.010, 0.0075)
_ROOT_TURN_SIGMA = (1.5, 1.5, 2.5)


def human_skeleton(rest_joints: Array) -> Skeleton:
    """Make the 36-dof human skeleton from joint centres rest_joints (19, 3) m in the model frame.

    Degrees of freedom: root 6, spine 3, neck 3; per side clavicle 2 (about y and z), shoulder 3, elbow 1, hip 3, knee 1
    (about x), ankle 2 (about x and y). The elbow turns about the normal of the plane of the resting arm, so that its
    zero is the bent arm of the template. Step sizes (sigma) are those of everyday motion recorded at 25 fps.
    """
    eye = np.eye(3)
    root = zip("tr", (_ROOT_SIGMA, np.radians(_ROOT_TURN_SIGMA)), strict=True)
    rows = [(f"pelvis_{kind}{c}", eye[k], 0, -np.inf, np.inf, sd[k]) for kind, sd in root for k, c in enumerate("xyz")]
    ball = np.zeros(len(JOINTS), dtype=bool)
    ball[0] = True
    for j, (name, _) in enumerate(JOINTS):
        kind = name.split("_")[-1]
        if kind in _BALLS:
            limit, sd = np.radians(_BALLS[kind])
            ball[j] = True
            rows += [(f"{name}_r{c}", eye[k], j, -limit, limit, sd) for k, c in enumerate("xyz")]
        elif kind in _HINGES:
            for axis_name, low, high, sd in _HINGES[kind]:
                axis = _hinge_axis(name, kind, axis_name, rest_joints)
                rows.append((f"{name}_{axis_name}", axis, j, *np.radians([low, high, sd])))
    offsets = rest_joints - np.where(PARENTS[:, None] >= 0, rest_joints[PARENTS], rest_joints[:1])
    names, axes, joint_of_dof, lower, upper, sigma = zip(*rows, strict=True)
    numbers = (np.array(v) for v in (lower, upper, sigma))
    return Skeleton(JOINT_NAMES, PARENTS, offsets, ball, np.array(axes), np.array(joint_of_dof), names, *numbers)


def _hinge_axis(name: str, kind: str, axis_name: str, joints: Array) -> Array:
    """Compute the unit axis of a hinge in the model frame, oriented so that flexion is positive.

    name, kind: name of the joint, and the same without its side.
    axis_name: flexion, inversion, y or z.
    joints: (19, 3) m, joint centres at rest.
    Returns: (3,).
    """
    if kind == "elbow":
        j = JOINT_NAMES.index(name)
        upper, fore = joints[j] - joints[j - 1], joints[j + 1] - joints[j]
        normal = np.cross(upper, fore)
        # a straight resting arm has no plane: bend it forwards
        if np.linalg.norm(normal) < 0.02 * np.linalg.norm(upper) * np.linalg.norm(fore):
            normal = np.cross(upper, [0.0, -1.0, 0.0])
        return normal / np.linalg.norm(normal)
    fixed = {"flexion": (1.0, 0.0, 0.0), "inversion": (0.0, 1.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    return np.array(fixed[axis_name])


def asset_arrays(name: str) -> dict[str, np.ndarray]:
    """Load the arrays of an .npz file that is shipped with the package, by its name in hypose/assets."""
    with resources.files("hypose.assets").joinpath(name).open("rb") as file:
        return dict(np.load(file, allow_pickle=False))


@lru_cache(maxsize=1)
def human() -> Body:
    """Load the default body: 36 dof on the template made from MakeHuman's CC0 data (hypose/assets/LICENSE-assets.md).

    Returns: the body in metres; every call returns the same object, so it must not be changed.
    """
    data = asset_arrays("template.npz")

    def mesh(level: str) -> Mesh:
        return Mesh(
            data[f"{level}_vertices"].astype(np.float64),
            data[f"{level}_faces"].astype(np.int32),
            data[f"{level}_skin_index"].astype(np.int32),
            data[f"{level}_skin_weight"].astype(np.float64),
        )

    marks = Landmarks(
        tuple(str(n) for n in data["landmark_names"]),
        data["landmark_joint"].astype(np.int64),
        data["landmark_offset"].astype(np.float64),
    )
    joints = data["joints"].astype(np.float64)
    return Body("human", human_skeleton(joints - joints[0]), mesh("coarse"), mesh("fine"), marks)
