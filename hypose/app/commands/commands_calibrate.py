"""`hypose calibrate`: cameras from boards, from measured points, from a person who walks about, or from a file of
another program."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from hypose.app.commands.console import Stages, print_note, print_table, say
from hypose.errors import CalibrationError, InputError
from hypose.options import HEIGHT, MOST_FRAMES, Option, Yes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hypose.calibration.boards import Board
    from hypose.calibration.from_boards import BoardCalibration
    from hypose.calibration.from_points import PointCalibration
    from hypose.calibration.views import CameraViews
    from hypose.cameras.camera import CameraRig


def calibrate(
    sources: Annotated[
        tuple[Path, ...],
        Option(
            "Board videos or photo folders, one per camera, or a folder that holds them; a recording for "
            "--from-person.",
            argument=True,
        ),
    ] = (),
    chessboard: Annotated[
        str | None,
        Option("Inner corners of the chessboard, for example 9x6. [default: counted in the pictures]"),
    ] = None,
    charuco: Annotated[str | None, Option("Squares of the ChArUco board, for example 5x7.")] = None,
    square: Annotated[str | None, Option("Side of a square with its unit: 115mm, 4.5cm, 1in.")] = None,
    marker: Annotated[str | None, Option("Side of a ChArUco marker with its unit.")] = None,
    dictionary: Annotated[str, Option("Markers of the ChArUco board.")] = "DICT_4X4_1000",
    inverted: Annotated[bool, Option("The board is printed white on black.")] = False,
    legacy: Annotated[bool, Option("The ChArUco board was made with OpenCV before 4.6.")] = False,
    intrinsics: Annotated[
        Path | None,
        Option("Calibration file whose lenses are kept, or a folder with board videos or photos for the lenses."),
    ] = None,
    refine_lenses: Annotated[bool, Option("Refine the lenses of the --intrinsics file as well.")] = False,
    fisheye: Annotated[bool, Option("The lenses are fisheyes.")] = False,
    floor: Annotated[
        int | None,
        Option("Frame in which the board lies on the floor. [default: where it lies still]", 0, MOST_FRAMES),
    ] = None,
    lag: Annotated[tuple[str, ...], Option("CAMERA=FRAMES: its video is so many frames late (may be repeated).")] = (),
    frames: Annotated[int, Option("Pictures looked at per camera.", 1, 100_000)] = 120,
    points: Annotated[
        Path | None, Option("Instead of a board: a TOML file of measured points and their clicks.")
    ] = None,
    convert: Annotated[Path | None, Option("Instead: a calibration file of another program.")] = None,
    unit: Annotated[str, Option("Unit of the file given with --convert: auto, m, cm or mm.")] = "auto",
    from_person: Annotated[bool, Option("Instead of a board: by the person who walks about in a recording.")] = False,
    height: Annotated[float | None, Option("Of that person: how tall, in metres.", *HEIGHT, unit="metres")] = None,
    largest: Annotated[
        float | None,
        Option(
            "Of --from-person: videos start within so many seconds. [default: found out]",
            0,
            600,
            above=True,
            unit="seconds",
        ),  # fmt: skip
    ] = None,
    yes: Yes = False,
    target: Annotated[
        Path | None,
        Option(
            "File to write; its ending tells the format (see docs/calibration.md). [default: calibration.toml, of "
            "--from-person in the recording's folder]",
            flag="--out",
        ),
    ] = None,
    sheet: Annotated[Path | None, Option("Picture of what was seen. [default: beside --out, .png]")] = None,
) -> None:
    """Calibrate cameras: lenses and places from a board, from measured points, or from a person; or convert."""
    from hypose.io.calibrations.calibration_formats import check_format, write_any
    from hypose.io.files import check_writable

    check_format(target or Path("calibration.toml"))
    given = [bool(sources), points is not None, convert is not None]
    if sum(given) != 1 or (from_person and len(sources or []) != 1):
        raise InputError(
            "Give board videos (with --chessboard or --charuco and --square), or --points FILE, or --convert FILE, or "
            "one recording with --from-person."
        )
    if from_person and sources:
        from hypose.app.jobs.person_calibration import calibrate_recording

        rig, target = calibrate_recording(sources[0], intrinsics, height, largest, yes, target)
        for path in write_any(rig, target):
            say(f"Calibration: {path}")
        return
    target = target or Path("calibration.toml")
    check_writable(target.parent)
    if convert is not None:
        from hypose.io.calibrations.calibration_formats import read_any

        rig, notes = read_any(convert, unit)
        for text in notes:
            print_note(f"note: {text}")
    elif points is not None:
        rig = _from_points(points, intrinsics)
    else:
        from hypose.app.jobs.checking import check_picture

        if chessboard is None and charuco is None and square is not None:
            chessboard = _counted(list(sources or []))
        board = parse_board(chessboard, charuco, square, marker, dictionary, inverted, legacy)
        picture = sheet or target.with_suffix(".png")
        check_picture(picture, "--sheet")
        rig = _from_boards(
            list(sources or []), board, intrinsics, refine_lenses, fisheye, floor, lag or [], frames, picture
        )
    for path in write_any(rig, target):
        say(f"Calibration: {path}")


def _counted(paths: list[Path]) -> str:
    """The corners of the chessboard in the pictures, as the option would say it."""
    from hypose.calibration.views import count_corners, find_sources

    columns, rows = count_corners(find_sources(paths))
    say(f"The board is taken for a chessboard of {columns} x {rows} inner corners, as counted in the pictures.")
    return f"{columns}x{rows}"


def parse_board(
    chessboard: str | None,
    charuco: str | None,
    square: str | None,
    marker: str | None,
    dictionary: str,
    inverted: bool,
    legacy: bool,
) -> Board:
    """The board of the command line's options; an InputError says which is missing or malformed."""
    from hypose.calibration.boards import Board

    if (chessboard is None) == (charuco is None):
        raise InputError("Say which board it is: --chessboard COLUMNSxROWS (inner corners) or --charuco (squares).")
    if square is None:
        raise InputError("Say how large the board's squares are, measured on the print: --square 115mm.")
    text = chessboard or charuco or ""
    counts = re.fullmatch(r"\s*(\d{1,3})\s*[xX*,]\s*(\d{1,3})\s*", text)
    if counts is None:
        raise InputError(f"The board's size {text!r} is not understood; write COLUMNSxROWS, for example 9x6.")
    columns, rows = int(counts[1]), int(counts[2])
    side = parse_length(square, "--square")
    if chessboard is not None:
        return Board("chessboard", columns, rows, side, inverted=inverted)
    if marker is None:
        raise InputError("Say how large the ChArUco board's markers are, measured on the print: --marker 86mm.")
    name = dictionary.upper() if dictionary.upper().startswith("DICT_") else f"DICT_{dictionary.upper()}"
    return Board("charuco", columns, rows, side, parse_length(marker, "--marker"), name, legacy, inverted)


