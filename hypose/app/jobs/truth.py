"""Comparison of a tracked motion with the truth.npz of a synthetic recording (`hypose synth`, `hypose demo`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.body.ready_bodies import human
from hypose.errors import InputError
from hypose.geometry import Array
from hypose.io.motions.results import load_archive
from hypose.synthetic.metrics import joint_errors, population_offsets

_MAX_BYTES = 1 << 30
"""that a truth.npz may unpack to."""
NOTE = (
    "The truth is another body (its shape does not come from the tracker's), so joint definitions are aligned once by "
    "fixed offsets, measured between the mean bodies and not on this recording."
)


@dataclass(frozen=True)
class Truth:
    """What a synthetic recording knows: distances (T, K) m between true and found joints, their names (K), and the true
    pelvis path (T, 3) m; joints (T, J, 3) m, world, and their parents (J), when there are more than the pelvis."""

    distances: Array
    names: tuple[str, ...]
    pelvis: Array
    note: str = ""
    joints: Array | None = field(default=None, kw_only=True)
    parents: Sequence[int] = field(default=(), kw_only=True)

    @property
    def mean_mm(self) -> float:
        """Mean over frames and joints, mm."""
        return float(np.nanmean(self.distances)) * 1000


def compare_with(path: str | Path, first: int = 0) -> Callable[[Motion, Body], Truth]:
    """A function that measures a motion, whose row 0 is frame `first`, against the truth in a truth.npz."""
    return lambda motion, body: compare_with_truth(path, motion, first)


def compare_with_truth(path: str | Path, motion: Motion, first: int = 0) -> Truth:
    """A motion, whose row 0 is frame `first`, against the truth in a truth.npz."""
    path = Path(path)
    step = "make the recording again"
    data = load_archive(path, "truth", step, ("joints", "stature"), _MAX_BYTES)
    try:
        joints, stature = np.asarray(data["joints"], dtype=np.float64), float(data["stature"])
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} is no truth of hypose ({error}); {step}.") from None
    if motion.poses is None:
        raise InputError("The motion holds joint positions only and cannot be compared; track again.")
    joints = joints[first : first + len(motion)]
    found = motion.joints[: len(joints)]
    rotations, _ = motion.skeleton.forward(motion.poses[: len(joints)])
    errors = joint_errors(found, joints, population_offsets(human()) * stature, rotations)
    parents = human().skeleton.parents.tolist()
    return Truth(errors.distances, errors.names, joints[:, 0], NOTE, joints=joints, parents=parents)
