"""Motion: what every tracker and every fusion returns, and every writer takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hypose.body.skeleton import Skeleton
from hypose.errors import InputError
from hypose.geometry import Array


@dataclass(frozen=True)
class Motion:
    """A tracked motion in the world frame (metres, seconds, radians; z up).

    skeleton: the joint tree. times: (T,) s. joints: (T, J, 3) joint centres, world. poses: (T, D) or None when only
    points are known. joint_sd: (T, J) standard deviation of each joint's position per axis (root mean square over the
    axes), m; NaN where unknown. lost: (T,) the person was not found. extrapolated: (T,) no evidence, prediction only.
    n_views: (T,) number of views that carried evidence. cost: (T,) remaining cost of the method's own measure (NaN when
    none). provenance: recipe, versions, seed, inputs' hashes: plain JSON values. doubtful: (T,) the evidence speaks
    against itself (pictures that repeat or jump, views that disagree), or None: not looked at.
    """

    skeleton: Skeleton
    times: Array
    joints: Array
    poses: Array | None
    joint_sd: Array
    lost: np.ndarray
    extrapolated: np.ndarray
    n_views: np.ndarray
    cost: Array
    provenance: Mapping[str, Any] = field(default_factory=dict)
    doubtful: np.ndarray | None = None

    def __post_init__(self) -> None:
        t, j = len(self.times), len(self.skeleton.joint_names)
        expected = {
            "joints": (t, j, 3),
            "joint_sd": (t, j),
            "lost": (t,),
            "extrapolated": (t,),
            "n_views": (t,),
            "cost": (t,),
        }
        if self.doubtful is not None:
            expected["doubtful"] = (t,)
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise InputError(
                    f"Motion.{name} has shape {getattr(self, name).shape}, {shape} is needed; "
                    "give every array one row per frame."
                )
        if self.poses is not None and self.poses.shape != (t, self.skeleton.dof):
            raise InputError(
                f"Motion.poses has shape {self.poses.shape}, {(t, self.skeleton.dof)} is needed; "
                "give one pose per frame in the skeleton's degrees of freedom."
            )

    def __len__(self) -> int:
        return len(self.times)

    @property
    def frame_rate(self) -> float:
        """Frames per second, from the median time step (1 for a single frame)."""
        return float(1 / np.median(np.diff(self.times))) if len(self.times) > 1 else 1.0
