"""`hypose check`: is this recording's calibration right, and if not, what to do; `--refine` does it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hypose.app.commands.console import Stages, out, say
from hypose.app.commands.options import HEIGHT, number
from hypose.errors import InputError

if TYPE_CHECKING:
    from hypose.calibration.diagnostics import Cured, Report
    from hypose.io.recordings.recording import Recording
    from hypose.pipeline.examine import Refinement

_REFINE = "Refine"


def check(
    recording: Annotated[Path, typer.Argument(help="Folder with recording.toml, that file, or a Pose2Sim project.")],
    sheet: Annotated[
        Path | None, typer.Option("--out", help="Contact sheet to write. [default: results/check.png there]")
    ] = None,
    samples: Annotated[int, number("Frames whose common volume is looked at.", 1, 10_000)] = 5,
    frames: Annotated[int, number("Consecutive frames that the doctor looks at; 0: skip it.", 0, 100_000)] = 100,
    calibration: Annotated[
        Path | None, typer.Option(help="Use this calibration file instead of the recording's.")
    ] = None,
    refine: Annotated[
        bool,
        typer.Option("--refine", help="Find the cameras' poses from the moving person.", rich_help_panel=_REFINE),
    ] = False,
    using: Annotated[
        str,
        typer.Option("--from", help="keypoints, silhouettes, both, or auto.", rich_help_panel=_REFINE),
    ] = "auto",
    far: Annotated[
        bool,
        typer.Option(
            "--far", help="Also cameras more than 10 degrees or 0.5 m off (--refine=far).", rich_help_panel=_REFINE
        ),
    ] = False,
    focal: Annotated[bool, typer.Option("--focal", help="Focal lengths too.", rich_help_panel=_REFINE)] = False,
    keep: Annotated[
        list[str] | None,
        typer.Option(help="Camera that stays as it is (may be repeated).", rich_help_panel=_REFINE),
    ] = None,
    height: Annotated[
        float | None,
        number("The person's height in metres: sets the scale.", *HEIGHT, unit="metres", rich_help_panel=_REFINE),
    ] = None,
    to: Annotated[
        Path | None,
        typer.Option(
            help="New calibration file. [default: results/calibration_refined.toml there]", rich_help_panel=_REFINE
        ),
    ] = None,
) -> None:
    """Look whether the views agree, say what is wrong with which camera, and cure it with --refine.

    Exit code 0: fine, or refined; 1: something is wrong.
    """
    from hypose.app.jobs.checking import camera_table, check_picture, check_recording, examine_recording, write_findings
    from hypose.io.files import check_writable
    from hypose.io.recordings.recording import load_recording

    if using not in ("auto", "keypoints", "silhouettes", "both"):
        raise InputError(f"--from {using} is not possible; choose auto, keypoints, silhouettes or both.")
    if to is not None and to.exists():
        raise InputError(f"{to} exists, and calibrations are never overwritten; give another name with --to.")
    if sheet is not None:
        check_picture(sheet, "--out")
    loaded = load_recording(recording, calibration)
    for name in keep or []:
        loaded.rig.select([name])
    console = out()
    if not console.is_terminal:
        console.width = 160
    console.print(camera_table(loaded))
    for text in loaded.notes:
        say(f"note: {text}")
    path = sheet or loaded.folder / "results" / "check.png"
    check_writable(path.parent)
    if refine:
        check_writable((to or path).parent, "--to")
    report = cured = None
    with Stages() as progress:
        found = check_recording(loaded, path, samples, progress)
        if frames > 0:
            report, cured = examine_recording(loaded, frames, path.with_suffix(".html"), path, found, progress)
    write_findings(path.with_suffix(".json"), found, report)
    for text in found.facts:
        say(text)
    for text in found.warnings:
        say(f"warning: {text}", "yellow")
    if report is not None:
        _verdicts(report)
        say(f"Page: {path.with_suffix('.html')}")
    say(f"Contact sheet: {path}")
    if refine:
        _refine(loaded, cured, using, focal, tuple(keep or ()), height, to, far)
        return
    if found.warnings or (report is not None and not report.healthy):
        raise typer.Exit(1)
    say("No problem found.", "green")


def _verdicts(report: Report) -> None:
    for view in report.views:
        numbers = []
        if view.left_out_px == view.left_out_px:
            numbers.append(f"key points {view.left_out_px:.1f} px from where the other cameras put them")
        if view.tangency_px == view.tangency_px:
            numbers.append(f"silhouette {view.tangency_px:.1f} px")
        say(f"{view.name}: " + (", ".join(numbers) if numbers else "nothing to compare"))
    for finding in report.findings:
        say(f"{'fault' if finding.fault else 'note'}: {finding.sentence}", "yellow" if finding.fault else None)


def _refine(
    loaded: Recording,
    cured: Cured | None,
    using: str,
    focal: bool,
    keep: tuple[str, ...],
    height: float | None,
    to: Path | None,
    far: bool,
) -> None:
    from hypose.io.calibrations.calibration_text import write_calibration
    from hypose.pipeline.examine import cured_recording, refine_recording

    method = using
    if using == "auto":
        method = "keypoints" if loaded.keypoint_set is not None else "silhouettes"
    recording = loaded if cured is None else cured_recording(loaded, cured)
    late = None if cured is None else cured.late
    with Stages() as progress:
        result = refine_recording(
            recording,
            method,
            late=late,
            focal=focal,
            fixed=keep,
            height=height or loaded.subject_height,
            progress=progress,
        )
    target = to or _free_name(loaded.folder / "results" / "calibration_refined.toml")
    for text in result.notes:
        say(f"note: {text}")
    better = _tell(result)
    if not better:
        say("The refined calibration is not better on frames that it was not found on; nothing is written.", "yellow")
        raise typer.Exit(1)
    if result.far and not far:
        say(
            f"The refinement takes {' and '.join(result.far)} more than 10 degrees or 0.5 m away from where the "
            "calibration has it, and nothing is written: look whether the key points are one person's in all views, or "
            "take it with --refine=far.",
            "yellow",
        )
        raise typer.Exit(1)
    target.parent.mkdir(parents=True, exist_ok=True)
    write_calibration(result.rig, target)
    say(f"Refined calibration: {target} (metres, world as before, z up)", "green")
    if any("world is turned" in n for n in loaded.notes):
        say('note: this file is z up already: use it with world_up = "z".')
    say(f"Use it: hypose track {loaded.folder} --calibration {target}")
    if cured is not None:
        for text in _settings(loaded, cured):
            say(f"In recording.toml besides: {text}")


def _tell(result: Refinement) -> bool:
    for change in result.changes:
        focal = f", focal length x {change.focal:.4f}" if abs(change.focal - 1) > 1e-6 else ""
        say(
            f"{change.name}: turned by {change.turn_deg:.2f} degrees, moved by {1000 * change.move_m:.0f} mm{focal}; "
            f"the person moves {change.image_px:.1f} px in its image"
        )
    frames = "frames not used"
    better = True
    if result.before_px == result.before_px:
        say(
            f"Key points: {result.before_px:.2f} -> {result.after_px:.2f} px median residual ({frames}); one camera "
            f"left out: {result.left_out_before_px:.2f} -> {result.left_out_after_px:.2f} px"
        )
        better = result.after_px < result.before_px
    if result.tangency_before_px == result.tangency_before_px:
        say(f"Silhouettes: {result.tangency_before_px:.2f} -> {result.tangency_after_px:.2f} px ({frames})")
        if result.before_px != result.before_px:
            better = result.tangency_after_px < result.tangency_before_px
    return better


def _settings(recording: Recording, cured: Cured) -> list[str]:
    out = []
    if cured.keypoint_lag:
        out.append(f"keypoint_lag = {recording.keypoint_lag + cured.keypoint_lag}")
    for view, shift in zip(recording.views, cured.shift, strict=True):
        if shift.any():
            x, y = (round(float(a + b), 1) for a, b in zip(view.image_shift, shift, strict=True))
            out.append(f"view {view.name}: image_shift = [{x:g}, {y:g}]")
    return out


def _free_name(path: Path) -> Path:
    """The path, or with a number behind it the first that is not taken: calibrations are never overwritten."""
    number, free = 2, path
    while free.exists():
        free = path.with_name(f"{path.stem}_{number}{path.suffix}")
        number += 1
    return free
