"""Smooth whole clips: all frames of a motion together, without lag; gaps are bridged with growing uncertainty.

A tracker uses only the frames up to the current one; here later frames are used too. Each frame is represented by a
Gaussian (the solved pose and its curvature); key points alone, which are few, are used directly
(`hypose.tracking.keypoint_clip`). Frames are coupled by limits on accelerations and speeds. It is no low-pass filter:
where the evidence of a frame is strong it is followed, where it is weak the neighbours decide.

Feet: contacts are found on a motion that is already smooth: a point of the sole that is slow for a while and, where
there is a common floor, near it. The ground need not be flat (a beam, a step): without a common height each contact has
its own.
Source: foot-plant clean-up as in Kovar, Schreiner & Gleicher 2002, here as weighted points of the clip's solve, so that
    the legs give in where their evidence is weak and strong evidence can override the contact.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import uniform_filter1d

from hypose.body.body import Body, Landmarks
from hypose.body.motion import Motion
from hypose.body.skeleton import Skeleton
from hypose.compute.linear import frame_covariances
from hypose.evidence.frame import Frame
from hypose.evidence.terms import PointTerm, Term
from hypose.fitting import Quadratic, SolveSettings, fit_clip
from hypose.fitting.clip_solve import Coupling, Gaussian, pose_steps
from hypose.geometry import Array, interpolated, nearest_branch, runs
from hypose.tracking.covariance_calibration import pose_covariance
from hypose.tracking.refinement import unpacked
from hypose.tracking.tracker import FrameEstimate, Tracker, TrackerState

# ---- contacts of the feet -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ContactSettings:
    """Settings for finding and holding foot contacts; each field begins with its unit.

    slow, fast: m/s, a contact begins below slow and ends above fast.
    shortest: s, shortest contact.
    near: m above the floor that still counts as on it.
    common: share of the contact frames within `near` of one height that makes it a floor.
    drift: m, a point that moves further away begins a new contact.
    hold: m, standard deviation with which a point in contact is held.
    """

    slow: float = 0.25
    fast: float = 0.5
    shortest: float = 0.12
    near: float = 0.05
    common: float = 0.6
    drift: float = 0.025
    hold: float = 0.01


_CONTACTS = ContactSettings()
_SOLES = ("left_heel", "left_ball", "right_heel", "right_ball")


def soles_of(body: Body) -> Landmarks:
    """Locate heel and ball of the left foot, then of the right foot, as 4 points fixed to the ankles.

    They are the middle of the hindmost fifth and of the foremost 30 % of the sole: the skin of the foot in the lowest
    2 cm at rest.
    """
    joint, offset = [], []
    for side in ("left", "right"):
        j = body.skeleton.joint(f"{side}_ankle")
        skin = body.fine.vertices[body.fine.main_joint == j]
        sole = skin[skin[:, 2] < skin[:, 2].min() + 0.02]
        y = sole[:, 1]  # backward
        hind, fore = y > np.quantile(y, 0.8), y < np.quantile(y, 0.3)
        for part in (hind, fore):
            joint.append(j)
            offset.append(sole[part].mean(0) - body.skeleton.rest_joints[j])
    return Landmarks(_SOLES, np.array(joint), np.array(offset))


@dataclass(frozen=True)
class Contacts:
    """Foot contacts of a motion.

    touching: (T, 4) true where a point of the soles stands on the ground; the points are left heel, left ball, right
        heel and right ball.
    place: (T, 4, 3) where the point stands, m, world; NaN where it is not in contact.
    floor: common height of the contacts, m; NaN where they have none.
    """

    touching: NDArray[np.bool_]
    place: Array
    floor: float


def find_contacts(
    positions: Array, known: NDArray[np.bool_], frame_rate: float, settings: ContactSettings = _CONTACTS
) -> Contacts:
    """Find the contacts of the soles' points in a smooth motion.

    frame_rate: Hz; settings: limits of a contact (default: the usual ones).
    positions: (T, 4, 3) m.
    known: (T,) false for frames without evidence, which have no contacts.
    """
    o, t = settings, len(positions)
    speed = np.linalg.norm(np.gradient(positions, 1 / frame_rate, axis=0), axis=-1) if t > 1 else np.zeros((t, 4))
    shortest = max(2, round(o.shortest * frame_rate))
    touching = np.stack([_runs_of((s < o.fast) & known, s < o.slow, 1) for s in speed.T], 1)
    touching = np.stack([_runs_of(c, c, shortest) for c in touching.T], 1)
    floor = _common_height(positions[..., 2][touching], o)
    if np.isfinite(floor):
        high = positions[..., 2] > floor + o.near
        touching = np.stack([_runs_of(c, c, shortest) for c in (touching & ~high).T], 1)
    place = np.full(positions.shape, np.nan)
    for k in range(positions.shape[1]):
        for run in runs(touching[:, k]):
            for a, b in _standing(positions[:, k], run.start, run.stop, o.drift):
                if b - a < shortest:
                    touching[a:b, k] = False
                    continue
                middle = np.median(positions[a:b, k], axis=0)
                if np.isfinite(floor):
                    middle[2] = max(middle[2], floor)  # a heel may be raised, but nothing sinks
                place[a:b, k] = middle
    return Contacts(touching, place, floor)


def sliding(positions: Array, contacts: Contacts, frame_rate: float) -> float:
    """Measure the sliding of the soles' points (T, 4, 3), m, over given contacts.

    positions: positions of the soles; frame_rate: Hz.
    Returns: mean horizontal speed of the points in contact, mm/s; 0 where there is no contact.
    Use the same contacts for all motions that are compared.
    """
    both = contacts.touching[1:] & contacts.touching[:-1]
    speed = np.linalg.norm(np.diff(positions[..., :2], axis=0), axis=-1) * frame_rate
    return 1e3 * float(speed[both].mean()) if both.any() else 0.0


def _runs_of(flags: NDArray[np.bool_], marks: NDArray[np.bool_], least: int) -> NDArray[np.bool_]:
    """Keep the runs of marked frames (T,) in which at least `least` frames of marks (T,) are set."""
    out = np.zeros(len(flags), dtype=bool)
    for run in runs(flags):
        out[run.start : run.stop] = marks[run.start : run.stop].sum() >= least
    return out


def _standing(points: Array, first: int, last: int, drift: float) -> list[tuple[int, int]]:
    """Split the frames first to last where a point (T, 3) has moved further than drift from its mean so far."""
    out, begin = [], first
    for t in range(first + 1, last):
        if np.linalg.norm(points[t] - points[begin:t].mean(0)) > drift:
            out.append((begin, t))
            begin = t
    return [*out, (begin, last)]


def _common_height(heights: Array, settings: ContactSettings) -> float:
    """Estimate the low height that most contacts share; NaN where they share none, for example because a foot is held
    up.

    heights: (N,) m, of all points in contact.
    """
    if len(heights) == 0:
        return float("nan")
    near = np.abs(heights - np.quantile(heights, 0.1)) < settings.near
    return float(np.quantile(heights[near], 0.25)) if near.mean() >= settings.common else float("nan")


# ---- smoothing ------------------------------------------------------------------------------------------------------


_FARTHEST_M = 2.0
"""m: sd of the place of a person who has not been seen for long; for an angle it is 1 rad"""


@dataclass(frozen=True)
class ClipSettings:
    """Limits on accelerations and speeds of a clip. Chosen on synthetic scenes (walk, box, run, combo; seeds 20 to
    22).

    acceleration_m, speed_m: usual acceleration (m/s^2) and speed (m/s) of the root.
    acceleration_rad, speed_rad: usual acceleration (rad/s^2) and speed (rad/s) of joint angles.
    window, overlap: frames solved together, and how many are shared by two windows.
    rounds: number of solves of a window, each with the accelerations and speeds measured on the previous solution
        (`own_pace`).
    """

    acceleration_m: float = 12.0
    acceleration_rad: float = 60.0
    speed_m: float = 3.0
    speed_rad: float = 12.0
    window: int = 400
    overlap: int = 40
    rounds: int = 4


_CLIP = ClipSettings()
_PACE_S = 0.1
"""s before and after a frame in which its pace is measured"""
_EXCESS = 2.0
"""Factor on the measured excess of the pace, because a stiff solve shows too little of it. Chosen on a captured run at
twice its speed, 60 and 125 Hz, seeds 4 and 5: with 1 its ankles are 1.2 times as wrong as frame by frame, with 2 1.02.
"""
_SAME_PACE = 1.1
_EVERY_FRAME = SolveSettings(iterations=6, coarse_iterations=0, damping=1e-6)


def usual_pace(skeleton: Skeleton, settings: ClipSettings) -> tuple[Array, Array]:
    """Return the usual accelerations and speeds (D,) of the coordinates, per s^2 and per s.

    skeleton: skeleton of D coordinates; settings: limits.
    """
    rest = np.ones(skeleton.dof - 3)
    return (
        np.r_[np.full(3, settings.acceleration_m), settings.acceleration_rad * rest],
        np.r_[np.full(3, settings.speed_m), settings.speed_rad * rest],
    )


def pace_weights(pace: tuple[Array, Array], frame_rate: float) -> tuple[Array, Array]:
    """Compute the weights of squared second and first differences between frames.

    pace: usual accelerations and speeds, per s^2 and per s; frame_rate: Hz.
    """
    acceleration, speed = pace
    return (frame_rate**2 / acceleration) ** 2, (frame_rate / speed) ** 2


def own_pace(poses: Array, frame_rate: float, usual: tuple[Array, Array]) -> tuple[Array, Array]:
    """Measure the pace of a solved clip: its usual accelerations and speeds near each frame.

    poses: (T, D) pose vectors, rad and m; frame_rate: Hz.
    usual: (D,) usual accelerations and speeds. They are multiplied by one factor >= 1 for the whole body, that of its
        fastest coordinate (root mean square nearby in time).
    Returns: accelerations (T - 2, D); speeds (T - 1, D).
    Why: a penalty of one width for all motion flattens fast motion.
    """
    around, steps = 2 * max(1, round(_PACE_S * frame_rate)) + 1, pose_steps(poses)

    def nearby(values: Array, least: Array) -> Array:
        squares = uniform_filter1d((values / least) ** 2, around, axis=0, mode="nearest") if len(values) else values
        excess = np.maximum(squares.max(1, keepdims=True) - 1, 0.0)
        return least * np.sqrt(1 + _EXCESS**2 * excess)

    return nearby(np.diff(steps, axis=0) * frame_rate**2, usual[0]), nearby(steps * frame_rate, usual[1])


def at_own_pace(
    body: Body,
    given: Array,
    evidence: Sequence[Sequence[Term | Gaussian]],
    frame_rate: float,
    settings: ClipSettings,
    priors: Sequence[Quadratic] = (),
    options: SolveSettings = _EVERY_FRAME,
) -> Array:
    """Solve the poses (T, D) of a clip window by window, with limits adapted to the clip's own pace.

    frame_rate: Hz; settings: limits and windows; options: settings of each solve.
    given: (T, D) start poses.
    evidence: terms of each frame; priors: quadratic costs on every pose.
    Each window is solved with the usual pace, then with the pace of the solution, as long as this grows. Why: the width
    of the penalties is estimated from below, so that noise is not followed.
    """
    usual = usual_pace(body.skeleton, settings)

    def window(part: slice) -> Array:
        poses, pace = given[part], usual
        for _ in range(settings.rounds):
            acceleration, speed = pace_weights(pace, frame_rate)
            weights = {"acceleration": acceleration, "velocity": speed}
            poses = fit_clip(body, poses, evidence[part], priors=priors, options=options, **weights)
            before, pace = pace, own_pace(poses, frame_rate, usual)
            if all((new <= _SAME_PACE * old).all() for new, old in zip(pace, before, strict=True)):
                break
        return poses

    return in_windows(given, settings, window)


def smooth_poses(
    body: Body,
    poses: Array,
    information: Array,
    frame_rate: float,
    settings: ClipSettings = _CLIP,
    contacts: Sequence[Sequence[PointTerm]] | None = None,
) -> Array:
    """Solve the poses (T, D) of a clip from those of its frames and the information on each.

    frame_rate: Hz; settings: limits and windows (default: the usual ones).
    poses: (T, D) pose vectors, rad and m; ignored in frames without evidence.
    information: (T, D, D) inverse covariance of each frame's pose; zero in frames without evidence.
    contacts: points that stand still, per frame.
    """
    known = np.asarray(information.any((1, 2)))
    given = bridged(poses, known)
    evidence = [[Gaussian(q, i)] * k for q, i, k in zip(given, information, known.tolist(), strict=True)]
    if contacts is not None:
        evidence = [[*of, *held] for of, held in zip(evidence, contacts, strict=True)]
    return at_own_pace(body, given, evidence, frame_rate, settings)


def gap_covariance(
    body: Body, poses: Array, information: Array, frame_rate: float, settings: ClipSettings = _CLIP
) -> Array:
    """Compute the extra covariance (T, J, 3, 3) of the joint centres, m^2, in frames without evidence; 0 in the
    others.

    poses: (T, D) solved clip; frame_rate: Hz; settings: limits and windows (default: the usual ones).
    The covariance grows with the distance from the frames with evidence, because only the coupling to them limits
    it.
    information: (T, D, D) inverse covariance of each frame's pose; zero in frames without evidence.
    """
    weight, slow = pace_weights(usual_pace(body.skeleton, settings), frame_rate)
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
    """Interpolate poses (T, D) linearly across frames that are not known (T,)."""
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
    """Apply solve(part) to overlapping windows, with a linear transition where two overlap.

    like: (T, ...) array that gives the shape of the result.
    Why: memory and time grow only linearly with the clip's length.
    """
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


@dataclass(frozen=True)
class Clip:
    """A clip that has been tracked from its first frame to its last.

    tracker: tracker by which the clip was tracked.
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
    contacts: share of the frames with a foot on the ground; slid_before, slid: `sliding` of the feet before and after.
    one_by_one: (T, D) poses as tracked frame by frame.
    covariance: (T, D, D) covariance of the poses, from each frame alone.
    """

    motion: Motion
    contacts: float
    slid_before: float
    slid: float
    one_by_one: Array
    covariance: Array

    @property
    def notes(self) -> tuple[str, ...]:
        """Write sentences about contacts and gaps for the user."""
        said = []
        if self.contacts > 0:
            said.append(
                f"feet in contact in {100 * self.contacts:.0f} % of the frames: they slide by "
                f"{self.slid:.0f} mm/s ({self.slid_before:.0f} as tracked)"
            )
        bridged = int((self.motion.extrapolated | self.motion.lost).sum())
        if bridged:
            said.append(
                f"{bridged} frames without the person are interpolated from their neighbours, marked, with larger sd"
            )
        return tuple(said)


def smooth_motion(body: Body, motion: Motion, information: ArrayLike, settings: ClipSettings = _CLIP) -> Smoothed:
    """Solve a tracked motion again as one clip.

    information: (T, D (D + 1) / 2) packed inverse covariance of each frame's pose (`PoseUncertainty.information`).
        Frames in which the person was lost or unseen are bridged: they stay marked, and their sd grows with the
        distance from the others. Soles that stand are held, and all is solved again.
    """
    assert motion.poses is not None
    rate = motion.frame_rate
    known = ~(np.asarray(motion.lost) | np.asarray(motion.extrapolated))
    if len(motion) < 3 or known.sum() < 2:
        return Smoothed(motion, 0.0, 0.0, 0.0, motion.poses, pose_covariance(unpacked(information, body.skeleton.dof)))
    own = unpacked(information, body.skeleton.dof) * known[:, None, None]
    solve = partial(smooth_poses, body, motion.poses, own, rate, settings)
    return with_feet(body, motion, own, solve(), solve, settings)


def with_feet(
    body: Body,
    motion: Motion,
    own: Array,
    free: Array,
    held: Callable[[list[list[PointTerm]]], Array],
    settings: ClipSettings,
) -> Smoothed:
    """Solve a clip again with the standing soles held, and widen its covariances in gaps.

    motion: the tracked clip; settings: limits and windows.
    own: (T, D, D) information of each frame on its pose (zero: none).
    free: (T, D) the clip solved without contacts.
    held: function that solves the clip with points that stand still, one list per frame.
    """
    assert motion.poses is not None
    known, rate = np.asarray(own.any((1, 2))), motion.frame_rate
    soles = soles_of(body)
    contacts = find_contacts(soles.positions(body, free), known, rate)
    standing = [
        [PointTerm(place[on], np.ones(int(on.sum())), soles.joint[on], soles.offset[on], ContactSettings.hold)]
        for on, place in zip(contacts.touching, contacts.place, strict=True)
    ]
    poses = held(standing)
    spread = gap_covariance(body, poses, own, rate, settings)
    seen = np.where(known[:, None, None, None], motion.joint_covariance, np.nan)
    around = (interpolated(seen) + spread).astype(np.float32)
    smoothed = replace(motion, poses=poses, joints=body.joints(poses), joint_covariance=around)
    before, after = (sliding(soles.positions(body, q), contacts, rate) for q in (motion.poses, poses))
    share = float(contacts.touching.any(1).mean())
    return Smoothed(smoothed, share, before, after, motion.poses, pose_covariance(own))
