"""Anatomical joint angles: what a clinician reads, from the poses of the human skeleton.

Angles are measured from an anatomical neutral and not from the template's rest pose: standing upright, arms
hanging, the elbows' axes sideways (a bent forearm points forwards), limbs straight, feet flat. The neutral is
defined by the skeleton: the rest directions of thigh and upper arm are turned to the vertical and the axes of
knee and elbow to the side; trunk, head and feet are neutral as they rest in the template (upright, feet
flat).

Names, signs and order of rotations are those of OpenSim's full-body model (Rajagopal 2016). Body axes: X
forwards, Y up, Z to the subject's right. A ball's rotation is Rz Rx Ry about the moving axes, in this order;
for the left side X and Y are mirrored, so that the same motion has the same sign on both sides. Positive are
- pelvis_tilt backwards, pelvis_list right side down, pelvis_rotation turning left, all against OpenSim's
  ground (X = world y, Y = world z, Z = world x); pelvis_tx, _ty, _tz: the pelvis joint centre there, metres;
- hip_flexion thigh forwards, hip_adduction towards the midline, hip_rotation inwards;
- knee_angle flexion; ankle_angle dorsiflexion; subtalar_angle inversion (about the foot's long axis, not
  OpenSim's oblique subtalar axis);
- lumbar (chest against pelvis) extension backwards, bending to the right, rotation to the left; neck (head
  against chest) likewise;
- arm_flex forwards, arm_add towards the midline, arm_rot inwards: upper arm against the chest, so that the
  clavicle's motion is part of it, as in OpenSim's model, which has no clavicle joint;
- elbow_flex flexion.
Knee and elbow are hinges: their angle is that of the hinge, without crosstalk from the small angle between
the hinge's axis and the limb.

Source: Rajagopal et al. 2016, "Full-body musculoskeletal model for muscle-driven simulation of human gait",
joint definitions. Deviation: the full-body model has no neck; models that have one call neck_extension
neck_flexion, with the sign used here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.skeleton import Skeleton
from hypose.errors import InputError
from hypose.geometry import Array, so3_exp

# opensim_from_model: body axes X forwards (-y), Y up (z), Z right (-x)
BODY_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
# opensim_from_world: ground X = y, Y = z, Z = x, as in the TRC files
GROUND_AXES = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])

_SIDES = (("r", "right", 1.0), ("l", "left", -1.0))
ANGLE_NAMES: tuple[str, ...] = (
    *("pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz"),
    *(
        f"{a}_{s}"
        for s, _, _ in _SIDES
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
    *(f"{a}_{s}" for s, _, _ in _SIDES for a in ("arm_flex", "arm_add", "arm_rot", "elbow_flex")),
)


def is_length(name: str) -> bool:
    """True for the names whose values are metres rather than radians."""
    return name.endswith(("_tx", "_ty", "_tz"))


def joint_angles(skeleton: Skeleton, poses: ArrayLike) -> tuple[tuple[str, ...], Array]:
    """Anatomical joint angles of poses (T, D): names (A) and values (T, A), radians, and metres for
    pelvis_t*.

    Angles are continuous in time (unwrapped, and on one branch of the Euler angles); a frame whose pose is
    not finite is NaN and does not disturb the others. An InputError when the skeleton lacks one of the human
    joints.
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
    """(T, A) as `joint_angles` gives them, of joints' frames (T, J, 3, 3), identity in the skeleton's rest pose, and
    centres (T, J, 3) m."""
    columns = _columns(skeleton, world_from_joint, centres)
    return np.stack([columns[name] for name in ANGLE_NAMES], axis=1)


