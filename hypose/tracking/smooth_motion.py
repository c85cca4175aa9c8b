"""Solve the motion of all frames together as the last step of tracking, with feet that stand, and its uncertainty.

A recipe's `smooth` defines how its clips are solved; `smooth_clip` is that of the recipes for several cameras.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.evidence.frame import Frame
from hypose.evidence.terms import PointTerm
from hypose.geometry import Array
from hypose.tracking.contacts import FootMotion, contact_terms, find_contacts, foot_motion, soles_of
from hypose.tracking.covariance_calibration import pose_covariance
from hypose.tracking.pose_covariance import unpacked
from hypose.tracking.smoothing import ClipSettings, gap_covariance, smooth_poses
from hypose.tracking.tracker import FrameEstimate, Tracker, TrackerState


@dataclass(frozen=True)
class Clip:
    """A clip that has been tracked from its first frame to its last.

    tracker: that tracked it.
    motion: the estimates as a motion; estimates: one per frame.
    state: after the last frame.
    frames: function (range) that yields frames of the clip again, forwards or backwards.
    progress: function (done, total).
    """

    tracker: Tracker
    motion: Motion
    estimates: Sequence[FrameEstimate]
    state: TrackerState
    frames: Callable[[range], Iterable[Frame]]
    progress: Callable[[int, int], None]


def smooth_clip(clip: Clip) -> tuple[Motion, tuple[str, ...]]:
    """Smooth a tracked clip by `smooth_motion`; return the motion, and sentences about contacts and gaps."""
    clip.progress(0, 1)
    information = np.stack([e.uncertainty.information for e in clip.estimates])
    smoothed = smooth_motion(clip.tracker.body, clip.motion, information)
    clip.progress(1, 1)
    return smoothed.motion, smoothed.notes


@dataclass(frozen=True)
class Smoothed:
    """Result of smoothing a clip.

    motion: the smoothed motion.
    feet_before, feet: motion of the feet over the contacts that were found, before and after.
    one_by_one: (T, D) poses as tracked frame by frame.
    covariance: (T, D, D) of the poses, from each frame alone.
    """

    motion: Motion
    feet_before: FootMotion
    feet: FootMotion
    one_by_one: Array
    covariance: Array

    @property
    def notes(self) -> tuple[str, ...]:
        """Write sentences about contacts and gaps for the user."""
        said = []
        if self.feet.contacts > 0:
            said.append(
                f"feet in contact in {100 * self.feet.contacts:.0f} % of the frames: they slide by "
                f"{self.feet.sliding:.0f} mm/s ({self.feet_before.sliding:.0f} as tracked)"
            )
        bridged = int((self.motion.extrapolated | self.motion.lost).sum())
        if bridged:
            said.append(
                f"{bridged} frames without the person are interpolated from their neighbours, marked, with larger sd"
            )
        return tuple(said)


def smooth_motion(body: Body, motion: Motion, information: ArrayLike, settings: ClipSettings | None = None) -> Smoothed:
    """Solve a tracked motion again as one clip.

    information: (T, D (D + 1) / 2) of each frame on its pose (`PoseUncertainty`).
    Frames in which the person was lost or unseen are bridged: they stay marked, and their sd grows with the distance
    from the others. Soles that stand are held, and all is solved again.
    """
    assert motion.poses is not None
    settings, rate = settings or ClipSettings(), motion.frame_rate
    known = ~(np.asarray(motion.lost) | np.asarray(motion.extrapolated))
    if len(motion) < 3 or known.sum() < 2:
        nothing = FootMotion(0.0, 0.0)
        return Smoothed(
            motion, nothing, nothing, motion.poses, pose_covariance(unpacked(information, body.skeleton.dof))
        )
    own = unpacked(information, body.skeleton.dof) * known[:, None, None]
    given = motion.poses

    def held(contacts: list[list[PointTerm]] | None) -> Array:
        return smooth_poses(body, given, own, rate, settings, contacts)

    return with_feet(body, motion, own, held(None), held, settings)


def with_feet(
    body: Body,
    motion: Motion,
    own: Array,
    free: Array,
    held: Callable[[list[list[PointTerm]]], Array],
    settings: ClipSettings,
) -> Smoothed:
    """Solve a clip again with the standing soles held, and widen its covariances in gaps.

    own: (T, D, D) information of each frame on its pose (zero: none).
    free: (T, D) the clip solved without contacts.
    held: function that solves the clip with points that stand still, one list per frame.
    """
    assert motion.poses is not None
    known, rate = np.asarray(own.any((1, 2))), motion.frame_rate
    soles = soles_of(body)
    contacts = find_contacts(soles.positions(body, free), known, rate)
    poses = held(contact_terms(contacts, soles))
    spread = gap_covariance(body, poses, own, rate, settings)
    around = (_carried(motion.joint_covariance, known) + spread).astype(np.float32)
    smoothed = replace(motion, poses=poses, joints=body.joints(poses), joint_covariance=around)
    before, after = (foot_motion(soles.positions(body, q), contacts, rate) for q in (motion.poses, poses))
    return Smoothed(smoothed, before, after, motion.poses, pose_covariance(own))


def _carried(covariance: NDArray[np.float32], known: NDArray[np.bool_]) -> Array:
    """Interpolate the covariances (T, J, 3, 3) of known frames linearly in time."""
    at = np.flatnonzero(known)
    columns = covariance.reshape(len(covariance), -1).T
    carried = np.stack([np.interp(np.arange(len(covariance)), at, column[at]) for column in columns], 1)
    return carried.reshape(covariance.shape)
