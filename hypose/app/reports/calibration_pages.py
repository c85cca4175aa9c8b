"""Write the pages of calibrations: the HTML page of `hypose check`, the contact sheet of a board calibration, and a
chessboard to print with instructions for filming it (PDF).
"""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path

import cv2
import numpy as np

from hypose import __version__
from hypose.app.reports.report_parts import html_list, html_table, number_text, page, picture_of
from hypose.app.reports.result_pictures import close_up, jpeg, open_images, put_text
from hypose.calibration.boards import Board, BoardDetection
from hypose.calibration.diagnostics import Cured, Observed, PersonReport
from hypose.calibration.from_boards import BoardCalibration
from hypose.calibration.views import CameraViews
from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.evidence.keypoint_check import triangulated
from hypose.geometry import Image
from hypose.io.files import write_text
from hypose.io.recordings.recording import Recording
from hypose.io.videos.video import open_video
from hypose.pipeline.recording_diagnostics import window

_MEASURED, EXPECTED = (60, 200, 250), (60, 60, 235)  # BGR
_TILE = (400, 560)  # px: size of the picture of one view


def residual_picture(recording: Recording, observed: Observed, cured: Cured) -> Image | None:
    """Draw the key points of all views in the frame with most of them, each with a line to where the other cameras put
    it.

    observed: evidence of the check.
    cured: measured faults, of which the lag of the key points is used.
    Returns: picture; None without key points, with fewer than three cameras, or without pictures.
    """
    if not observed.names or len(recording.rig) < 3:
        return None
    few = window(recording, observed.keypoints.shape[1])
    row = int(np.argmax((observed.keypoints[..., 2] > 0.5).sum(2).min(0)))
    number = few.frames[min(row, len(few.frames) - 1)] + cured.keypoint_lag
    tiles = []
    with open_images(recording) as images:
        for c, (camera, view) in enumerate(zip(recording.rig, images, strict=True)):
            picture = view.read(min(number, recording.n_frames - 1))
            if picture is None:
                continue
            others = [k for k in range(len(images)) if k != c]
            rig = CameraRig(tuple(recording.rig[k] for k in others))
            points = triangulated(rig, observed.keypoints[others, row : row + 1])[0]
            shown = camera.scaled(picture.shape[1::-1])
            tile, near = close_up(picture, shown, points, _TILE, 1.3)
            x, y, confidence = observed.keypoints[c, row].T
            found = (np.stack([x, y], 1) + 0.5) * np.array(shown.size) / camera.size - 0.5
            found = near.K[:2, 2] + (found - shown.K[:2, 2]) * near.K[0, 0] / shown.K[0, 0]
            places = np.clip(np.stack([found, near.project(points)], 1), -4000, 4000)
            for a, b in places[(confidence > 0.3) & np.isfinite(places).all((1, 2))].round().astype(int).tolist():
                cv2.line(tile, a, b, EXPECTED, 2, cv2.LINE_AA)
                cv2.circle(tile, a, 4, _MEASURED, -1, cv2.LINE_AA)
            put_text(tile, camera.name, 8, 18)
            tiles.append(tile)
    return np.concatenate(tiles, 1) if tiles else None


def write_check_page(
    path: Path,
    title: str,
    report: PersonReport,
    sheet: Path,
    picture: Image | None,
    facts: Sequence[str],
    warnings: Sequence[str],
) -> None:
    """Write the HTML page of a calibration check, with all pictures inside.

    title: name of the recording.
    report: result of the check.
    sheet: file of the masks' contact sheet; it may be missing.
    picture: result of `residual_picture`.
    facts: notes at the end.
    warnings: further faults.
    """
    fine = report.healthy and not warnings
    rows = []
    for v in report.views:
        moved = "-" if v.change is None else f"{v.change.turn_deg:.2f}&deg;, {1000 * v.change.move_m:.0f} mm"
        kinds = html.escape(", ".join(dict.fromkeys(f.kind for f in report.of(v.name) if f.fault)))
        word = f'<span class="bad">{kinds}</span>' if kinds else "fine"
        numbers = map(number_text, (v.residual_px, v.left_out_px, v.tangency_px))
        rows.append((html.escape(v.name), *numbers, moved, word))
    head = ("camera", "residual (px)", "left out (px)", "silhouette (px)")
    found = [("" if f.fault else "Note: ") + f.sentence for f in report.findings]
    parts = [
        f"<h1>{html.escape(title)}: is the calibration right?</h1>",
        '<p class="good">No fault found.</p>' if fine else '<p class="bad">Something is wrong; see below.</p>',
        "<h2>Findings</h2>" + html_list([*found, *warnings] or ["none"]),
        "<h2>Cameras</h2>" + html_table(rows, (*head, "a refinement moves it by", "assessment"), range(1, 5)),
        "<p class='dim'>Residual: median distance of the camera's key points from the triangulation of all "
        "views; left out: of the other views. Silhouette: by how much the planes that touch the person differ from "
        "those of the other views.</p>",
    ]
    if picture is not None:
        parts.append("<h2>Key points, and where the other cameras put them</h2>")
        parts.append(picture_of(jpeg(picture, picture.shape[1], 85), "jpeg"))
    if sheet.is_file():
        parts.append("<h2>Masks</h2>" + picture_of(sheet.read_bytes(), "png"))
    parts.append("<h2>Notes</h2>" + html_list(facts))
    parts.append(f"<p class='dim'>hypose {__version__}</p>")
    write_text(path, page(f"{title}: check", "\n".join(parts)))


