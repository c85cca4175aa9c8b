"""Diagnostics with key points: gross faults, timing, and camera poses.

Gross faults are found by trial (`hypose.evidence.keypoint_check`), with key points or silhouettes.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hypose.calibration.findings import INVALID, REVIEW, Finding, Limits
from hypose.calibration.refine_points import (
    CameraChange,
    PointAdjustment,
    adjust,
    changes,
    gauge,
    point_residual,
    transform_rig,
)
from hypose.calibration.sync_motion import (
    Curves,
    at_the_end,
    keypoint_curves,
    offsets_within,
    solve_offsets,
    solve_widely,
)
from hypose.cameras.camera import CameraRig, triangulate
from hypose.errors import EvidenceError
from hypose.evidence.keypoint_check import SeenT, Trial, best_trial, disagreement, sizes, trials, undistorted
from hypose.geometry import Array, transform


def undo_faults(
    rig: CameraRig,
    seen: SeenT,
    trials: Callable[[CameraRig, SeenT], Iterator[Trial[SeenT]]],
    measure: Callable[[CameraRig, SeenT, Sequence[int]], float],
    few: Callable[[SeenT], SeenT],
    o: Limits,
    most: int,
    agree: float = np.inf,
) -> tuple[list[Finding], CameraRig, SeenT]:
    """Find and undo gross faults, the one with the largest effect first.

    seen: observations of the views: key points (C, T, K, 3) or mask tracks.
    trials: function that yields the suspected faults of cameras and observations, each one undone.
    measure: function of cameras, observations and view indices (none: all) that gives the disagreement of these
        views with the others, in shares of the person's size.
    few: function that selects the frames by which trials are compared.
    o: limits.
    most: largest number of faults.
    agree: largest disagreement that may remain, in shares of the person's size.
    Returns: the findings; cameras and observations after the faults were undone.
    """
    findings: list[Finding] = []
    for _ in range(most):
        trial, before, after = best_trial(rig, seen, trials, measure, few)
        least = o.gross_lens if trial is not None and trial.kind == "distortion" else o.gross
        if trial is None or before < least or after > min(o.gross_cured * before, agree):
            break
        names = tuple(rig.names[k] for k in trial.views)
        text = (
            f"{' and '.join(names) if 0 < len(names) < len(rig) else 'All cameras'}: {trial.words}; with that undone "
            f"the views agree to {100 * after:.1f} % of the person's size instead of {100 * before:.1f} %"
        )
        findings.append(Finding(trial.kind, names, text, trial.cure, before - after))
        rig, seen = trial.rig, trial.seen
    return findings, rig, seen


def undo_point_faults(
    rig: CameraRig,
    pixels: Array,
    names: Sequence[str],
    stored: Sequence[tuple[int, int] | None],
    o: Limits,
    most: int,
    every: int = 1,
) -> tuple[list[Finding], CameraRig, Array]:
    """Find and undo gross faults by key points.

    pixels: (C, T, K, 3) distorted px, and confidence.
    names: K names of the key points.
    stored: width and height of each view's stored images, px; None where unknown.
    o: limits.
    most: largest number of faults.
    every: trials are compared by every n-th frame.
    Returns: the findings; the corrected cameras; the corrected key points (C, T, K, 3).
    """
    return undo_faults(
        rig, pixels, lambda r, p: trials(r, p, names, stored), disagreement, lambda p: p[:, ::every], o, most
    )


# ---- doctor timing -------------------------------------------------------------------------------------------------
# Views that are not synchronous with the others, found by their key points.


_LEAST_FRAMES = 24
_PART = 0.62
"""Share of a clip that is used to confirm the result of the whole; half of it would leave too few frames after a shift
by a lag."""


def late_views(rig: CameraRig, pixels: Array, o: Limits) -> tuple[Array, Array]:
    """Estimate the delay of each view against the others; with two views, against the first one.

    pixels: (C, T, K, 3) key points of consecutive frames: distorted px, and confidence.
    o: limits of the test.
    Returns: late (C,) delay, frames, positive where the view is late, 0 where it is not certain; sd (C,) standard
        deviation, frames, infinite where the true delay may exceed the searched range, 0 for all views where no delay
        was estimated.
    """
    n, frames = pixels.shape[:2]
    if n < 2 or frames < _LEAST_FRAMES:
        return np.zeros(n), np.zeros(n)
    uv, confidence = undistorted(rig, pixels)
    late, sd = certain_delays(partial(keypoint_curves, rig, uv, confidence, step=0.5), n, o, o.late, o.late_gain)
    if late.any():
        late = np.where(_contradicted(rig, uv, confidence, late, o), 0.0, late)
    return late, sd


def certain_delays(
    curves: Callable[[float], Curves], n_views: int, o: Limits, least: float, gain: float
) -> tuple[Array, Array]:
    """Estimate the delay of each view against the others, where it is certain.

    curves: function of the largest offset (frames) that gives the curves of disagreement.
    o: limits of the test.
    least: smallest delay, frames.
    gain: least decrease of the disagreement, in half log likelihoods.
    Returns: delay (C,), frames, positive where the view is late, 0 where it is not certain; standard deviation (C,),
        frames, infinite where the true delay may exceed the searched range.
    """
    try:
        offsets, reach = solve_widely(curves, n_views, o.largest_lag)
    except EvidenceError:
        return np.zeros(n_views), np.zeros(n_views)
    found = _by_first_of_two(offsets.frames)
    certain = (offsets.gain >= gain) & (np.abs(found) >= np.maximum(least, o.late_sd * offsets.sd))
    ended = at_the_end(offsets, reach) & (np.abs(found) > 0.5 * reach)
    return np.where(certain, found, 0.0), np.where(ended, np.inf, offsets.sd)


def _contradicted(rig: CameraRig, uv: Array, confidence: Array, found: Array, o: Limits) -> NDArray[np.bool_]:
    """Test whether the first or the last part of a clip contradicts the delay found in the whole clip.

    uv, confidence: (C, T, K, 2) undistorted px and (C, T, K).
    found: (C,) delay, frames.
    Returns: (C,) True where a part contradicts it.
    Why: in a person who stands and waves few points move, and their lasting errors look like delayed motion. They
        differ between parts of a clip.
    """
    out, long = np.zeros(len(rig), np.bool_), round(_PART * uv.shape[1])
    if long < _LEAST_FRAMES:
        return out
    for part in (slice(None, long), slice(-long, None)):
        curves = keypoint_curves(rig, uv[:, part], confidence[:, part], o.largest_lag, step=0.5)
        try:
            offsets = solve_offsets(curves, len(rig))
        except EvidenceError:
            continue
        size = np.abs(found)
        out |= (offsets.sd < size / 3) & (np.abs(_by_first_of_two(offsets.frames) - found) > np.maximum(size / 2, 0.5))
    return out & (np.abs(found) < offsets_within(o.largest_lag, long) - 1)


def _by_first_of_two(frames: Array) -> Array:
    """Convert delays (C,) in frames: of two views, make them relative to the first one."""
    return frames - (frames[0] if len(frames) == 2 else 0.0)


def timing_findings(rig: CameraRig, late: Array, sd: Array, fault: bool = True) -> Iterator[Finding]:
    """Yield a finding for each view that is late or early.

    late, sd: (C,) results of `late_views`, frames.
    fault: whether the findings count as faults; False: as information only.
    """
    for name, x, s in zip(rig.names, late, sd, strict=True):
        if x != 0:
            rest, cure = f" (sd {s:.2f})", "run hypose sync, and track what it writes"
            if not np.isfinite(s):
                rest = ", or more: the clip is too short to tell"
                cure = "run hypose sync on more frames, with a larger --largest"
            text = f"{name}: {abs(x):.1f} frames {'late' if x > 0 else 'early'} against the other views{rest}"
            yield Finding("late", (name,), text, cure, abs(x), INVALID if fault else REVIEW)


# ---- doctor extrinsics ---------------------------------------------------------------------------------------------
# Check of the camera poses: a fast refinement on the key points of some frames, judged on others.


AGREE = 0.02
"""Largest disagreement, as a share of the person's size, of views of one person with correct cameras
(`disagreement`)."""
FAR_DEG, FAR_M = 10.0, 0.5
"""Movement of a camera by a refinement, degrees and m, above which wrong key points are more likely than a wrong
calibration."""
REFINE = "run hypose check --refine and use the calibration that it writes"
"""Next step for a camera that is displaced."""
_MOST_FRAMES = 30
_COMMON = 60  # points that two views have to see together to judge each other


def judge_extrinsics(rig: CameraRig, pixels: Array, o: Limits) -> tuple[list[Finding], tuple[CameraChange, ...] | None]:
    """Check the camera poses by a refinement on some frames and its effect on others.

    pixels: (C, T, K, 3) synchronous distorted px, and confidence.
    o: limits.
    Returns: findings, and the change of each camera by the refinement; None where two views see too few common points.
    """
    c, frames = pixels.shape[:2]
    uv, confidence = undistorted(rig, pixels)
    used = np.unique(np.linspace(0, frames - 1, min(_MOST_FRAMES, (frames + 1) // 2)).astype(np.int64))
    rest = np.setdiff1d(np.arange(frames), used)

    def of(which: NDArray[np.int64]) -> tuple[Array, Array]:
        return uv[:, which].reshape(c, -1, 2), confidence[:, which].reshape(c, -1)

    try:
        found = adjust(rig.pinhole(), *of(used))
        lens = adjust(rig.pinhole(), *of(used), radial=True)
    except (EvidenceError, np.linalg.LinAlgError):
        return [], None
    old_from_new = gauge(found.rig, rig, found.points)
    refined = transform_rig(found.rig, old_from_new)
    size = sizes(pixels)
    person = float(np.median(size[size > 0])) if (size > 0).any() else 1.0
    judged = of(rest if len(rest) else used)
    before, after = (float(np.nanmedian(point_residual(r, *judged, min_confidence=0.3))) for r in (rig, refined))
    moved = changes(rig, refined, transform(old_from_new, found.points))
    far = any(m.turn_deg > FAR_DEG or m.move_m > FAR_M for m in moved)
    if min(before, after) > o.scatter * person or (far and after > AGREE * person):
        said = (
            f"the key points miss each other by {before:.1f} px, and by {after:.1f} px still when every camera is "
            "moved (frames not used)"
        )
        return [scatter(rig, lambda r, kept: disagreement(r, pixels[kept]), AGREE, said, _OTHER_PERSON, before)], moved
    findings = _wrong_lenses(rig, lens, *judged, after, person, o) if c > 2 else []
    if any(f.fault for f in findings) or after >= o.extrinsics * before or before - after <= o.gain * person:
        return findings, moved
    missed = (
        f"the key points miss each other by {before:.1f} px, after a refinement by {after:.1f} px (frames not used)"
    )
    px = np.array([m.image_px for m in moved])
    own = px / np.where(size > 0, size, person)
    off = own > max(o.moved, 0.2 * np.nanmax(own))  # a part of the movement always goes to the other cameras
    seen = (confidence > 0.3).reshape(c, -1).astype(int)
    common = (seen @ seen.T >= _COMMON) & ~np.eye(c, dtype=bool)
    sure = common.sum(1) > 1
    findings += [displaced(m, m.image_px, missed) for m in itertools.compress(moved, off & sure)]
    unsure = off & ~sure
    if unsure.any() and not any(f.fault for f in findings):
        names = tuple(itertools.compress(rig.names, unsure | common[unsure].any(0)))
        two = "they do not agree, and two views alone cannot show which of them is wrong"
        text = f"{' and '.join(names)}: {two}; {missed}"
        cure = "film with a third camera, or run hypose check --refine"
        findings.append(Finding("extrinsics", names, text, cure, px[unsure].max()))
    return findings, moved


def displaced(change: CameraChange, px: float, evidence: str) -> Finding:
    """Make the finding that a camera is displaced.

    px: movement of the person in its image, px of the calibrated size.
    evidence: how much the views disagree before and after the change.
    """
    text = (
        f"{change.name}: {change.turn_deg:.1f} degrees and {1000 * change.move_m:.0f} mm off, which moves the person "
        f"{px:.0f} px in its image; {evidence}"
    )
    return Finding("extrinsics", (change.name,), text, REFINE, px)


def _wrong_lenses(
    rig: CameraRig, lens: PointAdjustment, uv: Array, confidence: Array, without: float, person: float, o: Limits
) -> list[Finding]:
    """Find cameras whose lens distortion differs from their coefficients.

    lens: refinement with a radial term per camera.
    uv, confidence: (C, N, 2) undistorted px and (C, N), of frames that the refinement did not use.
    without: median residual of these frames after a refinement without radial terms, px.
    person: size of the person, px.
    o: limits.
    Returns: faults, or notes where these frames hardly fit better with the terms, because with many points a term can
        be significant without any effect.
    """
    straight = np.stack([camera.undistort_points(p) for camera, p in zip(lens.rig, uv, strict=True)])
    points, _ = triangulate(lens.rig, straight, np.where(confidence > 0.3, confidence, 0.0))
    away = np.linalg.norm(np.stack([camera.project(points) for camera in lens.rig]) - uv, axis=-1)
    freed = float(np.nanmedian(away[confidence > 0.3]))
    wrong, out = freed <= o.lens_gain * without, list[Finding]()
    for c, camera in enumerate(lens.rig):
        k1, focal = float(camera.distortion[0]), camera.K[0, 0]
        radius = np.linalg.norm(uv[c][confidence[c] > 0.3] - camera.K[:2, 2], axis=1) / focal
        effect = abs(k1) * float(np.percentile(np.r_[radius, 0.0], 90)) ** 3 * focal
        if abs(k1) > o.lens_z * lens.radial_sd[c] and effect > o.lens_px * person:
            what, cure = (
                f"its lens coefficients do not fit: a radial term of {k1:+.2f} is missing",
                "calibrate the lens again (hypose calibrate), or correct the sign and order of its coefficients",
            )
            if not wrong:
                what, cure = "other lens coefficients would fit as well", "nothing, if the lenses were calibrated"
            text = (
                f"{rig[c].name}: {what}, {effect:.1f} px where the person is; with them the residual is {freed:.1f} px "
                f"instead of {without:.1f} px"
            )
            out.append(Finding("distortion", (rig[c].name,), text, cure, effect, INVALID if wrong else REVIEW))
    return out


_OTHER_PERSON = (
    "check whether video and key points of every view are of this recording and show the same person",
    "check whether its video and key points are of this recording, of the same person, and not mirrored or turned; "
    "else calibrate this camera again, or leave the view out",
)


def scatter(
    rig: CameraRig,
    disagree: Callable[[CameraRig, list[int]], float],
    limit: float,
    said: str,
    cures: tuple[str, str],
    size: float,
) -> Finding:
    """Make the finding that the views do not show one person; it names the view without which the others agree, where
    there is exactly one, and at least four views.

    disagree: function of some of the cameras and their indices that gives their disagreement, share of the person's
        size.
    limit: largest disagreement of views that agree.
    said: how much all views disagree.
    cures: next step where all views are doubtful, and where only one is.
    size: of the finding.
    """
    views = range(len(rig))
    rest = [[k for k in views if k != c] for c in (views if len(rig) > 3 else ())]
    left = [disagree(CameraRig(tuple(rig[k] for k in kept)), kept) for kept in rest] or [np.inf]
    c = int(np.argmin(left))
    if not left[c] < limit or sum(w < max(limit, 2 * left[c]) for w in left) > 1:
        return Finding("scatter", (), f"All cameras: {said}", cures[0], size)
    others = f"without this view the others agree to {100 * left[c]:.1f} % of the person's size"
    return Finding("scatter", (rig.names[c],), f"{rig.names[c]}: {said}; {others}", cures[1], size)
