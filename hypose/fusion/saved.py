"""A clip that is partly fused, as plain arrays: so that a long one can be interrupted and gone on with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from hypose.errors import InputError
from hypose.fusion.confidence import ConfidenceState
from hypose.fusion.fit import FitState
from hypose.fusion.register import Registration
from hypose.fusion.state import FusedFrame, FusionState
from hypose.fusion.swarm import SwarmState
from hypose.inference.hypotheses import Hypotheses

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
