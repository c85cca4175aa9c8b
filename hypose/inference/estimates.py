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
        columns, weights = self._columns(), h.weights[..., None]
        best = h.best()[..., columns]
        quaternions, centre = _quaternion(_first(h.values[..., columns])), _quaternion(_first(best))
        for _ in range(self.iterations):
            deviation = _log(_times_inverse(quaternions, centre[..., None, :]))
            step = (weights * deviation).sum(-2)
            centre = _times_inverse(_quaternion(step), _inverse(centre))
            if np.abs(step).max() < 1e-10:
                break
        mean[..., columns] = nearest_branch(np.moveaxis(_log(centre), 0, -1), best)
        return mean

    def deviations(self, h: Hypotheses, centre: FloatArray) -> FloatArray:
        """(*B, N, D) tangent vectors from a centre (*B, D) to the states; rotations in rad."""
        out = h.values - centre[..., None, :]
        if self.rotations:
            columns = self._columns()
            middle = _quaternion(_first(centre[..., columns]))[..., None, :]
            away = _log(_times_inverse(_quaternion(_first(h.values[..., columns])), middle))
            out[..., columns] = np.moveaxis(away, 0, -1)
        return out

    def covariance(self, h: Hypotheses, centre: FloatArray) -> FloatArray:
        """(*B, D, D) weighted second moment of the deviations from a centre (*B, D), in its tangent space."""
        deviation = self.deviations(h, centre)
        return np.einsum("...nd,...ne->...de", h.weights[..., None] * deviation, deviation)

    def _columns(self) -> NDArray[np.intp]:
        """(R, 3) the columns of the rotation vectors."""
        return np.asarray(self.rotations, dtype=np.intp)[:, None] + np.arange(3)


# Unit quaternions (w, x, y, z) rather than matrices, each component an array of its own: whole populations are averaged
# in every frame, and their products are a few operations on long arrays.
def _first(vectors: FloatArray) -> FloatArray:
    """(..., 3) -> (3, ...), contiguous."""
    return np.ascontiguousarray(np.moveaxis(vectors, -1, 0))


def _length(vectors: FloatArray) -> FloatArray:
    x, y, z = vectors
    return np.sqrt(x * x + y * y + z * z)


def _quaternion(rotation_vectors: FloatArray) -> FloatArray:
    """(3, ...) -> (4, ...)"""
    half = 0.5 * _length(rotation_vectors)
    return np.concatenate([np.cos(half)[None], 0.5 * np.sinc(half / np.pi) * rotation_vectors])


def _inverse(quaternions: FloatArray) -> FloatArray:
    return np.concatenate([quaternions[:1], -quaternions[1:]])


def _times_inverse(a: FloatArray, b: FloatArray) -> FloatArray:
    """The product of a with the inverse of b, both (4, ...)."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return np.stack(
        [
            aw * bw + ax * bx + ay * by + az * bz,
            bw * ax - aw * bx - (ay * bz - az * by),
            bw * ay - aw * by - (az * bx - ax * bz),
            bw * az - aw * bz - (ax * by - ay * bx),
        ]
    )


def _log(quaternions: FloatArray) -> FloatArray:
    """(4, ...) -> rotation vectors (3, ...) of length at most pi."""
    q = np.where(quaternions[:1] < 0, -quaternions, quaternions)
    length = _length(q[1:])
    small = length < 1e-12
    return np.where(small, 2.0, 2 * np.arctan2(length, q[0]) / np.where(small, 1.0, length)) * q[1:]
