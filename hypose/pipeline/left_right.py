"""Find stretches of a tracked clip in which left and right were exchanged or the body was lost, and track them again.

During tracking, the body turned around and the body with exchanged legs are compared with the tracked one twice a
second (with depth cameras once), and a lost body is searched for (`FrameEstimate.exchanged`). Where one of them is
better, tracking starts again from it, forwards and backwards in time, as long as it explains the evidence better than
before. In each frame the better estimate is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise

import numpy as np

from hypose.body.body import Body
from hypose.evidence.frame import Frame
from hypose.inference.layer import Memory
from hypose.pipeline.frame_anomalies import in_words, looked_again
from hypose.pipeline.settings import SETTINGS
from hypose.tracking.contacts import runs
from hypose.tracking.tracker import FrameEstimate, Tracker, TrackerState

FrameRange = Callable[[range], Iterable[Frame]]
"""Function that reads the frames with the given numbers, one after the other."""

_LIMBS = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")


def correct_left_right(
    tracker: Tracker,
    estimates: Sequence[FrameEstimate],
    frames: FrameRange,
    *,
    sure_start: bool = False,
    memory: Memory | None = None,
) -> tuple[list[FrameEstimate], list[range]]:
    """Track stretches again in which left and right were exchanged.

    estimates: of the frames 0, 1, ...
    frames: reads a range of frames.
    sure_start: frame 0 is known to be the right way round; what follows from it is kept.
    memory: what the recipe has learned about the person.
    Returns: the corrected estimates, and the ranges of frames that were replaced.
    """
    out = list(estimates)
    tried, replaced = set[int](), np.zeros(len(out), dtype=bool)
    while (at := _most_suspicious(out, tried)) is not None:
        retracked = _retracked_from(tracker, out, at, frames, memory)
        if retracked.won < SETTINGS.sides_least * pace_of(tracker) or (sure_start and retracked.first == 0):
            tried.update(retracked.compared)  # frames that fit equally well both ways are tried once
            continue
        tried.add(at)
        out[retracked.first : retracked.first + len(retracked.better)] = retracked.better
        replaced[retracked.first : retracked.first + len(retracked.better)] = True
    return out, runs(replaced)


def retrack_start(
    tracker: Tracker, estimates: Sequence[FrameEstimate], frames: FrameRange, *, memory: Memory | None = None
) -> tuple[list[FrameEstimate], range]:
    """Track the first frames backwards from a frame in which the person had been found, and keep that where it explains
    them better.

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


def left_right_notes(replaced: Sequence[range]) -> tuple[str, ...]:
    """Return a sentence for the user; none where nothing was exchanged."""
    if not replaced:
        return ()
    return (
        f"left and right had been exchanged in {in_words(replaced)}, or the body lost; tracked again the right way",
    )


def start_notes(replaced: range) -> tuple[str, ...]:
    """Return a sentence for the user; none where nothing was replaced."""
    return (f"the start was wrong in {in_words([replaced])}; tracked again backwards",) if replaced else ()


def _most_suspicious(estimates: Sequence[FrameEstimate], tried: set[int]) -> int | None:
    """Return the frame in which the body with exchanged sides, or found again, is better by most; None where none is
    left.
    """
    better = [(e.exchanged, t) for t, e in enumerate(estimates) if e.exchanged > 0 and t not in tried]
    return max(better)[1] if better else None


@dataclass(frozen=True)
class _Retracked:
    """Frames that were tracked again.

    first: number of the first frame of `better`.
    better: new estimates.
    won: sum over their frames of the decrease of 1 - IoU.
    compared: all frames that were tracked for it.
    """

    first: int
    better: list[FrameEstimate]
    won: float
    compared: range


def _retracked_from(
    tracker: Tracker, old: Sequence[FrameEstimate], at: int, frames: FrameRange, memory: Memory | None
) -> _Retracked:
    """Track again from frame `at` in both directions, starting with exchanged sides, or where the lost body was found;
    return the frames that become better.
    """
    start = tracker.start(tracker.rival(old[at].pose, next(iter(frames(range(at, at + 1))))), memory)
    ahead, back = range(at, len(old)), range(at - 1, -1, -1)
    later, won, after = _while_better(tracker, start, old, ahead, frames_forwards(frames, at, len(old)))
    earlier, won_earlier, before = _while_better(tracker, start, old, back, with_last(frames_backwards(frames, at)))
    compared = range(at - before, at + after)
    return _Retracked(at - len(earlier), [*earlier[::-1], *later], won + won_earlier, compared)


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


def frames_backwards(frames: FrameRange, stop: int) -> Iterator[Frame]:
    """Yield the frames stop - 1, stop - 2, ..., 0, of which some are read at once."""
    for end in range(stop, 0, -SETTINGS.sides_block):
        yield from list(frames(range(max(0, end - SETTINGS.sides_block), end)))[::-1]


def with_last(backwards: Iterable[Frame]) -> Iterator[tuple[Frame, Frame | None]]:
    """Yield frames that come backwards, each with the one before it in time."""
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
