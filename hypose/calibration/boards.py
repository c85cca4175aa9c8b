"""Calibration boards: their patterns, and detection of their corners in pictures.

OpenCV finds chessboards and ChArUco boards. Two steps are added for chessboards. A picture without a detection is
searched again in rectified views of its bright sheets, because OpenCV's detectors miss boards that lie far away on the
floor (all of four real cameras at 4 m, 20 x 10 px per square). And corners are numbered in a fixed order, as far as the
pattern allows: a chessboard looks the same when rotated by 180 degrees if both of its corner counts are even or both
odd (`Board.turns`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.errors import InputError, refuse
from hypose.geometry import Array

Gray = NDArray[np.uint8]
IntArray = NDArray[np.int64]

_SEARCH_SIZE = 1400  # px: larger pictures are searched in a smaller copy first; corners are refined in the original
_FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE
_MIN_CORNERS = 6  # of a ChArUco board; fewer do not determine the pose of a plane well
_SHEETS = 4  # bright quadrilaterals that are searched


@dataclass(frozen=True)
class Board:
    """A flat calibration board.

    kind: "chessboard" or "charuco".
    columns, rows: inner corners of a chessboard, squares of a ChArUco board (as OpenCV counts each).
    square: side of a square, m.
    marker: side of a ChArUco board's markers, m.
    dictionary: OpenCV's name of its markers.
    legacy: ChArUco boards of OpenCV before 4.6 with an even number of rows.
    inverted: printed white on black.
    Raises: InputError where a value is out of range.
    """

    kind: Literal["chessboard", "charuco"]
    columns: int
    rows: int
    square: float
    marker: float = 0.0
    dictionary: str = "DICT_4X4_1000"
    legacy: bool = False
    inverted: bool = False

    def __post_init__(self) -> None:
        charuco = self.kind == "charuco"
        low, what = (2, "squares") if charuco else (3, "inner corners")
        wrong = not (low <= self.columns <= 100 and low <= self.rows <= 100)
        faults = {
            f"A {self.kind} has {low} to 100 {what} each way, got {self.columns} x {self.rows}": wrong,
            f"The board's squares are said to be {self.square:g} m wide; give 1 mm to 5 m, with the unit (115mm)": (
                not 1e-3 <= self.square <= 5
            ),
            f"The board's markers are said to be {self.marker:g} m wide; they must be smaller than the squares "
            f"({self.square:g} m)": charuco and not 0 < self.marker < self.square,
            f"The marker dictionary {self.dictionary!r} is not known; the dictionaries are "
            f"{', '.join(dictionaries())}": charuco and self.dictionary not in dictionaries(),
        }
        refuse("", faults)

    @property
    def size(self) -> tuple[int, int]:
        """Number of corners along x and along y."""
        return (self.columns, self.rows) if self.kind == "chessboard" else (self.columns - 1, self.rows - 1)

    @cached_property
    def points(self) -> Array:
        """Positions (N, 3) of the board's corners in the board's frame, m, row by row.

        z is 0. Seen from the front, x points right, y down and z into the board.
        """
        nx, ny = self.size
        xy = np.stack(np.meshgrid(np.arange(nx), np.arange(ny)), -1).reshape(-1, 2)
        first = 0 if self.kind == "chessboard" else 1
        return np.asarray(np.concatenate([(xy + first) * self.square, np.zeros((nx * ny, 1))], 1), dtype=np.float64)

    @cached_property
    def turns(self) -> tuple[IntArray, ...]:
        """Renumberings (N,) of the corners under which the picture stays the same, the identity first.

        Corner i gets the number turn[i]. ChArUco boards have only the identity, because their markers have numbers.
        """
        nx, ny = self.size
        grid = np.arange(nx * ny, dtype=np.int64).reshape(ny, nx)
        turns = [grid.ravel()]
        if self.kind == "chessboard" and (nx + ny) % 2 == 0:
            turns.append(grid[::-1, ::-1].ravel())
            if nx == ny and nx % 2 == 0:
                turns += [np.rot90(grid).ravel(), np.rot90(grid, 3).ravel()]
        return tuple(turns)

    def __str__(self) -> str:
        what = "inner corners" if self.kind == "chessboard" else f"squares, {self.dictionary}"
        return f"{self.kind} of {self.columns} x {self.rows} {what}, squares of {1e3 * self.square:g} mm"


@dataclass(frozen=True)
class BoardDetection:
    """A board detected in a picture.

    ids: (n,) numbers of the corners, rows of Board.points.
    pixels: (n, 2) px.
    edge_px: width of the edges between black and white, px; about 2 in a sharp picture, more with blur.
    """

    ids: IntArray
    pixels: Array
    edge_px: float

    def turned(self, turn: IntArray) -> BoardDetection:
        """Copy the detection with its corners renumbered by one of `Board.turns`."""
        return BoardDetection(turn[self.ids], self.pixels, self.edge_px)


Detector = Callable[[Gray], BoardDetection | None]


def dictionaries() -> tuple[str, ...]:
    """List the names of OpenCV's marker dictionaries."""
    return tuple(sorted(n for n in dir(cv2.aruco) if n.startswith("DICT_") and n == n.upper()))


