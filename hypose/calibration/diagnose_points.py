"""Diagnostics with key points: gross faults, timing, and camera poses.

Gross faults are found by trial: each suspected fault is undone, and it is confirmed when the views agree afterwards.
    The measure is the distance of key points from the triangulation of all views (or, for silhouettes, the disagreement
    of tangent planes between two views), in shares of the person's size, so that it is valid for any image size.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.calibration.findings import INVALID, REVIEW, Finding, Limits, SeenT, Trial
from hypose.calibration.refine_points import (
    CameraChange,
    PointAdjustment,
    adjust,
    bent,
    changes,
    gauge,
    point_residual,
    transform_rig,
)
from hypose.calibration.sync_motion import Curves, farther, keypoint_curves, offsets_within, solve_offsets, solve_widely
from hypose.calibration.synchronisation import point_sd, sizes
from hypose.cameras.camera import Camera, CameraRig, triangulate
from hypose.errors import EvidenceError
from hypose.geometry import Array, se3_inverse, transform

CONVENTIONS: tuple[tuple[str, Callable[[Camera], Array]], ...] = (
    ("64 times too large (Qualisys coefficients of another version, divided by 64)", lambda c: c.distortion / 64),
    ("64 times too small (Qualisys coefficients must not be divided by 64)", lambda c: c.distortion * 64),
    ("of the opposite sign", lambda c: -c.distortion),
    ("those of images that are already undistorted", lambda c: np.zeros(5)),
)


_TURNS = (
    ("mirrored", "mirrored", (-1.0, 1.0), "mirror the video back (ffmpeg -i IN -vf hflip OUT)"),
    ("turned", "upside down", (-1.0, -1.0), "turn the video back (ffmpeg -i IN -vf hflip,vflip OUT)"),
    ("mirrored", "flipped top to bottom", (1.0, -1.0), "flip the video back (ffmpeg -i IN -vf vflip OUT)"),
)
"""Kind, words, factors of x and y about the middle of the picture, cure."""


def geometric_trials(
    rig: CameraRig, seen: SeenT, turned: Callable[[int, Array], SeenT], ordered: Callable[[NDArray[np.int64]], SeenT]
) -> Iterator[Trial[SeenT]]:
    """Yield trials for mirrored or rotated images of one camera, exchanged views of two cameras, and inverted poses.

    seen: what the views see.
    turned: function of view and factors (2,) that multiplies the view's positions about the picture's middle.
    ordered: function that puts the views into another order.
    """
    for c, camera in enumerate(rig):
        for kind, words, factor, cure in _TURNS:
            cure = f"{cure}, or calibrate {camera.name} from such images"
            yield Trial(kind, (c,), f"its images are {words}", cure, rig, turned(c, np.array(factor)))
    for a, b in itertools.combinations(range(len(rig)), 2):
        order = np.arange(len(rig))
        order[[a, b]] = b, a
        words = f"its video is that of camera {rig.names[b]} and the other way round"
        cure = f'exchange camera = "{rig.names[a]}" and camera = "{rig.names[b]}" in recording.toml'
        yield Trial("swapped", (a, b), words, cure, rig, ordered(order))
    inverse = CameraRig(tuple(replace(c, camera_from_world=se3_inverse(c.camera_from_world)) for c in rig))
    words = "the poses are those of the cameras in the world, not of the world in the cameras"
    yield Trial("inverted", (), words, "invert every camera's rotation and translation", inverse, seen)


def gross_finding(rig: CameraRig, trial: Trial[Any], before: float, after: float, who: str = "views") -> Finding:
    """Make the finding of a confirmed fault.

    trial: the suspected fault.
    before, after: disagreement with and without the fault, in shares of the person's size.
    who: what agrees without the fault, for the sentence.
    """
    names = tuple(rig.names[k] for k in trial.views)
    text = (
        f"{' and '.join(names) if 0 < len(names) < len(rig) else 'All cameras'}: {trial.words}; with that undone the "
        f"{who} agree to {100 * after:.1f} % of the person's size instead of {100 * before:.1f} %"
    )
    return Finding(trial.kind, names, text, trial.cure, before - after)


def mirrored_names(names: Sequence[str]) -> list[int]:
    """Find for each key point the index of the same point on the other side of the body, by its name (left_...,
    right_...).

    Returns: K indices; a point without another side keeps its own.
    """
    other = {"left": "right", "right": "left"}
    out = []
    for k, n in enumerate(names):
        side, _, rest = n.partition("_")
        twin = f"{other[side]}_{rest}" if side in other else n
        out.append(list(names).index(twin) if twin in names else k)
    return out


def disagreement(rig: CameraRig, pixels: Array, views: Sequence[int] = ()) -> float:
    """Compute the disagreement of key points with their triangulation, in shares of the person's size, at most 10.

    It is the mean over `views` of the median distance in px. Points behind a camera count as far away.

    pixels: (C, T, K, 3) distorted px, and confidence.
    views: views that are judged; all by default.
    Why: points are triangulated from the other views when these are at least two, so that a bad view does not affect
        the points by which it is judged; else from all.
    """
    c = len(rig)
    judged = list(views) or list(range(c))
    others = [k for k in range(c) if k not in judged]
    by = others if len(others) > 1 else list(range(c))
    needed = sorted({*judged, *by})
    uv, confidence = undistorted(CameraRig(tuple(rig[k] for k in needed)), pixels[needed])
    at = {k: i for i, k in enumerate(needed)}
    rows = [at[k] for k in by]
    flat, seen = uv.reshape(len(needed), -1, 2), np.where(confidence > 0.3, confidence, 0.0).reshape(len(needed), -1)
    points, _ = triangulate(CameraRig(tuple(rig[k] for k in by)), flat[rows], seen[rows])
    known = np.isfinite(points).all(1)
    out = []
    for k in judged:
        size = float(sizes(pixels[k : k + 1])[0])
        use = known & (seen[at[k]] > 0)
        if use.sum() > 20 and size > 0:
            distance = np.linalg.norm(rig[k].project_pinhole(points[use]) - flat[at[k]][use], axis=1)
            out.append(min(float(np.median(np.nan_to_num(distance, nan=1e6))) / size, 10.0))
    return float(np.mean(out)) if out else float("nan")


def undistorted(rig: CameraRig, pixels: Array) -> tuple[Array, Array]:
    """Remove the lens distortion from key points.

    pixels: (C, T, K, 3) distorted px, and confidence.
    Returns: (C, T, K, 2) px, and confidence (C, T, K), 0 where the point cannot be undistorted.
    """
    uv = np.stack([c.undistort_points(p[..., :2]) for c, p in zip(rig, pixels, strict=True)])
    far = 20 * rig.sizes.max()
    fine = np.isfinite(uv).all(-1) & (np.abs(np.nan_to_num(uv)) < far).all(-1)
    return np.where(fine[..., None], uv, 0.0), np.where(fine, pixels[..., 2], 0.0)


def trials(
    rig: CameraRig, pixels: Array, names: Sequence[str], stored: Sequence[tuple[int, int] | None]
) -> Iterator[Trial[Array]]:
    """Yield all suspected faults of a rig and its key points, each one undone.

    pixels: (C, T, K, 3) distorted px, and confidence.
    names: K names of the key points.
    stored: width and height of each view's stored images, px; None where unknown.
    """
    twin = mirrored_names(names)

    def turned(c: int, factor: Array) -> Array:
        return _turned(pixels, rig, c, factor, twin if factor.prod() < 0 else None)

    yield from geometric_trials(rig, pixels, turned, lambda order: pixels[order])
    every = tuple(range(len(rig)))
    for c in every:
        yield from _sizes(rig, pixels, c, stored[c])
    for shift in (1, len(rig) - 1) if len(rig) > 2 else ():
        words = "the videos belong to other cameras: their order is shifted by one"
        cure = 'give each view its camera = "..." in recording.toml'
        yield Trial("swapped", every, words, cure, rig, pixels[np.roll(np.arange(len(rig)), shift)])
    # a mirrored picture exchanges left and right; a reversed axis alone does not
    for kind, words, factor, other, cure in (
        (
            "mirrored",
            "all images are mirrored",
            (-1.0, 1.0),
            twin,
            "mirror the videos back (ffmpeg -i IN -vf hflip OUT)",
        ),
        ("turned", "all images are upside down", (-1.0, -1.0), None, "turn the videos back (ffmpeg -vf hflip,vflip)"),
        (
            "flipped",
            "the key points' y counts from the bottom of the images (or all videos are flipped)",
            (1.0, -1.0),
            None,
            "write y as the image's height minus y",
        ),
    ):
        points = pixels
        for c in every:
            points = _turned(points, rig, c, np.array(factor), other)
        yield Trial(kind, every, words, cure, rig, points)
    lenses = [c for c in every if np.abs(rig[c].distortion).max(initial=0) > 0]
    for views in ((), *((c,) for c in lenses)) if lenses else ():
        whose = rig.names[views[0]] if views else "the calibration file"
        cure = f"correct the distortion coefficients of {whose}, or calibrate the lens again"
        for words, coefficients in CONVENTIONS:
            cameras = [
                replace(k, distortion=coefficients(k)) if c in (views or every) else k for c, k in enumerate(rig)
            ]
            words = f"its distortion coefficients are {words}"
            yield Trial("distortion", views, words, cure, CameraRig(tuple(cameras)), pixels)


def _turned(pixels: Array, rig: CameraRig, c: int, factor: Array, twin: list[int] | None) -> Array:
    """Multiply the key points of one view about the picture's middle.

    pixels: (C, T, K, 3) distorted px, and confidence.
    c: index of the view.
    factor: (2,) of x and y.
    twin: index of each point on the other side, where left and right are exchanged as well; None where not.
    Returns: a changed copy of `pixels`.
    """
    middle = (np.array(rig[c].size) - 1) / 2
    out = _placed(pixels, c, middle + factor * (pixels[c, ..., :2] - middle))
    if twin is not None:
        out[c] = out[c][:, twin]
    return out


def _placed(pixels: Array, c: int, xy: Array) -> Array:
    """Replace the positions (T, K, 2) of the detected key points of view c."""
    out = pixels.copy()
    out[c, ..., :2] = np.where(pixels[c, ..., 2:] > 0, xy, 0.0)
    return out


def _sizes(rig: CameraRig, pixels: Array, c: int, stored: tuple[int, int] | None) -> Iterator[Trial[Array]]:
    """Yield trials for key points of images of another size than calibrated: scaled or cropped.

    pixels: (C, T, K, 3) distorted px, and confidence.
    c: index of the view.
    stored: width and height of its stored images, px; None where unknown, then usual factors are tried.
    """
    camera = rig[c]
    w, h = camera.size
    xy = pixels[c, ..., :2]
    known = stored is not None and tuple(stored) != (w, h)
    factors = [(w / stored[0], h / stored[1])] if known and stored is not None else []
    if not known:
        factors = [(s, s) for s in (0.5, 2 / 3, 0.75, 4 / 3, 1.5, 2.0)]
    for fx, fy in factors:
        new = _placed(pixels, c, (xy + 0.5) * np.array([fx, fy]) - 0.5)
        if known and stored is not None:
            words = (
                f"its key points are in pixels of the stored {stored[0]} x {stored[1]} images, not of the calibrated"
            )
        else:
            words = f"its key points are in pixels of images {1 / fx:.2f} times the calibrated size"
        cure = 'set keypoint_pixels = "image" in recording.toml'
        yield Trial("scaled", (c,), words + f" {w} x {h}", cure, rig, new)
    if known and stored is not None and (stored[0] < w or stored[1] < h):
        dw, dh = max(w - stored[0], 0), max(h - stored[1], 0)
        places = {(x, y) for x in (0.0, 0.5, 1.0) for y in (0.0, 0.5, 1.0)}
        for x, y in sorted(places):
            dx, dy = round(x * dw), round(y * dh)
            if (dx, dy) == (0, 0):
                continue
            words = f"its images were cut: {dx} px are missing at the left and {dy} px at the top"
            cure = f"subtract ({dx}, {dy}) from the principal point of {camera.name} and give its size as {stored}"
            # or the loader has stretched them to the calibrated size
            stretched = (xy + 0.5) * np.array([stored[0] / w, stored[1] / h]) - 0.5
            for new in (xy, stretched):
                yield Trial("cropped", (c,), words, cure, rig, _placed(pixels, c, new + np.array([dx, dy])))


def best_trial(
    rig: CameraRig, pixels: Array, names: Sequence[str], stored: Sequence[tuple[int, int] | None], every: int = 4
) -> tuple[Trial[Array] | None, float, float]:
    """Find the trial after which the affected views agree best.

    Trials that make the agreement of all views together worse are rejected.

    pixels: (C, T, K, 3) distorted px, and confidence.
    names: K names of the key points.
    stored: as in `trials`.
    every: only every n-th frame is used.
    Returns: the trial (None without one), and the disagreement before and after it, in shares of the person's size.
    """
    few = pixels[:, ::every]
    all_before = disagreement(rig, few)
    before: dict[tuple[int, ...], float] = {}
    scored: list[tuple[float, float, int]] = []
    for k, trial in enumerate(trials(rig, few, names, stored)):
        if trial.views not in before:
            before[trial.views] = disagreement(rig, few, trial.views)
        scored.append((disagreement(trial.rig, trial.seen, trial.views), before[trial.views], k))
    # the camera with the largest disagreement is tested first, because its fault affects the others
    worst = max((b for _, b, _ in scored), default=0.0)
    order = sorted(scored, key=lambda x: x[0] / max(x[1], 1e-6))
    for after, was, k in order[:6]:
        if was < 0.5 * worst and after > 0.2 * was:
            continue
        trial = next(itertools.islice(trials(rig, pixels, names, stored), k, None))
        if disagreement(trial.rig, trial.seen[:, ::every]) < all_before:
            return trial, was, after
    return None, all_before, all_before


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
    scatter = point_sd(uv, confidence)

    def curves(largest: float) -> Curves:
        return keypoint_curves(rig, uv, confidence, largest, scatter, step=0.5)

    late, sd = certain_delays(curves, n, o, o.late, o.late_gain)
    if late.any():
        late = np.where(_contradicted(rig, uv, confidence, scatter, late, o), 0.0, late)
    return late, sd


def certain_delays(
    curves: Callable[[float], Curves], n_views: int, o: Limits, least: float, gain: float
) -> tuple[Array, Array]:
    """Estimate the delay of each view against the others, where it is certain.

    curves: function of the largest offset (frames) that gives the curves of disagreement.
    o: limits of the test.
    least: smallest delay, frames.
    gain: least decrease of the disagreement, in half log likelihoods.
    Returns: as of `late_views`.
    """
    try:
        offsets, reach = solve_widely(curves, n_views, o.largest_lag)
    except EvidenceError:
        return np.zeros(n_views), np.zeros(n_views)
    found = _by_first_of_two(offsets.frames)
    certain = (offsets.gain >= gain) & (np.abs(found) >= np.maximum(least, o.late_sd * offsets.sd))
    return np.where(certain, found, 0.0), np.where(farther(offsets, found, reach), np.inf, offsets.sd)


def _contradicted(
    rig: CameraRig, uv: Array, confidence: Array, scatter: float, found: Array, o: Limits
) -> NDArray[np.bool_]:
    """Test whether the first or the last part of a clip contradicts the delay found in the whole clip.

    uv, confidence: (C, T, K, 2) undistorted px and (C, T, K).
    scatter: standard deviation of a detection, px.
    found: (C,) delay, frames.
    Returns: (C,) True where a part contradicts it.
    Why: in a person who stands and waves few points move, and their lasting errors look like delayed motion. They
        differ between parts of a clip.
    """
    out, long = np.zeros(len(rig), np.bool_), round(_PART * uv.shape[1])
    if long < _LEAST_FRAMES:
        return out
    for part in (slice(None, long), slice(-long, None)):
        curves = keypoint_curves(rig, uv[:, part], confidence[:, part], o.largest_lag, scatter, step=0.5)
        try:
            offsets = solve_offsets(curves, len(rig))
        except EvidenceError:
            continue
        size = np.abs(found)
        away = np.abs(_by_first_of_two(offsets.frames) - found)
        out |= (offsets.sd < size / 3) & (away > np.maximum(size / 2, 0.5))
    return out & (np.abs(found) < offsets_within(o.largest_lag, long) - 1)


def _by_first_of_two(frames: Array) -> Array:
    """Convert delays (C,) in frames: of two views, make them relative to the first one."""
    return frames - (frames[0] if len(frames) == 2 else 0.0)


def timing_findings(rig: CameraRig, late: Array, sd: Array, fault: bool = True) -> Iterator[Finding]:
    """Yield a finding for each view that is late or early.

    late, sd: (C,) results of `late_views`, frames.
    fault: whether the findings are faults.
    """
    for name, x, s in zip(rig.names, late, sd, strict=True):
        if x != 0:
            way, cure = "late" if x > 0 else "early", "run hypose sync, and track what it writes"
            text = f"{name}: {abs(x):.1f} frames {way} against the other views (sd {s:.2f})"
            if not np.isfinite(s):
                text = (
                    f"{name}: {abs(x):.1f} frames {way} against the other views, or more: the clip is too short to tell"
                )
                cure = "run hypose sync on more frames, with a larger --largest"
            yield Finding("late", (name,), text, cure, abs(x), INVALID if fault else REVIEW)


# ---- doctor extrinsics ---------------------------------------------------------------------------------------------
# Check of the camera poses: a fast refinement on the key points of some frames, judged on others.


AGREE = 0.02
"""Largest disagreement, as a share of the person's size, of views of one person with correct cameras
(`disagreement`)."""
FAR_DEG, FAR_M = 10.0, 0.5
"""Movement of a camera by a refinement, degrees and m, above which wrong key points are more likely than a wrong
calibration."""
_MOST_FRAMES = 30
_COMMON = 60  # points that two views have to see together to judge each other


def judge_extrinsics(rig: CameraRig, pixels: Array, o: Limits) -> tuple[list[Finding], tuple[CameraChange, ...]] | None:
    """Check the camera poses by a refinement on some frames and its effect on others.

    pixels: (C, T, K, 3) synchronous distorted px, and confidence.
    o: limits.
    Returns: findings, and the change of each camera by the refinement; None where two views see too few common points.
    """
    c, frames = pixels.shape[:2]
    uv, confidence = undistorted(rig, pixels)
    ideal = rig.pinhole()
    used = np.unique(np.linspace(0, frames - 1, min(_MOST_FRAMES, (frames + 1) // 2)).astype(np.int64))
    rest = np.setdiff1d(np.arange(frames), used).astype(np.int64)
    rest = rest if len(rest) else used

    def of(which: NDArray[np.int64]) -> tuple[Array, Array]:
        return uv[:, which].reshape(c, -1, 2), confidence[:, which].reshape(c, -1)

    try:
        found = adjust(ideal, *of(used))
        lens = adjust(ideal, *of(used), radial=True) if c > 2 else None
    except (EvidenceError, np.linalg.LinAlgError):
        return None
    old_from_new = gauge(found.rig, ideal, found.points)
    refined = transform_rig(found.rig, old_from_new)
    size = sizes(pixels)
    person = float(np.median(size[size > 0])) if (size > 0).any() else 1.0
    before, after = (_residual(r, *of(rest)) for r in (ideal, refined))
    moved = changes(ideal, refined, transform(old_from_new, found.points))
    findings: list[Finding] = []
    far = any(m.turn_deg > FAR_DEG or m.move_m > FAR_M for m in moved)
    if min(before, after) > o.scatter * person or (far and after > AGREE * person):
        return [_no_one_person(rig, pixels, before, after)], moved
    if lens is not None:
        findings += _lenses(rig, ideal, lens, uv, confidence, rest, found, person, o)
    if not any(f.fault for f in findings) and after < o.extrinsics * before and before - after > o.gain * person:
        own = np.array([m.image_px for m in moved]) / np.where(size > 0, size, person)
        against = _witnesses(confidence)
        unsure = []
        for k, m in enumerate(moved):
            if own[k] > max(o.moved, 0.2 * np.nanmax(own)):  # a part of the movement always goes to the other cameras
                if against[k] < 2:
                    unsure.append(k)
                    continue
                text = (
                    f"{m.name}: {m.turn_deg:.1f} degrees and {1000 * m.move_m:.0f} mm off, which moves the person "
                    f"{m.image_px:.0f} px in its image; the key points miss each other by {before:.1f} px, after a "
                    f"refinement by {after:.1f} px (frames not used)"
                )
                cure = "run hypose check --refine and use the calibration that it writes"
                findings.append(Finding("extrinsics", (m.name,), text, cure, float(m.image_px)))
        if unsure and not any(f.fault for f in findings):
            findings.append(_undecided(rig, unsure, confidence, before, after, max(moved[k].image_px for k in unsure)))
    return findings, moved


def _no_one_person(rig: CameraRig, pixels: Array, before: float, after: float) -> Finding:
    """Make the finding that the views disagree wherever the cameras are moved; it names a view without which the others
    agree.

    pixels: (C, T, K, 3) distorted px, and confidence.
    before, after: median residual before and after all cameras were moved, px.
    """
    views = range(len(rig)) if len(rig) > 3 else ()
    rest = [np.delete(np.arange(len(rig)), c) for c in views]
    without = [disagreement(CameraRig(tuple(rig[int(k)] for k in r)), pixels[r]) for r in rest]
    said = (
        f"the key points miss each other by {before:.1f} px, and by {after:.1f} px still when every camera is moved "
        "(frames not used)"
    )
    c = int(np.argmin(without)) if without else -1
    if c < 0 or not without[c] < AGREE or sum(w < max(AGREE, 2 * without[c]) for w in without) > 1:
        cure = "check whether video and key points of every view are of this recording and show the same person"
        return Finding("scatter", (), f"All cameras: {said}", cure, before)
    text = (
        f"{rig.names[c]}: {said}; without this view the others agree to {100 * without[c]:.1f} % of the person's size"
    )
    cure = (
        "check whether its video and key points are of this recording, of the same person, and not mirrored or turned; "
        "else calibrate this camera again, or leave the view out"
    )
    return Finding("scatter", (rig.names[c],), text, cure, before)


def _witnesses(confidence: Array) -> NDArray[np.int64]:
    """Count for each view (C,) the other views with enough common points to judge it."""
    seen = (confidence > 0.3).reshape(len(confidence), -1)
    common = (seen[:, None] & seen[None]).sum(-1)
    np.fill_diagonal(common, 0)
    return (common >= _COMMON).sum(1)


def _undecided(
    rig: CameraRig, views: list[int], confidence: Array, before: float, after: float, image_px: float
) -> Finding:
    """Make the finding that pairs of cameras disagree, where it is unknown which camera is wrong.

    views: indices of the cameras that moved.
    confidence: (C, T, K) of the key points.
    before, after: median residual before and after the refinement, px.
    image_px: largest movement of the person in an image by the refinement, px.
    """
    seen = (confidence > 0.3).reshape(len(confidence), -1)
    partners = {j for k in views for j in range(len(rig)) if (seen[k] & seen[j]).sum() >= _COMMON}
    names = tuple(rig.names[k] for k in sorted({*views, *partners}))
    text = (
        f"{' and '.join(names)}: they do not agree, and two views alone cannot show which of them is wrong; the key "
        f"points miss each other by {before:.1f} px, after a refinement by {after:.1f} px (frames not used)"
    )
    return Finding("extrinsics", names, text, "film with a third camera, or run hypose check --refine", image_px)


def _residual(rig: CameraRig, uv: Array, confidence: Array) -> float:
    return float(np.nanmedian(point_residual(rig, uv, confidence, min_confidence=0.3)))


def _lenses(
    rig: CameraRig,
    ideal: CameraRig,
    lens: PointAdjustment,
    uv: Array,
    confidence: Array,
    rest: NDArray[np.int64],
    plain: PointAdjustment,
    person: float,
    o: Limits,
) -> list[Finding]:
    """Find cameras whose lens distortion differs from their coefficients.

    rig, ideal: the cameras with and without distortion.
    lens, plain: refinement with and without a radial term per camera.
    uv, confidence: (C, T, K, 2) undistorted px and (C, T, K).
    rest: frames that the refinements did not use.
    person: size of the person, px.
    o: limits.
    Returns: faults where the other frames fit better with a radial term per camera, else at most one note.
    Why: with many points a term can be significant without any effect.
    """
    c, filmed = len(rig), uv[:, rest].reshape(len(rig), -1, 2)
    seen = confidence[:, rest].reshape(c, -1)
    without, freed = _residual(plain.rig, filmed, seen), _bent_residual(lens, filmed, seen)
    off, largest = list[str](), 0.0
    out = []
    for n, camera in enumerate(ideal):
        radius = np.linalg.norm((uv[n][confidence[n] > 0.3] - camera.K[:2, 2]) / camera.K[0, 0], axis=1)
        far = float(np.percentile(radius, 90)) if len(radius) else 0.0
        effect = abs(lens.radial[n]) * far**3 * camera.K[0, 0]
        if abs(lens.radial[n]) > o.lens_z * lens.radial_sd[n] and effect > o.lens_px * person:
            off.append(rig[n].name)
            largest = max(largest, effect)
            text = (
                f"{camera.name}: its lens coefficients do not fit: a radial term of {lens.radial[n]:+.2f} is missing, "
                f"{effect:.1f} px where the person is; the residual falls from {without:.1f} to {freed:.1f} px"
            )
            cure = "calibrate the lens again (hypose calibrate), or correct the sign and order of its coefficients"
            out.append(Finding("distortion", (rig[n].name,), text, cure, effect))
    if not off or freed <= o.lens_gain * without:
        return out
    text = (
        f"{', '.join(off)}: other lens coefficients would fit as well, but the views would hardly agree better "
        f"({freed:.1f} instead of {without:.1f} px)"
    )
    return [Finding("distortion", tuple(off), text, "nothing, if the lenses were calibrated", largest, severity=REVIEW)]


def _bent_residual(lens: PointAdjustment, pixels: Array, confidence: Array) -> float:
    """Compute the median distance, px, between detections (C, N, 2) and projections with the estimated radial terms.

    Why: the terms are applied to the projections, because pixels without distortion would have another scale and could
        not be compared.
    """
    straight = np.stack([_bent_back(k, pixels[n], lens.radial[n]) for n, k in enumerate(lens.rig)])
    points, _ = triangulate(lens.rig, straight, np.where(confidence > 0.3, confidence, 0.0))
    r = np.stack([bent(k, k.project_pinhole(points), lens.radial[n]) for n, k in enumerate(lens.rig)]) - pixels
    return float(np.nanmedian(np.where(confidence > 0.3, np.linalg.norm(r, axis=-1), np.nan)))


def _bent_back(camera: Camera, pixels: Array, radial: float) -> Array:
    """Remove the radial term from pixels."""
    centre, focal = camera.K[:2, 2], camera.K[0, 0]
    x = (pixels - centre) / focal
    y = x.copy()
    for _ in range(5):
        y = x / (1 + radial * (y**2).sum(-1, keepdims=True))
    return centre + y * focal
