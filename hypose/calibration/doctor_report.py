"""What the doctor says: findings with their evidence and next step, and the checks that need no geometry."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hypose.body.ready_bodies import human
from hypose.calibration.doctor_extrinsics import Extrinsics
from hypose.calibration.doctor_findings import Clip, Finding, Limits
from hypose.calibration.doctor_masks import Alignment
from hypose.calibration.doctor_person import wrong_set, wrong_way_up
from hypose.calibration.doctor_points import undistorted
from hypose.calibration.refine_camera import CameraChange
from hypose.cameras.camera import CameraRig, triangulate
from hypose.errors import EvidenceError
from hypose.geometry import Array
from hypose.tracking.subject import shape_from_keypoints

UNITS = (
    (1000.0, "metres are given as if they were millimetres, or the other way round"),
    (100.0, "centimetres and metres are mixed up"),
    (10.0, "centimetres and millimetres are mixed up"),
    (3.2808, "the lengths are feet"),
    (39.37, "the lengths are inches"),
)


@dataclass(frozen=True)
class ViewReport:
    """One camera. residual_px: median distance of its key points from the triangulation of all views; left_out_px:
    from that of the others; tangency_px: median disagreement of its silhouette's tangent planes with the other views;
    size_px of the person; change: how far a refinement moves it; alignment of key points and masks. px of the
    calibrated size, NaN where unknown."""

    name: str
    residual_px: float
    left_out_px: float
    tangency_px: float
    size_px: float
    change: CameraChange | None
    alignment: Alignment | None


@dataclass(frozen=True)
class Report:
    """findings, worst kind first as they were found; views in the rig's order."""

    findings: tuple[Finding, ...]
    views: tuple[ViewReport, ...]
    extrinsics: Extrinsics | None
    alignments: tuple[Alignment | None, ...] | None

    @property
    def healthy(self) -> bool:
        """Nothing is wrong."""
        return not any(f.fault for f in self.findings)

    def of(self, view: str) -> tuple[Finding, ...]:
        """The findings about one camera, or about all."""
        return tuple(f for f in self.findings if view in f.views or not f.views)

    def verdict(self, view: str) -> str:
        """One line about one camera."""
        found = self.of(view)
        if not found:
            return f"{view}: no fault found"
        return " ".join(f.sentence if f.text.startswith(view) else f"{view}: {f.sentence}" for f in found)


def clip_findings(rig: CameraRig, clips: Sequence[Clip], frame_rate: float) -> Iterator[Finding]:
    """Sizes, frame rates and numbers of frames of the files."""
    if not clips:
        return
    for camera, clip in zip(rig, clips, strict=True):
        if clip.size is None or tuple(clip.size) == tuple(camera.size):
            continue
        (w, h), (cw, ch) = clip.size, camera.size
        text = f"{camera.name}: its images are {w} x {h} px, it is calibrated for {cw} x {ch} px"
        fx, fy = w / cw, h / ch
        if abs(h / cw - 1) < 0.01 and abs(w / ch - 1) < 0.01:
            yield Finding("size", (camera.name,), text + " (turned by 90 degrees)", "turn the video back", 1.0)
        elif clip.accepted:
            words = f": stretched by {fx:.4f} x {fy:.4f}, as accepted"
            yield Finding("size", (camera.name,), text + words, "nothing", abs(fx / fy - 1), fault=False)
        elif abs(fx / fy - 1) < 0.002:
            cure = 'nothing if the video was only scaled; key points detected in it need keypoint_pixels = "image"'
            yield Finding(
                "size", (camera.name,), text + f": scaled to {100 * fx:.0f} %", cure, abs(fx - 1), fault=False
            )
        else:
            cure = (
                "if it was stretched, set accept_scaled = true for the view; if it was cut, correct the principal "
                "point and the size in the calibration"
            )
            words = f": scaled by {fx:.4f} x {fy:.4f}, or cut by {cw - w} x {ch - h} px"
            yield Finding("size", (camera.name,), text + words, cure, abs(fx / fy - 1))
    rates = [c.frame_rate for c in clips if c.frame_rate]
    usual = float(np.median(rates)) if rates else frame_rate
    for camera, clip in zip(rig, clips, strict=True):
        if clip.frame_rate and abs(clip.frame_rate / usual - 1) > 0.005:
            text = f"{camera.name}: {clip.frame_rate:g} frames/s, the other views have {usual:g}"
            cure = f"convert it to {usual:g} frames/s (ffmpeg -i IN -r {usual:g} OUT)"
            yield Finding("frame_rate", (camera.name,), text, cure, abs(clip.frame_rate / usual - 1))
    counts = [c.frames for c in clips if c.frames]
    most = int(np.median(counts)) if counts else 0
    for camera, clip in zip(rig, clips, strict=True):
        if clip.frames and abs(clip.frames - most) > max(2, 0.01 * most):
            text = f"{camera.name}: {clip.frames} frames, the other views have {most}"
            cure = "copy the video again if it was cut off; else check with hypose sync that all started together"
            yield Finding("frame_count", (camera.name,), text, cure, float(abs(clip.frames - most)))


