"""Are the cameras where the calibration says? Refined quickly on some frames' key points, judged on others."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.calibration.doctor_findings import Finding, Limits
from hypose.calibration.doctor_points import disagreement, sizes, undistorted
from hypose.calibration.refine_camera import CameraChange, changes, gauge, in_world
from hypose.calibration.refine_points import (
    PointAdjustment,
    PointSettings,
    adjust,
    bent,
    point_residual,
)
from hypose.cameras.camera import Camera, CameraRig, triangulate
from hypose.errors import EvidenceError
from hypose.geometry import Array, transform

AGREE = 0.02
"""Share of the person's size to which the views of one person agree through the right cameras (`disagreement`)"""
FAR_DEG, FAR_M = 10.0, 0.5
"""a refinement that moves a camera farther comes more often from key points of something else than from a calibration
so wrong"""
_MOST_FRAMES = 30
_COMMON = 60  # points that two views have to see together to judge each other


@dataclass(frozen=True)
class Extrinsics:
    """findings; changes per camera; before_px, after_px: median residual on frames not used; radial (C,) terms that the
    lenses ask for and their sd; lens_cured: the rig given, refined: the rig that fits (in the old gauge)."""

    findings: tuple[Finding, ...]
    changes: tuple[CameraChange, ...]
    before_px: float
    after_px: float
    radial: Array
    radial_sd: Array
    lens_cured: CameraRig
    refined: CameraRig


