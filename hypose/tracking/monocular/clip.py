"""Whole clips of one camera: tracked backwards as well, both passes summed up frame by frame, and smoothed.

A tracker that looks at one frame after the other decides early which way a limb leans, and stays with it. The way back
comes from the other side and errs elsewhere, so the two together are nearer to the truth than either. Then the frames
are solved together, coupled by what bodies do (hypose.tracking.smoothing); errors last longer than a frame, so what
each frame says counts less than it claims.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.geometry import Array, nearest_branch
from hypose.tracking.monocular.evidence import grey
from hypose.tracking.monocular.tracker import MonoTracker
from hypose.tracking.monocular.types import OPTIMISED, MonoEstimate, MonoFrame, MonoHypotheses, MonoState
from hypose.tracking.smoothing import ClipSettings

_HELD = 1e8
"""1/rad^2: how well dof are known that are not estimated"""


@dataclass(frozen=True)
class WholeClip:
    """How the two passes are put together; chosen on arm seeds 100 to 106 and body seeds 100 to 103.

    temperature: of a frame's costs, by which the passes are weighed; settled: s after which the start is forgotten, so
    that the way back counts as much as the way there; widening: of the covariances of single frames, whose errors last;
    motion: usual accelerations and speeds."""

    temperature: float = 4.0
    settled: float = 2.0
    widening: float = 4.0
    motion: ClipSettings = ClipSettings(acceleration_rad=24.0)


class Modes(NamedTuple):
    """The modes of T frames, NaN where a frame has fewer than K: poses (T, K, D), weights, costs (T, K), covariances
    (T, K, D, D)."""

    poses: Array
    weights: Array
    costs: Array
    covariances: NDArray[np.floating]


def backwards(
    tracker: MonoTracker,
    last: MonoHypotheses,
    count: int,
    frame: Callable[[int], MonoFrame],
    rng: Callable[[int], np.random.Generator],
) -> Iterator[MonoEstimate]:
    """Estimates of the frames count - 2 to 0 of a clip, from the modes of its last one. frame, rng: of an index."""
    labels = np.full(len(last), OPTIMISED, dtype=np.int8)
    begin = replace(last, velocities=-last.velocities, labels=labels)
    state = MonoState(0, begin, grey(frame(count - 1).image))
    for index in range(count - 2, -1, -1):
        state, estimate = tracker.step(state, frame(index), rng(index))
        yield estimate


def together(there: Modes, back: Modes, frame_rate: float, settings: WholeClip | None = None) -> tuple[Array, Array]:
    """Poses (T, D) and covariances (T, D, D) of both passes over a clip; the last frame of `back` is not looked at."""
    o = settings or WholeClip()
    first, own = summed_up(there)
    second, other = summed_up(back, first)
    second[-1], other[-1] = first[-1], own[-1]
    age = (1 + np.arange(len(first))) / frame_rate
    worse = np.clip((there.costs[:, 0] - back.costs[:, 0]) / o.temperature, -30, 30)
    worse[-1] = 0.0
    share = 1 / (1 + (1 - np.exp(-age / o.settled)) * np.exp(worse))
    apart = first - second
    between = share * (1 - share)
    poses = second + share[:, None] * apart
    within = share[:, None, None] * own + (1 - share)[:, None, None] * other
    return poses, within + between[:, None, None] * apart[:, :, None] * apart[:, None, :]


def summed_up(modes: Modes, near: Array | None = None) -> tuple[Array, Array]:
    """Mean (T, D) and covariance (T, D, D) of the modes of every frame; near (T, D): poses on whose branch the root's
    rotation vectors are (default: that of the best mode)."""
    seen = np.isfinite(modes.weights)
    weights = np.where(seen, modes.weights, 0.0)
    poses = np.where(seen[..., None], modes.poses, modes.poses[:, :1])
    reference = poses[:, 0] if near is None else near
    poses[..., 3:6] = nearest_branch(poses[..., 3:6], np.repeat(reference[:, None, 3:6], poses.shape[1], axis=1))
    mean = np.einsum("tk,tkd->td", weights, poses)
    whole = np.zeros((*mean.shape, mean.shape[1]))
    for k in range(poses.shape[1]):  # mode by mode: all at once would take gigabytes for a long clip
        off = poses[:, k] - mean
        own = np.where(seen[:, k, None, None], modes.covariances[:, k], 0.0)
        whole += weights[:, k, None, None] * (own + off[:, :, None] * off[:, None, :])
    return mean, whole


def information(covariances: ArrayLike, active: NDArray[np.int64], settings: WholeClip | None = None) -> Array:
    """(T, D, D) what frames say of their poses, for solving the clip: from covariances (T, D, D) over the active dof
    (A,); the others are held."""
    o, given = settings or WholeClip(), np.asarray(covariances, dtype=np.float64)
    out = np.zeros_like(given)
    held = np.setdiff1d(np.arange(given.shape[1]), active)
    out[:, held, held] = _HELD
    rows, columns = np.ix_(active, active)
    out[:, rows, columns] = np.linalg.inv(o.widening * given[:, rows, columns])
    return out
