"""Solve the poses of a whole clip from key points at once; no frame is final before the last one has been seen.

In order: (1) frame after frame, which corrects exchanged sides, leaves strangers out and finds the pose's branch; (2)
again from where this went on with the wrong leg or arm, judged by the names of most points; (3) all frames together,
with feet that stand. For a live camera, the tracker uses key points frame by frame instead.

Limbs on the wrong side (`exchanged_by_names`): a detector exchanges left and right in single views for a while, so each
view's points are renamed by where the body is expected (`check_sides_and_views`). Where two limbs have met, that
expectation may go on with the wrong one and then rename all views in all later frames. Most points called left are
left: so the names of all views and frames are counted together, and limbs that are apart do not change places.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.errors import EvidenceError
from hypose.evidence.frame import Keypoints
from hypose.evidence.keypoints import triangulate_keypoints
from hypose.evidence.terms import KeypointTerm, PointTerm, Term
from hypose.fitting import SolveSettings, fit_pose
from hypose.geometry import Array
from hypose.inference.estimates import likeliest_path
from hypose.inference.layer import go_on
from hypose.tracking.frame_evidence import (
    MIN_CONFIDENCE,
    STRANGER_M,
    SWAPPED_M,
    KeypointModel,
    keypoint_term,
    pixels_per_metre,
    shows_another_person,
    side_distances,
    sides_of,
)
from hypose.tracking.left_right import limbs_exchanged
from hypose.tracking.refinement import anatomical_prior, from_neighbours, joint_covariance_of
from hypose.tracking.smoothing import ClipSettings, Smoothed, at_own_pace, bridged, with_feet
from hypose.tracking.start_search import start_from_keypoints

# ---- sides by names -------------------------------------------------------------------------------------------------


LIMBS = {"legs": ("knee", "ankle", "big_toe", "small_toe", "heel"), "arms": ("elbow", "wrist")}
_MEETING, _APART, _APART_M = 8.0, 24.0, 0.5
"""views: cost of an exchange where two limbs touch, and the extra cost where they are _APART_M apart. Half a second in
which, by chance, one view more has the other side's names than not is worth 12, and has two ends."""


def exchanged_by_names(
    body: Body,
    model: KeypointModel,
    poses: Array,
    keypoints: Sequence[Keypoints | None],
    limb: str,
    *,
    sure_start: bool = False,
) -> tuple[NDArray[np.bool_], float]:
    """Find the frames in which two limbs are on each other's side, by the names of the key points (Viterbi search).

    model: where key points sit on the body; keypoints: T frames, None where there are none.
    poses: (T, D) tracked poses.
    limb: "legs" or "arms", see LIMBS.
    sure_start: frame 0 is known to have its sides right.
    Returns: (T,) true for exchanged frames; the gain, in views, of exchanging them.
    """
    pairs = sides_of(model.names, LIMBS[limb], model.known)
    if not len(pairs):
        return np.zeros(len(poses), np.bool_), 0.0
    places = model.positions(body, poses)
    apart = np.linalg.norm(places[:, pairs[:, 0]] - places[:, pairs[:, 1]], axis=-1).mean(1)
    won = np.zeros(len(poses))  # views with the other side's names minus views with the own side's
    for t, seen in enumerate(keypoints):
        if seen is not None and seen.names == model.names:
            uv = np.stack([camera.project_pinhole(places[t]) for camera in seen.rig])
            renamed, kept = views_by_names(model, limb, seen.points, uv, pixels_per_metre(seen, poses[t, :3]))
            won[t] = renamed - kept
    change = _MEETING + _APART * (apart / _APART_M) ** 2
    change[0] = np.inf if sure_start else _MEETING  # a start may be wrong, however far apart they are
    costs = [np.array([0.0, change[0] - won[0]]), *np.column_stack([0 * won, -won])[1:]]
    path, _ = likeliest_path(costs, [np.array([[0.0, c], [c, 0.0]]) for c in change[1:]])
    exchanged = np.array(path, np.bool_)
    return exchanged, float(won[exchanged].sum() - change[np.diff(exchanged, prepend=False)].sum())


def views_by_names(model: KeypointModel, limb: str, points: Array, expected: Array, size: Array) -> tuple[int, int]:
    """Count the views whose named points lie on the other side's limb, and those whose points lie on their own.

    model: model of the key points; limb: "legs" or "arms".
    points: (C, K, 3) u px, v px, confidence.
    expected: (C, K, 2) places on the body, px; size: (C,) pixels per metre.
    Returns: views on the other side; views on their own side. Views where both fit alike count as neither.
    """
    pairs, seen = sides_of(model.names, LIMBS[limb], model.known), np.nan_to_num(points)
    seen[~(seen[..., 2] > MIN_CONFIDENCE)] = 0.0
    as_named, exchanged = side_distances(seen, expected, size, pairs)
    renamed = (as_named > SWAPPED_M) & (exchanged < 0.5 * as_named)
    kept = (exchanged > SWAPPED_M) & (as_named < 0.5 * exchanged)
    return int(renamed.sum()), int(kept.sum())


