"""What fusion is told, what it remembers of a stream, and what it says of one instant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.errors import InputError
from hypose.fusion import joints as jt
from hypose.fusion.confidence import ConfidenceState
from hypose.fusion.fit import FitSettings, FitState
from hypose.fusion.register import Registration
from hypose.fusion.swarm import IMPROVED, PUBLISHED, SwarmSettings, SwarmState
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses

FIT, SWARM, PUBLISHED_SWARM, PUBLISHED_WINDOW = "fit", "swarm", "published", "published-window"
METHODS = (FIT, SWARM, PUBLISHED_SWARM, PUBLISHED_WINDOW)


@dataclass(frozen=True)
class FusionSettings:
    """method: one of METHODS ("swarm" is the improved one; "published" is Asteriadis et al. 2013 with their
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
        if self.method not in METHODS:
            raise InputError(f"There is no fusion method {self.method!r}; choose one of {', '.join(METHODS)}.")

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
    frames: int = 0


_FRAME = tuple(f.name for f in fields(FusedFrame) if f.name != "joint_names")


@dataclass(frozen=True)
class ClipSoFar:
    """The state of a clip's fusion after the frames that are fused so far."""

    state: FusionState
    frames: Sequence[FusedFrame]

    def arrays(self) -> dict[str, np.ndarray]:
        """Everything that differs from a clip's start; equal states give equal arrays."""
        state, out = self.state, {}
        for name in ("up", "heading", "frames"):
            _put(out, name, getattr(state, name))
        for part in ("registration", "fit", "confidence", "swarm"):
            value = getattr(state, part)
            for f in fields(value) if value is not None else ():
                inner = getattr(value, f.name)
                if isinstance(inner, Hypotheses):
                    for name in ("values", "log_weights", "origin"):
                        _put(out, f"{part}.{f.name}.{name}", getattr(inner, name))
                else:
                    _put(out, f"{part}.{f.name}", inner)
        for name in _FRAME if self.frames else ():
            series = [getattr(f, name) for f in self.frames]
            if series[0] is not None:
                out[f"frame.{name}"] = np.array(series)
        return out


def restored(arrays: Mapping[str, np.ndarray], begun: FusionState) -> ClipSoFar:
    """What `ClipSoFar.arrays` put away, for the clip whose fusion starts with `begun`. An InputError when the arrays
    are not those of such a clip."""
    try:
        state = replace(
            begun,
            up=_get(arrays, "up"),
            heading=_get(arrays, "heading"),
            frames=int(arrays["frames"]),
            registration=Registration(**_part(arrays, "registration", Registration)),
            fit=FitState(**_part(arrays, "fit", FitState)),
            confidence=None
            if begun.confidence is None
            else ConfidenceState(**_part(arrays, "confidence", ConfidenceState)),
            swarm=None if begun.swarm is None else SwarmState(**_swarm(arrays)),
        )
        _check(state, begun)
        frames = tuple(
            FusedFrame(joint_names=begun.joint_names, **{name: _at(arrays, name, t) for name in _FRAME})
            for t in range(state.frames)
        )
    except (KeyError, ValueError, TypeError, IndexError) as error:
        raise InputError(
            f"What was fused so far does not belong to this clip ({error}); fuse it from its start."
        ) from None
    return ClipSoFar(state, frames)


def _put(out: dict[str, np.ndarray], name: str, value: Any) -> None:
    if value is not None:
        out[name] = np.asarray(value)


def _get(arrays: Mapping[str, np.ndarray], name: str) -> Any:
    """The value, None when it was; numbers without dimensions as plain ones."""
    value = arrays.get(name)
    return value.item() if value is not None and value.ndim == 0 else value


def _part(arrays: Mapping[str, np.ndarray], part: str, kind: type) -> dict[str, Any]:
    return {f.name: _get(arrays, f"{part}.{f.name}") for f in fields(kind)}


def _swarm(arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    out = _part(arrays, "swarm", SwarmState)
    if "swarm.candidates.values" in arrays:
        values, log_weights, origin = (arrays[f"swarm.candidates.{n}"] for n in ("values", "log_weights", "origin"))
        out["candidates"] = Hypotheses(values, log_weights, origin)
    return out


def _check(state: FusionState, begun: FusionState) -> None:
    """Arrays of other sensors would only fail far inside."""
    for part in ("registration", "fit", "confidence", "swarm"):
        new, old = getattr(state, part), getattr(begun, part)
        for f in fields(old) if old is not None else ():
            a, b = getattr(new, f.name), getattr(old, f.name)
            if isinstance(b, np.ndarray) and (not isinstance(a, np.ndarray) or a.shape != b.shape):
                raise ValueError(f"{part}.{f.name} has another shape")
    if state.frames < 0:
        raise ValueError("a negative number of frames")


def _at(arrays: Mapping[str, np.ndarray], name: str, t: int) -> Any:
    if name == "choice" and "frame.choice" not in arrays:
        return None
    value = arrays[f"frame.{name}"][t]
    return value.item() if value.ndim == 0 else value
