"""People with fingers for the simulated depth sensor, of other shapes than the tracker's body, and how to pose them.

A person is posed by one global rotation per joint over 51 joints (the 19 of the body, a twist joint per forearm, 3 per
finger): arms by two-bone inverse kinematics, hands by flexion angles. The source of the bodies is in
hypose/assets/LICENSE-assets.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from hypose.body.skin_weights import vertex_normals
from hypose.geometry import Array, frame_of, so3_exp, unit
from hypose.synthetic.subjects import JointedPerson, people_arrays

SIDES = ("left", "right")
FINGERS = ("thumb", "index", "middle", "ring", "pinky")
# flexion (degrees) of the three joints of index, middle, ring and little finger
FLEXION: dict[str, tuple[tuple[float, float, float], ...]] = {
    "flat": ((3, 3, 3),) * 4,
    "spread": ((0, 2, 2),) * 4,
    "relaxed": ((25, 30, 20),) * 4,
    "fist": ((75, 95, 60),) * 4,
    "point": ((3, 5, 3), *((75, 95, 60),) * 3),
    "two": (*((3, 5, 3),) * 2, *((75, 95, 60),) * 2),
    "three": (*((3, 5, 3),) * 3, (75, 95, 60)),
    "claw": ((20, 60, 45),) * 4,
    "grip": ((45, 60, 35),) * 4,
    "ok": ((45, 55, 35), (20, 20, 12), (10, 10, 8), (5, 5, 5)),
}
# opposition and the two flexions of the thumb (degrees) where it touches nothing
_THUMB: dict[str, tuple[float, float, float]] = {
    "flat": (0, 0, 0),
    "spread": (-10, 0, 0),
    "relaxed": (15, 15, 15),
    "claw": (20, 20, 30),
    "grip": (30, 20, 25),
}
_CLOTH_M = 0.008


def rotation_about(axis: ArrayLike, angle: float) -> Array:
    """Compute the rotation (3, 3) about an axis (3,) by an angle in rad."""
    return so3_exp(angle * unit(axis))


def _align(a0: ArrayLike, b0: ArrayLike, a1: ArrayLike, b1: ArrayLike) -> Array:
    """Compute the rotation that takes direction a0 to a1, and b0 into the half plane of a1 and b1."""
    return frame_of(a1, b1) @ frame_of(a0, b0).T


@dataclass(frozen=True)
class HandShape:
    """Shape of a hand.

    flexion: (4, 3) rad, joints of index to little finger.
    spread: angle between neighbouring fingers, rad.
    thumb: (3, 3, 3) rotations of the thumb's joints relative to the hand.
    """

    flexion: Array
    spread: float
    thumb: Array

    def towards(self, other: HandShape, t: float) -> HandShape:
        """Interpolate between this hand shape and another one.

        t: share of the way, 0 (this shape) to 1 (the other).
        """
        u, _, v = np.linalg.svd((1 - t) * self.thumb + t * other.thumb)
        return HandShape((1 - t) * self.flexion + t * other.flexion, (1 - t) * self.spread + t * other.spread, u @ v)


@dataclass(frozen=True)
class ArmGoal:
    """Goal of an arm.

    wrist: (3,) m, position of the wrist.
    fingers, palm, elbow: (3,) directions in which the fingers point, the palm faces and the elbow lies.
    hand: shape of the hand.
    """

    wrist: Array
    fingers: Array
    palm: Array
    elbow: Array
    hand: HandShape


@dataclass(frozen=True)
class GesturePerson(JointedPerson):
    """Body of a person with fingers, V vertices and 51 joints.

    joint_names: names of the joints.
    ends: (2, 5, 3) m, finger tips of the left and right hand.
    thumbs: (2, 2, 8) pose of the left and right thumb that touches the index finger ("ok") or lies on the folded middle
        finger ("fist"): rotation vector of its root and two flexions, rad, and logarithms of the factors of the index
        finger's three flexions (0 for "fist"). Fitted by scripts/bake_gesture_people.py.
    """

    joint_names: tuple[str, ...]
    ends: Array
    thumbs: Array

    def joint(self, name: str) -> Array:
        """Return the position (3,) m of a joint at rest."""
        return self.joints[self.joint_names.index(name)]

    @property
    def ground(self) -> float:
        """Height of the soles in the body's frame (z), m."""
        return float(self.vertices[:, 2].min())

    def hand_axes(self, side: str) -> tuple[Array, Array, float]:
        """Return for a hand at rest the direction of the fingers (3,), the direction that the palm faces (3,), and the
        length of the palm (m).
        """
        wrist, middle = self.joint(f"{side}_wrist"), self.joint(f"{side}_middle_1")
        along = unit(middle - wrist)
        across = self.joint(f"{side}_index_1") - self.joint(f"{side}_pinky_1")
        palm = np.cross(across, along) if side == "right" else np.cross(along, across)
        return along, unit(palm - along * (along @ palm)), float(np.linalg.norm(middle - wrist))

    def shape(self, side: str, kind: str, rng: np.random.Generator | None = None, jitter_deg: float = 0.0) -> HandShape:
        """Return a named hand shape.

        side: "left" or "right".
        kind: name of the shape, a key of FLEXION.
        rng, jitter_deg: vary every joint by jitter_deg (sd), less where fingers touch.
        """
        touches = kind not in _THUMB
        noise = (
            np.zeros((5, 3)) if rng is None else rng.normal(0, min(jitter_deg, 2.5) if touches else jitter_deg, (5, 3))
        )
        flexion = np.array(FLEXION[kind], dtype=np.float64)
        spread = np.deg2rad(12 if kind == "spread" else 0)
        if not touches:
            along, palm, _ = self.hand_axes(side)
            o, a, b = np.deg2rad(np.array(_THUMB[kind]) + noise[4])  # opposition and two flexions
            axis = np.cross(unit(self.joint(f"{side}_thumb_2") - self.joint(f"{side}_thumb_1")), palm)
            first = rotation_about(axis, o * 0.6) @ rotation_about(along, -o * 0.7 * (1 if side == "right" else -1))
            thumb = np.stack([first, first @ rotation_about(axis, a), first @ rotation_about(axis, a + b)])
        else:
            x = self.thumbs[SIDES.index(side), 0 if kind == "ok" else 1]
            if kind == "ok":
                flexion[0] *= np.exp(x[5:8])
            thumb = thumb_of(self, side, x if rng is None else np.r_[x[:3] + rng.normal(0, 0.03, 3), x[3:]])
        return HandShape(np.deg2rad(flexion + noise[:4] * [1, 0.7, 0.5]), spread, thumb)


