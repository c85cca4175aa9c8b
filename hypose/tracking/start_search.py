"""Find a start from silhouettes alone: dozens of postures in all headings at the visual hull.

The few that fit the masks best are solved, followed through some frames, and weighed. One frame cannot tell a person
who sits from one who stands in front of a chair, nor front from back. Things that no body explains (a chair, a bag)
leave mask uncovered; a wrong pose puts body outside the masks. So uncovered mask costs less than body outside, and
several frames decide.

Simpler starts come from triangulated key points, from a known pose at the visual hull, or, after a loss, from the hull
near the last pose (`recover`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body, Shape, deform
from hypose.compute.scorer import silhouette_xor
from hypose.errors import EvidenceError, InputError
from hypose.evidence.hull import Hull
from hypose.evidence.people import occupied_space
from hypose.evidence.terms import PointTerm
from hypose.fitting.articulated import PoseFit, SolveSettings, fit_poses
from hypose.geometry import Array, procrustes, rotation_between, so3_exp, so3_log
from hypose.inference.resampling import distinct
from hypose.tracking.frame_evidence import PreparedFrame, evidence_energy
from hypose.tracking.left_right import strain, turn_pose, turned_around, with_joints_at
from hypose.tracking.refinement import SETTLING, anatomical_prior, refine

# ---- known poses and key points -------------------------------------------------------------------------------------


# direction of the upper arm in each known pose, for the left side (x = the subject's left, y backward, z up)
_ARM_DIRECTION = {
    "t": (1.0, 0.0, 0.0),
    "standing": (0.15, 0.0, -1.0),
    "hands-up": (0.3, 0.0, 1.0),
}
KNOWN_POSES = ("a", *_ARM_DIRECTION)
"""Poses that a person may be asked to take at the start; 'a' is the body's rest pose."""


def known_pose(body: Body, name: str) -> Array:
    """Build a known pose (D,) at the origin, facing -y: 'a', 't', 'standing' (arms hanging) or 'hands-up'; arms
    straight.

    Raises: InputError that lists the known poses where the name is unknown.
    """
    s = body.skeleton
    pose = np.zeros(s.dof)
    if name not in KNOWN_POSES:
        raise InputError(f"There is no known pose {name!r}; the known poses are {', '.join(KNOWN_POSES)}.")
    if name in _ARM_DIRECTION:
        joints = s.rest_joints
        for side, mirror in (("left", 1.0), ("right", -1.0)):
            shoulder, elbow, wrist = (s.joint(f"{side}_{n}") for n in ("shoulder", "elbow", "wrist"))
            upper, fore = joints[elbow] - joints[shoulder], joints[wrist] - joints[elbow]
            direction = np.array(_ARM_DIRECTION[name]) * (mirror, 1, 1)
            pose[s.dofs_of(f"{side}_shoulder")] = so3_log(rotation_between(upper, direction))
            straight = np.arccos(np.clip(upper @ fore / np.linalg.norm(upper) / np.linalg.norm(fore), -1, 1))
            pose[s.dofs_of(f"{side}_elbow")] = -straight
    return s.clamp(pose)


def start_from_keypoints(
    body: Body, points_world: Array, joint: NDArray[np.int64], offset: Array, *, weight: Array | None = None
) -> PoseFit:
    """Fit a pose to 3D points of one frame by bounded inverse kinematics.

    Several arm poses and headings are tried; the solution with the least cost is returned.
    points_world: (K, 3) m; NaN where missing.
    joint: (K,) joint of each point; offset: (K, 3) its position in the joint's frame, m.
    weight: (K,) weight of the points (default 1).
    Raises: EvidenceError where fewer than 6 points are known.
    """
    known = np.asarray(np.isfinite(points_world).all(1))
    if known.sum() < 6:
        raise EvidenceError(
            f"Only {int(known.sum())} of {len(points_world)} key points could be triangulated; at least 6 are "
            "needed to start: choose another start frame or check the calibration with `hypose check`."
        )
    term = PointTerm(points_world, np.ones(len(points_world)) if weight is None else weight, joint, offset, 0.03)
    starts = []
    for root in _root_guesses(body, points_world, joint, offset, known):
        for name in ("standing", "t"):
            starts.append(np.concatenate([root, known_pose(body, name)[6:]]))
    options = SolveSettings(iterations=40, coarse_iterations=20)
    fits = fit_poses(body, starts, [term], priors=(anatomical_prior(body.skeleton),), options=options)
    return min(fits, key=lambda fit: fit.cost)


