"""Reading one state and its uncertainty off a weighted set whose coordinates include rotation vectors.

Angles may not be averaged across +-pi as plain numbers: rotations are averaged on SO(3), the rest as vectors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.geometry import nearest_branch, so3_exp, so3_log
from hypose.inference.hypotheses import FloatArray, Hypotheses


@dataclass(frozen=True)
class TangentMean:
    """Weighted mean with the rotation vectors at columns ``rotations`` .. +2 averaged on SO(3) (Karcher mean).

    An Estimate for states (*B, N, D) whose listed blocks are rotation vectors (rad); every other coordinate
    is averaged as it is. The rotation vectors lie on the branch nearest to the hypothesis of largest weight.
    With sets spread over more than half a turn the mean is a local one, near that hypothesis.
    """

    rotations: tuple[int, ...] = ()
    iterations: int = 30

    def __call__(self, h: Hypotheses, /) -> FloatArray:
        """Return the mean state (*B, D)."""
        mean = h.mean()
        if not self.rotations:
            return mean
        columns, weights = self._columns(), h.weights[..., None, None]
        best = h.best()[..., columns]
        rotations, centre = so3_exp(h.values[..., columns]), so3_exp(best)
        for _ in range(self.iterations):
            away = so3_log(rotations @ np.swapaxes(centre, -1, -2)[..., None, :, :, :])
            step = (weights * away).sum(-3)
            centre = so3_exp(step) @ centre
            if np.abs(step).max() < 1e-10:
                break
        mean[..., columns] = nearest_branch(so3_log(centre), best)
        return mean

    def _columns(self) -> NDArray[np.intp]:
        """Return (R, 3) the columns of the rotation vectors."""
        return np.asarray(self.rotations, dtype=np.intp)[:, None] + np.arange(3)


def likeliest_path(costs: Sequence[FloatArray], steps: Sequence[FloatArray]) -> tuple[list[int], list[FloatArray]]:
    """Return the states of least cost, one of each time, and the probability of each state, (N_t,) per time.

    costs: negative log-likelihoods (N_t,) of the states of each time t.
    steps: of going from each to each of the next time (N_t, N_t+1), one fewer.

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
