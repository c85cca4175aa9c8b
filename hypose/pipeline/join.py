"""Chunks of one recording, tracked apart from each other, become one run of estimates without a seam.

Two neighbours share some frames. Where both have found the person they are the same there up to noise, and one fades
into the other. Where they are not, the earlier one goes on into the later one's frames until they meet, as a tracker
that was never split would have done; unless the later one explains the evidence better all along.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hypose.body.body import Body
from hypose.geometry import Array
from hypose.pipeline.track_loop import Tracked
from hypose.tracking.pose_covariance import PoseUncertainty
from hypose.tracking.tracker import FrameEstimate, TrackerState

AGREE_M = 0.02
"""m: chunks agree where the mean distance of their joints is smaller, in all frames of the fade."""
FADE = 7
"""Frames over which one chunk fades into the next."""
_BETTER = 0.02
"""1 - IoU by which the later of two chunks that disagree has to be better to be believed."""


@dataclass(frozen=True)
class Seam:
    """frame: number of the first frame that is the later chunk's. apart_m: mean distance of joints between the two
    chunks in the frames of the fade (NaN: no common frame). agreed: they met; again: frames of the later chunk that
    were tracked anew to get there."""

    frame: int
    apart_m: float
    agreed: bool
    again: int


Follow = Callable[[TrackerState, range], Iterator[tuple[TrackerState, FrameEstimate]]]
"""follow(state, frames): the tracker's next steps, into these frames."""


def join(body: Body, chunks: Sequence[Tracked], follow: Follow, stop: int) -> tuple[Tracked, tuple[Seam, ...]]:
    """All chunks as one that ends before frame `stop`, and a seam between each two. The chunks begin one after the
    other; a chunk but the first may begin later than the one before it ends, or be without any frame: then `follow`
    fills the gap."""
    whole, seams = chunks[0], []
    for later in chunks[1:]:
        if later.frames:
            whole, seam = _join_two(body, whole, later, follow)
            seams.append(seam)
    return _longer(whole, follow(whole.state, range(whole.frames.stop, stop))), tuple(seams)


def _join_two(body: Body, whole: Tracked, later: Tracked, follow: Follow) -> tuple[Tracked, Seam]:
    common = range(later.frames.start, min(whole.frames.stop, later.frames.stop))
    apart = [_apart(body, _at(whole, t), _at(later, t)) for t in common]
    begin = _closest(apart)
    if begin is not None and max(apart[begin : begin + FADE]) <= AGREE_M:
        return _faded(body, whole, later, common[begin], 0)
    if begin is not None and _later_is_better(whole, later, common):
        at = common[begin] + FADE // 2
        return _cut(whole, [], later, at), Seam(at, float(np.mean(apart[begin : begin + FADE])), False, 0)
    reached, longer = whole.frames.stop, whole
    for step in follow(whole.state, range(reached, later.frames.stop)):
        longer = _longer(longer, [step])
        if longer.frames.stop > later.frames.start:
            apart.append(_apart(body, longer.estimates[-1], _at(later, longer.frames.stop - 1)))
        if len(apart) >= FADE and max(apart[-FADE:]) <= AGREE_M:
            again = longer.frames.stop - reached
            return _faded(body, longer, later, longer.frames.stop - FADE, again)
    # they never met: nothing of the later chunk is used
    end = longer.frames.stop
    return longer, Seam(end, apart[-1] if apart else float("nan"), False, end - reached)


def _longer(tracked: Tracked, steps: Iterable[tuple[TrackerState, FrameEstimate]]) -> Tracked:
    """With further frames behind it."""
    found = list(steps)
    if not found:
        return tracked
    frames = range(tracked.frames.start, tracked.frames.stop + len(found))
    return Tracked(frames, [*tracked.estimates, *(e for _, e in found)], found[-1][0])


def _at(tracked: Tracked, frame: int) -> FrameEstimate:
    return tracked.estimates[frame - tracked.frames.start]


def _faded(body: Body, whole: Tracked, later: Tracked, begin: int, again: int) -> tuple[Tracked, Seam]:
    """Joined where the fade begins."""
    frames = range(begin, begin + FADE)
    pairs = [(_at(whole, t), _at(later, t)) for t in frames]
    faded = [_between(body, a, b, (n + 1) / (FADE + 1)) for n, (a, b) in enumerate(pairs)]
    apart = float(np.mean([_apart(body, a, b) for a, b in pairs]))
    return _cut(whole, faded, later, frames.stop), Seam(begin + FADE // 2, apart, True, again)


def _cut(whole: Tracked, between: Sequence[FrameEstimate], later: Tracked, at: int) -> Tracked:
    """The first one, what is between, and from frame `at` on the later one."""
    head = whole.estimates[: at - len(between) - whole.frames.start]
    tail = later.estimates[at - later.frames.start :]
    return Tracked(range(whole.frames.start, later.frames.stop), [*head, *between, *tail], later.state)


def _apart(body: Body, a: FrameEstimate, b: FrameEstimate) -> float:
    """m, mean over the joints; infinite when one of them does not see the person."""
    if a.lost or b.lost or a.extrapolated or b.extrapolated:
        return float("inf")
    joints = body.joints(np.stack([a.pose, b.pose]))
    return float(np.linalg.norm(joints[0] - joints[1], axis=-1).mean())


def _closest(apart: Sequence[float]) -> int | None:
    """Where the stretch of FADE frames begins in which the two come closest; None when there are fewer frames."""
    if len(apart) < FADE:
        return None
    worst = [max(apart[n : n + FADE]) for n in range(len(apart) - FADE + 1)]
    return int(np.argmin(worst))


def _later_is_better(whole: Tracked, later: Tracked, common: range) -> bool:
    """By the mean of 1 - IoU over the common frames; a frame without the person costs 1."""
    earlier = _costs(whole, common)
    return bool(earlier.mean() - _costs(later, common).mean() > _BETTER)


def _costs(of: Tracked, common: range) -> Array:
    found = [_at(of, t) for t in common]
    return np.array([1.0 if e.lost or e.extrapolated else e.cost for e in found])


def _between(body: Body, a: FrameEstimate, b: FrameEstimate, share: float) -> FrameEstimate:
    """The pose and what is known of it by shares (0: a, 1: b), everything else of the nearer one."""
    step = body.skeleton.on_branch(b.pose, a.pose) - a.pose
    u, v = a.uncertainty, b.uncertainty
    around = ((1 - share) * u.joint_covariance + share * v.joint_covariance).astype(np.float32)
    known = ((1 - share) * u.information + share * v.information).astype(np.float32)
    return replace(b if share > 0.5 else a, pose=a.pose + share * step, uncertainty=PoseUncertainty(around, known))


def seam_notes(seams: Sequence[Seam]) -> tuple[str, ...]:
    """Sentences for the user."""
    if not seams:
        return ()
    met = [s for s in seams if s.agreed]
    notes = []
    if met:
        apart = max(s.apart_m for s in met)
        notes.append(
            f"tracked in {len(seams) + 1} chunks: where they were joined they agreed to {1000 * apart:.0f} mm or better"
        )
    again = sum(s.again for s in seams)
    if again:
        notes.append(f"{again} frames were tracked again, because two chunks had not met where they overlap")
    for s in seams:
        if not s.agreed:
            notes.append(f"the chunks on both sides of frame {s.frame} do not agree: look at the frames around it")
    return tuple(notes)
