"""`hypose check` and `hypose sync`: is a recording's calibration right, how late is each camera, and what cures it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from click.exceptions import Exit

from hypose.app.commands.console import Stages, out, say
from hypose.errors import EvidenceError, InputError
from hypose.evidence.frame import Silhouettes
from hypose.options import HEIGHT, CalibrationFile, Option, RecordingPath

if TYPE_CHECKING:
    from hypose.app.commands.console import ProgressCall
    from hypose.calibration.diagnostics import Cured, PersonReport
    from hypose.geometry import Array
    from hypose.io.recordings.recording import Recording
    from hypose.io.recordings.recording_people import RecordedPerson
    from hypose.pipeline.recording_diagnostics import Refinement

_REFINE = "Refine"


def check(
    recording: RecordingPath,
    sheet: Annotated[
        Path | None, Option("Contact sheet to write. [default: results/check.png there]", flag="--out")
    ] = None,
    samples: Annotated[int, Option("Frames whose common volume is looked at.", 1, 10_000)] = 5,
    frames: Annotated[int, Option("Consecutive frames that the doctor looks at; 0: skip it.", 0, 100_000)] = 100,
    calibration: CalibrationFile = None,
    refine: Annotated[
        bool,
        Option("Find the cameras' poses from the moving person.", group=_REFINE, flag="--refine"),
    ] = False,
    using: Annotated[
        str,
        Option("keypoints, silhouettes, both, or auto.", group=_REFINE, flag="--from"),
    ] = "auto",
    far: Annotated[
        bool,
        Option("Also cameras more than 10 degrees or 0.5 m off (--refine=far).", group=_REFINE, flag="--far"),
    ] = False,
    focal: Annotated[bool, Option("Focal lengths too.", group=_REFINE)] = False,
    keep: Annotated[
        tuple[str, ...],
        Option("Camera that stays as it is (may be repeated).", group=_REFINE),
    ] = None,
    height: Annotated[
        float | None,
        Option("The person's height in metres: sets the scale.", *HEIGHT, unit="metres", group=_REFINE),
    ] = None,
    to: Annotated[
        Path | None,
        Option("New calibration file. [default: results/calibration_refined.toml there]", group=_REFINE),
    ] = None,
) -> None:
    """Check whether the views agree, name the cause and the camera, and correct it with --refine.

    Exit code 0: fine, or refined; 1: something is wrong.
    """
    from hypose.app.jobs.checking import camera_table, check_picture, check_recording, examine_recording, write_findings
    from hypose.io.files import check_writable
    from hypose.io.recordings.recording import load_recording

    if using not in ("auto", "keypoints", "silhouettes", "both"):
        raise InputError(f"--from {using} is not possible; choose auto, keypoints, silhouettes or both.")
    if to is not None and to.exists():
        raise InputError(f"{to} exists, and calibrations are never overwritten; give another name with --to.")
    if sheet is not None:
        check_picture(sheet, "--out")
    loaded = load_recording(recording, calibration)
    for name in keep or []:
        loaded.rig.select([name])
    console = out()
    if not console.is_terminal:
        console.width = 160
    console.print(camera_table(loaded))
    for text in loaded.notes:
        say(f"note: {text}")
    path = sheet or loaded.folder / "results" / "check.png"
    check_writable(path.parent)
    if refine:
        check_writable((to or path).parent, "--to")
    report = cured = None
    with Stages() as progress:
        found = check_recording(loaded, path, samples, progress)
        if frames > 0:
            report, cured = examine_recording(loaded, frames, path.with_suffix(".html"), path, found, progress)
    write_findings(path.with_suffix(".json"), found, report)
    for text in found.facts:
        say(text)
    for text in found.warnings:
        say(f"warning: {text}", "yellow")
    if report is not None:
        _verdicts(report)
        say(f"Page: {path.with_suffix('.html')}")
    say(f"Contact sheet: {path}")
    if refine:
        _refine(loaded, cured, using, focal, tuple(keep or ()), height, to, far)
        return
    if found.warnings or (report is not None and not report.healthy):
        raise Exit(1)
    say("No problem found.", "green")


def _verdicts(report: PersonReport) -> None:
    for view in report.views:
        numbers = []
        if view.left_out_px == view.left_out_px:
            numbers.append(f"key points {view.left_out_px:.1f} px from where the other cameras put them")
        if view.tangency_px == view.tangency_px:
            numbers.append(f"silhouette {view.tangency_px:.1f} px")
        say(f"{view.name}: " + (", ".join(numbers) if numbers else "nothing to compare"))
    for finding in report.findings:
        say(f"{'fault' if finding.fault else 'note'}: {finding.sentence}", "yellow" if finding.fault else None)


def _refine(
    loaded: Recording,
    cured: Cured | None,
    using: str,
    focal: bool,
    keep: tuple[str, ...],
    height: float | None,
    to: Path | None,
    far: bool,
) -> None:
    from hypose.io.calibrations.calibration_text import write_calibration
    from hypose.pipeline.recording_diagnostics import cured_recording, refine_recording

    method = using
    if using == "auto":
        method = "keypoints" if loaded.keypoint_set is not None else "silhouettes"
    recording = loaded if cured is None else cured_recording(loaded, cured)
    late = None if cured is None else cured.late
    with Stages() as progress:
        result = refine_recording(
            recording,
            method,
            late=late,
            focal=focal,
            fixed=keep,
            height=height or loaded.subject_height,
            progress=progress,
        )
    target = to or _free_name(loaded.folder / "results" / "calibration_refined.toml")
    for text in result.notes:
        say(f"note: {text}")
    better = _tell(result)
    if not better:
        say("The refined calibration is not better on frames that it was not found on; nothing is written.", "yellow")
        raise Exit(1)
    if result.far and not far:
        say(
            f"The refinement takes {' and '.join(result.far)} more than 10 degrees or 0.5 m away from where the "
            "calibration has it, and nothing is written: look whether the key points are one person's in all views, or "
            "take it with --refine=far.",
            "yellow",
        )
        raise Exit(1)
    target.parent.mkdir(parents=True, exist_ok=True)
    write_calibration(result.rig, target)
    say(f"Refined calibration: {target} (metres, world as before, z up)", "green")
    if any("world is turned" in n for n in loaded.notes):
        say('note: this file is z up already: use it with world_up = "z".')
    say(f"Use it: hypose track {loaded.folder} --calibration {target}")
    if cured is not None:
        for text in _settings(loaded, cured):
            say(f"In recording.toml besides: {text}")


def _tell(result: Refinement) -> bool:
    for change in result.changes:
        focal = f", focal length x {change.focal:.4f}" if abs(change.focal - 1) > 1e-6 else ""
        say(
            f"{change.name}: turned by {change.turn_deg:.2f} degrees, moved by {1000 * change.move_m:.0f} mm{focal}; "
            f"the person moves {change.image_px:.1f} px in its image"
        )
    frames = "frames not used"
    better = True
    if result.before_px == result.before_px:
        say(
            f"Key points: {result.before_px:.2f} -> {result.after_px:.2f} px median residual ({frames}); one camera "
            f"left out: {result.left_out_before_px:.2f} -> {result.left_out_after_px:.2f} px"
        )
        better = result.after_px < result.before_px
    if result.tangency_before_px == result.tangency_before_px:
        say(f"Silhouettes: {result.tangency_before_px:.2f} -> {result.tangency_after_px:.2f} px ({frames})")
        if result.before_px != result.before_px:
            better = result.tangency_after_px < result.tangency_before_px
    return better


def _settings(recording: Recording, cured: Cured) -> list[str]:
    out = []
    if cured.keypoint_lag:
        out.append(f"keypoint_lag = {recording.keypoint_lag + cured.keypoint_lag}")
    for view, shift in zip(recording.views, cured.shift, strict=True):
        if shift.any():
            x, y = (round(float(a + b), 1) for a, b in zip(view.image_shift, shift, strict=True))
            out.append(f"view {view.name}: image_shift = [{x:g}, {y:g}]")
    return out


def _free_name(path: Path) -> Path:
    """The path, or with a number behind it the first that is not taken: calibrations are never overwritten."""
    number, free = 2, path
    while free.exists():
        free = path.with_name(f"{path.stem}_{number}{path.suffix}")
        number += 1
    return free


def sync(
    recording: RecordingPath,
    by: Annotated[str, Option("motion, sound or flash.")] = "motion",
    offsets: Annotated[str | None, Option("Known offsets in frames instead, one per view: 0,-2.5,1")] = None,
    largest: Annotated[
        float, Option("Largest offset that is looked for, in seconds.", 0, 600, above=True, unit="seconds")
    ] = 0.5,
    frames: Annotated[int, Option("Consecutive frames that motion is taken from.", 24, 100_000)] = 250,
    to: Annotated[
        Path | None, Option("New folder for masks, depth maps and key points that are in step.", flag="--out")
    ] = None,
) -> None:
    """How many frames each view is late. With --out, masks, depth maps and key points in step are written."""
    from hypose.io.files import check_writable, claimed
    from hypose.io.recordings.recording import load_recording

    if by not in ("motion", "sound", "flash"):
        raise InputError(f"--by {by} is not possible; choose motion, sound or flash.")
    if to is not None and to.exists() and not _unfinished(to):
        raise InputError(f"{to} is not empty; give a new folder with --out.")
    loaded = load_recording(recording)
    if len(loaded.views) < 2:
        raise InputError("One view needs no synchronisation; the recording has only one.")
    if to is not None:
        check_writable(to)
    with Stages() as progress:
        if offsets is not None:
            late, words = _given(offsets, loaded), ["as given"] * len(loaded.views)
        elif by == "motion":
            late, words = _by_motion(loaded, largest * loaded.frame_rate, frames, progress)
        elif by == "sound":
            late, words = _by_sound(loaded, largest)
        else:
            late, words = _by_light(loaded, progress)
    for view, x, word in zip(loaded.views, late, words, strict=True):
        say(f"{view.name}: {abs(x):.2f} frames {'late' if x >= 0 else 'early'} ({word})")
    if to is None:
        keep_offsets(loaded, by if offsets is None else "given", late, words)
        say(f"To bring the evidence in step: hypose sync {recording} --out NEW_FOLDER")
        return
    with claimed(to), Stages() as progress:
        path = _write(loaded, late, to, progress)
    say(f"Evidence in step: {path}", "green")


def keep_offsets(recording: Recording, by: str, late: list[float], words: list[str]) -> None:
    """results/sync.json, for the studio; where it cannot be written, the printed text has to do."""
    import contextlib

    from hypose.io.files import write_text

    views = [{"name": v.name, "late": x, "told": w} for v, x, w in zip(recording.views, late, words, strict=True)]
    with contextlib.suppress(OSError, InputError):
        write_text(recording.folder / "results" / "sync.json", json.dumps({"by": by, "views": views}) + "\n")


def _unfinished(folder: Path) -> bool:
    """True for an empty folder, and for one that this command has begun and not finished."""
    return folder.is_dir() and all(
        p.name in ("masks", "depth", "keypoints") or p.name[0] == "." for p in folder.iterdir()
    )


def _given(text: str, recording: Recording) -> list[float]:
    count = len(recording.views)
    try:
        out = [float(x) for x in text.split(",")]
    except ValueError:
        raise InputError(
            f"--offsets {text} are no numbers; write frames separated by commas, for example 0,-2.5,1."
        ) from None
    if len(out) != count or any(abs(x) > 1e5 or x != x for x in out):
        raise InputError(f"--offsets {text}: {count} numbers of frames are needed, one per view.")
    if max(out) - min(out) >= len(recording.frames):
        raise InputError(
            f"--offsets {text}: views so far apart have no frame in common, since the recording has "
            f"{len(recording.frames)}; give frames, not milliseconds or frame numbers."
        )
    return out


def _by_motion(
    recording: Recording, largest: float, frames: int, progress: ProgressCall
) -> tuple[list[float], list[str]]:
    from hypose.calibration.diagnose_points import undistorted
    from hypose.calibration.sync_motion import at_the_end, offsets_within
    from hypose.calibration.synchronisation import offsets_from_motion
    from hypose.pipeline.recording_diagnostics import observe_recording

    seen = observe_recording(recording, frames, progress)
    points = None if seen.keypoints is None else undistorted(seen.rig, seen.keypoints)
    found = offsets_from_motion(seen.rig.pinhole(), points, seen.silhouettes, largest=largest)
    if found.gain < 0:
        raise EvidenceError("The motion does not tell the offsets; use --by sound or --by flash.")
    reported = [s < largest for s in found.sd]  # unknown where the deviation exceeds the search range
    if not any(reported):
        raise EvidenceError(
            f"{recording.name}: the views have no motion in common that tells how late they are; film a person who "
            "walks or waves, or use --by sound or --by flash."
        )
    words = [
        f"sd {s:.2f}" if known else "no motion in common with the others"
        for s, known in zip(found.sd, reported, strict=True)
    ]
    total = points[0].shape[1] if points is not None else len(seen.silhouettes or ())
    reach = offsets_within(largest, total)
    if at_the_end(found, reach):
        what = "a larger --largest" if reach >= largest - 0.5 else "more frames, and a larger --largest"
        words[0] += f"; views are {reach:.1f} frames apart or more: give {what}"
    return [float(x) for x in found.frames], words


def _by_sound(recording: Recording, largest: float) -> tuple[list[float], list[str]]:
    from hypose.calibration.synchronisation import offsets_from_sound
    from hypose.io.videos.video import read_sound

    sounds = []
    for view in recording.views:
        if view.video is None:
            raise InputError(f"View {view.name} has no video and so no sound; use --by motion.")
        sounds.append(read_sound(view.video))
    seconds, peaks = offsets_from_sound(sounds, [v.name for v in recording.views], largest)
    return [float(x) * recording.frame_rate for x in seconds], [f"peak {p:.0f} sd" for p in peaks]


def _by_light(recording: Recording, progress: ProgressCall) -> tuple[list[float], list[str]]:
    import numpy as np

    from hypose.calibration.synchronisation import offsets_from_light
    from hypose.io.videos.video import open_video

    levels = []
    for n, view in enumerate(recording.views):
        if view.source is None:
            raise InputError(f"View {view.name} has only masks, in which no light is seen; use --by motion.")
        progress("sync", n, len(recording.views))
        with open_video(view.source, rate=view.rate) as reader:
            levels.append(np.array([float(image[::8, ::8].mean()) for image in reader]))
    progress("sync", len(recording.views), len(recording.views))
    late, kinds = offsets_from_light(levels, [v.name for v in recording.views])
    return [float(x) for x in late], list(kinds)


def _write(recording: Recording, late: list[float], folder: Path, progress: ProgressCall) -> Path:
    """Masks (PNG, undistorted), depth maps and key points (OpenPose JSON) on the common clock, and a recording.toml."""
    from dataclasses import replace

    from hypose.calibration.synchronisation import Resampled, points_at
    from hypose.evidence.detector import openpose_document
    from hypose.io.file_names import folder_for
    from hypose.io.files import write_text
    from hypose.io.recordings.frames import mask_folder, write_frame_masks
    from hypose.io.recordings.recording import write_recording
    from hypose.pipeline.one_of_several import frames_to_examine
    from hypose.pipeline.recording_diagnostics import raw_person

    progress("background", 0, 1)
    stream, _ = frames_to_examine(recording)
    with stream:
        progress("background", 1, 1)
        source = Resampled(stream, late)
        named = zip(recording.views, stream.rig, strict=True)
        masks = [None if v.depth is not None else mask_folder(folder / "masks", v.name, c) for v, c in named]
        for i in range(len(source)):
            progress("masks", i, len(source))
            write_frame_masks(source.frame(i).the(Silhouettes), masks, i)
        progress("masks", len(source), len(source))
    people = _people(raw_person(recording))
    views = []
    for c, view in enumerate(recording.views):
        keypoints = None
        if people and view.keypoints is not None:
            keypoints = folder_for(folder / "keypoints", view.name)
            for t, shown in enumerate(zip(*(points_at(p[c], late[c]) for p in people), strict=True)):
                said = json.dumps(openpose_document(shown))
                write_text(keypoints / f"{keypoints.name}_{t:012d}_keypoints.json", said + "\n")
        if view.depth is not None:
            maps = _depth_in_step(view.depth, recording.frames, late[c], folder_for(folder / "depth", view.name))
            views.append(replace(view, depth=maps, keypoints=keypoints))
            continue
        views.append(
            replace(
                view,
                video=None,
                images=None,
                background=None,
                masks=masks[c],
                keypoints=keypoints,
                image_shift=(0.0, 0.0),
                accept_scaled=False,
            )
        )
    made = replace(
        recording,
        views=tuple(views),
        frame_range=None,
        n_frames=len(recording.frames),
        keypoint_lag=0,
        keypoint_pixels="calibration",
        name=f"{recording.name} in step",
    )
    return write_recording(made, folder)


def _depth_in_step(depth: Path, frames: range, late: float, folder: Path) -> Path:
    """The maps of a folder on the common clock, those of the nearest frame, empty where there is none; returns where
    they are."""
    import shutil

    import numpy as np

    from hypose.io.sensors.depth import write_depth_png
    from hypose.io.videos.video import frame_size, list_images

    files, (width, height) = list_images(depth), frame_size(depth)
    for i in range(len(frames)):
        nearest = round(i + late)
        if 0 <= nearest < len(frames):
            shutil.copyfile(files[frames[nearest]], folder / f"{i:06d}.png")
        else:
            write_depth_png(folder / f"{i:06d}.png", np.zeros((height, width)))
    return folder


def _people(found: RecordedPerson | None) -> list[Array]:
    """(C, T, K, 3) px of the calibrated pictures: of the person whom the recording is about, then of the others whom
    several views show; empty where there are no key points."""
    import numpy as np

    if found is None:
        return []
    out = [found.raw]
    for one in found.one.people[1:]:
        raw = np.zeros_like(found.raw)
        raw[:, one.first : one.last + 1] = one.points[..., [3, 4, 2]].transpose(1, 0, 2, 3)
        out.append(raw)
    return out
