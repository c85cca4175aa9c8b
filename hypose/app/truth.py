"""Comparison of a tracked motion with the truth.npz of a synthetic recording (`hypose synth`, `hypose demo`)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from hypose.app.plots import Truth
from hypose.body.body import Body
from hypose.body.models import human
from hypose.body.motion import Motion
from hypose.errors import InputError
from hypose.evaluation.metrics import joint_errors, population_offsets

NOTE = (
    "The truth is another body (its shape does not come from the tracker's), so joint definitions are aligned once by "
    "fixed offsets, measured between the mean bodies and not on this recording."
)


def compare_with(path: str | Path, first: int = 0) -> Callable[[Motion, Body], Truth]:
    """A function that measures a motion, whose row 0 is frame `first`, against the truth in a truth.npz."""
    path = Path(path)

    def compare(motion: Motion, body: Body) -> Truth:
        try:
            with np.load(path, allow_pickle=False) as data:
                joints, stature = np.asarray(data["joints"], dtype=np.float64), float(data["stature"])
        except (OSError, ValueError, KeyError) as error:
            raise InputError(f"{path} is no truth of hypose ({error}); make the recording again.") from None
        if motion.poses is None:
            raise InputError("The motion holds joint positions only and cannot be compared; track again.")
        joints = joints[first : first + len(motion)]
        found = motion.joints[: len(joints)]
        rotations, _ = motion.skeleton.forward(motion.poses[: len(joints)])
        errors = joint_errors(found, joints, population_offsets(human()) * stature, rotations)
        return Truth(errors.distances, errors.names, joints[:, 0], NOTE)

    return compare
