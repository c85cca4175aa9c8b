"""The monocular tracker: one frame at a time, from a set of hypotheses to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.cameras.camera import Camera
from hypose.monocular.settings import MonoSettings
from hypose.monocular.types import MonoEstimate, MonoFrame, MonoHypotheses, MonoState


@dataclass(frozen=True)
class MonoTracker:
    """A body, the camera (lens distortion is ignored: give undistorted pictures), settings, and the dof to estimate
    (default `body_dofs`: 30); the others keep their start values."""

    body: Body
    camera: Camera
    settings: MonoSettings = MonoSettings()
    active: NDArray[np.int64] | None = None

    def start(self, hypotheses: MonoHypotheses, frame: MonoFrame | None = None) -> MonoState:
        """The state before the first step; with a frame (the one the hypotheses belong to) flow is used at once."""
        raise NotImplementedError

    def step(self, state: MonoState, frame: MonoFrame, rng: np.random.Generator) -> tuple[MonoState, MonoEstimate]:
        """One frame: predict, optimise every hypothesis, sample along uncertain directions, pool and prune."""
        raise NotImplementedError

    def optimise(self, hypotheses: MonoHypotheses, frame: MonoFrame, *, iterations: int = 20) -> MonoHypotheses:
        """Poses optimised on one still picture (edges, silhouette, points; no flow, no prediction), best first: for
        initialisation and for mirrored poses."""
        raise NotImplementedError

    def flips(self, hypotheses: MonoHypotheses) -> MonoHypotheses:
        """The hypotheses and all their mirrored limbs, not yet optimised (forward/backward ambiguity)."""
        raise NotImplementedError