def _columns(skeleton: Skeleton, world_from_joint: Array, centres: Array) -> dict[str, Array]:
    neutral = neutral_frames(skeleton)
    out: dict[str, Array] = {}

    def anatomical(name: str) -> Array:
        """world_from_segment (T, 3, 3), where the segment frame equals the model frame in the neutral."""
        return world_from_joint[:, skeleton.joint(name)] @ neutral[name].T

    def relative(parent: str, child: str) -> Array:
        r = np.swapaxes(anatomical(parent), -1, -2) @ anatomical(child)
        return BODY_AXES @ r @ BODY_AXES.T

    def hinge(name: str) -> Array:
        j = skeleton.joint(name)
        r = np.swapaxes(world_from_joint[:, skeleton.parents[j]], -1, -2) @ world_from_joint[:, j]
        return _turn_about(r, hinge_axis(skeleton, name)) + straight_offset(skeleton, name)

    pelvis = GROUND_AXES @ anatomical("pelvis") @ BODY_AXES.T
    turn = continuous_euler_zxy(pelvis[:, None], prior_axis=1)[:, 0]
    out["pelvis_tilt"], out["pelvis_list"], out["pelvis_rotation"] = turn.T
    ground = centres[:, skeleton.joint("pelvis")] @ GROUND_AXES.T
    out["pelvis_tx"], out["pelvis_ty"], out["pelvis_tz"] = ground.T

    pairs = [("pelvis", "chest"), ("chest", "head")]
    for _, side, _ in _SIDES:
        pairs += [
            ("pelvis", f"{side}_hip"),
            (f"{side}_knee", f"{side}_ankle"),
            ("chest", f"{side}_shoulder"),
        ]
    euler = continuous_euler_zxy(np.stack([relative(a, b) for a, b in pairs], axis=1))
    angle = {child: euler[:, i] for i, (_, child) in enumerate(pairs)}
    for joint, name in (("chest", "lumbar"), ("head", "neck")):
        out[f"{name}_extension"], out[f"{name}_bending"], out[f"{name}_rotation"] = angle[joint].T
    for s, side, sign in _SIDES:
        hip, ankle, arm = (angle[f"{side}_{j}"] * [1, sign, sign] for j in ("hip", "ankle", "shoulder"))
        out[f"hip_flexion_{s}"], out[f"hip_adduction_{s}"], out[f"hip_rotation_{s}"] = hip.T
        out[f"knee_angle_{s}"] = hinge(f"{side}_knee")
        out[f"ankle_angle_{s}"], out[f"subtalar_angle_{s}"] = ankle[:, 0], ankle[:, 1]
        out[f"arm_flex_{s}"], out[f"arm_add_{s}"], out[f"arm_rot_{s}"] = arm.T
        out[f"elbow_flex_{s}"] = hinge(f"{side}_elbow")
    return out


def neutral_frames(skeleton: Skeleton) -> dict[str, Array]:
    """model_from_joint rotation (3, 3) of every joint in the anatomical neutral, by joint name."""
    frames = {name: np.eye(3) for name in skeleton.joint_names}
    down, side = np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0])
    for _, left_right, _ in _SIDES:
        for upper, lower, axis in (("hip", "knee", side), ("shoulder", "elbow", -side)):
            u, lo = f"{left_right}_{upper}", f"{left_right}_{lower}"
            bone, hinge = skeleton.rest_offsets[skeleton.joint(lo)], hinge_axis(skeleton, lo)
            frames[u] = _frame(down, axis) @ _frame(bone, hinge).T
            frames[lo] = frames[u] @ so3_exp(-straight_offset(skeleton, lo) * hinge)
        # hands have no joint of their own: they go with the forearm
        frames[f"{left_right}_wrist"] = frames[f"{left_right}_elbow"]
    return frames


def straight_offset(skeleton: Skeleton, name: str) -> float:
    """Angle (rad) of the knee or elbow hinge in the rest pose, from the straight limb: add it to the
    dof's value."""
    axis, j = hinge_axis(skeleton, name), skeleton.joint(name)
    children = np.flatnonzero(skeleton.parents == j)
    if not len(children):
        raise InputError(f"The joint {name!r} has no child, so its limb has no direction.")
    a, b = skeleton.rest_offsets[j], skeleton.rest_offsets[children[0]]
    return float(np.arctan2(axis @ np.cross(a, b), a @ b - (a @ axis) * (b @ axis)))


def _turn_about(rotations: Array, axis: Array) -> Array:
    """(T,) rad in (-pi, pi]: the turn about an axis (3,) that is nearest to rotations (T, 3, 3)."""
    skew = np.stack([rotations[:, 2, 1] - rotations[:, 1, 2], rotations[:, 0, 2] - rotations[:, 2, 0]], -1)
    skew = np.concatenate([skew, (rotations[:, 1, 0] - rotations[:, 0, 1])[:, None]], -1)
    trace, along = np.trace(rotations, axis1=1, axis2=2), np.einsum("i,tij,j->t", axis, rotations, axis)
    return np.arctan2(skew @ axis, trace - along)


