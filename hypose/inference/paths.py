"""Paths through hypotheses over time: which of the states of each step belong together, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hypose.inference.hypotheses import FloatArray


def likeliest_path(costs: Sequence[FloatArray], steps: Sequence[FloatArray]) -> tuple[list[int], list[FloatArray]]:
    """The states of least cost, one of each time, and the probability of each state, (N_t,) per time.

    costs: negative log-likelihoods (N_t,) of the states of each time t; steps: of going from each to each of the next
    time (N_t, N_t+1), one fewer. Source: Viterbi 1967; forward and backward sums, Baum et al. 1970.
    """
    best, came = [costs[0]], list[np.ndarray]()
    ahead = [-costs[0]]
    for step, cost in zip(steps, costs[1:], strict=True):
        reached = best[-1][:, None] + step
        came.append(reached.argmin(0))
        best.append(reached.min(0) + cost)
        ahead.append(np.logaddexp.reduce(ahead[-1][:, None] - step, 0) - cost)
    path = [int(best[-1].argmin())]
    weights = [_shares(ahead[-1])]
    after = np.zeros(len(costs[-1]))
    for t in range(len(steps) - 1, -1, -1):
        path.append(int(came[t][path[-1]]))
        after = np.logaddexp.reduce(after - costs[t + 1] - steps[t], 1)
        weights.append(_shares(ahead[t] + after))
    return path[::-1], weights[::-1]


def _shares(log: FloatArray) -> FloatArray:
    share = np.exp(log - log.max())
    return share / share.sum()