@cache
def load_people() -> tuple[GesturePerson, ...]:
    """Load the people, dressed: clothes stand off by up to 1.5 _CLOTH_M (another share for each), but not on head
    and hands.
    """
    data, people = people_arrays("gesture_people.npz")
    names, out = tuple(str(n) for n in data["joint_names"]), []
    bare = [i for i, n in enumerate(names) if n == "head" or n.endswith(("_wrist", "_1", "_2", "_3"))]
    for k, fields in enumerate(people):
        fingers = {"ends": data["finger_ends"][k].astype(np.float64), "thumbs": data["thumbs"][k]}
        naked = GesturePerson(*fields, joint_names=names, **fingers)
        dressed = np.clip(1 - 1.5 * naked.weights[:, bare].sum(1), 0, 1)
        thickness = _CLOTH_M * (0.4 + 1.1 * ((k * 7) % 18) / 17)
        cloth = (thickness * dressed)[:, None] * vertex_normals(naked.vertices, naked.faces)
        out.append(replace(naked, vertices=naked.vertices + cloth))
    return tuple(out)


class Puppet:
    """Person that is being posed: joints without a rotation of their own follow their parent."""

    def __init__(self, person: GesturePerson) -> None:
        self.person = person
        self._index = {n: i for i, n in enumerate(person.joint_names)}
        self._turned: dict[int, Array] = {0: np.eye(3)}
        self._placed: tuple[Array, Array] | None = None

    def set(self, name: str, rotation: Array) -> None:
        """Set the rotation (3, 3) of a joint in the world."""
        self._turned[self._index[name]] = rotation
        self._placed = None

    def place(self) -> tuple[Array, Array]:
        """Compute the rotations (51, 3, 3) and centres (51, 3), m, of all joints in the present pose."""
        if self._placed is not None:
            return self._placed
        r = np.empty((len(self.person.parents), 3, 3))
        for j, parent in enumerate(self.person.parents):
            r[j] = self._turned.get(j, r[parent])
        self._placed = r, self.person.place_joints(r, self.person.joints[0])
        return self._placed

    def at(self, name: str) -> Array:
        """Return the centre (3,) m of a joint."""
        return self.place()[1][self._index[name]]

    def rotation(self, name: str) -> Array:
        """Return the rotation (3, 3) of a joint."""
        return self.place()[0][self._index[name]]

    def carried(self, name: str, point: Array) -> Array:
        """Return the current position (3,) m of a point of the rest pose that moves with a joint."""
        r, c = self.place()
        j = self._index[name]
        return c[j] + r[j] @ (point - self.person.joints[j])

    def finger_end(self, side: str, finger: int) -> Array:
        """Return the tip (3,) m of finger 0 (thumb) to 4."""
        return self.carried(f"{side}_{FINGERS[finger]}_3", self.person.ends[SIDES.index(side), finger])

    def reach(self, side: str, goal: ArmGoal) -> None:
        """Move the wrist of a side ("left", "right") to its goal as far as the arm reaches, and shape the hand.

        The arm is solved by two-bone inverse kinematics; the twist between elbow and hand is spread over the forearm
        (15 and 55 %).
        """
        p = self.person
        shoulder = self.at(f"{side}_shoulder")
        a, b, c = (p.joint(f"{side}_{k}") for k in ("shoulder", "elbow", "wrist"))
        upper, fore = float(np.linalg.norm(b - a)), float(np.linalg.norm(c - b))
        to = goal.wrist - shoulder
        length = float(np.clip(np.linalg.norm(to), abs(upper - fore) + 0.03, upper + fore - 0.005))
        to = unit(to)
        cosine = (upper**2 + length**2 - fore**2) / (2 * upper * length)
        out = goal.elbow - to * (to @ goal.elbow)
        out = unit(out if np.linalg.norm(out) > 1e-3 else np.cross(to, [1, 0, 0]))
        elbow = shoulder + upper * (cosine * to + np.sqrt(max(0.0, 1 - cosine**2)) * out)
        wrist = shoulder + length * to
        d1, d2, e1, e2 = b - a, c - b, elbow - shoulder, wrist - elbow
        n0, n1 = np.cross(d1, d2), np.cross(e1, e2)
        r_upper, r_fore = _align(d1, n0, e1, n1), _align(d2, n0, e2, n1)
        along, palm, _ = p.hand_axes(side)
        r_hand = _align(along, palm, goal.fingers, goal.palm)
        axis = unit(d2)
        v = frame_of(axis, palm)
        q = v.T @ (r_fore.T @ r_hand) @ v
        twist = float(np.arctan2(q[2, 1] - q[1, 2], q[1, 1] + q[2, 2]))
        self.set(f"{side}_shoulder", r_upper)
        self.set(f"{side}_elbow", r_fore @ rotation_about(axis, 0.15 * twist))
        self.set(f"{side}_forearm_twist", r_fore @ rotation_about(axis, 0.55 * twist))
        self.set(f"{side}_wrist", r_hand)
        self.shape_hand(side, goal.hand, r_hand)

    def shape_hand(self, side: str, shape: HandShape, r_hand: Array) -> None:
        """Bend the fingers of one hand to a shape; r_hand (3, 3) is the rotation of the hand in the world."""
        along, palm, _ = self.person.hand_axes(side)
        axis = np.cross(along, palm)
        for k, finger in enumerate(FINGERS[1:]):
            apart = rotation_about(palm, (1.5 - k) * shape.spread * (-1 if side == "right" else 1))
            for q, bend in enumerate(np.cumsum(shape.flexion[k])):
                self.set(f"{side}_{finger}_{q + 1}", r_hand @ apart @ rotation_about(axis, bend))
        for q in range(3):
            self.set(f"{side}_thumb_{q + 1}", r_hand @ shape.thumb[q])

    def skin(self) -> Array:
        """Compute the vertices (V, 3) m by linear blend skinning."""
        return self.person.skin(self.place()[0], self.person.joints[0])


