"""Performance: a subject's known motion, and how it is made from joint angles.

Angles are anatomical and relative to standing upright with hanging arms. `perform` converts them to one world rotation
per joint for a given subject, whatever its rest pose, and finds the root's path from the feet: a foot that carries the
body stays on the ground and does not slide.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from hypose.body.default_body import JOINT_NAMES, PARENTS
from hypose.geometry import Array, rotation_between, so3_exp, so3_log, unit
from hypose.synthetic.subjects import SyntheticSubject


class Stance(NamedTuple):
    """Positions of planted feet, in m per m of leg length, relative to the point under the pelvis at rest.

    left_forward, right_forward: forward position of each ankle.
    half_width: outward position of both ankles.
    toes_out: outward turn of the toes, degrees.
    """

    left_forward: float = 0.0
    right_forward: float = 0.0
    half_width: float = 0.14
    toes_out: float = 8.0


@dataclass(frozen=True)
class Angles:
    """Motion as joint angles over time.

    name: name of the motion.
    times: (T,) s.
    values: (T,) by channel; missing channels are 0, which is standing upright with hanging arms. Of the whole body:
        pelvis_lean (forwards), pelvis_list (to the left), pelvis_turn (to the left), degrees; forward, left and up, m
        per m of leg length. Of the trunk, degrees: spine_ and neck_ lean, list and turn. Of each side (left_, right_),
        degrees: clavicle_up, clavicle_forward, shoulder_flexion, shoulder_abduction, shoulder_internal, elbow_flexion,
        hip_flexion, hip_abduction, hip_internal, knee_flexion, ankle_dorsiflexion; and heel, height of a planted
        foot's heel, m per m of leg length.
    stance: positions of planted feet; the legs follow by inverse kinematics, and leg channels are ignored. None: the
        legs follow the channels, and the body travels as far as its feet push it.
    turn_radius: radius of the circle on which it travels, m (infinite: straight).
    """

    name: str
    times: Array
    values: dict[str, Array]
    stance: Stance | None = None
    turn_radius: float = np.inf

    def get(self, channel: str) -> Array:
        """Return the values (T,) of a channel."""
        return np.broadcast_to(np.asarray(self.values.get(channel, 0.0), dtype=np.float64), self.times.shape)


@dataclass(frozen=True)
class Performance:
    """Exact motion of a subject.

    name: name of the motion.
    times: (T,) s.
    rotations: (T, 19, 3, 3) world_from_joint.
    root: (T, 3) m, pelvis in the world.
    joints: (T, 19, 3) m, world.
    """

    name: str
    times: Array
    rotations: Array
    root: Array
    joints: Array

    def __len__(self) -> int:
        return len(self.times)

    @property
    def frame_rate(self) -> float:
        """Frames per second."""
        return float((len(self.times) - 1) / (self.times[-1] - self.times[0])) if len(self.times) > 1 else 25.0


class OfPerformance:
    """Base class of objects with a `performance`; it gives them the times, frame rate, joints and rotations of this
    performance.
    """

    performance: Performance
    subject: SyntheticSubject

    def __len__(self) -> int:
        return len(self.performance)

    def vertices(self, index: int) -> Array:
        """Compute the subject's skin (and clothes) (V, 3) m in frame `index`."""
        return self.subject.skin(self.performance.rotations[index], self.performance.root[index])

    @property
    def times(self) -> Array:
        """(T,) s."""
        return self.performance.times

    @property
    def frame_rate(self) -> float:
        """Frames per second."""
        return self.performance.frame_rate

    @property
    def joints(self) -> Array:
        """(T, 19, 3) true joint centres, m, world."""
        return self.performance.joints

    @property
    def rotations(self) -> Array:
        """(T, 19, 3, 3) true world_from_joint rotations; identity in the subject's rest pose."""
        return self.performance.rotations


def assemble(name: str, subject: SyntheticSubject, times: Array, rotations: Array, root: Array) -> Performance:
    """Make a performance with the joint centres of the subject's own bones.

    name: name of the motion.
    subject: the person.
    times: (T,) s.
    rotations: (T, 19, 3, 3) world_from_joint.
    root: (T, 3) m, pelvis in the world.
    """
    return Performance(name, times, rotations, root, subject.place_joints(rotations, root))


