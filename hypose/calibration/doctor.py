"""The doctor: is this calibration right for this recording, and if not, what is wrong with which camera?

Each fault is looked for by undoing it: if the views agree much better afterwards, it is there. Gross faults come
first (mirrored or turned images, exchanged cameras, another image size, lens coefficients of another convention), then
a constant shift of the key points and timing, then the cameras' poses, because each hides the next. The measures are
shares of the person's size in the image, so that limits hold for any resolution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hypose.calibration.common_focal import focal_by_points, focal_findings
from hypose.calibration.doctor_depth import depth_findings
from hypose.calibration.doctor_extrinsics import Extrinsics, judge_extrinsics
from hypose.calibration.doctor_findings import Clip, Finding, Limits
from hypose.calibration.doctor_masks import Alignment, align, tangency, tangency_by_view, view_masks
from hypose.calibration.doctor_points import best_trial, disagreement, sizes, undistorted
from hypose.calibration.doctor_report import Report, ViewReport, clip_findings, person_findings
from hypose.calibration.doctor_silhouettes import examine_silhouettes
from hypose.calibration.doctor_timing import late_views, timing_findings
from hypose.calibration.in_step import points_at
from hypose.calibration.refine_points import left_out_residual, point_residual
from hypose.calibration.sync_motion import mask_tracks
from hypose.cameras.camera import CameraRig
from hypose.errors import EvidenceError
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Silhouettes
from hypose.geometry import Array


@dataclass(frozen=True)
class Observed:
    """What the doctor looks at: consecutive frames of one recording.

    rig: as calibrated, with lens distortion; keypoints (C, T, K, 3) in px of the calibrated, distorted images
    (confidence 0: missing) and their names; silhouettes: T, undistorted, at any working size, made without the key
    points (else they agree with them whatever is wrong); clips: one per view; height: of the person, m, when known;
    people: sentences about who else is there; depths: of some frames, where there are depth cameras."""

    rig: CameraRig
    keypoints: Array | None = None
    names: tuple[str, ...] = ()
    silhouettes: Sequence[Silhouettes | None] | None = None
    clips: tuple[Clip, ...] = ()
    frame_rate: float = 25.0
    height: float | None = None
    people: tuple[str, ...] = ()
    depths: Sequence[Depth] = ()


@dataclass(frozen=True)
class Cured:
    """The observations after the cures: rig, key points in step and in place; late (C,) frames; shift (C, 2) px of the
    calibrated size to add to the images; keypoint_lag in frames."""

    rig: CameraRig
    keypoints: Array | None
    late: Array
    shift: Array
    keypoint_lag: int


@dataclass
class _State:
    rig: CameraRig
    pixels: Array
    findings: list[Finding] = field(default_factory=list)


def examine(observed: Observed, limits: Limits | None = None) -> Report:
    """All checks that the evidence allows. An EvidenceError when there is neither key point nor silhouette."""
    return examine_and_cure(observed, limits)[0]


def examine_and_cure(observed: Observed, limits: Limits | None = None) -> tuple[Report, Cured]:
    """The report, and the observations as they are after the faults were undone (for a refinement)."""
    o = limits or Limits()
    n = len(observed.rig)
    findings = list(clip_findings(observed.rig, observed.clips, observed.frame_rate))
    findings += [Finding("people", (), text, "nothing, if that is right", 0.0, fault=False) for text in observed.people]
    by_depth = depth_findings(observed.depths)
    findings += by_depth
    if observed.keypoints is None or (observed.keypoints[..., 2] > 0.3).any((1, 2)).sum() < 2:
        if observed.silhouettes is None:
            raise EvidenceError(
                "There are neither key points of two views nor silhouettes; give the recording one of them to check "
                "its calibration."
            )
        found, views, late = examine_silhouettes(observed.rig, observed.silhouettes, o)
        # of cameras that measure, masks tell nothing better: their faults are those of the depth maps, guessed
        findings += [] if any(f.fault for f in by_depth) else found
        return Report(tuple(findings), views, None, None), Cured(
            observed.rig, observed.keypoints, late, np.zeros((n, 2)), 0
        )
    state = _State(observed.rig, observed.keypoints)
    _gross(state, observed, o)
    gross = {f.kind for f in state.findings}
    findings += state.findings
    alignments, lag, shift = _against_masks(observed, state, findings, o)
    late, sd = np.zeros(n), np.zeros(n)
    if not gross & {"inverted"}:
        late, sd = late_views(state.rig, state.pixels, o)
        findings += timing_findings(state.rig, late, sd)
    pixels = np.stack([points_at(p, x) for p, x in zip(state.pixels, late, strict=True)])
    extrinsics = None
    focal = list(focal_findings(focal_by_points(state.rig, pixels))) if n > 1 and not gross else []
    findings += focal
    later = bool((np.isinf(sd) & (late != 0)).any())  # by how much is not known: cameras would take the blame for it
    if not focal and n > 1 and not gross & {"inverted"}:
        extrinsics = judge_extrinsics(state.rig, pixels, o)
        if extrinsics is not None and later:
            findings += [f for f in extrinsics.findings if f.kind == "scatter"]
        elif extrinsics is not None:
            state.rig = extrinsics.lens_cured
            findings += extrinsics.findings
    if any(f.kind == "scatter" for f in findings):  # what never meets tells no time, and says nothing of a body
        findings = [f for f in findings if f.kind != "late"]
        late, pixels = np.zeros(n), state.pixels
    elif not later:
        findings += person_findings(state.rig, pixels, observed.names, observed.height, o)
    report = Report(tuple(findings), _views(observed, pixels, alignments, extrinsics), extrinsics, alignments)
    return report, Cured(state.rig, pixels, late, shift, lag)


def _gross(state: _State, observed: Observed, o: Limits) -> None:
    """Undoes up to three gross faults, the one that helps most first."""
    stored = [c.size for c in observed.clips] if observed.clips else [None] * len(state.rig)
    for _ in range(3):
        every = max(1, state.pixels.shape[1] // 15)
        trial, before, after = best_trial(state.rig, state.pixels, observed.names, stored, every)
        limit = o.gross_lens if trial is not None and trial.kind == "distortion" else o.gross
        if trial is None or before < limit or after > o.gross_cured * before:
            return
        names = tuple(state.rig.names[k] for k in trial.views)
        text = (
            f"{' and '.join(names) if 0 < len(names) < len(state.rig) else 'All cameras'}: {trial.words}; with that "
            f"undone the views agree to "
            f"{100 * after:.1f} % of the person's size instead of {100 * before:.1f} %"
        )
        state.findings.append(Finding(trial.kind, names, text, trial.cure, before - after))
        state.rig, state.pixels = trial.rig, trial.pixels


def _against_masks(
    observed: Observed, state: _State, findings: list[Finding], o: Limits
) -> tuple[tuple[Alignment | None, ...] | None, int, Array]:
    """Lag and shift of the key points against the masks of the same view. Returns the alignments, the common lag and
    the shifts (C, 2) to add to the images, px of the calibrated size (zero where none was found)."""
    shift = np.zeros((len(observed.rig), 2))
    if observed.silhouettes is None or observed.keypoints is None:
        return None, 0, shift
    small = next((s.rig for s in observed.silhouettes if s is not None), None)
    if small is None:
        return None, 0, shift
    scaled = {name for f in state.findings if f.kind in ("scaled", "cropped") for name in f.views}
    uv, confidence = undistorted(observed.rig, observed.keypoints)
    cured, cured_confidence = undistorted(observed.rig, state.pixels)
    made: list[Alignment | None] = []
    for c, camera in enumerate(observed.rig):
        ratio = np.array(small[c].size) / np.array(camera.size)
        source = (cured[c], cured_confidence[c]) if camera.name in scaled else (uv[c], confidence[c])
        points = np.concatenate([(source[0] + 0.5) * ratio - 0.5, source[1][..., None]], -1)
        made.append(align(points, observed.names, view_masks(observed.silhouettes, c)))
    lag, lagging = _common_lag(made, o)
    if lag:
        text = (
            f"The key points are {abs(lag)} frame{'s' if abs(lag) > 1 else ''} {'early' if lag > 0 else 'late'} "
            f"against the videos in {lagging} of {len(made)} views: file t belongs to video frame t{lag:+d}"
        )
        cure = f"set keypoint_lag = {lag} in recording.toml (counted from its present value)"
        findings.append(Finding("keypoint_lag", (), text, cure, float(abs(lag))))
    size = sizes(observed.keypoints)
    moves = _own_shifts(made, observed.rig, small)
    usual = np.where(size > 0, size, np.inf)
    for c, a in enumerate(made):
        if a is None or observed.rig[c].name in scaled:
            continue
        own = a.lag - lag
        if abs(own) > 1.0 and abs(own) > o.own_lag_sd * a.lag_sd:
            name = observed.rig[c].name
            text = (
                f"{name}: its key points are {abs(own):.1f} frames {'early' if own > 0 else 'late'} against its video"
            )
            findings.append(Finding("keypoint_lag", (name,), text, "detect its key points again", abs(own)))
        ratio = np.array(observed.rig[c].size) / np.array(small[c].size)
        move, sd = moves[c], a.shift_sd * ratio
        others = np.delete(moves, c, 0) / np.delete(usual, c)[:, None]
        spread = np.sqrt(np.nanmean(others**2, axis=0)) if np.isfinite(others).any() else np.zeros(2)
        spread = np.maximum(spread, 0.0025)
        least = np.maximum(np.maximum(o.shift_sd * sd, o.shift * size[c]), o.shift_spread * spread * size[c])
        least = np.maximum(least, o.shift_px * ratio)
        least[1] *= 1.5  # limbs hang: what is above and below is told by few of them
        significant = np.abs(move) > least
        if significant.any():
            shift[c] = np.where(significant, move, 0.0)
            x, y = np.round(shift[c], 1)
            where = [f"{abs(x):g} px to the {'right' if x > 0 else 'left'} of"] if x else []
            where += [f"{abs(y):g} px {'below' if y > 0 else 'above'}"] if y else []
            name = observed.rig[c].name
            findings.append(
                Finding(
                    "keypoint_shift",
                    (name,),
                    f"{name}: its key points lie {' and '.join(where)} the person in its images, constantly",
                    f"set image_shift = [{x:g}, {y:g}] for this view in recording.toml",
                    float(np.linalg.norm(move)),
                )
            )
    return tuple(made), lag, shift


def _own_shifts(made: Sequence[Alignment | None], rig: CameraRig, small: CameraRig) -> Array:
    """(C, 2) px of the calibrated size by which each view's images would have to move, less what the views share: that
    is a matter of the detector's joints. NaN where unknown."""
    own = np.full((len(made), 2), np.nan)
    for c, a in enumerate(made):
        if a is not None:
            own[c] = a.shift * np.array(rig[c].size) / np.array(small[c].size)
    known = np.isfinite(own[:, 0])
    if known.any():
        # limbs hang, so the vertical shift is the one that detectors get wrong alike, in two views already
        own[:, 1] -= np.nanmedian(own[:, 1])
        if known.sum() > 2:
            own[:, 0] -= np.nanmedian(own[:, 0])
    return own


