"""Find frames whose evidence contradicts itself: pictures that repeat, jump, disagree with other views or show others.

A tracker fits whatever masks it gets: repeated frames, a late camera and a gap in the recording all give poses with a
good fit. They show in the change of the masks between frames, in the overlap of the body with one view compared with
the others, and in mask parts that the body does not touch. These frames are marked with a reason; nothing is corrected.
"""

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
from hypose.geometry import Array, runs
from hypose.pipeline.settings import SETTINGS
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
    """Return a frame's estimate with statistics of the views and features of the error model added.

    last: the frame before; None: there is none.
    change: result of `mask_change`, where known from masks of several people; None: it is computed.
    """
    seen = view_statistics(estimate, tracker.body, frame, last, change)
    views = max((len(pictures.rig) for pictures in (*frame.of(Silhouettes), *frame.of(Keypoints))), default=0)
    if views < frame.fewest_views:  # one camera's other poses are judged otherwise
        return replace(estimate, seen=seen)
    unused = {"keypoints": Silhouettes, "silhouettes": Keypoints}
    own = frame.without(*(kind for evidence, kind in unused.items() if evidence == tracker.settings.evidence))
    # with key points an exchange of sides that masks allow is no reason for doubt
    exchanged = float("nan") if own.of(Keypoints) else estimate.exchanged
    audit = audit_frame(tracker.body, estimate.pose, own, tracker.keypoints_on_body, exchanged)
    return replace(estimate, seen=seen, audit=audit)


def looked_again(
    tracker: Tracker, estimate: FrameEstimate, old: FrameEstimate, frame: Frame, last: Frame | None
) -> FrameEstimate:
    """Add view statistics and features of the error model to a new estimate of a frame, see `looked_at`; the mask
    change is taken from the old estimate of the frame.
    """
    return looked_at(tracker, estimate, frame, last, old.seen[:, 1] if len(old.seen) else None)