def turn(axis: int, degrees: Array) -> Array:
    """Compute rotations (T, 3, 3) about coordinate axis 0, 1 or 2 by angles (T,) in degrees."""
    v = np.zeros((*np.shape(degrees), 3))
    v[..., axis] = np.radians(degrees)
    return so3_exp(v)


def hanging_from_rest(subject: SyntheticSubject) -> Array:
    """Compute the smallest rotations (19, 3, 3) that take the subject's rest pose to upright standing, from which
    angles are measured.

    Arms and legs hang straight down and the feet stay level.
    """
    down, j = np.array([0.0, 0.0, -1.0]), subject.joints
    out = np.tile(np.eye(3), (len(JOINT_NAMES), 1, 1))
    for a, b, c in ((6, 7, 8), (10, 11, 12), (13, 14, 15), (16, 17, 18)):
        out[a] = rotation_between(j[b] - j[a], down)
        out[b] = rotation_between(out[a] @ (j[c] - j[b]), down) @ out[a]
        if a < 13:
            out[c] = out[b]  # hands continue the forearm
    return out


def joint_rotations(angles: Angles) -> Array:
    """Compute the rotations (T, 19, 3, 3) of each joint in its parent's frame, relative to the hanging pose, from joint
    angles.

    x = left, y = backward, z = up: a lean forwards is a positive turn about x, flexion of hip, shoulder and elbow a
    negative one, and left and right mirror the turns about y and z.
    """
    g = angles.get
    out = np.tile(np.eye(3), (len(angles.times), len(JOINT_NAMES), 1, 1))
    out[:, 0] = turn(2, g("pelvis_turn")) @ turn(1, g("pelvis_list")) @ turn(0, g("pelvis_lean"))
    for part, joints in (("spine", (1, 2)), ("neck", (3, 4))):
        half = turn(2, g(f"{part}_turn") / 2) @ turn(1, g(f"{part}_list") / 2) @ turn(0, g(f"{part}_lean") / 2)
        for j in joints:
            out[:, j] = half
    for side, sign, first_arm, first_leg in (("left", 1.0, 5, 13), ("right", -1.0, 9, 16)):

        def c(channel: str, side: str = side) -> Array:
            return g(f"{side}_{channel}")

        out[:, first_arm] = turn(2, -sign * c("clavicle_forward")) @ turn(1, -sign * c("clavicle_up"))
        swing = turn(0, -c("shoulder_flexion")) @ turn(1, -sign * c("shoulder_abduction"))
        out[:, first_arm + 1] = swing @ turn(2, -sign * c("shoulder_internal"))
        out[:, first_arm + 2] = turn(0, -c("elbow_flexion"))
        thigh = turn(0, -c("hip_flexion")) @ turn(1, -sign * c("hip_abduction"))
        out[:, first_leg] = thigh @ turn(2, -sign * c("hip_internal"))
        out[:, first_leg + 1] = turn(0, c("knee_flexion"))
        out[:, first_leg + 2] = turn(0, -c("ankle_dorsiflexion"))
    return out


def global_rotations(local: Array) -> Array:
    """Multiply local rotations (T, 19, 3, 3) down the joint tree to world rotations (T, 19, 3, 3)."""
    out = local.copy()
    for j, p in enumerate(PARENTS):
        if p >= 0:
            out[:, j] = out[:, p] @ local[:, j]
    return out


def perform(angles: Angles, subject: SyntheticSubject) -> Performance:
    """Make the performance of a motion by a subject, about the origin of the world, facing -y at the start."""
    world = global_rotations(joint_rotations(angles))
    align = hanging_from_rest(subject)
    if angles.stance is None:
        root, heading = _travel(angles, subject, world @ align)
        rotations = heading[:, None] @ (world @ align)
    else:
        rotations, root = _planted(angles, subject, world, align)
    return assemble(angles.name, subject, angles.times, rotations, root)