def hinge_axis(skeleton: Skeleton, name: str) -> Array:
    """(3,) axis in the skeleton's rest frame of a joint with one hinge; an InputError for any other joint."""
    dofs = skeleton.dofs_of(name)
    if len(dofs) != 1:
        raise InputError(f"Joint angles need a hinge at {name!r}, this skeleton has {len(dofs)} degrees of freedom.")
    return skeleton.axes[dofs[0]]


def _frame(first: Array, second: Array) -> Array:
    """Rotation (3, 3) whose columns are the direction of `first`, of `second` across it, and their normal."""
    a = first / np.linalg.norm(first)
    b = second - (second @ a) * a
    b = b / np.linalg.norm(b)
    return np.stack([a, b, np.cross(a, b)], axis=1)


def continuous_euler_zxy(rotations: ArrayLike, prior_axis: int = 2) -> Array:
    """Rotations (T, K, 3, 3) -> angles (T, K, 3) = (z, x, y) in rad with R = Rz(z) Rx(x) Ry(y), continuous in
    time.

    Every rotation has two triples, (z, x, y) and (z + pi, pi - x, y + pi). The sequence of least total change
    is taken (dynamic programming over the two), with a small price on triples whose angle `prior_axis` (1: x,
    2: y) leaves what a body does: near |x| = 90 deg noise alone would decide the branch otherwise. At |x| =
    90 deg, where only z +- y is defined, y keeps its last value. The angles always give back the rotation.
    """
    r = np.asarray(rotations, dtype=np.float64)
    cosine = np.hypot(r[..., 2, 0], r[..., 2, 2])
    x = np.arctan2(r[..., 2, 1], cosine)
    y = _hold(np.arctan2(-r[..., 2, 0], r[..., 2, 2]), cosine > 1e-9)
    # z from R Ry(-y): stays exact where x is +-90 deg
    cy, sy = np.cos(y), np.sin(y)
    z = np.arctan2(r[..., 1, 0] * cy + r[..., 1, 2] * sy, r[..., 0, 0] * cy + r[..., 0, 2] * sy)
    first = np.stack([z, x, y], -1)
    second = np.stack([z + np.pi, np.pi - x, y + np.pi], -1)
    both = _wrap(np.stack([first, second], axis=2))
    chosen = np.take_along_axis(both, _branch(both, prior_axis)[..., None, None], axis=2)[:, :, 0]
    return np.unwrap(chosen, axis=0)


def _wrap(angle: Array) -> Array:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _hold(values: Array, defined: NDArray[np.bool_]) -> Array:
    """Values (T, K) with the undefined ones replaced by the last defined one before (0 where there is
    none)."""
    index = np.where(defined, np.arange(len(values))[:, None], -1)
    last = np.maximum.accumulate(index, axis=0)
    return np.where(last >= 0, np.take_along_axis(values, np.maximum(last, 0), 0), 0.0)


def _branch(both: Array, prior_axis: int) -> NDArray[np.int64]:
    """Branch (T, K) of the two triples (T, K, 2, 3) with the least change plus the price of unlikely
    angles.

    From frame to frame both branches cost the same to stay on and the same to leave for the other, for they are each
    other's mirror. So all that has to be known of the way so far is by how much the second one is dearer."""
    usual, price = np.radians(100.0), 0.2
    node = price * np.maximum(np.abs(both[..., prior_axis]) - usual, 0)
    t, k = both.shape[:2]
    stay = np.abs(_wrap(both[1:, :, 0] - both[:-1, :, 0])).sum(-1)
    change = np.abs(_wrap(both[1:, :, 0] - both[:-1, :, 1])).sum(-1)
    dearer, extra = change - stay, node[..., 1] - node[..., 0]
    out = np.zeros((t, k), dtype=np.int64)
    # where neither to leave the first one nor to be on the second is ever cheaper, the first one it is
    for c in np.flatnonzero((dearer < 0).any(0) | (extra < 0).any(0)):
        out[:, c] = _cheapest(dearer[:, c].tolist(), extra[:, c].tolist())
    return out


def _cheapest(dearer: list[float], extra: list[float]) -> list[int]:
    """The cheapest way over frames with two branches: dearer (T - 1), by how much it costs more to change the branch
    than to stay; extra (T), by how much the second branch costs more in a frame."""
    ahead = extra[0]  # by how much the way to the second branch is dearer
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