def view_statistics(
    estimate: FrameEstimate, body: Body, frame: Frame, last: Frame | None, change: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """Compute three statistics (C, 3) per view of a tracked frame, NaN where not known.

    Column 0: overlap of the body with the mask.
    Column 1: change of the mask since the frame before, see `mask_change`.
    Column 2: unexplained part of the mask, see `unexplained_share`.
    last: frame before.
    change: column 1 where already known; None: it is computed.
    Returns: (0, 3) without silhouettes.
    """
    out, change = np.zeros((0, 3), np.float32), mask_change(frame, last) if change is None else change
    for silhouettes in frame.of(Silhouettes):
        out = np.full((len(silhouettes.masks), 3), np.nan, np.float32)
        # an arm's breadth among others is not significant
        seen = silhouettes.visible_share[: len(estimate.overlap)] >= SETTINGS.anomaly_shown
        out[: len(estimate.overlap), 0] = np.where(seen, estimate.overlap, np.nan)
        for before in pieces_of([last] if last else [], Silhouettes) if change is not None else ():
            out[:, 1] = change
            if before.ignored is None and silhouettes.ignored is not None:  # leave out the pixels that others hide now
                before = replace(before, ignored=silhouettes.ignored, expected=silhouettes.expected)
            if not (estimate.lost or estimate.extrapolated):
                out[:, 2] = unexplained_share(silhouettes, before, body.skeleton, body.joints(estimate.pose))
    return out


def mask_change(frame: Frame, last: Frame | None) -> NDArray[np.float32] | None:
    """Compute how much each view's mask differs from that of the frame before: XOR over the larger area.

    Returns: (C,), NaN where a mask is not usable; None without silhouettes of both frames.
    """
    for masks, before in zip(frame.of(Silhouettes), pieces_of([last] if last else [], Silhouettes), strict=False):
        if before.masks.shape != masks.masks.shape:
            continue
        out = np.full(len(masks.masks), np.nan, np.float32)
        now, then = masks.prepared, before.prepared
        for c in np.flatnonzero(masks.usable & before.usable):
            differ = int(np.bitwise_count(now.bits[c] ^ then.bits[c]).sum())
            out[c] = differ / max(int(now.areas[c]), int(then.areas[c]), 1)
        return out
    return None


def with_anomalies(motion: Motion, seen: Sequence[NDArray[np.float32]]) -> tuple[Motion, list[str]]:
    """Mark the doubtful frames of a motion as low confidence.

    seen: per frame the result of `view_statistics`.
    Returns: the motion, and sentences on which frames and why.
    """
    if not seen or any(len(s) == 0 for s in seen):
        return motion, []
    table = np.stack(seen).astype(np.float64)
    known = ~(motion.lost | motion.extrapolated)
    views = motion.provenance.get("settings", {}).get("views", [])
    count = table.shape[1]
    names = [f"camera {v}" for v in views] if len(views) == count else [f"view {c + 1}" for c in range(count)]
    return _marked(motion, find_anomalies(table[..., 0], table[..., 1], table[..., 2], known, motion.frame_rate, names))


def with_repeated_points(motion: Motion, keypoints: Sequence[Keypoints | None]) -> tuple[Motion, list[str]]:
    """Mark frames whose key points repeat to the last digit although the person moves.

    Returns: the motion, and sentences on which frames.
    """
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
    size = np.where(seen.sum(-1) >= SETTINGS.anomaly_few_points, (high.max(2) - low.min(2)).max(-1), np.nan)
    change = np.where(both.sum(-1) >= SETTINGS.anomaly_few_points, moved / size, np.nan)
    change[0] = np.nan
    same = _repeats(change, motion.frame_rate, SETTINGS.anomaly_still_points)
    found = _repeated(same, change, motion.frame_rate, first.rig.names)
    return _marked(motion, [(what, frames) for what, frames in found if frames.any()])


def _marked(motion: Motion, found: Sequence[tuple[str, NDArray[np.bool_]]]) -> tuple[Motion, list[str]]:
    """Mark frames of a motion as low confidence; `found` holds the reason and the frames (T,)."""
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
    """Find anomalies in the statistics of the views.

    overlap, change, others: (T, C) columns of `view_statistics`.
    known: (T,) frames in which the person was found.
    frame_rate: Hz.
    names: names of the views.
    Returns: description and frames (T,) of each anomaly.
    """
    overlap, change = np.asarray(overlap, dtype=np.float64), np.asarray(change, dtype=np.float64)
    known = np.asarray(known, dtype=bool)
    if len(change) < round(frame_rate):
        return []
    same, jumps = _repeats(change, frame_rate), _jumps(change, frame_rate)
    repeated = _repeated(same, change, frame_rate, names)
    # a gap shows in most cameras, except where the person moves along the line of sight
    views = np.maximum(np.isfinite(change).sum(1), 1)
    all_jump = (jumps.sum(1) >= np.maximum(2, 0.5 * views)) & ~_in_all(same, change)
    out = [*repeated[:1], ("time jumps", _during(all_jump, frame_rate))]
    gone = np.asarray(binary_opening(~known, np.ones(3)), dtype=bool)
    out.append(("the person has just been found again", _during(gone, frame_rate) & known))
    out.append(("another person or an object is in the masks", _strangers(others, known, frame_rate)))
    worse = _worse(overlap, known, frame_rate)
    for c, name in enumerate(names):
        out += [repeated[1 + c], (f"{name} disagrees with the other views", worse[:, c])]
    doubted = np.any([frames for _, frames in out], axis=0)
    out.append(("the body fits less well than before that", _not_back(overlap, doubted, known, frame_rate)))
    return [(what, frames) for what, frames in out if frames.any()]


def _repeats(change: Array, frame_rate: float, still: float = SETTINGS.anomaly_still) -> NDArray[np.bool_]:
    """Find frames (T, C) in which a view repeats the frame before although the person moves. Where nothing changes for
    longer than a second, the usual change of the clip decides.
    """
    some = np.where(change > 0, change, np.nan)
    usual, ever = _local(some, frame_rate), _local(some, len(change))
    return (change == 0) & (np.where(np.isfinite(usual), usual, ever) > still)


def _in_all(same: NDArray[np.bool_], change: Array) -> NDArray[np.bool_]:
    """Find frames (T,) in which all usable views repeat; same, change: (T, C)."""
    seen = np.isfinite(change)
    return (same.sum(1) == np.maximum(seen.sum(1), 1)) & seen.any(1)


def _repeated(
    same: NDArray[np.bool_], change: Array, frame_rate: float, names: Sequence[str]
) -> list[tuple[str, NDArray[np.bool_]]]:
    """List the repeats in all views together, then in each view alone, with their frames (T,)."""
    everywhere = _in_all(same, change)
    out = [("all cameras repeat pictures", _during(everywhere, frame_rate))]
    for c, name in enumerate(names):
        alone = same[:, c] & ~everywhere
        out.append((f"{name} repeats pictures while the others go on", _during(alone, frame_rate)))
    return out


def _jumps(change: Array, frame_rate: float) -> NDArray[np.bool_]:
    """Find frames (T, C) in which a mask changes far more than within a second around, and suddenly. Why suddenly: the
    mask of a person who turns changes gradually more.
    """
    usual = _local(np.where(change > 0, change, np.nan), frame_rate)
    before = np.concatenate([change[:1], change[:-1]])
    sudden = ~(change < SETTINGS.anomaly_sudden * before)  # the frame before may not be known
    return (change > SETTINGS.anomaly_jump * usual) & (change > usual + SETTINGS.anomaly_least_jump) & sudden


def _local(values: Array, frame_rate: float) -> Array:
    """Compute the median (T, C) of the known values within a second before and after; NaN where there is none."""
    half = max(1, round(frame_rate))
    out = np.full_like(values, np.nan)
    for t in range(len(values)):
        part = values[max(0, t - half) : t + half + 1]
        some = np.isfinite(part).any(0)
        out[t, some] = np.nanmedian(part[:, some], 0)
    return out


def _during(at: NDArray[np.bool_], frame_rate: float) -> NDArray[np.bool_]:
    """Fill short gaps between events, and extend them a little, since tracking needs time to recover."""
    gap = max(1, round(SETTINGS.anomaly_after_s * frame_rate))
    closed = np.asarray(binary_closing(np.pad(at, gap), np.ones(gap + 1))[gap:-gap], dtype=bool) | at
    return np.convolve(closed, np.ones(gap + 1))[: len(at)] > 0


def _strangers(others: ArrayLike, known: NDArray[np.bool_], frame_rate: float) -> NDArray[np.bool_]:
    """Find frames (T,) in which mask parts apart from the body last for a fifth of a second in several views. Short
    gaps, in which they touch the body, are filled.
    """
    share = np.where(known[:, None], np.asarray(others, dtype=np.float64), np.nan)
    views = np.isfinite(share).sum(1)
    at = ((share > SETTINGS.anomaly_stranger).sum(1) >= np.maximum(2, 0.5 * views)) & (views > 0)
    lasting = binary_opening(at, np.ones(max(2, round(0.2 * frame_rate))))
    gap = max(1, round(frame_rate))
    closed = binary_closing(np.pad(lasting, gap), np.ones(gap + 1))[gap:-gap]
    return np.asarray(closed, dtype=bool)


def _not_back(
    overlap: Array, doubted: NDArray[np.bool_], known: NDArray[np.bool_], frame_rate: float
) -> NDArray[np.bool_]:
    """Find frames (T,) after doubtful frames in which the overlap stays below that of the good frames before. Why: the
    disturbance may have turned the body around or displaced an arm.
    """
    out = np.zeros(len(known), dtype=bool)
    half = max(3, round(0.5 * frame_rate))
    seen = known & np.isfinite(overlap).any(1)
    mean = np.zeros(len(known))
    mean[seen] = np.nanmean(overlap[seen], 1)
    smooth, limit = median_filter(mean, half, mode="nearest"), float("nan")
    for t in range(1, len(out)):
        if doubted[t] and not (doubted[t - 1] or out[t - 1]):
            good = seen[:t] & ~doubted[:t] & ~out[:t]
            limit = float(np.median(mean[:t][good])) - SETTINGS.anomaly_less if good.sum() >= half else float("nan")
        out[t] = smooth[t] < limit and not doubted[t] and (doubted[t - 1] or out[t - 1])
    return out


def _worse(overlap: Array, known: NDArray[np.bool_], frame_rate: float) -> NDArray[np.bool_]:
    """Find frames (T, C) in which one view's overlap is far below its usual one while that of the other
    views is not.
    """
    if known.sum() < frame_rate or overlap.shape[1] < 2:
        return np.zeros(overlap.shape, dtype=bool)
    values = np.where(known[:, None], overlap, np.nan)
    with np.errstate(all="ignore"):
        usual = np.array([np.nanmedian(v) if np.isfinite(v).any() else np.nan for v in values.T])
    below = median_filter(np.nan_to_num(usual - values), (max(3, round(0.5 * frame_rate)), 1), mode="nearest")
    others = (below.sum(1, keepdims=True) - below) / (below.shape[1] - 1)
    least = np.maximum(
        SETTINGS.anomaly_worse, SETTINGS.anomaly_spread * 1.48 * np.median(np.abs(below - np.median(below, 0)), 0)
    )
    return (below > least) & (below - others > 0.5 * least)


def in_words(found: Sequence[range]) -> str:
    """Write ranges of frames as text such as 'frames 10-19, 40'; at most five ranges are named."""
    shown = [f"{r.start}-{r.stop - 1}" if len(r) > 1 else str(r.start) for r in found[:5]]
    more = f" and {len(found) - 5} more" if len(found) > 5 else ""
    return f"frame{'s' if sum(map(len, found)) > 1 else ''} {', '.join(shown)}{more}"


def against_the_clip(audit: ArrayLike, n_views: ArrayLike, evidence: str) -> tuple[Finding, ...]:
    """Find faults of a clip as a whole: views that contradict each other, and masks that are larger than the body.

    audit: (T, J, A) features of the error model.
    n_views: (T,) number of views.
    evidence: kind of evidence; only 'silhouettes' is checked. Why: key points show where limbs are and which view is
        wrong.
    """
    if evidence != "silhouettes":
        return ()
    found, beyond = list[Finding](), beyond_usual(audit, evidence)
    if beyond > SETTINGS.contradiction_apart_m[0]:
        text = (
            f"the views contradict each other by {1e3 * beyond:.0f} mm from beginning to end, so the calibration, the "
            "synchronisation or the body is wrong: run hypose check"
        )
        severity = INVALID if beyond > SETTINGS.contradiction_apart_m[1] else REVIEW
        found.append(Finding("views disagree", (), text, size=beyond, severity=severity))
    if (more := more_than_body(audit, n_views)) > SETTINGS.contradiction_look_more_m2:
        text = (
            "the masks show more than the body from beginning to end (a chair, wide clothes, a bag, another person?), "
            "and limbs may have been put there: compare the overlay with the images"
        )
        found.append(Finding("larger masks", (), text, size=more, severity=REVIEW))
    if all(f.severity == REVIEW for f in found) and len(found) > 1:
        # objects in the masks do not make views disagree; late or wrong cameras cause both (seeds 600 to 617)
        return tuple(replace(f, severity=INVALID) for f in found)
    return tuple(found)


def unexplained_share(now: Silhouettes, before: Silhouettes, skeleton: Skeleton, joints: Array) -> NDArray[np.float32]:
    """Compute per view the largest mask part that the body does not touch, relative to the area that it touches.

    now, before: masks of this frame and the one before; only pixels that are in both count, since noise changes.
    joints: (J, 3) m, world, of the tracked body.
    Returns: (C,); NaN where the body touches nothing or a mask is not usable.
    """
    points = _points(skeleton, joints)
    cameras, seen, then = now.rig, now.prepared, before.prepared
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
    """Return the joints and points along the bones between them, (N, 3)."""
    child = np.flatnonzero(np.asarray(skeleton.parents) >= 0)
    parent = np.asarray(skeleton.parents)[child]
    return np.concatenate(
        [joints, *(joints[parent] + a * (joints[child] - joints[parent]) for a in SETTINGS.stranger_along)]
    )