def make_detector(board: Board) -> Detector:
    """Make the detector of a board.

    Returns: function of a grey picture (h, w) that returns a BoardDetection, or None where the picture shows no
        board.
    """
    if board.kind == "charuco":
        return _charuco_detector(board)

    def detect(gray: Gray) -> BoardDetection | None:
        picture = 255 - gray if board.inverted else gray
        found = _find_chessboard(picture, board.size)
        if found is None:
            return None
        pixels = _refined(gray, _numbered(picture, found, board.size), board.size)
        if not _regular(pixels, board.size):
            return None
        return BoardDetection(np.arange(len(pixels)), pixels, edge_width(gray, pixels))

    return detect


def likely_shown(gray: Gray, board: Board) -> bool:
    """Test in a few milliseconds whether a grey picture (h, w) shows a board.

    Returns: True where OpenCV's quick check sees a chessboard, which a detector nearly always finds then; False leaves
        it open. True for every picture where the board is a ChArUco board, which are searched fast.
    """
    return board.kind == "charuco" or bool(cv2.checkChessboard(255 - gray if board.inverted else gray, board.size))


def _charuco_detector(board: Board) -> Detector:
    """Make the detector of a ChArUco board, as `make_detector` does."""
    detector = cv2.aruco.CharucoDetector(opencv_charuco(board))
    nx = board.size[0]

    def detect(gray: Gray) -> BoardDetection | None:
        corners, ids = detector.detectBoard(255 - gray if board.inverted else gray)[:2]
        if ids is None or len(ids) < _MIN_CORNERS:
            return None
        numbers = np.asarray(ids).ravel().astype(np.int64)
        # on one line the pose is undetermined
        if len(np.unique(numbers % nx)) < 2 or len(np.unique(numbers // nx)) < 2:
            return None
        pixels = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
        order = np.argsort(numbers)
        return BoardDetection(numbers[order], pixels[order], edge_width(gray, pixels))

    return detect


def opencv_charuco(board: Board) -> cv2.aruco.CharucoBoard:
    """Make OpenCV's object of a ChArUco board.

    Raises: InputError where the dictionary has too few markers.
    """
    markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    if board.columns * board.rows // 2 > len(markers.bytesList):
        raise InputError(
            f"The dictionary {board.dictionary} has {len(markers.bytesList)} markers, a board of {board.columns} x "
            f"{board.rows} squares needs {board.columns * board.rows // 2}; give the board's own dictionary."
        )
    pattern = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, board.marker, markers)
    pattern.setLegacyPattern(board.legacy)
    return pattern


# ---- chessboards ---------------------------------------------------------------------------------------------------


def _find_chessboard(gray: Gray, size: tuple[int, int]) -> Array | None:
    """Find the corners of a chessboard roughly, in any of its numberings.

    gray: (h, w) picture.
    size: corners along x and along y.
    Returns: (N, 2) px; None without a board.
    """
    for number, (view, image_from_view) in enumerate(board_views(gray, size, _SEARCH_SIZE)):
        found, corners = cv2.findChessboardCornersSB(view, size, flags=_FLAGS)
        if not found and number:  # the older detector closes gaps in overexposed boards
            found, corners = cv2.findChessboardCorners(view, size)
        if found:
            at = cv2.perspectiveTransform(corners.reshape(-1, 1, 2).astype(np.float64), image_from_view)
            return np.asarray(at[:, 0], dtype=np.float64)
    return None


def board_views(gray: Gray, size: tuple[int, int], largest: int) -> Iterator[tuple[Gray, Array]]:
    """Yield a picture, and then its bright sheets, rectified to front views.

    size: corners of the expected board along x and y, for the shape of the front views.
    largest: longer side to which the picture is reduced, px.
    Returns: an iterator over grey pictures and their image_from_view (3, 3).
    """
    scale = min(1.0, largest / max(gray.shape))
    small = gray if scale == 1 else _gray(cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    move = 0.5 / scale - 0.5
    image_from_small = np.array([[1 / scale, 0.0, move], [0.0, 1 / scale, move], [0.0, 0.0, 1.0]])
    yield small, image_from_small
    width, height, margin = 32 * (size[0] + 3), 32 * (size[1] + 3), 48
    target = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32) + np.float32(margin)
    shape = (width + 2 * margin, height + 2 * margin)
    for quad in _sheets(small):
        sheet_from_small = cv2.getPerspectiveTransform(quad.astype(np.float32), target)
        sheet = cv2.warpPerspective(
            small, sheet_from_small, shape, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
        )
        yield _gray(sheet), np.asarray(image_from_small @ np.linalg.inv(sheet_from_small), dtype=np.float64)


def _sheets(gray: Gray) -> list[Array]:
    """Find the largest different bright quadrilaterals (4, 2), px, such as a board on white paper seen obliquely."""
    kept: list[tuple[float, Array]] = []
    for level in np.unique(np.percentile(gray, [50, 60, 70, 80, 86, 91, 95, 98]).astype(int)):
        contours, _ = cv2.findContours((gray > level).astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
        for contour in contours:
            hull = cv2.convexHull(contour)
            area = cv2.contourArea(hull)
            if not 0.002 * gray.size < area < 0.6 * gray.size:
                continue
            quad = cv2.approxPolyDP(hull, 0.02 * cv2.arcLength(hull, True), True).reshape(-1, 2)
            if len(quad) != 4 or cv2.contourArea(quad) < 0.9 * area:
                continue
            if cv2.contourArea(contour) < 0.3 * area:  # a board is at least half white
                continue
            centre = quad.mean(0)
            near = 0.1 * np.sqrt(area)
            if all(np.linalg.norm(centre - q.mean(0)) > near or abs(a / area - 1) > 0.2 for a, q in kept):
                kept.append((area, quad.astype(np.float64)))
    # those with most edges first: boards have many, walls and lamps few
    busy = cv2.convertScaleAbs(cv2.Laplacian(gray, cv2.CV_16S))

    def edges(quad: Array) -> float:
        mask = np.zeros(gray.shape, np.uint8)
        cv2.fillConvexPoly(mask, quad.astype(np.int32), 1)
        return float(cv2.mean(busy, mask)[0])

    return sorted((q for _, q in kept), key=edges, reverse=True)[:_SHEETS]


def _numbered(gray: Gray, corners: Array, size: tuple[int, int]) -> Array:
    """Put the corners into the order that the pattern defines, or into one of the equivalent orders of Board.turns.

    gray: (h, w) picture in which the board is black on white.
    corners: (N, 2) px, row by row in any direction.
    size: corners along x and along y.
    Returns: (N, 2) px in right-handed order as seen from the front; the first inner square is dark where the opposite
        one is light.
    """
    nx, ny = size
    grid = corners.reshape(ny, nx, 2)
    right, down = grid[:, -1].mean(0) - grid[:, 0].mean(0), grid[-1].mean(0) - grid[0].mean(0)
    if right[0] * down[1] - right[1] * down[0] < 0:
        grid = grid[:, ::-1]
    first = _square_level(gray, grid[:2, :2])
    if (nx + ny) % 2:
        if first > _square_level(gray, grid[-2:, -2:]):
            grid = grid[::-1, ::-1]
    elif nx == ny and nx % 2 and first > _square_level(gray, grid[:2, -2:]):
        grid = np.rot90(grid)  # a quarter turn exchanges black and white
    return np.ascontiguousarray(grid.reshape(-1, 2))


def _square_level(gray: Gray, corners: Array) -> float:
    """Compute the mean brightness in the middle of a square with corners (2, 2, 2), px."""
    middle = corners.reshape(4, 2).mean(0)
    ring = middle + 0.5 * (corners.reshape(4, 2) - middle)
    h, w = gray.shape
    x, y = np.clip(np.rint(np.vstack([ring, middle])).astype(int), 0, [w - 1, h - 1]).T
    return float(gray[y, x].mean())


def _refined(gray: Gray, corners: Array, size: tuple[int, int]) -> Array:
    """Refine corners to a fraction of a pixel, as the points of symmetry of the picture seen from the front.

    The method is Gauss-Newton on I(c + u) - I(c - u) over a window of the rectified picture.

    Why: a corner of a chessboard is a centre of point symmetry, and remains one when overexposure enlarges the white
        squares. cv2.cornerSubPix searches for edges through the corner. In an overexposed picture the corners lie in
        gaps without edges, where it drifts (2 px on real boards of 20 x 10 px per square; this method is off by 0.3
        px).
    """
    nx, ny = size
    largest = float(_spacing(corners).max())
    cell = int(np.clip(np.ceil(1.5 * largest), 16, 40))
    flat = np.stack(np.meshgrid(np.arange(nx), np.arange(ny)), -1).reshape(-1, 2) * float(cell) + 1.5 * cell
    sheet_from_image = cv2.findHomography(corners, flat)[0]
    if sheet_from_image is None:
        return corners
    zoom = cell / largest
    picture = gray if zoom > 0.7 else _gray(cv2.GaussianBlur(gray, (0, 0), 0.5 / zoom))
    shape = ((nx + 2) * cell, (ny + 2) * cell)
    sheet = cv2.warpPerspective(
        picture, sheet_from_image, shape, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    ).astype(np.float32)
    start = cv2.perspectiveTransform(corners.reshape(-1, 1, 2), sheet_from_image).reshape(-1, 2)
    # a smooth fit of all corners corrects those that drifted: the lens bends the grid smoothly
    x, y = ((flat - flat.mean(0)) / np.abs(flat - flat.mean(0)).max()).T
    smooth = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], 1)
    start = flat + smooth @ np.linalg.lstsq(smooth, start - flat, rcond=None)[0]
    half = max(4, round(min(0.8 * cell, 14 * zoom)))
    line = np.arange(-half, half + 1) / half
    window = np.exp(-2 * (line[:, None] ** 2 + line**2)).astype(np.float32)
    side = (2 * half + 1, 2 * half + 1)
    images = (sheet, cv2.Scharr(sheet, cv2.CV_32F, 1, 0) / 32, cv2.Scharr(sheet, cv2.CV_32F, 0, 1) / 32)
    out = start.copy()
    for k in range(len(out)):
        for _ in range(12):
            patch, gx, gy = (cv2.getRectSubPix(i, side, (float(out[k, 0]), float(out[k, 1]))) for i in images)
            r = patch - patch[::-1, ::-1]
            gx, gy = gx - gx[::-1, ::-1], gy - gy[::-1, ::-1]
            xx, xy, yy = (
                float((window * gx * gx).sum()),
                float((window * gx * gy).sum()),
                float((window * gy * gy).sum()),
            )
            rx, ry = float((window * gx * r).sum()), float((window * gy * r).sum())
            det = xx * yy - xy * xy
            if det <= 1e-6 * (xx + yy) ** 2 + 1e-9:
                break
            step = np.array([xy * ry - yy * rx, xy * rx - xx * ry]) / det
            out[k] += np.clip(step, -2, 2)
            if np.abs(step).max() < 1e-3 or np.abs(out[k] - start[k]).max() > 0.4 * cell:
                break
    lost = np.abs(out - start).max(1) > 0.4 * cell
    out[lost] = start[lost]
    back = cv2.perspectiveTransform(out.reshape(-1, 1, 2), np.linalg.inv(sheet_from_image))
    return np.asarray(back, dtype=np.float64).reshape(-1, 2)


