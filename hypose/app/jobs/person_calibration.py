"""`hypose calibrate --from-person`: a recording without a calibration, its cameras found from the person in it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from hypose.app.commands.commands_check import keep_offsets
from hypose.app.commands.commands_track import detected
from hypose.app.commands.console import Stages, print_note, print_table, say
from hypose.calibration.from_person import PersonCalibration, calibrate_from_person
from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.evidence.held_points import without_held
from hypose.evidence.keypoints import keypoint_names, person_size
from hypose.geometry import Array
from hypose.io.recordings.recording import Recording, load_recording
from hypose.io.recordings.recording_people import candidates_of
from hypose.pipeline.recording_diagnostics import window

_MOST_SECONDS = 60


def person_of(loaded: Recording, lenses_known: bool, yes: bool) -> tuple[Array, tuple[str, ...]]:
    """(C, T, K, 3) px of the stored pictures and confidence of whom each view shows largest and most surely, in the
    middle minute of a recording, and the key points' names; where it has no key points, those of the detector. Where
    the lenses are not known these are kept apart, for the detector's masks fit no other lens."""
    few = window(loaded, round(_MOST_SECONDS * loaded.frame_rate))
    if few.keypoint_set is None:
        kept = few if lenses_known else replace(few, folder=few.folder / "results" / "uncalibrated")
        found = detected(kept, few.frames, yes=yes, why="--from-person")
        views = tuple(replace(v, keypoints=found.view(v.name)) for v in few.views)
        few = replace(few, views=views, keypoint_set=found.keypoint_set, keypoint_lag=0, keypoint_pixels="calibration")
    names = keypoint_names(str(few.keypoint_set))
    people = candidates_of(few, few.rig) or []
    points = np.zeros((len(few.views), len(few.frames), len(names), 3))
    for c, view in enumerate(points):
        for t, found in enumerate(without_held([frame[c] for frame in people], first=3)[0]):
            if found is not None and len(found):
                view[t] = max(found[..., [3, 4, 2]], key=lambda p: float(p[:, 2].sum()) * person_size(p))
    return points, names


def calibrate_recording(
    path: Path, lenses: Path | None, height: float | None, largest: float | None, yes: bool, target: Path | None
) -> tuple[CameraRig, Path]:
    """The cameras of a recording and the file that they are to be written to; says what was found, and keeps the
    offsets. lenses: calibration file; largest: offset that is looked for, seconds (None: as many as needed)."""
    loaded = load_recording(path, lenses, uncalibrated=lenses is None)
    target = target or loaded.folder / "calibration.toml"
    if target.exists():
        raise InputError(f"{target} exists, and calibrations are never overwritten; give another name with --out.")
    height = height or loaded.subject_height
    if height is None:
        raise InputError("Say how tall the person is, in metres: --height 1.72 (the height gives the scale).")
    points, names = person_of(loaded, lenses is not None, yes)
    for text in loaded.notes:
        print_note(f"note: {text}")
    with Stages() as progress:
        found = calibrate_from_person(
            points, names, loaded.rig, height, loaded.frame_rate,
            lenses_known=lenses is not None, largest_s=largest, progress=progress,
        )  # fmt: skip
    _show(found)
    keep_offsets(loaded, "person", found.late.tolist(), [f"sd {s:.2f}" for s in found.sds.late])
    if np.abs(found.late).max() > 0.05:
        offsets = ",".join(f"{x:.2f}" for x in found.late)
        say(f"To bring the evidence in step: hypose sync {path} --offsets={offsets} --out NEW_FOLDER")
    return found.rig, target


def _show(found: PersonCalibration) -> None:
    from rich.table import Table

    table = Table(title=f"Fit of the person's key points: {found.median_px:.1f} px median", title_justify="left")
    for column in ("camera", "late (frames)", "focal (px)", "position (m)", "uncertain by (mm)", "turned by (deg)"):
        table.add_column(column)
    sds = zip(found.late, found.sds.late, found.sds.focal, found.sds.place_m, found.sds.turn_deg, strict=True)
    for camera, (late, late_sd, focal_sd, place_sd, turn_sd) in zip(found.rig, sds, strict=True):
        f, (x, y, z) = camera.K[0, 0], camera.position
        table.add_row(
            camera.name, f"{late:+.2f} +- {late_sd:.2f}", f"{f:.0f}" + (f" +- {focal_sd * f:.0f}" if focal_sd else ""),
            f"{x:.3f} {y:.3f} {z:.3f}", f"{1e3 * place_sd:.0f}", f"{turn_sd:.2f}",
        )  # fmt: skip
    print_table(table)
    for text in found.approximate:
        say(f"warning: approximate: {text}.", "yellow")
