"""Recordings: the views of calibrated cameras with their files, read from recording.toml and checked.

A recording folder holds recording.toml, calibration.toml and the videos (or images, or masks). A Pose2Sim project or
trial folder can be used without recording.toml (`hypose.io.recordings.pose2sim`). The keys of recording.toml with
their defaults; paths are relative to its folder:

    name = "walk"                     # default: the folder's name
    calibration = "calibration.toml"  # of any program that hypose.io.calibrations reads
    calibration_unit = "auto"         # auto, m, cm or mm: unit of the calibration's translations
    world_up = "z"                    # axis of the calibration's world that points up: x y z -x -y -z
    frame_rate = 60.0                 # frames/s; default: what the videos, or the files of key points, say
    frame_range = [0, 100]            # first frame and the one after the last, from 0; default: all
    keypoint_set = "BODY_25"          # order of the 2D key points; default: detected
    keypoint_lag = 0                  # key points of frame t belong to video frame t + keypoint_lag
    keypoint_pixels = "calibration"   # key points are pixels of the calibrated size, or of the stored "image"
    subject_height = 1.75             # m; default: estimated
    subject_mass = 70.0               # kg; default: unknown

    [[view]]                          # one per camera, in any order
    name = "cam01"
    camera = "cam_01"                 # its name in the calibration; default: by name, else by order
    video = "videos/cam01.mp4"        # a video file, or
    images = "images/cam01"           # a folder of images in natural order
    masks = "masks/cam01"             # silhouettes of another program: folder of images or video; needs no video.
                                      # Of several objects: see hypose.io.recordings.object_masks
    depth = "depth/cam01"             # of a depth camera, in place of pictures: a folder of 16-bit PNG in millimetres,
                                      # 0 = hole. The background is then such a folder of the empty room; without
                                      # it, the person must stand on the floor (z = 0)
    background = "background/cam01"   # an image, a folder of images or a video of the empty scene
    keypoints = "pose/cam01_json"     # file or folder of hypose.io.keypoints.read_keypoints; needs no video
    board = "board/cam01.mp4"         # a video or folder of photos of a calibration board, from which the studio's
                                      # Calibrate makes the calibration; tracking does not need it
    image_shift = [0.0, 0.0]          # px to add to this view's image coordinates (after scaling to the
                                      # calibrated size) so that they agree with calibration and key points
    accept_scaled = false             # images of another shape (width : height) than calibrated were
                                      # stretched, not cut

    [[person]]                        # one per person, if there are several (hypose track --people)
    name = "anna"
    height = 1.68                     # m; default: estimated
    body = "bodies/anna"              # their own body, as hypose subject wrote it; default: fitted
    place = [0.4, -1.2]               # m: where they stand on the floor (x, y), z up, at
    time = 0.0                        # s from the first frame of the recording

    [silhouettes]                     # how masks are made (hypose.evidence.silhouettes.SilhouetteSettings)
    threshold = 4.0                   # and the other options; default: the usual ones

Images of another size but of the calibrated shape (within 1 %) are assumed to be scaled; a note says so. Videos are
assumed to be synchronous: frame t of one belongs to frame t of the others.
"""

from __future__ import annotations

import difflib
import os
import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import CalibrationError, InputError, refuse
from hypose.evidence.keypoints import keypoint_names
from hypose.evidence.silhouettes import SilhouetteSettings
from hypose.geometry import rotation_between, se3
from hypose.io.calibrations.calibration_formats import find_calibration, read_any, write_calibration
from hypose.io.calibrations.camera_tables import UNITS
from hypose.io.files import file_name, match_names, read_toml, text_of, toml_text, write_text
from hypose.io.keypoints.read_keypoints import ViewKeypoints, check_keypoints, keypoints_of_views, with_detected
from hypose.io.recordings import pose2sim
from hypose.io.recordings.recording_views import (
    ViewSettings,
    check_background,
    check_picture_size,
    common_frames,
    look_together,
    on_one_clock,
    stored_numbers,
)
from hypose.io.videos.video import VIDEO_ENDINGS, frame_size

# ---- keys of recording.toml -----------------------------------------------------------------------------------------


Check = tuple[Callable[[Any], bool], str]
"""Test of the value of a key, and the allowed values in words."""


