"""Compute one state, or the most probable sequence of states, from weighted sets.

Rotation vectors are averaged on SO(3) and all other coordinates as plain numbers, because angles must not be averaged
across +-pi.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import softmax

from hypose.geometry import nearest_branch, so3_exp, so3_log
from hypose.inference.hypotheses import FloatArray, Hypotheses

_KARCHER_STEPS = 30


def tangent_mean(h: Hypotheses, /, rotations: ArrayLike) -> FloatArray:
    """Compute the weighted mean state (*B, D) of a set, with rotation vectors averaged on SO(3) (Karcher mean).

    rotations: first column of each rotation vector (3 columns, rad) in the states (*B, N, D); all other columns are
        averaged as they are.

    The mean rotation vectors lie on the branch nearest to the hypothesis of largest weight. Where a set is spread over
    more than half a turn, the mean is a local one near that hypothesis.
    """
    columns = np.asarray(rotations, dtype=np.intp)[:, None] + np.arange(3)
    mean, best, weights = h.mean(), h.best()[..., columns], h.weights[..., None, None]
    rotation, centre = so3_exp(h.values[..., columns]), so3_exp(best)
    for _ in range(_KARCHER_STEPS):
        away = so3_log(rotation @ np.swapaxes(centre, -1, -2)[..., None, :, :, :])
        step = (weights * away).sum(-3)
        centre = so3_exp(step) @ centre
        if np.abs(step).max() < 1e-10:
            break
    mean[..., columns] = nearest_branch(so3_log(centre), best)
    return mean


def likeliest_path(costs: Sequence[FloatArray], steps: Sequence[FloatArray]) -> tuple[list[int], list[FloatArray]]:
    """Find the sequence of states of least total cost (Viterbi), and the probability of every state.

    costs: for each time t, the negative log-likelihoods (N_t,) of its states.
    steps: for each time but the last, the costs (N_t, N_t+1) of the transitions from each state to each state of the
        next time.
    Returns: the index of the chosen state of each time, and the probabilities (N_t,) of the states of each time.
    Source: Viterbi 1967; forward and backward sums, Baum et al. 1970.
    """
    best, came = [costs[0]], list[np.ndarray]()
    ahead = [-costs[0]]
    for step, cost in zip(steps, costs[1:], strict=True):
        reached = best[-1][:, None] + step
        came.append(reached.argmin(0))
        best.append(reached.min(0) + cost)
        ahead.append(np.logaddexp.reduce(ahead[-1][:, None] - step, 0) - cost)
    path = [int(best[-1].argmin())]
    weights = [softmax(ahead[-1])]
    after = np.zeros(len(costs[-1]))
    for t in range(len(steps) - 1, -1, -1):
        path.append(int(came[t][path[-1]]))
        after = np.logaddexp.reduce(after - costs[t + 1] - steps[t], 1)
        weights.append(softmax(ahead[t] + after))
    return path[::-1], weights[::-1]
