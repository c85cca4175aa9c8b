"""`hypose sync`: how late is each camera, and a copy of the recording's evidence that is in step."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hypose.app.commands.console import Stages, say
from hypose.app.commands.options import number
from hypose.errors import EvidenceError, InputError

if TYPE_CHECKING:
    from hypose.app.commands.console import ProgressCall
    from hypose.geometry import Array
    from hypose.io.recordings.recording import Recording
    from hypose.io.recordings.recording_people import RecordedPerson


def sync(
    recording: Annotated[Path, typer.Argument(help="Folder with recording.toml, that file, or a Pose2Sim project.")],
    by: Annotated[str, typer.Option(help="motion, sound or flash.")] = "motion",
    offsets: Annotated[str | None, typer.Option(help="Known offsets in frames instead, one per view: 0,-2.5,1")] = None,
    largest: Annotated[
        float, number("Largest offset that is looked for, in seconds.", 0, 600, above=True, unit="seconds")
    ] = 0.5,
    frames: Annotated[int, number("Consecutive frames that motion is taken from.", 24, 100_000)] = 250,
    to: Annotated[
        Path | None, typer.Option("--out", help="New folder for masks, depth maps and key points that are in step.")
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
        _keep(loaded, by if offsets is None else "given", late, words)
        say(f"To bring the evidence in step: hypose sync {recording} --out NEW_FOLDER")
        return
    with claimed(to), Stages() as progress:
        path = _write(loaded, late, to, progress)
    say(f"Evidence in step: {path}", "green")


def _keep(recording: Recording, by: str, late: list[float], words: list[str]) -> None:
    """results/sync.json, for the studio; where it cannot be written, what was said has to do."""
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
    from hypose.pipeline.examine import observe

    seen = observe(recording, frames, progress)
    points = None if seen.keypoints is None else undistorted(seen.rig, seen.keypoints)
    found = offsets_from_motion(seen.rig.pinhole(), points, seen.silhouettes, largest=largest)
    if found.gain < 0:
        raise EvidenceError("The motion does not tell the offsets; use --by sound or --by flash.")
    told = [s < largest for s in found.sd]  # what is less sure than all that was looked for is not known
    if not any(told):
        raise EvidenceError(
            f"{recording.name}: the views have no motion in common that tells how late they are; film somebody who "
            "walks or waves, or use --by sound or --by flash."
        )
    words = [
        f"sd {s:.2f}" if known else "no motion in common with the others"
        for s, known in zip(found.sd, told, strict=True)
    ]
    total = points[0].shape[1] if points is not None else len(seen.silhouettes or ())
    reach = offsets_within(largest, total)
    if at_the_end(found, reach):
        what = "a larger --largest" if reach >= largest - 0.5 else "more frames, and a larger --largest"
        words[0] += f"; views are {reach:.1f} frames apart or more: give {what}"
    return [float(x) for x in found.frames], words


def _by_sound(recording: Recording, largest: float) -> tuple[list[float], list[str]]:
    from hypose.calibration.synchronisation import offsets_from_sound
    from hypose.io.videos.sound import read_sound

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
        with open_video(view.source) as reader:
            levels.append(np.array([float(image[::8, ::8].mean()) for image in reader]))
    progress("sync", len(recording.views), len(recording.views))
    late, kinds = offsets_from_light(levels, [v.name for v in recording.views])
    return [float(x) for x in late], list(kinds)


def _write(recording: Recording, late: list[float], folder: Path, progress: ProgressCall) -> Path:
    """Masks (PNG, undistorted), depth maps and key points (OpenPose JSON) on the common clock, and a recording.toml."""
    from dataclasses import replace

    import cv2
    import numpy as np

    from hypose.calibration.synchronisation import Resampled, points_at
    from hypose.io.file_names import folder_for
    from hypose.io.files import write_bytes, write_text
    from hypose.io.recordings.recording import write_recording
    from hypose.io.recordings.view_source import SIDECAR
    from hypose.pipeline.examine import raw_person
    from hypose.pipeline.one_of_several import frames_to_examine

    progress("background", 0, 1)
    stream, _ = frames_to_examine(recording)
    with stream:
        progress("background", 1, 1)
        source = Resampled(stream, late)
        masks = [None if v.depth is not None else folder_for(folder / "masks", v.name) for v in recording.views]
        for path, camera in zip(masks, stream.rig, strict=True):
            if path is not None:
                write_text(path / SIDECAR, json.dumps({"undistorted": True, "size": list(camera.size)}) + "\n")
        for i in range(len(source)):
            progress("masks", i, len(source))
            silhouettes = source.frame(i).silhouettes
            assert silhouettes is not None
            for c, (path, camera) in enumerate(zip(masks, stream.rig, strict=True)):
                if path is None:
                    continue
                w, h = camera.size
                data = cv2.imencode(".png", silhouettes.masks[c, :h, :w] * np.uint8(255))[1]
                write_bytes(path / f"{i:06d}.png", data.tobytes(), synced=False)
        progress("masks", len(source), len(source))
    people = _people(raw_person(recording))
    views = []
    for c, view in enumerate(recording.views):
        keypoints = None
        if people and view.keypoints is not None:
            keypoints = folder_for(folder / "keypoints", view.name)
            for t, shown in enumerate(zip(*(points_at(p[c], late[c]) for p in people), strict=True)):
                said = [
                    {"pose_keypoints_2d": [round(float(x), 4) for x in p.ravel()]} for p in shown if (p[:, 2] > 0).any()
                ]
                write_text(keypoints / f"{keypoints.name}_{t:012d}_keypoints.json", json.dumps({"people": said}) + "\n")
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
    several views show; nobody without key points."""
    import numpy as np

    if found is None:
        return []
    out = [found.raw]
    for one in found.one.people[1:]:
        raw = np.zeros_like(found.raw)
        raw[:, one.first : one.last + 1] = one.points[..., [3, 4, 2]].transpose(1, 0, 2, 3)
        out.append(raw)
    return out
