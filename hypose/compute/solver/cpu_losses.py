"""numba: the losses of compute.losses, compiled from their one definition."""

from __future__ import annotations

from hypose.compute.compiled import kernel
from hypose.compute.solver.losses import along as _along
from hypose.compute.solver.losses import geman_mcclure as _geman_mcclure
from hypose.compute.solver.losses import leclerc as _leclerc
from hypose.compute.solver.losses import lorentzian as _lorentzian
from hypose.compute.solver.losses import quadratic as _quadratic

along = kernel(_along)
geman_mcclure = kernel(_geman_mcclure)
leclerc = kernel(_leclerc)
lorentzian = kernel(_lorentzian)
quadratic = kernel(_quadratic)
