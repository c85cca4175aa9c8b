"""`hypose check`: check a recording before it is tracked (a table of the cameras, a contact sheet, whether the views
agree), and correct its calibration.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np
from click.exceptions import Exit

from hypose.app.commands.console import ProgressCall, Stages, counted, each, ignore, print_table, say
from hypose.app.options import CheckCommand
from hypose.app.reports.calibration_pages import residual_picture, write_check_page
from hypose.app.reports.result_pictures import Canvas, Drawing, open_images
from hypose.calibration.diagnostics import Cured, PersonReport, examine
from hypose.errors import EvidenceError, InputError
from hypose.evidence.frame import Silhouettes
from hypose.evidence.hull import hull_iou, visual_hull
from hypose.geometry import Image
from hypose.io.calibrations.calibration_formats import write_calibration
from hypose.io.files import check_writable, free_path, write_bytes, write_text
from hypose.io.motions.results import json_values, to_json
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import Recording, load_recording
from hypose.io.recordings.recording_views import open_pictures
from hypose.pipeline.recorded_frames import frames_to_examine
from hypose.pipeline.recording_diagnostics import (
    Refinement,
    cured_recording,
    observe_recording,
    refine_recording,
)

_LOW_IOU = 0.6  # hull against mask: below this a view contradicts the others
_FIGURES = ("name", "residual_px", "left_out_px", "tangency_px")
_SHEET_WIDTH = 1600  # px
_LARGE, _SMALL = 0.5, 0.001  # share of the picture that a mask of one person covers at most and at least


def check(c: CheckCommand) -> None:
    """Check a recording and its calibration, and print what was found (`hypose check`).

    Raises: Exit with code 1 where faults were found, or a refinement is no better.
    """
    if c.to is not None and c.to.exists():
        raise InputError(f"{c.to} exists, and calibrations are never overwritten; give another name with --to.")
    if c.out is not None:
        check_picture(c.out, "--out")
    loaded = load_recording(c.recording, c.calibration)
    for name in c.keep:
        loaded.rig.select([name])
    print_cameras(loaded)
    for text in loaded.notes:
        say(f"note: {text}")
    path = c.out or loaded.folder / "results" / "check.png"
    check_writable(path.parent)
    if c.refine:
        check_writable((c.to or path).parent, "--to")
    report = cured = None
    with Stages() as progress:
        facts, warnings = check_recording(loaded, path, c.samples, progress)
        if c.frames > 0:
            report, cured = examine_recording(loaded, c.frames, path, facts, warnings, progress)
    found = {  # for the studio
        "healthy": not warnings and (report is None or report.healthy),
        "facts": facts,
        "warnings": warnings,
        "findings": [
            {"fault": f.fault, "kind": f.kind, "views": f.views, "sentence": f.sentence, "cure": f.cure}
            for f in (report.findings if report is not None else ())
        ],
        "views": [{k: getattr(view, k) for k in _FIGURES} for view in (report.views if report is not None else ())],
        "page": "check.html" if report is not None else None,
    }
    write_text(path.with_suffix(".json"), to_json(json_values(found)))
    for text in facts:
        say(text)
    for text in warnings:
        say(f"warning: {text}", "yellow")
    if report is not None:
        _print_report(report)
        say(f"Page: {path.with_suffix('.html')}")
    say(f"Contact sheet: {path}")
    if c.refine:
        _refine(loaded, cured, c)
        return
    if warnings or (report is not None and not report.healthy):
        raise Exit(1)
    say("No problem found.", "green")


def _print_report(report: PersonReport) -> None:
    """Print how well each view agrees with the others, and the findings."""
    for view in report.views:
        points = f"key points {view.left_out_px:.1f} px from where the other cameras put them"
        figures = ((view.left_out_px, points), (view.tangency_px, f"silhouette {view.tangency_px:.1f} px"))
        say(f"{view.name}: " + (", ".join(text for px, text in figures if np.isfinite(px)) or "nothing to compare"))
    for finding in report.findings:
        say(f"{'fault' if finding.fault else 'note'}: {finding.sentence}", "yellow" if finding.fault else None)


def _refine(loaded: Recording, cured: Cured | None, c: CheckCommand) -> None:
    """Refine the calibration from the person, print the changes, and write it where it is better.

    loaded: recording as it is.
    cured: the recording with measured faults corrected, from which the refinement starts; None: from the recording.
    c: options of the user.
    Raises: Exit with code 1 where the refined calibration is not better, or moves a camera far without --refine=far.
    """
    method = c.using
    if method == "auto":
        method = "keypoints" if loaded.keypoint_set is not None else "silhouettes"
    with Stages() as progress:
        result = refine_recording(
            loaded if cured is None else cured_recording(loaded, cured),
            method,
            late=None if cured is None else cured.late,
            focal=c.focal,
            fixed=c.keep,
            height=c.height or loaded.subject_height,
            progress=progress,
        )
    target = c.to or free_path(loaded.folder / "results", "calibration_refined", ".toml")
    for text in result.notes:
        say(f"note: {text}")
    why = ""
    if not _print_changes(result):
        why = "The refined calibration is not better on frames that it was not found on; nothing is written."
    elif result.far and not c.far:
        why = (
            f"The refinement takes {' and '.join(result.far)} more than 10 degrees or 0.5 m away from where the "
            "calibration has it, and nothing is written: look whether the key points are one person's in all views, or "
            "take it with --refine=far."
        )
    if why:
        say(why, "yellow")
        raise Exit(1)
    target.parent.mkdir(parents=True, exist_ok=True)
    write_calibration(result.rig, target)
    say(f"Refined calibration: {target} (metres, world as before, z up)", "green")
    if any("world is turned" in n for n in loaded.notes):
        say('note: this file is z up already: use it with world_up = "z".')
    say(f"Use it: hypose track {loaded.folder} --calibration {target}")


def _print_changes(result: Refinement) -> bool:
    """Print the changes of a refinement; return whether it is better on frames that it was not found on: by the key
    points with one camera left out, else by those of all cameras, else by the silhouettes.
    """
    for change in result.changes:
        focal = f", focal length x {change.focal:.4f}" if abs(change.focal - 1) > 1e-6 else ""
        say(
            f"{change.name}: turned by {change.turn_deg:.2f} degrees, moved by {1000 * change.move_m:.0f} mm{focal}; "
            f"the person moves {change.image_px:.1f} px in its image"
        )
    for what, (before, after) in result.residuals.items():
        say(f"{what}: {before:.2f} -> {after:.2f} px (median of frames not used)")
    before, after = next(iter(result.residuals.values()), (1.0, 0.0))
    return after < before


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
        files = {"background": "-" if "masks" in view.files else "from the recording", "masks": "-"}
        files |= {kind: _name(path) for kind, path in view.files.items()}
        x, y, z = camera.position
        rows.append((
            *(view.name, camera.name, _name(view.source), size, f"{camera.size[0]}x{camera.size[1]}", rate, frames),
            *(files["masks"], files["background"]),
            f"{files['keypoints']} ({recording.keypoint_set})" if "keypoints" in files else "-",
            f"{x:.2f} {y:.2f} {z:.2f}",
        ))  # fmt: skip
    print_table(title, (*columns, "position (m)"), rows)


def _name(path: Path | None) -> str:
    return "-" if path is None else path.name


def check_recording(
    recording: Recording, sheet: Path, samples: int, progress: ProgressCall = ignore
) -> tuple[list[str], list[str]]:
    """Check masks and visual hulls of some frames spread over the recording, and write the contact sheet.

    sheet: picture to write.
    samples: number of frames.
    Returns: facts and warnings, each a sentence.
    Raises: EvidenceError where no frame shows a person.
    """
    facts: list[str] = []
    warnings: list[str] = []
    source, several = frames_to_examine(recording, progress)
    with source:
        facts += ["Several people stand in the masks; their hulls are looked at together."] if several else []
        facts += [f"note: {text}" for text in source.notes]
        rows = np.unique(np.linspace(0, len(source) - 1, min(samples, len(source))).astype(int)).tolist()
        ious, why = list[np.ndarray](), ""
        points = np.stack([k.points for k in source.keypoints]) if source.keypoints else np.zeros((0, 0, 0, 3))
        shown = bool((points[..., 2] > 0).any())
        for row in each(progress, "check", rows):
            frame = source.frame(row)
            for masks in frame.of(Silhouettes):
                shown = shown or bool(masks.usable.any())
                why = why or next((r.rstrip(".") for r in masks.reasons if r), "")
                warnings += _mask_warnings(masks, frame.index)
                if len(recording.views) > 1:
                    ious += _hull_overlap(masks, frame.index, facts, warnings, several)
        guessed, contradicted = source.guessed_rooms, _contradictions(recording, np.array(ious))
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
    return facts, list(dict.fromkeys(warnings))


def examine_recording(
    recording: Recording,
    frames: int,
    sheet: Path,
    facts: Sequence[str],
    warnings: Sequence[str],
    progress: ProgressCall = ignore,
) -> tuple[PersonReport | None, Cured | None]:
    """Check the calibration on `frames` consecutive frames, and write the HTML page next to the contact sheet.

    sheet: file of the contact sheet.
    facts, warnings: result of `check_recording`, for the page.
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
        sheet.with_suffix(".html"),
        recording.name,
        report,
        sheet,
        residual_picture(recording, observed, cured),
        (*recording.notes, *facts),
        warnings,
    )
    return report, cured


