"""Manage the pool of candidates: mark, join, sample along uncertain directions, prune to the best distinct ones.

Columns of a candidate:
    velocity, prediction: (D,).
    hessian: (A, A) of the evidence, where the candidate (or the one it was drawn from) was optimised.
    free: (A,) dof that no joint limit held there.
    cost: in this frame; evidence: the cost accumulated over the frames.
    nodes: counts of its contour nodes, as in MonoWorkspace.
Source: Sminchisescu & Triggs 2001, section 4.2 and figure 4. Deviations: samples of all hypotheses are pooled before
    pruning (the printed listing empties the pool for each); costs are accumulated over frames with a memory;
    directions are those of the Hessian in the subspace that no limit holds, in units of each dof's usual motion.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.resampling import distinct
from hypose.tracking.frame_evidence import PreparedFrame
from hypose.tracking.monocular.settings import SearchSettings

OPTIMISED, SAMPLED, MIRRORED = _ROLES = ("optimised", "sampled", "mirrored")
"""Origin of a hypothesis: optimised, drawn along an uncertain direction, or a mirrored limb."""
LEAST_CURVATURE = 1e-6
"""smallest eigenvalue of the Hessian in units of the usual motion; replaces smaller ones, in directions without
evidence"""


def candidates(role: str, poses: Array, **columns: NDArray[Any]) -> Hypotheses:
    """Make a set of N candidates from poses; all log-weights are 0.

    role: origin of all candidates: "optimised", "sampled" or "mirrored".
    poses: (N, D) one pose per candidate.
    columns: (N, ...) further values per candidate, by name.
    """
    bit = np.full(len(poses), 1 << _ROLES.index(role), dtype=np.int32)
    return Hypotheses(poses, np.zeros(len(poses)), role=bit, role_names=_ROLES, columns=columns)


def pooled(*sets: Hypotheses) -> Hypotheses:
    """Join several sets of candidates into one set, and set all log-weights to 0."""
    return Hypotheses(
        np.concatenate([h.values for h in sets]),
        np.zeros(sum(h.count for h in sets)),
        role=np.concatenate([h.role for h in sets]),
        role_names=_ROLES,
        columns={name: np.concatenate([h.columns[name] for h in sets]) for name in sets[0].columns},
    )


def accumulated(h: Hypotheses, frame: PreparedFrame, /) -> Array:
    """Compute the log-likelihoods (N,) of candidates: minus the cost accumulated over the frames so far.

    Source: equation (4); its Z is the sum over the set. Deviation: evidence is accumulated over frames with a
        memory.
    """
    return -h.columns["evidence"]


def uncertain_samples(
    pose: Array,
    hessian: Array,
    free: NDArray[np.bool_],
    active: NDArray[np.int64],
    spread: Array,
    lower: Array,
    upper: Array,
    settings: SearchSettings,
) -> Array:
    """Draw poses along the most uncertain free directions of an optimised candidate, on both sides of it.

    settings: settings of the search.
    pose: (D,) the candidate's pose.
    hessian: (A, A) of its evidence.
    free: (A,) true where no joint limit holds the dof.
    active: (A,) indices of the estimated dof.
    spread: (A,) usual error of a prediction; the unit of each dof and the bound on a sample's length.
    lower, upper: (A,) joint limits.
    Returns: (S, D) poses.
    Deviation: directions are those of the Hessian in the subspace that no limit holds, in units of each dof's usual
        motion.
    """
    loose = np.flatnonzero(free)
    if len(loose) == 0:
        return np.zeros((0, len(pose)))
    unit = spread[loose]
    values, vectors = np.linalg.eigh(hessian[np.ix_(loose, loose)] * unit[:, None] * unit)
    out = []
    for j in range(min(settings.directions, len(loose))):
        step = unit * vectors[:, j] / np.sqrt(max(values[j], LEAST_CURVATURE))
        reach = min(settings.reach, settings.longest / float(np.abs(step / unit).max()))
        for p in range(1, settings.samples + 1):
            for sign in (-1.0, 1.0):
                moved = pose.copy()
                moved[active[loose]] += sign * reach * p / settings.samples * step
                moved[active] = np.clip(moved[active], lower, upper)
                out.append(moved)
    return np.array(out).reshape(-1, len(pose))


def best_of(pool: Hypotheses) -> int:
    """Find the index of the best candidate that is not a sample."""
    return int(np.where(pool.has(SAMPLED), np.inf, pool.columns["evidence"]).argmin())


def prune(pool: Hypotheses, body: Body, settings: SearchSettings) -> Hypotheses:
    """Keep the best distinct candidates, at most settings.hypotheses, best first.

    pool: all candidates of the frame.
    body: by whose joints and landmarks poses are compared.
    settings: settings of the search.

    The best optimised candidate is always kept and comes first; the others are ranked by their accumulated evidence.
    Deviations: samples of all hypotheses are pooled before pruning, where the printed listing empties the pool for
        each; only poses that differ are kept.
    """
    first = best_of(pool)
    others = np.delete(np.arange(pool.count), first)
    ranked = np.array([first, *others[np.argsort(pool.columns["evidence"][others], kind="stable")]])
    places = np.concatenate([body.joints(pool.values[ranked]), body.landmark_points(pool.values[ranked])], axis=1)
    return pool.take(ranked[distinct(places, settings.hypotheses, settings.distinct_m)])


def hessian_covariance(hessian: Array, spread: Array, active: NDArray[np.int64], dof: int, inflation: float) -> Array:
    """Compute the covariance (D, D) of a pose: inflation^2 H^-1 over the active dof, 0 elsewhere.

    hessian: (A, A).
    spread: (A,) usual error of a prediction, the unit in which small eigenvalues are replaced.
    dof: D.
    """
    values, vectors = np.linalg.eigh(hessian * spread[:, None] * spread)
    root = spread[:, None] * vectors / np.sqrt(np.maximum(values, LEAST_CURVATURE))
    out = np.zeros((dof, dof))
    out[np.ix_(active, active)] = inflation**2 * np.einsum("ik,jk->ij", root, root)
    return out
