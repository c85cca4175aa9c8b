"""Measure the weight of key points in solves that use masks too, on a few frames of the clip, limb by limb.

Outlines locate a limb to about a centimetre, but their cost hardly grows beyond that: key points with a larger scatter
pull a limb out of its outline instead of being averaged with it. So with masks, key points get a reduced weight where
the outlines are right, and their full weight where the outlines are wrong (a skirt, a bag, a chair, another person,
shadows). To decide, the body is fitted to the outlines alone: where they are right it lies within the key points'
scatter, else further away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.evidence.frame import Frame, Keypoints, Silhouettes, pieces_of
from hypose.evidence.keypoints import lasting_m
from hypose.fitting import SolveSettings
from hypose.geometry import Array
from hypose.tracking.frame_evidence import PreparedFrame, prepare
from hypose.tracking.keypoint_evidence import MIN_CONFIDENCE, KeypointModel
from hypose.tracking.keypoint_offsets import OffsetResiduals, residual_rows, solved_frames, triangulated_starts
from hypose.tracking.refinement import settled_start, solve_poses

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
_LEAST_FRAMES, _LEAST_ROWS, _LEAST_LEFT = 3, 8, 0.2
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
    left = max(1 - body.skeleton.dof / max(float(rows), 1.0), _LEAST_LEFT)
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
    kept, by_points, outlines = list[Keypoints](), list[Array](), list[PreparedFrame]()
    for frame, points, start in zip(frames, seen, starts, strict=True):
        if not np.isfinite(start).all():
            continue
        pose = solved_frames(body, model, [points], start[None])[0]
        prepared = prepare(replace(frame, keypoints=None), body, pose, prediction_weight=0.0)
        if prepared.silhouettes.seen:
            kept.append(points)
            by_points.append(pose)
            outlines.append(prepared)

    by_masks = [solve_poses(body, q[None], f, _SOLVE)[0].pose for q, f in zip(by_points, outlines, strict=True)]
    shape = len(kept), body.skeleton.dof
    return kept, np.array(by_points).reshape(shape), np.array(by_masks).reshape(shape)


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