def _root_guesses(
    body: Body, points: Array, joint: NDArray[np.int64], offset: Array, known: NDArray[np.bool_]
) -> list[Array]:
    """Estimate root poses (6,): a rigid fit of the trunk's points where there are enough, else four headings at the
    centroid.

    points: (K, 3) m; joint, offset: as for `start_from_keypoints`; known: (K,) points that are there.
    """
    s = body.skeleton
    rest = s.rest_joints[joint] + offset
    trunk_joints = [
        s.joint(n)
        for n in (
            "pelvis",
            "chest",
            "neck",
            "left_clavicle",
            "right_clavicle",
            "left_shoulder",
            "right_shoulder",
            "left_hip",
            "right_hip",
        )
    ]
    trunk = known & np.isin(joint, trunk_joints)
    centre = points[known].mean(0) - rest[known].mean(0)
    if trunk.sum() >= 3:
        # the trunk is nearly rigid: its points give position and heading at once
        motion, _ = procrustes(rest[trunk], points[trunk])
        return [np.concatenate([motion[:3, 3], so3_log(motion[:3, :3])])]
    return [np.concatenate([centre, [0, 0, yaw]]) for yaw in np.arange(4) * np.pi / 2]


_FIRST_ROUND, _SECOND_ROUND = 16, 4
"""numbers of poses that are solved in the first and in the second round of a search"""
RECOVERY_REACH = 1.3
"""m: how far from the last pose a lost person is searched for; further away it is another person."""


def recover(pose: Array, last: Array, frame: PreparedFrame, /) -> Array:
    """Find the pose (D,) of a lost person: the given pose, moved to the hull and turned, or a known pose, refined.

    last: (D,) last pose in which the person was seen. Only the space within RECOVERY_REACH of it is searched.
    Returns: the best pose; the given one where there is no person in reach, or the solution is further away, so that
        another person in view is not taken for the one who left.
    """
    body = frame.body
    try:
        hull = hull_of(frame, np.stack([last[:3] - RECOVERY_REACH, last[:3] + RECOVERY_REACH]))
    except EvidenceError:
        return pose
    bases = pose, known_pose(body, "standing"), known_pose(body, "a")
    turned = [turn_pose(base, heading) for base in bases for heading in np.arange(8) * np.pi / 4]
    candidates = np.stack([pose, *(_centred(body, q, hull) for q in turned)])
    order = np.argsort(evidence_energy(body, candidates, frame.evidence), kind="stable")[:_FIRST_ROUND]
    # solve the best briefly, and the best of these at length: a wrong heading may overlap better than the right one
    # until the limbs have moved
    moved = np.stack([f.pose for f in refine(body, candidates[order], frame, _BRIEF)])
    order = np.argsort(evidence_energy(body, moved, frame.evidence), kind="stable")[:_SECOND_ROUND]
    poses = np.stack([f.pose for f in refine(body, moved[order], frame, SETTLING)])
    found = poses[np.argmin(evidence_energy(body, poses, frame.evidence))]
    return found if np.linalg.norm(found[:3] - last[:3]) <= RECOVERY_REACH else pose


def _centred(body: Body, pose: Array, hull: Hull) -> Array:
    """Move a pose so that the mesh's centre lies at the hull's: a person who is lost may have no foot on the floor."""
    vertices, out = body.skin(pose), pose.copy()
    target, middle = (0.5 * (points.min(0) + points.max(0)) for points in (hull.points, vertices))
    out[:3] += 0.5 * (target - middle) + 0.5 * (hull.centroid - vertices.mean(0))
    return out


