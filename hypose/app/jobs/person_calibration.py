"""`hypose calibrate --from-person`: a recording without a calibration, its cameras found from the person in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hypose.app.commands.commands_check import keep_offsets
from hypose.app.commands.commands_track import detect, detected, open_network_asking
from hypose.app.commands.console import Stages, note, out, say
from hypose.calibration.from_person import PersonCalibration, PersonSettings, calibrate_from_person
from hypose.calibration.two_views import with_focal
from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.evidence.held_points import without_held
from hypose.evidence.keypoints import keypoint_names, person_size
from hypose.geometry import Array
from hypose.io.recordings.recording import Recording, load_recording
from hypose.io.recordings.recording_people import candidates_of
from hypose.pipeline.detect_keypoints import wants_detector
from hypose.pipeline.examine import window

_MOST_SECONDS = 60
_ROUGH = 0.1
"""sd (share) of focal lengths that the user gives"""


def recording_without_cameras(path: Path, lenses: Path | None, focal: Sequence[str]) -> tuple[Recording, bool]:
    """A recording whose cameras have their lenses alone, from a calibration file, or as wide as their pictures with
    the focal lengths (CAMERA=PX, or PX for all) that are given; and whether all focal lengths are given."""
    if lenses is not None:
        return load_recording(path, lenses), True
    loaded = load_recording(path, uncalibrated=True)
    given = _focal_lengths(focal, loaded.rig.names)
    cameras = [with_focal(c, given.get(c.name, c.K[0, 0]) / c.K[0, 0]) for c in loaded.rig]
    return replace(loaded, rig=CameraRig(tuple(cameras))), len(given) == len(cameras)


def _focal_lengths(texts: Sequence[str], names: Sequence[str]) -> Mapping[str, float]:
    given = {}
    for text in texts:
        name, _, number = text.rpartition("=")
        try:
            value = float(number)
        except ValueError:
            value = 0.0
        if not 10 <= value <= 1e6 or (name and name not in names):
            raise InputError(
                f"--focal {text!r} is not understood; write pixels, or CAMERA=PIXELS with one of the cameras "
                f"{', '.join(names)}."
            )
        given |= {name: value} if name else dict.fromkeys(names, value)
    return given


def with_person(loaded: Recording, lenses_known: bool, yes: bool) -> Recording:
    """The recording, limited to its middle minute, with key points: where it has none, those of the detector. Where
    the lenses are not known, these are kept apart, for the detector's masks fit no other lens."""
    few = window(loaded, round(_MOST_SECONDS * loaded.frame_rate))
    if few.keypoint_set is not None:
        return few
    if not wants_detector(few):
        raise InputError(f"{few.name}: cameras are found from key points or videos, and a view has neither; add them.")
    if lenses_known:
        found = detected(few, few.frames, yes=yes, why="--from-person")
    else:
        network = open_network_asking(yes, "--from-person")
        found = detect(few, network, few.folder / "results" / "keypoints_uncalibrated", few.frames, resume=True)
    views = tuple(replace(v, keypoints=found.view(v.name)) for v in few.views)
    return replace(few, views=views, keypoint_set=found.keypoint_set, keypoint_lag=0, keypoint_pixels="calibration")


def most_prominent(recording: Recording) -> tuple[Array, tuple[str, ...]]:
    """(C, T, K, 3) px of the stored pictures and confidence of whom each view shows largest and most surely, and the
    key points' names."""
    assert recording.keypoint_set is not None
    names = keypoint_names(recording.keypoint_set)
    found = candidates_of(recording, recording.rig)
    points = np.zeros((len(recording.views), len(recording.frames), len(names), 3))
    for c in range(len(points)):
        column, _ = without_held([frame[c] for frame in found or []], first=3)
        for t, people in enumerate(column):
            if people is not None and len(people):
                seen = people[..., [3, 4, 2]]
                points[c, t] = max(seen, key=lambda p: float(p[:, 2].sum()) * person_size(p))
    return points, names


def find_cameras(
    loaded: Recording, focal_known: bool, rough: bool, height: float, largest: float | None, progress: Callable
) -> PersonCalibration:
    """Cameras and offsets of a recording with key points; rough: its focal lengths are about right; largest: offset
    that is looked for, seconds."""
    points, names = most_prominent(loaded)
    frames = None if largest is None else max(4, round(largest * loaded.frame_rate))
    settings = PersonSettings(focal_known, _ROUGH if rough else None, frames)
    return calibrate_from_person(points, names, loaded.rig, height, loaded.frame_rate, settings, progress)


def calibrate_recording(
    path: Path,
    lenses: Path | None,
    focal: Sequence[str],
    height: float | None,
    largest: float | None,
    yes: bool,
    target: Path | None,
) -> tuple[CameraRig, Path]:
    """The rig and the file it is to be written to; says what was found, and keeps the offsets."""
    if lenses is not None and focal:
        raise InputError("--intrinsics and --focal both say what the lenses are; leave one of the two out.")
    loaded, all_given = recording_without_cameras(path, lenses, focal)
    height = height or loaded.subject_height
    if height is None:
        raise InputError("Say how tall the person is, in metres: --height 1.72 (the height gives the scale).")
    target = target or loaded.folder / "calibration.toml"
    if target.exists():
        raise InputError(f"{target} exists, and calibrations are never overwritten; give another name with --out.")
    seen = with_person(loaded, lenses is not None, yes)
    for text in loaded.notes:
        note(f"note: {text}")
    with Stages() as progress:
        found = find_cameras(seen, lenses is not None, all_given and lenses is None, height, largest, progress)
    show(found)
    words = [f"sd {s:.2f}" for s in found.late_sd]
    keep_offsets(loaded, "person", [float(x) for x in found.late], words)
    if np.abs(found.late).max() > 0.05:
        late = ",".join(f"{x:.2f}" for x in found.late)
        say(f"To bring the evidence in step: hypose sync {path} --offsets={late} --out NEW_FOLDER")
    return found.rig, target


def show(found: PersonCalibration) -> None:
    """Say what was found, how sure it is, and what is approximate."""
    from rich.table import Table

    table = Table(title=f"Fit of the person's key points: {found.median_px:.1f} px median", title_justify="left")
    for column in ("camera", "late (frames)", "focal (px)", "position (m)", "uncertain by (mm)", "turned by (deg)"):
        table.add_column(column)
    for c, camera in enumerate(found.rig):
        x, y, z = camera.position
        focal = f"{camera.K[0, 0]:.0f}"
        table.add_row(
            camera.name, f"{found.late[c]:+.2f} +- {found.late_sd[c]:.2f}",
            f"{focal} +- {found.focal_sd[c] * camera.K[0, 0]:.0f}" if found.focal_sd[c] else f"{focal} (given)",
            f"{x:.3f} {y:.3f} {z:.3f}", f"{1e3 * found.place_sd_m[c]:.0f}", f"{found.turn_sd_deg[c]:.2f}",
        )  # fmt: skip
    console = out()
    if not console.is_terminal:
        console.width = 160
    console.print(table)
    for text in found.approximate:
        say(f"warning: approximate: {text}.", "yellow")
