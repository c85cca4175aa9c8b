"""Search for the board in the videos or photos of every camera, and explanation where it was not found."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from hypose.calibration.boards import Board, BoardDetection, Detector, Gray, board_views, likely_shown, make_detector
from hypose.errors import CalibrationError, InputError
from hypose.io.files import natural_key, text_of
from hypose.io.videos.video import IMAGE_ENDINGS, VIDEO_ENDINGS, evenly_spread, list_images, open_video

BoardProgress = Callable[[str, int, int], None]

BLURRED_PX = 5.0
"""Width of edges above which corners are too uncertain to be used, px."""
_COLOURS = {
    False: "the board is printed white on black: give --inverted",
    True: "the board is printed black on white: leave --inverted out",
}
_DICTIONARIES = ("DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_APRILTAG_36H11")
_ENOUGH_BOARDS = 24  # sharp boards of a camera after which no picture is searched that does not surely show one


@dataclass(frozen=True)
class BoardFootage:
    """The board pictures of one camera.

    path: a video, a folder of photos or one photo.
    lag: delay of the video, frames: its frame i + lag belongs to frame i of the others.
    """

    name: str
    path: Path
    lag: int = 0


@dataclass(frozen=True)
class Look:
    """The result of the search for a board in one picture.

    sighting: the detected board; None without one.
    reason: why it was not found or not used; empty where it was.
    focus: mean of the squared Laplacian, for comparison with other pictures of the same camera only.
    brightness: mean grey level.
    """

    sighting: BoardDetection | None
    reason: str
    focus: float
    brightness: float


@dataclass(frozen=True)
class CameraViews:
    """The results of the search for a board in the pictures of one camera.

    size: width and height, px.
    looks: results by frame number (of the common time; of photos, by order).
    lag: delay of the video, frames.
    """

    name: str
    path: Path
    size: tuple[int, int]
    looks: Mapping[int, Look]
    lag: int = 0

    @property
    def sightings(self) -> dict[int, BoardDetection]:
        """Detected boards of the sharp pictures, by frame number."""
        return {f: k.sighting for f, k in self.looks.items() if k.sighting is not None and k.reason == ""}

    @property
    def coverage(self) -> float:
        """Share of the picture's 6 x 6 fields in which a corner was detected."""
        seen = np.zeros((6, 6), bool)
        for s in self.sightings.values():
            x, y = np.clip(6 * s.pixels / self.size, 0, 5.99).astype(int).T
            seen[y, x] = True
        return float(seen.mean())

    def summary(self) -> str:
        """Format the result as one sentence."""
        n = len(self.sightings)
        why = Counter(look.reason for look in self.looks.values() if look.reason)
        rest = ", ".join(f"{k} x {r}" for r, k in why.most_common())
        text = f"{self.name}: the board was found in {n} of {len(self.looks)} pictures"
        if n:
            text += f", in {100 * self.coverage:.0f} % of the picture's area"
        return text + (f" ({rest})" if rest else "")


def find_sources(paths: Sequence[Path], what: str = "board videos") -> list[BoardFootage]:
    """Find the board pictures of each camera.

    Cameras are named by their files or, where these have equal names, by their folders.

    paths: a folder with one video or photo folder per camera, or the videos and photo folders themselves.
    what: name of the expected files, for error messages.
    Raises: InputError where a path cannot be used or names are not unique.
    """
    found: list[Path] = []
    for path in paths:
        if not path.exists():
            raise InputError(f"{path} does not exist; give the {what}: a folder, or one video or photo folder each.")
        found += _inside(path, what) if path.is_dir() else [path]
    for path in found:
        if path.is_file() and path.suffix.lower() not in VIDEO_ENDINGS + IMAGE_ENDINGS:
            raise InputError(f"{path} is neither a video nor a picture; give the {what}.")
    stems = [text_of(p.stem if p.is_file() else p.name) for p in found]
    if len(set(stems)) < len(stems):
        stems = [text_of(p.absolute().parent.name) for p in found]
    names = [re.sub(r"^(int|ext)_|_(img|ext|int|images|board|calib)$", "", s) for s in stems]
    if len(set(names)) < len(names):
        names = stems
    if len(set(names)) < len(names):
        raise InputError(
            f"The {what} cannot be distinguished by their names ({', '.join(stems)}); name the files by their cameras."
        )
    return [BoardFootage(n, p) for n, p in zip(names, found, strict=True)]