def soles(subject: SyntheticSubject, rotations: Array, joints: Array) -> tuple[Array, Array]:
    """Find the lowest point of each foot (left, right).

    rotations: (T, 19, 3, 3) world_from_joint.
    joints: (T, 19, 3) m.
    Returns: heights (T, 2) m, and the motion of that point of the foot per frame (T, 2, 3) m.
    """
    low, motion = [], []
    for j in (15, 18):
        rest = subject.vertices[subject.main_joint == j] - subject.joints[j]
        if len(rest) == 0:
            rest = np.array([[0.0, -0.1, -0.08], [0.0, 0.05, -0.08]])
        rest = rest[rest[:, 2] < rest[:, 2].min() + 0.03]
        p = joints[:, None, j] + np.einsum("tab,vb->tva", rotations[:, j], rest)
        lowest = p[..., 2].argmin(1)
        low.append(p[np.arange(len(p)), lowest, 2])
        step = np.gradient(p, axis=0) if len(p) > 1 else np.zeros_like(p)
        motion.append(step[np.arange(len(p)), lowest])
    return np.stack(low, 1), np.stack(motion, 1)


def _soft_minimum(values: Array, width: float) -> Array:
    """Compute a smooth minimum over the last axis (below the true one by at most width * ln n)."""
    lowest = values.min(-1, keepdims=True)
    return lowest[..., 0] - width * np.log(np.exp(-(values - lowest) / width).sum(-1))


def _travel(angles: Angles, subject: SyntheticSubject, rotations: Array) -> tuple[Array, Array]:
    """Compute the path of a body whose feet push it along a circle.

    angles: angles of the motion.
    subject: the person.
    rotations: (T, 19, 3, 3) rotations of the joints, facing -y.
    Returns: root path (T, 3) m, and heading rotations (T, 3, 3) by which the rotations are to be turned.
    """
    times = angles.times
    dt = np.gradient(times) if len(times) > 1 else np.ones(1)
    joints = subject.place_joints(rotations, np.zeros((len(times), 3)))
    low, motion = soles(subject, rotations, joints)
    scale = subject.leg_length
    height = -_soft_minimum(low, 0.006) + angles.get("up") * scale
    rate = (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else 25.0
    # the body goes as fast forward as the sole that carries it goes backward under the pelvis
    backward = motion[..., 1] / dt[:, None]
    aside = -motion[..., 0] / dt[:, None]
    # (a foot that swings forward close above the ground does not carry)
    carries = np.exp(-(low - low.min(1, keepdims=True)) / 0.01) / (1 + np.exp(-backward / 0.1)) + 1e-6
    speed = (backward * carries).sum(1) / carries.sum(1)
    # and sways over it from side to side, without drifting away
    sway = gaussian_filter1d((aside * carries).sum(1) / carries.sum(1), 0.06 * rate, mode="nearest")
    sway = np.concatenate([[0.0], np.cumsum((sway[1:] + sway[:-1]) / 2 * np.diff(times))])
    sway -= gaussian_filter1d(sway, 0.6 * rate, mode="nearest")
    flight = angles.get("up") > 1e-4
    if flight.any():
        speed = np.where(flight, np.median(speed[~flight]) if (~flight).any() else 0.0, speed)
    speed = np.maximum(gaussian_filter1d(speed, 0.08 * rate, mode="nearest"), 0.0)
    way = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(times))])
    yaw = way / angles.turn_radius
    direction = np.stack([np.sin(yaw), -np.cos(yaw)], 1)  # facing -y, turning left
    step = np.diff(way)[:, None] * (direction[1:] + direction[:-1]) / 2
    root = np.zeros((len(times), 3))
    root[1:, :2] = np.cumsum(step, 0)
    # about the circle's centre; a straight path about its middle
    if np.isfinite(angles.turn_radius):
        root[:, 0] -= angles.turn_radius
    else:
        root[:, :2] -= (root[0, :2] + root[-1, :2]) / 2
    sideways = np.stack([np.cos(yaw), np.sin(yaw)], 1)
    root[:, :2] += (angles.get("forward")[:, None] * direction + angles.get("left")[:, None] * sideways) * scale
    root[:, :2] += sway[:, None] * sideways
    root[:, 2] = gaussian_filter1d(height, 0.02 * rate, mode="nearest")
    return root, turn(2, np.degrees(yaw))