def hull_of(frame: PreparedFrame, bounds: Array | None = None) -> Hull:
    """Compute the visual hull of a frame, or the space behind depth maps, inside bounds (2, 3), m (default: the common
    view).

    Raises: EvidenceError, naming the frame, where nothing is left of it.
    """
    if not frame.silhouettes.seen:
        raise EvidenceError(f"Frame {frame.frame.index} has no usable silhouette to start from; choose another frame.")
    hull = occupied_space(frame.frame, bounds)
    if len(hull.points) == 0:
        raise EvidenceError(
            f"Frame {frame.frame.index}: the silhouettes of the views have no common volume; check the calibration and "
            "the masks, or start from key points."
        )
    return hull


def scaled_to_height(body: Body, height: float) -> Body:
    """Scale a body uniformly to a standing height, m.

    Raises: EvidenceError where the height is not that of a person (0.5 to 2.5 m).
    """
    if not 0.5 < height < 2.5:
        raise EvidenceError(
            f"A subject height of {height:.2f} m is not a person's; give --height in metres or check the "
            "calibration's unit."
        )
    return deform(body, Shape(scale=height / body.stature))


# ---- search in any pose ---------------------------------------------------------------------------------------------


BARE = 0.6
"""Weight of uncovered mask relative to the same area of body outside the masks. Chosen, like the penalty of unusual
statures and the softness of weights, on scenes (benchmark `starts`) of the seeds 700 to 702."""
_HEADINGS = 24
USUAL_M, _SPREAD = 1.70, 0.12
"""m, and relative sd: stature of people where it is unknown"""
_BINS = 0.04
"""difference of the logarithms of two statures tried"""
_TRIED, _PER_POSTURE, _KEPT, _SIZED, _TURNED = 48, 3, 10, 4, 4
"""Numbers of starts: solved, kept per posture and stature, kept in the end, tried in other sizes, and turned around."""
_SIZES = (0.88, 0.94, 1.06, 1.12)
_APART_M = 0.08
"""m, mean over the joints: nearer starts are the same"""
_HOPELESS, _FOLLOWED = 0.1, 6
"""Starts that cost this much more than the best, and those beyond this number, are not followed."""
_SOFT = 0.01
"""cost difference by which a start's weight falls to 1 / e"""
_FAR_M = 0.1
"""m from which a joint is elsewhere"""
_BRIEF = SolveSettings(iterations=8, coarse_iterations=8)


@dataclass(frozen=True)
class Start:
    """Start of a track: a body of some size, its pose (D,), and its cost (`mask_cost`, `strain` and a penalty of odd
    sizes).
    """

    body: Body
    pose: Array
    cost: float


def mask_cost(body: Body, poses: Array, frame: PreparedFrame) -> Array:
    """Compute how badly poses (N, D) fit the masks: body outside plus BARE times uncovered mask, as shares of the
    masks.

    Returns: (N,) means over the views; with depth cameras also the depth energy.
    """
    masks = frame.silhouettes.masks
    flat = np.ascontiguousarray(poses, dtype=np.float64)
    counts = silhouette_xor(flat, body.skeleton.tree, body.coarse.arrays, masks)
    use = masks.usable
    area, whole = masks.areas[use].astype(np.float64), masks.norm[use]
    bare = area - counts[:, use, 2]
    outside = counts[:, use, 0] - bare
    cost = ((outside + BARE * bare) / whole).mean(1)
    return cost + frame.depth.energy(body, flat) / use.sum()


