"""Calibration from board videos or photos: a rig of cameras in a world with a floor, and notes for the user."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.calibration.board_fit import FOCAL_SD, CalibratedLens, board_poses, calibrate_lens
from hypose.calibration.boards import Board
from hypose.calibration.refine_points import transform_rig
from hypose.calibration.rig import PoseComparison, RigCalibration, calibrate_rig
from hypose.calibration.views import BoardFootage, BoardProgress, CameraViews, diagnose, look_for_board
from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import CalibrationError
from hypose.geometry import Array, Image, frame_of, se3, se3_inverse, so3_log, transform, unit
from hypose.io.videos.video import open_video

# ---- surroundings --------------------------------------------------------------------------------------------------
# The orientation of a still board that looks the same when turned by 180 degrees, in two cameras: seen from above,
# the floor around it must look the same in both pictures (what stands on the floor does not, but seldom says the
# opposite).


_REACH = 4.0  # board lengths around its middle
_CELLS = 320
_MIN_SHARE = 0.06  # of the square: less common floor is not enough
_LEAST_RISE = 0.12  # sine of the lowest viewing angle: below, the floor is too blurred


def floor_likelihood(
    images: Mapping[int, Image],
    cameras: Sequence[Camera],
    camera_from_board: Mapping[int, Array],
    board: Board,
    c: int,
    d: int,
    d_from_c: Array,
    other: Array,
) -> float:
    """Compare two relative poses of cameras c and d by the appearance of the floor around the board.

    images: pictures BGR (h, w, 3) by camera index, with the board lying still.
    camera_from_board: (4, 4) pose of the board by camera index.
    d_from_c, other: (4, 4) the two relative poses.
    Returns: how many times better the floor agrees under d_from_c than under `other`: quotient of the unexplained
        shares 1 - correlation; 1 where the floor cannot be compared.
    """
    base = camera_from_board[c]
    one = _from_above(images[c], replace(cameras[c], camera_from_world=base), board)
    turned = (replace(cameras[d], camera_from_world=motion @ base) for motion in (d_from_c, other))
    scores = np.array([_correlation(one, _from_above(images[d], camera, board)) for camera in turned])
    return float((1 - scores[1]) / max(1 - scores[0], 1e-6)) if np.isfinite(scores).all() else 1.0


def _from_above(image: Image, camera: Camera, board: Board) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Rectify the floor around the board to a view from above.

    camera: in the board's frame.
    Returns: picture (n, n, 3), and mask (n, n) of the floor that is seen well.
    """
    low, high = board.points.min(0), board.points.max(0)
    middle, length = 0.5 * (low + high), float((high - low).max())
    line = np.linspace(-_REACH * length, _REACH * length, _CELLS)
    x, y = np.meshgrid(line + middle[0], line + middle[1])
    points = np.stack([x, y, np.zeros_like(x)], -1)
    uv = camera.project(points)
    # a lens model is meaningless far outside the picture: only points whose pinhole image is near count
    plain = camera.project_pinhole(points)
    size = np.array(camera.size)
    with np.errstate(invalid="ignore"):
        seen = ((uv > 1) & (uv < size - 2) & (plain > -0.5 * size) & (plain < 1.5 * size)).all(-1)
    towards = camera.position - points
    seen &= np.abs(towards[..., 2]) / np.linalg.norm(towards, axis=-1) > _LEAST_RISE
    margin = 1.5 * board.square
    seen &= ~(((points[..., :2] > low[:2] - margin) & (points[..., :2] < high[:2] + margin)).all(-1))
    map_x, map_y = (np.where(seen, uv[..., i], 0).astype(np.float32) for i in (0, 1))
    return cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR).astype(np.float32), seen


def _correlation(
    one: tuple[NDArray[np.float32], NDArray[np.bool_]], two: tuple[NDArray[np.float32], NDArray[np.bool_]]
) -> float:
    """Compute the mean correlation of colours over the common floor.

    one, two: pictures from above (n, n, 3) with masks (n, n) of the floor that is seen well.
    Returns: -1 to 1; NaN where too little is common.
    Why: each colour is relative to its surroundings, so that shading has no effect.
    """
    mask = one[1] & two[1]
    if mask.mean() < _MIN_SHARE:
        return float("nan")
    weight = mask.astype(np.float32)[..., None]
    spread = np.maximum(cv2.GaussianBlur(weight, (0, 0), 24), 1e-3)[..., None]
    smooth = (cv2.GaussianBlur(image, (0, 0), 2.5) for image in (one[0], two[0]))
    a, b = ((s - cv2.GaussianBlur(s * weight, (0, 0), 24) / spread)[mask] for s in smooth)
    a, b = a - a.mean(0), b - b.mean(0)
    norm = np.sqrt((a**2).sum() * (b**2).sum())
    return float((a * b).sum() / norm) if norm > 1e-6 else float("nan")


