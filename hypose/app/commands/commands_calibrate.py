"""`hypose calibrate`: calibrate cameras from boards, measured points or a person who walks about, or convert a file of
another program.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hypose.app.commands.commands_sync import keep_offsets
from hypose.app.commands.console import Stages, print_notes, print_table, say
from hypose.app.jobs.checking import check_picture, write_image
from hypose.app.jobs.person_job import detected
from hypose.app.options import CalibrateCommand
from hypose.app.reports.calibration_pages import draw_sheet
from hypose.calibration.boards import Board
from hypose.calibration.from_boards import BoardCalibration, BoardsNotFound, CalibrateOptions, calibrate_from_boards
from hypose.calibration.from_person import PersonCalibration, calibrate_from_person
from hypose.calibration.from_points import PointCalibration, calibrate_from_points, read_scene_points
from hypose.calibration.views import count_corners, find_sources
from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import CalibrationError, InputError
from hypose.evidence.keypoints import keypoint_names, person_size
from hypose.evidence.one_person import without_held
from hypose.geometry import Array
from hypose.io.calibrations.calibration_formats import check_toml, read_any, write_calibration
from hypose.io.files import check_writable
from hypose.io.recordings.frames import candidates_of
from hypose.io.recordings.recording import Recording, load_recording
from hypose.options import named_values
from hypose.pipeline.recording_diagnostics import window


def calibrate(c: CalibrateCommand) -> None:
    """Calibrate cameras, or convert a calibration, and write the file (`hypose calibrate`)."""
    target = c.out or Path("calibration.toml")
    check_toml(target)
    given = [bool(c.sources), c.points is not None, c.convert is not None]
    if sum(given) != 1 or (c.from_person and len(c.sources) != 1):
        raise InputError(
            "Give board videos (with --chessboard or --charuco and --square), or --points FILE, or --convert FILE, or "
            "one recording with --from-person."
        )
    if c.from_person:
        rig, target = calibrate_recording(c)
    else:
        check_writable(target.parent)
        if c.convert is not None:
            rig, notes = read_any(c.convert, c.unit)
            print_notes(notes)
        elif c.points is not None:
            lenses = None if c.intrinsics is None else _lenses(c.intrinsics)
            found = calibrate_from_points(read_scene_points(c.points), lenses)
            _show_points(found)
            rig = found.rig
        else:
            rig = _from_boards(c, c.sheet or target.with_suffix(".png"))
    write_calibration(rig, target)
    say(f"Calibration: {target}")


def _board_of(c: CalibrateCommand) -> Board:
    """Make the board from the options; with --square alone, count the corners of a chessboard in the pictures.

    Raises: InputError names the option that is missing or malformed.
    """
    text = c.chessboard or c.charuco
    if (c.chessboard and c.charuco) or (text is None and c.square is None):
        raise InputError("Say which board it is: --chessboard COLUMNSxROWS (inner corners) or --charuco (squares).")
    if c.square is None:
        raise InputError("Say how large the board's squares are, measured on the print: --square 115mm.")
    side = parse_length(c.square, "--square")
    if text is None:
        columns, rows = count_corners(find_sources(c.sources))
        say(f"The board is taken for a chessboard of {columns} x {rows} inner corners, as counted in the pictures.")
    else:
        counts = re.fullmatch(r"\s*(\d{1,3})\s*[xX*,]\s*(\d{1,3})\s*", text)
        if counts is None:
            raise InputError(f"The board's size {text!r} is not understood; write COLUMNSxROWS, for example 9x6.")
        columns, rows = int(counts[1]), int(counts[2])
    if c.charuco is None:
        return Board("chessboard", columns, rows, side, inverted=c.inverted)
    if c.marker is None:
        raise InputError("Say how large the ChArUco board's markers are, measured on the print: --marker 86mm.")
    name = f"DICT_{c.dictionary.upper().removeprefix('DICT_')}"
    return Board("charuco", columns, rows, side, parse_length(c.marker, "--marker"), name, c.legacy, c.inverted)


def parse_length(text: str, option: str) -> float:
    """Parse a length with its unit (mm, cm, m or in), and return metres.

    option: flag of the option, for the error.
    Raises: InputError where it is no length.
    """
    found = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*(mm|cm|m|in)\s*", text)
    if found is None:
        raise InputError(f"{option} {text!r} is not understood; write a number with its unit: 115mm, 4.5cm, 0.1m, 1in.")
    return float(found[1]) * {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}[found[2]]


def _lenses(path: Path) -> CameraRig:
    """Load the lenses of a calibration file.

    Raises: CalibrationError where the file does not contain the size of the pictures.
    """
    rig, notes = read_any(path)
    guess = next((n for n in notes if "does not say how large" in n), None)
    if guess is not None:
        what, _, remedy = guess.partition("; ")
        raise CalibrationError(
            f"--intrinsics: {what}, and lenses fit only pictures of their own size; {remedy.split('wrong, ')[-1]}"
        )
    return rig


def _show_points(result: PointCalibration) -> None:
    """Print how well a calibration from measured points fits."""
    rows = []
    for camera, sd in zip(result.rig, result.position_sd, strict=True):
        errors = result.errors[camera.name]
        worst = max(errors, key=errors.__getitem__)
        fit = f"{worst} {errors[worst]:.1f}", f"{camera.K[0, 0]:.0f}", _place(camera, sd)
        rows.append((camera.name, str(len(errors)), *fit))
    columns = ("camera", "points", "worst point (px)", "focal (px)", _PLACE)
    print_table(f"Fit of the points: {result.rms_px:.2f} px rms", columns, rows)
    _say_notes(result)


def _from_boards(c: CalibrateCommand, sheet: Path) -> CameraRig:
    """Calibrate from videos or photos of a board, print the fit, and write the contact sheet.

    c: options of the user.
    sheet: file of the contact sheet, which is also written where no board is found.
    Returns: calibrated cameras.
    Raises: CalibrationError where no board is found.
    """
    board = _board_of(c)
    check_picture(sheet, "--sheet")
    sources = find_sources(c.sources)
    form = f"CAMERA=FRAMES with one of the cameras {', '.join(s.name for s in sources)}"
    lags = named_values("--lag", c.lag, form, {s.name for s in sources}, r"[+-]?\d{1,6}")
    sources = [replace(s, lag=int(lags.get(s.name, 0))) for s in sources]
    lenses = lens_sources = None
    if c.intrinsics is not None and c.intrinsics.is_dir() and not (c.intrinsics / "intri.yml").is_file():
        lens_sources = find_sources([c.intrinsics], "lens videos")
    elif c.intrinsics is not None:
        lenses = _lenses(c.intrinsics)
    with Stages() as progress:
        options = CalibrateOptions(lenses, c.refine_lenses, c.fisheye, c.floor, c.frames, progress=progress)
        try:
            result = calibrate_from_boards(sources, board, options, lens_sources)
        except BoardsNotFound as error:
            write_image(sheet, draw_sheet(error.views, board, None))
            raise CalibrationError(f"{error} What was seen is in {sheet}.") from None
    _show(result)
    write_image(sheet, draw_sheet((*result.lens_views, *result.views), board, result))
    say(f"Contact sheet: {sheet}")
    return result.rig


def _show(result: BoardCalibration) -> None:
    """Print how well a calibration from boards fits."""
    fit = result.fit
    rows = [
        (
            camera.name,
            f"{len(view.sightings)} of {len(view.looks)}",
            str(sum(1 for k, _ in fit.dropped if k == c)),
            f"{100 * view.coverage:.0f} %",
            f"{fit.camera_rms[c]:.2f}",
            f"{camera.K[0, 0]:.1f}" + (f" +- {fit.focal_sd[c]:.1f}" if np.isfinite(fit.focal_sd[c]) else " (given)"),
            _place(camera, fit.position_sd[c]),
        )
        for c, (camera, view) in enumerate(zip(result.rig, result.views, strict=True))
    ]
    columns = ("camera", "boards", "left out", "area", "rms (px)", "focal (px)", _PLACE)
    print_table(f"Joint fit of all boards: {fit.rms_px:.2f} px rms", columns, rows)
    _say_notes(result)


_PLACE = "position +- uncertainty (m)"


def _place(camera: Camera, sd: float) -> str:
    """Format the position of a camera, with its standard deviation (m), for a table."""
    return " ".join(f"{x:.3f}" for x in camera.position) + (f" +- {sd:.3f}" if np.isfinite(sd) else "")


def _say_notes(result: PointCalibration | BoardCalibration) -> None:
    for text in result.notes:
        say(f"note: {text}")
    for text in result.warnings:
        say(f"warning: {text}", "yellow")


# ---- from a person -----------------------------------------------------------------------------------------------

_MOST_SECONDS = 60


def person_of(loaded: Recording, lenses_known: bool, yes: bool) -> tuple[Array, tuple[str, ...]]:
    """Select the main person of each view (largest and most confident) in the middle minute of a recording.

    Key points come from the recording, else from the detector. Where the lenses are not known, detected ones are kept
    in a folder of their own, since the detector's masks fit no other lens.
    lenses_known: the recording's cameras have the right lenses.
    yes: the detector's models may be downloaded without asking.
    Returns: (C, T, K, 3) px of the stored pictures and confidence, 0 where the person is not seen; and the names of the
        key points.
    """
    few = window(loaded, round(_MOST_SECONDS * loaded.frame_rate))
    if few.keypoint_set is None:
        kept = few if lenses_known else replace(few, folder=few.folder / "results" / "uncalibrated")
        found = detected(kept, few.frames, yes=yes, why="--from-person")
        views = tuple(replace(v, files={**v.files, "keypoints": found.view(v.name)}) for v in few.views)
        few = replace(few, views=views, keypoint_set=found.keypoint_set, keypoint_lag=0, keypoint_pixels="calibration")
    names = keypoint_names(str(few.keypoint_set))
    people = candidates_of(few, few.rig)
    points = np.zeros((len(few.views), len(few.frames), len(names), 3))
    for c, view in enumerate(points):
        for t, found in enumerate(without_held([frame[c] for frame in people])[0]):
            if found is not None and len(found):
                view[t] = max(found[..., [3, 4, 2]], key=lambda p: float(p[:, 2].sum()) * person_size(p))
    return points, names


def calibrate_recording(c: CalibrateCommand) -> tuple[CameraRig, Path]:
    """Calibrate the cameras of a recording from the person; print the result and save the offsets.

    Returns: the cameras, and the file they are to be written to.
    Raises: InputError where the height is missing or the file exists.
    """
    path, lenses = c.sources[0], c.intrinsics
    loaded = load_recording(path, lenses, uncalibrated=lenses is None)
    rig = with_focal_lengths(loaded.rig, c.focal) if c.focal else loaded.rig
    target = c.out or loaded.folder / "calibration.toml"
    if target.exists():
        raise InputError(f"{target} exists, and calibrations are never overwritten; give another name with --out.")
    height = c.height or loaded.subject_height
    if height is None:
        raise InputError("Say how tall the person is, in metres: --height 1.72 (the height gives the scale).")
    points, names = person_of(loaded, lenses is not None, c.yes)
    print_notes(loaded.notes)
    with Stages() as progress:
        found = calibrate_from_person(
            points, names, rig, height, loaded.frame_rate,
            lenses_known=lenses is not None or bool(c.focal), largest_s=c.largest, progress=progress,
        )  # fmt: skip
    _show_person(found)
    keep_offsets(loaded, "person", found.late.tolist(), [f"sd {s:.2f}" for s in found.sds.late])
    if np.abs(found.late).max() > 0.05:
        offsets = ",".join(f"{x:.2f}" for x in found.late)
        say(f"To bring the evidence in step: hypose sync {path} --offsets={offsets} --out NEW_FOLDER")
    return found.rig, target


def with_focal_lengths(rig: CameraRig, given: Sequence[str]) -> CameraRig:
    """Set the focal lengths of a rig to those of the option --focal.

    given: texts "PIXELS" (all cameras) or "CAMERA=PIXELS"; of two for the same camera the later counts.
    Raises: InputError where a text is not understood, or a camera has no focal length.
    """
    pixels: dict[str, float] = {}
    for text in given:
        name, _, number = text.rpartition("=")
        if not re.fullmatch(r"[1-9]\d{0,5}(\.\d+)?", number) or name not in ("", *rig.names):
            raise InputError(
                f"--focal {text!r} is not understood; write a number of pixels for all cameras, or CAMERA=PIXELS with "
                f"one of the cameras {', '.join(rig.names)}."
            )
        pixels |= dict.fromkeys([name] if name else rig.names, float(number))
    if missing := [n for n in rig.names if n not in pixels]:
        raise InputError(f"--focal: the focal length of {', '.join(missing)} is missing; add CAMERA=PIXELS.")
    lenses = [np.array([[pixels[c.name], 0, c.K[0, 2]], [0, pixels[c.name], c.K[1, 2]], [0, 0, 1.0]]) for c in rig]
    return CameraRig(tuple(replace(c, K=k) for c, k in zip(rig, lenses, strict=True)))


def _show_person(found: PersonCalibration) -> None:
    """Print how well a calibration from a person fits."""
    sds = found.sds
    rows = [
        (
            camera.name,
            f"{found.late[k]:+.2f} +- {sds.late[k]:.2f}",
            f"{camera.K[0, 0]:.0f}" + (f" +- {sds.focal[k] * camera.K[0, 0]:.0f}" if sds.focal[k] else ""),
            _place(camera, sds.place_m[k]),
            f"{sds.turn_deg[k]:.2f}",
        )
        for k, camera in enumerate(found.rig)
    ]
    columns = ("camera", "late (frames)", "focal (px)", _PLACE, "turned by (deg)")
    print_table(f"Fit of the person's key points: {found.median_px:.1f} px median", columns, rows)
    for text in found.approximate:
        say(f"warning: approximate: {text}.", "yellow")
