"""Where the evidence of a clip speaks against itself: pictures that repeat, jump or disagree with the other views, or
show another person as well.

A tracker explains whatever it is shown: frames that come twice, a camera that lags, a gap in the recording all give
poses that fit their masks well enough. What gives them away is how masks change from frame to frame, how well the body
overlaps one view, compared with the others, and what lies apart from it in them. Those frames are marked, and it is
said why; nothing is corrected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_closing, binary_opening, median_filter

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.body.skeleton import Skeleton
from hypose.calibration.findings import INVALID, REVIEW, Finding
from hypose.compute.parts import projected, touched_area
from hypose.evidence.frame import Frame, Keypoints, Silhouettes, pieces_of
from hypose.evidence.prefetch import prepared_masks
from hypose.geometry import Array
from hypose.pipeline.settings import SETTINGS
from hypose.tracking.contacts import runs
from hypose.tracking.covariance_calibration import beyond_usual
from hypose.tracking.joint_features import audit_frame, more_than_body
from hypose.tracking.tracker import FrameEstimate, Tracker


def looked_at(
    tracker: Tracker,
    estimate: FrameEstimate,
    frame: Frame,
    last: Frame | None,
    change: NDArray[np.float32] | None = None,
) -> FrameEstimate:
    """The estimate of a frame with what was seen in it and its audit; last: the frame before; change: `mask_change`
    where it is known (of the masks of several people)."""
    seen = view_statistics(estimate, tracker.body, frame, last, change)
    views = max((len(pictures.rig) for pictures in (*frame.of(Silhouettes), *frame.of(Keypoints))), default=0)
    if views < frame.fewest_views:  # one camera's other poses are judged otherwise
        return replace(estimate, seen=seen)
    wanted = tracker.settings.evidence
    own = replace(
        frame,
        silhouettes=frame.silhouettes if wanted != "keypoints" else None,
        keypoints=frame.keypoints if wanted != "silhouettes" else None,
    )
    rivals = estimate.rivals, estimate.rival_weights
    # key points tell which way round the body is; that masks alone may not is no doubt then
    exchanged = estimate.exchanged if own.keypoints is None else float("nan")
    audit = audit_frame(tracker.body, estimate.pose, own, tracker.keypoints_on_body, rivals, exchanged)
    return replace(estimate, seen=seen, audit=audit)


def looked_again(
    tracker: Tracker, estimate: FrameEstimate, old: FrameEstimate, frame: Frame, last: Frame | None
) -> FrameEstimate:
    """`looked_at` for another estimate of a frame than the old one: how the masks change depends on neither."""
    return looked_at(tracker, estimate, frame, last, old.seen[:, 1] if len(old.seen) else None)


def view_statistics(
    estimate: FrameEstimate, body: Body, frame: Frame, last: Frame | None, change: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """(C, 3) of a tracked frame, NaN where not known: the body's overlap with each view's mask; the difference of the
    mask from that of the frame before (XOR over the larger area; None: there is none); how much of it is another person
    (`strangers_share`). (0, 3) without silhouettes."""
    out, change = np.zeros((0, 3), np.float32), mask_change(frame, last) if change is None else change
    for silhouettes in frame.of(Silhouettes):
        out = np.full((len(silhouettes.masks), 3), np.nan, np.float32)
        # an arm's breadth among others is not significant
        seen = silhouettes.visible_share[: len(estimate.overlap)] >= SETTINGS.doubts_shown
        out[: len(estimate.overlap), 0] = np.where(seen, estimate.overlap, np.nan)
        for before in pieces_of([last] if last else [], Silhouettes) if change is not None else ():
            out[:, 1] = change
            if not (estimate.lost or estimate.extrapolated):
                out[:, 2] = unexplained_share(silhouettes, before, body.skeleton, body.joints(estimate.pose))
    return out


def mask_change(frame: Frame, last: Frame | None) -> NDArray[np.float32] | None:
    """(C,) difference of each view's mask from that of the frame before, XOR over the larger area, NaN where one is not
    usable; None without silhouettes of both."""
    for masks, before in zip(frame.of(Silhouettes), pieces_of([last] if last else [], Silhouettes), strict=False):
        if before.masks.shape != masks.masks.shape:
            continue
        out = np.full(len(masks.masks), np.nan, np.float32)
        now, then = prepared_masks(masks), prepared_masks(before)  # packed already, for the tracker
        for c in np.flatnonzero(masks.usable & before.usable):
            differ = int(np.bitwise_count(now.bits[c] ^ then.bits[c]).sum())
            out[c] = differ / max(int(now.areas[c]), int(then.areas[c]), 1)
        return out
    return None


def as_now(own: Frame, before: Frame) -> Frame | None:
    """The frame before with the pixels ignored now: what was then may have been ignored otherwise. None without
    silhouettes of both."""
    s, then = own.silhouettes, before.silhouettes
    if s is None or then is None:
        return None
    return replace(before, silhouettes=replace(then, ignored=s.ignored, expected=s.expected))


def with_anomalies(motion: Motion, seen: Sequence[NDArray[np.float32]]) -> tuple[Motion, list[str]]:
    """The motion with its doubtful frames marked, and sentences that say which and why. seen: of each frame, as
    `view_statistics` gives it."""
    if not seen or any(len(s) == 0 for s in seen):
        return motion, []
    table = np.stack(seen).astype(np.float64)
    known = ~(motion.lost | motion.extrapolated)
    views = motion.provenance.get("settings", {}).get("views", [])
    names = [f"camera {v}" for v in views] if len(views) == table.shape[1] else _numbered(table.shape[1])
    return _marked(motion, find_anomalies(table[..., 0], table[..., 1], table[..., 2], known, motion.frame_rate, names))


def with_repeated_points(motion: Motion, keypoints: Sequence[Keypoints | None]) -> tuple[Motion, list[str]]:
    """The motion with the frames marked in which key points come twice, to the last digit, although the person moves,
    and sentences that say which."""
    first = next((k for k in keypoints if k is not None), None)
    if first is None or len(keypoints) < round(motion.frame_rate):
        return motion, []
    none = np.zeros((len(first.rig), len(first.names), 3))
    points = np.stack([none if k is None else np.nan_to_num(k.points) for k in keypoints])
    seen = points[..., 2] > 0
    both = seen & np.concatenate([seen[:1], seen[:-1]])
    moved = np.linalg.norm(np.diff(points[..., :2], axis=0, prepend=points[:1, ..., :2]), axis=-1)
    moved = np.where(both, moved, 0.0).sum(-1) / np.maximum(both.sum(-1), 1)
    low, high = (np.where(seen[..., None], points[..., :2], x) for x in (np.inf, -np.inf))
    size = np.where(seen.sum(-1) >= SETTINGS.doubts_few_points, (high.max(2) - low.min(2)).max(-1), np.nan)
    change = np.where(both.sum(-1) >= SETTINGS.doubts_few_points, moved / size, np.nan)
    change[0] = np.nan
    same = _repeats(change, motion.frame_rate, SETTINGS.doubts_still_points)
    found = _repeated(same, change, motion.frame_rate, first.rig.names)
    return _marked(motion, [(what, frames) for what, frames in found if frames.any()])


def _marked(motion: Motion, found: Sequence[tuple[str, NDArray[np.bool_]]]) -> tuple[Motion, list[str]]:
    """The motion with its frames marked for what was found, and sentences."""
    marked = np.zeros(len(motion), dtype=bool) if motion.low_confidence is None else motion.low_confidence.astype(bool)
    for _, frames in found:
        marked |= frames
    notes = [f"{what} in {in_words(runs(frames))}" for what, frames in found]
    if found:
        notes.append(f"{int(marked.sum())} frames are marked as doubtful for that")
    return replace(motion, low_confidence=marked), notes


def find_anomalies(
    overlap: ArrayLike,
    change: ArrayLike,
    others: ArrayLike,
    known: ArrayLike,
    frame_rate: float,
    names: Sequence[str],
) -> list[tuple[str, NDArray[np.bool_]]]:
    """Find anomalies: their names, and their frames (T,). overlap, change, others (T, C): see `view_statistics`;
    known (T,): frames in which the person was found."""
    overlap, change = np.asarray(overlap, dtype=np.float64), np.asarray(change, dtype=np.float64)
    known = np.asarray(known, dtype=bool)
    if len(change) < round(frame_rate):
        return []
    same, jumps = _repeats(change, frame_rate), _jumps(change, frame_rate)
    repeated = _repeated(same, change, frame_rate, names)
    # a gap in all cameras shows in most of them; a person who moves along a camera's line of sight hardly moves in it
    views = np.maximum(np.isfinite(change).sum(1), 1)
    all_jump = (jumps.sum(1) >= np.maximum(2, 0.5 * views)) & ~_in_all(same, change)
    out = [*repeated[:1], ("time jumps", _during(all_jump, frame_rate))]
    gone = np.asarray(binary_opening(~known, np.ones(3)), dtype=bool)
    out.append(("somebody has just been found again", _during(gone, frame_rate) & known))
    out.append(("somebody or something else is in the masks", _strangers(others, known, frame_rate)))
    worse = _worse(overlap, known, frame_rate)
    for c, name in enumerate(names):
        out += [repeated[1 + c], (f"{name} disagrees with the other views", worse[:, c])]
    doubted = np.any([frames for _, frames in out], axis=0)
    out.append(("the body fits less well than before that", _not_back(overlap, doubted, known, frame_rate)))
    return [(what, frames) for what, frames in out if frames.any()]


def _numbered(count: int) -> list[str]:
    return [f"view {c + 1}" for c in range(count)]


def _repeats(change: Array, frame_rate: float, still: float = SETTINGS.doubts_still) -> NDArray[np.bool_]:
    """(T, C): the view repeats the frame before, although the person moves; where nothing else is seen for
    longer than a second, the usual change of the clip decides."""
    some = np.where(change > 0, change, np.nan)
    usual, ever = _local(some, frame_rate), _local(some, len(change))
    return (change == 0) & (np.where(np.isfinite(usual), usual, ever) > still)


def _in_all(same: NDArray[np.bool_], change: Array) -> NDArray[np.bool_]:
    """(T,): all views that are known repeat themselves (same, change (T, C))."""
    seen = np.isfinite(change)
    return (same.sum(1) == np.maximum(seen.sum(1), 1)) & seen.any(1)


def _repeated(
    same: NDArray[np.bool_], change: Array, frame_rate: float, names: Sequence[str]
) -> list[tuple[str, NDArray[np.bool_]]]:
    """That all views repeat themselves, and that each does alone, and during which frames (T,)."""
    everywhere = _in_all(same, change)
    out = [("all cameras repeat pictures", _during(everywhere, frame_rate))]
    for c, name in enumerate(names):
        alone = same[:, c] & ~everywhere
        out.append((f"{name} repeats pictures while the others go on", _during(alone, frame_rate)))
    return out


def _jumps(change: Array, frame_rate: float) -> NDArray[np.bool_]:
    """(T, C): the mask changes far more than within a second around, and all at once: who turns from a camera's line of
    sight moves more and more in it."""
    usual = _local(np.where(change > 0, change, np.nan), frame_rate)
    before = np.concatenate([change[:1], change[:-1]])
    sudden = ~(change < SETTINGS.doubts_sudden * before)  # the frame before may not be known
    return (change > SETTINGS.doubts_jump * usual) & (change > usual + SETTINGS.doubts_least_jump) & sudden


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
    gap = max(1, round(SETTINGS.doubts_after_s * frame_rate))
    closed = np.asarray(binary_closing(np.pad(at, gap), np.ones(gap + 1))[gap:-gap], dtype=bool) | at
    return np.convolve(closed, np.ones(gap + 1))[: len(at)] > 0


def _strangers(others: ArrayLike, known: NDArray[np.bool_], frame_rate: float) -> NDArray[np.bool_]:
    """(T,): parts of the masks lie apart from the body in several views, for at least a fifth of a second; where they
    touch it for a moment, they are still there."""
    share = np.where(known[:, None], np.asarray(others, dtype=np.float64), np.nan)
    views = np.isfinite(share).sum(1)
    at = ((share > SETTINGS.doubts_stranger).sum(1) >= np.maximum(2, 0.5 * views)) & (views > 0)
    lasting = binary_opening(at, np.ones(max(2, round(0.2 * frame_rate))))
    gap = max(1, round(frame_rate))
    closed = binary_closing(np.pad(lasting, gap), np.ones(gap + 1))[gap:-gap]
    return np.asarray(closed, dtype=bool)


def _not_back(
    overlap: Array, doubted: NDArray[np.bool_], known: NDArray[np.bool_], frame_rate: float
) -> NDArray[np.bool_]:
    """(T,): from the end of each stretch of doubtful frames as long as the overlap, over half a second, lies below that
    of the good frames before it: whatever it was may have turned the body around, or taken an arm away."""
    out = np.zeros(len(known), dtype=bool)
    half = max(3, round(0.5 * frame_rate))
    seen = known & np.isfinite(overlap).any(1)
    mean = np.zeros(len(known))
    mean[seen] = np.nanmean(overlap[seen], 1)
    smooth, limit = median_filter(mean, half, mode="nearest"), float("nan")
    for t in range(1, len(out)):
        if doubted[t] and not (doubted[t - 1] or out[t - 1]):
            good = seen[:t] & ~doubted[:t] & ~out[:t]
            limit = float(np.median(mean[:t][good])) - SETTINGS.doubts_less if good.sum() >= half else float("nan")
        out[t] = smooth[t] < limit and not doubted[t] and (doubted[t - 1] or out[t - 1])
    return out


def _worse(overlap: Array, known: NDArray[np.bool_], frame_rate: float) -> NDArray[np.bool_]:
    """(T, C): the view's overlap is far below its usual one, and not because all views' are."""
    if known.sum() < frame_rate or overlap.shape[1] < 2:
        return np.zeros(overlap.shape, dtype=bool)
    values = np.where(known[:, None], overlap, np.nan)
    with np.errstate(all="ignore"):
        usual = np.array([np.nanmedian(v) if np.isfinite(v).any() else np.nan for v in values.T])
    below = median_filter(np.nan_to_num(usual - values), (max(3, round(0.5 * frame_rate)), 1), mode="nearest")
    others = (below.sum(1, keepdims=True) - below) / (below.shape[1] - 1)
    least = np.maximum(
        SETTINGS.doubts_worse, SETTINGS.doubts_spread * 1.48 * np.median(np.abs(below - np.median(below, 0)), 0)
    )
    return (below > least) & (below - others > 0.5 * least)


def in_words(found: Sequence[range]) -> str:
    """Runs of frames in words: 'frames 10-19, 40' of the clip, the first five."""
    shown = [f"{r.start}-{r.stop - 1}" if len(r) > 1 else str(r.start) for r in found[:5]]
    more = f" and {len(found) - 5} more" if len(found) > 5 else ""
    return f"frame{'s' if sum(map(len, found)) > 1 else ''} {', '.join(shown)}{more}"


def against_the_clip(audit: ArrayLike, n_views: ArrayLike, evidence: str) -> tuple[Finding, ...]:
    """Find what speaks against a clip as a whole.

    audit: (T, J, A) features of the error model
    n_views: (T,)
    evidence: of the clip; with key points, which say where limbs are and which view is wrong, nothing is found
    """
    if evidence != "silhouettes":
        return ()
    found, beyond = list[Finding](), beyond_usual(audit, evidence)
    if beyond > SETTINGS.contradiction_look_apart_m:
        text = (
            f"the views contradict each other by {1e3 * beyond:.0f} mm from beginning to end, so the calibration, the "
            "synchronisation or the body is wrong: run hypose check"
        )
        severity = INVALID if beyond > SETTINGS.contradiction_wrong_apart_m else REVIEW
        found.append(Finding("views disagree", (), text, size=beyond, severity=severity))
    if (more := more_than_body(audit, n_views)) > SETTINGS.contradiction_look_more_m2:
        text = (
            "the masks show more than the body from beginning to end (a chair, wide clothes, a bag, another person?), "
            "and limbs may have been put there: compare the overlay with the images"
        )
        found.append(Finding("larger masks", (), text, size=more, severity=REVIEW))
    if all(f.severity == REVIEW for f in found) and len(found) > 1:
        # things in the masks do not set views apart; late or wrong cameras do both (seeds 600 to 617)
        return tuple(replace(f, severity=INVALID) for f in found)
    return tuple(found)


def unexplained_share(now: Silhouettes, before: Silhouettes, skeleton: Skeleton, joints: Array) -> NDArray[np.float32]:
    """(C,) area of the largest part of each view's mask that the body does not touch, over the area of what it touches;
    NaN where it touches nothing, or the mask is not usable. joints (J, 3): m, world, of the tracked body.

    Only what was there in the frame before as well is looked at: noise comes and goes."""
    points = _points(skeleton, joints)
    cameras, seen, then = now.rig, prepared_masks(now), prepared_masks(before)
    step = max(1, round(int(cameras.sizes.max()) / SETTINGS.stranger_looked_at))
    out = np.full(len(cameras), np.nan, np.float32)
    for c in np.flatnonzero(now.usable & before.usable).tolist():
        w, h = (int(n) for n in cameras.sizes[c])
        at = projected(points, cameras.projections[c])[0]
        own, other = touched_area(seen.bits[c], then.bits[c], (w, h), step, at)
        if own:
            out[c] = other / own
    return out


def _points(skeleton: Skeleton, joints: Array) -> Array:
    """(N, 3) joints, and points along the bones between them."""
    child = np.flatnonzero(np.asarray(skeleton.parents) >= 0)
    parent = np.asarray(skeleton.parents)[child]
    return np.concatenate(
        [joints, *(joints[parent] + a * (joints[child] - joints[parent]) for a in SETTINGS.stranger_along)]
    )