def starts_in_frame(
    template: Body,
    frame: PreparedFrame,
    height: float | None = None,
    extent: float | None = None,
    names: Sequence[str] = KNOWN_POSES,
) -> list[Start]:
    """Find the starts that a frame allows, best first, all different from each other.

    frame: prepared for any body.
    height: height of the person, m; None: unknown.
    extent: height of the hull, m, where that of another frame is more reliable.
    names: known poses from which is searched; all of them: any posture is tried.
    Raises: EvidenceError where the views have no common hull, or its height is not that of a person.
    """
    hull = hull_of(frame)
    tall = extent or hull.height
    known = tuple(names) != KNOWN_POSES
    base = np.stack([known_pose(template, name) for name in names]) if known else postures(template)
    spans = np.array([np.ptp(template.skin(q)[:, 2]) for q in base])
    found: list[Start] = []
    for stature, own in _by_size(template, spans, tall, height):
        body = template if stature == template.stature else scaled_to_height(template, stature)
        places = np.concatenate([_placed(body, base[n], hull, _HEADINGS) for n in own])
        cost = mask_cost(body, places, frame) + _odd(stature, height)
        for first in range(0, len(places), _HEADINGS):
            for i in first + np.argsort(cost[first : first + _HEADINGS], kind="stable")[:_PER_POSTURE]:
                found.append(Start(body, places[i], float(cost[i])))
    if not found and frame.depth.seen:
        raise EvidenceError(
            f"Frame {frame.frame.index}: what the depth cameras see is {tall:.2f} m high and no person; check "
            "whether sunlight, dark clothes or the distance leave holes in the depth maps, or choose other frames."
        )
    if not found:
        raise EvidenceError(
            f"Frame {frame.frame.index}: the common volume of all views is {tall:.2f} m high and no person; check the "
            "calibration, and that each view has its own camera."
        )
    found.sort(key=lambda s: s.cost)
    kept = _different(_solved(found[:_TRIED], frame, height, _BRIEF), _KEPT)
    kept = _solved(kept, frame, height, SETTLING)
    if height is None:
        low = float(hull.points[:, 2].min())
        others = [o for s in _different(kept, _SIZED) for o in _sized(template, s, low)]
        kept = [*kept, *_solved(others, frame, height, SETTLING)]
    # a person facing the other way has nearly the same outline, but no posture in the list with these limbs
    kept = _different(kept, _KEPT)
    around = [replace(s, pose=turned_around(s.body, s.pose)) for s in kept[:_TURNED]]
    return _different([*kept, *_solved(around, frame, height, SETTLING)], _KEPT)


def _sized(template: Body, start: Start, floor: float) -> list[Start]:
    """Make smaller and larger copies of a start, scaled about the floor (m).

    Why: objects around a person, and raised arms, make the hull's height a poor measure.
    """
    out = []
    for factor in _SIZES:
        stature = start.body.stature * factor
        if 0.8 < stature < 2.3:
            pose = start.pose.copy()
            pose[2] = floor + factor * (pose[2] - floor)
            out.append(Start(scaled_to_height(template, stature), pose, np.inf))
    return out


def _solved(starts: Sequence[Start], frame: PreparedFrame, height: float | None, options: SolveSettings) -> list[Start]:
    """Solve the starts from their poses; those of one body in several threads.

    frame: prepared for any body; height: height of the person, m, None: unknown; options: options of the solves.
    """
    out: list[Start] = []
    for body in dict.fromkeys(s.body for s in starts):
        poses = np.stack([s.pose for s in starts if s.body is body])
        own = _own(frame, body, poses[0])
        poses = np.stack([f.pose for f in refine(body, poses, own, options)])
        costs = mask_cost(body, poses, own) + strain(body.skeleton, poses) + _odd(body.stature, height)
        out += [Start(body, q, float(c)) for q, c in zip(poses, costs, strict=True)]
    return out


@dataclass(frozen=True)
class Starts:
    """Alternative starts of one frame, best first.

    starts: K different starts.
    weights: (K,) weights that sum to 1.
    unsure: (2, J) probability that a joint is far from where the best start has it, from starts that face the other
        way, and from those that face the same way in another posture or size (sitting instead of standing).
    """

    starts: tuple[Start, ...]
    weights: Array
    unsure: Array

    @property
    def best(self) -> Start:
        """The best start."""
        return self.starts[0]


def weigh_starts(starts: Sequence[Start], frames: Sequence[PreparedFrame]) -> Starts:
    """Weigh the starts of one frame by following them through the frames after it."""
    some = [s for s in starts if s.cost < starts[0].cost + _HOPELESS][:_FOLLOWED]
    ways = [_followed(s, frames) for s in some]
    costs = np.array([(s.cost + c.sum()) / (1 + len(frames)) for s, (_, c) in zip(some, ways, strict=True)])
    return by_their_ways(
        some, [np.concatenate([s.pose[None], w]) for s, (w, _) in zip(some, ways, strict=True)], costs
    )[0]


