"""Use detected body ends in the search: particles posed on them by inverse kinematics, and a cost with their distances.

The set itself stores which members were posed on a detection (a role, inherited by selection), so the share of such
proposals follows their survival without hidden state. Source: Alcoverro 2014, section 2.5.2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body, Landmarks
from hypose.evidence.body_parts import UNNAMED, assign_ends
from hypose.evidence.frame import Detections, Keypoints
from hypose.evidence.keypoints import triangulate_keypoints
from hypose.geometry import Array, nearest_branch, so3_exp, so3_log
from hypose.inference.annealing import Energy
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.kernels import reflect
from hypose.inference.layer import Kernel
from hypose.tracking.frame_evidence import PreparedFrame

END_NAMES = ("left_hand", "right_hand", "head", "left_wrist", "right_wrist", "left_ankle", "right_ankle")
"""Names of the body ends, in the order of `Detections.part`. Unnamed detections can only become one of the first
three."""
LIMITS = np.array([0.35, 0.35, 0.25])
"""m: largest distance of an unnamed detection from the end of the predicted pose (hands, head; Alcoverro 2014, section
2.5.1)."""
_KEYPOINT_OF = {"left_wrist": 3, "right_wrist": 4, "left_ankle": 5, "right_ankle": 6}


def ends_of(body: Body) -> Landmarks:
    """Locate the body ends: hands and head (middle of their skin), wrists and ankles (the joints).

    Hands are put at three quarters of the way to the skin's middle, because a visual hull keeps little of the
    fingers:
    detected hands lay 10 to 35 mm nearer to the wrist.
    """
    s, mesh = body.skeleton, body.fine
    rest, joint, offset = s.rest_joints, [], []
    for name in END_NAMES:
        j = s.joint(name.replace("hand", "wrist"))
        part = mesh.vertices[mesh.main_joint == j]
        skin = name.endswith("hand") or name == "head"
        joint.append(j)
        middle = part.mean(0) - rest[j] if skin and len(part) else np.zeros(3)
        offset.append(0.75 * middle if name.endswith("hand") else middle)
    return Landmarks(END_NAMES, np.array(joint), np.array(offset))


def found_ends(body: Body, ends: Landmarks, frame: PreparedFrame) -> dict[int, Array]:
    """Find the body ends that are detected in a frame.

    `Frame.detections` are used where there are any: named ones directly, unnamed ones assigned to hands and head by
    eq.
    2.19 with the predicted pose. Otherwise wrists and ankles are triangulated from key points in two or more views.
    Returns: dictionary from the index of the end in END_NAMES to its position (3,), m, world; empty where nothing is
        detected.
    """
    found: dict[int, Array] = {}
    for detections in frame.frame.of(Detections):
        unnamed = detections.part == UNNAMED
        for k in np.flatnonzero(~unnamed):
            found[int(detections.part[k])] = detections.points[k]
        # ends with named detections are not assigned again
        free = [i for i in range(len(LIMITS)) if i not in found]
        points = detections.points[unnamed]
        now = ends.positions(body, frame.prediction[None])[0]
        for point, i in zip(points, assign_ends(points, now[free], LIMITS[free]), strict=True):
            if i != UNNAMED:
                found[free[i]] = point
        return found
    for seen in frame.frame.of(Keypoints):
        points, _, _ = triangulate_keypoints([seen])
        for name, part in _KEYPOINT_OF.items():
            if name in seen.names:
                point = points[0, seen.names.index(name)]
                if np.isfinite(point).all():
                    found[part] = point
    return found


def pose_limb(body: Body, ends: Landmarks, end: int, poses: Array, targets: Array, swivel: Array) -> Array:
    """Set the ball and the hinge of a limb in poses (N, D) so that its end lies at the targets, as near as length and
    limits allow.

    ends: places of the ends on the body; end: index in END_NAMES of a hand, wrist or ankle. It is fixed to the hinge's
        segment (wrists do not move; an ankle's own freedom does not move its centre).
    targets: (N, 3) m.
    swivel: (N,) rotation about the line from the ball to the target, rad, which the end's place does not determine.
    Returns: (N, D) poses.
    The hinge is set by the distance from ball to target (law of cosines; of two angles the one inside the limits and
    nearer to the current one). The ball then turns by the smallest rotation that points the end at the target, and by
    the swivel.
    """
    side, part = END_NAMES[end].split("_")
    upper, lower = (f"{side}_{n}" for n in (("hip", "knee") if part == "ankle" else ("shoulder", "elbow")))
    s, rest = body.skeleton, body.skeleton.rest_joints
    j, k, hinge = s.joint(upper), s.joint(lower), int(s.dofs_of(lower)[0])
    rotations, centres = s.forward(poses)
    to = np.einsum("nba,nb->na", rotations[:, s.parents[j]], targets - centres[:, j])
    distance = np.linalg.norm(to, axis=1)
    # at rest: from the ball to the hinge, and from there to the end
    a, e, h = s.axes[hinge], rest[k] - rest[j], rest[ends.joint[end]] + ends.offset[end] - rest[k]
    along = (a @ h) * a
    across, turned = h - along, np.cross(a, h)
    # |e + exp(theta a) h|^2 = |e|^2 + |h|^2 + 2 e.along + 2 (e.across cos theta + e.turned sin theta)
    p, q = float(e @ across), float(e @ turned)
    wanted = 0.5 * (distance**2 - e @ e - h @ h) - e @ along
    middle, opening = np.arctan2(q, p), np.arccos(np.clip(wanted / max(np.hypot(p, q), 1e-12), -1.0, 1.0))
    current = poses[:, hinge]
    best, least = current, np.full(len(poses), np.inf)
    for candidate in (middle + opening, middle - opening):
        angle = np.mod(candidate + np.pi, 2 * np.pi) - np.pi
        clipped = np.clip(angle, s.lower[hinge], s.upper[hinge])
        cost = 10.0 * np.abs(angle - clipped) + np.abs(clipped - current)
        best, least = np.where(cost < least, clipped, best), np.minimum(cost, least)
    tip = e + along + np.cos(best)[:, None] * across + np.sin(best)[:, None] * turned
    ball = s.dofs_of(upper)
    before = so3_exp(poses[:, ball])
    pointing = np.einsum("nab,nb->na", before, tip)
    axis = np.cross(pointing, to)
    sine = np.linalg.norm(axis, axis=1)
    smallest = axis * (np.arctan2(sine, (pointing * to).sum(1)) / np.maximum(sine, 1e-12))[:, None]
    line = to / np.maximum(distance, 1e-9)[:, None]
    turn = so3_exp(swivel[:, None] * line) @ so3_exp(smallest)
    out = poses.copy()
    out[:, hinge] = best
    out[:, ball] = nearest_branch(so3_log(turn @ before), poses[:, ball])
    return np.asarray(reflect(out, s.lower, s.upper))


@dataclass(frozen=True)
class DetectorDriven:
    """Search kernel that poses a part of the hypotheses so that a limb reaches a detected body end; the others
    diffuse by the base kernel.

    base: Gaussian kernel of the layer; moves all members first.
    end: indices in END_NAMES of the ends that can drive the layer; the first detected one is used.
    sigma: (D,) usual steps of the coordinates that the layer may move, for the head.
    limb: the posed part, which names the roles.
    noise: sd of a detection per axis, m.
    swivel, far_swivel: sd of the rotation about the line to the end, rad; far_swivel for a third of the members.
    step: share of the members that change their kind per layer; least: smallest share of either kind. Limbs are posed
        by analytic inverse kinematics. For the head, members take the least step, in units of sigma, that brings it to
        the detection (the gain of a Kalman update). Kinds: half of the members are posed at first; later, where more
        than half of the survivors are of that kind, its share grows by `step`, otherwise it shrinks. Without a
        detection all members only diffuse and keep their kinds.
    """

    body: Body
    ends: Landmarks
    base: Kernel
    end: tuple[int, ...]
    sigma: Array
    limb: str
    noise: float = 0.03
    swivel: float = 0.15
    far_swivel: float = 0.8
    step: float = 0.05
    least: float = 0.25

    def __call__(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """Return the moved set: a part posed on the detection, the rest diffused; the roles store which is which."""
        moved = self.base(h, frame, rng)
        found = found_ends(self.body, self.ends, frame)
        end = next((i for i in self.end if i in found), None)
        if end is None:
            return moved
        driven = self._kinds(h, rng)
        rows = np.flatnonzero(driven)
        values = moved.values.copy()
        targets = found[end] + self.noise * rng.standard_normal((h.count, 3))
        # a lost arm's elbow may lie anywhere on its circle
        far = np.arange(h.count) % 3 == 0
        swivel = np.where(far, self.far_swivel, self.swivel) * rng.standard_normal(h.count)
        if END_NAMES[end] == "head":
            values[rows] = self._reach(moved.values[rows], targets[rows], end)
        else:
            values[rows] = pose_limb(self.body, self.ends, end, values[rows], targets[rows], swivel[rows])
        moved = replace(moved, values=values).marked(self.sorted, np.ones(h.count, bool))
        return moved.marked(self.posed, driven)

    @property
    def posed(self) -> str:
        """Name of the role that members of the set get which are posed on the detection."""
        return f"{self.limb} posed"

    @property
    def sorted(self) -> str:
        """Name of the role that marks members whose kind (posed or diffused) is decided; all members have it after
        the first detection.
        """
        return f"{self.limb} sorted"

    def _kinds(self, h: Hypotheses, rng: np.random.Generator) -> NDArray[np.bool_]:
        """Choose the members (N,) that are posed on the detection in this layer."""
        n = h.count
        order = rng.permutation(n)
        driven = np.zeros(n, dtype=bool)
        if not h.has(self.sorted).all():
            driven[order[: n // 2]] = True
            return driven
        driven = h.has(self.posed)
        share = driven.mean()
        wanted = round(
            n * float(np.clip(share + (self.step if share > 0.5 else -self.step), self.least, 1 - self.least))
        )
        excess = int(driven.sum()) - wanted
        change = order[driven[order] == (excess > 0)][: abs(excess)]
        driven[change] = excess < 0
        return driven

    def _reach(self, poses: Array, targets: Array, end: int) -> Array:
        """Move poses (N, D) by the least step, in units of sigma, that brings an end to the targets (N, 3), m.

        end: index in END_NAMES.
        Source: the gain of a Kalman update, linearised at the mean pose.
        """
        s = self.body.skeleton
        mean = poses.mean(0)
        at = self.ends.positions(self.body, mean[None])[0, end]
        jacobian = s.jacobian(mean, int(self.ends.joint[end]), at[None])[0]
        spread = self.sigma**2
        gain = np.linalg.solve(
            np.einsum("ad,d,bd->ab", jacobian, spread, jacobian) + self.noise**2 * np.eye(3), jacobian * spread
        )
        short = targets - self.ends.positions(self.body, poses)[:, end]
        return np.asarray(reflect(poses + np.einsum("na,ad->nd", short, gain), s.lower, s.upper))


@dataclass(frozen=True)
class DetectionCost:
    """Energy C + kappa D of the refinement layer; 0 for all members where nothing is detected.

    energy: C, the silhouettes' cost.
    kappa: weight of D, 1 / m. D is the mean over the detected ends of the distance, m, to the nearest end of the model
        of the same group (hands and head; wrists; ankles). Detections that were assigned to no end are left out.
    Source: Alcoverro 2014, eqs. 2.20 and 2.21.
    """

    body: Body
    ends: Landmarks
    energy: Energy
    kappa: float

    def __call__(self, h: Hypotheses, frame: PreparedFrame, /) -> Array:
        """Compute the energies (N,) of the hypotheses."""
        found = found_ends(self.body, self.ends, frame)
        if not found:
            return np.zeros(h.count)
        positions = self.ends.positions(self.body, h.values)
        total = np.zeros(h.count)
        for i, point in found.items():
            group = next(g for g in _GROUPS if i in g)
            total += np.linalg.norm(positions[:, group] - point, axis=2).min(1)
        return np.asarray(self.energy(h, frame)) + self.kappa * total / len(found)


_GROUPS = ([0, 1, 2], [3, 4], [5, 6])