def _inside(folder: Path, what: str) -> list[Path]:
    """List the videos or photo folders in a folder, one per camera.

    what: name of the expected files, for the message.
    Raises: InputError where there are none.
    """
    entries = sorted(folder.iterdir(), key=lambda p: natural_key(p.name))
    videos = [p for p in entries if p.is_file() and p.suffix.lower() in VIDEO_ENDINGS]
    if videos:
        return videos
    folders = [p for p in entries if p.is_dir()]
    with_photos = [p for p in folders if list_images(p)]
    if with_photos:
        return with_photos
    with_videos = [v for p in folders for v in sorted(p.iterdir()) if v.suffix.lower() in VIDEO_ENDINGS]
    if with_videos and len(with_videos) == len({v.parent for v in with_videos}):
        return with_videos
    if list_images(folder):
        return [folder]
    raise InputError(
        f"{folder} holds no {what}: one video per camera, or one folder of photos per camera, is expected in it."
    )


def look_for_board(
    sources: Sequence[BoardFootage],
    board: Board,
    max_frames: int = 120,
    together: bool = True,
    progress: BoardProgress = lambda stage, done, total: None,
) -> tuple[CameraViews, ...]:
    """Search for the board in the pictures of all cameras.

    sources: board pictures of each camera.
    max_frames: largest number of pictures per camera, evenly spread.
    together: the cameras recorded at the same time, so the same frames are searched in all.
    progress: called with stage, number done and total.
    Raises: InputError where a file cannot be read.
    """
    lengths = [open_video(s.path).n_frames for s in sources]
    numbers = None
    if together and len(sources) > 1:
        common = min(n - max(s.lag, 0) for s, n in zip(sources, lengths, strict=True))
        first = max(0, *(-s.lag for s in sources))
        if common <= first:
            raise InputError("The videos have no common frames at the given lags; check --lag.")
        numbers = evenly_spread(first, common, max_frames)
    chosen = [numbers or evenly_spread(0, n, max_frames) for n in lengths]
    total, done = sum(map(len, chosen)), itertools.count(1)

    def one(source: BoardFootage, frames: Sequence[int]) -> CameraViews:
        return _look(source, frames, board, lambda: progress("board", min(next(done), total), total))

    with ThreadPoolExecutor(2) as pool:
        return tuple(pool.map(one, sources, chosen))


def _look(source: BoardFootage, numbers: Sequence[int], board: Board, step: Callable[[], None]) -> CameraViews:
    """Search for the board in the pictures of one camera.

    source: board pictures of the camera.
    numbers: frames of the common time to search.
    step: called once per frame, for progress.
    """
    detect = make_detector(board)
    looks: dict[int, Look] = {}
    with open_video(source.path) as reader:
        # first the pictures that surely show the board; the search of the others is slow
        for quick, start, every in ((True, 0, 1), (False, 0, 2), (False, 1, 2)):
            if sum(k.sighting is not None and not k.reason for k in looks.values()) >= _ENOUGH_BOARDS:
                break
            for number in [n for n in numbers[start::every] if n not in looks]:
                image = np.asarray(cv2.cvtColor(reader.read(number + source.lag), cv2.COLOR_BGR2GRAY), dtype=np.uint8)
                if not quick or likely_shown(image, board):
                    looks[number] = _examine(image, detect)
                if quick:
                    step()
        size = reader.size
    return CameraViews(source.name, source.path, size, _with_reasons(looks), source.lag)


def _examine(gray: Gray, detect: Detector) -> Look:
    """Search for the board in one picture (h, w), and measure its sharpness and brightness.

    detect: detector of the board.
    """
    small = cv2.resize(gray, (640, max(1, round(640 * gray.shape[0] / gray.shape[1]))), interpolation=cv2.INTER_AREA)
    focus = float((cv2.Laplacian(small, cv2.CV_32F) ** 2).mean())
    sighting = detect(gray)
    reason = "blurred" if sighting is not None and sighting.edge_px > BLURRED_PX else ""
    return Look(sighting, reason, focus, float(small.mean()))


def _with_reasons(looks: Mapping[int, Look]) -> dict[int, Look]:
    """Add why the board was not found: dark, overexposed, more blurred than pictures with a board, or no board."""
    sharp = [k.focus for k in looks.values() if k.sighting is not None and not k.reason]
    usual, out = float(np.median(sharp)) if sharp else float("nan"), {}
    for number, k in sorted(looks.items()):
        tests = (
            (k.brightness < 25, "too dark"),
            (k.brightness > 230, "overexposed"),
            (k.focus < 0.5 * usual, "blurred"),
        )
        why = next((words for true, words in tests if true), "no board found")
        out[number] = replace(k, reason=why) if k.sighting is None else k
    return out


