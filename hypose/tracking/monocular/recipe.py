"""Build the recipe of one camera with several hypotheses (Sminchisescu & Triggs 2001), and solve whole clips.

A whole clip of one camera is also tracked backwards; both passes are averaged frame by frame, then all frames are
solved together with a model of motion (hypose.tracking.smoothing). Why: a tracker that sees one frame after the other
decides early whether a limb points to the camera or away, and keeps to it; the backward pass makes other errors, so
the average is nearer to the truth than either. Errors last longer than a frame, so single frames get less weight than
their covariances claim.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.motion import Modes, Motion
from hypose.evidence.frame import Frame
from hypose.geometry import Array, nearest_branch, so3_left_jacobian
from hypose.inference.layer import Layer, Recipe
from hypose.inference.resampling import keep
from hypose.tracking.monocular.picture_search import PictureSearch
from hypose.tracking.monocular.pool import OPTIMISED, accumulated, best_of
from hypose.tracking.monocular.settings import MonoSettings, body_dofs
from hypose.tracking.smoothing import Clip, ClipSettings, smooth_poses
from hypose.tracking.tracker import FrameEstimate, Tracker, TrackerState, modes_of

_HELD = 1e8
"""1/rad^2: information on dof that are not estimated, which fixes them"""


@dataclass(frozen=True)
class WholeClip:
    """Settings for joining the forward and the backward pass; chosen on arm seeds 100 to 106 and body seeds 100 to
    103.

    temperature: scale of the cost difference from which the weights of the passes are computed.
    settled: time after which the start pose has no more influence, s; from then on the backward pass counts as much
        as the forward pass.
    widening: factor on the covariances of single frames, because errors last longer than a frame.
    motion: usual accelerations and speeds; one round for the whole clip, since more would follow the noise of depth.
    """

    temperature: float = 4.0
    settled: float = 2.0
    widening: float = 4.0
    motion: ClipSettings = ClipSettings(acceleration_rad=24.0, rounds=1)


def solve_clip(clip: Clip, active: NDArray[np.int64]) -> tuple[Motion, tuple[str, ...]]:
    """Solve the motion of a whole clip from the modes of all frames of the forward and the backward pass.

    clip: tracked forwards, with its frames.

    Frames in which the person was lost are bridged. Feet are not held where they seem to stand, as they are with
    several cameras, because the depth of feet is too uncertain in one view.
    active: (A,) dof that are estimated.
    Returns: the motion; notes (none).
    """
    tracker, motion, total = clip.tracker, clip.motion, len(clip.motion)
    body = tracker.body
    modes = modes_of(clip.estimates)
    assert modes is not None
    back = modes
    if total > 2:
        found: list[FrameEstimate] = []
        for estimate in backward_estimates(tracker, clip.state, clip.frames(range(total - 2, -1, -1))):
            clip.progress(len(found), total - 1)
            found.append(estimate)
        the_way = modes_of([*reversed(found), clip.estimates[-1]])
        assert the_way is not None
        # the forward pass had no flow in the first picture, so its costs cannot be compared
        the_way.costs[0] = modes.costs[0, 0]
        back = the_way
        clip.progress(total - 1, total - 1)
    poses, covariances = together(modes, back, motion.frame_rate)
    known = information(covariances, active) * ~motion.lost[:, None, None]
    if total > 2 and not motion.lost.all():
        poses = smooth_poses(body, poses, known, motion.frame_rate, WholeClip.motion)
    around = np.stack([body.skeleton.joint_covariances(q, c) for q, c in zip(poses, covariances, strict=True)])
    solved = replace(motion, poses=poses, joints=body.joints(poses), joint_covariance=around.astype(np.float32))
    return solved, ()


def backward_estimates(tracker: Tracker, last: TrackerState, frames: Iterable[Frame]) -> Iterator[FrameEstimate]:
    """Track a clip backwards, from the state in its last frame.

    frames: all but the last frame, in reverse order; the picture `before` of each is that of the frame after it.
    """
    h = last.hypotheses
    turned = replace(h, columns={"velocity": -h.columns["velocity"]}).marked(OPTIMISED, np.arange(h.count))
    return (estimate for _, estimate in tracker.follow(tracker.start(turned), frames))


def together(there: Modes, back: Modes, frame_rate: float) -> tuple[Array, Array]:
    """Average the poses of the forward and the backward pass over a clip, weighted by their costs.

    frame_rate: Hz.
    there: modes of the forward pass; back: modes of the backward pass, whose last frame is not used.
    Returns: poses (T, D); covariances (T, D, D) of the average, including the difference of the passes.
    """
    first, own = summed_up(there)
    second, other = summed_up(back, first)
    second[-1], other[-1] = first[-1], own[-1]
    age = (1 + np.arange(len(first))) / frame_rate
    worse = np.clip((there.costs[:, 0] - back.costs[:, 0]) / WholeClip.temperature, -30, 30)
    worse[-1] = 0.0
    share = 1 / (1 + (1 - np.exp(-age / WholeClip.settled)) * np.exp(worse))
    apart = first - second
    between = share * (1 - share)
    poses = second + share[:, None] * apart
    apart = _by_turn(apart, poses)
    within = share[:, None, None] * own + (1 - share)[:, None, None] * other
    return poses, within + between[:, None, None] * apart[:, :, None] * apart[:, None, :]


def summed_up(modes: Modes, near: Array | None = None) -> tuple[Array, Array]:
    """Compute mean (T, D) and covariance (T, D, D) of the modes of every frame.

    near: (T, D) poses that choose the branch of the root's rotation vectors (default: the best mode of each frame).
    """
    seen = np.isfinite(modes.weights)
    weights = np.where(seen, modes.weights, 0.0)
    poses = np.where(seen[..., None], modes.poses, modes.poses[:, :1])
    reference = poses[:, 0] if near is None else near
    poses[..., 3:6] = nearest_branch(poses[..., 3:6], np.repeat(reference[:, None, 3:6], poses.shape[1], axis=1))
    mean = np.einsum("tk,tkd->td", weights, poses)
    whole = np.zeros((*mean.shape, mean.shape[1]))
    for k in range(poses.shape[1]):  # mode by mode, because all at once would need gigabytes for a long clip
        off = _by_turn(poses[:, k] - mean, mean)
        own = np.where(seen[:, k, None, None], modes.covariances[:, k], 0.0)
        whole += weights[:, k, None, None] * (own + off[:, :, None] * off[:, None, :])
    return mean, whole


def _by_turn(off: Array, poses: Array) -> Array:
    """Convert the root's rotation vector in differences (T, D) from poses (T, D) to a rotation in the world."""
    out = off.copy()
    out[:, 3:6] = np.einsum("tab,tb->ta", so3_left_jacobian(poses[:, 3:6]), off[:, 3:6])
    return out


