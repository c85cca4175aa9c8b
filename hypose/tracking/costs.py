"""Costs of hypotheses on the evidence of a frame: the silhouette XOR and what is read off it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose import compute
from hypose.body.body import Body
from hypose.evidence.terms import KeypointTerm
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.depth_costs import DEPTH_COSTS, MEASURED, depth_cost, depth_views, with_limb_depth
from hypose.tracking.frame_evidence import PoseMemory, PreparedFrame


@dataclass(frozen=True)
class SilhouetteXor:
    """Energy E = sum over usable views of XOR(M_v, S_v) / C(S_v), so that the weight is exp(-E).

    M_v: silhouette of the posed coarse mesh in view v, S_v: the mask, C: its foreground pixels (those expected of the
    whole person where others hide a part: pixels that say nothing count nowhere). With no usable view
    every hypothesis costs the same (0). Source: Alcoverro 2014, eq. 2.8. What the user's own evidence says, if there is
    any, is added.
    """

    def __call__(self, h: Hypotheses, frame: PreparedFrame, /) -> Array:
        """(N,) energies of h.values (N, D)."""
        return frame_energy(h.values, frame)


def frame_energy(
    poses: Array,
    frame: PreparedFrame,
    moving: NDArray[np.bool_] | None = None,
    rest: compute.Standing | None = None,
) -> Array:
    """(N,) what poses (N, D) of the frame's body cost: eq. 2.8, what depth cameras say, and the user's own evidence.
    moving (J,) bool: the joints that differ in the poses; everything else stands as in the last one and is drawn once.
    rest: what does not move, where it has been drawn."""
    return evidence_energy(frame.body, poses, frame, moving, rest) + frame.own_energy(poses)


def evidence_energy(
    body: Body,
    poses: Array,
    frame: PreparedFrame,
    moving: NDArray[np.bool_] | None = None,
    rest: compute.Standing | None = None,
) -> Array:
    """(N,) the same of any body, without the user's own evidence."""
    cost = xor_energy(body, poses, frame, moving, rest)
    return cost if frame.depth is None else cost + depth_cost(body, poses, frame)


def limb_energy(
    poses: Array,
    frame: PreparedFrame,
    moving: NDArray[np.bool_],
    rest: compute.Standing | None = None,
    slack: float = 1.0,
    rest_depth: compute.StandingDepth | None = None,
) -> Array:
    """`frame_energy` where only what costs at most `slack` times as much as the first pose counts: others may be
    infinite. rest_depth: as rest, before depth cameras."""
    if frame.masks is None or frame.own or (frame.depth is not None and len(poses) <= MEASURED):
        return frame_energy(poses, frame, moving, rest)
    body, masks = frame.body, frame.masks

    def outlines(slack: float, more: float = 0.0) -> Array:
        return compute.limb_energies(poses, body.skeleton.tree, body.coarse.arrays, masks, moving, rest, slack, more)

    if frame.depth is None:
        return outlines(slack)
    return with_limb_depth(body, poses, frame, moving, outlines, rest_depth)


def xor_energy(
    body: Body,
    poses: Array,
    frame: PreparedFrame,
    moving: NDArray[np.bool_] | None = None,
    rest: compute.Standing | None = None,
) -> Array:
    """(N,) energies of eq. 2.8 for poses (N, D); zeros when no view is usable. moving, rest: as for `frame_energy`."""
    if frame.masks is None:
        return np.zeros(len(poses))
    counts = _counts(body, poses, frame) if moving is None else _count(body, poses, frame.masks, moving, rest)
    use = frame.masks.usable
    return (counts[:, use, 0] / frame.masks.norm[use]).sum(1)