def _number(low: float, high: float, unit: str) -> Check:
    return lambda v: type(v) in (int, float) and low <= v <= high, f"a number of {unit} ({low:g} to {high:g})"


def _numbers(count: int, kind: str, *types: type) -> Check:
    def fits(value: Any) -> bool:
        return isinstance(value, list) and len(value) == count and all(type(v) in types and abs(v) < 1e9 for v in value)

    return fits, f"{count} {kind} in [ ]"


def _word(*words: str) -> Check:
    return lambda value: value in words, ", ".join(words)


_TEXT: Check = (lambda value: isinstance(value, str), "text in quotes")
_WHOLE: Check = (lambda value: type(value) is int and abs(value) < 1e9, "a whole number")
_FLAG: Check = (lambda value: isinstance(value, bool), "true or false")
_TABLE: Check = (lambda value: isinstance(value, dict), "a table, as [silhouettes]")
_LIST: Check = (lambda value: isinstance(value, list), "a list in [ ]")
_PAIR = _numbers(2, "numbers", int, float)
_METRES = _number(0.4, 2.8, "metres")
_UP = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "-x": (-1, 0, 0), "-y": (0, -1, 0), "-z": (0, 0, -1)}
RECORDING_KEYS: dict[str, Check] = {
    "name": _TEXT,
    "calibration": _TEXT,
    "calibration_unit": _word("auto", *UNITS),
    "world_up": _word(*_UP),
    "frame_rate": _number(0.1, 10_000, "frames per second"),
    "frame_range": _numbers(2, "whole numbers", int),
    "keypoint_set": _TEXT,
    "keypoint_lag": _WHOLE,
    "keypoint_pixels": _word("calibration", "image"),
    "subject_height": _METRES,
    "subject_mass": _number(2, 400, "kilograms"),
    "view": _LIST,
    "left_out": _LIST,
    "person": _LIST,
    "silhouettes": _TABLE,
    "track": _TABLE,
}
PATH_KEYS = ("video", "images", "masks", "background", "keypoints", "depth")
VIEW_KEYS: dict[str, Check] = {
    "name": _TEXT,
    "camera": _TEXT,
    **dict.fromkeys(PATH_KEYS, _TEXT),
    "board": _TEXT,
    "image_shift": _PAIR,
    "accept_scaled": _FLAG,
}
PERSON_KEYS: dict[str, Check] = {
    "name": _TEXT,
    "height": _METRES,
    "body": _TEXT,
    "place": _PAIR,
    "time": _number(0, 1e9, "seconds from the first frame"),
}
_REAL: Check = (lambda value: type(value) in (int, float) and abs(value) < 1e9, "a number")
CHECKS: dict[type, Check] = {str: _TEXT, int: _WHOLE, bool: _FLAG, float: _REAL, tuple: _PAIR}
"""Check of a value by its type."""
SILHOUETTE_KEYS = {f.name: CHECKS[type(f.default)] for f in fields(SilhouetteSettings)}


def check_keys(where: str, table: Mapping[str, Any], known: Mapping[str, Check]) -> None:
    """Check the keys of a table and their values.

    where: file and table, for the error message.
    known: the allowed keys, and the test of each.
    Raises: InputError where a key is unknown (the most similar known key is named) or its value is not allowed.
    """
    for key, value in table.items():
        if key not in known:
            near = difflib.get_close_matches(key, known, 1, 0.5)
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
            raise InputError(f"{where}: the key {key} is unknown ({hint}); correct or remove it.")
        fits, wanted = known[key]
        if not fits(value):
            raise InputError(f"{where}: {key} must be {wanted}, got {value!r}; correct it.")


def silhouette_options(where: str, table: Mapping[str, Any]) -> SilhouetteSettings:
    """Convert a [silhouettes] table to settings; absent keys keep their defaults.

    Raises: InputError where a key is unknown or a value is out of range.
    """
    check_keys(f"{where}, silhouettes", table, SILHOUETTE_KEYS)
    values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in table.items()}
    try:
        return SilhouetteSettings(**values)
    except InputError as error:
        raise InputError(f"{where}, silhouettes: {error}") from None


# ---- person tables -------------------------------------------------------------------------------------------------
# The [[person]] tables of recording.toml: known data of the people in a recording.


_NAME = re.compile(r"[\w][\w .-]{0,59}")
# Pattern of names that look like a file's, such as those of the results of all people in neighbouring folders.
_FILE = re.compile(r".*\.[a-z0-9]{2,5}")


