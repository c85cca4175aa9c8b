"""Recordings: what was filmed, by which calibrated cameras; recording.toml and its checks.

A recording folder holds recording.toml, calibration.toml and the videos (or images, or masks). A Pose2Sim
project or trial folder is taken as it is (`hypose.io.recordings.pose2sim`). The keys of recording.toml are in
`hypose.io.recordings.recording_keys`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hypose.cameras.camera import CameraRig
from hypose.errors import CalibrationError, InputError
from hypose.evidence.keypoints import keypoint_names
from hypose.evidence.silhouettes import SilhouetteSettings
from hypose.geometry import rotation_between, se3
from hypose.io.calibrations.calibration_formats import read_any
from hypose.io.calibrations.calibration_toml import (
    UNITS,
    find_calibration,
    toml_value,
    write_calibration,
)
from hypose.io.file_names import text_of
from hypose.io.files import write_text
from hypose.io.keypoints.detected_keypoints import with_detected
from hypose.io.keypoints.read_keypoints import ViewKeypoints, check_keypoints, keypoints_of_views
from hypose.io.matching_names import match_names
from hypose.io.recordings import pose2sim
from hypose.io.recordings.person_tables import Person, people_of_tables
from hypose.io.recordings.recording_keys import (
    PATH_KEYS,
    RECORDING_KEYS,
    VIEW_KEYS,
    check_keys,
    choice,
    numbers,
    read_toml,
    silhouette_options,
)
from hypose.io.recordings.recording_views import (
    View,
    check_background,
    check_size,
    common_frames,
    frame_rate_of,
    look_together,
)
from hypose.io.videos.video import frame_size

_UP = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "-x": (-1, 0, 0), "-y": (0, -1, 0), "-z": (0, 0, -1)}


@dataclass(frozen=True)
class Recording:
    """A checked recording. rig: the cameras in the order of `views`, world in metres, z up. frame_rate:
    frames/s. frame_range: (first, stop) as given, None = all. n_frames: frames that every view has.
    keypoint_set None: there are no key points. subject_height m, subject_mass kg. people: what is known of several
    people. silhouettes: how masks are
    made. notes: sentences about accepted oddities, for the user."""

    folder: Path
    name: str
    rig: CameraRig
    views: tuple[View, ...]
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
    people: tuple[Person, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if len(self.rig) != len(self.views):
            raise InputError(
                f"Recording {self.name}: {len(self.rig)} cameras for {len(self.views)} views; give one each."
            )

    @property
    def frames(self) -> range:
        """The frames to work on: frame_range, or all that every view has."""
        return range(*(self.frame_range or (0, self.n_frames)))

    @property
    def has_pictures(self) -> bool:
        """Whether any view has a video, images or masks; else there are key points alone."""
        return any(v.source is not None or v.masks is not None for v in self.views)

    @property
    def detected(self) -> bool:
        """Whether masks and key points are those of hypose's own detector, which belong together."""
        return all(v.masks is not None and v.masks.parent == v.keypoints for v in self.views)

    @property
    def inputs(self) -> dict[str, Path]:
        """All input files and folders by a telling name, for the provenance."""
        out = {"calibration": self.calibration} if self.calibration else {}
        for view in self.views:
            out |= {f"{view.name}.{k}": p for k in PATH_KEYS if (p := getattr(view, k)) is not None}
        return out


