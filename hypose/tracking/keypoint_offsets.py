"""Measure on the clip itself where a detector's key points sit on this person, and how noisy they are.

A detector's hip is not the joint's centre, and every detector has its own systematic offsets. Offsets and poses are
solved in turn on the reprojection in all views; offsets have a prior around the body's landmarks and limits, so that
they cannot replace the pose. The remaining distances are the noise that weights key points against contours.

Weights next to masks (`weigh_against_masks`): outlines locate a limb to about a centimetre, but their cost hardly grows
beyond that: key points with a larger scatter pull a limb out of its outline instead of being averaged with it. So with
masks, key points get a reduced weight where the outlines are right, and their full weight where the outlines are wrong
(a skirt, a bag, a chair, another person, shadows). To decide, the body is fitted to the outlines alone: where they are
right it lies within the key points' scatter, else further away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.cameras.camera import CameraRig, triangulate
from hypose.compute.losses import lorentzian_weight
from hypose.errors import EvidenceError
from hypose.evidence.frame import Frame, Keypoints, Silhouettes, pieces_of
from hypose.evidence.keypoints import lasting_m, other_sides, triangulate_keypoints
from hypose.fitting.articulated import SolveSettings, fit_pose
from hypose.geometry import Array
from hypose.tracking.frame_evidence import (
    MIN_CONFIDENCE,
    KeypointModel,
    keypoint_term,
    pixels_per_metre,
    prepare,
)
from hypose.tracking.refinement import anatomical_prior, settled_start, solve_poses
from hypose.tracking.start_search import start_from_keypoints

LEAST_SD, LARGEST_SD = 0.008, 0.3
"""m: bounds of the measured noise. Points with a scatter of 4 % of the body height must get the low weight that belongs
to it, or they spoil the silhouettes' better estimate."""
TOGETHER = 2.0
"""Factor on the noise from the median distance, because errors of a point are correlated in neighbouring frames and
views and sometimes very large (chosen on the balancing clip)."""
FEET_WEIGH = 0.05
"""Weight of toes and heels while offsets are measured. Feet turn further than a hinge at the knee and an ankle allow,
so toes would turn the leg, the knee's offset would compensate, and the knee would be wrong by 15 mm in all frames
(chosen on captured movement, seeds 3 to 5).
"""
_SHRINK = 20.0
"""Number of distances at the usual noise that are added to each point's own, so that rarely seen points are near the
usual."""


def offset_limits(names: Sequence[str]) -> Array:
    """Return the limits (K,), m, of the points' offsets from the body's landmarks: 5 cm joints, 12 cm face, 8 cm
    feet.
    """
    face = ("nose", "eye", "ear", "head")
    foot = ("toe", "heel")
    lower = [n.lower() for n in names]
    return np.array([0.12 if any(f in n for f in face) else 0.08 if any(f in n for f in foot) else 0.05 for n in lower])


def leg_weights(names: Sequence[str]) -> Array:
    """Return the weights (K,) of key points in the solves that measure offsets: FEET_WEIGH for points of the feet, 1
    for all others.
    """
    return np.array([FEET_WEIGH if any(f in n.lower() for f in ("toe", "heel")) else 1.0 for n in names])


def calibrate_keypoints(
    body: Body, model: KeypointModel, keypoints: Sequence[Keypoints], poses: Array | None = None, *, rounds: int = 3
) -> KeypointModel:
    """Measure offsets and noise of the key points on frames of this person (T; some tens of different poses).

    keypoints: key points of the frames; rounds: alternations of poses and offsets.
    model: where the points are expected; offsets stay within `offset_limits` of it.
    poses: (T, D) approximate poses, NaN rows where unknown (default: from triangulation).
    Returns: the model with measured offset, sd and view.
    Raises: EvidenceError where no frame has enough points.
    """
    model = replace(model, view=view_factors(keypoints))
    start = triangulated_starts(body, model, keypoints) if poses is None else poses
    chosen = np.flatnonzero(np.isfinite(start).all(1))
    if len(chosen) == 0:
        raise EvidenceError("No frame has 6 triangulated key points; check the key points' folder and the calibration.")
    used, q = [keypoints[int(t)] for t in chosen], start[chosen].copy()
    base, found = model, model
    for _ in range(rounds):
        q = solved_frames(body, found, used, q, leg_weights(model.names))
        found = replace(found, offset=_offsets(base, found, residual_rows(body, found, used, q)))
        found = replace(found, sd=_noise(residual_rows(body, found, used, q)))
    q = solved_frames(body, found, used, q)
    return replace(found, sd=_noise(residual_rows(body, found, used, q)))


