"""Check a recording before it is tracked: a table of the cameras, a contact sheet, and whether the views agree."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from hypose.app.commands.console import ProgressCall, counted, each, ignore, print_table
from hypose.app.reports.calibration_pages import residual_picture, write_check_page
from hypose.app.reports.result_pictures import Canvas, Drawing, open_images
from hypose.calibration.diagnostics import Cured, PersonReport, examine
from hypose.errors import EvidenceError, InputError
from hypose.evidence.frame import Silhouettes
from hypose.evidence.hull import hull_iou, visual_hull
from hypose.geometry import Image
from hypose.io.files import write_bytes, write_text
from hypose.io.motions.results import to_json
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import Recording
from hypose.io.recordings.recording_views import open_pictures
from hypose.pipeline.recorded_frames import frames_to_examine
from hypose.pipeline.recording_diagnostics import observe_recording

_LOW_IOU = 0.6  # hull against mask: below this a view contradicts the others
_HEIGHTS = (0.5, 2.6)  # m: what a person's hull can measure
_FIGURES = ("name", "residual_px", "left_out_px", "tangency_px")
_SHEET_WIDTH = 1600  # px
_LARGE, _SMALL = 0.5, 0.001  # share of the picture that a mask of one person covers at most and at least


@dataclass(frozen=True)
class Findings:
    """Result of a check: facts and warnings, each a sentence."""

    facts: tuple[str, ...]
    warnings: tuple[str, ...]


def print_cameras(recording: Recording) -> None:
    """Print a table with one row per camera: files, sizes, frame rate, frames, background, key points, position."""
    title = f"{recording.name}: {counted(len(recording.views), 'view')}, {counted(recording.n_frames, 'frame')}, "
    title += f"{recording.frame_rate:g} frames/s"
    columns = ("view", "camera", "images", "size", "calibrated", "fps", "frames", "masks", "background", "key points")
    rows = []
    for view, camera in zip(recording.views, recording.rig, strict=True):
        size = rate = frames = "-"
        if view.has_pictures:
            with open_pictures(view) as reader:
                size, frames = f"{reader.size[0]}x{reader.size[1]}", str(reader.n_frames)
                rate = "-" if reader.frame_rate is None else f"{reader.frame_rate:g}"
        room = "from the recording" if not view.masks else "-"
        x, y, z = camera.position
        rows.append((
            *(view.name, camera.name, _name(view.source), size, f"{camera.size[0]}x{camera.size[1]}", rate, frames),
            *(_name(view.masks), _name(view.background) if view.background else room),
            f"{_name(view.keypoints)} ({recording.keypoint_set})" if view.keypoints else "-",
            f"{x:.2f} {y:.2f} {z:.2f}",
        ))  # fmt: skip
    print_table(title, (*columns, "position (m)"), rows)


def _name(path: Path | None) -> str:
    return "-" if path is None else path.name


def check_recording(recording: Recording, sheet: Path, samples: int, progress: ProgressCall = ignore) -> Findings:
    """Check masks and visual hulls of some frames spread over the recording, and write the contact sheet.

    sheet: picture to write.
    samples: number of frames.
    Returns: facts and warnings.
    Raises: EvidenceError where no frame shows a person.
    """
    facts: list[str] = []
    warnings: list[str] = []
    source, several = frames_to_examine(recording, progress)
    with source:
        facts += ["Several people stand in the masks; their hulls are looked at together."] if several else []
        facts += [f"note: {text}" for text in source.notes]
        rows = np.unique(np.linspace(0, len(source) - 1, min(samples, len(source))).astype(int)).tolist()
        ious, heights, why = [], [], ""
        points = np.stack([k.points for k in source.keypoints]) if source.keypoints else np.zeros((0, 0, 0, 3))
        shown = bool((points[..., 2] > 0).any())
        for row in each(progress, "check", rows):
            frame = source.frame(row)
            for masks in frame.of(Silhouettes):
                shown = shown or bool(masks.usable.any())
                why = why or next((r.rstrip(".") for r in masks.reasons if r), "")
                warnings += _mask_warnings(masks, frame.index)
                if len(recording.views) == 1:
                    continue
                found = _hull_facts(masks, frame.index, facts, warnings, several)
                if found is not None:
                    heights.append(found[0])
                    ious.append(found[1])
        guessed = source.guessed_rooms
        if ious:
            contradicted = _hull_warnings(recording, np.array(heights), np.array(ious))
            warnings = [*([guessed] if guessed and contradicted else []), *warnings, *contradicted]
        if len(points):
            shares = zip(source.rig.names, (points[..., 2] > 0.3).mean((0, 2)), strict=True)
            listed = ", ".join(f"{name} {100 * share:.0f} %" for name, share in shares)
            facts.append(f"Key points seen with confidence above 0.3: {listed}.")
        write_sheet(recording, source, sheet, min(len(rows), 3))
    if not shown:
        raise EvidenceError(
            f"{recording.name}: nobody is seen in any of {len(rows)} frames ({why or 'no evidence'}), so there "
            f"is nothing to check; see whether masks and backgrounds belong to this recording (contact sheet: {sheet})."
            + (f" {guessed}" if guessed else "")
        )
    if len(recording.views) == 1:
        facts.append("There is one camera, so that no views can be compared; look at its masks in the contact sheet.")
    return Findings(tuple(facts), tuple(dict.fromkeys(warnings)))


def examine_recording(
    recording: Recording,
    frames: int,
    page: Path,
    sheet: Path,
    found: Findings,
    progress: ProgressCall = ignore,
) -> tuple[PersonReport | None, Cured | None]:
    """Check the calibration on `frames` consecutive frames, and write the HTML page.

    page, sheet: files of the page and of the contact sheet.
    found: result of `check_recording`, for the page.
    Returns: report, and the recording with measured faults corrected; None where there is nothing to check.
    """
    if len(recording.views) < 2 and not recording.depth_views:
        return None, None
    observed = observe_recording(recording, frames, progress)
    progress("doctor", 0, 1)
    try:
        report, cured = examine(observed)
    except EvidenceError:  # without any evidence there is nothing more to report
        return None, None
    finally:
        progress("doctor", 1, 1)
    write_check_page(
        page,
        recording.name,
        report,
        sheet,
        residual_picture(recording, observed, cured),
        (*recording.notes, *found.facts),
        found.warnings,
    )
    return report, cured


def write_findings(path: Path, found: Findings, report: PersonReport | None) -> None:
    """Write the findings of a check as JSON for the studio: facts, warnings, findings, figures per view, name of the
    page.

    found: result of `check_recording`.
    report: result of `examine_recording`; None without one.
    """
    value = {
        "healthy": not found.warnings and (report is None or report.healthy),
        "facts": found.facts,
        "warnings": found.warnings,
        "findings": [
            {"fault": f.fault, "kind": f.kind, "views": f.views, "sentence": f.sentence, "cure": f.cure}
            for f in (report.findings if report is not None else ())
        ],
        "views": [
            {k: None if isinstance(v := getattr(view, k), float) and not np.isfinite(v) else v for k in _FIGURES}
            for view in (report.views if report is not None else ())
        ],
        "page": "check.html" if report is not None else None,
    }
    write_text(path, to_json(value))


def _mask_warnings(silhouettes: Silhouettes, number: int) -> list[str]:
    """List sentences on masks that are unusable, or cover too little or too much of the picture.

    number: of the frame.
    """
    out = []
    pixels = silhouettes.rig.sizes.prod(1)
    for c, name in enumerate(silhouettes.rig.names):
        share = float(silhouettes.areas[c] / pixels[c])
        if not silhouettes.usable[c]:
            out.append(f"{silhouettes.reasons[c]}; this view is left out there.")
        elif not _SMALL <= share <= _LARGE:
            what = "hardly anything" if share < _SMALL else "most of the picture"
            out.append(
                f"{name}, frame {number}: the mask covers {what} ({100 * share:.1f} %); look at the contact sheet, and "
                "give a background clip or masks of your own."
            )
    return out


def _hull_facts(
    silhouettes: Silhouettes, number: int, facts: list[str], warnings: list[str], several: bool
) -> tuple[float, np.ndarray] | None:
    """Compute the height of the visual hull and its overlap with the masks, and add sentences on them.

    number: of the frame.
    facts, warnings: receive the sentences.
    several: several people are in the masks, so that all parts of the hull count.
    Returns: height in m, and IoU with each view's mask (C,), NaN for unusable masks; None without a hull.
    """
    try:
        hull = visual_hull(silhouettes, largest=not several)
    except EvidenceError as error:
        warnings.append(str(error) if str(number) in str(error) else f"frame {number}: {error}")
        return None
    iou = hull_iou(hull, silhouettes)
    height = float(np.ptp(hull.points[:, 2])) + hull.voxel
    x, y = hull.points[:, :2].mean(0)
    worst = float(np.nanmin(iou))
    facts.append(
        f"Frame {number}: the common volume of the views is {hull.volume * 1000:.0f} litres, {height:.2f} m high, at "
        f"({x:.2f}, {y:.2f}) m; its overlap with the masks is {np.nanmean(iou):.2f} on average, {worst:.2f} at worst."
    )
    return height, iou


def _hull_warnings(recording: Recording, heights: np.ndarray, ious: np.ndarray) -> list[str]:
    """List sentences on views that contradict the others, and on a hull of a height that no person has.

    heights: (N,) of the hulls, m.
    ious: (N, C) IoU of each hull with each view's mask; NaN where the mask is unusable.
    """
    out = []
    for c, view in enumerate(recording.views):
        known = ious[:, c][np.isfinite(ious[:, c])]
        if len(known) and np.median(known) < _LOW_IOU:
            out.append(
                f"View {view.name}: its masks agree badly with the other views (IoU {np.median(known):.2f}); check its "
                "calibration, its synchronisation and its mask."
            )
    height = float(np.median(heights))
    agree = bool(np.isfinite(ious).any()) and float(np.nanmedian(ious)) >= _LOW_IOU
    if agree and not _HEIGHTS[0] <= height <= _HEIGHTS[1]:
        out.append(
            f"The common volume is {height:.2f} m high, which no person is; check the unit of the calibration "
            "(calibration_unit) and which of its axes points up (world_up)."
        )
    return out


def write_sheet(recording: Recording, source: FrameStream, path: Path, count: int) -> None:
    """Write a picture of some frames, one below the other, each with all views and the outlines of the masks.

    source: frames of the recording.
    count: number of frames, spread over the recording.
    """
    rows = np.unique(np.linspace(0, len(source) - 1, min(count, len(source))).astype(int)).tolist()
    numbers = recording.frames
    with open_images(recording) as images:
        canvas, pictures = Canvas(recording, images), []
        for row in rows:
            what = Drawing(source.frame(row).silhouettes, f"frame {numbers[row]}")
            pictures.append(canvas.draw([v.read(numbers[row]) for v in images], what).copy())
    picture = np.concatenate(pictures)
    h, w = picture.shape[:2]
    if w > _SHEET_WIDTH:
        size = _SHEET_WIDTH, round(h * _SHEET_WIDTH / w)
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    write_image(path, picture)


def check_picture(path: Path, option: str) -> None:
    """Raise InputError where `path`, given with an option, cannot be the file name of a picture."""
    if path.is_dir():
        raise InputError(f"{option} {path} is a folder; name the picture to write, for example {path / 'check.png'}.")
    if path.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise InputError(f"{option} {path} is no name for a picture; give one that ends in .png or .jpg.")


def write_image(path: Path, image: Image) -> None:
    """Write a PNG or JPEG file completely or not at all; see `check_picture`."""
    write_bytes(path, cv2.imencode(path.suffix, image)[1].tobytes())