def load_recording(path: str | Path, calibration: str | Path | None = None) -> Recording:
    """Load and check a recording folder, a recording.toml, or a Pose2Sim project or trial folder.

    calibration: a calibration file to use instead of the recording's own. An InputError (CalibrationError for the
    cameras) names the file or camera, what is allowed and the next step.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path} does not exist; give a recording folder, its recording.toml, or a Pose2Sim project.")
    if path.is_file() and path.name.lower() == "config.toml":
        path = path.parent
    if path.is_file():
        if path.suffix.lower() != ".toml":
            raise InputError(
                f"{path} is no recording; give a folder with recording.toml, that file, or a Pose2Sim project folder."
            )
        return _build(path.parent, path, _with_calibration(read_toml(path), calibration), [])
    toml = path / "recording.toml"
    if toml.is_file():
        given, notes = read_toml(toml), list[str]()
        if "calibration" not in given and not (path / "calibration.toml").exists() and pose2sim.is_project(path):
            project, notes = pose2sim.read_project(path)
            given = pose2sim.changed(project, given, toml)
        return _build(path, toml, _with_calibration(given, calibration), notes)
    if pose2sim.is_project(path):
        settings, notes = pose2sim.read_project(path)
        return _build(path, path, _with_calibration(settings, calibration), notes)
    inside = [p.name for p in sorted(path.iterdir()) if p.is_dir() and (p / "recording.toml").is_file()]
    hint = f"it holds the recordings {', '.join(inside)}: name one" if inside else "write recording.toml"
    raise InputError(
        f"The folder {path} has no recording.toml and is no Pose2Sim project (Config.toml, videos); {hint}."
    )


def _with_calibration(settings: Mapping[str, Any], path: str | Path | None) -> Mapping[str, Any]:
    if path is None:
        return settings
    # the unit that was stated belongs to the other file
    rest = {k: v for k, v in settings.items() if k != "calibration_unit"}
    return {**rest, "calibration": os.path.abspath(path)}


def write_recording(recording: Recording, folder: str | Path) -> Path:
    """Write recording.toml and calibration.toml (metres, z up) to a folder; returns the path of
    recording.toml.

    Paths inside the folder are written relative to it, others absolute. Videos are not copied.
    """
    folder = Path(folder)
    write_calibration(recording.rig, folder / "calibration.toml")
    lines = [
        f"name = {toml_value(recording.name)}",
        'calibration = "calibration.toml"',
        'calibration_unit = "m"',
    ]
    lines.append(f"frame_rate = {toml_value(float(recording.frame_rate))}")
    if recording.frame_range is not None:
        lines.append(f"frame_range = {toml_value([int(i) for i in recording.frame_range])}")
    if recording.keypoint_set is not None:
        lines += [
            f"keypoint_set = {toml_value(recording.keypoint_set)}",
            f"keypoint_lag = {toml_value(int(recording.keypoint_lag))}",
            f"keypoint_pixels = {toml_value(recording.keypoint_pixels)}",
        ]
    for key in ("subject_height", "subject_mass"):
        if getattr(recording, key) is not None:
            lines.append(f"{key} = {toml_value(float(getattr(recording, key)))}")
    for view, camera in zip(recording.views, recording.rig, strict=True):
        lines += ["", "[[view]]", f"name = {toml_value(view.name)}", f"camera = {toml_value(camera.name)}"]
        for key in PATH_KEYS:
            if (value := getattr(view, key)) is not None:
                lines.append(f"{key} = {toml_value(_relative(value, folder))}")
        if tuple(view.image_shift) != (0, 0):
            lines.append(f"image_shift = {toml_value([float(s) for s in view.image_shift])}")
        if view.accept_scaled:
            lines.append("accept_scaled = true")
    for person in recording.people:
        lines += ["", "[[person]]", f"name = {toml_value(person.name)}"]
        if person.height is not None:
            lines.append(f"height = {toml_value(float(person.height))}")
        if person.body is not None:
            lines.append(f"body = {toml_value(_relative(person.body, folder))}")
        if person.place is not None:
            lines.append(f"place = {toml_value([float(x) for x in person.place])}")
            lines.append(f"time = {toml_value(float(person.time))}")
    lines += silhouette_lines(recording.silhouettes)
    write_text(folder / "recording.toml", "\n".join(lines) + "\n")
    return folder / "recording.toml"


def silhouette_lines(options: SilhouetteSettings) -> list[str]:
    """The [silhouettes] table of a recording.toml; nothing when all is as usual."""
    usual = asdict(SilhouetteSettings())
    changed = {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(options).items() if v != usual[k]}
    return ["", "[silhouettes]", *(f"{k} = {toml_value(v)}" for k, v in changed.items())] if changed else []


def _relative(path: Path, folder: Path) -> str:
    full, base = Path(os.path.abspath(path)), Path(os.path.abspath(folder))
    return full.relative_to(base).as_posix() if full.is_relative_to(base) else full.as_posix()


# ---- checks ------------------------------------------------------------------------------------------------


def _build(folder: Path, origin: Path, settings: Mapping[str, Any], notes: list[str]) -> Recording:
    """The recording of a (translated) recording.toml; origin: the file or folder that errors name."""
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

    calibration, rig = _calibration(folder, where, settings, notes)
    rig = _match_cameras(rig, calibration, views, [t.get("camera") for t in tables], notes)

    views, clips = look_together(views, notes)
    for view, camera, found in zip(views, rig, clips, strict=True):
        for clip in found:
            check_size(view, camera, clip.path, clip.size, notes)
        if view.background is not None:
            check_background(view, camera, found[0].size if found else None)
    pixels = choice(where, "keypoint_pixels", settings.get("keypoint_pixels", "calibration"), ("calibration", "image"))
    lag = settings.get("keypoint_lag", 0)
    stored = [found[0].size if found and view.source else None for view, found in zip(views, clips, strict=True)]
    if pixels == "image" and (blind := [v.name for v, s in zip(views, stored, strict=True) if v.keypoints and not s]):
        raise InputError(
            f"{where}: keypoint_pixels is image, but {', '.join(blind)} has no pictures that would say how large they "
            "are; give the videos, or key points in pixels of the calibration."
        )
    stored = stored if pixels == "image" else [None] * len(views)
    keypoint_set, keypoints = _told_keypoints(where, settings, views, rig, notes)
    told = next((k.table.frame_rate for k in keypoints if k is not None and k.table.frame_rate is not None), None)
    frame_rate = frame_rate_of(where, settings.get("frame_rate"), views, clips, told, notes)
    if any(clips):
        n_frames = common_frames(views, clips, notes)
    else:
        n_frames = max((k.last + 1 + lag for k in keypoints if k is not None), default=0)
    if n_frames < 1:
        raise InputError(f"{where}: there are no pictures, and the key points show nobody; detect them again.")
    check_keypoints(keypoints, names, rig, range(-lag, n_frames - lag), stored)
    frame_range = None
    if "frame_range" in settings:
        first, stop = numbers(where, "frame_range", settings["frame_range"], 2, whole=True)
        if not 0 <= first < stop <= n_frames:
            raise InputError(
                f"{where}: frame_range = [{first}, {stop}] lies outside the recording, which has the frames "
                f"0 to {n_frames - 1}; give the first frame and the one after the last, at most [0, "
                f"{n_frames}]."
            )
        frame_range = (first, stop)
    for key, low, high, unit in (
        ("subject_height", 0.4, 2.8, "metres"),
        ("subject_mass", 2, 400, "kilograms"),
    ):
        if key in settings and not low <= settings[key] <= high:
            raise InputError(
                f"{where}: {key} = {settings[key]:g} is implausible; give it in {unit} ({low:g} to {high:g})."
            )
    return Recording(
        folder=folder,
        name=settings.get("name", text_of(folder.resolve().name)),
        rig=rig,
        views=tuple(views),
        frame_rate=frame_rate,
        frame_range=frame_range,
        keypoint_set=keypoint_set,
        keypoint_lag=lag,
        subject_height=_optional(settings.get("subject_height")),
        subject_mass=_optional(settings.get("subject_mass")),
        keypoint_pixels=pixels,
        n_frames=n_frames,
        calibration=calibration,
        silhouettes=silhouette_options(where, settings.get("silhouettes", {})),
        people=people_of_tables(folder, where, settings.get("person", ())),
        notes=tuple(notes),
    )


def keypoints_of_recording(recording: Recording) -> tuple[list[ViewKeypoints | None], list[str]]:
    """The key points of a recording's views, and sentences about them; an InputError names what cannot be used."""
    return keypoints_of_views(
        [v.keypoints for v in recording.views],
        [v.name for v in recording.views],
        recording.rig.names,
        recording.keypoint_set,
    )


