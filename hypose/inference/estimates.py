"""Reading one state and its uncertainty off a weighted set whose coordinates include rotation vectors.

Angles may not be averaged across +-pi as plain numbers: rotations are averaged on SO(3), the rest as vectors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.geometry import nearest_branch
from hypose.inference.hypotheses import FloatArray, Hypotheses


@dataclass(frozen=True)
class TangentMean:
    """Weighted mean with the rotation vectors at columns ``rotations`` .. +2 averaged on SO(3) (Karcher
    mean).

    An Estimate for states (*B, N, D) whose listed blocks are rotation vectors (rad); every other coordinate
    is averaged as it is. The rotation vectors of the result are on the branch next to the hypothesis of
    largest weight. A tangent vector d at a centre c stands for the rotation exp(d) exp(c). With sets spread
    over more than half a turn the mean is a local one, next to that hypothesis.
    """

    rotations: tuple[int, ...] = ()
    iterations: int = 30

    def __call__(self, h: Hypotheses, /) -> FloatArray:
        """The mean state (*B, D)."""
        mean = h.mean()
        if not self.rotations:
            return mean
        columns, weights = self._columns(), h.weights
        best = h.best()[..., columns]
        quaternions, centre = _quaternion(h.values[..., columns]), _quaternion(best)
        for _ in range(self.iterations):
            deviation = _log(_times_inverse(quaternions, centre[..., None, :, :]))
            step = np.einsum("...n,...nrd->...rd", weights, deviation)
            centre = _times_inverse(_quaternion(step), centre * [1.0, -1.0, -1.0, -1.0])
            if np.abs(step).max() < 1e-10:
                break
        mean[..., columns] = nearest_branch(_log(centre), best)
        return mean

    def deviations(self, h: Hypotheses, centre: FloatArray) -> FloatArray:
        """(*B, N, D) tangent vectors from a centre (*B, D) to the states; rotations in rad."""
        out = h.values - centre[..., None, :]
        if self.rotations:
            columns = self._columns()
            middle = _quaternion(centre[..., columns])[..., None, :, :]
            out[..., columns] = _log(_times_inverse(_quaternion(h.values[..., columns]), middle))
        return out

    def covariance(self, h: Hypotheses, centre: FloatArray) -> FloatArray:
        """(*B, D, D) weighted second moment of the deviations from a centre (*B, D), in its tangent space."""
        deviation = self.deviations(h, centre)
        return np.einsum("...nd,...ne->...de", h.weights[..., None] * deviation, deviation)

    def _columns(self) -> NDArray[np.intp]:
        """(R, 3) the columns of the rotation vectors."""
        return np.asarray(self.rotations, dtype=np.intp)[:, None] + np.arange(3)


# Unit quaternions (w, x, y, z) rather than matrices: whole populations are averaged in every frame, and their
# products are a few array operations where those of small matrices are a call each.
def _quaternion(rotation_vector: FloatArray) -> FloatArray:
    half = 0.5 * np.linalg.norm(rotation_vector, axis=-1, keepdims=True)
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * rotation_vector], axis=-1)


def _times_inverse(a: FloatArray, b: FloatArray) -> FloatArray:
    """The product of a with the inverse of b, both (..., 4)."""
    aw, av, bw, bv = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    w = aw * bw + np.sum(av * bv, axis=-1, keepdims=True)
    return np.concatenate([w, bw * av - aw * bv - np.cross(av, bv)], axis=-1)


def _log(quaternion: FloatArray) -> FloatArray:
    """Rotation vector (..., 3) of norm at most pi."""
    q = np.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    length = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    small = length < 1e-12
    return np.where(small, 2.0, 2 * np.arctan2(length, q[..., :1]) / np.where(small, 1.0, length)) * q[..., 1:]
