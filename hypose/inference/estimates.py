"""Reading one state and its uncertainty off a weighted set whose coordinates include rotation vectors.

Angles may not be averaged across +-pi as plain numbers: rotations are averaged on SO(3), the rest as vectors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hypose.geometry import nearest_branch, so3_exp, so3_log
from hypose.inference.hypotheses import FloatArray, Hypotheses


@dataclass(frozen=True)
class TangentMean:
    """Weighted mean with the rotation vectors at columns ``rotations`` .. +2 averaged on SO(3) (Karcher
    mean).

    An Estimate for states (*B, N, D) whose listed blocks are rotation vectors (rad); every other coordinate
    is averaged as it is. The rotation vectors of the result are on the branch next to the hypothesis of
    largest weight.
    """

    rotations: tuple[int, ...] = ()
    iterations: int = 20

    def __call__(self, h: Hypotheses, /) -> FloatArray:
        """The mean state (*B, D)."""
        mean, best = h.mean(), h.best()
        for start in self.rotations:
            block = slice(start, start + 3)
            rotations, centre = so3_exp(h.values[..., block]), so3_exp(best[..., block])
            for _ in range(self.iterations):
                deviation = so3_log(rotations @ np.swapaxes(centre, -1, -2)[..., None, :, :])
                step = np.einsum("...n,...nd->...d", h.weights, deviation)
                centre = so3_exp(step) @ centre
                if np.abs(step).max() < 1e-12:
                    break
            mean[..., block] = nearest_branch(so3_log(centre), best[..., block])
        return mean

    def deviations(self, h: Hypotheses, centre: FloatArray) -> FloatArray:
        """(*B, N, D) tangent vectors from a centre (*B, D) to the states: rotations as exp(d) centre, in
        rad.
        """
        out = h.values - centre[..., None, :]
        for start in self.rotations:
            block = slice(start, start + 3)
            middle = np.swapaxes(so3_exp(centre[..., block]), -1, -2)[..., None, :, :]
            out[..., block] = so3_log(so3_exp(h.values[..., block]) @ middle)
        return out

    def covariance(self, h: Hypotheses, centre: FloatArray) -> FloatArray:
        """(*B, D, D) weighted second moment of the deviations from a centre (*B, D), in its tangent space."""
        deviation = self.deviations(h, centre)
        return np.einsum("...nd,...ne->...de", h.weights[..., None] * deviation, deviation)