def stored_sizes(recording: Recording) -> list[tuple[int, int] | None]:
    """The size of each view's stored pictures where its key points are in their pixels."""
    if recording.keypoint_pixels != "image":
        return [None] * len(recording.views)
    return [None if v.source is None else frame_size(v.source) for v in recording.views]


def _told_keypoints(
    where: str, settings: Mapping[str, Any], views: Sequence[View], rig: CameraRig, notes: list[str]
) -> tuple[str | None, list[ViewKeypoints | None]]:
    """The set of the key points, None without any, and those of every view."""
    stated = settings.get("keypoint_set")
    if all(v.keypoints is None for v in views):
        return None, [None] * len(views)
    if stated is not None:
        keypoint_names(stated)
    found, said = keypoints_of_views([v.keypoints for v in views], [v.name for v in views], rig.names, stated)
    notes += said
    kinds = [k.keypoint_set for k in found if k is not None]
    return (kinds[0] if kinds else stated or "BODY_25"), found


def _optional(value: float | None) -> float | None:
    return None if value is None else float(value)


def _named(folder: Path, where: str, key: str, name: str) -> Path:
    """The path that a setting names; an InputError where no file system can have it."""
    try:
        path = folder / Path(name).expanduser()
        path.exists()
    except (OSError, RuntimeError) as problem:  # a name that is too long; a user (~name) who is not known
        shown = name if len(name) <= 60 else f"{name[:60]}..."
        raise InputError(f"{where}: the {key} {shown} is no path ({_reason(problem)}); correct it.") from None
    return path


