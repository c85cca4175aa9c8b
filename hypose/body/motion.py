"""Motion: the result that every tracker and every fusion returns, and that every writer takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.joint_angles import ANGLE_NAMES
from hypose.body.skeleton import Skeleton, check_shapes
from hypose.geometry import Array

TAILS = 7.0
"""Degrees of freedom of the Student t distribution of the errors.

Clips differ in how well they fit, so that most errors are smaller, and some larger, than in a normal distribution with
the same 90 % regions. Chosen on scenes (docs/decisions/error-model.md).
"""


def region_reach(level: ArrayLike, dimensions: int = 3) -> Array:
    """Compute the Mahalanobis distance (in standard deviations) to which the confidence region of a level reaches.

    level: probability of the region, 0 to 1.
    dimensions: 3 for the position of a joint, 1 for one coordinate or an angle.
    Returns: standard deviations. At 0.9 those of a normal distribution, 2.50 and 1.64, to which covariances are fitted;
        at other levels those of a Student t distribution with TAILS degrees of freedom that agrees with it there.
    """
    from scipy.special import betaincinv, gammaincinv  # takes long to import

    def squared(at: ArrayLike) -> Array:  # quantile of the F distribution, up to a factor
        x = betaincinv(dimensions / 2, TAILS / 2, at)
        return np.asarray(x / (1 - x))

    return np.sqrt(2 * gammaincinv(dimensions / 2, 0.9) * squared(level) / squared(0.9))


@dataclass(frozen=True)
class Motion:
    """Tracked motion in the world frame (metres, seconds, radians; z up): T frames, J joints, D degrees of freedom.

    skeleton: the joint tree.
    times: (T,) s.
    joints: (T, J, 3) m, joint centres in the world.
    poses: (T, D) pose vectors, rad and m; None where only points are known.
    joint_covariance: (T, J, 3, 3) m^2, covariance of each joint's position in the world, NaN where unknown; float32,
        because long recordings have many frames. `region_reach` gives how far its regions reach.
    lost: (T,) whether the person was not found.
    extrapolated: (T,) whether the frame is a prediction without evidence.
    n_views: (T,) number of views with evidence.
    cost: (T,) remaining cost by the method's own measure, NaN where it has none.
    provenance: recipe, versions, seed, hashes of the inputs, as plain JSON values.
    low_confidence: (T,) whether the evidence of the frame contradicts itself (pictures that repeat or jump, views that
        disagree), or a joint is doubtful; None: not judged.
    error_probability: (T, J) probability that the joint is wrong by more than 100 mm; None: not judged.
    low_confidence_joints: (T, J) whether that probability is too large to be ignored; None: not judged.
    angle_sd: (T, A) rad, standard deviation of the joint angles (body.joint_angles; m for positions); None: not known.
    systematic_covariance: (T, J, 3, 3) m^2, the part of joint_covariance that more views of this kind and more frames
        would not reduce (definition of the joint, errors common to all views, calibration); None: not known.
    rivals: (T, K, D) other poses that the evidence of a frame allows, best first, NaN where there are fewer; None where
        the method keeps none.
    rival_weights: (T, K) probabilities of the rivals; the pose has the rest (0: no rival).
    Raises: InputError where the shape of an array does not fit.
    """

    skeleton: Skeleton
    times: Array
    joints: Array
    poses: Array | None
    joint_covariance: NDArray[np.float32]
    lost: np.ndarray
    extrapolated: np.ndarray
    n_views: np.ndarray
    cost: Array
    provenance: Mapping[str, Any] = field(default_factory=dict)
    low_confidence: np.ndarray | None = None
    error_probability: NDArray[np.float32] | None = None
    low_confidence_joints: NDArray[np.bool_] | None = None
    angle_sd: NDArray[np.float32] | None = None
    systematic_covariance: NDArray[np.float32] | None = None
    rivals: NDArray[np.float32] | None = None
    rival_weights: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        t, j = len(self.times), len(self.skeleton.joint_names)
        expected = {
            "joints": (t, j, 3),
            "joint_covariance": (t, j, 3, 3),
            "lost": (t,),
            "extrapolated": (t,),
            "n_views": (t,),
            "cost": (t,),
        }
        optional = {
            "poses": (t, self.skeleton.dof),
            "low_confidence": (t,),
            "error_probability": (t, j),
            "low_confidence_joints": (t, j),
            "angle_sd": (t, len(ANGLE_NAMES)),
            "systematic_covariance": (t, j, 3, 3),
        }
        expected |= {name: shape for name, shape in optional.items() if getattr(self, name) is not None}
        if self.rivals is not None or self.rival_weights is not None:
            count = 0 if self.rival_weights is None else self.rival_weights.shape[-1]
            expected |= {"rivals": (t, count, self.skeleton.dof), "rival_weights": (t, count)}
        check_shapes(self, expected)

    def __len__(self) -> int:
        return len(self.times)

    @property
    def joint_sd(self) -> Array:
        """(T, J) m, standard deviation of each joint's position per axis (RMS over the axes); NaN where unknown."""
        return sd_per_axis(self.joint_covariance)

    @property
    def frame_rate(self) -> float:
        """Frames per second, from the median time step (1 for a single frame)."""
        return float(1 / np.median(np.diff(self.times))) if len(self.times) > 1 else 1.0


