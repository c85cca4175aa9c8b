"""Diagnostics of a calibration: whether it fits a recording, and which camera has which fault.

Each fault is tested by undoing it: if the views agree much better afterwards, it is present. Gross faults are tested
first (mirrored or rotated images, exchanged cameras, another image size, lens coefficients of another convention), then
a constant shift of the key points, then timing, then the camera poses, because each hides the next. The measures are
shares of the person's size in the image, so that limits are valid for any resolution.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from hypose.calibration.diagnose_masks import (
    Alignment,
    align_to_masks,
    focal_by_masks,
    focal_by_points,
    focal_findings,
    tangency,
    tangency_by_view,
    view_masks,
)
from hypose.calibration.diagnose_person import PersonReport, ViewReport, clip_findings, height_findings, person_findings
from hypose.calibration.diagnose_points import (
    FAR_DEG,
    FAR_M,
    certain_delays,
    judge_extrinsics,
    late_views,
    odd_view_out,
    timing_findings,
    undo_faults,
    undo_point_faults,
)
from hypose.calibration.findings import REVIEW, Finding, Limits, ViewFile, depth_findings
from hypose.calibration.refine_points import CameraChange, apply_parameters, changes, left_out_residual, point_residual
from hypose.calibration.sync_motion import MaskTrack, mask_tracks, silhouette_curves
from hypose.calibration.synchronisation import points_at
from hypose.cameras.camera import CameraRig
from hypose.errors import EvidenceError
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Silhouettes
from hypose.evidence.hull import visual_hull
from hypose.evidence.keypoint_check import Trial, geometric_trials, sizes, undistorted
from hypose.geometry import Array

# ---- doctor silhouettes --------------------------------------------------------------------------------------------
# Checks with silhouettes alone: tangent planes of pairs of views in place of key points.
#
# They give less information than key points: two planes per pair and frame. Mirrored, turned and exchanged views,
# timing, wrong poses and units can be found; lens coefficients cannot.


_SCATTER = 0.08
"""Share of the person's size by which tangent planes may disagree; it allows for tables and treadmills that hide part
of the person."""
_JUDGED = 40  # frames on which poses are judged
_LOOK_AT_MASKS = (
    "look at the masks in check.png; if they outline the same person in every view, run hypose check --refine, else "
    "give a photo or clip of the empty room as background, masks of your own, or key points"
)


def examine_silhouettes(
    rig: CameraRig, silhouettes: Sequence[Silhouettes | None], o: Limits
) -> tuple[list[Finding], tuple[ViewReport, ...], Array]:
    """Diagnose a calibration with silhouettes alone.

    rig: the calibrated cameras.
    silhouettes: silhouettes of consecutive frames.
    o: limits.
    Returns: findings, a report per view, and (C,) delay of each view, frames.
    Raises: EvidenceError where no frame has silhouettes.
    """
    small = next((s.rig for s in silhouettes if s is not None), None)
    n = len(rig)
    if small is None:
        raise EvidenceError("No frame has silhouettes; give masks, a background, or key points.")
    tracks = mask_tracks(silhouettes)
    size = _sizes(tracks)
    late = np.zeros(n)
    if n < 2:
        return [], tuple(ViewReport(name) for name in rig.names), late
    residual = tangency_by_view(tangency(small, tracks), n) * rig.sizes[:, 0] / small.sizes[:, 0]
    reports = tuple(ViewReport(name, tangency_px=float(r)) for name, r in zip(rig.names, residual, strict=True))
    findings, small, tracks = _gross_masks(small, tracks, size, o)
    timed = list(findings)
    late = _timing(rig, small, tracks, size, timed, o)
    in_step = [_delayed(t, x) for t, x in zip(tracks, late, strict=True)]
    # for a person who walks straight, a late camera has the same effect as a displaced one
    left = _score(small, _few(in_step, _JUDGED), size)
    best = _best_moved(rig, small, tracks, size, silhouettes, o) if not findings else None
    if best is None or best.after > min(o.gross_cured * min(best.before, left), o.tangency):
        findings, tracks = timed, in_step
    else:  # a displaced camera also seems late: it is reported as displaced
        findings.append(best.finding)
        small = best.moved
        late = _timing(rig, small, tracks, size, findings, o)
        tracks = [_delayed(t, x) for t, x in zip(tracks, late, strict=True)]
    if not findings or all(f.kind == "late" for f in findings):
        findings += focal_findings(focal_by_masks(small, _few(tracks, _JUDGED)))
    if not findings or all(f.kind == "late" for f in findings):
        poses = _poses(rig, small, tracks, size, silhouettes, o)
        if any(f.kind == "scatter" for f in poses):  # masks that do not show one person give no lag
            return poses, reports, np.zeros(n)
        findings += poses
        findings += _unit(small, size, o)
    return findings, reports, late


def gross_silhouettes(rig: CameraRig, silhouettes: Sequence[Silhouettes | None], o: Limits) -> tuple[Finding, ...]:
    """Find gross faults from the silhouettes of a few frames, which need not be consecutive.

    The faults are mirrored, rotated and exchanged views, tangent planes that never agree, and a wrong unit.

    rig: the cameras of the silhouettes.
    o: limits.
    Returns: the findings; none where there is only one view or no silhouette.
    """
    tracks = mask_tracks(silhouettes)
    size = _sizes(tracks)
    if len(rig) < 2 or not (size > 0).any():
        return ()
    findings, cured, tracks = _gross_masks(rig, tracks, size, o)
    left = _score(cured, tracks, size)
    if not findings and left > _SCATTER:
        found = _scattered(cured, tracks, size, left)
        findings.append(replace(found, cure="run hypose check, which looks for the cause"))
    findings += _unit(cured, size, o)
    return tuple(findings)


def _sizes(tracks: Sequence[MaskTrack]) -> Array:
    return np.array([t.size for t in tracks])


def _score(rig: CameraRig, tracks: Sequence[MaskTrack], size: Array) -> float:
    """Compute the mean disagreement of the views' tangent planes, in shares of the person's size; 10 where planes never
    agree.

    Views without a whole mask (size 0) do not count.
    """
    seen = size > 0
    by_view = tangency_by_view(tangency(rig, tracks), len(rig))[seen] / size[seen]
    return float(np.mean(np.nan_to_num(np.minimum(by_view, 10.0), nan=10.0))) if seen.sum() > 1 else 0.0


def _few(tracks: Sequence[MaskTrack], count: int) -> list[MaskTrack]:
    total = len(tracks[0].area)
    rows = np.unique(np.linspace(0, total - 1, min(count, total)).astype(int))
    return [t.at(rows) for t in tracks]


def _gross_masks(
    rig: CameraRig, tracks: list[MaskTrack], size: Array, o: Limits
) -> tuple[list[Finding], CameraRig, list[MaskTrack]]:
    """Find and undo up to two gross faults by the tangent planes of the masks.

    rig: the cameras of the masks.
    tracks: mask track of each view.
    size: (C,) size of the person in each view, px of the masks.
    o: limits.
    Returns: the findings; cameras and tracks after the faults were undone.
    """

    def trials(cameras: CameraRig, seen: list[MaskTrack]) -> Iterator[Trial[list[MaskTrack]]]:
        def turned(c: int, factor: Array) -> list[MaskTrack]:
            middle, track = (np.array(cameras[c].size) - 1) / 2, seen[c]
            outline, changed = (
                tuple(None if p is None else middle + factor * (p - middle) for p in parts)
                for parts in (track.outline, track.changed)
            )
            return [*seen[:c], replace(track, outline=outline, changed=changed), *seen[c + 1 :]]

        return geometric_trials(cameras, seen, turned, lambda order: [seen[k] for k in order])

    def measure(cameras: CameraRig, seen: list[MaskTrack], _: Sequence[int]) -> float:
        return _score(cameras, seen, size)

    most = 2 if _score(rig, _few(tracks, 25), size) >= o.gross else 0
    return undo_faults(rig, tracks, trials, measure, lambda seen: _few(seen, 25), o, most, _SCATTER)


def _delayed(track: MaskTrack, late: float) -> MaskTrack:
    """Shift a track in time, so that frame t + late becomes frame t."""
    return track.at(np.arange(len(track.area)) + round(late))


def _timing(
    rig: CameraRig, small: CameraRig, tracks: list[MaskTrack], size: Array, findings: list[Finding], o: Limits
) -> Array:
    """Estimate the delay of each view from its masks, and add the findings.

    rig: the calibrated cameras.
    small: the cameras of the masks, at their size.
    tracks: mask track of each view.
    size: (C,) size of the person in each view, px of the masks.
    findings: list to which findings are added.
    o: limits.
    Returns: (C,) frames; 0 where it is not certain, and for all views of fewer than 24 frames.
    """
    if len(tracks[0].area) < 24:
        return np.zeros(len(rig))
    scale = max(float(np.median(size)) / 130, 0.5)
    curves = partial(silhouette_curves, small, tracks, scale_px=scale)
    late, sd = certain_delays(curves, len(rig), o, max(o.late, 0.6), 2 * o.late_gain)
    findings += timing_findings(rig, late, sd)
    return late


def _poses(
    rig: CameraRig,
    small: CameraRig,
    tracks: list[MaskTrack],
    size: Array,
    silhouettes: Sequence[Silhouettes | None],
    o: Limits,
) -> list[Finding]:
    """Check whether moving one camera makes the tangent planes agree.

    rig: the calibrated cameras.
    small: the cameras of the masks, at their size.
    tracks: mask track of each view.
    size: (C,) size of the person in each view, px of the masks.
    silhouettes: silhouettes of the frames, for points of the person.
    o: limits.
    Returns: at most one finding; none where the planes agree already or there are two views.
    """
    best = _best_moved(rig, small, tracks, size, silhouettes, o)
    if best is None:
        return []
    before, after = best.before, best.after
    disagree = f"All cameras: the silhouettes' tangent planes disagree by {100 * before:.1f} % of the person's size"
    far = best.change.turn_deg > FAR_DEG or best.change.move_m > FAR_M
    if min(before, after) > _SCATTER or (far and after > o.tangency):
        if before <= _SCATTER and after <= _SCATTER:  # the views show one person; the fault is unknown
            return [Finding("extrinsics", (), disagree, "run hypose check --refine, and hypose sync", before)]
        found = _scattered(small, _few(tracks, _JUDGED), size, before)
        text = f"{found.text}, and no lag that these frames can tell and no other place of one camera cures that"
        return [replace(found, text=text)]
    if after > o.extrinsics * before:
        return [Finding("extrinsics", (), disagree, "run hypose check --refine", before)]
    return [best.finding]


def _scattered(small: CameraRig, tracks: Sequence[MaskTrack], size: Array, before: float) -> Finding:
    """Make the finding that masks do not show one person; it names a view without which the others agree.

    small: the cameras of the masks, at their size.
    tracks: mask track of each view.
    size: (C,) size of the person in each view, px of the masks.
    before: disagreement of the tangent planes, share of the person's size.
    """
    disagree = f"the silhouettes' tangent planes disagree by {100 * before:.0f} % of the person's size"

    def rest(kept: list[int]) -> float:
        return _score(small.select([small.names[k] for k in kept]), [tracks[k] for k in kept], size[kept])

    odd = odd_view_out(small, rest, min(0.5 * _SCATTER, 0.25 * before)) if (size > 0).sum() > 3 else None
    if odd is None:
        return Finding("scatter", (), f"All cameras: {disagree}", _LOOK_AT_MASKS, before)
    name = small.names[odd[0]]
    text = f"{name}: {disagree}, by {100 * odd[1]:.0f} % without this view"
    return Finding("scatter", (name,), text, _LOOK_AT_MASKS, before)


class _BestMoved(NamedTuple):
    """The camera whose movement lessens the disagreement of tangent planes most.

    before, after: disagreement before and after it is moved, shares of the person's size.
    moved: the cameras of the masks with the moved one.
    change: how far it is moved.
    finding: the finding that it is displaced.
    """

    before: float
    after: float
    moved: CameraRig
    change: CameraChange
    finding: Finding


def _best_moved(
    rig: CameraRig,
    small: CameraRig,
    tracks: list[MaskTrack],
    size: Array,
    silhouettes: Sequence[Silhouettes | None],
    o: Limits,
) -> _BestMoved | None:
    """Find the camera that helps most when it alone is moved to where its tangent planes agree best with the others'.

    rig: the calibrated cameras.
    small: the cameras of the masks, at their size.
    tracks: mask track of each view.
    size: (C,) size of the person in each view, px of the masks.
    silhouettes: silhouettes of the frames, for points of the person.
    o: limits.
    Returns: None where the planes agree already, or there are two views.
    """
    few = _few(tracks, _JUDGED)
    before = _score(small, few, size)
    if before < o.tangency or len(rig) < 3:
        return None
    tried = [_moved_alone(small, few, size, c) for c in range(len(small))]
    left = [_score(moved, few, size) for moved in tried]
    c = int(np.argmin(left))
    change = changes(small, tried[c], _person(silhouettes))[c]
    px = change.image_px * rig.sizes[c, 0] / small.sizes[c, 0]
    text = (
        f"{rig.names[c]}: {change.turn_deg:.1f} degrees and {1000 * change.move_m:.0f} mm off, which moves the person "
        f"{px:.0f} px in its image; the silhouettes' tangent planes disagree by {100 * before:.1f} % of the person's "
        f"size, after moving this camera by {100 * left[c]:.1f} %"
    )
    cure = "run hypose check --refine and use the calibration that it writes"
    return _BestMoved(before, left[c], tried[c], change, Finding("extrinsics", (rig.names[c],), text, cure, px))


def _moved_alone(rig: CameraRig, tracks: list[MaskTrack], size: Array, c: int) -> CameraRig:
    """Move one camera to where its tangent planes agree best with those of the others.

    rig: the cameras of the masks.
    tracks: mask track of each view.
    size: (C,) size of the person in each view, px.
    c: index of the camera.
    Returns: the cameras with the moved one.
    """
    from scipy.optimize import least_squares  # takes long to import

    mine = [k for k in range(len(rig)) if k != c]
    scale = 0.01 * max(float(size[c]), 1.0)

    def at(x: Array) -> CameraRig:
        cameras = list(rig)
        cameras[c] = apply_parameters(rig[c], x * np.array([0.02] * 3 + [0.1] * 3))
        return CameraRig(tuple(cameras))

    def rows(x: Array) -> Array:
        moved = at(x)
        out = []
        for k in mine:
            pair = CameraRig((moved[c], moved[k]))
            out.append(tangency(pair, [tracks[c], tracks[k]])[0, 1].ravel())
        r = np.clip(np.nan_to_num(np.concatenate(out)), -50 * scale, 50 * scale) / scale
        return np.r_[r, 0.3 * x]

    found = least_squares(rows, np.zeros(6), loss="soft_l1", max_nfev=12, diff_step=1e-3).x
    return at(found)


def _person(silhouettes: Sequence[Silhouettes | None]) -> Array:
    """Compute some points (N, 3) of the person from a visual hull, m; the origin where there is none."""
    for s in silhouettes[:: max(1, len(silhouettes) // 5)]:
        if s is not None and s.usable.sum() > 1:
            try:
                return visual_hull(s).points
            except EvidenceError:
                continue
    return np.zeros((1, 3))


def _unit(rig: CameraRig, size: Array, o: Limits) -> Iterator[Finding]:
    """Check the person's height from its size in the images and the distance of the cameras; accurate to a third."""
    look = np.stack([c.camera_from_world[2, :3] for c in rig])
    across = np.eye(3) - look[:, :, None] * look[:, None, :]
    middle = np.linalg.lstsq(across.sum(0), (across @ rig.positions[..., None]).sum(0)[:, 0], rcond=None)[0]
    distance = np.linalg.norm(rig.positions - middle, axis=1)
    seen = size > 0
    if seen.any():
        heights = size[seen] * distance[seen] / np.array([c.K[1, 1] for c in rig])[seen]
        yield from height_findings(
            float(np.median(heights)), None, replace(o, heights=(0.6, 3.5), usual_heights=(0.6, 3.5))
        )