def parse_length(text: str, option: str) -> float:
    """Metres of a length with its unit."""
    found = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*(mm|cm|m|in)\s*", text)
    if found is None:
        raise InputError(f"{option} {text!r} is not understood; write a number with its unit: 115mm, 4.5cm, 0.1m, 1in.")
    return float(found[1]) * {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}[found[2]]


def _lenses(path: Path) -> CameraRig:
    """The lenses of a calibration file; a CalibrationError when it does not say for which size of pictures they are."""
    from hypose.io.calibrations.calibration_formats import read_any

    rig, notes = read_any(path)
    guess = next((n for n in notes if "does not say how large" in n), None)
    if guess is not None:
        what, _, remedy = guess.partition("; ")
        raise CalibrationError(
            f"--intrinsics: {what}, and lenses fit only pictures of their own size; {remedy.split('wrong, ')[-1]}"
        )
    return rig


def _from_points(path: Path, intrinsics: Path | None) -> CameraRig:
    from hypose.calibration.from_points import calibrate_from_points, read_scene_points

    lenses = None if intrinsics is None else _lenses(intrinsics)
    result = calibrate_from_points(read_scene_points(path), lenses)
    _show_points(result)
    return result.rig


def _show_points(result: PointCalibration) -> None:
    from rich.table import Table

    table = Table(title=f"Fit of the points: {result.rms_px:.2f} px rms", title_justify="left")
    for column in ("camera", "points", "worst point (px)", "focal (px)", "position (m)", "uncertain by (mm)"):
        table.add_column(column)
    for camera, sd in zip(result.rig, result.position_sd, strict=True):
        errors = result.errors[camera.name]
        worst = max(errors, key=lambda n: errors[n])
        x, y, z = camera.position
        table.add_row(
            camera.name, str(len(errors)), f"{worst} {errors[worst]:.1f}", f"{camera.K[0, 0]:.0f}",
            f"{x:.3f} {y:.3f} {z:.3f}", f"{1e3 * sd:.0f}",
        )  # fmt: skip
    print_table(table)
    for text in result.notes:
        say(f"note: {text}")
    for text in result.warnings:
        say(f"warning: {text}", "yellow")