def person_findings(
    rig: CameraRig, pixels: Array, names: Sequence[str], height: float | None, o: Limits
) -> Iterator[Finding]:
    """The size of the person: units of the calibration, and its scale where the height is known."""
    if len(rig) < 2:
        return
    uv, confidence = undistorted(rig, pixels)
    n = len(rig)
    points, _ = triangulate(rig, uv.reshape(n, -1, 2), np.where(confidence > 0.3, confidence, 0).reshape(n, -1))
    template = human()
    world = points.reshape(*pixels.shape[1:3], 3)
    other = wrong_set(world, names)
    if other is not None:
        yield other
        return
    yield from wrong_way_up(world, names, pixels, rig)
    try:
        shape = shape_from_keypoints(template, world, tuple(names))
    except (EvidenceError, ValueError):
        return
    found = float(shape.scale) * template.stature
    if not np.isfinite(found):
        return
    yield from height_findings(found, height, o)


def height_findings(found: float, height: float | None, o: Limits) -> Iterator[Finding]:
    """What a measured height of `found` metres says about the calibration's unit and scale."""
    if not o.heights[0] <= found <= o.heights[1]:
        best = "the scale of the calibration is wrong"
        for factor, words in UNITS:
            if any(1.3 <= found * f <= 2.1 for f in (factor, 1 / factor)):
                best = words
                break
        text = f"All cameras: the person would be {found:.3g} m tall: {best}"
        cure = "set calibration_unit in recording.toml, or correct the translations and the board's square size"
        yield Finding("unit", (), text, cure, abs(float(np.log(found / 1.7))))
    elif height is not None and abs(found / height - 1) > o.height_share:
        text = f"All cameras: the person would be {found:.2f} m tall, {height:.2f} m is known"
        cure = "check the board's square size; hypose check --refine keeps the known height"
        yield Finding("unit", (), text, cure, abs(found / height - 1))
    elif height is not None and abs(found / height - 1) > o.height_doubt:
        text = (
            f"All cameras: the person comes out {found:.2f} m tall, {height:.2f} m is known: joints are off by that "
            "share of their distances"
        )
        cure = "check the board's square size and the focal lengths"
        yield Finding("unit", (), text, cure, abs(found / height - 1), fault=False)
    elif height is None and not o.usual_heights[0] <= found <= o.usual_heights[1]:
        text = (
            f"All cameras: the person comes out {found:.2f} m tall, as the calibration's unit and focal lengths have it"
        )
        cure = "give the person's height if it is right (--height), else check the board's square size"
        yield Finding("unit", (), text, cure, abs(float(np.log(found / 1.7))), fault=False)