@dataclass(frozen=True)
class Observed:
    """Evidence of consecutive frames of one recording, for the diagnostics.

    rig: the calibrated cameras, with lens distortion.
    keypoints: (C, T, K, 3) px of the calibrated, distorted images, and confidence (0: missing); T and K are 0 without
        key points.
    names: K names of the key points.
    silhouettes: T, undistorted, at any working size. They must be made without the key points, because otherwise they
        agree with them in any case.
    clips: file of each view.
    frame_rate: frames/s.
    height: height of the person, m, where known.
    people: sentences about other people.
    depths: depth maps of some frames, where there are depth cameras.
    """

    rig: CameraRig
    keypoints: Array = field(default_factory=lambda: np.zeros((0, 0, 0, 3)))
    names: tuple[str, ...] = ()
    silhouettes: Sequence[Silhouettes | None] = ()
    clips: tuple[ViewFile, ...] = ()
    frame_rate: float = 25.0
    height: float | None = None
    people: tuple[str, ...] = ()
    depths: Sequence[Depth] = ()


@dataclass(frozen=True)
class Cured:
    """The evidence after the faults were undone.

    rig: corrected cameras.
    keypoints: synchronous key points in the right place, as in `Observed`.
    late: (C,) delay of each view, frames.
    shift: (C, 2) x and y to add to image positions of each view, px of the calibrated size.
    keypoint_lag: number of frames: key points of frame t belong to video frame t + keypoint_lag.
    """

    rig: CameraRig
    keypoints: Array
    late: Array
    shift: Array
    keypoint_lag: int