def thumb_of(person: GesturePerson, side: str, x: Array) -> Array:
    """Compute the rotations of the thumb's joints relative to the hand.

    person, side: the person, and "left" or "right" hand.
    x: rotation vector of the thumb's root (x[:3], rad) and two flexions (x[3:5], rad).
    Returns: (3, 3, 3).
    """
    base = person.joint(f"{side}_thumb_1")
    t = unit(person.joint(f"{side}_thumb_3") - base)
    axis = unit(np.cross(t, unit(person.joint(f"{side}_index_1") - person.joint(f"{side}_thumb_2"))))
    angle = float(np.linalg.norm(x[:3]))
    out = [rotation_about(x[:3], angle) if angle > 1e-6 else np.eye(3)]
    for flex in x[3:5]:
        out.append(out[-1] @ rotation_about(axis, float(flex)))
    return np.stack(out)


# ---- poses of gestures ---------------------------------------------------------------------------------------------
# Poses of people with fingers: gestures to be found, near misses and free movement.
#
# Positions are in the body's frame (x = the person's left, y = backward, z = up, m); the person faces -y. Poses are
# written for a right-handed person and mirrored for a left-handed one.


_SHOULDER = {"left": 1.0, "right": -1.0}


@dataclass(frozen=True)
class Keyframe:
    """Pose of a person.

    angles: (6,) rad: root yaw, trunk pitch, trunk roll, chest yaw, head pitch, head yaw.
    left, right: goals of both arms.
    """

    angles: Array
    left: ArmGoal
    right: ArmGoal

    def towards(self, other: Keyframe, t: float) -> Keyframe:
        """Interpolate between this pose and another one.

        t: share of the way, 0 (this pose) to 1 (the other).
        """
        return Keyframe(
            (1 - t) * self.angles + t * other.angles,
            _blend(self.left, other.left, t),
            _blend(self.right, other.right, t),
        )