# ---- whole clip -----------------------------------------------------------------------------------------------------


EXTRAPOLATE_S = 1.0
"""s without key points after which the person counts as lost, as in the tracker."""
FASTEST, FARTHEST = 4.0, 1.3
"""m/s, m: how much faster than predicted, and how far, a person may move unseen and still be taken for the same
person."""
SAME_SIZE = 0.1
"""A lost person is accepted anywhere when the limbs' lengths (median) differ from the body's by less than this
share."""
_LIMBS = [
    (f"{side}_{a}", f"{side}_{b}")
    for side in ("left", "right")
    for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
]
_LOOK_EVERY = 5  # frames between two searches of the whole space, which are slow
LEAST_POINTS = 6
"""A frame with fewer points (in all views together) does not determine the pose by itself."""
_QUICK = SolveSettings(iterations=6, coarse_iterations=0, tolerance=3e-3)
_SETTINGS = ClipSettings()
_ALL = SolveSettings(iterations=8, coarse_iterations=0)

Report = Callable[[int, int], None]


def solve_keypoint_clip(
    body: Body,
    model: KeypointModel,
    keypoints: Sequence[Keypoints | None],
    start: Array,
    frame_rate: float,
    settings: ClipSettings = _SETTINGS,
) -> tuple[Array, list[KeypointTerm | None]]:
    """Solve the poses of a clip from its key points alone.

    frame_rate: Hz; settings: limits on accelerations and speeds (default: the usual ones).
    model: where key points sit on the body; keypoints: T frames, None where there are none.
    start: (D,) pose in the first frame.
    Returns: poses (T, D); the key-point term of each frame, None where there is no evidence.
    """
    first, terms = _on_named_sides(body, model, keypoints, start, frame_rate)
    evidence = [[] if term is None else [term] for term in terms]
    return _together(body, first, evidence, frame_rate, settings), terms


def track_keypoint_clip(
    body: Body,
    model: KeypointModel,
    keypoints: Sequence[Keypoints | None],
    start: Array,
    frame_rate: float,
    settings: ClipSettings = _SETTINGS,
    progress: Report | None = None,
    *,
    sure_start: bool = False,
    others: Sequence[Sequence[Term]] = (),
) -> Smoothed:
    """Compute the smoothed motion of a clip from its key points alone.

    frame_rate: Hz; settings: limits on accelerations and speeds (default: the usual ones).
    model: joint and offset of each key point on the body.
    keypoints: key points of the T frames; None where there are none.
    start: (D,) pose in the first frame; sure_start: it is the right way round, even where the points' names contradict
        it.
    progress: function (done, total), called after every frame of the first pass.
    others: other evidence of each frame, used where all frames are solved together.
    Frames with fewer than LEAST_POINTS are bridged from their neighbours and marked as extrapolated (as lost after a
    second); their sd grows with the distance from these.
    Raises: EvidenceError where fewer than two frames have enough points.
    """
    first, terms = _on_named_sides(body, model, keypoints, start, frame_rate, progress, sure_start=sure_start)
    seen = [np.zeros((1, 1), dtype=bool) if term is None else term.points[..., 2] > 0 for term in terms]
    known = np.array([points.any(0).sum() >= LEAST_POINTS for points in seen])
    if known.sum() < 2:
        raise EvidenceError(
            f"{int(known.sum())} of {len(terms)} frames have {LEAST_POINTS} confident key points or more; check the "
            "detector's files, or use silhouettes."
        )
    evidence = [[] if term is None else [term] for term in terms]
    evidence = [[*of, *more] for of, more in zip(evidence, others or [[]] * len(terms), strict=True)]
    free = _together(body, first, evidence, frame_rate, settings)
    own = np.zeros((len(terms), body.skeleton.dof, body.skeleton.dof))
    around = np.full((len(terms), len(body.skeleton.joint_names), 3, 3), np.nan, np.float32)
    still, priors = SolveSettings(iterations=0, coarse_iterations=0), (anatomical_prior(body.skeleton, keypoints=True),)
    for t in np.flatnonzero(known):  # what a frame by itself shows of its pose
        own[t] = fit_pose(body, free[t], evidence[t], priors=priors, options=still).information
        around[t] = joint_covariance_of(body, free[t], own[t], "keypoints")
    around = from_neighbours(around, frame_rate)
    frames = np.arange(len(known))
    last_known = np.maximum.accumulate(np.where(known, frames, -1))
    motion = Motion(
        body.skeleton,
        frames / frame_rate,
        body.joints(free),
        free,
        around,
        frames - last_known > EXTRAPOLATE_S * frame_rate,
        ~known,
        np.array([int(points.any(1).sum()) for points in seen]),
        np.full(len(terms), np.nan),
        {},
    )

    def held(contacts: list[list[PointTerm]]) -> Array:
        every = [[*of, *held] for of, held in zip(evidence, contacts, strict=True)]
        return _together(body, free, every, frame_rate, settings)

    return replace(with_feet(body, motion, own, free, held, settings), one_by_one=first)