# ---- floor ---------------------------------------------------------------------------------------------------------
# The world of a calibrated rig: z up, the floor at z = 0, from a board that lay on the floor.


_FLAT = np.deg2rad(30.0)  # a board tilted by more against the cameras' common up does not lie on the floor
_STILL_M, _STILL_RAD = 0.01, np.deg2rad(1.0)
_STILL_FRAMES = 3


def floor_frame(
    rig: CameraRig, boards: Mapping[int, Array], board: Board, wanted: int | None
) -> tuple[int | None, str]:
    """Choose the frame in which the board lies on the floor: the middle of the longest time in which it does not move
    and is level, judged by the cameras' common up direction.

    boards: world_from_board (4, 4) by frame.
    wanted: frame chosen by the user; the nearest frame with a board is used.
    Returns: the frame, None where there is none, and a sentence about the choice.
    Raises: CalibrationError where no board is near the wanted frame.
    """
    frames = sorted(boards)
    if wanted is not None:
        near = min(frames, key=lambda f: abs(f - wanted))
        if abs(near - wanted) > 50:
            raise CalibrationError(
                f"No board was found near frame {wanted} (the nearest is frame {near}); give --floor a frame in which "
                "the board lies on the floor and is seen."
            )
        return near, f"The floor is where the board lies in frame {near}."
    if len(frames) == 1:
        return frames[0], "The floor is where the board lies."
    up = _common_up(rig)
    middle = board.points.mean(0)
    best: list[int] = []
    run: list[int] = []
    for f in frames:
        motion = np.eye(4) if not run else se3_inverse(boards[run[0]]) @ boards[f]
        moved = np.linalg.norm(transform(motion, middle[None]) - middle)  # the same in the board's frame
        if moved > _STILL_M or np.linalg.norm(so3_log(motion[:3, :3])) > _STILL_RAD:
            run = []
        run = [*run, f] if float(-boards[f][:3, 2] @ up) > np.cos(_FLAT) else []
        best = max(best, run, key=len)
    if len(best) >= min(_STILL_FRAMES, len(frames)):
        return best[len(best) // 2], (
            f"The floor is where the board lies still in frames {best[0]} to {best[-1]}; if it lay on something else, "
            "give --floor FRAME."
        )
    return None, (
        "No frame shows the board lying still, so the floor is not known: up is the mean of the cameras' upward "
        "directions, and z = 0 is where the board was lowest; lay the board on the floor for a moment and give --floor "
        "FRAME."
    )


def place_on_floor(
    rig: CameraRig, boards: Mapping[int, Array], board: Board, frame: int | None
) -> tuple[CameraRig, dict[int, Array]]:
    """Transform rig and boards to a world with z up.

    With a floor frame, the origin is the board's first corner and x its first row. Otherwise the origin is below the
    middle of all boards and x points to the right of the first camera.

    boards: world_from_board (4, 4) by frame.
    frame: frame in which the board lies on the floor; None where unknown.
    """
    if frame is not None:
        world_from_old = np.diag([1.0, -1.0, -1.0, 1.0]) @ se3_inverse(boards[frame])
    else:
        turn = frame_of(_common_up(rig), rig[0].camera_from_world[0, :3]).T[[1, 2, 0]]
        corners = np.concatenate([transform(b, board.points) for b in boards.values()]) @ turn.T
        world_from_old = se3(turn, -np.array([*corners[:, :2].mean(0), corners[:, 2].min()]))
    return transform_rig(rig, world_from_old), {f: world_from_old @ b for f, b in boards.items()}


def _common_up(rig: CameraRig) -> Array:
    """Estimate the common up direction (3,) of cameras: the direction most perpendicular to all cameras' x axes.

    Why: cameras are tilted but seldom rolled, so this excludes the part along their views that tilting adds.
    """
    right = np.stack([c.camera_from_world[0, :3] for c in rig])
    mean = -np.stack([c.camera_from_world[1, :3] for c in rig]).mean(0)
    _, s, vt = np.linalg.svd(right)
    up = vt[-1]
    if len(rig) < 2 or s[1] < 0.2 * s[0]:  # parallel x axes do not determine it
        up = mean
    return unit(up if up @ mean >= 0 else -up)


_GOOD_PX = 1.0  # rms above this is worth a warning
_TWO_SIDED = "a board printed on both sides, of which cameras see different ones (cover the back)"


@dataclass(frozen=True)
class CalibrateOptions:
    """Options of a calibration with boards.

    lenses: cameras whose K and distortion are known, by name; they are kept unless refine_lenses.
    refine_lenses: refine the known lenses.
    fisheye: all other lenses are fisheye lenses.
    floor: frame in which the board lies on the floor.
    max_frames: largest number of pictures per camera.
    progress: called with stage, number done and total.
    """

    lenses: CameraRig | None = None
    refine_lenses: bool = False
    fisheye: bool = False
    floor: int | None = None
    max_frames: int = 120
    progress: BoardProgress = field(default=lambda stage, done, total: None)


