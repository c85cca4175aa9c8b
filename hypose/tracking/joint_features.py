"""Compute features of a tracked clip that show errors: of every joint in a frame (the audit), and of each view's mask.

A wrong limb nearly always leaves a trace in the evidence: the true limb is not covered in a mask, the wrong one lies
outside it, key points lie elsewhere, or another pose fits as well. No trace is certain alone;
`hypose.tracking.error_model` weights them.
The distance of each view's mask from the body as a whole shows errors that the curvature of a cost does not: a wrong
calibration, a delay between views or a wrong body. A solve only halves the difference between views that contradict
each other; the rest has one direction in each view and stays, while the noise of outlines has all directions.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body
from hypose.compute import reach
from hypose.compute.arrays import PreparedMasks
from hypose.compute.parts import draw_parts, parts_against_mask, projected
from hypose.evidence.cues import SilhouetteEvidence
from hypose.evidence.frame import Frame, Keypoints, Silhouettes
from hypose.evidence.terms import Limb
from hypose.geometry import Array
from hypose.tracking.arm_workspace import ArmReach, ends, in_practice
from hypose.tracking.frame_evidence import MIN_CONFIDENCE, KeypointModel, check_sides_and_views, pixels_per_metre

_SCALE_M = 0.025
"""m: scale of Tukey's weight on the distance of outlines; zero at three times that, because it is another object."""
_ROUNDS, _SETTLED_PX = 8, 0.01
_LEAST_POINTS = 30
"""points of the outline without which a view's shift is unknown"""