@dataclass(frozen=True)
class PersonSettings:
    """Known data of one person of a recording, from a [[person]] table.

    name: name of the person and of the folder of their results.
    height: stature, m; None: not known.
    body: path of the person's own body, as `hypose subject` writes it.
    place: (x, y) on the floor, m, at `time`.
    time: s from the first frame.
    """

    name: str
    height: float | None = None
    body: Path | None = None
    place: tuple[float, float] | None = None
    time: float = 0.0


def people_of_tables(folder: Path, where: str, tables: Any) -> tuple[PersonSettings, ...]:
    """Convert the [[person]] tables to settings.

    folder: folder of the recording, for relative paths.
    where: file, for the error messages.
    Raises: InputError where a table is not valid or names are too similar.
    """
    found = [_person(folder, where, table, k) for k, table in enumerate(tables)]
    names = [p.name for p in found]
    # what every file system and every C3D file keeps of a name
    kept = {re.sub(r"[ .-]+", "-", unicodedata.normalize("NFKC", n).casefold()) for n in names}
    if len(kept) < len(names):
        raise InputError(
            f"{where}: the names of people must differ, got {', '.join(names)}, by more than capitals, spaces, dots "
            "and hyphens, which not all systems and files tell apart; rename one."
        )
    return tuple(found)


def _person(folder: Path, where: str, table: Any, index: int) -> PersonSettings:
    if not isinstance(table, Mapping):
        raise InputError(
            f"{where}: person must be [[person]] tables, got {table!r}; write [[person]] before each person."
        )
    name = table.get("name", f"person-{index + 1}")
    here = f"{where}, person {name}"
    check_keys(here, table, PERSON_KEYS)
    plain = _NAME.fullmatch(name) and file_name(name) == name and not _FILE.fullmatch(name)
    if not plain or name in ("all",) or name.strip(" .") != name or name.isdigit():
        raise InputError(
            f"{here}: the name must begin with a letter and may have letters, digits, spaces, dots and hyphens, since "
            "it names a folder, and must not be that of a file (report.html); change it."
        )
    body = folder / table["body"] if "body" in table else None
    place = tuple(table["place"]) if "place" in table else None
    return PersonSettings(name, table.get("height"), body, place, table.get("time", 0.0))


