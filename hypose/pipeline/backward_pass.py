"""Track arms backwards in time from where they jumped, and correct the frames before.

Forwards, a lost arm stays lost until the masks show it clearly, although it could have been seen some frames before. So
tracking begins again after the jump and goes backwards, until both directions agree. In each frame the candidates of
both directions are compared; the path through them that explains the masks best without jumping becomes the motion
(Viterbi). Other likely poses stay as rivals.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.compute.threads import in_background
from hypose.evidence.frame import Frame
from hypose.evidence.prefetch import look_ahead
from hypose.geometry import Array
from hypose.inference.estimates import likeliest_path
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.layer import Memory
from hypose.pipeline.frame_anomalies import looked_again
from hypose.pipeline.left_right import FrameRange, frames_backwards, pace_of, read_once, with_last
from hypose.tracking.frame_evidence import PreparedFrame, agreement
from hypose.tracking.part_colours import ColourSettings, colour_scores
from hypose.tracking.pose_covariance import uncertainty_of_pose
from hypose.tracking.refinement import RIVAL, mismatch
from hypose.tracking.tracker import FrameEstimate, Tracker, TrackerState

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

    estimates: of the frames 0, 1, ...
    frames: reads a range of frames.
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


def backward_pass_notes(moved: int) -> tuple[str, ...]:
    """Return a sentence for the user; none where no arm moved."""
    return (f"arms were found elsewhere in {moved} frames by tracking backwards",) if moved else ()


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
            if not prepared.silhouettes.seen or frame.depth is not None or not _known(old[t]):
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