def shift_of_mask(
    mask: NDArray[np.uint8], body: NDArray[np.uint8], metre: float, ignored: NDArray[np.uint8] | None = None
) -> Array:
    """Estimate the 2D shift that would move the drawn body onto the mask, in one view.

    mask: (h, w) and body: (h, w), 0 or 1.
    metre: pixels per metre at the person.
    ignored: (h, w), 1 for pixels without information.
    Returns: (2,) shift to the right and down, m; NaN where too little of the outline is visible.
    """
    outlines, _ = cv2.findContours(body, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not outlines:
        return np.full(2, np.nan)
    x, y = max(outlines, key=len)[:, 0].T
    inside = (x > 0) & (y > 0) & (x < mask.shape[1] - 1) & (y < mask.shape[0] - 1)
    if ignored is not None:
        inside &= ignored[y, x] == 0
    x, y = x[inside], y[inside]
    if len(x) < _LEAST_POINTS:
        return np.full(2, np.nan)
    # pixels further from the outline than this have no weight
    margin = int(2 * 3 * _SCALE_M * metre) + 2
    low, high = np.maximum((x.min() - margin, y.min() - margin), 0), (x.max() + margin + 1, y.max() + margin + 1)
    mask = np.ascontiguousarray(mask[low[1] : high[1], low[0] : high[0]])
    if not mask.any() or mask.all():  # there is no edge nearby
        return np.full(2, np.nan)
    distance = cv2.distanceTransform(1 - mask, cv2.DIST_L2, 5) - cv2.distanceTransform(mask, cv2.DIST_L2, 5)
    distance += mask - np.float32(0.5)  # the edge lies between the pixels
    smooth, below = cv2.GaussianBlur(distance, (0, 0), 1.0).ravel(), mask.shape[1]
    at = (y - low[1]) * below + (x - low[0])  # numbers of the pixels
    residual = (distance.ravel()[at] + 0.5).astype(np.float64)  # the outline's pixels are the body's last ones
    right, down = (smooth[at + 1] - smooth[at - 1]) / 2, (smooth[at + below] - smooth[at - below]) / 2
    steep = np.maximum(np.sqrt(right * right + down * down), 1e-3)
    across, weighted = np.empty((len(at), 2)), np.empty((len(at), 2))
    across[:, 0], across[:, 1] = right / steep, down / steep
    found, limit = np.zeros(2), 3 * _SCALE_M * metre
    for _ in range(_ROUNDS):
        weight = np.maximum(1 - ((residual + across @ found) / limit) ** 2, 0.0) ** 2
        for k in range(2):  # faster than numpy on rows of two
            np.multiply(across[:, k], weight, out=weighted[:, k])
        last, found = found, -np.linalg.solve(weighted.T @ across + 1e-3 * np.eye(2), weighted.T @ residual)
        if np.abs(found - last).max() < _SETTLED_PX:
            break
    return np.asarray(found / metre, dtype=np.float64)


def apart(shifts: Array) -> float:
    """Compute the root mean square, m, of the shifts (C, 2) of all views; NaN where fewer than two views have a
    known shift.
    """
    square = (shifts**2).sum(1)
    known = np.isfinite(square)
    return float(np.sqrt(square[known].mean())) if known.sum() > 1 else float("nan")


AUDITED = (
    *("bare", "bare_second", "exposed", "exposed_second", "outside", "loose", "exchanged"),
    *("points_median", "points_worst", "points_views", "points_all", "points_agree", "points_against", "apart"),
)
"""Columns of an audit, per joint and frame ("part": the skin of a joint; NaN: no such evidence):
bare: area of mask within _NEAR_M of the joint that the body does not cover, sum over the views, m^2;
    bare_second: in the view with the second largest area.
exposed: share of the joint's part that no other part covers, sum over the views; exposed_second: second largest.
outside: share of the part outside the masks, sum over the views.
loose: how far elbow and wrist may move while the masks hardly change, m; 0 for other joints, NaN in frames in which the
    arm is not tried, and with depth.
exchanged: gain in mask overlap (IoU) of the body with exchanged sides; NaN where it was not tried.
points_median, points_worst: distance of the joint's key points from it, median and largest over the views, m.
points_views: views with such a point; points_all: median distance of all points of the frame, m.
points_agree, points_against: views whose detected point is near the joint, and far from it.
apart: contradiction between the views' masks as a whole, m, the same for all joints; NaN where not computed.
"""
_NEAR_M = 0.25
_TALL = 110
"""px: height of a person in the reduced pictures that are compared; a forearm is five pixels wide"""
_PARTS = (
    *(("left_shoulder",), ("left_elbow", "left_wrist"), ("right_shoulder",), ("right_elbow", "right_wrist")),
    *(("left_hip",), ("left_knee", "left_ankle"), ("right_hip",), ("right_knee", "right_ankle")),
    *(("pelvis", "spine", "chest", "left_clavicle", "right_clavicle"), ("neck", "head")),
)
"""Groups of joints whose skin is one part."""
_TRUNK = 8
_NEARBY_M = 0.4
_AGREE_M = 0.06
"""m: a key point nearer to its joint agrees with it; one more than twice as far contradicts it"""
_FAR_M = 0.5  # m, larger distances are cut off


@lru_cache(8)
def _part_of_joint(names: tuple[str, ...]) -> NDArray[np.int64]:
    """Look up the part (J,) of each joint, an index in _PARTS; the trunk for joints of other names."""
    return np.array([next((k for k, p in enumerate(_PARTS) if n in p), _TRUNK) for n in names])


def views_apart(audit: ArrayLike) -> float:
    """Compute the median contradiction between the views of a clip, m, from its audit (T, J, A); 0 where it is
    unknown.
    """
    apart = np.asarray(audit, dtype=np.float64)[:, 0, AUDITED.index("apart")]
    apart = apart[np.isfinite(apart)]
    return float(np.median(apart)) if len(apart) else 0.0


def more_than_body(audit: ArrayLike, n_views: ArrayLike) -> float:
    """Compute the usual uncovered mask area per joint and view of a clip, m^2.

    audit: (T, J, A); n_views: (T,) number of views.
    Returns: mean over the joints, median over the frames; 0 where there are no masks.
    """
    bare = np.asarray(audit, dtype=np.float64)[..., AUDITED.index("bare")].mean(1)
    bare = bare / np.maximum(np.asarray(n_views, dtype=np.float64), 1)
    bare = bare[np.isfinite(bare)]
    return float(np.median(bare)) if len(bare) else 0.0


@lru_cache(4)
def _face_parts(body: Body) -> NDArray[np.uint8]:
    """Find the part (index in _PARTS) of each face (F,) of the body's coarse mesh; cached per body."""
    part = _part_of_joint(tuple(body.skeleton.joint_names))
    corner = part[body.coarse.main_joint][body.coarse.faces]
    return np.where(corner[:, 1] == corner[:, 2], corner[:, 1], corner[:, 0]).astype(np.uint8)


def audit_frame(
    body: Body,
    pose: Array,
    frame: Frame,
    model: KeypointModel | None = None,
    exchanged: float = float("nan"),
) -> NDArray[np.float32]:
    """Compute the audit of one frame: how well the evidence supports each joint of a tracked pose.

    pose: (D,) pose vector, rad and m.
    model: where key points sit on the body; None: key points are not used.
    exchanged: gain of the body with exchanged sides, NaN where it was not tried.
    Returns: (J, A) one column per measurement in AUDITED, which lists their names; NaN where the frame has no such
        evidence.
    """
    names = tuple(body.skeleton.joint_names)
    out = np.full((len(names), len(AUDITED)), np.nan, np.float32)
    for silhouettes in frame.of(Silhouettes):
        if not silhouettes.usable.any():
            continue
        masks = silhouettes.prepared
        _masks(body, pose, silhouettes, masks, frame.index % _RARELY == 0, out)
        if frame.fewest_views > 1:
            out[:, AUDITED.index("loose")] = _loose(body, pose, masks, frame.index)
    out[:, AUDITED.index("exchanged")] = exchanged
    for points in frame.of(Keypoints):
        if model is not None and model.names == points.names:
            out[:, AUDITED.index("points_median") : -1] = _points(body, pose, points, model)
    return out


def _masks(
    body: Body,
    pose: Array,
    silhouettes: Silhouettes,
    masks: PreparedMasks,
    apart_too: bool,
    out: NDArray[np.float32],
) -> None:
    """Fill the columns of out (J, A) that come from masks, except "loose"; "apart" only where apart_too.

    pose: (D,) pose of the body.
    masks: the silhouettes, prepared for the scorer.
    """
    part = _part_of_joint(tuple(body.skeleton.joint_names))
    vertices, joints = body.skin(pose), body.joints(pose)
    points, part_of_face = np.concatenate([vertices, joints]), _face_parts(body)
    views = np.flatnonzero(silhouettes.usable)
    shifts, square = np.full((len(views), 2), np.nan), np.ones((len(views), 1))
    bare, exposed, outside = (np.zeros((len(views), n)) for n in (len(joints), len(_PARTS), len(_PARTS)))
    area = np.ones((len(views), len(_PARTS)), np.int64)
    for k, c in enumerate(views.tolist()):
        p, (w, h) = masks.projections[c], masks.sizes[c].tolist()
        depth = float(p[2, :3] @ joints[0] + p[2, 3])
        per_metre = float(silhouettes.rig[c].K[0, 0]) / max(depth, 0.1)
        step = max(1, int(1.7 * per_metre / _TALL))
        uv, z, (across, down) = projected(points, p)
        # pixels further from the body are not used
        (x0, x1), (y0, y1) = _span(across, _NEARBY_M * per_metre, w), _span(down, _NEARBY_M * per_metre, h)
        if x0 >= x1 or y0 >= y1:
            continue
        size, shape = per_metre / step, (-((y0 - y1) // step), -((x0 - x1) // step))
        uv[:, 0] -= x0
        uv[:, 1] -= y0
        uv /= step
        drawn = draw_parts(uv, z, body.coarse.faces, part_of_face, len(_PARTS), shape)
        small = c, slice(y0, y1, step), slice(x0, x1, step)
        ignored = None if silhouettes.ignored is None else np.ascontiguousarray(silhouettes.ignored[small])
        near = np.full(len(joints), _NEAR_M * size)
        mask = np.ascontiguousarray(masks.masks[small])
        seen = parts_against_mask(mask, ignored, drawn, uv[-len(joints) :], near)
        area[k], exposed[k], outside[k], bare[k], square[k] = seen.area, seen.exposed, seen.outside, seen.bare, size**2
        if apart_too:
            shifts[k] = shift_of_mask(silhouettes.masks[small], seen.body, size, ignored)
    second = -2 if len(views) > 1 else -1
    bare, exposed, outside = bare / square, exposed / np.maximum(area, 1), outside / np.maximum(area, 1)
    out[:, 0], out[:, 1] = bare.sum(0), np.sort(bare, 0)[second]
    out[:, 2], out[:, 3] = exposed.sum(0)[part], np.sort(exposed, 0)[second][part]
    out[:, 4] = outside.sum(0)[part]
    if apart_too:
        out[:, -1] = apart(shifts)


def _span(reach: Array, nearby: float, most: int) -> tuple[int, int]:
    """Compute the pixel range from 0 to `most` that covers the interval `reach` (2,) with a margin; (0, 0) where it is
    empty.

    nearby: margin, px; most: size of the picture along the axis, px.
    """
    first, last = reach.tolist()  # plain numbers are ten times as fast
    low, high = first - nearby, last + nearby
    return (int(min(max(low, 0.0), most)), int(min(max(high, 0.0), most))) if low <= high else (0, 0)


def _loose(body: Body, pose: Array, masks: PreparedMasks, index: int) -> Array:
    """Compute column "loose" (J,) of AUDITED by random small rotations of one arm; the arms take turns over the frames.

    pose: (D,) pose vector, rad and m; masks: prepared for the scorer; index: index of the frame.
    Returns: (J,) m; NaN for an arm whose turn it is not, 0 for joints of no arm.
    """
    s, mesh, out = body.skeleton, body.coarse.arrays, np.zeros(len(body.skeleton.joint_names))
    for k, arm in enumerate(_arms(body)):
        if (index - 2 * k) % _EVERY:
            out[list(arm.chain)] = np.nan
            continue
        poses = np.repeat(pose[None], _TURNS + 1, 0)  # the last one stays unchanged
        poses[:-1, arm.own] += _turns(len(arm.own))
        poses = s.clamp(poses)
        at = ends(arm.here(poses))  # elbow, wrist, hand
        away = np.linalg.norm(at[:-1] - at[-1:], axis=-1)
        rest = reach.standing(pose, s.tree, mesh, masks, arm.moving)
        energy = SilhouetteEvidence(masks.usable, (), masks).energy(body, poses, Limb(arm.moving, rest))
        weight = np.exp(-np.maximum((energy[:-1] - energy[-1]) / _HARDLY, -1.0))
        out[list(arm.chain[1:])] = np.sqrt(weight @ away[:, :2] ** 2 / (1 + weight.sum()))
    return out


@lru_cache(4)
def _turns(count: int) -> Array:
    """Draw the rotations (_TURNS, d), rad, of an arm's coordinates, small ones and large ones."""
    rng = np.random.default_rng(0)
    return rng.standard_normal((_TURNS, count)) * rng.choice(_TURNS_RAD, (_TURNS, 1))


_TURNS, _TURNS_RAD = 64, (0.12, 0.3, 0.6)
"""number of rotations, and their standard deviations"""
_HARDLY = 0.005
"""share of the masks' areas, summed over the views: a rotation that changes this much more counts 1 / e as much.
Chosen, like the rotations, on scenes of the seeds 600 to 617"""


_EVERY, _RARELY = 4, 8
"""frames between two searches of the same arm, and between two computations of the column "apart"."""


@lru_cache(4)
def _arms(body: Body) -> list[ArmReach]:
    """Build the reach tables of the body's arms that are complete; cached per body."""
    s, found = body.skeleton, []
    for side in ("left", "right"):
        joints = tuple(f"{side}_{n}" for n in ("clavicle", "shoulder", "elbow"))
        if {*joints, f"{side}_wrist"} <= {*s.joint_names}:
            found.append(ArmReach(body, joints, *in_practice(s)))
    return found


def _points(body: Body, pose: Array, seen: Keypoints, model: KeypointModel) -> Array:
    """Compute the six columns (J, 6) of AUDITED from points_median to points_against.

    pose: (D,) pose vector, rad and m; seen: key points of the frame; model: where they sit on the body.
    """
    names, points = tuple(body.skeleton.joint_names), np.nan_to_num(seen.points)
    expected = model.positions(body, pose)
    uv = np.stack([camera.project_pinhole(expected) for camera in seen.rig])
    size = pixels_per_metre(seen, body.joints(pose)[0])
    points[~(points[..., 2] > MIN_CONFIDENCE)] = 0.0
    own = columns_of_joints(names, model.names)  # (J, M), -1: none
    raw = np.linalg.norm(points[..., :2] - uv, axis=-1) / size[:, None]
    there = (own >= 0)[None] & ((points[..., 2] > 0) & model.known & np.isfinite(uv).all(-1))[:, own]
    agree, against = (there & (raw[:, own] < _AGREE_M)).any(-1), (there & (raw[:, own] > 2 * _AGREE_M)).any(-1)
    points = check_sides_and_views(points, uv, model.names, size, model.known)
    known = (points[..., 2] > 0) & model.known & np.isfinite(uv).all(-1)
    away = np.minimum(np.linalg.norm(points[..., :2] - uv, axis=-1) / size[:, None], _FAR_M)
    away = np.where(known, away, np.inf)
    found = np.where((own >= 0)[None], away[:, own], np.inf)  # (C, J, M)
    in_set = ((own >= 0) & model.known[own]).any(1)
    views = np.where(in_set, np.isfinite(found).any(-1).sum(0), np.nan)
    row = np.sort(found.transpose(1, 0, 2).reshape(len(names), -1), axis=1)
    count = np.isfinite(row).sum(1)
    at = np.arange(len(names))
    middle, worst = (np.where(count > 0, row[at, np.maximum(k, 0)], _FAR_M) for k in ((count - 1) // 2, count - 1))
    usual = float(np.median(away[known])) if known.any() else _FAR_M
    found = [middle, worst, views, np.full(len(names), usual), agree.sum(0), against.sum(0)]
    return np.stack(found, 1)


@lru_cache(8)
def columns_of_joints(names: tuple[str, ...], points: tuple[str, ...]) -> NDArray[np.int64]:
    """Find the key points that belong to each joint.

    names, points: names of the J joints and of the key points.
    Returns: (J, M) indices of the key points of each joint; the rows are filled up with -1.
    """
    own = [[points.index(n) for n in _NAMED.get(name, (name,)) if n in points] for name in names]
    most = max(map(len, own))
    return np.array([[*o, *[-1] * (most - len(o))] for o in own], dtype=np.int64).reshape(len(names), most)


_NAMED = {
    "pelvis": ("left_hip", "right_hip", "mid_hip"),
    "neck": ("neck", "upper_neck", "left_shoulder", "right_shoulder"),
    "head": ("nose", "left_ear", "right_ear", "head_top", "left_eye", "right_eye"),
    "chest": ("neck", "left_shoulder", "right_shoulder"),
    "spine": ("mid_hip", "left_hip", "right_hip", "left_shoulder", "right_shoulder"),
    "left_clavicle": ("left_shoulder", "neck"),
    "right_clavicle": ("right_shoulder", "neck"),
}
"""Key points of joints that have no key point of their own name."""