def _planted(angles: Angles, subject: SyntheticSubject, world: Array, align: Array) -> tuple[Array, Array]:
    """Compute a motion with the feet at their stance and the legs by inverse kinematics.

    angles: angles of the motion.
    subject: the person.
    world: (T, 19, 3, 3) rotations of the joints relative to the hanging pose.
    align: (19, 3, 3) rotations from the rest to the hanging pose.
    Returns: rotations (T, 19, 3, 3) world_from_joint, and root (T, 3) m.
    """
    stance, scale, g = angles.stance or Stance(), subject.leg_length, angles.get
    joints = subject.joints
    rotations = world @ align
    feet = subject.vertices[np.isin(subject.main_joint, (15, 18))]
    sole = joints[[15, 18], 2].mean() - (feet[:, 2].min() if len(feet) else joints[[15, 18], 2].mean() - 0.08)
    # the ankle of a lifted heel moves on a circle about the ball of the foot
    ball = 0.30 * scale * 0.5
    ankles, pitch = [], []
    for side, sign, forward in (("left", 1.0, stance.left_forward), ("right", -1.0, stance.right_forward)):
        lift = g(f"{side}_heel") * scale
        p = np.arcsin(np.clip(lift / (2 * ball), -0.9, 0.9))
        pitch.append(p)
        x = sign * stance.half_width * scale
        y = -forward * scale - ball * (1 - np.cos(p))
        ankles.append(np.stack([np.full_like(p, x), y, sole + 2 * ball * np.sin(p) * 0.9], 1))
    hips = rotations[:, :1] @ joints[[13, 16], :, None]
    hips = hips[..., 0]
    lengths = [
        (np.linalg.norm(joints[a + 1] - joints[a]), np.linalg.norm(joints[a + 2] - joints[a + 1])) for a in (13, 16)
    ]
    root = np.zeros((len(angles.times), 3))
    root[:, 0] = g("left") * scale
    root[:, 1] = -g("forward") * scale
    # as high as a nearly straight leg allows, lowered by `up`; smooth, because either leg may be the shorter
    # one
    reach = []
    for k in range(2):
        across = ankles[k][:, :2] - root[:, :2] - hips[:, k, :2]
        longest = 0.992 * sum(lengths[k])
        reach.append(ankles[k][:, 2] + np.sqrt(np.maximum(longest**2 - (across**2).sum(1), 0.01)) - hips[:, k, 2])
    root[:, 2] = _soft_minimum(np.stack(reach, 1), 0.005) + np.minimum(g("up"), 0.0) * scale
    for k, (j, sign) in enumerate(((13, 1.0), (16, -1.0))):
        yaw = sign * stance.toes_out
        foot = turn(2, np.full(len(root), yaw)) @ turn(0, np.degrees(pitch[k]))
        to = ankles[k] - (root + hips[:, k])
        thigh, shank = _leg(to, float(lengths[k][0]), float(lengths[k][1]), forward=foot @ np.array([0.0, -1.0, 0.0]))
        rotations[:, j] = thigh @ align[j]
        rotations[:, j + 1] = shank @ align[j + 1]
        rotations[:, j + 2] = foot @ align[j + 2]
    return rotations, root


