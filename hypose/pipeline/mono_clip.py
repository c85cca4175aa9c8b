"""The last step of a monocular track of a recording: the clip tracked backwards as well, and solved as a whole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.io.motions import modes as stored
from hypose.monocular.clip import Modes, WholeClip, backwards, information, together
from hypose.monocular.models import body_dofs
from hypose.monocular.tracker import MonoTracker
from hypose.monocular.types import MonoEstimate, MonoFrame, MonoHypotheses, posterior_arrays
from hypose.pipeline.track_loop import Progress
from hypose.tracking.smoothing import smooth_poses

_AHEAD_BYTES = 250_000_000
"""Of pictures that are read forwards and kept, so that no video is decoded backwards."""
_BACK = 1
"""Beside the seed: the stream of random numbers of the way back."""


def solve_clip(
    tracker: MonoTracker,
    motion: Motion,
    modes: stored.Modes,
    last: MonoHypotheses,
    frame: Callable[[int], MonoFrame],
    seed: int,
    progress: Progress,
) -> Motion:
    """The motion of a clip's best modes, solved as a whole: from all modes, the tracker's last hypotheses, and frames
    by index. Frames in which the person was lost are bridged. Feet are not held where they seem to stand, as they are
    with several cameras: their depth is known far too badly to tell."""
    total, back = len(motion), modes
    if total > 2:
        way = backwards(tracker, last, total, _read_ahead(frame), lambda i: np.random.default_rng([seed, i, _BACK]))
        found: list[stored.Modes] = []
        for estimate in way:
            progress("smooth", len(found), total - 1)
            found.append(modes_of(tracker.body, estimate))
        back = stored.joined([*reversed(found), _last_of(modes)])
        # the way there saw the first picture without flow, so its costs are of another kind
        back.costs[0] = modes.costs[0, 0]
        progress("smooth", total - 1, total - 1)
    poses, covariances = together(_arrays(modes), _arrays(back), motion.frame_rate)
    body = tracker.body
    active = body_dofs(body.skeleton) if tracker.active is None else tracker.active
    known = information(covariances, active) * ~motion.lost[:, None, None]
    if total > 2 and not motion.lost.all():
        poses = smooth_poses(body, poses, known, motion.frame_rate, WholeClip().motion)
    around = np.stack([body.skeleton.joint_covariances(q, c) for q, c in zip(poses, covariances, strict=True)])
    return replace(motion, poses=poses, joints=body.joints(poses), joint_covariance=around.astype(np.float32))


def modes_of(body: Body, estimate: MonoEstimate) -> stored.Modes:
    """The modes of one frame, covariances in 32 bit."""
    arrays = {k.removeprefix("mode_"): v for k, v in posterior_arrays(body, [estimate]).items()}
    arrays["covariances"] = arrays["covariances"].astype(np.float32)
    return stored.Modes(**arrays)


def _last_of(modes: stored.Modes) -> stored.Modes:
    return stored.Modes(**{k: v[-1:] for k, v in stored.to_arrays(modes).items()})


def _arrays(modes: stored.Modes) -> Modes:
    return Modes(*(getattr(modes, name) for name in Modes._fields))


def _read_ahead(frame: Callable[[int], MonoFrame]) -> Callable[[int], MonoFrame]:
    """frame(index) for falling indices."""
    kept: dict[int, MonoFrame] = {}

    def at(index: int) -> MonoFrame:
        if index not in kept:
            size = next(iter(kept.values())).image.nbytes if kept else frame(index).image.nbytes
            kept.clear()
            ahead = max(1, _AHEAD_BYTES // size)
            kept.update({i: frame(i) for i in range(max(0, index - ahead + 1), index + 1)})
        return kept[index]

    return at