def by_their_ways(starts: Sequence[Start], ways: Sequence[Array], costs: Array) -> tuple[Starts, list[int]]:
    """Weigh starts by their costs (K,) over the same frames.

    ways: poses (T, D) of each start in these frames.
    Returns: the starts with weights, best first; their indices in this order.
    """
    order = np.argsort(costs, kind="stable")
    weights = np.exp(-(costs[order] - costs[order[0]]) / _SOFT)
    weights /= weights.sum()
    joints = np.stack([starts[k].body.joints(ways[k]) for k in order])
    away = np.linalg.norm(joints - joints[0], axis=-1)
    arm = np.array([n.endswith(("elbow", "wrist")) for n in starts[0].body.skeleton.joint_names])
    other = away[..., ~arm].mean((1, 2)) > _APART_M  # differences of the arms alone are found by the tracker
    far = weights[:, None] * (away > _FAR_M).mean(1) * other[:, None]
    left, right = (starts[0].body.skeleton.joint(f"{side}_hip") for side in ("left", "right"))
    across = joints[:, :, right] - joints[:, :, left]
    turned = (across * across[:1]).sum(-1).mean(1) < 0
    unsure = np.stack([far[turned].sum(0), far[~turned].sum(0)])
    return Starts(tuple(starts[k] for k in order), weights, unsure), order.tolist()


def _followed(start: Start, frames: Sequence[PreparedFrame]) -> tuple[Array, Array]:
    """Track a start through the next frames; return the poses (F, D) and costs (F,).

    The last displacement of the root is predicted again. Why: without that the true start of a walking person loses its
    legs, and a body that is too small wins.
    """
    poses, costs, pose, moved = [], [], start.pose, np.zeros(3)
    for frame in frames:
        expected = pose.copy()
        expected[:3] += moved
        own = _own(frame, start.body, expected)
        before, pose = pose, refine(start.body, expected[None], own, _BRIEF)[0].pose
        moved = pose[:3] - before[:3]
        poses.append(pose)
        costs.append(float(mask_cost(start.body, pose[None], own)[0] + strain(start.body.skeleton, pose[None])[0]))
    return np.array(poses).reshape(len(frames), len(pose)), np.array(costs)


def _by_size(template: Body, spans: Array, tall: float, height: float | None) -> list[tuple[float, list[int]]]:
    """List statures (m) and the postures to try at each: as high as the hull, and a little less and more.

    template: body of usual proportions; spans: (N,) height of each posture on it, m; tall: height of the hull, m;
        height: height of the person, m, None: unknown.
    Returns: pairs (stature, indices of postures); statures outside 0.8 to 2.3 m are left out.
    """
    if height is not None:
        return [(height, list(range(len(spans))))]
    by: dict[int, list[int]] = {}
    for n, span in enumerate(spans):
        for factor in (0.94, 1.0, 1.06):
            stature = template.stature * factor * tall / span
            if 0.8 < stature < 2.3:
                by.setdefault(round(np.log(stature / USUAL_M) / _BINS), []).append(n)
    return [(USUAL_M * float(np.exp(_BINS * k)), list(dict.fromkeys(own))) for k, own in sorted(by.items())]


def _odd(stature: float, height: float | None) -> float:
    """Compute the penalty of an unusual stature; 0 where the height is known."""
    return 0.0 if height is not None else 0.002 * float(np.log(stature / USUAL_M) / _SPREAD) ** 2


def _placed(body: Body, pose: Array, hull: Hull, headings: int) -> Array:
    """Place a pose at the hull in several headings (N, D), with its feet on the hull's lowest point."""
    low, high = hull.points.min(0), hull.points.max(0)
    middle = 0.5 * (0.5 * (low + high) + hull.centroid)
    vertices = body.skin(pose)
    own = 0.5 * (0.5 * (vertices.min(0) + vertices.max(0)) + vertices.mean(0)) - pose[:3]
    turns = so3_exp(np.arange(headings)[:, None] * [0.0, 0.0, 2 * np.pi / headings])
    out = np.repeat(pose[None], headings, 0)
    out[:, :2] = (middle - turns @ own)[:, :2]
    out[:, 2] = low[2] - (vertices[:, 2].min() - pose[2])
    out[:, 3:6] = so3_log(turns @ so3_exp(pose[3:6]))
    return out