def _on_named_sides(
    body: Body,
    model: KeypointModel,
    keypoints: Sequence[Keypoints | None],
    start: Array,
    frame_rate: float,
    progress: Report | None = None,
    *,
    sure_start: bool = False,
) -> tuple[Array, list[KeypointTerm | None]]:
    """Run `_one_by_one`; repeat it with legs or arms exchanged from frames where their names put them on the other
    side.

    Arguments as for `track_keypoint_clip`.
    Returns: poses (T, D), bridged where nothing is seen; the key-point term of each frame, None where there is none.
    It is repeated as long as that leaves less to be exchanged.
    """
    poses, terms = _one_by_one(body, model, keypoints, start, frame_rate, progress)
    for limb in LIMBS:
        wrong, worth = exchanged_by_names(body, model, poses, keypoints, limb, sure_start=sure_start)
        while wrong.any():
            at = int(np.argmax(wrong))
            begin = limbs_exchanged(body, poses[at], limb)
            afresh, own = _one_by_one(body, model, keypoints[at:], begin, frame_rate)
            found = np.concatenate([poses[:at], afresh])
            wrong, left = exchanged_by_names(body, model, found, keypoints, limb, sure_start=sure_start)
            if left >= worth:
                break
            poses, terms, worth = found, [*terms[:at], *own], left
    return poses, terms


def _one_by_one(
    body: Body,
    model: KeypointModel,
    keypoints: Sequence[Keypoints | None],
    start: Array,
    frame_rate: float,
    progress: Report | None = None,
) -> tuple[Array, list[KeypointTerm | None]]:
    """Solve each frame from the previous one; people too far from the expected place are left out.

    Arguments as for `track_keypoint_clip`.
    Returns: poses (T, D), bridged where nothing is seen; the key-point term of each frame.
    """
    s = body.skeleton
    prior = (anatomical_prior(s, keypoints=True),)
    poses, terms = np.empty((len(keypoints), s.dof)), []
    last, before = start.copy(), start
    unseen = frame_rate * EXTRAPOLATE_S  # the start may be that of a frame within the first second
    for t, seen in enumerate(keypoints):
        expected = s.clamp(last + go_on(last - s.on_branch(before, last), 0))
        reach = min(STRANGER_M + FASTEST * unseen / frame_rate, FARTHEST)
        if seen is not None and shows_another_person(seen, body, model, expected, reach):
            lost = unseen > EXTRAPOLATE_S * frame_rate
            found = _returned(body, model, seen) if lost and int(unseen) % _LOOK_EVERY == 0 else None
            if found is None:
                seen = None
            else:
                expected = last = found  # the jump there is no velocity
        term = None if seen is None else keypoint_term(seen, body, model, expected)
        terms.append(term)
        unseen = 0.0 if term is not None else unseen + 1
        poses[t] = expected  # without evidence the last velocity decays
        if term is not None:
            found = fit_pose(body, expected, [term], priors=prior, options=_QUICK).pose
            # beyond half a turn a shoulder's rotation vector would reach the corner of its limits while the arm goes on
            poses[t] = s.unwound(found)
            last += poses[t] - found  # the step stays what it was
        before, last = (last, poses[t].copy()) if t else (poses[t], poses[t].copy())
        if progress is not None:
            progress(t + 1, len(keypoints))
    return bridged(_in_a_row(body, poses), np.array([t is not None for t in terms])), terms


def _in_a_row(body: Body, poses: Array) -> Array:
    """Put every ball's rotation vector in poses (T, D) on the branch of the previous frame, where limits allow."""
    out = poses.copy()
    for t in range(1, len(out)):
        out[t] = body.skeleton.unwound(out[t], out[t - 1])
    return out


def _returned(body: Body, model: KeypointModel, seen: Keypoints) -> Array | None:
    """Find the pose (D,) of the person in a frame at any place; None where the limbs' lengths are not those of the
    body.

    model: where key points sit on the body; seen: key points of the frame.
    """
    points = triangulate_keypoints([seen])[0][0]
    try:
        known = model.known
        pose = start_from_keypoints(body, points[known], model.joint[known], model.offset[known]).pose
    except EvidenceError:  # too few points
        return None
    own = model.positions(body, pose)
    pairs = [(model.names.index(a), model.names.index(b)) for a, b in _LIMBS if {a, b} <= set(model.names)]
    ratio = [np.linalg.norm(points[a] - points[b]) / np.linalg.norm(own[a] - own[b]) for a, b in pairs]
    ratio = [r for r in ratio if np.isfinite(r)]
    return pose if len(ratio) >= 2 and abs(np.median(ratio) - 1) < SAME_SIZE else None


def _together(
    body: Body,
    given: Array,
    evidence: Sequence[Sequence[Term]],
    frame_rate: float,
    settings: ClipSettings,
) -> Array:
    """Solve all frames together on their evidence, from the given poses (T, D).

    frame_rate: Hz; settings: limits on accelerations and speeds.
    """

    priors = (anatomical_prior(body.skeleton, keypoints=True),)
    return at_own_pace(body, _in_a_row(body, given), evidence, frame_rate, settings, priors, _ALL)