def _reason(problem: Exception) -> str:
    return problem.strerror if isinstance(problem, OSError) and problem.strerror else str(problem).rstrip(".")


def _view(folder: Path, where: str, table: Mapping[str, Any], index: int) -> View:
    name = table.get("name") or f"view{index + 1}"
    where = f"{where}, view {name}"
    paths: dict[str, Any] = {}
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
    if "video" in paths and "images" in paths:
        raise InputError(f"{where}: video and images are both given; keep the one to use.")
    if "depth" in paths and (others := sorted(paths.keys() & {"video", "images", "masks"})):
        raise InputError(
            f"{where}: depth and {', '.join(others)} are both given; a depth "
            "camera is a view of its own, with its own camera in the calibration."
        )
    if not paths.keys() & {"video", "images", "masks", "keypoints", "depth"}:
        raise InputError(
            f"{where}: neither video, images, depth, masks nor keypoints are given; add one of them, or remove the "
            "view."
        )
    shift = numbers(where, "image_shift", table.get("image_shift", [0.0, 0.0]), 2, whole=False)
    return View(
        name=name,
        image_shift=(float(shift[0]), float(shift[1])),
        accept_scaled=table.get("accept_scaled", False),
        **paths,
    )


def _calibration(folder: Path, where: str, settings: Mapping[str, Any], notes: list[str]) -> tuple[Path, CameraRig]:
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
    unit = choice(where, "calibration_unit", settings.get("calibration_unit", "auto"), ("auto", *UNITS))
    rig, found = read_any(path, unit)
    notes += found
    up = choice(where, "world_up", settings.get("world_up", "z"), tuple(_UP))
    if up != "z":
        turn = se3(rotation_between(_UP[up], _UP["z"]).T, np.zeros(3))
        rig = CameraRig(tuple(replace(c, camera_from_world=c.camera_from_world @ turn) for c in rig))
        notes.append(f"The world is turned so that the calibration's {up} axis points up (z).")
    return path, rig


def _match_cameras(
    rig: CameraRig, path: Path, views: Sequence[View], wanted: Sequence[str | None], notes: list[str]
) -> CameraRig:
    """The rig in the order of the views."""
    if all(wanted):
        chosen = rig.select([w for w in wanted if w])  # its error lists the cameras there are
        left = [n for n in rig.names if n not in chosen.names]
        if left:
            notes.append(f"The cameras {', '.join(left)} of {path.name} have no view and are left out.")
        return chosen
    exact = [w or v.name for w, v in zip(wanted, views, strict=True)]
    if len(rig) > len(views) and all(name in rig.names for name in exact):
        left = [n for n in rig.names if n not in exact]
        notes.append(f"The cameras {', '.join(left)} of {path.name} have no view and are left out.")
        return rig.select(exact)
    if len(rig) != len(views):
        raise CalibrationError(
            f"{path} has {len(rig)} cameras ({', '.join(rig.names)}) but there are {len(views)} views "
            f"({', '.join(v.name for v in views)}); add the missing ones, or give every view its camera "
            '(camera = "...") in recording.toml.'
        )
    keys = [w or v.name for w, v in zip(wanted, views, strict=True)]
    unknown = [w for w in wanted if w and w not in rig.names]
    if unknown:
        rig.select(unknown)
    matched = match_names(keys, rig.names)
    if all(m is not None for m in matched):
        if any(k != rig.names[m] for k, m in zip(keys, matched, strict=True) if m is not None):
            order = [rig.names[m] for m in matched if m is not None]
            pairs = ", ".join(f"{v.name} = {n}" for v, n in zip(views, order, strict=True))
            notes.append(f"Views and cameras are matched by their names: {pairs}.")
        return CameraRig(tuple(rig[m] for m in matched if m is not None))
    pairs = ", ".join(f"{v.name} = {c}" for v, c in zip(views, rig.names, strict=True))
    notes.append(
        "The names of views and cameras do not tell which belong together, so they are taken in their "
        f"order: {pairs}; "
        'if that is wrong, give each view its camera = "..." in recording.toml.'
    )
    return rig