def judge_extrinsics(rig: CameraRig, pixels: Array, o: Limits) -> Extrinsics | None:
    """pixels (C, T, K, 3), distorted px, in step. None when too few points are seen by two views."""
    c, frames = pixels.shape[:2]
    uv, confidence = undistorted(rig, pixels)
    ideal = CameraRig(tuple(replace(k, distortion=np.zeros(5), fisheye=False) for k in rig))
    used = np.unique(np.linspace(0, frames - 1, min(_MOST_FRAMES, (frames + 1) // 2)).astype(np.int64))
    rest = np.setdiff1d(np.arange(frames), used).astype(np.int64)
    rest = rest if len(rest) else used

    def of(which: NDArray[np.int64]) -> tuple[Array, Array]:
        return uv[:, which].reshape(c, -1, 2), confidence[:, which].reshape(c, -1)

    try:
        found = adjust(ideal, *of(used))
        lens = adjust(ideal, *of(used), PointSettings(radial=True)) if c > 2 else None
    except (EvidenceError, np.linalg.LinAlgError):
        return None
    refined = _in_old_gauge(found, ideal)
    size = sizes(pixels)
    person = float(np.median(size[size > 0])) if (size > 0).any() else 1.0
    before, after = (_residual(r, *of(rest)) for r in (ideal, refined))
    points = transform(gauge(found.rig, ideal, found.points), found.points)
    moved = changes(ideal, refined, points)
    findings: list[Finding] = []
    radial, radial_sd = np.zeros(c), np.full(c, np.inf)
    far = any(m.turn_deg > FAR_DEG or m.move_m > FAR_M for m in moved)
    if min(before, after) > o.scatter * person or (far and after > AGREE * person):
        scatter = (_no_one_person(rig, pixels, before, after),)
        return Extrinsics(scatter, moved, before, after, radial, radial_sd, rig, _with_lenses(refined, rig))
    if lens is not None:
        radial, radial_sd = lens.radial, lens.radial_sd
        findings += _lenses(rig, ideal, lens, uv, confidence, rest, found, person, o)
    if not any(f.fault for f in findings) and after < o.extrinsics * before and before - after > o.gain * person:
        own = np.array([m.image_px for m in moved]) / np.where(size > 0, size, person)
        against = _witnesses(confidence)
        unsure = []
        for k, m in enumerate(moved):
            if own[k] > max(o.moved, 0.2 * np.nanmax(own)):  # a little of it always goes to the others
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
    return Extrinsics(tuple(findings), moved, before, after, radial, radial_sd, rig, _with_lenses(refined, rig))


def _no_one_person(rig: CameraRig, pixels: Array, before: float, after: float) -> Finding:
    """What disagrees however all cameras are moved: of one view, where the others agree without it."""
    views = range(len(rig)) if len(rig) > 3 else ()
    rest = [np.delete(np.arange(len(rig)), c) for c in views]
    without = [disagreement(CameraRig(tuple(rig[int(k)] for k in r)), pixels[r]) for r in rest]
    said = (
        f"the key points miss each other by {before:.1f} px, and by {after:.1f} px still when every camera is moved "
        "(frames not used)"
    )
    c = int(np.argmin(without)) if without else -1
    if c < 0 or not without[c] < AGREE or sum(w < max(AGREE, 2 * without[c]) for w in without) > 1:
        cure = "look whether video and key points of every view are of this recording and show the same person"
        return Finding("scatter", (), f"All cameras: {said}", cure, before)
    text = (
        f"{rig.names[c]}: {said}; without this view the others agree to {100 * without[c]:.1f} % of the person's size"
    )
    cure = (
        "look whether its video and key points are of this recording, of the same person, and not mirrored or turned; "
        "else calibrate this camera anew, or leave the view out"
    )
    return Finding("scatter", (rig.names[c],), text, cure, before)


def _witnesses(confidence: Array) -> NDArray[np.int64]:
    """(C,) by how many other views each view's points (C, T, K) can be judged."""
    seen = (confidence > 0.3).reshape(len(confidence), -1)
    common = (seen[:, None] & seen[None]).sum(-1)
    np.fill_diagonal(common, 0)
    return (common >= _COMMON).sum(1)


def _undecided(
    rig: CameraRig, views: list[int], confidence: Array, before: float, after: float, image_px: float
) -> Finding:
    """Cameras that disagree with one other alone: which of them is off cannot be told."""
    seen = (confidence > 0.3).reshape(len(confidence), -1)
    partners = {j for k in views for j in range(len(rig)) if (seen[k] & seen[j]).sum() >= _COMMON}
    names = tuple(rig.names[k] for k in sorted({*views, *partners}))
    text = (
        f"{' and '.join(names)}: they do not agree, and which of them is off cannot be told by two alone; the key "
        f"points miss each other by {before:.1f} px, after a refinement by {after:.1f} px (frames not used)"
    )
    return Finding("extrinsics", names, text, "film with a third camera, or run hypose check --refine", image_px)


def _in_old_gauge(found: PointAdjustment, old: CameraRig) -> CameraRig:
    return in_world(found.rig, gauge(found.rig, old, found.points))


def _with_lenses(rig: CameraRig, like: CameraRig) -> CameraRig:
    """The rig's poses and focal lengths with the lens distortion of another."""
    return CameraRig(
        tuple(replace(a, distortion=b.distortion, fisheye=b.fisheye) for a, b in zip(rig, like, strict=True))
    )


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
    """Cameras whose images bend straight lines otherwise than their coefficients say: faults when frames that were not
    used fit better with terms of their own, else a note, for many points make a term certain that changes nothing."""
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
    return [Finding("distortion", tuple(off), text, "nothing, if the lenses were calibrated", largest, fault=False)]


def _bent_residual(lens: PointAdjustment, pixels: Array, confidence: Array) -> float:
    """px between points (C, N, 2) as they were filmed and where the cameras with their radial terms see them: pixels
    made straight first would be another size, and no measure beside those as they are."""
    straight = np.stack([_bent_back(k, pixels[n], lens.radial[n]) for n, k in enumerate(lens.rig)])
    points, _ = triangulate(lens.rig, straight, np.where(confidence > 0.3, confidence, 0.0))
    r = np.stack([bent(k, k.project_pinhole(points), lens.radial[n]) for n, k in enumerate(lens.rig)]) - pixels
    return float(np.nanmedian(np.where(confidence > 0.3, np.linalg.norm(r, axis=-1), np.nan)))


def _bent_back(camera: Camera, pixels: Array, radial: float) -> Array:
    """Pixels as the camera would give them without the radial term."""
    centre, focal = camera.K[:2, 2], camera.K[0, 0]
    x = (pixels - centre) / focal
    y = x.copy()
    for _ in range(5):
        y = x / (1 + radial * (y**2).sum(-1, keepdims=True))
    return centre + y * focal