def keypoint_cost(body: Body, poses: Array, term: KeypointTerm) -> Array:
    """(N,) what the key points of a frame cost poses (N, D) of a body: the robust cost of the solver, in which a
    difference of 1 is a difference of 1 in log-likelihood."""
    rotations, centres = body.skeleton.forward(poses)
    x = centres[:, term.joint] + np.einsum("nkab,kb->nka", rotations[:, term.joint], term.offset)
    h = np.einsum("cij,nkj->ncki", term.projections[:, :, :3], x) + term.projections[:, None, :, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        away = np.linalg.norm(h[..., :2] / h[..., 2:] - term.points[..., :2], axis=-1)
    away = np.where(h[..., 2] > 0, np.nan_to_num(away, nan=np.inf), np.inf)
    ratio = np.minimum(away / (2 * term.scale_px), 1e3)  # a point behind a camera is as far off as can be
    used = np.where(term.points[..., 2] > term.min_confidence, term.points[..., 2], 0.0)
    return 2 * (used * np.log1p(ratio**2)).sum((1, 2))


def silhouette_iou(body: Body, pose: Array, frame: PreparedFrame) -> Array:
    """(C,) intersection over union of the posed body and the mask per view; NaN for views without a usable mask, or in
    which others hide nearly all of the body. Over the pixels that say something."""
    if frame.masks is None:
        return np.full(0, np.nan)
    memory: PoseMemory[Array] = frame.shared.setdefault(_OVERLAPS, PoseMemory())
    known = memory.get(body, pose)
    return memory.keep(body, pose, _overlap(body, pose, frame, frame.masks)) if known is None else known


def _overlap(body: Body, pose: Array, frame: PreparedFrame, masks: compute.PreparedMasks) -> Array:
    counts = _counts(body, pose[None], frame)[0]
    union = counts[:, 0] + counts[:, 2]  # XOR and intersection are disjoint
    with np.errstate(invalid="ignore", divide="ignore"):
        use = masks.usable
        if masks.hidden.size:
            use = use & (counts[:, 1] > VISIBLE * masks.norm)
        return np.where(use, counts[:, 2] / union, np.nan)


def same_cost(body: Body, pose: Array, other: Array, frame: PreparedFrame) -> None:
    """What has been found out about a pose (D,) holds for another, which differs from it in the last digits alone."""
    for memory in (frame.counts, frame.shared.get(_OVERLAPS), frame.shared.get(DEPTH_COSTS)):
        if memory is not None:
            memory.same(body, pose, other)


_IN_LANES = 8
"""From so many numbers on numpy adds them in another order."""


def mean_overlap(body: Body, pose: Array, frame: PreparedFrame) -> float:
    """Mean IoU over the views that tell; 0 when none does."""
    return _mean_of_known(silhouette_iou(body, pose, frame), 0.0)


def _mean_of_known(overlap: Array, otherwise: float) -> float:
    """np.nanmean, bit by bit; of a few numbers, which numpy adds one after the other as well, many times sooner."""
    if len(overlap) >= _IN_LANES:
        return float(np.nanmean(overlap)) if np.isfinite(overlap).any() else otherwise
    total, count = 0.0, 0
    for one in overlap.tolist():
        if one == one:  # a number
            total, count = total + one, count + 1
    return total / count if count else otherwise


def agreement(body: Body, pose: Array, frame: PreparedFrame) -> float:
    """How well a pose (D,) agrees with the masks: mean IoU over the views, less half of what it is off in depth where
    depth cameras see; NaN when no view tells. Who stands back to front has nearly the same outline, but other
    depths."""
    mean = _mean_of_known(silhouette_iou(body, pose, frame), float("nan"))
    if frame.depth is None or np.isnan(mean):
        return mean
    return mean - 0.5 * float(depth_cost(body, pose[None], frame)[0]) / depth_views(frame)


VISIBLE = 0.2
"""Share of a body that must be visible in a view which is to tell of its overlap."""
_OVERLAPS = "overlaps"
"""What is kept in a frame's `shared`: the overlap of single poses, asked for several times."""
_REMEMBERED_POSES = 12
"""sets of no more poses are looked up, and remembered: the same pose is judged several times in a frame"""


def _counts(body: Body, poses: Array, frame: PreparedFrame) -> NDArray[np.int64]:
    assert frame.masks is not None
    if len(poses) > _REMEMBERED_POSES:
        return _count(body, poses, frame.masks)
    masks = frame.masks
    return frame.counts.all(body, poses, lambda new: _count(body, new, masks))


def _count(
    body: Body,
    poses: Array,
    masks: compute.PreparedMasks,
    moving: NDArray[np.bool_] | None = None,
    rest: compute.Standing | None = None,
) -> NDArray[np.int64]:
    flat = np.ascontiguousarray(poses, dtype=np.float64)
    return compute.silhouette_xor(flat, body.skeleton.tree, body.coarse.arrays, masks, moving=moving, rest=rest)