def _own(frame: PreparedFrame, body: Body, pose: Array) -> PreparedFrame:
    """Copy a prepared frame for a body and a start pose (D,), without a pull to that pose."""
    return replace(frame, body=body, prediction=pose, prediction_weight=0.0)  # nothing is expected


def _different(starts: Sequence[Start], count: int) -> list[Start]:
    """Select the best starts that lie apart from each other, best first."""
    ranked = sorted(starts, key=lambda s: s.cost)
    at = np.array([s.body.joints(s.pose) for s in ranked])
    return [ranked[n] for n in distinct(at, count, _APART_M, np.mean)]


# ---- postures ----
# Poses in which a person may be found: standing, sitting, crouching, kneeling, with the arms anywhere; as directions
# of limbs, posed on a body by its own bones and limits.


Vector = tuple[float, float, float]
_LEGS: dict[str, tuple[float, Vector, Vector, Vector, Vector]] = {
    "standing": (0, (0.1, 0, -1), (0.05, 0.05, -1), (-0.1, 0, -1), (-0.05, 0.05, -1)),
    "left step": (4, (0.05, -0.45, -0.9), (0, -0.1, -1), (-0.05, 0.25, -0.97), (0, 0.55, -0.8)),
    "right step": (4, (0.05, 0.25, -0.97), (0, 0.55, -0.8), (-0.05, -0.45, -0.9), (0, -0.1, -1)),
    "wide": (3, (0.4, -0.1, -0.9), (0.3, 0.15, -0.9), (-0.4, -0.1, -0.9), (-0.3, 0.15, -0.9)),
    "sitting": (3, (0.15, -1, -0.05), (0, 0, -1), (-0.15, -1, -0.05), (0, 0, -1)),
    "sitting wide": (3, (0.3, -1, -0.05), (0.05, -0.05, -1), (-0.3, -1, -0.05), (-0.05, -0.05, -1)),
    "sitting back": (-10, (0.15, -1, 0.05), (0, -0.5, -0.85), (-0.15, -1, 0.05), (0, -0.5, -0.85)),
    "sitting forward": (20, (0.15, -1, -0.1), (0, 0.3, -0.95), (-0.15, -1, -0.1), (0, 0.3, -0.95)),
    "crouching": (35, (0.2, -0.8, -0.6), (0, 0.45, -0.9), (-0.2, -0.8, -0.6), (0, 0.45, -0.9)),
    "squatting": (35, (0.3, -0.9, 0.2), (0, 0.4, -0.9), (-0.3, -0.9, 0.2), (0, 0.4, -0.9)),
    "kneeling": (5, (0.1, -0.05, -1), (0, 1, -0.1), (-0.1, -0.05, -1), (0, 1, -0.1)),
    "left knee": (8, (0.1, 0.05, -1), (0, 0.95, -0.2), (-0.1, -1, -0.05), (0, 0, -1)),
    "right knee": (8, (0.1, -1, -0.05), (0, 0, -1), (-0.1, 0.05, -1), (0, 0.95, -0.2)),
    "on the floor": (5, (0.15, -1, 0.1), (0, -1, -0.1), (-0.15, -1, 0.1), (0, -1, -0.1)),
    "cross-legged": (8, (0.7, -0.65, 0.1), (-0.8, -0.2, -0.2), (-0.7, -0.65, 0.1), (0.8, -0.2, -0.2)),
    "bowing": (60, (0.1, 0.1, -1), (0.05, 0, -1), (-0.1, 0.1, -1), (-0.05, 0, -1)),
}
"""Lean of the trunk (degrees), and directions of left thigh and shank, right thigh and shank: x = the person's left, y
= backward, z = up."""
_ARMS: dict[str, tuple[Vector, Vector]] = {
    "hanging": ((0.15, 0, -1), (0.08, -0.15, -1)),
    "apart": ((0.6, 0, -0.8), (0.5, -0.1, -0.8)),
    "sideways": ((1, 0, 0), (1, 0, 0)),
    "up": ((0.25, 0, 1), (0.05, -0.05, 1)),
    "forward": ((0.1, -1, -0.05), (0, -1, 0)),
    "folded": ((0.2, -0.45, -0.9), (-0.9, -0.4, 0.1)),
    "guard": ((0.15, -0.35, -0.95), (-0.15, -0.65, 0.75)),
    "forearms forward": ((0.15, -0.05, -1), (0, -1, -0.1)),
    "on thighs": ((0.15, -0.35, -0.95), (-0.1, -0.85, -0.45)),
    "on hips": ((0.7, 0.3, -0.65), (-0.65, -0.45, -0.6)),
    "behind head": ((0.9, -0.15, 0.45), (-0.75, 0.2, 0.6)),
}
"""Directions of the left upper arm and forearm; the right ones are mirrored."""
_HANDS_BUSY = ("hanging", "on thighs", "folded", "forward", "up", "guard")
_TOGETHER: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("standing", tuple(_ARMS)),
    ("left step", ("hanging", "guard")),
    ("right step", ("hanging", "guard")),
    ("wide", ("hanging", "forearms forward", "up")),
    ("sitting", (*_HANDS_BUSY, "sideways")),
    ("sitting wide", ("hanging", "on thighs", "guard")),
    ("sitting back", ("hanging", "on thighs")),
    ("sitting forward", ("hanging", "on thighs", "forward")),
    ("crouching", ("hanging", "forward", "guard", "up")),
    ("squatting", ("hanging", "forward")),
    ("kneeling", ("hanging", "forearms forward", "up")),
    ("left knee", ("hanging", "forearms forward")),
    ("right knee", ("hanging", "forearms forward")),
    ("on the floor", ("hanging", "on thighs")),
    ("cross-legged", ("on thighs",)),
    ("bowing", ("hanging", "forward")),
)
_ONE_ARM = ("up", "forward", "sideways")
"""Postures of one arm alone, for a person who stands or sits."""