def _blend(a: ArmGoal, b: ArmGoal, t: float) -> ArmGoal:
    """Interpolate two goals of an arm by a share t (0: a, 1: b)."""

    def mix(p: Array, q: Array) -> Array:
        v = (1 - t) * unit(p) + t * unit(q)
        return v if np.linalg.norm(v) > 1e-2 else p + 0.3 * q + [0.01, 0, 0]

    return ArmGoal(
        (1 - t) * a.wrist + t * b.wrist,
        mix(a.fingers, b.fingers),
        mix(a.palm, b.palm),
        mix(a.elbow, b.elbow),
        a.hand.towards(b.hand, t),
    )


def bend(puppet: Puppet, angles: Array) -> None:
    """Turn trunk and head of a person by angles (6,) as in `Keyframe`."""
    root = rotation_about([0, 0, 1], angles[0])
    spine = root @ rotation_about([1, 0, 0], angles[1]) @ rotation_about([0, 1, 0], angles[2])
    chest = spine @ rotation_about([0, 0, 1], angles[3])
    puppet.set("pelvis", root)
    puppet.set("spine", spine)
    puppet.set("chest", chest)
    puppet.set("neck", chest @ rotation_about([1, 0, 0], angles[4]) @ rotation_about([0, 0, 1], angles[5]))


def apply(puppet: Puppet, frame: Keyframe) -> None:
    """Pose the whole person.

    puppet: person that is posed; it is changed in place.
    frame: the pose.
    """
    bend(puppet, frame.angles)
    puppet.reach("left", frame.left)
    puppet.reach("right", frame.right)