def triangulated_starts(body: Body, model: KeypointModel, keypoints: Sequence[Keypoints]) -> Array:
    """Compute poses (T, D) from triangulated points; NaN where there are fewer than six.

    model: where key points sit on the body; keypoints: T frames.
    """
    points, _, _ = triangulate_keypoints(keypoints, worse=model.worse(len(keypoints[0].rig)))
    known = model.known
    out = np.full((len(points), body.skeleton.dof), np.nan)
    for t, frame in enumerate(points):
        if np.isfinite(frame[known]).all(1).sum() >= 6:
            out[t] = start_from_keypoints(body, frame[known], model.joint[known], model.offset[known]).pose
    return out


def solved_frames(
    body: Body, model: KeypointModel, keypoints: Sequence[Keypoints], poses: Array, weights: Array | None = None
) -> Array:
    """Solve the poses (T, D) of frames, each frame by itself on its key points, from its start pose.

    model: where key points sit on the body; keypoints: T frames. Frames without points keep their start pose.
    poses: (T, D) start poses.
    weights: (K,) factors on the points' weights (default 1).
    """
    out, prior = poses.copy(), (anatomical_prior(body.skeleton, keypoints=True),)
    options = SolveSettings(iterations=12, coarse_iterations=0)
    for t, frame in enumerate(keypoints):
        term = keypoint_term(frame, body, model, poses[t])
        if term is not None:
            scores = term.points[..., 2:] * (1.0 if weights is None else weights[model.known, None])
            term = term._replace(points=np.concatenate([term.points[..., :2], scores], -1))
            out[t] = fit_pose(body, poses[t], [term], priors=prior, options=options).pose
    return out


class OffsetResiduals(NamedTuple):
    """Residuals of key points about a body, for measuring offsets.

    residual: (T, C, K, 2) px.
    slope: (T, C, K, 2, 3) derivative with respect to the offset, px/m.
    confidence: (T, C, K); 0 where there is no point.
    size: (T, C) pixels per metre, times the noise factor of the view.
    """

    residual: Array
    slope: Array
    confidence: Array
    size: Array


def residual_rows(body: Body, model: KeypointModel, keypoints: Sequence[Keypoints], poses: Array) -> OffsetResiduals:
    """Compute the residuals of key points, with exchanged sides corrected, about a body in given poses.

    model: where the points sit on the body; keypoints: T frames; poses: (T, D) pose vectors, rad and m.
    """
    rotations, world = body.skeleton.forward(poses)[0][:, model.joint], model.positions(body, poses)
    rig, (frames, count) = keypoints[0].rig, world.shape[:2]
    points, size = np.zeros((len(rig), frames, count, 3)), np.ones((frames, len(rig)))
    for t, frame in enumerate(keypoints):
        size[t] = pixels_per_metre(frame, poses[t, :3]) * model.worse(len(rig))
        term = keypoint_term(frame, body, replace(model, sd=None, view=None), poses[t])  # exchanged sides put right
        if term is not None:
            points[:, t, model.known] = term.points
    flat = points.reshape(len(rig), -1, 3)
    residual, slope, _ = _rows(world.reshape(-1, 3), flat[..., :2], rig.projections, flat[..., 2] > 0)
    by_offset = np.einsum("ctkia,tkab->tckib", slope.reshape(*points.shape[:3], 2, 3), rotations)
    residual = residual.reshape(*points.shape[:3], 2).swapaxes(0, 1)
    return OffsetResiduals(residual, by_offset, points[..., 2].swapaxes(0, 1), size)