def examine(observed: Observed) -> tuple[PersonReport, Cured]:
    """Diagnose the calibration of a recording with all checks for which there is evidence, and undo the faults for a
    refinement.

    observed: evidence of consecutive frames.
    Returns: the report, and the evidence after the faults were undone.
    Raises: EvidenceError where there are neither key points nor silhouettes.
    """
    o = Limits()
    n = len(observed.rig)
    findings = list(clip_findings(observed.rig, observed.clips, observed.frame_rate))
    findings += [
        Finding("people", (), text, "nothing, if that is right", 0.0, severity=REVIEW) for text in observed.people
    ]
    by_depth = depth_findings(observed.depths)
    findings += by_depth
    if (observed.keypoints[..., 2] > 0.3).any((1, 2)).sum() < 2:
        found, views, late = examine_silhouettes(observed.rig, observed.silhouettes, o)
        # for depth cameras, masks give no better information: their faults follow from those of the depth maps
        findings += [] if any(f.fault for f in by_depth) else found
        return PersonReport(tuple(findings), views), Cured(observed.rig, observed.keypoints, late, np.zeros((n, 2)), 0)
    stored = [c.size for c in observed.clips] if observed.clips else [None] * n
    every = max(1, observed.keypoints.shape[1] // 15)
    undone, rig, pixels = undo_point_faults(
        observed.rig, observed.keypoints, observed.names, stored, o, most=3, every=every
    )
    gross = {f.kind for f in undone}
    findings += undone
    scaled = {name for f in undone if f.kind in ("scaled", "cropped") for name in f.views}
    alignments, lag, shift = _against_masks(observed, pixels, scaled, findings, o)
    late, sd = np.zeros(n), np.zeros(n)
    if not gross & {"inverted"}:
        late, sd = late_views(rig, pixels, o)
        findings += timing_findings(rig, late, sd)
    before = pixels
    pixels = np.stack([points_at(p, x) for p, x in zip(before, late, strict=True)])
    extrinsics = None
    focal = list(focal_findings(focal_by_points(rig, pixels))) if n > 1 and not gross else []
    findings += focal
    later = bool((np.isinf(sd) & (late != 0)).any())  # an unknown delay would look like wrong camera poses
    if not focal and n > 1 and not gross & {"inverted"}:
        extrinsics = judge_extrinsics(rig, pixels, o)
        if extrinsics is not None:
            findings += [f for f in extrinsics[0] if f.kind == "scatter" or not later]
    if any(f.kind == "scatter" for f in findings):  # views that never agree give no delay and no body size
        findings = [f for f in findings if f.kind != "late"]
        late, pixels = np.zeros(n), before
    elif not later:
        findings += person_findings(rig, pixels, observed.names, observed.height, o)
    report = PersonReport(tuple(findings), _views(observed, pixels, alignments, extrinsics and extrinsics[1]))
    return report, Cured(rig, pixels, late, shift, lag)


def _against_masks(
    observed: Observed, pixels: Array, scaled: set[str], findings: list[Finding], o: Limits
) -> tuple[tuple[Alignment | None, ...] | None, int, Array]:
    """Estimate the lag and shift of key points against the masks of the same view, and add the findings.

    pixels: (C, T, K, 3) key points after gross faults were undone.
    scaled: names of the views whose key points were in pixels of another size; of these, `pixels` are compared.
    findings: list to which findings are added.
    o: limits.
    Returns: the alignments, the common lag, and the shifts (C, 2) to add to the images, px of the calibrated size (0
        where none was found).
    """
    shift = np.zeros((len(observed.rig), 2))
    small = next((s.rig for s in observed.silhouettes if s is not None), None)
    if small is None:
        return None, 0, shift
    uv, confidence = undistorted(observed.rig, observed.keypoints)
    cured, cured_confidence = undistorted(observed.rig, pixels)
    made: list[Alignment | None] = []
    for c, camera in enumerate(observed.rig):
        ratio = np.array(small[c].size) / np.array(camera.size)
        source = (cured[c], cured_confidence[c]) if camera.name in scaled else (uv[c], confidence[c])
        points = np.concatenate([(source[0] + 0.5) * ratio - 0.5, source[1][..., None]], -1)
        made.append(align_to_masks(points, observed.names, view_masks(observed.silhouettes, c)))
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
        least[1] *= 1.5  # limbs are mostly vertical, so few of them show a vertical shift
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
    """Compute the shift of each view's images without the part common to all views.

    made: alignment of each view's key points with its masks; None where unknown.
    rig, small: the calibrated cameras, and those of the masks.
    Returns: (C, 2) px of the calibrated size; NaN where unknown.
    Why: the common part comes from the detector's definition of the joints.
    """
    own = np.full((len(made), 2), np.nan)
    for c, a in enumerate(made):
        if a is not None:
            own[c] = a.shift * np.array(rig[c].size) / np.array(small[c].size)
    known = np.isfinite(own[:, 0])
    if known.any():
        # limbs are mostly vertical, so detectors have a common vertical error, even with only two views
        own[:, 1] -= np.nanmedian(own[:, 1])
        if known.sum() > 2:
            own[:, 0] -= np.nanmedian(own[:, 0])
    return own


def _common_lag(made: Sequence[Alignment | None], o: Limits) -> tuple[int, int]:
    """Determine the lag (whole frames) on which most views agree, and their number; 0 where they do not agree."""
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
    changed: Sequence[CameraChange] | None,
) -> tuple[ViewReport, ...]:
    """Report residuals of key points and silhouettes for each view.

    pixels: (C, T, K, 3) key points as they are judged in the end.
    alignments: alignments of key points and masks of each view; None where there are no masks.
    changed: change of each camera by the refinement; None where there was none.
    """
    c = len(observed.rig)
    uv, confidence = undistorted(observed.rig, pixels)
    flat, seen = uv.reshape(c, -1, 2), confidence.reshape(c, -1)
    inside = point_residual(observed.rig, flat, seen) if c > 1 else np.full(seen.shape, np.nan)
    outside = left_out_residual(observed.rig, flat, seen)
    masks = np.full(c, np.nan)
    small = next((s.rig for s in observed.silhouettes if s is not None), None)
    if small is not None and c > 1:
        tracks = mask_tracks(observed.silhouettes[:: max(1, len(observed.silhouettes) // 20)])
        masks = tangency_by_view(tangency(small, tracks), c)
        masks = masks * observed.rig.sizes[:, 0] / small.sizes[:, 0]
    out = []
    for k, name in enumerate(observed.rig.names):
        change = None if changed is None else changed[k]
        fit = None if alignments is None else alignments[k]
        a, b = (float(np.nanmedian(x[k])) if np.isfinite(x[k]).any() else float("nan") for x in (inside, outside))
        out.append(ViewReport(name, a, b, float(masks[k]), change, fit))
    return tuple(out)
