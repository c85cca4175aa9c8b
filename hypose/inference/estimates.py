"""Reading one state and its uncertainty off a weighted set whose coordinates include rotation vectors.

Angles may not be averaged across +-pi as plain numbers: rotations are averaged on SO(3), the rest as vectors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.geometry import nearest_branch, so3_exp, so3_log
from hypose.inference.hypotheses import FloatArray, Hypotheses


@dataclass(frozen=True)
class TangentMean:
    """Weighted mean with the rotation vectors at columns ``rotations`` .. +2 averaged on SO(3) (Karcher
    mean).

    An Estimate for states (*B, N, D) whose listed blocks are rotation vectors (rad); every other coordinate
    is averaged as it is. The rotation vectors of the result are on the branch next to the hypothesis of
    largest weight. With sets spread
    over more than half a turn the mean is a local one, next to that hypothesis.
    """

    rotations: tuple[int, ...] = ()
    iterations: int = 30

    def __call__(self, h: Hypotheses, /) -> FloatArray:
        """The mean state (*B, D)."""
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
        """(R, 3) the columns of the rotation vectors."""
        return np.asarray(self.rotations, dtype=np.intp)[:, None] + np.arange(3)