def _leg(to_ankle: Array, thigh: float, shank: float, forward: Array) -> tuple[Array, Array]:
    """Compute the rotations of thigh and shank from hanging, by the two-bone triangle.

    to_ankle: (T, 3) m from the hip; a longer way than the leg is shortened.
    thigh, shank: lengths, m.
    forward: (T, 3) direction in which the knee bends.
    Returns: thigh and shank, each (T, 3, 3).
    """
    d = np.linalg.norm(to_ankle, axis=1)
    d = np.clip(d, abs(thigh - shank) * 1.05 + 0.02, (thigh + shank) * 0.99999)
    axis = unit(to_ankle)
    ahead = unit(forward - (forward * axis).sum(1, keepdims=True) * axis)
    at_hip = np.arccos(np.clip((thigh**2 + d**2 - shank**2) / (2 * thigh * d), -1, 1))
    knee = thigh * (np.cos(at_hip)[:, None] * axis + np.sin(at_hip)[:, None] * ahead)
    down_thigh = knee / thigh
    down_shank = (d[:, None] * axis - knee) / shank
    left = unit(np.cross(-axis, ahead))
    frames = [np.stack([left, np.cross(left, down), -down], 2) for down in (down_thigh, down_shank)]
    return frames[0].astype(np.float64), frames[1].astype(np.float64)


def moved(p: Performance, yaw: float = 0.0, shift: tuple[float, float] = (0.0, 0.0)) -> Performance:
    """Turn a performance about the world's z axis by yaw (rad), then shift it on the floor (m)."""
    r = so3_exp([0.0, 0.0, yaw])
    offset = np.array([shift[0], shift[1], 0.0])
    return Performance(p.name, p.times, r @ p.rotations, p.root @ r.T + offset, p.joints @ r.T + offset)


def heading(rotation: Array) -> float:
    """Compute the direction that the pelvis faces, as a turn about z from -y (rad), from its world rotation (3, 3)."""
    facing = rotation @ np.array([0.0, -1.0, 0.0])
    return float(np.arctan2(facing[0], -facing[1]))


def chain(name: str, parts: list[Performance], subject: SyntheticSubject, blend: float = 0.5) -> Performance:
    """Join performances one after the other, cross-faded over `blend` seconds.

    name: name of the result.
    parts: the performances, of one subject.
    Returns: one performance. Each part starts where the one before ends, facing the same way; the ground contact is
        restored in the blends.
    """
    out = parts[0]
    rate = out.frame_rate
    n = max(2, round(blend * rate))
    for nxt in parts[1:]:
        k = min(n, len(out) - 1, len(nxt) - 1)
        turn_by = heading(out.rotations[-k, 0]) - heading(nxt.rotations[0, 0])
        nxt = moved(nxt, turn_by)
        nxt = moved(nxt, 0.0, tuple((out.root[-k] - nxt.root[0])[:2]))
        s = np.linspace(0, 1, k + 2)[1:-1]
        s = s * s * s * (10 - 15 * s + 6 * s * s)  # minimum jerk
        a, b = out.rotations[-k:], nxt.rotations[:k]
        mixed = so3_exp(s[:, None, None] * so3_log(b @ np.swapaxes(a, -1, -2))) @ a
        root = (1 - s[:, None]) * out.root[-k:] + s[:, None] * nxt.root[:k]
        rotations = np.concatenate([out.rotations[:-k], mixed, nxt.rotations[k:]])
        roots = np.concatenate([out.root[:-k], root, nxt.root[k:]])
        times = out.times[0] + np.arange(len(roots)) / rate
        out = assemble(name, subject, times, rotations, roots)
        # a blend of two standing poses may stand above or below the ground: put it back, fading at its ends
        low = _soft_minimum(soles(subject, out.rotations, out.joints)[0], 0.006)
        at = np.arange(len(out))
        first = len(out) - len(nxt)
        window = np.clip(1 - np.abs(at - (first + (k - 1) / 2)) / (k / 2 + 0.3 * rate), 0, 1)
        window = np.minimum(1.0, 2 * window)
        roots = out.root.copy()
        roots[:, 2] -= window * gaussian_filter1d(low, 0.04 * rate, mode="nearest")
        out = assemble(name, subject, times, out.rotations, roots)
    return out


def centred(p: Performance) -> Performance:
    """Move a performance so that the middle of its root's range is at the world's origin."""
    middle = (p.root[:, :2].min(0) + p.root[:, :2].max(0)) / 2
    return moved(p, 0.0, (-float(middle[0]), -float(middle[1])))