@dataclass(frozen=True)
class BoardCalibration:
    """The result of a calibration with boards.

    rig: calibrated cameras, world z up, m.
    views: detected boards of each camera.
    lens_views: detected boards in the lens pictures, if there are any.
    fit: result of the joint refinement.
    lenses: lens of each camera before the joint refinement.
    notes, warnings: sentences for the user.
    """

    rig: CameraRig
    views: tuple[CameraViews, ...]
    lens_views: tuple[CameraViews, ...]
    fit: RigCalibration
    lenses: tuple[CalibratedLens, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


class BoardsNotFound(CalibrationError):
    """Error that the board was not found, or not well enough, in some camera; `views` hold the detections for the
    contact sheet.
    """

    def __init__(self, message: str, views: tuple[CameraViews, ...]) -> None:
        super().__init__(message)
        self.views = views


def calibrate_from_boards(
    sources: Sequence[BoardFootage],
    board: Board,
    options: CalibrateOptions | None = None,
    lens_sources: Sequence[BoardFootage] | None = None,
) -> BoardCalibration:
    """Calibrate a rig from one board video or photo folder per camera, recorded at the same time.

    With a single source only its lens is calibrated, and the board on the floor gives its pose.

    sources: board pictures of each camera.
    options: the defaults where None.
    lens_sources: further board pictures per camera, by the same names, for the lens only.
    Raises: BoardsNotFound (a CalibrationError) with a description of each camera's pictures.
    """
    o = options or CalibrateOptions()
    lens_views: tuple[CameraViews, ...] = ()
    if lens_sources:
        lens_views = look_for_board(lens_sources, board, o.max_frames, False, o.progress)
        if {v.name for v in lens_views} ^ {s.name for s in sources}:
            raise CalibrationError(
                f"The lens pictures are of {', '.join(v.name for v in lens_views)}, the others of "
                f"{', '.join(s.name for s in sources)}; name the files or folders alike."
            )
        order = [s.name for s in sources]
        lens_views = tuple(sorted(lens_views, key=lambda v: order.index(v.name)))
    views = look_for_board(sources, board, o.max_frames, True, o.progress)
    both = (*lens_views, *views)
    _all_found(views, board, both)
    try:
        lenses = tuple(_lens(i, views, lens_views, board, o) for i in range(len(views)))
        o.progress("solve", 0, 2)
        choose = _chooser(views, lenses, board) if len(board.turns) > 1 else None
        fit = calibrate_rig(
            lenses,
            [v.sightings for v in views],
            board,
            choose,
            [v.sightings for v in lens_views] or None,
        )
        _determined(fit)
    except CalibrationError as error:
        raise BoardsNotFound(str(error), both) from None
    o.progress("solve", 1, 2)
    frame, said = floor_frame(fit.rig, fit.boards, board, o.floor)
    rig, boards = place_on_floor(fit.rig, fit.boards, board, frame)
    fit = replace(fit, rig=rig, boards=boards)
    o.progress("solve", 2, 2)
    warnings = _warnings(fit, lenses, lens_views or views)
    return BoardCalibration(rig, views, lens_views, fit, lenses, (*fit.notes, said), tuple(warnings))


def _all_found(views: Sequence[CameraViews], board: Board, all_views: tuple[CameraViews, ...]) -> None:
    """Check that every camera saw the board.

    views: results of the search in the pictures that place the cameras.
    all_views: these and the results in the lens pictures, for the contact sheet.
    Raises: BoardsNotFound where a camera saw none; the message says what was found instead.
    """
    found = {v.name: diagnose(v, board) for v in views if not v.sightings}
    if not found:
        return
    said = [v.summary() + (f"; {found[v.name]}" if found[v.name] else "") for v in views if v.name in found]
    said += [f"{v.name}: found in {len(v.sightings)} pictures" for v in views if v.sightings]
    advice = "check the pattern, light and focus, and that the whole board is in the picture"
    if any("instead" in why for why in found.values()):
        advice = "check the pattern size: count the corners where four squares meet, not the squares"
    raise BoardsNotFound(f"No {board} was found. {'. '.join(said)}. Next: {advice}.", all_views)


def _lens(
    i: int, views: Sequence[CameraViews], lens_views: Sequence[CameraViews], board: Board, o: CalibrateOptions
) -> CalibratedLens:
    """Take the lens of a camera from the given file, or calibrate it from its board pictures.

    i: index of the camera.
    views: results of the search for the rig.
    lens_views: results of the search in the lens pictures; empty where there are none.
    o: options.
    Returns: the lens, at the size of the rig's pictures.
    Raises: CalibrationError where the file has no such camera, or pictures have another shape.
    """
    view = views[i]
    if o.lenses is not None:
        names = set(o.lenses.names)
        by_order = len(names) == len(views) and not names & {v.name for v in views}
        # the error of `select` lists the existing cameras
        given = replace(o.lenses[i], name=view.name) if by_order else o.lenses.select([view.name])[0]
        camera = replace(_scaled(given, view, "the given lens"), camera_from_world=np.eye(4))
        errors = [board_poses(camera, s, board.points)[0][1] for s in view.sightings.values()]
        return CalibratedLens(camera, float(np.median(errors)), not o.refine_lenses)
    shown = lens_views[i] if lens_views else view
    lens = calibrate_lens(view.name, shown.sightings, board, shown.size, fisheye=o.fisheye)
    if shown.size == view.size:
        return lens
    return replace(lens, camera=_scaled(lens.camera, view, "those for its lens"), given=True)


def _scaled(lens: Camera, view: CameraViews, whose: str) -> Camera:
    """Adapt a lens to the size of a view's pictures; CalibrationError where they have another shape."""
    (w, h), (lens_w, lens_h) = view.size, lens.size
    if abs((w / h) / (lens_w / lens_h) - 1) > 0.01:
        raise CalibrationError(
            f"Camera {view.name}: its pictures are {w} x {h} px, {whose} {lens_w} x {lens_h} px; film both in the same "
            "mode."
        )
    return lens if view.size == lens.size else lens.scaled(view.size)


def _determined(fit: RigCalibration) -> None:
    for c, camera in enumerate(fit.rig):
        share = fit.focal_sd[c] / camera.K[0, 0]
        if np.isfinite(share) and share > FOCAL_SD:
            raise CalibrationError(
                f"Camera {camera.name}: its {len(fit.sightings[c])} boards leave its focal length uncertain by "
                f"{100 * share:.0f} %; film the board tilted by 30 to 45 degrees in several directions, or give a "
                "calibration file with --intrinsics."
            )


def _chooser(views: Sequence[CameraViews], lenses: Sequence[CalibratedLens], board: Board) -> PoseComparison:
    """Make the function that compares relative poses by the floor, in the first frame that both cameras saw.

    views: results of the search, with the boards of each camera.
    lenses: lens of each camera.
    """
    cameras = [n.camera for n in lenses]

    @cache
    def picture(c: int, frame: int) -> Image:
        with open_video(views[c].path) as reader:
            return np.asarray(reader.read(frame + views[c].lag), dtype=np.uint8)

    def choose(c: int, d: int, d_from_c: Array, other: Array) -> float:
        seen = {i: views[i].sightings for i in (c, d)}
        frame = next(f for f in seen[c] if f in seen[d])
        poses = {i: board_poses(cameras[i], s[frame], board.points)[0][0] for i, s in seen.items()}
        return floor_likelihood({i: picture(i, frame) for i in seen}, cameras, poses, board, c, d, d_from_c, other)

    return choose


def _warnings(fit: RigCalibration, lenses: Sequence[CalibratedLens], views: Sequence[CameraViews]) -> list[str]:
    """List sentences on what makes the result doubtful.

    fit: result of the joint refinement.
    lenses: lens of each camera before it.
    views: results of the search in the pictures that gave the lenses.
    """
    out = []
    names = fit.rig.names
    for c, name in enumerate(names):
        own, share, seen = lenses[c].rms_px, fit.focal_sd[c] / fit.rig[c].K[0, 0], views[c].coverage
        checks = (
            (
                fit.camera_rms[c] > _GOOD_PX,
                f"the boards fit only to {fit.camera_rms[c]:.2f} px; look for a bent board, blurred pictures, videos "
                f"that are not synchronous, or {_TWO_SIDED}",
            ),
            (
                lenses[c].given and own > 2 * _GOOD_PX,
                f"the given lens fits the boards only to {own:.2f} px; calibrate it again",
            ),
            (
                share > 0.01,
                f"its focal length is uncertain by {100 * share:.1f} %; film the board tilted and in all corners of "
                "the picture",
            ),
            (
                not lenses[c].given and seen < 0.4,
                f"the board covered {100 * seen:.0f} % of the picture; outside, the lens is a guess",
            ),
        )
        out += [f"{name}: {text}." for true, text in checks if true]
    for c, n in Counter(c for c, _ in fit.dropped).items():
        kept = len(fit.sightings[c])
        if n > 0.3 * (n + kept):
            out.append(
                f"{names[c]}: {n} of {n + kept} boards contradict the others and were left out; its video may not be "
                f"synchronous, the board bent, or {_TWO_SIDED}."
            )
    return out