class Doer:
    """Person who performs gestures: the leading hand, and the frame of the chest, in which directions of arms are
    given.
    """

    def __init__(self, puppet: Puppet, rng: np.random.Generator, leading: str, amount: float) -> None:
        self.puppet, self.rng, self.amount = puppet, rng, amount
        sd, mean = [0.06, 0.05, 0.04, 0.06, 0.1, 0.2], [0.0, 0.03, 0.0, 0.0, 0.05, 0.0]
        self.angles = rng.normal(mean, sd) * amount
        bend(puppet, self.angles)
        self.lead, self.other = leading, "left" if leading == "right" else "right"
        self.mirror = np.array([1.0 if leading == "right" else -1.0, 1, 1])
        self.chest = puppet.rotation("chest")
        self.lead_shoulder = puppet.at(f"{self.lead}_shoulder")
        self.middle = 0.5 * (self.lead_shoulder + puppet.at(f"{self.other}_shoulder"))

    def way(self, x: float, y: float, z: float, noise: float = 0.0) -> Array:
        """Return the direction or offset (x, y, z), given in the chest's frame and mirrored for left-handed people, in
        the world.

        noise: sd of the random variation.
        """
        return self.chest @ (np.array([x, y, z]) * self.mirror) + self.rng.normal(0, noise, 3) * self.amount

    def elbow(self, x: float, y: float, z: float) -> Array:
        """Return the direction (x, y, z) of the elbow, mirrored for left-handed people."""
        return np.array([x, y, z]) * self.mirror

    def shape(self, side: str, kind: str, jitter: float = 6.0) -> HandShape:
        """Return a hand shape with random variation.

        side: "left" or "right".
        kind: name of the shape, a key of FLEXION.
        jitter: sd of the variation of each finger joint, degrees.
        """
        return self.puppet.person.shape(side, kind, self.rng, jitter)

    def hanging(self, side: str) -> ArmGoal:
        """Return the goal of an arm that hangs at the side of the body."""
        x, rng = _SHOULDER[side], self.rng
        offset = [x * rng.uniform(0.05, 0.2), rng.uniform(-0.15, 0.05), -rng.uniform(0.45, 0.6)]
        return ArmGoal(
            self.puppet.at(f"{side}_shoulder") + offset,
            np.array([0.1 * x, -0.2, -1]),
            np.array([-x, 0.0, 0]),
            np.array([0.6 * x, 1, 0]),
            self.shape(side, "relaxed"),
        )

    def keyframe(self, lead: ArmGoal, other: ArmGoal | None = None) -> Keyframe:
        """Return the pose with the leading arm and the other one (None: it hangs)."""
        other = self.hanging(self.other) if other is None else other
        left, right = (other, lead) if self.lead == "right" else (lead, other)
        return Keyframe(self.angles, left, right)


def lips(person: GesturePerson) -> Array:
    """Return the middle of the lips (3,) m at rest: 4 cm below the tip of the nose."""
    head = person.joint("head")
    v = person.vertices
    front = v[(np.abs(v[:, 0]) < 0.01) & (v[:, 2] > head[2] - 0.08) & (v[:, 2] < head[2] + 0.2)]
    return front[np.argmin(front[:, 1])] + [0, 0.012, -0.04]


def gesture(
    puppet: Puppet, name: str, rng: np.random.Generator, leading: str = "right", amount: float = 1.0
) -> tuple[Keyframe, Array]:
    """Pose a person who shows a gesture.

    puppet: the person, which is posed.
    name: one of GESTURES.
    leading: side of the leading hand.
    amount: how much the pose varies (1 = as between people).
    Returns: the pose, and the annotated point (3,) m on the surface.
    """
    frame = _GESTURES[name](Doer(puppet, rng, leading, amount))
    apply(puppet, frame)
    return frame, annotated(puppet, name, leading)


def _tee(do: Doer) -> Keyframe:
    """Pose "tee": a flat hand on the finger tips of the other, upright hand."""
    side = do.other
    person, up = do.puppet.person, unit(do.way(0, 0, 1, 0.08))
    length = float(np.linalg.norm(person.ends[SIDES.index(side), 2] - person.joint(f"{side}_wrist")))
    wrist = do.middle + do.way(0, -0.33, -0.12, 0.03) - up * length
    upright = ArmGoal(wrist, up, do.way(-1, 0.3, 0, 0.12), do.elbow(1, 0.2, -0.5), do.shape(side, "flat"))
    # short arms do not reach the middle, so that the flat hand is placed at the fingers of the upright one
    do.puppet.reach(side, upright)
    tip = do.puppet.finger_end(side, 2)
    along, palm = unit(do.way(1, -0.1, 0, 0.08)), unit(do.way(0, 0, -1, 0.08))
    wrist = tip - along * person.hand_axes(do.lead)[2] * 1.05 - palm * 0.015
    flat = ArmGoal(wrist, along, palm, do.elbow(-1, 0.2, -0.6), do.shape(do.lead, "flat"))
    return do.keyframe(flat, upright)