def _offsets(base: KeypointModel, model: KeypointModel, rows: OffsetResiduals) -> Array:
    """Compute all offsets (K, 3) by one robust Gauss-Newton step on all frames, with prior and limits.

    base: places before the measurement, around which the limits lie; model: present places and noise; rows: residuals
        about them.
    """
    limit = offset_limits(base.names)
    sd_px = (model.sd if model.sd is not None else np.full(len(limit), 0.02)) * rows.size[..., None]
    square = (rows.residual**2).sum(-1) / sd_px**2
    weight = lorentzian_weight(0.25 * square, rows.confidence / sd_px**2)
    hessian = np.einsum("tck,tckia,tckib->kab", weight, rows.slope, rows.slope)
    gradient = np.einsum("tck,tckia,tcki->ka", weight, rows.slope, rows.residual)
    # errors of a clip's frames are correlated, so the prior grows with their number
    prior = len(rows.residual) * (2 / limit) ** 2 * 0.1
    shift = model.offset - base.offset
    hessian += prior[:, None, None] * np.eye(3)
    gradient += prior[:, None] * shift
    moved = shift - np.linalg.solve(hessian, gradient[..., None])[..., 0]
    length = np.linalg.norm(moved, axis=1, keepdims=True)
    moved *= np.minimum(1.0, limit[:, None] / np.maximum(length, 1e-9))
    return np.where(model.known[:, None], base.offset + moved, base.offset)


def _noise(rows: OffsetResiduals) -> Array:
    """Estimate the noise (K,), m per axis at confidence 1, from the median distances; see TOGETHER.

    rows: residuals about the present places; LARGEST_SD where there is no point at all.
    """
    metres = np.abs(rows.residual) / rows.size[..., None, None]
    by_point = [
        (np.sqrt(rows.confidence[:, :, k, None]) * metres[:, :, k])[rows.confidence[:, :, k] > 0].ravel()
        for k in range(metres.shape[2])
    ]
    pooled = np.concatenate(by_point)
    if len(pooled) == 0:
        return np.full(len(by_point), LARGEST_SD)
    usual = float(np.median(pooled))
    middle = np.array(
        [(len(d) * np.median(d) + _SHRINK * usual) / (len(d) + _SHRINK) if len(d) else usual for d in by_point]
    )
    # half way to the usual noise, because offset and pose absorb a part of the point's own
    return np.clip(TOGETHER * 1.4826 * np.sqrt(middle * usual), LEAST_SD, LARGEST_SD)


LARGEST = 12.0
"""Largest noise factor of a view; with it the view has practically no weight."""
USUAL = 1.6
"""Factors up to this are chance, or due to what a view sees of the person."""
_ROUNDS = 12
_LEAST_POINTS = 30
_CONFIDENT = 0.3
_NEAREST_M = 0.3
_LEAST_LEFT = 0.2


def view_factors(keypoints: Sequence[Keypoints]) -> Array:
    """Estimate by how much the noise in metres of each view is larger than that of the better half of the views.

    keypoints: frames of one recording.
    Returns: (C,) factors >= 1; all 1 with fewer than three views, and where too little is seen in three.
    The worst view is left out before the others are judged, as long as three are left, so that its errors are not
    charged to them. A view that calls left what the others call right is not noisier for it: its sides are exchanged in
    frames where they then lie nearer to those of the others.
    """
    rig, other = keypoints[0].rig, other_sides(keypoints[0].names)
    points = np.stack([k.points for k in keypoints], 1)
    seen = (points[..., 2] > _CONFIDENT) & np.isfinite(points[..., :2]).all(-1)
    uv, factor, active = np.nan_to_num(points[..., :2]), np.ones(len(rig)), np.ones(len(rig), dtype=np.bool_)
    while active.sum() >= 3:
        chosen = seen[active].sum(0) >= 3
        if chosen.sum() < _LEAST_POINTS:
            break
        found = _components(rig, uv, seen & chosen, active, other)
        worst = int(np.argmax(np.where(active, found, 0.0)))
        if found[worst] <= USUAL:
            break
        factor[worst], active[worst] = found[worst], False
    return factor