def information(covariances: Array, active: NDArray[np.int64]) -> Array:
    """Compute the information matrices (T, D, D) of the frames' poses, for solving the clip.

    covariances: (T, D, D), inverted over the active dof after widening.
    active: (A,) estimated dof; all others are fixed.
    """
    out = np.zeros(covariances.shape)
    held = np.setdiff1d(np.arange(len(out[0])), active)
    out[:, held, held] = _HELD
    rows, columns = np.ix_(active, active)
    out[:, rows, columns] = np.linalg.inv(WholeClip.widening * covariances[:, rows, columns])
    return out


def monocular(body: Body, particles: int = 7, frame_rate: float = 25.0, *, floor: float | None = None) -> Recipe:
    """Build the recipe (tracking method) for the pictures of one camera.

    body: body of the person.
    frame_rate: Hz.
    particles: number of hypotheses.
    floor: height in the world of the floor, m; None: unknown.
    Mirrored limbs are tried while tracking where there are key points, because these show sooner or later which is
    right.
    """
    usual = MonoSettings(frame_rate=frame_rate)
    search = replace(usual.search, hypotheses=particles, flips=None)
    return picture_recipe(PictureSearch(body, replace(usual, search=search), floor=floor))


def picture_recipe(search: PictureSearch) -> Recipe:
    """Build the recipe of figure 4: in every frame all hypotheses are optimised, sampled along uncertain directions,
    and pruned.

    Deviations: a constant-velocity prediction comes before the optimisation, because without it nothing keeps track;
        evidence is accumulated over frames; mirrored limbs are an option. See also pool.py and compute's mono.py.
    """
    layers = (
        Layer(search.predicted, None, keep, "predict"),
        Layer(search.optimised, accumulated, keep, "optimise"),
        Layer(search.mirror, accumulated, keep, "mirror", search.mirror_now),
        Layer(search.sampled, accumulated, search.pruned, "sample"),
    )
    active = body_dofs(search.body.skeleton) if search.active is None else search.active
    return Recipe(
        "monocular",
        layers,
        search.settings.search.hypotheses,
        ("picture",),
        predict=None,
        estimate=lambda h: h.values[best_of(h)],
        uncertainty=search.uncertainty,
        lost=search.lost,
        smooth=partial(solve_clip, active=active),
    )
