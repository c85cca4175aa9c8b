"""From board videos or photos to a calibrated rig in a world with a floor, with everything a user should see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hypose.calibration.boards import Board
from hypose.calibration.bundle import LensPrior
from hypose.calibration.floor import floor_frame, place_on_floor
from hypose.calibration.intrinsics import FOCAL_SD, Lens, board_poses, calibrate_lens
from hypose.calibration.lags import estimate_lags
from hypose.calibration.rig import Chooser, RigCalibration, RigSettings, calibrate_rig
from hypose.calibration.surroundings import Picture, floor_likelihood
from hypose.calibration.views import CameraViews, LookOptions, Progress, Source, diagnose, look_for_board
from hypose.cameras.camera import CameraRig
from hypose.errors import CalibrationError
from hypose.geometry import Array
from hypose.io.videos.video import open_video

_GOOD_PX = 1.0  # rms above this is worth a warning
_TWO_SIDED = "a board printed on both sides, of which cameras see different ones (cover the back)"


@dataclass(frozen=True)
class CalibrateOptions:
    """lenses: cameras whose K and distortion are known, by name, kept unless refine_lenses; fisheye: all other lenses;
    floor: frame in which the board lies on the floor; max_frames: pictures looked at per camera."""

    lenses: CameraRig | None = None
    refine_lenses: bool = False
    fisheye: bool = False
    floor: int | None = None
    max_frames: int = 120
    prior: LensPrior = field(default_factory=LensPrior)
    progress: Progress = field(default=lambda stage, done, total: None)


@dataclass(frozen=True)
class BoardCalibration:
    """rig: world z up, m. views: what each camera saw; lens_views: in the lens pictures, if there were any; fit: the
    joint refinement; lenses; notes and warnings: sentences."""

    rig: CameraRig
    views: tuple[CameraViews, ...]
    lens_views: tuple[CameraViews, ...]
    fit: RigCalibration
    lenses: tuple[Lens, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


class BoardsNotFound(CalibrationError):
    """The board was not found (well enough) in some camera; `views` hold what was seen, for the contact sheet."""

    def __init__(self, message: str, views: tuple[CameraViews, ...]) -> None:
        super().__init__(message)
        self.views = views


def calibrate_from_boards(
    sources: Sequence[Source],
    board: Board,
    options: CalibrateOptions | None = None,
    lens_sources: Sequence[Source] | None = None,
) -> BoardCalibration:
    """Rig from one board video (or photo folder) per camera, filmed at the same time.

    lens_sources: further board pictures per camera, by the same names, for the lens only. With a single source only
    its lens is calibrated and the board's place on the floor gives its pose. BoardsNotFound (a CalibrationError) says
    per camera what was seen instead."""
    o = options or CalibrateOptions()
    lens_views: tuple[CameraViews, ...] = ()
    if lens_sources:
        lens_views = look_for_board(lens_sources, board, LookOptions(o.max_frames, False, o.progress))
        unknown = {v.name for v in lens_views} ^ {s.name for s in sources}
        if unknown:
            raise CalibrationError(
                f"The lens pictures are of {', '.join(v.name for v in lens_views)}, the others of "
                f"{', '.join(s.name for s in sources)}; name the files or folders alike."
            )
        by_name = {v.name: v for v in lens_views}
        lens_views = tuple(by_name[s.name] for s in sources)
    views = look_for_board(sources, board, LookOptions(o.max_frames, True, o.progress))
    both = (*lens_views, *views)
    _all_found(views, board, both)
    lenses: tuple[Lens, ...] = ()
    try:
        lenses = tuple(_lens(i, views, lens_views, board, o) for i in range(len(views)))
        o.progress("solve", 0, 2)
        choose = _chooser(views, lenses, board) if len(board.turns) > 1 else None
        fit = calibrate_rig(
            lenses,
            [v.sightings for v in views],
            board,
            RigSettings(free_intrinsics=True, prior=o.prior, choose=choose),
            [v.sightings for v in lens_views] or None,
        )
        _determined(fit)
    except BoardsNotFound:
        raise
    except CalibrationError as error:
        late = _lag_hint(lenses, views, board)
        raise BoardsNotFound(f"{error}{' ' if late else ''}{late}", both) from None
    o.progress("solve", 1, 2)
    frame, said = floor_frame(fit.rig, fit.boards, board, o.floor, all(v.still for v in views))
    rig, boards = place_on_floor(fit.rig, fit.boards, board, frame)
    fit = replace(fit, rig=rig, boards=boards)
    o.progress("solve", 2, 2)
    notes = [*fit.notes, said] if said else list(fit.notes)
    warnings = _warnings(fit, lenses, lens_views or views)
    if warnings and (late := _lag_hint(lenses, views, board)):
        warnings.append(late)
    return BoardCalibration(rig, views, lens_views, fit, lenses, tuple(notes), tuple(warnings))


def _all_found(views: Sequence[CameraViews], board: Board, all_views: tuple[CameraViews, ...]) -> None:
    missing = [v for v in views if not v.sightings]
    if not missing:
        return
    said, other = [], False
    for v in missing:
        why = diagnose(v, board)
        other |= "instead" in why
        said.append(v.summary() + (f"; {why}" if why else ""))
    rest = [f"{v.name}: found in {len(v.sightings)} pictures" for v in views if v.sightings]
    advice = "check the pattern, light and focus, and that the whole board is in the picture"
    if other:
        advice = "check the pattern size: count the corners where four squares meet, not the squares"
    raise BoardsNotFound(f"No {board} was found. {'. '.join([*said, *rest])}. Next: {advice}.", all_views)


def _lens(
    i: int, views: Sequence[CameraViews], lens_views: Sequence[CameraViews], board: Board, o: CalibrateOptions
) -> Lens:
    view = views[i]
    if o.lenses is not None:
        given = o.lenses.select([view.name])[0] if view.name in o.lenses.names else None
        if given is None and len(o.lenses) == len(views) and not set(o.lenses.names) & {v.name for v in views}:
            given = replace(o.lenses[i], name=view.name)
        if given is None:
            o.lenses.select([view.name])  # its error lists the cameras there are
        assert given is not None
        if given.size != view.size:
            ratio = (view.size[0] / view.size[1]) / (given.size[0] / given.size[1])
            if abs(ratio - 1) > 0.01:
                raise CalibrationError(
                    f"Camera {view.name}: its pictures are {view.size[0]} x {view.size[1]} px, the given lens is "
                    f"calibrated for {given.size[0]} x {given.size[1]} px; give a lens calibrated at this size."
                )
            given = given.scaled(view.size)
        camera = replace(given, camera_from_world=np.eye(4))
        errors = [board_poses(camera, s, board.points)[0][1] for s in view.sightings.values()]
        return Lens(camera, (), float(np.median(errors)), float("nan"), not o.refine_lenses)
    seen = lens_views[i].sightings if lens_views else view.sightings
    size = lens_views[i].size if lens_views else view.size
    lens = calibrate_lens(view.name, seen, board, size, fisheye=o.fisheye, prior=o.prior, strict=False)
    if size != view.size:
        ratio = (view.size[0] / view.size[1]) / (size[0] / size[1])
        if abs(ratio - 1) > 0.01:
            raise CalibrationError(
                f"Camera {view.name}: the lens pictures are {size[0]} x {size[1]} px, the others {view.size[0]} x "
                f"{view.size[1]} px; film both in the same mode."
            )
        lens = replace(lens, camera=lens.camera.scaled(view.size), given=True)
    return lens


def _lag_hint(lenses: Sequence[Lens], views: Sequence[CameraViews], board: Board) -> str:
    """A sentence about videos that are clearly late, or ''."""
    if len(lenses) < len(views) or any(v.still for v in views):
        return ""
    lags = estimate_lags([n.camera for n in lenses], [v.sightings for v in views], board)
    if not lags:
        return ""
    said = " ".join(f"--lag {views[c].name}={views[c].lag + lag}" for c, lag in lags.items())
    return f"By the board's speed, videos are about this late: {said}; try that, or hypose sync."


def _determined(fit: RigCalibration) -> None:
    for c, camera in enumerate(fit.rig):
        share = fit.focal_sd[c] / camera.K[0, 0]
        if np.isfinite(share) and share > FOCAL_SD:
            raise CalibrationError(
                f"Camera {camera.name}: its {len(fit.sightings[c])} boards leave its focal length uncertain by "
                f"{100 * share:.0f} %; film the board tilted by 30 to 45 degrees in several directions, or give a "
                "calibration file with --intrinsics."
            )


def _chooser(views: Sequence[CameraViews], lenses: Sequence[Lens], board: Board) -> Chooser:
    """Compares the floor around a symmetric board, in the first frame that both cameras saw."""
    pictures: dict[tuple[int, int], Picture] = {}

    def picture(c: int, frame: int) -> Picture:
        if (c, frame) not in pictures:
            with open_video(views[c].path) as reader:
                pictures[c, frame] = np.asarray(reader.read(frame + views[c].lag), dtype=np.uint8)
        return pictures[c, frame]

    def choose(c: int, d: int, d_from_c: Array, other: Array) -> float:
        seen = [views[i].sightings for i in (c, d)]
        frame = next(f for f in seen[0] if f in seen[1])
        cameras = [n.camera for n in lenses]
        images = {i: picture(i, frame) for i in (c, d)}
        poses = {i: board_poses(cameras[i], s[frame], board.points)[0][0] for i, s in zip((c, d), seen, strict=True)}
        return floor_likelihood(images, cameras, poses, board, c, d, d_from_c, other)

    return choose


def _warnings(fit: RigCalibration, lenses: Sequence[Lens], views: Sequence[CameraViews]) -> list[str]:
    out = []
    names = fit.rig.names
    for c, name in enumerate(names):
        if fit.camera_rms[c] > _GOOD_PX:
            out.append(
                f"{name}: the boards fit only to {fit.camera_rms[c]:.2f} px; look for a bent board, blurred pictures, "
                f"videos that are not synchronous, or {_TWO_SIDED}."
            )
        own = lenses[c].rms_px
        if lenses[c].given and own > 2 * _GOOD_PX:
            out.append(f"{name}: the given lens fits the boards only to {own:.2f} px; calibrate it again.")
        if np.isfinite(fit.focal_sd[c]) and fit.focal_sd[c] > 0.01 * fit.rig[c].K[0, 0]:
            out.append(
                f"{name}: its focal length is uncertain by {100 * fit.focal_sd[c] / fit.rig[c].K[0, 0]:.1f} %; film "
                "the board tilted and in all corners of the picture."
            )
        if not lenses[c].given and views[c].coverage < 0.4:
            out.append(
                f"{name}: the board covered {100 * views[c].coverage:.0f} % of the picture; outside, the lens is a "
                "guess."
            )
    dropped: dict[int, int] = {}
    for c, _ in fit.dropped:
        dropped[c] = dropped.get(c, 0) + 1
    for c, n in dropped.items():
        kept = len(fit.sightings[c])
        if n > 0.3 * (n + kept):
            out.append(
                f"{names[c]}: {n} of {n + kept} boards contradict the others and were left out; its video may not be "
                f"synchronous, the board bent, or {_TWO_SIDED}."
            )
    return out
