"""Find the cameras of a live run: those of a recording, or of a calibration with the address of each camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.evidence.silhouettes import SilhouetteSettings
from hypose.io.calibrations.calibration_formats import find_calibration, read_any
from hypose.io.recordings.frames import build_backgrounds, working_rig
from hypose.io.recordings.pose2sim import is_project
from hypose.io.recordings.recording import Recording, load_recording
from hypose.io.recordings.recording_views import DepthSource, ViewSettings
from hypose.io.sensors.depth import DEPTH_PREFIX, is_depth
from hypose.io.videos.video import is_device, without_password
from hypose.pipeline.live.capture import LiveView
from hypose.pipeline.settings import SETTINGS


@dataclass(frozen=True)
class LiveRig:
    """Cameras of a live run.

    rig, views: calibrated cameras, and how each is opened, in the same order.
    rate: frame rate, Hz.
    silhouettes: how masks are made.
    height: height of the person, m, where known.
    notes: for the user.
    no_background: a recording is played without a picture of the empty room; the background is guessed from its
        videos.
    """

    rig: CameraRig
    views: tuple[LiveView, ...]
    rate: float
    silhouettes: SilhouetteSettings = SilhouetteSettings()
    height: float | None = None
    notes: tuple[str, ...] = ()
    no_background: bool = False


def live_rig(path: str | Path, sources: Mapping[str, str], rate: float | None = None, loop: bool = False) -> LiveRig:
    """Load the cameras for a live run.

    path: a recording (folder or recording.toml), or a calibration (file or folder).
    sources: addresses by camera name (see `open_camera`). With them only these cameras are used, and the empty room is
        learned at the start; without, a recording's videos are played.
    rate: Hz; None: that of the recording, else a usual one.
    loop: play the videos again and again.
    Raises: InputError names the missing input.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path} does not exist; give a recording, or a calibration file.")
    names = ("recording.toml", "config.toml")
    is_one = path.name.lower() in names if path.is_file() else (path / names[0]).is_file() or is_project(path)
    recording = load_recording(path) if is_one else None
    notes: tuple[str, ...] = ()
    if recording is None:
        found = find_calibration(path) if path.is_dir() else path
        if found is None:
            raise InputError(f"{path} holds neither a recording nor a calibration; calibrate the cameras first.")
        rig, notes = read_any(found)
    else:
        rig = recording.rig
    if not sources:
        return _played(recording, rig, path, rate, loop)
    names = rig.names if recording is None else tuple(v.name for v in recording.views)
    unknown = sorted(set(sources) - set(names))
    if unknown:
        raise InputError(f"There is no camera {unknown[0]}; the cameras are {', '.join(names)}.")
    _check_places(sources)
    known = [ViewSettings(name) for name in names] if recording is None else recording.views
    if len(sources) < 2:
        others = ", ".join(n for n in names if n not in sources)
        raise InputError(f"Live tracking needs two cameras or more; give the place of another with --source: {others}.")
    used = [k for k, name in enumerate(names) if name in sources]
    views = tuple(
        LiveView(v.name, where, v.image_shift, stretched=v.accept_scaled, depth=is_depth(where))
        for v, where in ((known[k], _address(known[k], sources)) for k in used)
    )
    return LiveRig(
        CameraRig(tuple(rig[k] for k in used)),
        views,
        rate or SETTINGS.live_rig_usual_rate,
        SilhouetteSettings() if recording is None else recording.silhouettes,
        None if recording is None else recording.subject_height,
        notes,
    )


def _address(view: ViewSettings, sources: Mapping[str, str]) -> str:
    """Return the address of a camera; the folder of a depth view is marked as one of depth maps."""
    where = sources[view.name]
    return where if "depth" not in view.files or is_depth(where) else f"{DEPTH_PREFIX}{where}"


def _check_places(sources: Mapping[str, str]) -> None:
    """Raise InputError where two cameras have the same address."""
    names = dict[str, str]()
    for name, where in sources.items():
        first = names.setdefault(str(int(where)) if is_device(where) else where, name)
        if first != name:
            both = f"{first} and {name} are both at {without_password(where)}"
            raise InputError(f"The cameras {both}; say where each of them is.")


def _played(recording: Recording | None, rig: CameraRig, path: Path, rate: float | None, loop: bool) -> LiveRig:
    if recording is None:
        raise InputError(
            f"Where are the cameras of {path}? Say so for each, for example --source {rig.names[0]}=0 for the first "
            f"camera of this computer, or --source {rig.names[0]}=http://... ; they are {', '.join(rig.names)}."
        )
    without = [v.name for v in recording.views if v.source is None]
    if without:
        raise InputError(
            f"View {without[0]} of {recording.name} has no video to play; give the camera with --source, or a "
            "recording with videos."
        )
    # masks made by other programs do not exist for live pictures
    shown = replace(recording, keypoint_set=None, views=tuple(v.without("masks") for v in recording.views))
    loop_s = recording.n_frames / recording.frame_rate if loop else None
    small = working_rig(rig, depth=[v in recording.depth_views for v in recording.views])
    views = tuple(
        LiveView(v.name, str(v.source), v.image_shift, b, v.accept_scaled, loop_s=loop_s)
        if "depth" not in v.files
        else LiveView(
            v.name,
            f"{DEPTH_PREFIX}{v.source}",
            v.image_shift,
            depth=True,
            depth_background=DepthSource(v, camera, own).room,
        )
        for v, b, camera, own in zip(recording.views, build_backgrounds(shown), rig, small, strict=True)
    )
    notes = tuple(f"View {v.name}: {v.background.note}" for v in views if v.background and v.background.note)
    no_background = not any({"background", "depth"} & v.files.keys() for v in recording.views)
    rate = rate or recording.frame_rate
    return LiveRig(rig, views, rate, recording.silhouettes, recording.subject_height, notes, no_background)