def diagnose(views: CameraViews, board: Board) -> str:
    """Explain why a camera saw no board at all.

    Tested are inverted colours, another number of corners, other markers and a mirrored picture.

    views: the results of the search in the camera's pictures.
    Returns: the explanation; empty where there is none.
    """
    grays = list(_spread_pictures(views.path, _TESTED))
    charuco, inverted = board.kind == "charuco", replace(board, inverted=not board.inverted)
    swapped, legacy = replace(board, columns=board.rows, rows=board.columns), replace(board, legacy=not board.legacy)
    others = (
        (inverted, _COLOURS[board.inverted]),
        (swapped, "the board is found with columns and rows exchanged"),
        (legacy, "the board is found with the legacy pattern switched"),
    )
    for other, words in others[: 3 if charuco else 1]:
        detect = make_detector(other)
        if any(detect(g) is not None for g in grays):
            return words
    for pictures, other, words in (
        (grays, board, "its markers were seen, but not its corners: check the numbers of columns and rows"),
        (grays, inverted, _COLOURS[board.inverted]),
        (
            [np.ascontiguousarray(g[:, ::-1]) for g in grays],
            board,
            "its markers are seen in the mirrored picture: the camera stores mirrored images; switch that off",
        ),
    ):
        if charuco and _markers_seen(pictures, other):
            return words
    seen = None if charuco else chessboard_seen(grays, board.size)
    if seen is not None and set(seen) == set(board.size):
        return "a board of this size was seen, but not well enough to measure it"
    for name in _DICTIONARIES if seen is None else ():
        if _markers_seen(grays, replace(board, dictionary=name, inverted=charuco and board.inverted)):
            another = f"markers of another dictionary, {name}, were seen"
            return another if charuco else f"markers of the dictionary {name} were seen: is it a ChArUco board?"
    seen = seen or chessboard_seen(grays, board.size)
    what = " without markers" if charuco else ""
    return f"a chessboard of {seen[0]} x {seen[1]} inner corners{what} was seen instead" if seen else ""


def chessboard_seen(grays: Sequence[Gray], about: tuple[int, int] = (9, 6)) -> tuple[int, int] | None:
    """Count the inner corners of the chessboard in most of the pictures, the larger number first; None without a
    chessboard.

    about: expected corners along x and y.
    """
    sizes = Counter[tuple[int, int]]()
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER | cv2.CALIB_CB_EXHAUSTIVE
    for gray in grays:
        best = (0, 0)
        for picture, _ in board_views(gray, about, 1000):
            found, _, meta = cv2.findChessboardCornersSBWithMeta(picture, (3, 3), flags)
            if found and meta is not None and meta.ndim >= 2:
                seen = (max(meta.shape[:2]), min(meta.shape[:2]))
                best = max(best, seen, key=lambda s: s[0] * s[1])
        if best[0] * best[1] > 9:  # a grid of 3 x 3 is found in many things
            sizes[best] += 1
    return max(sizes, key=lambda n: (sizes[n], n[0] * n[1])) if sizes else None


def _markers_seen(grays: Sequence[Gray], board: Board) -> bool:
    """Test whether one of the pictures shows at least four markers of the board's dictionary."""
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary)))
    found = (detector.detectMarkers(255 - gray if board.inverted else gray)[1] for gray in grays)
    return any(ids is not None and len(ids) >= 4 for ids in found)


# ---- counted corners -----------------------------------------------------------------------------------------------
# Identification of a chessboard: its corners are counted in the pictures, so that the user need not count them.


_PICTURES, _TESTED = 8, 6
"""Numbers of pictures per camera that are searched for a count, and for the reason why no board was found."""
_ENOUGH = 4
"""Number of pictures with the same number of corners after which no further camera is searched."""


def count_corners(sources: Sequence[BoardFootage]) -> tuple[int, int]:
    """Count the inner corners (columns, rows) of the chessboard in board videos or photos, the larger number first.

    Raises: CalibrationError where no count occurs twice.
    Why: a partly hidden or partly detected board shows fewer corners than it has, so the count of most pictures is
        used, and of equally frequent counts the larger.
    """
    votes = Counter[tuple[int, int]]()
    for source in sources:
        seen = [chessboard_seen([gray]) for gray in _spread_pictures(source.path, _PICTURES)]
        votes.update(size for size in seen if size is not None)
        if max(votes.values(), default=0) >= _ENOUGH:
            break
    found = max(votes, key=lambda n: (votes[n], n[0] * n[1]), default=None)
    if found is None or votes[found] < 2:
        raise CalibrationError(
            f"No chessboard was seen in the pictures of {', '.join(s.name for s in sources)}, so its corners could not "
            "be counted; say which board it is: --chessboard COLUMNSxROWS (inner corners) or --charuco (squares)."
        )
    return found


def _spread_pictures(path: Path, count: int) -> Iterator[Gray]:
    """Read `count` grey pictures, evenly spread over a video or folder of photos."""
    with open_video(path) as reader:
        for frame in evenly_spread(0, reader.n_frames, count):
            yield np.asarray(cv2.cvtColor(reader.read(frame), cv2.COLOR_BGR2GRAY), dtype=np.uint8)
