"""Where the evidence of a clip speaks against itself: pictures that repeat, jump or disagree with the other views.

A tracker explains whatever it is shown: frames that come twice, a camera that lags, a gap in the recording all give
poses that fit their masks well enough. What gives them away is how masks change from frame to frame, and how well the
body overlaps one view beside the others. Those frames are marked, and it is said why; nothing is corrected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_closing, binary_opening, median_filter

from hypose.body.motion import Motion
from hypose.evidence.ahead import prepared_masks
from hypose.evidence.frame import Frame
from hypose.geometry import Array

JUMP, LEAST_JUMP = 1.8, 0.12
"""A mask jumps when it changes by more than this many times the usual within a second, and by this much more."""
WORSE, SPREAD = 0.15, 4.0
"""A view disagrees when its overlap, over half a second, lies this far below its usual one, and so many times its usual
spread, and that of the other views is not half as far below theirs. Chosen on clean walks (seeds 0 and 3)."""
_STILL = 0.02
_AFTER_S = 0.4


def what_was_seen(overlap: ArrayLike, frame: Frame, last: Frame | None) -> NDArray[np.float32]:
    """(C, 2): overlap (C,), as the tracker found it (empty: it did not look), and the difference of each view's mask
    from that of the frame before (XOR over the larger area; None: there is none); (0, 2) without silhouettes."""
    silhouettes, before = frame.silhouettes, None if last is None else last.silhouettes
    if silhouettes is None:
        return np.zeros((0, 2), np.float32)
    out = np.full((len(silhouettes.masks), 2), np.nan, np.float32)
    known = np.asarray(overlap)
    out[: len(known), 0] = known
    if before is not None and before.masks.shape == silhouettes.masks.shape:
        now, then = prepared_masks(silhouettes), prepared_masks(before)  # packed already, for the tracker
        for c in np.flatnonzero(silhouettes.usable & before.usable):
            differ = int(np.bitwise_count(now.bits[c] ^ then.bits[c]).sum())
            out[c, 1] = differ / max(int(now.areas[c]), int(then.areas[c]), 1)
    return out


def with_doubts(motion: Motion, seen: Sequence[NDArray[np.float32]]) -> tuple[Motion, list[str]]:
    """The motion with its doubtful frames marked, and sentences that say which and why. seen: of each frame, as
    `what_was_seen` gives it."""
    if not seen or any(len(s) == 0 for s in seen):
        return motion, []
    table = np.stack(seen).astype(np.float64)
    known = ~(motion.lost | motion.extrapolated)
    views = motion.provenance.get("settings", {}).get("views", [])
    names = [f"camera {v}" for v in views] if len(views) == table.shape[1] else _numbered(table.shape[1])
    found = find_doubts(table[..., 0], table[..., 1], known, motion.frame_rate, names)
    marked = np.zeros(len(motion), dtype=bool)
    for _, frames in found:
        marked |= frames
    notes = [f"{what} in {_spans(frames)}" for what, frames in found]
    if found:
        notes.append(f"{int(marked.sum())} frames are marked as doubtful for that")
    return replace(motion, doubtful=marked), notes


def find_doubts(
    overlap: ArrayLike, change: ArrayLike, known: ArrayLike, frame_rate: float, names: Sequence[str]
) -> list[tuple[str, NDArray[np.bool_]]]:
    """What is doubtful, in words, and in which frames (T,). overlap, change (T, C): see `what_was_seen`; known (T,):
    frames in which the person was found."""
    overlap, change = np.asarray(overlap, dtype=np.float64), np.asarray(change, dtype=np.float64)
    known = np.asarray(known, dtype=bool)
    if len(change) < round(frame_rate):
        return []
    same, jumps = _repeats(change, frame_rate), _jumps(change, frame_rate)
    seen = np.isfinite(change)
    views = np.maximum(seen.sum(1), 1)
    all_same = (same.sum(1) == views) & seen.any(1)
    # a gap in all cameras shows in most of them; a person who moves along a camera's line of sight hardly moves in it
    all_jump = (jumps.sum(1) >= np.maximum(2, 0.5 * views)) & ~all_same
    out = [
        ("all cameras repeat pictures", _during(all_same, frame_rate)),
        ("time jumps", _during(all_jump, frame_rate)),
    ]
    gone = np.asarray(binary_opening(~known, np.ones(3)), dtype=bool)
    out.append(("somebody has just been found again", _during(gone, frame_rate) & known))
    worse = _worse(overlap, known, frame_rate)
    for c, name in enumerate(names):
        alone = same[:, c] & ~all_same
        out.append((f"{name} repeats pictures while the others go on", _during(alone, frame_rate)))
        out.append((f"{name} disagrees with the other views", worse[:, c]))
    return [(what, frames) for what, frames in out if frames.any()]


def _numbered(count: int) -> list[str]:
    return [f"view {c + 1}" for c in range(count)]


def _repeats(change: Array, frame_rate: float) -> NDArray[np.bool_]:
    """(T, C): the mask is that of the frame before, although the person moves."""
    moving = _local(np.where(change > 0, change, np.nan), frame_rate) > _STILL
    return (change == 0) & moving


def _jumps(change: Array, frame_rate: float) -> NDArray[np.bool_]:
    """(T, C): the mask changes far more than within a second around."""
    usual = _local(np.where(change > 0, change, np.nan), frame_rate)
    return (change > JUMP * usual) & (change > usual + LEAST_JUMP)


def _local(values: Array, frame_rate: float) -> Array:
    """(T, C): median of the known values within a second before and after; NaN where there is none."""
    half = max(1, round(frame_rate))
    out = np.full_like(values, np.nan)
    for t in range(len(values)):
        part = values[max(0, t - half) : t + half + 1]
        some = np.isfinite(part).any(0)
        out[t, some] = np.nanmedian(part[:, some], 0)
    return out


def _during(at: NDArray[np.bool_], frame_rate: float) -> NDArray[np.bool_]:
    """From the first to the last of events that lie close together, and a little after: tracking has to catch up."""
    gap = max(1, round(_AFTER_S * frame_rate))
    closed = np.asarray(binary_closing(np.pad(at, gap), np.ones(gap + 1))[gap:-gap], dtype=bool) | at
    return np.convolve(closed, np.ones(gap + 1))[: len(at)] > 0


def _worse(overlap: Array, known: NDArray[np.bool_], frame_rate: float) -> NDArray[np.bool_]:
    """(T, C): the view's overlap is far below its usual one, and not because all views' are."""
    if known.sum() < frame_rate or overlap.shape[1] < 2:
        return np.zeros(overlap.shape, dtype=bool)
    values = np.where(known[:, None], overlap, np.nan)
    with np.errstate(all="ignore"):
        usual = np.array([np.nanmedian(v) if np.isfinite(v).any() else np.nan for v in values.T])
    below = median_filter(np.nan_to_num(usual - values), (max(3, round(0.5 * frame_rate)), 1), mode="nearest")
    others = (below.sum(1, keepdims=True) - below) / (below.shape[1] - 1)
    least = np.maximum(WORSE, SPREAD * 1.48 * np.median(np.abs(below - np.median(below, 0)), 0))
    return (below > least) & (below - others > 0.5 * least)


def _spans(frames: NDArray[np.bool_]) -> str:
    """Runs of frames in words: 'frames 10-19 and 40' of the clip, the first five."""
    edges = np.flatnonzero(np.diff(np.r_[0, frames.astype(np.int8), 0]))
    runs = [f"{a}-{b - 1}" if b - a > 1 else str(a) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    more = f" and {len(runs) - 5} more" if len(runs) > 5 else ""
    return f"frame{'s' if int(frames.sum()) > 1 else ''} {', '.join(runs[:5])}{more}"