def _cross(do: Doer) -> Keyframe:
    """Pose "cross": both forearms crossed in front of the chest."""
    centre = do.middle + do.way(0, -0.30, -0.08, 0.03)
    kind = str(do.rng.choice(["fist", "flat", "relaxed"]))
    angle = do.rng.normal(0.75, 0.08)
    arms = []
    for side, x, forward in ((do.lead, 1, -0.035), (do.other, -1, 0.035)):
        f = unit(do.way(x * np.sin(angle), -0.05, np.cos(angle), 0.05))
        wrist = centre + do.way(0, forward, 0) + f * 0.09
        arms.append(ArmGoal(wrist, f, do.way(0, 1, 0, 0.1), do.elbow(-x, 0, -0.8), do.shape(side, kind)))
    return do.keyframe(*arms)


def _pause(do: Doer) -> Keyframe:
    """Pose "pause": the leading palm held up to the camera."""
    wrist = do.lead_shoulder + do.way(-0.06, -0.36, 0.0, 0.05)
    kind = str(do.rng.choice(["flat", "spread"]))
    f, n = do.way(0, -0.1, 1, 0.1), do.way(0, -1, 0, 0.1)
    return do.keyframe(ArmGoal(wrist, f, n, do.elbow(-0.6, 0.3, -1), do.shape(do.lead, kind)))


def _silence(do: Doer) -> Keyframe:
    """Pose "silence": the index finger before the lips."""
    person = do.puppet.person
    mouth = do.puppet.carried("head", lips(person))
    f, n = unit(do.way(0.12, -0.12, 1, 0.08)), do.way(1, 0.25, 0, 0.12)
    shape = do.shape(do.lead, "point")
    wrist = mouth - f * (person.hand_axes(do.lead)[2] + 0.05) + do.way(-0.012, -0.025, 0, 0.006)
    goal = ArmGoal(wrist, f, n, do.elbow(-0.8, 0.2, -1), shape)
    do.puppet.reach(do.lead, goal)  # then shifted so that the finger's end segment lies before the lips
    finger = 0.5 * (do.puppet.finger_end(do.lead, 1) + do.puppet.at(f"{do.lead}_index_2"))
    wrist = wrist + (mouth + do.way(0, -0.012, 0) - finger)
    return do.keyframe(ArmGoal(wrist, f, n, goal.elbow, shape))


def _ok(do: Doer) -> Keyframe:
    """Pose "ok": thumb and index finger form a ring."""
    wrist = do.lead_shoulder + do.way(-0.06, -0.33, 0.02, 0.05)
    f, n = do.way(0, -0.1, 1, 0.1), do.way(0.1, -1, 0, 0.1)
    return do.keyframe(ArmGoal(wrist, f, n, do.elbow(-0.6, 0.3, -1), do.shape(do.lead, "ok")))


def _volume_up(do: Doer) -> Keyframe:
    """Pose "volume_up": a fist with the thumb up."""
    wrist = do.lead_shoulder + do.way(-0.02, -0.34, -0.1, 0.05)
    f, n = do.way(0.75, -0.65, 0.1, 0.1), do.way(0.6, 0.8, 0, 0.1)
    person, elbow, fist = do.puppet.person, do.elbow(-0.6, 0.3, -1), do.shape(do.lead, "fist", 4)
    do.puppet.reach(do.lead, ArmGoal(wrist, f, n, elbow, fist))
    # the thumb turned up as far as it goes
    thumb = unit(person.joint(f"{do.lead}_thumb_3") - person.joint(f"{do.lead}_thumb_2"))
    up = unit(do.puppet.rotation(f"{do.lead}_wrist").T @ do.way(0, 0, 1, 0.08))
    axis = np.cross(thumb, up)
    raised = rotation_about(axis, 0.8 * float(np.arcsin(min(1.0, np.linalg.norm(axis)))))
    shape = HandShape(fist.flexion, fist.spread, np.stack([raised] * 3))
    return do.keyframe(ArmGoal(wrist, f, n, elbow, shape))


