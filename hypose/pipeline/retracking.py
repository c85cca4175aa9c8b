"""Track parts of a finished clip again: stretches in which left and right were exchanged or the body was lost, the
beginning, and arms backwards in time from where they jumped.

Sides: during tracking, the body turned around and the body with exchanged legs are compared with the tracked one twice
a second (with depth cameras once), and a lost body is searched for (`FrameEstimate.exchanged`). Where one of them is
better, tracking starts again from it, forwards and backwards in time, as long as it explains the evidence better than
before. In each frame the better estimate is kept.

Arms: forwards, a lost arm stays lost until the masks show it clearly, although it could have been seen some frames
before. So tracking begins again after the jump and goes backwards, until both directions agree. In each frame the
candidates of both directions are compared; the path through them that explains the masks best without jumping becomes
the motion (Viterbi). Other likely poses stay as rivals.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, pairwise

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.compute.threads import in_background
from hypose.evidence.frame import Frame
from hypose.evidence.prefetch import look_ahead
from hypose.geometry import Array, runs
from hypose.inference.estimates import likeliest_path
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.layer import Memory
from hypose.pipeline.frame_anomalies import looked_again
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.sources import FrameRange, frames_backwards
from hypose.tracking.frame_evidence import PreparedFrame, agreement
from hypose.tracking.part_colours import ColourSettings, colour_scores
from hypose.tracking.refinement import RIVAL, mismatch, uncertainty_of_pose
from hypose.tracking.tracker import FrameEstimate, Tracker, TrackerState

_LIMBS = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")


def correct_left_right(
    tracker: Tracker,
    estimates: Sequence[FrameEstimate],
    frames: FrameRange,
    *,
    sure_start: bool = False,
    memory: Memory | None = None,
) -> tuple[list[FrameEstimate], list[range]]:
    """Find stretches of a tracked clip in which left and right were exchanged, and track them again.

    estimates: one estimate per frame, from frame 0 on.
    frames: function that reads the frames of a range.
    sure_start: left and right are known to be right in frame 0, so the frames that follow from it are kept.
    memory: what the recipe has learned about the person.
    Returns: the corrected estimates, and the ranges of frames that were replaced.
    """
    out = list(estimates)
    tried, replaced = set[int](), np.zeros(len(out), dtype=bool)
    # first the frame in which the body with exchanged sides, or found again, is better by most
    while suspicious := [(e.exchanged, t) for t, e in enumerate(out) if e.exchanged > 0 and t not in tried]:
        at = max(suspicious)[1]
        first, better, won, compared = _retracked_from(tracker, out, at, frames, memory)
        if won < SETTINGS.sides_least * pace_of(tracker) or (sure_start and first == 0):
            tried.update(compared)  # frames that fit equally well both ways are tried once
            continue
        tried.add(at)
        out[first : first + len(better)] = better
        replaced[first : first + len(better)] = True
    return out, runs(replaced)


def retrack_start(
    tracker: Tracker, estimates: Sequence[FrameEstimate], frames: FrameRange, *, memory: Memory | None = None
) -> tuple[list[FrameEstimate], range]:
    """Track the first frames backwards from a frame in which the person had been found, and keep the new estimates
    where they explain these frames better.

    Returns: the estimates, and the range of frames that were replaced.
    """
    out, pace = list(estimates), pace_of(tracker)
    at = min(round(SETTINGS.sides_found_by * pace), len(out) - 1)
    if at < 1 or tracker.recipe.recover is None:
        return out, range(0)
    start = tracker.start(out[at].pose, memory)
    better, won, _ = _while_better(
        tracker, start, out, range(at - 1, -1, -1), with_last(frames_backwards(frames, at)), False
    )
    if len(better) < at or won < SETTINGS.sides_least_back * pace:  # it does not reach the first frame
        return out, range(0)
    moved = [t for t in range(at) if _apart(tracker.body, out[t], better[at - 1 - t]) > SETTINGS.sides_met_m]
    out[:at] = better[::-1]
    return out, range(max(moved, default=-1) + 1)


def _retracked_from(
    tracker: Tracker, old: Sequence[FrameEstimate], at: int, frames: FrameRange, memory: Memory | None
) -> tuple[int, list[FrameEstimate], float, range]:
    """Track again from frame `at` in both directions, starting with exchanged sides, or where the lost body was found.

    Returns: number of the first frame that becomes better, new estimates from there on, the sum over these frames of
        the decrease of 1 - IoU, and all frames that were tracked for it.
    """
    start = tracker.start(tracker.rival(old[at].pose, next(iter(frames(range(at, at + 1))))), memory)
    ahead, back = range(at, len(old)), range(at - 1, -1, -1)
    later, won, after = _while_better(tracker, start, old, ahead, frames_forwards(frames, at, len(old)))
    earlier, won_earlier, before = _while_better(tracker, start, old, back, with_last(frames_backwards(frames, at)))
    compared = range(at - before, at + after)
    return at - len(earlier), [*earlier[::-1], *later], won + won_earlier, compared


def _while_better(
    tracker: Tracker,
    start: TrackerState,
    old: Sequence[FrameEstimate],
    numbers: range,
    frames: Iterable[tuple[Frame, Frame | None]],
    until_met: bool = True,
) -> tuple[list[FrameEstimate], float, int]:
    """Track from the state `start` until the cost won over the old estimates is largest.

    until_met: end where both tracks are one, and leave out the last estimates that are nearly the same as the old ones.
    Returns: new estimates, cost won, and number of frames tracked.
    """
    state, new = start, list[FrameEstimate]()
    won = best = 0.0
    kept = met = 0
    pace = pace_of(tracker)
    for t, (frame, before) in zip(numbers, frames, strict=False):
        state, estimate = tracker.step(state, frame)
        new.append(looked_again(tracker, estimate, old[t], frame, before))
        won += float(np.nan_to_num(old[t].cost - estimate.cost))
        if won > best:
            best, kept = won, len(new)
        met = met + 1 if _apart(tracker.body, old[t], estimate) < SETTINGS.sides_met_m else 0
        both = until_met and met >= SETTINGS.sides_met_frames * pace
        if won < best - SETTINGS.sides_give_up * pace or len(new) - kept > SETTINGS.sides_undecided * pace or both:
            break
    if not until_met:
        return new, won, len(new)
    while kept and _much_the_same(tracker.body, old[numbers[kept - 1]], new[kept - 1]):
        kept -= 1
    return new[:kept], best, len(new)


def pace_of(tracker: Tracker) -> float:
    """Return the number of frames that last as long as one at 25 Hz, at least one."""
    return max(1.0, tracker.settings.frame_rate / 25)


def frames_forwards(frames: FrameRange, first: int, stop: int) -> Iterator[tuple[Frame, Frame | None]]:
    """Yield the frames first, first + 1, ... with the one before each."""
    before = () if first else (None,)
    pairs = pairwise(chain(before, frames(range(max(0, first - 1), stop))))
    return ((frame, last) for last, frame in pairs if frame is not None)


def with_last(backwards: Iterable[Frame]) -> Iterator[tuple[Frame, Frame | None]]:
    """Yield the frames of a sequence that runs backwards in time, each with the frame before it in time (None for
    the first frame of the clip).
    """
    return ((frame, last) for frame, last in pairwise(chain(backwards, (None,))) if frame is not None)


def read_once(frames: FrameRange) -> FrameRange:
    """Wrap a frame reader so that the frames of the last request are kept in memory. Why: a backward pass reads
    overlapping ranges, and prepared masks stay with their frames.
    """
    known = dict[int, Frame]()

    def of(numbers: range) -> Iterator[Frame]:
        missing = [t for t in numbers if t not in known]
        if missing:
            retracked = range(missing[0], missing[-1] + 1)
            known.update(zip(retracked, frames(retracked), strict=True))
        for t in set(known) - set(numbers):
            del known[t]
        yield from [known[t] for t in numbers]

    return of


def _much_the_same(body: Body, a: FrameEstimate, b: FrameEstimate) -> bool:
    """Return whether two estimates have their limbs on the same sides and their joints near each other."""
    s = body.skeleton
    joints = body.joints(np.stack([a.pose, b.pose]))
    left, right = (joints[:, [s.joint(f"{side}_{name}") for name in _LIMBS]] for side in ("left", "right"))
    across = left - right
    return bool(((across[0] * across[1]).sum(-1) > 0).all()) and _apart(body, a, b) < SETTINGS.sides_elsewhere_m


def _apart(body: Body, a: FrameEstimate, b: FrameEstimate) -> float:
    """Compute the mean distance of the joints, m."""
    joints = body.joints(np.stack([a.pose, b.pose]))
    return float(np.linalg.norm(joints[0] - joints[1], axis=-1).mean())


# ---- arms backwards ----------------------------------------------------------------------------------------------


_COLOURS = ColourSettings()
_ENDS = ("left_elbow", "left_wrist", "right_elbow", "right_wrist")


@dataclass(frozen=True)
class BackwardPassSettings:
    """Settings of the backward pass. Frame counts hold at 25 frames/s and grow with the frame rate.

    jump: displacement by which an elbow or wrist must leave its straight line between two frames to count as a jump, m.
    after: frames after a jump at which backward tracking begins.
    met: distance of the farthest elbow or wrist below which both directions agree, m.
    met_frames: frames for which they must agree to end.
    longest: most frames to go back from one jump.
    apart: arms nearer than this are one pose, m.
    softness: mismatch per unit of log-likelihood.
    motion: mismatch per mean squared step, in units of three usual steps.

    Chosen on synthetic scenes (walk, box, run, combo) with the seeds 500 to 507.
    """

    jump: float = 0.1
    after: int = 2
    met: float = 0.04
    met_frames: int = 2
    longest: int = 100
    apart: float = 0.04
    softness: float = 0.005
    motion: float = 0.002


_SETTINGS = BackwardPassSettings()


@dataclass(frozen=True)
class _Seen:
    """One frame and its candidate poses.

    prepared: evidence of the frame.
    last: the frame before.
    poses: (N, D) candidates of both directions, best first.
    costs: (N,) their mismatches.
    """

    prepared: PreparedFrame
    last: Frame | None
    poses: Array
    costs: Array


def backward_pass(
    tracker: Tracker,
    estimates: Sequence[FrameEstimate],
    frames: FrameRange,
    *,
    memory: Memory | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[list[FrameEstimate], int]:
    """Track backwards from each jump of an arm, and replace estimates for which the later frames give a better pose.

    estimates: one estimate per frame, from frame 0 on.
    frames: function that reads the frames of a range.
    memory: what the recipe has learned about the person.
    progress: called with frames done, total.
    Returns: the estimates, and the number of frames in which an arm moved.
    """
    out = list(estimates)
    if not tracker.recipe.rivals or tracker.settings.evidence not in ("silhouettes", "both") or len(out) < 3:
        return out, 0
    jumps, pace, frames = _jumps(tracker.body, out, _SETTINGS.jump), pace_of(tracker), read_once(frames)
    near = np.zeros(len(out), np.bool_)
    for t in np.flatnonzero(jumps):
        near[t : t + round(_SETTINGS.after * pace) + 1] = True
    t, moved = len(out) - 1, 0
    while t > 0:
        if not near[t] or not _known(out[t]):
            t -= 1
            continue
        progress(len(out) - t, len(out))
        seen = _looked_back(tracker, out, t, near, frames, memory)
        if not seen:
            t -= 1
            continue
        first = t - len(seen) + 1
        better = _chosen(tracker, out, first, seen[::-1])
        ends = _arms(tracker.body, np.stack([e.pose for e in [*out[first : t + 1], *better]]))
        moved += int((_farthest(ends[: len(better)], ends[len(better) :]) > _SETTINGS.apart).sum())
        out[first : t + 1] = better
        t = first - 1
    return out, moved


def _known(estimate: FrameEstimate) -> bool:
    return not (estimate.lost or estimate.extrapolated)


def _arms(body: Body, poses: Array) -> Array:
    """Compute the positions (N, 4, 3) m of elbows and wrists."""
    return body.joints(poses)[:, [body.skeleton.joint(n) for n in _ENDS]]


def _farthest(a: Array, b: Array) -> Array:
    """Compute the largest distance (...,) m between corresponding points (..., E, 3)."""
    return np.linalg.norm(a - b, axis=-1).max(-1)


def _jumps(body: Body, estimates: Sequence[FrameEstimate], least: float) -> NDArray[np.bool_]:
    """Find the frames (T,) in which an arm leaves its straight line, and the frame after each."""
    ends = _arms(body, np.stack([e.pose for e in estimates]))
    off = _farthest(ends[2:] - ends[1:-1], ends[1:-1] - ends[:-2]) > least
    known = np.array([_known(e) for e in estimates])
    off &= known[2:] & known[1:-1] & known[:-2]
    out = np.zeros(len(ends), np.bool_)
    out[1:-1] |= off
    out[2:] |= off
    return out


def _looked_back(
    tracker: Tracker,
    old: Sequence[FrameEstimate],
    stop: int,
    near: NDArray[np.bool_],
    frames: FrameRange,
    memory: Memory | None,
) -> list[_Seen]:
    """Track backwards from frame `stop` until both directions agree.

    Returns: evidence and candidates of each frame, last frame first.
    """
    out, met, pace = list[_Seen](), 0, pace_of(tracker)
    state = _turned(tracker, old, stop, memory)
    most = range(stop, max(-1, stop - round(_SETTINGS.longest * pace)), -1)
    with contextlib.closing(look_ahead(frames_backwards(frames, stop + 1))) as coming:
        for t, (frame, last) in zip(most, with_last(coming), strict=False):
            prepared = replace(tracker.prepare_frame(frame, old[t].pose), memory=memory or {})
            if not prepared.silhouettes.seen or frame.kind == "depth" or not _known(old[t]):
                break
            state, back = tracker.step(state, frame)
            if not _known(back):
                break
            out.append(_seen(tracker.body, old[t], back, prepared, last))
            ends = _arms(tracker.body, np.stack([old[t].pose, back.pose]))
            met = met + 1 if _farthest(ends[0], ends[1]) < _SETTINGS.met else 0
            if not near[t] and met >= _SETTINGS.met_frames * pace:
                break
    return out


def _turned(tracker: Tracker, old: Sequence[FrameEstimate], stop: int, memory: Memory | None) -> TrackerState:
    """Return the tracker state that a backward track has just before frame `stop`."""
    after = old[min(stop + 1, len(old) - 1)].pose
    state = tracker.start(after, memory)
    if stop + 2 < len(old) and all(_known(e) for e in old[stop + 1 : stop + 3]):
        state = replace(state, previous=old[stop + 2].pose)
    return replace(state, frames=1, usual_iou=1 - old[stop].cost)


def _seen(
    body: Body,
    old: FrameEstimate,
    back: FrameEstimate,
    prepared: PreparedFrame,
    last: Frame | None,
) -> _Seen:
    """Collect the candidate poses of a frame: both estimates and their rivals, without near duplicates, best first.
    Their cost comes from the masks, and from the colours of the pictures where known.
    """
    s = body.skeleton
    alive = [old.pose[None], old.rivals, back.pose[None], back.rivals]
    poses = np.concatenate([p.reshape(-1, s.dof) for p in alive]).astype(np.float64)
    poses = s.on_branch(poses[np.isfinite(poses).all(1)], old.pose)
    costs = mismatch(poses, prepared, step_penalty=0.0) + _COLOURS.weight * colour_scores(poses, prepared, _COLOURS)
    ends, kept = _arms(body, poses), list[int]()
    for n in np.argsort(costs, kind="stable").tolist():
        if all(_farthest(ends[n], ends[k]) > _SETTINGS.apart for k in kept):
            kept.append(n)
    return _Seen(prepared, last, poses[kept], costs[kept])


def _chosen(tracker: Tracker, old: Sequence[FrameEstimate], first: int, seen: Sequence[_Seen]) -> list[FrameEstimate]:
    """Return the estimates along the cheapest path through the candidates; frames before and after are fixed ends."""
    s, stop = tracker.body.skeleton, first + len(seen)
    poses, costs = [x.poses for x in seen], [x.costs / _SETTINGS.softness for x in seen]
    fixed = np.zeros(1)
    before = first > 0 and _known(old[first - 1])
    if before:
        poses, costs = [old[first - 1].pose[None], *poses], [fixed, *costs]
    if stop < len(old) and _known(old[stop]):
        poses, costs = [*poses, old[stop].pose[None]], [*costs, fixed]
    large = 3 * s.step_sigma(tracker.settings.frame_rate)

    def step(a: Array, b: Array) -> Array:
        apart = np.stack([s.on_branch(b, q) - q for q in a]) / large
        return _SETTINGS.motion / _SETTINGS.softness * (apart[..., 3:] ** 2).mean(-1)

    path, weights = likeliest_path(costs, [step(a, b) for a, b in zip(poses[:-1], poses[1:], strict=True)])
    rows = zip(seen, path[before:], weights[before:], range(first, stop), strict=False)
    begun = [in_background(partial(_estimate, tracker, old[t], x, n, w)) for x, n, w, t in rows]
    return [result() for result in reversed(begun)][::-1]  # other threads begin at the other end


def _estimate(tracker: Tracker, old: FrameEstimate, seen: _Seen, best: int, weights: Array) -> FrameEstimate:
    """Make the estimate of a frame from candidate number `best`; the others become rivals with weights (N,)."""
    if len(seen.poses) == 1 and np.array_equal(seen.poses[0], old.pose):
        return old
    order = [best, *(n for n in np.argsort(-weights, kind="stable").tolist() if n != best)][: tracker.recipe.rivals]
    h = Hypotheses(seen.poses[order], np.log(np.maximum(weights[order], 1e-12)))
    h = h.marked(RIVAL, np.arange(1, h.count))
    prepared, pose = seen.prepared, h.values[0]
    known = (tracker.recipe.uncertainty or uncertainty_of_pose)(pose, h, prepared)
    rivals, shares = np.full_like(old.rivals, np.nan), np.zeros_like(old.rival_weights)
    rivals[: h.count - 1], shares[: h.count - 1] = h.values[1:], h.weights[1:]
    cost = 1 - agreement(tracker.body, pose, prepared)
    found = replace(
        old,
        pose=pose,
        uncertainty=known,
        cost=cost,
        overlap=prepared.silhouettes.overlap(tracker.body, pose),
        rivals=rivals,
        rival_weights=shares,
    )
    return looked_again(tracker, found, old, prepared.frame, seen.last)