def _spacing(corners: Array) -> Array:
    """Compute the distance (N,) of each corner from the nearest other corner, px."""
    from scipy.spatial import KDTree  # takes long to import

    return KDTree(corners).query(corners, 2)[0][:, 1]


def _regular(corners: Array, size: tuple[int, int]) -> bool:
    """Test whether corners form a grid: the steps between neighbours change little, as perspective and lens allow."""
    grid = corners.reshape(size[1], size[0], 2)
    for axis in (0, 1):
        step = np.diff(grid, axis=axis)
        bend = np.linalg.norm(np.diff(step, axis=axis), axis=-1)
        if bend.size and bend.max() > 0.5 * np.linalg.norm(step, axis=-1).max() + 1:
            return False
    return bool(np.isfinite(corners).all())


def edge_width(gray: Gray, corners: Array) -> float:
    """Compute the median width of the edges at corners: contrast divided by the steepest gradient in a window.

    gray: (h, w) picture.
    corners: (N, 2) px.
    Returns: px; NaN where no edge can be measured.
    """
    h, w = gray.shape
    widths = []
    some = slice(None, None, max(1, len(corners) // 24))
    for (x, y), gap in zip(corners[some], _spacing(corners)[some], strict=True):
        half = int(np.clip(0.45 * gap, 3, 16))
        cx, cy = round(float(x)), round(float(y))
        if not (half < cx < w - half - 1 and half < cy < h - half - 1):
            continue
        cell = gray[cy - half : cy + half + 1, cx - half : cx + half + 1].astype(np.float32)
        contrast = float(np.percentile(cell, 95) - np.percentile(cell, 5))
        steep = np.hypot(cv2.Scharr(cell, cv2.CV_32F, 1, 0), cv2.Scharr(cell, cv2.CV_32F, 0, 1)).max() / 32
        if contrast > 8 and steep > 0:
            widths.append(contrast / float(steep))
    return float(np.median(widths)) if widths else float("nan")


def _gray(image: object) -> Gray:
    return np.asarray(image, dtype=np.uint8)