_GESTURES = {
    "tee": _tee,
    "cross": _cross,
    "pause": _pause,
    "silence": _silence,
    "ok": _ok,
    "volume_up": _volume_up,
}
GESTURES = tuple(_GESTURES)
"""Gestures that detectors learn. volume_up is a thumb up: the thesis does not define it."""


def annotated(puppet: Puppet, name: str, leading: str) -> Array:
    """Return the point (3,) m on the surface at which a gesture is annotated.

    puppet: person who is posed in the gesture.
    name: one of GESTURES.
    leading: side of the leading hand.
    """
    lead, other = leading, "left" if leading == "right" else "right"
    chest = puppet.rotation("chest")
    if name == "tee":  # where the fingers of the upright hand meet the flat one
        return puppet.finger_end(other, 2) + chest @ np.array([0, -0.01, 0.01])
    if name == "cross":  # where the front forearm passes before the other
        a, b = puppet.at(f"{lead}_elbow"), puppet.at(f"{lead}_wrist")
        c, d = puppet.at(f"{other}_elbow"), puppet.at(f"{other}_wrist")
        t, s = np.clip(np.linalg.lstsq(np.stack([b - a, c - d], 1), c - a, rcond=None)[0], 0, 1)
        return min((a + t * (b - a), c + s * (d - c)), key=lambda p: p[1]) + chest @ np.array([0, -0.03, 0])
    if name == "silence":
        return puppet.carried("head", lips(puppet.person)) + chest @ np.array([0, -0.02, 0])
    if name == "ok":
        return 0.5 * (puppet.finger_end(lead, 0) + puppet.finger_end(lead, 1))
    wrist = puppet.at(f"{lead}_wrist")
    return wrist + 0.8 * (puppet.at(f"{lead}_middle_1") - wrist)


def movement(puppet: Puppet, rng: np.random.Generator) -> Keyframe:
    """Make a random pose of a person that is none of the gestures: arms hanging or anywhere in front, hands of any
    shape but "ok".

    puppet: the person, whose trunk is posed.
    rng: random numbers.

    A quarter of the raised hands are near misses (a fist, a pointing finger, ... held up to the camera).
    """
    do = Doer(puppet, rng, "right", 1.5)
    goals = {}
    for side, x in _SHOULDER.items():
        if rng.random() < 0.25:
            goals[side] = do.hanging(side)
            continue
        shoulder = puppet.at(f"{side}_shoulder")
        while True:
            way = unit(rng.normal(0, 1, 3) + [0, -1.2, 0])
            wrist = shoulder + do.chest @ (way * rng.uniform(0.2, 0.55) + [-0.08 * x, 0, 0])
            f, n = unit(unit(wrist - shoulder) + rng.normal(0, 0.6, 3) + [0, 0, 0.5]), rng.normal(0, 1, 3)
            kinds = ["flat", "spread", "relaxed", "fist", "point", "two", "claw"]
            if rng.random() < 0.25:
                f, n = unit([0, -0.1, 1] + rng.normal(0, 0.25, 3)), np.array([0, -1, 0]) + rng.normal(0, 0.4, 3)
                kinds = ["fist", "point", "two", "claw", "relaxed"]
            kind = str(rng.choice(kinds))
            if not (kind in ("flat", "spread") and f[2] > 0.8 and unit(n)[1] < -0.75):  # that would be "pause"
                break
        elbow = np.array([x * rng.uniform(0.1, 1), rng.uniform(-0.2, 0.6), -rng.uniform(0.2, 1)])
        goals[side] = ArmGoal(wrist, f, n, elbow, do.shape(side, kind, 10))
    return Keyframe(do.angles, goals["left"], goals["right"])
