"""A search of one limb at a time: many poses of it about the one that it is in, of which the best is kept."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hypose.body.skeleton import Skeleton
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.kernels import HeavyTail, every, reflect
from hypose.tracking.costs import limb_energy
from hypose.tracking.frame_evidence import PreparedFrame
from hypose.tracking.refinement import COMPOSITE, SOLVED


@dataclass(frozen=True)
class LimbSearch:
    """Kernel: a greedy step of a search of single limbs. The limb takes Gaussian steps in all hypotheses, in a share
    `long` of them `longer` times as long, and in a share `again` it is drawn again between lower and upper (D,); then
    that of the best is all people's, with the rest of each body as it was.

    The hypothesis in the role SOLVED never moves, and the one in the role COMPOSITE is tried as it is, so that the
    search never loses its start. skeleton; joints: of the limb, by name; sigma (D,): sd of a step. With a budget of
    tens of hypotheses, resampling would leave most of them on values that are known to be worse. Shares are spread
    evenly over the set. Poses that are certainly worse than the first hypothesis are not measured.
    """

    skeleton: Skeleton
    joints: tuple[str, ...]
    sigma: Array
    lower: Array
    upper: Array
    redrawn: float = 0.0
    long: float = 0.3
    longer: float = 4.0

    @cached_property
    def own(self) -> NDArray[np.int64]:
        """(d,) the limb's coordinates."""
        return self.skeleton.dofs_of(*self.joints)

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """(J,) the limb's joints."""
        s = self.skeleton
        return np.isin(np.arange(len(s.joint_names)), [s.joint(j) for j in self.joints])

    @cached_property
    def _tail(self) -> HeavyTail:
        return HeavyTail(self.long, self.longer, np.ones(len(self.own), np.bool_))

    def __call__(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """The set with the best limb."""
        s, own = self.skeleton, self.own
        limb = h.values[:, own]
        steps = rng.standard_normal(limb.shape) * self.sigma[own]
        self._tail.stretch(steps, np.arange(len(own)), len(own))
        tried = reflect(limb + steps, s.lower[own], s.upper[own])
        if self.redrawn > 0:
            rows, low, high = every(self.redrawn, h.count), self.lower[own], self.upper[own]
            tried[rows] = low + (high - low) * rng.random((len(rows), len(own)))
        solved = h.has(SOLVED)
        staying = solved | h.has(COMPOSITE)
        tried[staying] = limb[staying]
        values = h.values.copy()
        values[:, own] = tried
        energies = limb_energy(values, frame, self.moving)
        best = np.where(np.isfinite(energies), energies, np.inf).argmin()
        values[:, own] = np.where(solved[:, None], limb, tried[best])
        return h.equal(values)