def _common_lag(made: Sequence[Alignment | None], o: Limits) -> tuple[int, int]:
    """The lag (whole frames) that most views ask for, and how many of them; 0 when they do not agree."""
    known = [a for a in made if a is not None]
    if not known:
        return 0, 0
    lags, sd = np.array([a.lag for a in known]), np.array([max(a.lag_sd, 0.1) for a in known])
    middle = float((lags / sd**2).sum() / (1 / sd**2).sum())
    # views that disagree make the mean less certain
    off = np.sqrt(1 / (1 / sd**2).sum() * max(1.0, float((((lags - middle) / sd) ** 2).mean())))
    lag = int(np.rint(middle))
    votes = int((np.abs(lags - lag) < np.maximum(0.75, 2 * sd)).sum())
    if lag == 0 or abs(middle) < o.keypoint_lag_sd * off or votes * 2 <= len(known):
        return 0, 0
    return lag, votes


def _views(
    observed: Observed,
    pixels: Array,
    alignments: tuple[Alignment | None, ...] | None,
    extrinsics: Extrinsics | None,
) -> tuple[ViewReport, ...]:
    """Per view: residuals of key points (all views, and left out) and of silhouettes."""
    c = len(observed.rig)
    uv, confidence = undistorted(observed.rig, pixels)
    flat, seen = uv.reshape(c, -1, 2), confidence.reshape(c, -1)
    inside = point_residual(observed.rig, flat, seen) if c > 1 else np.full(seen.shape, np.nan)
    outside = left_out_residual(observed.rig, flat, seen)
    masks = np.full(c, np.nan)
    if observed.silhouettes is not None:
        small = next((s.rig for s in observed.silhouettes if s is not None), None)
        if small is not None and c > 1:
            tracks = mask_tracks(observed.silhouettes[:: max(1, len(observed.silhouettes) // 20)])
            masks = tangency_by_view(tangency(small, tracks), c)
            masks = masks * observed.rig.sizes[:, 0] / small.sizes[:, 0]
    size = sizes(pixels)
    out = []
    for k, name in enumerate(observed.rig.names):
        change = None if extrinsics is None else extrinsics.changes[k]
        fit = None if alignments is None else alignments[k]
        a, b = (float(np.nanmedian(x[k])) if np.isfinite(x[k]).any() else float("nan") for x in (inside, outside))
        out.append(ViewReport(name, a, b, float(masks[k]), float(size[k]), change, fit))
    return tuple(out)


__all__ = ["Clip", "Cured", "Finding", "Limits", "Observed", "Report", "disagreement", "examine", "examine_and_cure"]
