"""Trace of a clip: which pass moved which joint in which frames, by how much and why."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing

from hypose.body.motion import Motion
from hypose.geometry import Array
from hypose.pipeline.settings import SETTINGS
from hypose.tracking.contacts import runs


@dataclass(frozen=True)
class Change:
    """Frames in which one pass moved one joint.

    stage: name of the pass.
    joint: name of the joint.
    frames: frames of the clip, counted from 0.
    moved: largest displacement in these frames, m.
    reason: why the pass moved it.
    """

    stage: str
    joint: str
    frames: range
    moved: float
    reason: str

    def document(self) -> dict[str, Any]:
        """Return the change as JSON values; lengths in millimetres."""
        frames = [self.frames.start, self.frames.stop]
        moved = round(1e3 * self.moved)
        return {"pass": self.stage, "joint": self.joint, "frames": frames, "moved_mm": moved, "reason": self.reason}


def list_changes(
    stage: str, names: Sequence[str], moved: Array, reason: str, at: NDArray[np.bool_] | None = None
) -> tuple[Change, ...]:
    """List the runs of frames in which a pass moved joints by more than SETTINGS.trace_least_m.

    stage: name of the pass.
    names: names of the J joints.
    moved: (T, J) displacements, m.
    reason: why the pass moved them.
    at: (T,) frames to consider; None: all.
    """
    large = np.asarray(moved) > SETTINGS.trace_least_m
    large = large if at is None else large & at[:, None]
    closed = np.asarray(binary_closing(np.pad(large, ((2, 2), (0, 0))), np.ones((3, 1))), dtype=bool)[2:-2]
    found = [(name, j, r) for j, name in enumerate(names) for r in runs(closed[:, j])]
    return tuple(Change(stage, name, r, float(moved[r.start : r.stop, j].max()), reason) for name, j, r in found)


def trace_of(motion: Motion) -> tuple[Change, ...]:
    """Read the trace from a motion's provenance; empty where none was recorded."""
    kept: Iterable[Mapping[str, Any]] = motion.provenance.get("trace", ())
    return tuple(
        Change(str(c["pass"]), str(c["joint"]), range(*c["frames"]), float(c["moved_mm"]) / 1e3, str(c["reason"]))
        for c in kept
    )


def with_trace(motion: Motion, trace: Iterable[Change]) -> Motion:
    """Return the motion with this trace in its provenance, in place of the trace before."""
    return replace(motion, provenance={**motion.provenance, "trace": [change.document() for change in trace]})


def later(trace: Iterable[Change], frames: int) -> tuple[Change, ...]:
    """Add `frames` to all frame numbers of a trace."""
    return tuple(replace(c, frames=range(c.frames.start + frames, c.frames.stop + frames)) for c in trace)