@dataclass(frozen=True)
class Recording:
    """A checked recording: cameras, views and settings.

    folder: folder of the recording, where relative paths start.
    rig: cameras in the order of `views`; world in metres, z up.
    views: settings of each camera's view.
    frame_rate: frames/s.
    frame_range: first frame, and the one after the last; None for all.
    keypoint_set: name of the key-point set; None where there are no key points.
    keypoint_lag: key points of frame t belong to video frame t + keypoint_lag.
    subject_height: m; None where it is not known.
    subject_mass: kg; None where it is not known.
    keypoint_pixels: "calibration" or "image": the size of picture whose pixels the key points use.
    n_frames: number of frames that every view has.
    calibration: path of the calibration file; None without one.
    silhouettes: settings of the masks.
    people: known data of several people.
    notes: sentences for the user about accepted irregularities.
    Raises: InputError where the numbers of cameras and views differ.
    """

    folder: Path
    name: str
    rig: CameraRig
    views: tuple[ViewSettings, ...]
    frame_rate: float
    frame_range: tuple[int, int] | None
    keypoint_set: str | None = "BODY_25"
    keypoint_lag: int = 0
    subject_height: float | None = None
    subject_mass: float | None = None
    keypoint_pixels: str = "calibration"
    n_frames: int = 0
    calibration: Path | None = None
    silhouettes: SilhouetteSettings = SilhouetteSettings()
    people: tuple[PersonSettings, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if len(self.rig) != len(self.views):
            raise InputError(
                f"Recording {self.name}: {len(self.rig)} cameras for {len(self.views)} views; give one each."
            )

    @property
    def frames(self) -> range:
        """The frames to process: frame_range, or all that every view has."""
        return range(*(self.frame_range or (0, self.n_frames)))

    @property
    def has_pictures(self) -> bool:
        """Whether any view has a video, images, depth maps or masks, not only key points."""
        return any(v.has_pictures for v in self.views)

    @property
    def depth_views(self) -> tuple[ViewSettings, ...]:
        """The views of depth cameras."""
        return tuple(v for v in self.views if "depth" in v.files)

    @property
    def detected(self) -> bool:
        """Whether masks and key points are those of hypose's own detector, which belong together."""
        files = [v.files for v in self.views]
        return all("masks" in f and f["masks"].parent == f.get("keypoints") for f in files)

    @property
    def inputs(self) -> dict[str, Path]:
        """All input files and folders by a descriptive name, for the provenance."""
        files = {f"{view.name}.{kind}": path for view in self.views for kind, path in view.files.items()}
        return files if self.calibration is None else {"calibration": self.calibration, **files}


def load_recording(path: str | Path, calibration: str | Path | None = None, *, uncalibrated: bool = False) -> Recording:
    """Load and check a recording folder, a recording.toml, or a Pose2Sim project or trial folder.

    calibration: a calibration file to use in place of the recording's own.
    uncalibrated: use no calibration; the cameras are those of `cameras_of_pictures`.
    Raises: InputError (CalibrationError for cameras) that names the file or camera, the allowed values and the next
        step.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path} does not exist; give a recording folder, its recording.toml, or a Pose2Sim project.")
    if path.is_file() and path.name.lower() == "config.toml":
        path = path.parent
    toml = path if path.is_file() else path / "recording.toml"
    if toml.suffix.lower() != ".toml":
        raise InputError(
            f"{path} is no recording; give a folder with recording.toml, that file, or a Pose2Sim project folder."
        )
    folder, notes = toml.parent, list[str]()
    settings = read_toml(toml) if toml.is_file() else {}
    if "calibration" not in settings and not (folder / "calibration.toml").exists() and pose2sim.is_project(folder):
        project, notes = pose2sim.read_project(folder)
        settings = pose2sim.with_overrides(project, settings, toml)
    elif not toml.is_file():
        _no_recording(folder)
    if calibration is not None:  # the unit that was stated belongs to the other file
        settings = {k: v for k, v in settings.items() if k != "calibration_unit"}
        settings["calibration"] = os.path.abspath(calibration)
    return _build(folder, toml if toml.is_file() else path, settings, notes, uncalibrated)


def _no_recording(folder: Path) -> NoReturn:
    """Raise the InputError for a folder without a recording, with what can be done with the files in it."""
    inside = [p.name for p in sorted(folder.iterdir()) if p.is_dir() and (p / "recording.toml").is_file()]
    hint = f"it holds the recordings {', '.join(inside)}: name one" if inside else "write recording.toml"
    if not inside and any(p.suffix.lower() in VIDEO_ENDINGS for p in (*folder.iterdir(), *folder.glob("*/*"))):
        hint = (
            f"it holds videos: hypose init {folder} writes recording.toml, and so does the page of hypose view {folder}"
        )
    raise InputError(
        f"The folder {folder} has no recording.toml and is no Pose2Sim project (Config.toml, videos); {hint}."
    )


def write_recording(recording: Recording, folder: str | Path) -> Path:
    """Write recording.toml and calibration.toml (metres, z up) to a folder.

    Paths inside the folder are written relative to it, others absolute. Videos are not copied.

    Returns: path of recording.toml.
    """
    folder = Path(folder)
    write_calibration(recording.rig, folder / "calibration.toml")
    has_keypoints = recording.keypoint_set is not None
    people = [
        {
            "name": person.name,
            "height": person.height,
            "body": None if person.body is None else _relative(person.body, folder),
            "place": person.place,
            "time": None if person.place is None else person.time,
        }
        for person in recording.people
    ]
    views = [
        {
            "name": view.name,
            "camera": camera.name,
            **{key: _relative(view.files[key], folder) for key in PATH_KEYS if key in view.files},
            "image_shift": [float(s) for s in view.image_shift] if any(view.image_shift) else None,
            "accept_scaled": view.accept_scaled or None,
        }
        for view, camera in zip(recording.views, recording.rig, strict=True)
    ]
    document = {
        "name": recording.name,
        "calibration": "calibration.toml",
        "calibration_unit": "m",
        "frame_rate": float(recording.frame_rate),
        "frame_range": recording.frame_range,
        "keypoint_set": recording.keypoint_set,
        "keypoint_lag": recording.keypoint_lag if has_keypoints else None,
        "keypoint_pixels": recording.keypoint_pixels if has_keypoints else None,
        "subject_height": recording.subject_height,
        "subject_mass": recording.subject_mass,
        "view": views,
        "person": people or None,
        "silhouettes": changed_settings(recording.silhouettes),
    }
    write_text(folder / "recording.toml", toml_text(document))
    return folder / "recording.toml"


def changed_settings(options: SilhouetteSettings) -> dict[str, Any] | None:
    """List the settings of the [silhouettes] table that are not the defaults; None where all are."""
    usual = asdict(SilhouetteSettings())
    return {k: v for k, v in asdict(options).items() if v != usual[k]} or None


def _relative(path: Path, folder: Path) -> str:
    full, base = Path(os.path.abspath(path)), Path(os.path.abspath(folder))
    return full.relative_to(base).as_posix() if full.is_relative_to(base) else full.as_posix()


# ---- checks ------------------------------------------------------------------------------------------------


def _build(folder: Path, origin: Path, settings: Mapping[str, Any], notes: list[str], uncalibrated: bool) -> Recording:
    """Build the recording from the settings of recording.toml after checking them and all files that they name.

    folder: folder of the recording, where relative paths start.
    origin: file or folder that the error messages name.
    settings: keys of recording.toml.
    notes: sentences so far, to which those about accepted irregularities are added.
    uncalibrated: make placeholder cameras, as `cameras_of_pictures`.
    Raises: InputError, CalibrationError for cameras.
    """
    where = str(origin)
    check_keys(where, settings, RECORDING_KEYS)
    settings = with_detected(folder, settings, notes)
    tables = settings.get("view", [])
    if not tables:
        raise InputError(f"{where}: no views; add one [[view]] table per camera with name and video.")
    for i, table in enumerate(tables):
        if not isinstance(table, dict):
            raise InputError(
                f"{where}: view must be [[view]] tables, got {table!r}; write [[view]] before each camera."
            )
        check_keys(f"{where}, view {table.get('name', i + 1)}", table, VIEW_KEYS)
    views = [_view(folder, where, table, i) for i, table in enumerate(tables)]
    names = [v.name for v in views]
    if len(set(names)) < len(names):
        raise InputError(f"{where}: view names must differ, got {', '.join(names)}; rename one.")

    calibration: Path | None = None
    if uncalibrated:
        rig = cameras_of_pictures(where, views)
    else:
        calibration, rig = _calibration(folder, where, settings, notes)
        rig = _match_cameras(rig, calibration, views, [t.get("camera") for t in tables], notes)

    views, clips = look_together(views, notes)
    for view, camera, found in zip(views, rig, clips, strict=True):
        for clip in found:
            check_picture_size(view, camera, clip.path, clip.size, notes)
        if "background" in view.files:
            check_background(view, camera, found[0].size if found else None)
    pixels = settings.get("keypoint_pixels", "calibration")
    lag = settings.get("keypoint_lag", 0)
    stored = [found[0].size if found and view.source else None for view, found in zip(views, clips, strict=True)]
    blind = [v.name for v in views if "keypoints" in v.files and v.source is None]
    if pixels == "image" and blind:
        raise InputError(
            f"{where}: keypoint_pixels is image, but {', '.join(blind)} has no pictures that would say how large they "
            "are; give the videos, or key points in pixels of the calibration."
        )
    stored = stored if pixels == "image" else [None] * len(views)
    paths = [v.files.get("keypoints") for v in views]
    keypoint_set = settings.get("keypoint_set") if any(paths) else None
    if keypoint_set is not None:
        keypoint_names(keypoint_set)  # an unknown name is refused before the files are read
    keypoints, said = keypoints_of_views(paths, names, rig.names, keypoint_set)
    notes += said
    if any(paths):
        keypoint_set = next((k.keypoint_set for k in keypoints if k is not None), keypoint_set or "BODY_25")
    reported = next((k.table.frame_rate for k in keypoints if k is not None and k.table.frame_rate is not None), None)
    views, frame_rate = on_one_clock(where, settings.get("frame_rate"), views, clips, reported, notes)
    keypoints = _by_stored_frames(keypoints, views)
    if any(clips):
        n_frames = common_frames(views, clips, notes)
    else:
        n_frames = max((k.last + 1 + lag for k in keypoints if k is not None), default=0)
    if n_frames < 1:
        raise InputError(f"{where}: there are no pictures, and the key points show no person; detect them again.")
    check_keypoints(keypoints, names, rig, range(-lag, n_frames - lag), stored)
    frame_range = None
    if "frame_range" in settings:
        first, stop = settings["frame_range"]
        if not 0 <= first < stop <= n_frames:
            raise InputError(
                f"{where}: frame_range = [{first}, {stop}] lies outside the recording, which has the frames "
                f"0 to {n_frames - 1}; give the first frame and the one after the last, at most [0, "
                f"{n_frames}]."
            )
        frame_range = (first, stop)
    return Recording(
        folder=folder,
        name=settings.get("name", text_of(folder.resolve().name)),
        rig=rig,
        views=tuple(views),
        frame_rate=frame_rate,
        frame_range=frame_range,
        keypoint_set=keypoint_set,
        keypoint_lag=lag,
        subject_height=settings.get("subject_height"),
        subject_mass=settings.get("subject_mass"),
        keypoint_pixels=pixels,
        n_frames=n_frames,
        calibration=calibration,
        silhouettes=silhouette_options(where, settings.get("silhouettes", {})),
        people=people_of_tables(folder, where, settings.get("person", ())),
        notes=tuple(notes),
    )


def keypoints_of_recording(recording: Recording) -> list[ViewKeypoints | None]:
    """Load the key points of a recording's views; None for a view that has none.

    Raises: InputError where a file cannot be used.
    """
    views = recording.views
    paths, names = [v.files.get("keypoints") for v in views], [v.name for v in views]
    return _by_stored_frames(keypoints_of_views(paths, names, recording.rig.names, recording.keypoint_set)[0], views)


def _by_stored_frames(
    keypoints: Sequence[ViewKeypoints | None], views: Sequence[ViewSettings]
) -> list[ViewKeypoints | None]:
    """Number key points of other programs by the stored frames of the video.

    keypoints: key points of each view; None where it has none.
    views: views, whose videos may be read by their time stamps.
    """
    return [
        k if k is None or k.table.timed else replace(k, frames=stored_numbers(v))
        for k, v in zip(keypoints, views, strict=True)
    ]


def stored_sizes(recording: Recording) -> list[tuple[int, int] | None]:
    """List the size (width, height) of each view's stored pictures, where key points are in their pixels; None
    otherwise.
    """
    if recording.keypoint_pixels != "image":
        return [None] * len(recording.views)
    return [None if v.source is None else frame_size(v.source) for v in recording.views]


def _named(folder: Path, where: str, key: str, name: str) -> Path:
    """Resolve the path that a setting gives; InputError where no file system can have it."""
    try:
        path = folder / Path(name).expanduser()
        path.exists()
    except (OSError, RuntimeError) as problem:  # a name that is too long; a user (~name) who is not known
        shown = name if len(name) <= 60 else f"{name[:60]}..."
        reason = getattr(problem, "strerror", None) or str(problem).rstrip(".")
        raise InputError(f"{where}: the {key} {shown} is no path ({reason}); correct it.") from None
    return path


def _view(folder: Path, where: str, table: Mapping[str, Any], index: int) -> ViewSettings:
    """Convert a [[view]] table to settings.

    folder: folder of the recording, for relative paths.
    where: file, for the error messages.
    index: number of the view from 0, which names it where the table does not.
    Raises: InputError where a path does not exist or paths contradict each other.
    """
    name = table.get("name") or f"view{index + 1}"
    where = f"{where}, view {name}"
    paths: dict[str, Path] = {}
    for key in PATH_KEYS:
        if key not in table:
            continue
        path = _named(folder, where, key, table[key])
        if not path.exists():
            raise InputError(f"{where}: the {key} {path} does not exist; correct the path or copy the file there.")
        if key in ("images", "depth") and not path.is_dir() or key == "video" and not path.is_file():
            wanted = "a file" if key == "video" else "a folder"
            raise InputError(f"{where}: {key} must be {wanted}, {path} is not; correct the path.")
        paths[key] = path
    others = sorted(paths.keys() & {"video", "images", "masks"}) if "depth" in paths else []
    faults = {
        "video and images are both given; keep the one to use": {"video", "images"} <= paths.keys(),
        f"depth and {', '.join(others)} are both given; a depth camera is a view of its own, with its own camera in "
        "the calibration": others,
        "neither video, images, depth, masks nor keypoints are given; add one of them, or remove the view": (
            not paths.keys() & {"video", "images", "masks", "keypoints", "depth"}
        ),
    }
    refuse(f"{where}: ", faults)
    shift = tuple(table.get("image_shift", (0.0, 0.0)))
    return ViewSettings(name, paths, image_shift=shift, accept_scaled=table.get("accept_scaled", False))


def _calibration(folder: Path, where: str, settings: Mapping[str, Any], notes: list[str]) -> tuple[Path, CameraRig]:
    """Read the calibration that the settings name, or the one in the folder, and turn its world so that z points up.

    folder, where, settings, notes: as in `_build`.
    Returns: path of the calibration, and its cameras.
    Raises: CalibrationError where there is none or it cannot be used.
    """
    if "calibration" in settings:
        path: Path | None = _named(folder, where, "calibration", settings["calibration"])
    else:
        path = find_calibration(folder / "calibration") if not (folder / "calibration.toml").is_file() else None
        path = path or folder / "calibration.toml"
    if not path.is_file():
        raise CalibrationError(
            f"{where}: there is no calibration ({path} does not exist); run hypose calibrate, or name the "
            "file with "
            'calibration = "...".'
        )
    rig, found = read_any(path, settings.get("calibration_unit", "auto"))
    notes += found
    up = settings.get("world_up", "z")
    if up != "z":
        turn = se3(rotation_between(_UP[up], _UP["z"]).T, np.zeros(3))
        rig = CameraRig(tuple(replace(c, camera_from_world=c.camera_from_world @ turn) for c in rig))
        notes.append(f"The world is turned so that the calibration's {up} axis points up (z).")
    return path, rig


def cameras_of_pictures(where: str, views: Sequence[ViewSettings]) -> CameraRig:
    """Make placeholder cameras from the size of each view's pictures, for a recording without calibration.

    The focal length is the longer image side, and all cameras are at the same place.

    Raises: InputError where a view has no pictures.
    """
    cameras = []
    for view in views:
        path = view.source or view.files.get("masks")
        if path is None:
            raise InputError(
                f"{where}, view {view.name}: it has no pictures, so their size is not known; give its video, or the "
                "cameras' lenses with --intrinsics FILE."
            )
        (width, height), focal = frame_size(path), max(frame_size(path))
        k = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
        cameras.append(Camera(view.name, k, np.zeros(5), np.eye(4), (width, height)))
    return CameraRig(tuple(cameras))


def _match_cameras(
    rig: CameraRig, path: Path, views: Sequence[ViewSettings], wanted: Sequence[str | None], notes: list[str]
) -> CameraRig:
    """Put the cameras of a rig into the order of the views.

    path: the calibration, for the error messages.
    wanted: for each view the name of its camera that recording.toml gives; None to match the names.
    notes: list to which sentences about the choice are added.
    Raises: CalibrationError where views and cameras cannot be matched.
    """
    names = [w or v.name for w, v in zip(wanted, views, strict=True)]
    if all(wanted) or (len(rig) > len(views) and all(name in rig.names for name in names)):
        chosen = rig.select(names)  # its error lists the existing cameras
        left = [n for n in rig.names if n not in chosen.names]
        if left:
            notes.append(f"The cameras {', '.join(left)} of {path.name} have no view and are left out.")
        return chosen
    if len(rig) != len(views):
        raise CalibrationError(
            f"{path} has {len(rig)} cameras ({', '.join(rig.names)}) but there are {len(views)} views "
            f"({', '.join(v.name for v in views)}); add the missing ones, or give every view its camera "
            '(camera = "...") in recording.toml.'
        )
    if unknown := [w for w in wanted if w and w not in rig.names]:
        rig.select(unknown)
    matched = match_names(names, rig.names)
    chosen = CameraRig(tuple(rig[i if m is None or None in matched else m] for i, m in enumerate(matched)))
    pairs = ", ".join(f"{v.name} = {c}" for v, c in zip(views, chosen.names, strict=True))
    if None in matched:
        notes.append(
            "The names of views and cameras do not tell which belong together, so they are taken in their "
            f'order: {pairs}; if that is wrong, give each view its camera = "..." in recording.toml.'
        )
    elif list(chosen.names) != names:
        notes.append(f"Views and cameras are matched by their names: {pairs}.")
    return chosen
