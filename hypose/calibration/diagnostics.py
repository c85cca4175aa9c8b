"""Diagnostics of a calibration: whether it fits a recording, and which camera has which fault.

Each fault is tested by undoing it: if the views agree much better afterwards, it is present. Gross faults are tested
first (mirrored or rotated images, exchanged cameras, another image size, lens coefficients of another convention), then
a constant shift of the key points, then timing, then the camera poses, because each hides the next. The measures are
shares of the person's size in the image, so that limits are valid for any resolution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hypose.calibration.diagnose_masks import (
    MaskViews,
    examine_silhouettes,
    focal_findings,
    tangency_by_view,
)
from hypose.calibration.diagnose_person import PersonReport, ViewReport, clip_findings, person_findings
from hypose.calibration.diagnose_points import judge_extrinsics, late_views, timing_findings, undo_point_faults
from hypose.calibration.findings import REVIEW, Finding, Limits, ViewFile, depth_findings
from hypose.calibration.limb_offsets import align_to_masks, view_masks
from hypose.calibration.refine_points import CameraChange, point_residual
from hypose.calibration.synchronisation import points_at
from hypose.cameras.camera import CameraRig
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Silhouettes
from hypose.evidence.keypoint_check import disagreement, sizes, undistorted
from hypose.geometry import Array


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
    o, n, points = Limits(), len(observed.rig), observed.keypoints
    by_depth = depth_findings(observed.depths)
    findings = [
        *clip_findings(observed.rig, observed.clips, observed.frame_rate),
        *(Finding("people", (), text, "nothing, if that is right", 0.0, severity=REVIEW) for text in observed.people),
        *by_depth,
    ]
    if (points[..., 2] > 0.3).any((1, 2)).sum() < 2:
        found, views, late = examine_silhouettes(observed.rig, observed.silhouettes, o)
        # for depth cameras, masks give no better information: their faults follow from those of the depth maps
        findings += [] if any(f.fault for f in by_depth) else found
        return PersonReport(tuple(findings), views), Cured(observed.rig, points, late, np.zeros((n, 2)), 0)
    stored = [c.size for c in observed.clips] if observed.clips else [None] * n
    every = max(1, points.shape[1] // 15)
    gross, rig, pixels = undo_point_faults(observed.rig, points, observed.names, stored, o, most=3, every=every)
    findings += gross
    inverted = any(f.kind == "inverted" for f in gross)
    scaled = {name for f in gross if f.kind in ("scaled", "cropped") for name in f.views}
    lag, shift = _against_masks(observed, pixels, scaled, findings, o)
    late = sd = np.zeros(n)
    if not inverted:
        late, sd = late_views(rig, pixels, o)
        findings += timing_findings(rig, late, sd)
    before = pixels
    pixels = np.stack([points_at(p, x) for p, x in zip(before, late, strict=True)])
    later = bool((np.isinf(sd) & (late != 0)).any())  # an unknown delay would look like wrong camera poses
    some = pixels[:, ::every]
    poses, moved = judge_extrinsics(rig, pixels, o) if n > 1 and not inverted else ([], None)
    if not gross and not any(f.kind == "distortion" for f in poses):  # wrong lenses look like wrong focal lengths
        focal = list(focal_findings(rig, lambda cameras, kept: disagreement(cameras, some[kept])))
        findings += focal
        poses, moved = ([], None) if focal else (poses, moved)  # which look like wrong camera poses
    findings += [f for f in poses if f.kind == "scatter" or not later]
    if any(f.kind == "scatter" for f in poses):  # views that never agree give no delay and no body size
        findings = [f for f in findings if f.kind != "late"]
        late, pixels = np.zeros(n), before
    elif not later:
        findings += person_findings(rig, pixels, observed.names, observed.height, o)
    return PersonReport(tuple(findings), _views(observed, pixels, moved)), Cured(rig, pixels, late, shift, lag)


def _against_masks(
    observed: Observed, pixels: Array, scaled: set[str], findings: list[Finding], o: Limits
) -> tuple[int, Array]:
    """Estimate the lag and shift of key points against the masks of the same view, and add the findings.

    pixels: (C, T, K, 3) key points after gross faults were undone.
    scaled: names of the views whose key points were in pixels of another size; of these, `pixels` are compared.
    findings: list to which findings are added.
    o: limits.
    Returns: the lag common to all views, and the shifts (C, 2) to add to the images, px of the calibrated size (0 where
        none was found).
    """
    rig, shift = observed.rig, np.zeros((len(observed.rig), 2))
    small = next((s.rig for s in observed.silhouettes if s is not None), None)
    if small is None:
        return 0, shift
    cured = np.array([name in scaled for name in rig.names])
    uv, confidence = undistorted(rig, np.where(cured[:, None, None, None], pixels, observed.keypoints))
    ratio = rig.sizes / small.sizes
    points = np.concatenate([(uv + 0.5) / ratio[:, None, None] - 0.5, confidence[..., None]], -1)
    made = [align_to_masks(p, observed.names, view_masks(observed.silhouettes, c)) for c, p in enumerate(points)]
    known = [c for c, a in enumerate(made) if a is not None]
    if not known:
        return 0, shift
    found = [a for a in made if a is not None]
    lag = int(np.rint(np.median(np.array([a.lag for a in found]))))
    votes = sum(abs(a.lag - lag) < 0.75 and a.lag_sd < o.keypoint_lag_sd for a in found)
    if lag and 2 * votes > len(found):
        findings.append(
            Finding(
                "keypoint_lag",
                (),
                f"The key points are {abs(lag)} frame{'s' if abs(lag) > 1 else ''} {'early' if lag > 0 else 'late'} "
                f"against the videos in {votes} of {len(rig)} views: file t belongs to video frame t{lag:+d}",
                f"set keypoint_lag = {lag} in recording.toml (counted from its present value)",
                float(abs(lag)),
            )
        )
    else:
        lag = 0
    # a part that is common to all views comes from the detector's definition of the joints; limbs are mostly vertical,
    # so few of them show a vertical shift, and with two views only the vertical part is common
    size = np.maximum(sizes(observed.keypoints), 1.0)[known, None]
    px = ratio[known]
    own = np.array([a.shift for a in found]) * px
    own -= np.median(own, axis=0) * [len(known) > 2, 1]
    squares = (own / size) ** 2
    spread = np.sqrt((squares.sum(0) - squares) / max(len(known) - 1, 1))
    sd = np.array([a.shift_sd for a in found]) * px
    least = np.maximum(o.shift_sd * sd, size * np.maximum(o.shift, o.shift_spread * spread))
    least = np.maximum(least, o.shift_px * px) * [1, 1.5]
    shift[known] = np.where((np.abs(own) > least) & ~cured[known, None], own, 0.0)
    for c in np.flatnonzero(shift.any(1)):
        x, y = np.round(shift[c], 1)
        where = [f"{abs(x):g} px to the {'right' if x > 0 else 'left'} of"] if x else []
        where += [f"{abs(y):g} px {'below' if y > 0 else 'above'}"] if y else []
        findings.append(
            Finding(
                "keypoint_shift",
                (rig.names[c],),
                f"{rig.names[c]}: its key points lie {' and '.join(where)} the person in its images, constantly",
                f"set image_shift = [{x:g}, {y:g}] for this view in recording.toml",
                float(np.linalg.norm(shift[c])),
            )
        )
    return lag, shift


def _views(observed: Observed, pixels: Array, changed: Sequence[CameraChange] | None) -> tuple[ViewReport, ...]:
    """Report residuals of key points and silhouettes for each view.

    pixels: (C, T, K, 3) key points as they are judged in the end.
    changed: change of each camera by the refinement; None where there was none.
    """
    rig, c = observed.rig, len(observed.rig)
    uv, confidence = undistorted(rig, pixels)
    numbers = np.full((3, c), np.nan)
    if c > 1:
        flat, seen = uv.reshape(c, -1, 2), confidence.reshape(c, -1)
        residuals = [point_residual(rig, flat, seen, left_out=left_out) for left_out in (False, True)]
        numbers[:2] = [[np.nanmedian(v) if np.isfinite(v).any() else np.nan for v in r] for r in residuals]
    some = observed.silhouettes[:: max(1, len(observed.silhouettes) // 20)]
    if c > 1 and any(s is not None for s in some):
        masks = MaskViews.of(some)
        numbers[2] = tangency_by_view(masks.rig, masks.tracks) * rig.sizes[:, 0] / masks.rig.sizes[:, 0]
    every = zip(rig.names, numbers.T.tolist(), changed or [None] * c, strict=True)
    return tuple(ViewReport(name, *figures, change=change) for name, figures, change in every)
