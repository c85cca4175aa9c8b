"""Whole clips: all frames of a motion together, smooth without lag, gaps bridged with growing uncertainty.

A tracker looks at one frame after the other; here every frame knows what comes after it, too. What the tracker found
is summed up frame by frame as a Gaussian (the solved pose and the curvature there); key points alone, which are few,
are used as they are (`hypose.tracking.keypoint_clip`). Frames are coupled by what bodies do: accelerations and speeds
are limited. This is a smoother and no low-pass filter: where the evidence is sharp it is followed, where it is weak
its neighbours decide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.skeleton import Skeleton
from hypose.compute import frame_covariances
from hypose.fitting import PointTerm, SolveSettings, fit_clip
from hypose.fitting.clip_solve import Coupling, Gaussian
from hypose.geometry import Array, nearest_branch

_FARTHEST_M = 2.0
"""m: sd of the place of somebody who has not been seen for long; of an angle it is 1 rad"""


@dataclass(frozen=True)
class ClipSettings:
    """acceleration_m, speed_m: usual acceleration (m/s^2) and speed (m/s) of the root; acceleration_rad, speed_rad: of
    angles (rad/s^2, rad/s); window, overlap: frames solved together, and how many are shared by two windows. Chosen on
    synthetic scenes (walk, box, run, combo; seeds 20 to 22)."""

    acceleration_m: float = 12.0
    acceleration_rad: float = 60.0
    speed_m: float = 3.0
    speed_rad: float = 12.0
    window: int = 400
    overlap: int = 40


def acceleration_weight(skeleton: Skeleton, frame_rate: float, settings: ClipSettings) -> Array:
    """(D,) weights of squared second differences at a frame rate (Hz)."""
    usual = np.r_[np.full(3, settings.acceleration_m), np.full(skeleton.dof - 3, settings.acceleration_rad)]
    return (frame_rate**2 / usual) ** 2


def speed_weight(skeleton: Skeleton, frame_rate: float, settings: ClipSettings) -> Array:
    """(D,) weights of squared first differences at a frame rate (Hz)."""
    usual = np.r_[np.full(3, settings.speed_m), np.full(skeleton.dof - 3, settings.speed_rad)]
    return (frame_rate / usual) ** 2


def smooth_poses(
    body: Body,
    poses: Array,
    information: Array,
    frame_rate: float,
    settings: ClipSettings | None = None,
    contacts: Sequence[PointTerm | None] | None = None,
) -> Array:
    """Poses (T, D) of a clip from those of its frames (T, D) and what is known of each: information (T, D, D), zero in
    frames without evidence, whose pose does not matter. contacts: points that hold still, per frame."""
    settings = settings or ClipSettings()
    weight, slow = (f(body.skeleton, frame_rate, settings) for f in (acceleration_weight, speed_weight))
    known = np.asarray(information.any((1, 2)))
    given = bridged(poses, known)
    terms = [Gaussian(q, i) if k else None for q, i, k in zip(given, information, known, strict=True)]
    options = SolveSettings(iterations=6, coarse_iterations=0, damping=1e-6)

    def solve(part: slice) -> Array:
        held = None if contacts is None else contacts[part]
        return fit_clip(
            body,
            given[part],
            points=held,
            gaussians=terms[part],
            acceleration=weight,
            velocity=slow,
            options=options,
        )

    return in_windows(given, settings, solve)


def gap_covariance(
    body: Body, poses: Array, information: Array, frame_rate: float, settings: ClipSettings | None = None
) -> Array:
    """(T, J, 3, 3) m^2: what coupling to the neighbours leaves open of each joint's centre in frames that know
    nothing by themselves (information zero), growing with the distance from those that do; 0 in the others."""
    settings = settings or ClipSettings()
    weight, slow = (f(body.skeleton, frame_rate, settings) for f in (acceleration_weight, speed_weight))
    out = np.zeros((len(poses), len(body.skeleton.joint_names), 3, 3))
    blind = ~np.asarray(information.any((1, 2)))
    if not blind.any():
        return out
    least = np.diag(np.r_[np.full(3, _FARTHEST_M), np.ones(body.skeleton.dof - 3)] ** -2.0)

    def solve(part: slice) -> Array:
        n = part.stop - part.start
        covariance = frame_covariances(information[part] + least, Coupling(n, weight, slow).bands)
        assert covariance is not None
        spread = np.zeros((n, *out.shape[1:]))
        for t in np.flatnonzero(blind[part]):
            spread[t] = body.skeleton.joint_covariances(poses[part.start + t], covariance[t])
        return spread

    return in_windows(out, settings, solve)


def bridged(poses: Array, known: NDArray[np.bool_]) -> Array:
    """Poses with straight lines across frames that are not known."""
    out = poses.copy()
    if not known.any():
        return out
    at = np.flatnonzero(known)
    for a, b in zip(at[:-1], at[1:], strict=True):
        end = out[b].copy()
        end[3:6] = nearest_branch(end[3:6], out[a, 3:6])
        share = (np.arange(a + 1, b) - a)[:, None] / (b - a)
        out[a + 1 : b] = (1 - share) * out[a] + share * end
    out[: at[0]], out[at[-1] + 1 :] = out[at[0]], out[at[-1]]
    return out


def in_windows(like: Array, settings: ClipSettings, solve: Callable[[slice], Array]) -> Array:
    """solve(part), arrays as `like` (T, ...), of overlapping windows, faded over where two overlap, so that memory and
    time grow with the clip's length only linearly."""
    t, out = len(like), np.zeros_like(like)
    step = settings.window - settings.overlap
    first = 0
    while True:
        last = min(first + settings.window, t)
        if t - last < settings.overlap:
            last = t
        found = solve(slice(first, last))
        n = min(settings.overlap, last - first) if first else 0
        fade = ((np.arange(n) + 1.0) / (n + 1.0)).reshape(-1, *[1] * (like.ndim - 1))
        out[first : first + n] = (1 - fade) * out[first : first + n] + fade * found[:n]
        out[first + n : last] = found[n:]
        if last == t:
            return out
        first += step
