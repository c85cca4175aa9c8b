"""Compute anatomical joint angles (for clinicians and biomechanics) from poses of the human skeleton.

Angles are measured from an anatomical neutral pose, not from the rest pose of the template: standing upright, arms
hanging, axes of the elbows sideways (a bent forearm points forwards), limbs straight, feet flat. The neutral pose is
defined by the skeleton: the rest directions of thigh and upper arm are turned to the vertical, and the axes of knee and
elbow to the side; trunk, head and feet are neutral as they rest in the template.

Names, signs and order of rotations are those of OpenSim's full-body model (Rajagopal 2016). Body axes: X forwards, Y
up, Z to the subject's right. A ball's rotation is Rz Rx Ry about the moving axes, in this order; for the left side X
and Y are mirrored, so that the same motion has the same sign on both sides. Positive are
- pelvis_tilt backwards, pelvis_list right side down, pelvis_rotation turning left, all against OpenSim's ground (X =
world y, Y = world z, Z = world x); pelvis_tx, _ty, _tz: the pelvis joint centre there, metres;
- hip_flexion thigh forwards, hip_adduction towards the midline, hip_rotation inwards;
- knee_angle flexion; ankle_angle dorsiflexion; subtalar_angle inversion (about the foot's long axis, not OpenSim's
oblique subtalar axis);
- lumbar (chest against pelvis) extension backwards, bending to the right, rotation to the left; neck (head against
chest) likewise;
- arm_flex forwards, arm_add towards the midline, arm_rot inwards: upper arm against the chest, so that the clavicle's
motion is part of it, as in OpenSim's model, which has no clavicle joint;
- elbow_flex flexion.
Knee and elbow are hinges: their angle is that of the hinge, without crosstalk from the small angle between the hinge's
axis and the limb.

Source: Rajagopal et al. 2016, "Full-body musculoskeletal model for muscle-driven simulation of human gait", joint
    definitions. Deviation: the full-body model has no neck; other models call neck_extension neck_flexion, with the
    sign used here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.skeleton import Skeleton
from hypose.errors import InputError
from hypose.geometry import Array, frame_of, so3_exp

# opensim_from_model: body axes X forwards (-y), Y up (z), Z right (-x)
BODY_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
# opensim_from_world: ground X = y, Y = z, Z = x, as in the TRC files
GROUND_AXES = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])

_SIDES = (("r", "right"), ("l", "left"))
# parent, child, names of the rotations about z, x, y (those of x and y are mirrored on the left side)
_BALLS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("pelvis", "chest", ("lumbar_extension", "lumbar_bending", "lumbar_rotation")),
    ("chest", "head", ("neck_extension", "neck_bending", "neck_rotation")),
    *(
        row
        for s, side in _SIDES
        for row in (
            ("pelvis", f"{side}_hip", (f"hip_flexion_{s}", f"hip_adduction_{s}", f"hip_rotation_{s}")),
            (f"{side}_knee", f"{side}_ankle", (f"ankle_angle_{s}", f"subtalar_angle_{s}")),
            ("chest", f"{side}_shoulder", (f"arm_flex_{s}", f"arm_add_{s}", f"arm_rot_{s}")),
        )
    ),
)
_HINGES = tuple(
    (f"{side}_{parent}", f"{side}_{child}", f"{name}_{s}")
    for s, side in _SIDES
    for parent, child, name in (("hip", "knee", "knee_angle"), ("shoulder", "elbow", "elbow_flex"))
)
_FIRST_HINGE = 3 + 3 * len(_BALLS)
TURNS = _FIRST_HINGE + len(_HINGES) + 3
"""Number of values that are read off one frame."""
ANGLE_NAMES: tuple[str, ...] = (
    *("pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz"),
    *(
        f"{a}_{s}"
        for s, _ in _SIDES
        for a in (
            "hip_flexion",
            "hip_adduction",
            "hip_rotation",
            "knee_angle",
            "ankle_angle",
            "subtalar_angle",
        )
    ),
    *(
        "lumbar_extension",
        "lumbar_bending",
        "lumbar_rotation",
        "neck_extension",
        "neck_bending",
        "neck_rotation",
    ),
    *(f"{a}_{s}" for s, _ in _SIDES for a in ("arm_flex", "arm_add", "arm_rot", "elbow_flex")),
)
# row of the values read off a frame, by name
_ROWS = {
    **{name: k for k, name in enumerate(ANGLE_NAMES[:3])},
    **{name: 3 * n + k for n, (_, _, names) in enumerate(_BALLS, 1) for k, name in enumerate(names)},
    **{name: n for n, (_, _, name) in enumerate(_HINGES, _FIRST_HINGE)},
    **{name: TURNS - 3 + k for k, name in enumerate(ANGLE_NAMES[3:6])},
}
_ORDER = np.array([_ROWS[name] for name in ANGLE_NAMES])
_MIRRORED = np.array([name.endswith("_l") for name in ANGLE_NAMES]) & (_ORDER % 3 > 0) & (_ORDER < _FIRST_HINGE)


def is_length(name: str) -> bool:
    """Return whether the values of an angle name (ANGLE_NAMES) are lengths in metres and not angles in radians, as
    those of the pelvis position are.
    """
    return name.endswith(("_tx", "_ty", "_tz"))


def joint_angles(skeleton: Skeleton, poses: ArrayLike) -> tuple[tuple[str, ...], Array]:
    """Compute anatomical joint angles of poses.

    skeleton: human skeleton.
    poses: (T, D), rad and m.
    Returns: names (A) and values (T, A), rad, and m for pelvis_t*. Angles are continuous in time (unwrapped, and on one
        branch of the Euler angles); a frame whose pose is not finite is NaN and does not affect the others.
    Raises: InputError where the skeleton lacks one of the human joints.
    """
    q = np.asarray(poses, dtype=np.float64)
    if q.ndim != 2 or q.shape[1] != skeleton.dof:
        raise InputError(f"Joint angles need poses of shape (frames, {skeleton.dof}), got {q.shape}.")
    values = np.full((len(q), len(ANGLE_NAMES)), np.nan)
    good = np.isfinite(q).all(1)
    if good.any():
        values[good] = angles_of_frames(skeleton, *skeleton.forward(q[good]))
    return ANGLE_NAMES, values


def angles_of_frames(skeleton: Skeleton, world_from_joint: Array, centres: Array) -> Array:
    """Compute anatomical joint angles from joint frames.

    world_from_joint: (T, J, 3, 3) rotations, identity in the skeleton's rest pose.
    centres: (T, J, 3) m, joint centres.
    Returns: (T, A) values as in `joint_angles`.
    """
    return angles_in_time(turns_reader(skeleton)(world_from_joint, centres)).T


def turns_reader(skeleton: Skeleton) -> Callable[[Array, Array], Array]:
    """Make a function that reads the angles of each frame separately, before `angles_in_time` makes them continuous.

    Returns: function of joint frames and centres (as in `angles_of_frames`) that returns (TURNS, T): (z, x, y) of the
        pelvis in the world and of all balls, angles of the hinges, and the pelvis position.
    """
    neutral = neutral_frames(skeleton)
    joint = {name: skeleton.joint(name) for *pair, _ in (*_BALLS, *_HINGES) for name in pair}
    hinges = [(a, b, hinge_axis(skeleton, b), straight_offset(skeleton, b)) for a, b, _ in _HINGES]

    def read(world_from_joint: Array, centres: Array) -> Array:
        # frames are the last axis: numpy would otherwise multiply the many small matrices one by one
        parts = {n: np.ascontiguousarray(np.moveaxis(world_from_joint[:, j], 0, -1)) for n, j in joint.items()}
        out = np.empty((TURNS, len(world_from_joint)))
        out[:3] = _zxy(_product(GROUND_AXES, _product(parts["pelvis"], (BODY_AXES @ neutral["pelvis"]).T)))
        for n, (parent, child, _) in enumerate(_BALLS, 1):
            r = _product(parts[parent].swapaxes(0, 1), parts[child])
            r = _product(BODY_AXES @ neutral[parent], _product(r, (BODY_AXES @ neutral[child]).T))
            out[3 * n : 3 * n + 3] = _zxy(r)
        for n, (parent, child, axis, straight) in enumerate(hinges, _FIRST_HINGE):
            out[n] = _turn_about(_product(parts[parent].swapaxes(0, 1), parts[child]), axis) + straight
        out[-3:] = (centres[:, joint["pelvis"]] @ GROUND_AXES.T).T
        return out

    return read


def angles_in_time(turns: Array) -> Array:
    """Make angles continuous in time, and order them by ANGLE_NAMES.

    turns: (TURNS, T), read by `turns_reader` from consecutive frames.
    Returns: (A, T) values as in `joint_angles`.
    """
    out = turns.copy()
    for k in range(0, _FIRST_HINGE, 3):
        out[k : k + 3] = _continuous(turns[k : k + 3], prior_axis=2 if k else 1)
    return np.where(_MIRRORED[:, None], -1.0, 1.0) * out[_ORDER]


def _product(a: Array, b: Array) -> Array:
    """Multiply matrices frame by frame.

    a, b: (3, 3) or (3, 3, T); at least one has the frames axis.
    Returns: (3, 3, T).
    """
    out = np.empty((3, 3, max(a.size, b.size) // 9))
    for i in range(3):
        for k in range(3):
            np.multiply(a[i, 0], b[0, k], out=out[i, k])
            out[i, k] += a[i, 1] * b[1, k]
            out[i, k] += a[i, 2] * b[2, k]
    return out


def neutral_frames(skeleton: Skeleton) -> dict[str, Array]:
    """Compute the rotation of every joint in the anatomical neutral pose.

    Returns: rotation model_from_joint (3, 3) by joint name.
    """
    frames = {name: np.eye(3) for name in skeleton.joint_names}
    down, side = np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0])
    for _, left_right in _SIDES:
        for upper, lower, axis in (("hip", "knee", side), ("shoulder", "elbow", -side)):
            u, lo = f"{left_right}_{upper}", f"{left_right}_{lower}"
            bone, hinge = skeleton.rest_offsets[skeleton.joint(lo)], hinge_axis(skeleton, lo)
            frames[u] = frame_of(down, axis) @ frame_of(bone, hinge).T
            frames[lo] = frames[u] @ so3_exp(-straight_offset(skeleton, lo) * hinge)
        # hands have no joint of their own: they go with the forearm
        frames[f"{left_right}_wrist"] = frames[f"{left_right}_elbow"]
    return frames


def straight_offset(skeleton: Skeleton, name: str) -> float:
    """Compute the angle of a knee or elbow hinge between the straight limb and the rest pose.

    skeleton: human skeleton.
    name: name of the hinge.
    Returns: rad; added to the value of the degree of freedom it gives the anatomical angle.
    Raises: InputError where the joint is no hinge or has no child.
    """
    axis, j = hinge_axis(skeleton, name), skeleton.joint(name)
    children = np.flatnonzero(skeleton.parents == j)
    if not len(children):
        raise InputError(f"The joint {name!r} has no child, so its limb has no direction.")
    a, b = skeleton.rest_offsets[j], skeleton.rest_offsets[children[0]]
    return float(np.arctan2(axis @ np.cross(a, b), a @ b - (a @ axis) * (b @ axis)))


def _turn_about(r: Array, axis: Array) -> Array:
    """Compute the angle of the rotation about a given axis that is nearest to each rotation.

    r: (3, 3, T) rotation matrices.
    axis: (3,) unit vector.
    Returns: (T,) rad, -pi to pi.
    """
    skew = axis[0] * (r[2, 1] - r[1, 2]) + axis[1] * (r[0, 2] - r[2, 0]) + axis[2] * (r[1, 0] - r[0, 1])
    along = sum(axis[i] * axis[k] * r[i, k] for i in range(3) for k in range(3))
    return np.arctan2(skew, r[0, 0] + r[1, 1] + r[2, 2] - along)


def hinge_axis(skeleton: Skeleton, name: str) -> Array:
    """Return the axis (3,) of a hinge joint, in the skeleton's rest frame.

    Raises: InputError where the joint does not have exactly one degree of freedom.
    """
    dofs = skeleton.dofs_of(name)
    if len(dofs) != 1:
        raise InputError(f"Joint angles need a hinge at {name!r}, this skeleton has {len(dofs)} degrees of freedom.")
    return skeleton.axes[dofs[0]]


def continuous_euler_zxy(rotations: ArrayLike, prior_axis: int = 2) -> Array:
    """Convert rotations into Euler angles z, x, y with R = Rz(z) Rx(x) Ry(y) that are continuous in time.

    rotations: (T, K, 3, 3).
    prior_axis: angle (1: x, 2: y) with a small cost beyond the range of a body, because near |x| = 90 deg noise alone
        would otherwise choose the branch.
    Returns: (T, K, 3) z, x, y, rad.

    Every rotation has two triples, (z, x, y) and (z + pi, pi - x, y + pi). The sequence of least total change is chosen
    by dynamic programming over the two. At |x| = 90 deg, where only z +- y is defined, y keeps its last value. The
    angles always reproduce the rotation.
    """
    r = np.moveaxis(np.asarray(rotations, dtype=np.float64), (-2, -1), (0, 1))
    return np.moveaxis(_continuous(_zxy(r), prior_axis), 0, -1)


def _zxy(r: Array) -> tuple[Array, Array, Array]:
    """Compute the Euler angles z, x, y of rotations R = Rz(z) Rx(x) Ry(y).

    r: (3, 3, ...) rotation matrices.
    Returns: z, x, y (...), rad, with |x| <= pi/2. In gimbal lock (|x| = pi/2), where only z +- y is defined, y is NaN
        and z is the angle for y = 0.
    """
    cosine = np.hypot(r[2, 0], r[2, 2])
    locked = cosine <= 1e-9
    x, y = np.arctan2(r[2, 1], cosine), np.where(locked, 0.0, np.arctan2(-r[2, 0], r[2, 2]))
    # z from R Ry(-y): stays exact where x is +-90 deg
    cy, sy = np.cos(y), np.sin(y)
    z = np.arctan2(r[1, 0] * cy + r[1, 2] * sy, r[0, 0] * cy + r[0, 2] * sy)
    return z, x, np.where(locked, np.nan, y)


def _continuous(zxy: Sequence[Array] | Array, prior_axis: int = 2) -> Array:
    """Make three angles continuous in time.

    zxy: (3, T, ...) rotations about z, x and y, rad; y is NaN in gimbal lock, where it is held at its last value.
    prior_axis: which of z, x, y (0, 1, 2) decides between the two equivalent triples of angles; it stays near 0.
    Returns: (3, T, ...) the same without jumps of whole turns.
    """
    z, x, y = zxy
    locked = np.isnan(y)
    y = _hold(y, ~locked)
    z = z - np.where(locked, np.sign(x) * y, 0.0)
    other = _second_branch(z, x, y, prior_axis)
    turned = zip((z + np.pi, np.pi - x, y + np.pi), (z, x, y), strict=True)
    return np.stack([_unwrapped(np.where(other, _wrap(a), b)) for a, b in turned])


def _unwrapped(angle: Array) -> Array:
    """Remove jumps of whole turns from angles (T, ...)."""
    turns = np.rint(np.diff(angle, axis=0) / (2 * np.pi))
    if not turns.any():
        return angle
    return np.concatenate([angle[:1], angle[1:] - 2 * np.pi * np.cumsum(turns, axis=0)])


def _wrap(angle: Array) -> Array:
    return angle - 2 * np.pi * np.rint(angle / (2 * np.pi))


def _hold(values: Array, defined: NDArray[np.bool_]) -> Array:
    """Replace undefined values (T, ...) by the last defined one before (0 where there is none)."""
    rows = np.arange(len(values)).reshape(-1, *[1] * (values.ndim - 1))
    last = np.maximum.accumulate(np.where(defined, rows, -1), axis=0)
    return np.where(last >= 0, np.take_along_axis(values, np.maximum(last, 0), 0), 0.0)


def _second_branch(z: Array, x: Array, y: Array, prior_axis: int) -> NDArray[np.bool_]:
    """Find where (T, ...) the second triple is on the sequence of least change plus cost of unlikely angles.

    z, x, y: (T, ...) angles of the first triple.

    From frame to frame both branches cost the same to stay on and the same to change, because each is the mirror of the
    other. The search therefore only needs the difference between the costs of the best sequences to the two branches. A
    change costs 3 pi - |dz| - |dy| - |x + x'|, staying costs |dz| + |dy| + |x - x'|, for |x| <= pi / 2.
    """
    usual, price = np.radians(100.0), 0.2
    here, aside = np.abs((x, y)[prior_axis - 1]), np.abs(x)
    extra = price * (np.maximum(np.pi - here - usual, 0) - np.maximum(here - usual, 0))
    dz, dy = (np.abs(_wrap(np.diff(a, axis=0))) for a in (z, y))
    dearer = 3 * np.pi - 2 * (dz + dy + np.maximum(aside[1:], aside[:-1]))
    out = np.zeros(here.shape, dtype=bool)
    # where neither changing the branch nor the second branch is ever cheaper, the first one is chosen
    for c in np.argwhere((dearer < 0).any(0) | (extra < 0).any(0)):
        column = (slice(None), *c)
        out[column] = _cheapest(dearer[column].tolist(), extra[column].tolist())
    return out


def _cheapest(dearer: list[float], extra: list[float]) -> list[int]:
    """Find the cheapest sequence of two branches by dynamic programming.

    dearer: (T - 1) additional cost of changing the branch instead of staying.
    extra: (T) additional cost of the second branch in each frame.
    Returns: 0 or 1 per frame.
    """
    ahead = extra[0]  # additional cost of the best sequence that ends on the second branch
    came_from: list[tuple[int, int]] = []
    for g, n in zip(dearer, extra[1:], strict=True):
        first, second = int(ahead + g < 0), int(ahead < g)
        came_from.append((first, second))
        to_first = ahead + g if first else 0.0
        to_second = ahead if second else g
        ahead = to_second - to_first + n
    way = [int(ahead < 0)]
    for step in reversed(came_from):
        way.append(step[way[-1]])
    return way[::-1]