_PER_MODE = ("poses", "joints", "weights", "costs", "covariances")


@dataclass(frozen=True)
class Modes:
    """Poses (modes) that the evidence of each frame allows: T frames, at most K modes each, best first, NaN where there
    are fewer.

    poses: (T, K, D) pose vectors, rad and m.
    joints: (T, K, J, 3) m in the world.
    weights: (T, K), sum 1.
    costs: (T, K) negative log posterior given the evidence of the frame.
    covariances: (T, K, D, D) covariances of the poses, float32, the root's rotation as a small turn in the world.
    joint_covariance: (T, J, 3, 3) m^2, of the best mode.
    depth_sd: (T, J) m along the line of sight, of the best mode.
    alive: (T,) number of modes.
    Raises: InputError where the shape of an array does not fit.
    """

    poses: Array
    joints: Array
    weights: Array
    costs: Array
    covariances: NDArray[np.float32]
    joint_covariance: Array
    depth_sd: Array
    alive: NDArray[np.int64]

    def __post_init__(self) -> None:
        t, k, d = self.poses.shape
        j = self.joints.shape[2]
        wanted = {
            "joints": (t, k, j, 3),
            "weights": (t, k),
            "costs": (t, k),
            "covariances": (t, k, d, d),
            "joint_covariance": (t, j, 3, 3),
            "depth_sd": (t, j),
            "alive": (t,),
        }
        check_shapes(self, wanted)

    def __len__(self) -> int:
        return len(self.poses)

    def rows(self) -> list[Modes]:
        """Split into one `Modes` of one frame per frame, each with as many modes as the frame has."""
        single = [{k: v[t : t + 1] for k, v in modes_arrays(self).items()} for t in range(len(self))]
        return [
            Modes(**{k: v[:, :n] if k in _PER_MODE else v for k, v in one.items()})
            for one, n in zip(single, self.alive, strict=True)
        ]


def modes_arrays(modes: Modes) -> dict[str, np.ndarray]:
    """Return the fields of the modes as arrays by name, for archives and checkpoints."""
    return {f.name: np.asarray(getattr(modes, f.name)) for f in fields(Modes)}


def joined_modes(parts: Sequence[Modes]) -> Modes:
    """Join the modes of parts of a clip along the frames.

    parts: modes of consecutive frames, of one body.
    Returns: modes of all frames; frames with fewer modes than the most are filled with NaN.
    """
    most = max(p.poses.shape[1] for p in parts)

    def stacked(name: str) -> np.ndarray:
        arrays = []
        for part in parts:
            a = np.asarray(getattr(part, name))
            if name in _PER_MODE:
                a = np.pad(a, [(0, 0), (0, most - a.shape[1])] + [(0, 0)] * (a.ndim - 2), constant_values=np.nan)
            arrays.append(a)
        return np.concatenate(arrays)

    return Modes(**{f.name: stacked(f.name) for f in fields(Modes)})


def isotropic(joint_sd: ArrayLike) -> NDArray[np.float32]:
    """Make isotropic covariances (..., J, 3, 3) m^2 from standard deviations per axis (..., J) m."""
    return (np.asarray(joint_sd, dtype=np.float64)[..., None, None] ** 2 * np.eye(3)).astype(np.float32)


def sd_per_axis(joint_covariance: ArrayLike) -> Array:
    """Compute the RMS standard deviation (..., J) m over the axes, from covariances (..., J, 3, 3) m^2."""
    xx, yy, zz = (np.asarray(joint_covariance)[..., k, k].astype(np.float64) for k in range(3))
    return np.sqrt((xx + yy + zz) / 3)
