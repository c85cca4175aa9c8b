"""Costs of hypotheses on the evidence of a frame: the silhouette XOR and values derived from it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.compute.arrays import Standing
from hypose.compute.depth_costs import StandingDepth
from hypose.compute.scorer import limb_energies
from hypose.evidence.cues import MEASURED
from hypose.evidence.terms import Evidence, Limb
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.frame_evidence import PreparedFrame


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
    rest: Standing | None = None,
) -> Array:
    """(N,) what poses (N, D) of the frame's body cost by all its evidence: eq. 2.8, what depth cameras say, and the
    user's own. moving (J,) bool: the joints that differ in the poses; everything else stands as in the last one and is
    drawn once. rest: what does not move, where it has been drawn."""
    limb = None if moving is None else Limb(moving, rest)
    return evidence_energy(frame.body, poses, frame.evidence, limb)


def evidence_energy(body: Body, poses: Array, evidence: Iterable[Evidence], limb: Limb | None = None) -> Array:
    """(N,) what poses (N, D) of a body cost by all evidence given."""
    total = np.zeros(len(poses))
    for one in evidence:
        total += one.energy(body, poses, limb)
    return total


def limb_energy(
    poses: Array,
    frame: PreparedFrame,
    moving: NDArray[np.bool_],
    rest: Standing | None = None,
    slack: float = 1.0,
    rest_depth: StandingDepth | None = None,
) -> Array:
    """`frame_energy` where only what costs at most `slack` times as much as the first pose counts: others may be
    infinite. rest_depth: as rest, before depth cameras."""
    body, silhouettes, depth = frame.body, frame.silhouettes, frame.depth
    if not silhouettes.seen or (depth.seen and len(poses) <= MEASURED):
        return frame_energy(poses, frame, moving, rest)
    others = [one for one in frame.evidence if one is not silhouettes and one is not depth]
    other = evidence_energy(body, poses, others, Limb(moving, rest))
    given = poses, body.skeleton.tree, body.coarse.arrays, silhouettes.masks, moving, rest

    def outlines(slack: float, more: float = 0.0) -> Array:
        return limb_energies(*given, slack, more + slack * float(other[0]) - float(other.min())) + other

    return depth.limb_energy(body, poses, moving, outlines, rest_depth) if depth.seen else outlines(slack)


_IN_LANES = 8
"""From so many numbers on numpy adds them in another order."""


def mean_overlap(body: Body, pose: Array, frame: PreparedFrame) -> float:
    """Mean IoU over the views that tell; 0 when none does."""
    return _mean_of_known(frame.silhouettes.overlap(body, pose), 0.0)


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
    mean, depth = _mean_of_known(frame.silhouettes.overlap(body, pose), float("nan")), frame.depth
    return mean - 0.5 * float(depth.energy(body, pose[None])[0]) / max(int(depth.views.sum()), 1)