# ---- calibration sheet ---------------------------------------------------------------------------------------------
# Contact sheet of a calibration: per camera a picture with the board, the corners of all boards, a picture in which the
# board was not found and why, and the result of every frame.


_WIDTH = 520  # px of one picture
_STRIP = 26
_COLOURS = {"": (80, 190, 80), "blurred": (60, 160, 240), "too dark": (150, 60, 60), "overexposed": (230, 230, 120)}
_NOT_FOUND = (60, 60, 200)


def draw_sheet(views: Sequence[CameraViews], board: Board, result: BoardCalibration | None = None) -> Image:
    """Draw the contact sheet of a board calibration, one row per camera.

    A row shows a picture with a board (its first row in red, so that opposite numberings are visible), all corners that
    were found (green to red by their error, up to 2 px), a picture without a board and why, and below them a strip with
    the result of each frame.
    views: detections of all cameras, also of videos for the lenses alone.
    result: result of the calibration; None where it failed: then corners have no error and are grey.
    """
    rows = []
    seen = Counter(f for view in (views if result is None else result.views) for f in view.sightings)
    common = [f for f in sorted(seen) if seen[f] == max(seen.values())]
    for view in views:
        errors, numbered = dict[int, float](), view.sightings
        c = next((k for k, v in enumerate(() if result is None else result.views) if v is view), None)
        if result is not None and c is not None:
            errors = {f: e for (k, f), e in result.fit.errors.items() if k == c}
            numbered = {**numbered, **(result.fit.sightings[c] if errors else {})}
        rows.append(_row(view, board, numbered, errors, common))
    return np.concatenate(rows) if rows else np.zeros((10, 3 * _WIDTH, 3), np.uint8)


def _row(
    view: CameraViews,
    board: Board,
    sightings: Mapping[int, BoardDetection],
    errors: Mapping[int, float],
    common: Sequence[int],
) -> Image:
    """Draw the row of one camera.

    sightings: boards by frame, as numbered by the calibration.
    errors: errors of the boards by frame, px; a frame may be missing.
    common: frames in which most cameras see the board, in order of preference.
    """
    scale = _WIDTH / view.size[0]
    size = (_WIDTH, max(40, round(scale * view.size[1])))
    # the same picture in all cameras if there is one, so that the numbering can be compared
    usual = [f for f in common if f in sightings] or [f for f in sightings if f in errors] or list(sightings)
    shown = usual[len(usual) // 2] if usual else None
    without = [f for f, k in view.looks.items() if k.reason]
    missing = without[len(without) // 2] if without else None
    cells = [
        _picture(view, shown, size, "no board in any picture" if shown is None else f"frame {shown}"),
        np.full((size[1], size[0], 3), 32, np.uint8),
        _picture(view, missing, size, "" if missing is None else f"frame {missing}: {view.looks[missing].reason}"),
    ]
    if shown is not None:
        ids, pixels = sightings[shown].ids, sightings[shown].pixels
        corners = (scale * pixels[np.argsort(ids)]).astype(np.float32)
        # lines along the rows, the first of them red; a part of a board as circles
        cv2.drawChessboardCorners(cells[0], board.size, corners, len(ids) == len(board.points))
    for f, s in sightings.items():
        error = errors.get(f, float("nan"))
        share = min(error / 2, 1.0) if np.isfinite(error) else 0.0
        colour = (60, round(220 * (1 - share)), round(220 * share)) if np.isfinite(error) else (140, 140, 140)
        for x, y in (scale * s.pixels).round().astype(int).tolist():
            cv2.circle(cells[1], (x, y), 2, colour, -1, cv2.LINE_AA)
    put_text(cells[1], f"{len(sightings)} boards, {100 * view.coverage:.0f} % of the area", 8, 18)
    shades = [_COLOURS.get(view.looks[number].reason, _NOT_FOUND) for number in sorted(view.looks)] or [(20, 20, 20)]
    strip = cv2.resize(np.array([shades], np.uint8), (3 * _WIDTH, _STRIP), interpolation=cv2.INTER_NEAREST)
    head = np.full((30, 3 * _WIDTH, 3), 0, np.uint8)
    put_text(head, view.summary(), 8, 20)
    return np.concatenate([head, np.concatenate(cells, 1), strip]).astype(np.uint8)


def _picture(view: CameraViews, frame: int | None, size: tuple[int, int], text: str) -> Image:
    """Draw a picture of a video with a text; grey without a picture.

    frame: number; None: no picture.
    size: (width, height) px.
    """
    image = np.full((size[1], size[0], 3), 32, np.uint8)
    if frame is not None:
        try:
            with open_video(view.path) as reader:
                image = np.asarray(
                    cv2.resize(reader.read(frame + view.lag), size, interpolation=cv2.INTER_AREA), np.uint8
                )
        except InputError:
            text = f"{text}: cannot be read again"
    put_text(image, text, 8, 18)
    return image


# ---- board to print -----------------------------------------------------------------------------------------------


def printed_board(paper: str) -> bytes:
    """Read the PDF with the chessboard for a paper (a4 or a3) and the instructions for filming it, which
    scripts/bake_board.py has made.

    Raises: InputError for another paper.
    """
    if paper not in ("a4", "a3"):
        raise InputError(f"There is no board for the paper {paper[:20]!r}; choose a4 or a3.")
    return resources.files("hypose.assets").joinpath(f"board-{paper}.pdf").read_bytes()