def _mask_warnings(silhouettes: Silhouettes, number: int) -> list[str]:
    """List sentences on masks that are unusable, or cover too little or too much of the picture.

    number: number of the frame.
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


def _hull_overlap(
    silhouettes: Silhouettes, number: int, facts: list[str], warnings: list[str], several: bool
) -> list[np.ndarray]:
    """Compute the overlap of the visual hull with the masks, and add sentences on the hull.

    number: number of the frame.
    facts, warnings: receive the sentences.
    several: several people are in the masks, so that all parts of the hull count.
    Returns: one array (C,), the IoU with each view's mask, NaN for unusable masks; none without a hull.
    """
    try:
        hull = visual_hull(silhouettes, largest=not several)
    except EvidenceError as error:
        warnings.append(str(error) if str(number) in str(error) else f"frame {number}: {error}")
        return []
    iou = hull_iou(hull, silhouettes)
    height = float(np.ptp(hull.points[:, 2])) + hull.voxel
    x, y = hull.points[:, :2].mean(0)
    facts.append(
        f"Frame {number}: the common volume of the views is {hull.volume * 1000:.0f} litres, {height:.2f} m high, at "
        f"({x:.2f}, {y:.2f}) m; its overlap with the masks is {np.nanmean(iou):.2f} on average, "
        f"{float(np.nanmin(iou)):.2f} at worst."
    )
    return [iou]


def _contradictions(recording: Recording, ious: np.ndarray) -> list[str]:
    """List sentences on views that contradict the others.

    ious: (N, C) IoU of each hull with each view's mask; NaN where the mask is unusable.
    """
    usual = [np.median(mine[np.isfinite(mine)]) if np.isfinite(mine).any() else np.nan for mine in ious.T]
    return [
        f"View {view.name}: its masks agree badly with the other views (IoU {iou:.2f}); check its calibration, its "
        "synchronisation and its mask."
        for view, iou in zip(recording.views, usual, strict=bool(len(ious)))
        if iou < _LOW_IOU
    ]


def write_sheet(recording: Recording, source: FrameStream, path: Path, count: int) -> None:
    """Write a picture of some frames, one below the other, each with all views and the outlines of the masks.

    source: frames of the recording.
    count: number of frames, spread over the recording.
    """
    rows = np.unique(np.linspace(0, len(source) - 1, min(count, len(source))).astype(int)).tolist()
    numbers = recording.frames
    shown = [(numbers[row], Drawing(source.frame(row).silhouettes, f"frame {numbers[row]}")) for row in rows]
    write_frames(recording, shown, path)


def write_frames(recording: Recording, shown: Iterable[tuple[int, Drawing]], path: Path) -> None:
    """Write a picture of frames, one below the other, each with all views.

    shown: number and drawing of each frame.
    """
    with open_images(recording) as images:
        canvas = Canvas(recording, images)
        rows = [canvas.draw([v.read(number) for v in images], what).copy() for number, what in shown]
    picture = np.concatenate(rows)
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
