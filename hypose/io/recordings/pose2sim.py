"""Reading of a Pose2Sim project or trial folder as if it had a recording.toml. Nothing is written.

Read are: Config.toml of the trial and of up to two levels above it (a key of the trial wins); `calibration/` there or
    above (a folder with calib in its name; the .toml of Pose2Sim, else Qualisys .qca.txt); `videos/` (files or folders
    of images, in natural order; not needed where there are key points); `pose/<camera>_json/` (OpenPose JSON); and the
    photos in `calibration/extrinsics/`. These photos show the room with the recording's cameras, so they are used as
    background plates.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hypose.errors import InputError
from hypose.evidence.keypoints import KEYPOINT_SETS
from hypose.io.calibrations.calibration_formats import find_calibration
from hypose.io.files import match_names, natural_key, read_toml, text_of
from hypose.io.keypoints.keypoint_files import KEYPOINTS
from hypose.io.motions.marker_files import read_trc
from hypose.io.videos.video import IMAGE_ENDINGS, VIDEO_ENDINGS, frame_size, list_images

_LEVELS_ABOVE = 2
# Pose2Sim's names of its models -> key-point sets; other names are sets already (BODY_25B, HALPE_26, ...).
_MODELS = {
    "body_with_feet": "HALPE_26",
    "lower_body": "HALPE_26",
    "body": "COCO_17",
    "whole_body": "COCO_133",
    "whole_body_wrist": "COCO_133_WRIST",
}
_COUNT_OF_SET = {**{name: len(order) for name, order in KEYPOINT_SETS.items()}, "COCO": 18, "BLAZEPOSE": 33}


def is_project(folder: Path) -> bool:
    """Test whether a folder is a Pose2Sim project or trial.

    It has a Config.toml, or a calibration folder and videos or key points.
    """
    has_config = _entry(folder, "config.toml") is not None
    return has_config or (_is_trial(folder) and _calibration_folder(folder) is not None)


def read_project(folder: Path) -> tuple[dict[str, Any], list[str]]:
    """Translate a Pose2Sim project into the settings of recording.toml.

    Returns: settings with absolute paths, and notes for the user.
    Raises: InputError where videos and key points, or the calibration, are missing.
    """
    folder = folder.absolute()
    config = _merged_config(folder)
    videos = _entry(folder, "videos")
    clips = [] if videos is None else _clips(videos)
    posed = [] if clips else _pose_folders(folder, "pose-sync") or _pose_folders(folder)
    if not clips and not posed:
        trials = [p.name for p in sorted(folder.iterdir()) if p.is_dir() and _is_trial(p)]
        if trials:
            raise InputError(
                f"{folder} is a Pose2Sim session with the trials {', '.join(trials)}; name one of these folders."
            )
        raise InputError(
            f"The Pose2Sim project {folder} has no videos ({', '.join(VIDEO_ENDINGS)}) or folders of images in videos, "
            f"and no key points in pose; put the videos into {folder / 'videos'}."
        )
    calibration = _find_calibration(folder)
    notes: list[str] = []
    project = _table(config, "project")
    names = [text_of(p.stem if p.is_file() else p.name) for p in clips] or [_camera_of(p) for p in posed]
    settings: dict[str, Any] = {"name": text_of(folder.resolve().name), "calibration": str(calibration)}
    numbers = {"frame_rate": "frame_rate", "participant_height": "subject_height", "participant_mass": "subject_mass"}
    for key, target in numbers.items():
        value = project.get(key)
        value = value[0] if isinstance(value, list) and value else value
        if isinstance(value, int | float):
            settings[target] = float(value)
    if "frame_rate" not in settings and not clips:
        _rate_of_results(folder, settings, notes)
    frames = project.get("frame_range")
    if isinstance(frames, list) and len(frames) == 2:
        settings["frame_range"] = frames
    views: list[dict[str, Any]] = [{"name": n} for n in names]
    for view, clip in zip(views, clips, strict=False):  # none where there are key points alone
        view["video" if clip.is_file() else "images"] = str(clip)
    if posed:
        notes.append(f"There are no videos in {folder}; the key points in {posed[0].parent.name} are used alone.")
    keypoints: list[Path | None] = [*posed] or _keypoint_folders(folder, names, notes)
    for view, path in zip(views, keypoints, strict=True):
        if path is not None:
            view["keypoints"] = str(path)
    if any(keypoints):
        kind = _keypoint_set(_table(config, "pose").get("pose_model"), [k for k in keypoints if k], notes)
        if kind is not None:
            settings["keypoint_set"] = kind
        # Pose2Sim itself never scales key points: they are in the pixels of the calibration.
        settings["keypoint_pixels"] = "calibration"
    if clips:
        _add_plates(calibration.parent / "extrinsics", views, notes)
    settings["view"] = views
    return settings, notes


def _table(config: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """Get a table of Config.toml; empty where it is missing or something else."""
    return table if isinstance(table := config.get(name), Mapping) else {}


def with_overrides(project: Mapping[str, Any], given: Mapping[str, Any], source: Path) -> dict[str, Any]:
    """Merge a recording.toml that lies in a Pose2Sim project into the project's settings.

    project: settings of the project; its views stay.
    given: settings of recording.toml, which win; views are matched by name.
    source: path of recording.toml, for the error message.
    Raises: InputError where a view does not exist in the project.
    """
    views = {v["name"]: dict(v) for v in project["view"]}
    for view in given.get("view", []):
        name = view.get("name") if isinstance(view, Mapping) else None
        if name not in views:
            raise InputError(
                f"{source}: the Pose2Sim project has no view {name!r}; its views are {', '.join(views)}. Name one of "
                'them, or give calibration = "..." and all views.'
            )
        views[name] |= view
    return {**project, **{k: v for k, v in given.items() if k != "view"}, "view": list(views.values())}


def _entry(folder: Path, lower_name: str) -> Path | None:
    """Find the subfolder (or the .toml file) of this name, in whichever case it is written."""
    named = (p for p in folder.iterdir() if p.name.lower() == lower_name)
    return next((p for p in named if p.is_dir() != lower_name.endswith(".toml")), None)


def _calibration_folder(folder: Path) -> Path | None:
    """Find the subfolder with "calib" in its name; of several, the one that is most like "calibration"."""
    found = [p for p in folder.iterdir() if p.is_dir() and "calib" in p.name.lower()]
    return min(
        found,
        key=lambda p: (p.name.lower() != "calibration", not p.name.lower().startswith("calib"), natural_key(p.name)),
        default=None,
    )


def _levels(folder: Path) -> list[Path]:
    """List the folder and the folders above it that have a Config.toml, so belong to the same session."""
    out = [folder]
    for parent in list(folder.parents)[:_LEVELS_ABOVE]:
        try:
            if _entry(parent, "config.toml") is not None:
                out.append(parent)
        except OSError:
            break
    return out


def _merged_config(folder: Path) -> dict[str, Any]:
    """Merge the Config.toml files of the levels key by key; the one nearest to the folder wins."""
    merged: dict[str, Any] = {}
    for path in (_entry(level, "config.toml") for level in reversed(_levels(folder))):
        for table, values in ({} if path is None else read_toml(path)).items():
            both = isinstance(values, dict) and isinstance(merged.get(table), dict)
            merged[table] = merged[table] | values if both else values
    return merged


def _find_calibration(folder: Path) -> Path:
    looked = [found for level in _levels(folder) if (found := _calibration_folder(level)) is not None]
    for path in map(find_calibration, looked):
        if path is not None:
            return path
    where = " and ".join(map(str, looked)) if looked else f"{folder} (it has no calibration folder)"
    raise InputError(
        f"No calibration (.toml or .qca.txt) in {where}; run Pose2Sim's calibration step or hypose calibrate first."
    )


def _clips(videos: Path) -> list[Path]:
    seen = [p for p in videos.iterdir() if not p.name.startswith(".")]
    files = [p for p in seen if p.is_file() and p.suffix.lower() in VIDEO_ENDINGS]
    folders = [] if files else [p for p in seen if p.is_dir() and list_images(p)]
    return sorted(files or folders, key=lambda p: natural_key(p.name))


def _pose_folders(folder: Path, name: str = "pose") -> list[Path]:
    """List the folders of pose, or pose-sync, that hold key points, in natural order."""
    pose = _entry(folder, name)
    inside = [] if pose is None else [p for p in pose.iterdir() if p.is_dir() and next(p.glob("*.json"), None)]
    return sorted(inside, key=lambda p: natural_key(p.name))


def _rate_of_results(folder: Path, settings: dict[str, Any], notes: list[str]) -> None:
    """Take the frame rate from the triangulated points of Pose2Sim, where nothing else gives it.

    settings: settings of the recording, to which frame_rate is added.
    notes: list to which a sentence about this is added.
    """
    results = _entry(folder, "pose-3d")
    for path in sorted(results.glob("*.trc")) if results is not None else ():
        with contextlib.suppress(InputError):
            settings["frame_rate"] = read_trc(path).frame_rate
            notes.append(f"The frame rate, {settings['frame_rate']:g}/s, is that of {path.name}.")
            return


def _camera_of(folder: Path) -> str:
    """Derive the camera's name from the folder's (cam01_json -> cam01)."""
    return text_of(folder.name.removesuffix("_json")) or text_of(folder.name)


def _is_trial(folder: Path) -> bool:
    return _entry(folder, "videos") is not None or bool(_pose_folders(folder))


def _keypoint_folders(folder: Path, names: Sequence[str], notes: list[str]) -> list[Path | None]:
    """Find the folder of key points of each view; None where a view has none.

    folder: the project.
    names: names of the views.
    notes: list to which sentences about the choice are added.
    """
    pose = _entry(folder, "pose")
    if pose is None:
        return [None] * len(names)
    folders = _pose_folders(folder)
    matched = match_names(names, [p.name for p in folders])
    if None in matched and len(folders) == len(names):
        notes.append(
            f"Key-point folders and videos are paired in their order ({folders[0].name} with {names[0]}, "
            "...), since their names do not say which belong together."
        )
        return list(folders)
    missing = [n for n, m in zip(names, matched, strict=True) if m is None]
    if folders and missing:
        notes.append(f"No key points for {', '.join(missing)} in {pose}.")
    if _entry(folder, "pose-sync") is not None:
        notes.append(
            "pose-sync is not read: hypose takes the videos as synchronous, and the key points of pose as they are."
        )
    return [None if m is None else folders[m] for m in matched]


def _keypoint_set(model: Any, folders: Sequence[Path], notes: list[str]) -> str | None:
    """Choose the key-point set: that of Config.toml, unless the files have another number of points.

    model: pose_model of Config.toml; None where it has none.
    folders: folders of key points, of which up to four are read.
    notes: list to which a sentence is added where the files decide.
    Returns: None where the files decide.
    """
    if not isinstance(model, str) or not model.strip():
        return None
    stated = _MODELS.get(model.strip().lower(), model.strip().upper())
    sample = next((s for f in folders[:4] if len(s := KEYPOINTS.read(f).sample())), None)
    if sample is None or _COUNT_OF_SET.get(stated, sample.shape[1]) == sample.shape[1]:
        return stated
    notes.append(
        f"The key points have {sample.shape[1]} points, which are not those of {stated} in Config.toml; their bones "
        "decide the set."
    )
    return None


def _add_plates(extrinsics: Path, views: list[dict[str, Any]], notes: list[str]) -> None:
    """Add the photos of the room with which Pose2Sim calibrates as backgrounds of the views.

    extrinsics: folder of the photos, or of one folder of photos per camera; it need not exist.
    views: tables of the views, to which the key background is added.
    notes: list to which sentences about this are added.
    """
    if not extrinsics.is_dir():
        return
    photos: list[tuple[str, Path]] = []
    for path in sorted(extrinsics.iterdir(), key=lambda p: natural_key(p.name)):
        if path.is_dir() and (images := list_images(path)):
            photos.append((path.name, images[0]))
        elif path.is_file() and path.suffix.lower() in IMAGE_ENDINGS:
            photos.append((path.stem, path))
    used = []
    for view, index in zip(views, match_names([v["name"] for v in views], [n for n, _ in photos]), strict=True):
        if index is None:
            continue
        photo = photos[index][1]
        (w, h), (pw, ph) = frame_size(Path(view.get("video") or view["images"])), frame_size(photo)
        if abs((w / h) / (pw / ph) - 1) > 0.01:
            notes.append(
                f"{photo.name} ({pw} x {ph} px) is not used as background of {view['name']} ({w} x {h} px): "
                "the shape of the image differs."
            )
            continue
        view["background"] = str(photo)
        used.append(view["name"])
    if used:
        notes.append(
            f"The extrinsics photos serve as background plates of {', '.join(used)}; look at the "
            "silhouettes, since people in a photo leave ghosts."
        )
