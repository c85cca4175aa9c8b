"""What fusion is told, what it remembers of a stream, and what it says of one instant."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hypose.errors import InputError
from hypose.fusion import joints as jt
from hypose.fusion.confidence import ConfidenceState
from hypose.fusion.fit import FitSettings, FitState
from hypose.fusion.register import Registration
from hypose.fusion.swarm import IMPROVED, PUBLISHED, SwarmSettings, SwarmState
from hypose.geometry import Array

FIT, SWARM, PUBLISHED_SWARM, PUBLISHED_WINDOW = "fit", "swarm", "published", "published-window"
FUSION_METHODS = (FIT, SWARM, PUBLISHED_SWARM, PUBLISHED_WINDOW)


@dataclass(frozen=True)
class FusionSettings:
    """method: one of FUSION_METHODS ("swarm" is the improved one; "published" is Asteriadis et al. 2013 with their
    registration, by the triangle of every frame; "published-window" the same swarm, registered as the other methods
    are); reference: the sensor whose frame is the common one; registered: positions come in a common frame already;
    window_s, refit_s: a stream's registration uses the last window_s and is refitted every refit_s;
    diagnose: run the swarm beside the fit and report its choice of sensors; up (3,): direction of up in the common
    frame, default from the person; seed: of the swarm; check: refuse sensors that see different people."""

    method: str = FIT
    reference: int = 0
    registered: bool = False
    window_s: float = 5.0
    refit_s: float = 1.0
    diagnose: bool = False
    up: tuple[float, float, float] | None = None
    seed: int = 0
    check: bool = True
    fit: FitSettings = field(default_factory=FitSettings)
    swarm: SwarmSettings | None = None

    def __post_init__(self) -> None:
        if self.method not in FUSION_METHODS:
            raise InputError(f"There is no fusion method {self.method!r}; choose one of {', '.join(FUSION_METHODS)}.")

    @property
    def swarm_settings(self) -> SwarmSettings:
        """The swarm's settings: given ones, else those of the method."""
        return self.swarm or (PUBLISHED if self.method in (PUBLISHED_SWARM, PUBLISHED_WINDOW) else IMPROVED)

    @property
    def per_frame(self) -> bool:
        """Every frame is registered by its own triangle."""
        return self.method == PUBLISHED_SWARM and not self.registered


@dataclass(frozen=True)
class FusedFrame:
    """One instant. time s; joint_names (J,): the 15 common ones, then the sensor's others; joints (J, 3) m in the
    common frame, NaN where never seen; sd (J,) m per axis, of which systematic (J,) would remain with more frames or
    sensors, and wrong (J,): how likely the joint is off by more than trust.WRONG_M, NaN where unknown; shares (15, K):
    what each sensor carried of each common joint (fit: weights; swarm: population); choice (15, K) the swarm's
    population when it runs as diagnosis; lost; n_sensors with evidence; swapped (K,) sensors whose sides were
    exchanged; restarted: the swarm was initialised again."""

    time: float
    joint_names: tuple[str, ...]
    joints: Array
    sd: Array
    systematic: Array
    wrong: Array
    shares: Array
    choice: Array | None
    lost: bool
    n_sensors: int
    swapped: NDArray[np.bool_]
    restarted: bool


@dataclass(frozen=True)
class FusionState:
    """Everything a stream remembers. window: recent (positions, state, time) for the registration; heading: smoothed
    heading rad; swarm and confidence None unless the swarm runs; fixed_registration: do not refit; rest: indices of the
    set's joints beyond the common ones; joint_names: of the fused joints."""

    settings: FusionSettings
    sensor_names: tuple[str, ...]
    joint_set: jt.JointSet
    registration: Registration
    next_refit: float
    window: tuple[tuple[Array, NDArray[np.uint8], float], ...]
    fit: FitState
    swarm: SwarmState | None
    confidence: ConfidenceState | None
    up: Array | None
    heading: float | None
    fixed_registration: bool
    rest: NDArray[np.int64]
    joint_names: tuple[str, ...]
