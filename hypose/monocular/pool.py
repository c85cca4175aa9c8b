"""The pool of hypotheses: samples along uncertain directions, pruning to the best distinct ones, covariances.

Source: Sminchisescu & Triggs 2001, section 4.2 and figure 4. Deviations: samples of all hypotheses are pooled before
pruning (the printed listing empties the pool for each), costs are accumulated over frames with a memory, and directions
are those of the Hessian within the subspace that no limit holds, in units of the usual motion of each dof.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.compute import mono
from hypose.geometry import Array
from hypose.monocular.settings import SearchSettings
from hypose.monocular.types import MonoHypotheses

LEAST_CURVATURE = 1e-6
"""of the Hessian in units of the usual motion: directions without any evidence"""


@dataclass(frozen=True)
class Candidate:
    """One member of the pool. pose, velocity, prediction (D,); hessian (A, A) of the evidence where it (or its parent)
    was optimised, free (A,) dof that no limit held there; cost in this frame, evidence accumulated; label."""

    pose: Array
    velocity: Array
    prediction: Array
    hessian: Array
    free: NDArray[np.bool_]
    cost: float
    evidence: float
    label: int


def uncertain_samples(
    candidate: Candidate,
    active: NDArray[np.int64],
    spread: Array,
    lower: Array,
    upper: Array,
    settings: SearchSettings,
    rng: np.random.Generator,
) -> Array:
    """Poses (S, D) along the n_s most uncertain free directions of an optimised candidate, on both sides.

    Deviation: directions are those of the Hessian within the subspace that no limit holds, in units of the usual motion
    of each dof. spread (A,): the usual error of a prediction, the unit of each dof and the bound on a sample's
    length."""
    free = np.flatnonzero(candidate.free)
    if len(free) == 0:
        return np.zeros((0, len(candidate.pose)))
    unit = spread[free]
    values, vectors = mono.eigen(candidate.hessian[np.ix_(free, free)] * unit[:, None] * unit)
    out = []
    for j in range(min(settings.directions, len(free))):
        direction = vectors[:, j]
        if settings.isotropic:
            direction = rng.normal(size=len(free))
            direction /= np.linalg.norm(direction)
        step = unit * direction / np.sqrt(max(values[j], LEAST_CURVATURE))
        reach = min(settings.reach, settings.longest / float(np.abs(step / unit).max()))
        for p in range(1, settings.samples + 1):
            for sign in (-1.0, 1.0):
                pose = candidate.pose.copy()
                pose[active[free]] += sign * reach * p / settings.samples * step
                pose[active] = np.clip(pose[active], lower, upper)
                out.append(pose)
    return np.array(out)


def prune(pool: list[Candidate], body: Body, settings: SearchSettings) -> list[Candidate]:
    """The best distinct candidates, at most settings.hypotheses, best first; pool: the best optimised one comes
    first and stays, the others are ranked by their accumulated evidence.

    Deviation: samples of all hypotheses are pooled before pruning, where the printed listing empties the pool for each.
    Deviation: only poses that differ are kept."""
    ranked = pool[:1] + sorted(pool[1:], key=lambda c: c.evidence)
    places = landmark_places(body, np.stack([c.pose for c in ranked]))
    kept: list[int] = []
    for i in range(len(ranked)):
        if all(np.linalg.norm(places[i] - places[k], axis=-1).max() > settings.distinct_m for k in kept):
            kept.append(i)
        if len(kept) == settings.hypotheses:
            break
    return [ranked[i] for i in kept]


def landmark_places(body: Body, poses: Array) -> Array:
    """(N, L, 3) m: joint centres and landmarks, by which poses are told apart."""
    return np.concatenate([body.joints(poses), body.landmark_points(poses)], axis=1)


def pose_covariance(hessian: Array, spread: Array, active: NDArray[np.int64], dof: int, inflation: float) -> Array:
    """(D, D) covariance of a pose: inflation^2 H^-1 over the active dof, 0 elsewhere."""
    values, vectors = mono.eigen(hessian * spread[:, None] * spread)
    root = spread[:, None] * vectors / np.sqrt(np.maximum(values, LEAST_CURVATURE))
    out = np.zeros((dof, dof))
    out[np.ix_(active, active)] = inflation**2 * np.einsum("ik,jk->ij", root, root)
    return out


def as_hypotheses(candidates: list[Candidate], covariances: Array) -> MonoHypotheses:
    """Candidates as a weighted set, weights exp(-evidence): equation (4), whose Z is the sum over the set.

    Deviation: the evidence is accumulated over frames with a memory."""
    evidence = np.array([c.evidence for c in candidates])
    evidence = evidence - evidence.min()
    weights = np.exp(-evidence)
    return MonoHypotheses(
        np.stack([c.pose for c in candidates]),
        np.stack([c.velocity for c in candidates]),
        covariances,
        weights / weights.sum(),
        np.array([c.cost for c in candidates]),
        evidence,
        np.array([c.label for c in candidates], dtype=np.int8),
    )
