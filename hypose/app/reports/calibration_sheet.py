"""The contact sheet of a calibration: per camera a picture with the board, where boards were seen, one in which it was
not found and why, and what every looked-at frame gave."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from hypose.app.reports.result_pictures import put_text
from hypose.calibration.boards import Board, BoardDetection
from hypose.calibration.from_boards import BoardCalibration
from hypose.calibration.views import CameraViews
from hypose.errors import InputError
from hypose.geometry import Image
from hypose.io.videos.video import open_video

_WIDTH = 520  # px of one picture
_STRIP = 26
_COLOURS = {"": (80, 190, 80), "blurred": (60, 160, 240), "too dark": (150, 60, 60), "overexposed": (230, 230, 120)}
_NOT_FOUND = (60, 60, 200)


def draw_sheet(views: Sequence[CameraViews], board: Board, result: BoardCalibration | None = None) -> Image:
    """One row per camera: a board that was found (its first row in red, so that opposite numberings show), all corners
    seen (green to red by their error, up to 2 px), a picture without; below them the frames from first to last."""
    rows = []
    seen = Counter(f for view in (views if result is None else result.views) for f in view.sightings)
    common = [f for f in sorted(seen) if seen[f] == max(seen.values())]
    for view in views:
        c = 0
        errors: dict[int, float] = {}
        if result is not None and any(view is v for v in result.views):
            c = next(i for i, v in enumerate(result.views) if v is view)
            errors = {f: e for (k, f), e in result.fit.errors.items() if k == c}
        numbered = view.sightings
        if errors and result is not None:
            numbered = {**numbered, **result.fit.sightings[c]}
        rows.append(_row(view, board, numbered, errors, common))
    return np.concatenate(rows) if rows else np.zeros((10, 3 * _WIDTH, 3), np.uint8)


def _row(
    view: CameraViews,
    board: Board,
    sightings: Mapping[int, BoardDetection],
    errors: Mapping[int, float],
    common: Sequence[int],
) -> Image:
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
        _draw_board(cells[0], sightings[shown], board, scale)
    for f, s in sightings.items():
        error = errors.get(f, float("nan"))
        share = min(error / 2, 1.0) if np.isfinite(error) else 0.0
        colour = (60, round(220 * (1 - share)), round(220 * share)) if np.isfinite(error) else (140, 140, 140)
        for x, y in (scale * s.pixels).round().astype(int).tolist():
            cv2.circle(cells[1], (x, y), 2, colour, -1, cv2.LINE_AA)
    put_text(cells[1], f"{len(sightings)} boards, {100 * view.coverage:.0f} % of the area", 8, 18)
    strip = np.full((_STRIP, 3 * _WIDTH, 3), 20, np.uint8)
    numbers = sorted(view.looks)
    width = max(1, 3 * _WIDTH // max(len(numbers), 1))
    for k, number in enumerate(numbers):
        look = view.looks[number]
        x = round(k * 3 * _WIDTH / len(numbers))
        strip[4:-4, x : x + max(1, width - 1)] = _COLOURS.get(look.reason, _NOT_FOUND)
    head = np.full((30, 3 * _WIDTH, 3), 0, np.uint8)
    put_text(head, view.summary(), 8, 20)
    return np.concatenate([head, np.concatenate(cells, 1), strip])


def _picture(view: CameraViews, frame: int | None, size: tuple[int, int], text: str) -> Image:
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


def _draw_board(image: Image, sighting: BoardDetection, board: Board, scale: float) -> None:
    nx = board.size[0]
    at = dict(zip(sighting.ids.tolist(), (scale * sighting.pixels).round().astype(int).tolist(), strict=True))
    for i, (x, y) in at.items():
        first = i < nx
        cv2.circle(image, (x, y), 3, (40, 40, 255) if first else (80, 230, 80), 1, cv2.LINE_AA)
        right, down = i + 1, i + nx
        if right in at and right % nx:
            cv2.line(image, (x, y), tuple(at[right]), (40, 40, 255) if first else (80, 230, 80), 1, cv2.LINE_AA)
        if down in at and not i % nx:
            cv2.line(image, (x, y), tuple(at[down]), (255, 120, 40), 1, cv2.LINE_AA)
    if 0 in at:
        cv2.circle(image, tuple(at[0]), 6, (40, 40, 255), 2, cv2.LINE_AA)