def _components(
    rig: CameraRig, uv: Array, seen: NDArray[np.bool_], active: NDArray[np.bool_], other: NDArray[np.int64]
) -> Array:
    """Estimate the factors (C,) of the active views.

    rig: the cameras. Views that are not active have no weight and the factor 1.
    uv: (C, T, K, 2) points, px; seen: (C, T, K) where they are seen.
    other: (K,) column of each point's other side.
    """
    views, shape = len(rig), seen.shape
    factor, size = np.ones(views), np.ones((views, seen[0].size))
    named, shown = uv, (seen & active[:, None, None]).reshape(views, -1)
    for _ in range(_ROUNDS):
        world, _ = triangulate(rig, named.reshape(views, -1, 2), shown / (factor[:, None] * size))  # weights of rows
        residual, slope, size = _rows(world, named.reshape(views, -1, 2), rig.projections, shown)
        weight = shown / (factor[:, None] * size) ** 2
        normal = np.einsum("cn,cnia,cnib->nab", weight, slope, slope)
        least = 1e-9 * np.maximum(np.trace(normal, axis1=1, axis2=2), 1.0)
        inverse = np.linalg.inv(normal + least[:, None, None] * np.eye(3))
        left = 2 - weight * np.einsum("cnia,nab,cnib->cn", slope, inverse, slope)
        square = (residual**2).sum(-1) / size**2 / np.maximum(left, _LEAST_LEFT)
        many = shown.sum(1) >= _LEAST_POINTS
        medians = [np.median(s[k]) if m else np.nan for s, k, m in zip(square, shown, many, strict=True)]
        noise = np.sqrt(np.array(medians))
        usual = np.sort(noise[many])[(many.sum() - 1) // 2]
        found = np.clip(np.nan_to_num(noise / max(float(usual), 1e-6), nan=1.0), 1.0, LARGEST)
        factor = np.sqrt(factor * found)
        exchanged = _exchanged(world.reshape(*shape[1:], 3), uv, rig.projections, seen, other)[..., None]
        named = np.where(exchanged[..., None], uv[:, :, other], uv)
        shown = (np.where(exchanged, seen[:, :, other], seen) & active[:, None, None]).reshape(views, -1)
    return factor


def _exchanged(
    world: Array, uv: Array, projections: Array, seen: NDArray[np.bool_], other: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Find views and frames (C, T) whose points lie nearer to the 3D points (T, K, 3) when their sides change places.

    world: m; uv: (C, T, K, 2) px; projections: (C, 3, 4); seen: (C, T, K); other: (K,) column of each point's other
        side.
    """
    known = seen & np.isfinite(world).all(-1)
    known &= known[:, :, other]
    points, both = world.reshape(-1, 3), known.reshape(len(uv), -1)
    named, exchanged = (
        np.linalg.norm(_rows(points, at.reshape(len(uv), -1, 2), projections, both)[0], axis=-1)
        for at in (uv, uv[:, :, other])
    )
    return np.asarray((named - exchanged).reshape(seen.shape).sum(-1) > 0)


def _rows(world: Array, uv: Array, projections: Array, seen: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """Compute the residuals of 3D points (N, 3) seen at uv (C, N, 2).

    world: m; uv: px; projections: (C, 3, 4); seen: (C, N); the residual is 0 where a point is not seen.
    Returns: residuals (C, N, 2), px; derivatives (C, N, 2, 3), px/m; pixels per metre (C, N).
    """
    h = np.einsum("cij,nj->cni", projections[:, :, :3], world) + projections[:, None, :, 3]
    depth = np.maximum(np.nan_to_num(h[..., 2]), _NEAREST_M)
    projected = h[..., :2] / depth[..., None]
    by_point = projections[:, None, :2, :3] - projected[..., None] * projections[:, None, 2:, :3]
    slope = by_point / depth[..., None, None]
    size = np.linalg.norm(projections[:, :2, :3], axis=(1, 2))[:, None] / np.sqrt(2) / depth
    residual = np.where(seen[..., None], np.nan_to_num(projected - uv), 0.0)
    return residual, np.nan_to_num(slope), size


# ---- weights next to masks ------------------------------------------------------------------------------------------


OUTLINES_M = 0.015
"""m: points with no larger scatter keep their full weight next to masks, even where these contradict them."""
_STEEP = 3
"""Exponent of the share of their weight that points with a larger scatter keep. Outlines pull hardly more on a distant
limb than on a near one, so points dominate too early. On scenes (walk, box, serve, cross-arms; seeds 1040 and 1041) a
third to a tenth of the weight is better; on balancing all of it is needed, and kept.
"""
LEAST_POINT_WEIGHT = 0.03
"""Least share of their weight that points keep next to correct masks."""
_CLEARLY = 2.0
"""In a view where points are wrong their distance from the outlines' solve is this many times that in half of the
views."""
_APART = 1.5
"""Points of a view are wrong only where some view has this many times the usual distance from the points' own solve;
otherwise the outlines may be wrong."""
_FRAMES, _SPARSE, _MOST_TIMES = 8, 0.5, 3
"""frames that are compared; share of points seen below which more frames are compared, at most so many times more"""
_PARTS = (("elbow", "wrist"), ("knee", "ankle", "toe", "heel"), ("shoulder", "hip", "neck"), ("",))
_LEAST_FRAMES, _LEAST_ROWS, _LEAST_SHARE_LEFT = 3, 8, 0.2
_SOLVE = SolveSettings(iterations=12, coarse_iterations=4)


def weigh_against_masks(body: Body, model: KeypointModel, frames: Sequence[Frame]) -> KeypointModel:
    """Measure the weights that key points keep in solves with masks (`KeypointModel.cue_weight`).

    frames: frames of one person; those with key points and masks are used.
    Returns: the model with the weights; the same model where fewer than three frames can be compared.
    Method: the body is solved on the points and on the outlines. The points' scatter about the first is their noise;
        what their scatter about the second has in excess in most views is the outlines' fault, a clear excess in single
        views is the points' fault there.
    """
    both = [f for f in frames for _ in f.of(Keypoints) for _ in f.of(Silhouettes)]
    count = min(_FRAMES * _times(model, both), len(both))
    both = [both[int(n)] for n in np.unique(np.linspace(0, len(both) - 1, count).astype(int))]
    seen, by_points, by_masks = _solved_either_way(body, model, both)
    if len(seen) < _LEAST_FRAMES:
        return model
    own, other = (residual_rows(body, model, seen, poses) for poses in (by_points, by_masks))
    rows = 2 * np.median((own.confidence[:, :, model.known] > 0).sum((1, 2)))
    lasting = lasting_m(model.names) ** 2
    left = max(1 - body.skeleton.dof / max(float(rows), 1.0), _LEAST_SHARE_LEFT)
    usual, cue_weight = np.nanmedian(_scatter(own, model.known)), np.full((len(seen[0].rig), len(model.names)), np.nan)
    for members in _parts(model.names):
        given = members & model.known
        scatter, away = _scatter(own, given), _scatter(other, given) ** 2
        tell = np.isfinite(scatter) & np.isfinite(away)
        if not tell.any():
            continue
        noise = max(float(usual * np.median(scatter[tell])) / left, 1e-8)
        # assume that at least half of the views are right
        alike = tell & (away <= _CLEARLY**2 * max(float(np.sort(away[tell])[(tell.sum() - 1) // 2]), noise))
        off = tell & ~alike
        if off.any():  # the body solved on the points lies between the right and the wrong points
            noise = min(noise, float(np.median(away[alike])))
        wrong = max(float(np.median(away[alike])) - noise - lasting, 0.0)
        theirs = np.where(off, np.fmax(away - wrong, noise), noise) + lasting
        weight = ((OUTLINES_M**2 + wrong) / theirs) ** _STEEP
        apart = np.max(scatter[tell]) > _APART * usual
        cue_weight[:, members] = np.clip(weight, np.where(off & apart, 0.0, LEAST_POINT_WEIGHT), 1.0)[:, None]
    known = np.isfinite(cue_weight).any(0)
    # limbs of which too little is seen get the median weight of the others
    cue_weight[:, ~known] = np.median(cue_weight[:, known], axis=1, keepdims=True) if known.any() else 1.0
    return replace(model, cue_weight=cue_weight)


def start_with_masks(body: Body, model: KeypointModel, frame: Frame, start: Array) -> Array:
    """Refine a start pose (D,) that was found from key points, by a solve on key points and masks of its frame.

    Returns: (D,) pose; the start pose unchanged where there are no masks.

    model: where key points sit on the body; frame: with key points.
    """
    prepared = prepare(frame, body, start, use_keypoints=True, keypoints_on_body=model, prediction_weight=0.0)
    return settled_start(start, prepared) if prepared.silhouettes.seen else start


def _times(model: KeypointModel, frames: Sequence[Frame]) -> int:
    """Compute how many times as many frames to compare, because few points are seen.

    model: model of the key points; frames: frames of the person.
    Returns: 1 to _MOST_TIMES; 1 where half of the points or more are seen.
    """
    seen = [np.nan_to_num(k.points[:, model.known, 2]) > MIN_CONFIDENCE for k in pieces_of(frames, Keypoints)]
    share = float(np.mean([s.mean() for s in seen])) if seen else 1.0
    return int(np.clip(np.ceil(_SPARSE / max(share, 1e-3)), 1, _MOST_TIMES))


def _solved_either_way(
    body: Body, model: KeypointModel, frames: Sequence[Frame]
) -> tuple[list[Keypoints], Array, Array]:
    """Solve frames on the points alone and on the outlines alone.

    model: where key points sit on the body; frames: with key points and masks.
    Returns: key points of the frames where both work; poses (T, D) by points; poses (T, D) by outlines.
    """
    seen = pieces_of(frames, Keypoints)
    starts = triangulated_starts(body, model, seen) if seen else np.zeros((0, body.skeleton.dof))
    found = np.flatnonzero(np.isfinite(starts).all(1)).tolist()
    poses = solved_frames(body, model, [seen[n] for n in found], starts[found])
    alone = [
        prepare(replace(frames[n], keypoints=None), body, q, prediction_weight=0.0)
        for n, q in zip(found, poses, strict=True)
    ]
    shown = [k for k, frame in enumerate(alone) if frame.silhouettes.seen]
    by_masks = poses[shown].copy()
    for n, k in enumerate(shown):
        by_masks[n] = solve_poses(body, poses[k, None], alone[k], _SOLVE)[0].pose
    return [seen[found[k]] for k in shown], poses[shown], by_masks


def _parts(names: Sequence[str]) -> list[NDArray[np.bool_]]:
    """Group key points by part: masks (K,) of a limb of one side, of the trunk, of the head."""
    out, free = [], np.ones(len(names), np.bool_)
    for words in _PARTS:
        own = free & np.array([any(w in n.lower() for w in words) for n in names])
        left = own & np.array(["left" in n.lower() for n in names])
        out += [left, own & ~left] if words in _PARTS[:2] else [own]
        free = free & ~own
    return out


def _scatter(rows: OffsetResiduals, members: NDArray[np.bool_]) -> Array:
    """Compute the robust standard deviation (C,), m per axis, of these points' residuals (K,) in each view; NaN where
    few.

    rows: rows of residuals; members: (K,) the points that are used.
    """
    used = (rows.confidence > 0) & members
    metres = np.abs(rows.residual) / rows.size[..., None, None]
    views = [metres[:, c][used[:, c]] for c in range(used.shape[1])]
    return np.array([1.4826 * np.median(m) if m.size >= 2 * _LEAST_ROWS else np.nan for m in views])
