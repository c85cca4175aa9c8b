"""Poses of people with fingers: gestures to be found, near misses and free movement.

Positions are in the body's frame (x = the person's left, y = backward, z = up, m); the person faces -y. Poses are
written for a right-handed person and mirrored for a left-handed one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hypose.geometry import Array
from hypose.synthetic.gesture_people import SIDES, ArmGoal, GesturePerson, HandShape, Puppet, rotation_about, unit

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
        self.other_shoulder = puppet.at(f"{self.other}_shoulder")
        self.middle = 0.5 * (self.lead_shoulder + self.other_shoulder)

    def way(self, x: float, y: float, z: float, noise: float = 0.0) -> Array:
        """Return the direction or offset (x, y, z), given in the chest's frame and mirrored for left-handed people, in
        the world.

        noise: sd of the random variation.
        """
        return self.chest @ (np.array([x, y, z]) * self.mirror) + self.rng.normal(0, noise, 3) * self.amount

    def elbow(self, x: float, y: float, z: float) -> Array:
        """Return the direction (x, y, z) of the elbow, mirrored for left-handed people."""
        return np.array([x, y, z]) * self.mirror

    def middle_finger(self, side: str) -> Array:
        """Return the vector (3,) m from the wrist to the tip of the middle finger at rest."""
        person = self.puppet.person
        return person.ends[SIDES.index(side), 2] - person.joint(f"{side}_wrist")

    def shape(self, side: str, kind: str, jitter: float = 6.0) -> HandShape:
        """Return a hand shape with random variation.

        side: "left" or "right".
        kind: one of HAND_SHAPES.
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
    nose = front[np.argmin(front[:, 1])].astype(np.float64)
    return nose + [0, 0.012, -0.04]


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


def _palm(do: Doer, side: str) -> float:
    """Return the length of the palm of a side, m."""
    return do.puppet.person.hand_axes(side)[2]


def _tee(do: Doer) -> Keyframe:
    """Pose "tee": a flat hand on the finger tips of the other, upright hand."""
    side = do.other
    up, length = unit(do.way(0, 0, 1, 0.08)), float(np.linalg.norm(do.middle_finger(side)))
    wrist = do.middle + do.way(0, -0.33, -0.12, 0.03) - up * length
    upright = ArmGoal(wrist, up, do.way(-1, 0.3, 0, 0.12), do.elbow(1, 0.2, -0.5), do.shape(side, "flat"))
    # short arms do not reach the middle, so that the flat hand is placed at the fingers of the upright one
    do.puppet.reach(side, upright)
    tip = do.puppet.finger_end(side, 2)
    along, palm = unit(do.way(1, -0.1, 0, 0.08)), unit(do.way(0, 0, -1, 0.08))
    wrist = tip - along * _palm(do, do.lead) * 1.05 - palm * 0.015
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
    mouth = do.puppet.carried("head", lips(do.puppet.person))
    f, n = unit(do.way(0.12, -0.12, 1, 0.08)), do.way(1, 0.25, 0, 0.12)
    shape = do.shape(do.lead, "point")
    wrist = mouth - f * (_palm(do, do.lead) + 0.05) + do.way(-0.012, -0.025, 0, 0.006)
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
        u, v, w = b - a, d - c, a - c
        uu, uv, vv, uw, vw = u @ u, u @ v, v @ v, u @ w, v @ w
        t = float(np.clip((uv * vw - vv * uw) / max(uu * vv - uv * uv, 1e-9), 0, 1))
        s = float(np.clip((uu * vw - uv * uw) / max(uu * vv - uv * uv, 1e-9), 0, 1))
        return min((a + t * u, c + s * v), key=lambda p: p[1]) + chest @ np.array([0, -0.03, 0])
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