@lru_cache(4)
def postures(body: Body) -> Array:
    """Build the start postures (N, D) of a body at the origin, facing -y, within its limits; cached per body."""
    out = []
    for legs, all_ in _TOGETHER:
        out += [_posed(body, legs, arms, arms) for arms in all_]
    for legs, rest in (("standing", "hanging"), ("sitting", "on thighs")):
        for arm in _ONE_ARM:
            out += [_posed(body, legs, arm, rest), _posed(body, legs, rest, arm)]
    return np.stack(out)


def _posed(body: Body, legs: str, left_arm: str, right_arm: str) -> Array:
    """Solve for the pose (D,) whose joints lie where the directions put them, as far as anatomy allows.

    legs: key of _LEGS; left_arm, right_arm: keys of _ARMS.
    """
    s = body.skeleton
    lean, *directions = _LEGS[legs]
    trunk = so3_exp([np.radians(lean), 0.0, 0.0])
    rest = s.rest_joints
    wanted = rest @ trunk.T
    chains = [
        ("left", ("hip", "knee", "ankle"), directions[:2]),
        ("right", ("hip", "knee", "ankle"), directions[2:]),
        ("left", ("shoulder", "elbow", "wrist"), _ARMS[left_arm]),
        ("right", ("shoulder", "elbow", "wrist"), np.array(_ARMS[right_arm]) * (-1, 1, 1)),
    ]
    for side, chain, ways in chains:
        joints = [s.joint(f"{side}_{part}") for part in chain]
        for a, b, way in zip(joints[:-1], joints[1:], ways, strict=True):
            d = np.array(way) / np.linalg.norm(way)
            wanted[b] = wanted[a] + np.linalg.norm(rest[b] - rest[a]) * d
    start = np.zeros(s.dof)
    start[3] = np.radians(lean)
    for side in ("left", "right"):  # bent knees and hips to begin with: straight ones may bend either way
        start[s.dofs_of(f"{side}_hip")[0]] = -0.4
        start[s.dofs_of(f"{side}_knee")] = 0.4
    return with_joints_at(body, wanted, s.clamp(start), 0.05)
