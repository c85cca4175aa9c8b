"""Compute the costs of hypotheses on the evidence of a frame: the silhouette XOR and values derived from it."""

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
    """Energy of hypotheses on silhouettes: E = sum over usable views of XOR(M_v, S_v) / C(S_v), so that the weight is
    exp(-E).

    M_v: silhouette of the posed coarse mesh in view v; S_v: the mask; C: its number of foreground pixels (those
        expected of the whole person where others hide a part; ignored pixels count nowhere).
    All hypotheses cost 0 where no view is usable. The energies of depth and of the user's own evidence are added.
    Source: Alcoverro 2014, eq. 2.8.
    """

    def __call__(self, h: Hypotheses, frame: PreparedFrame, /) -> Array:
        """Compute the energies (N,) of h.values (N, D)."""
        return frame_energy(h.values, frame)


def frame_energy(
    poses: Array,
    frame: PreparedFrame,
    moving: NDArray[np.bool_] | None = None,
    rest: Standing | None = None,
) -> Array:
    """Compute the energies (N,) of poses (N, D) of the frame's body on all its evidence.

    The evidence is silhouettes (eq. 2.8), depth and the user's own.
    moving: (J,) true for the joints that differ between the poses; all others are as in the last pose and drawn once.
    rest: the parts that do not move, where they are drawn already.
    """
    limb = None if moving is None else Limb(moving, rest)
    return evidence_energy(frame.body, poses, frame.evidence, limb)


def evidence_energy(body: Body, poses: Array, evidence: Iterable[Evidence], limb: Limb | None = None) -> Array:
    """Compute the sum (N,) of the energies of poses (N, D) of a body over all evidence given."""
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
    """Compute `frame_energy` for poses that differ in one limb, exact only for poses near the first one.

    poses: (N, D); moving: (J,) true for the joints that differ; rest: as for `frame_energy`.
    slack: poses that cost more than this many times the first pose may get an infinite energy.
    rest_depth: the parts that do not move, as depth cameras see them.
    """
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
"""numpy adds this many numbers, or more, in another order."""


def mean_overlap(body: Body, pose: Array, frame: PreparedFrame) -> float:
    """Compute the mean IoU of a pose with the masks over the views where it is known; 0 where there is none."""
    return _mean_of_known(frame.silhouettes.overlap(body, pose), 0.0)


def _mean_of_known(overlap: Array, otherwise: float) -> float:
    """Compute np.nanmean with the same bits, but faster for a few numbers.

    overlap: (C,) NaN where unknown; otherwise: the result where none is known.
    """
    if len(overlap) >= _IN_LANES:
        return float(np.nanmean(overlap)) if np.isfinite(overlap).any() else otherwise
    total, count = 0.0, 0
    for one in overlap.tolist():
        if one == one:  # a number
            total, count = total + one, count + 1
    return total / count if count else otherwise


def agreement(body: Body, pose: Array, frame: PreparedFrame) -> float:
    """Compute how well a pose (D,) agrees with masks and depth.

    Returns: mean IoU over the views minus half of the mean depth energy; NaN where no view is usable.
    Why: a person who stands back to front has nearly the same outline, but other depths.
    """
    mean, depth = _mean_of_known(frame.silhouettes.overlap(body, pose), float("nan")), frame.depth
    return mean - 0.5 * float(depth.energy(body, pose[None])[0]) / max(int(depth.views.sum()), 1)