def _from_boards(
    paths: list[Path],
    board: Board,
    intrinsics: Path | None,
    refine_lenses: bool,
    fisheye: bool,
    floor: int | None,
    lag: list[str],
    frames: int,
    sheet: Path,
) -> CameraRig:
    from hypose.calibration.from_boards import BoardsNotFound, CalibrateOptions, calibrate_from_boards
    from hypose.calibration.views import find_sources

    sources = _with_lags(find_sources(paths), lag)
    lenses = lens_sources = None
    if intrinsics is not None and intrinsics.is_dir() and not (intrinsics / "intri.yml").is_file():
        lens_sources = find_sources([intrinsics], "lens videos")
    elif intrinsics is not None:
        lenses = _lenses(intrinsics)
    with Stages() as progress:
        options = CalibrateOptions(lenses, refine_lenses, fisheye, floor, frames, progress=progress)
        try:
            result = calibrate_from_boards(sources, board, options, lens_sources)
        except BoardsNotFound as error:
            where = _write_sheet(error.views, board, None, sheet)
            raise CalibrationError(f"{error} What was seen is in {where}.") from None
    _show(result)
    say(f"Contact sheet: {_write_sheet((*result.lens_views, *result.views), board, result, sheet)}")
    return result.rig


def _with_lags(sources: list, texts: list[str]) -> list:
    from dataclasses import replace

    lags = {}
    for text in texts:
        name, _, number = text.rpartition("=")
        if not re.fullmatch(r"[+-]?\d{1,6}", number) or name not in {s.name for s in sources}:
            raise InputError(
                f"--lag {text!r} is not understood; write CAMERA=FRAMES with one of the cameras "
                f"{', '.join(s.name for s in sources)}."
            )
        lags[name] = int(number)
    return [replace(s, lag=lags.get(s.name, 0)) for s in sources]


def _show(result: BoardCalibration) -> None:
    from rich.table import Table

    fit = result.fit
    table = Table(title=f"Joint fit of all boards: {fit.rms_px:.2f} px rms", title_justify="left")
    for column in (
        "camera",
        "boards",
        "left out",
        "area",
        "rms (px)",
        "focal (px)",
        "position (m)",
        "uncertain by (mm)",
    ):
        table.add_column(column)
    for c, (camera, view) in enumerate(zip(result.rig, result.views, strict=True)):
        sd, position_sd = fit.focal_sd[c], fit.position_sd[c]
        x, y, z = camera.position
        table.add_row(
            camera.name,
            f"{len(view.sightings)} of {len(view.looks)}",
            str(sum(1 for k, _ in fit.dropped if k == c)),
            f"{100 * view.coverage:.0f} %",
            f"{fit.camera_rms[c]:.2f}",
            f"{camera.K[0, 0]:.1f}" + (f" +- {sd:.1f}" if sd == sd else " (given)"),
            f"{x:.3f} {y:.3f} {z:.3f}",
            f"{1e3 * position_sd:.0f}" if position_sd == position_sd else "-",
        )
    print_table(table)
    for text in result.notes:
        say(f"note: {text}")
    for text in result.warnings:
        say(f"warning: {text}", "yellow")


def _write_sheet(views: Sequence[CameraViews], board: Board, result: BoardCalibration | None, path: Path) -> Path:
    from hypose.app.jobs.checking import write_image
    from hypose.app.reports.calibration_pages import draw_sheet

    write_image(path, draw_sheet(views, board, result))
    return path
