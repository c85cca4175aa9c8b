"""`hypose sync`: find how late each camera of a recording is, and write its evidence on one clock."""

from __future__ import annotations

import contextlib
import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from hypose.app.commands.console import ProgressCall, Stages, each, say
from hypose.app.options import SyncCommand
from hypose.calibration.sync_motion import at_the_end, offsets_within
from hypose.calibration.synchronisation import (
    Resampled,
    offsets_from_light,
    offsets_from_motion,
    offsets_from_sound,
    points_at,
)
from hypose.errors import EvidenceError, InputError
from hypose.evidence.frame import Silhouettes
from hypose.evidence.keypoint_check import undistorted
from hypose.evidence.keypoints import openpose_document
from hypose.geometry import Array
from hypose.io.files import check_writable, claimed, file_name, folder_for, write_text
from hypose.io.recordings.frames import RecordedPerson, mask_folder, write_frame_masks
from hypose.io.recordings.recording import Recording, load_recording, write_recording
from hypose.io.recordings.recording_views import ViewSettings
from hypose.io.sensors.depth import write_depth_png
from hypose.io.videos.video import frame_size, list_images, open_video, read_sound, writing_video
from hypose.pipeline.recorded_frames import frames_to_examine
from hypose.pipeline.recording_diagnostics import (
    observe_recording,
    raw_person,
)


def sync(c: SyncCommand) -> None:
    """Find how late each camera is, or write the evidence on one clock (`hypose sync`)."""
    begun = ("masks", "depth", "keypoints", "videos", "results")  # what this command writes before recording.toml
    if (
        c.out is not None
        and c.out.exists()
        and not (c.out.is_dir() and all(p.name in begun or p.name[0] == "." for p in c.out.iterdir()))
    ):
        raise InputError(f"{c.out} is not empty; give a new folder with --out.")
    loaded = load_recording(c.recording)
    if len(loaded.views) < 2:
        raise InputError("One view needs no synchronisation; the recording has only one.")
    if c.out is not None:
        check_writable(c.out)
    with Stages() as progress:
        if c.offsets is not None:
            late, words = _given(c.offsets, loaded), ["as given"] * len(loaded.views)
        elif c.by == "motion":
            late, words = _by_motion(loaded, c.largest, c.frames, progress)
        elif c.by == "sound":
            late, words = _by_sound(loaded, c.largest or _LARGEST_S[-1])
        else:
            late, words = _by_light(loaded, progress)
    for view, x, word in zip(loaded.views, late, words, strict=True):
        say(f"{view.name}: {abs(x):.2f} frames {'late' if x >= 0 else 'early'} ({word})")
    if c.out is None:
        keep_offsets(loaded, c.by if c.offsets is None else "given", late, words)
        say(f"To bring the evidence in step: hypose sync {c.recording} --out NEW_FOLDER")
        return
    with claimed(c.out), Stages() as progress:
        path = _write(loaded, late, c.out, progress)
    say(f"Evidence in step: {path}", "green")


def keep_offsets(
    recording: Recording, by: str, late: list[float], words: list[str], folder: Path | None = None
) -> None:
    """Write results/sync.json for the studio; where it cannot be written, only the printed text remains.

    by: how the offsets were found.
    late: frames by which each view is late.
    words: uncertainty of each, as a text.
    folder: instead of the recording's folder.
    """
    views = [{"name": v.name, "late": x, "how": w} for v, x, w in zip(recording.views, late, words, strict=True)]
    with contextlib.suppress(OSError, InputError):
        write_text(
            (folder or recording.folder) / "results" / "sync.json", json.dumps({"by": by, "views": views}) + "\n"
        )


def _given(text: str, recording: Recording) -> list[float]:
    """Parse the option --offsets.

    Returns: frames by which each view is late.
    Raises: InputError where they are no numbers, not one per view, or leave no frame in common.
    """
    count = len(recording.views)
    try:
        out = [float(x) for x in text.split(",")]
    except ValueError:
        raise InputError(
            f"--offsets {text} are no numbers; write frames separated by commas, for example 0,-2.5,1."
        ) from None
    if len(out) != count or not np.abs(out).max() <= 1e5:
        raise InputError(f"--offsets {text}: {count} numbers of frames are needed, one per view.")
    if max(out) - min(out) >= len(recording.frames):
        raise InputError(
            f"--offsets {text}: views so far apart have no frame in common, since the recording has "
            f"{len(recording.frames)}; give frames, not milliseconds or frame numbers."
        )
    return out


_LARGEST_S = (0.5, 2.0, 10.0)
"""Largest offsets that are tried one after the other where the user gives none, s."""


def _by_motion(
    recording: Recording, largest_s: float | None, frames: int, progress: ProgressCall
) -> tuple[list[float], list[str]]:
    """Find how late each view is from the motion of the person, with growing ranges of search.

    largest_s: largest delay that is searched, s; None: 0.5, 2 and 10 s are tried in turn until all delays are certain.
    frames: number of frames that are used, at least.
    Returns: delay of each view in frames, and a text on the certainty of each.
    Raises: EvidenceError where the motion does not determine the delays.
    """
    rate = recording.frame_rate
    within = [s for s in _LARGEST_S if 3 * s * rate <= len(recording.frames)] or _LARGEST_S[:1]
    *nearer, last = [largest_s] if largest_s else within
    for seconds in nearer:
        with contextlib.suppress(EvidenceError):
            late, words, sure = _by_motion_within(recording, seconds * rate, frames, progress)
            if sure:
                return late, words
    return _by_motion_within(recording, last * rate, frames, progress)[:2]


def _by_motion_within(
    recording: Recording, largest: float, frames: int, progress: ProgressCall
) -> tuple[list[float], list[str], bool]:
    """Find how late each view is from the motion of the person.

    largest: largest delay that is searched, frames.
    frames: number of frames that are used, at least.
    Returns: delay of each view in frames, a text on the certainty of each, and whether all delays are certain and
        clearly smaller than `largest`.
    Raises: EvidenceError where the motion does not determine the delays.
    """
    seen = observe_recording(recording, max(frames, math.ceil(4 * largest)), progress)
    points = undistorted(seen.rig, seen.keypoints)
    found = offsets_from_motion(seen.rig.pinhole(), points, seen.silhouettes, largest=largest)
    known = found.sd < largest  # unknown where the deviation exceeds the search range
    if found.gain < 0 or not known.any():
        raise EvidenceError(
            f"{recording.name}: the views have no motion in common that tells how late they are; film a person who "
            "walks or waves, or use --by sound or --by flash."
        )
    pairs = zip(found.sd, known, strict=True)
    words = [f"sd {sd:.2f}" if sure else "no motion in common with the others" for sd, sure in pairs]
    reach = offsets_within(largest, max(seen.keypoints.shape[1], len(seen.silhouettes)))
    ended = at_the_end(found, reach)
    if ended:
        what = "a larger --largest" if reach >= largest - 0.5 else "more frames, and a larger --largest"
        words[0] += f"; views are {reach:.1f} frames apart or more: give {what}"
    return found.frames.tolist(), words, bool(known.all()) and not ended


def _by_sound(recording: Recording, largest: float) -> tuple[list[float], list[str]]:
    """Find how late each view is from the sound of its video.

    largest: largest delay that is searched, s.
    Returns: delay of each view in frames, and a text on the certainty of each.
    Raises: InputError where a view has no video.
    """
    videos = {v.name: v.files.get("video") for v in recording.views}
    if silent := [name for name, video in videos.items() if video is None]:
        raise InputError(f"View {silent[0]} has no video and so no sound; use --by motion.")
    sounds = [read_sound(video) for video in videos.values() if video is not None]
    seconds, peaks = offsets_from_sound(sounds, list(videos), largest)
    return (seconds * recording.frame_rate).tolist(), [f"peak {p:.0f} sd" for p in peaks]


def _by_light(recording: Recording, progress: ProgressCall) -> tuple[list[float], list[str]]:
    """Find how late each view is from changes of the light, such as a flash.

    Returns: delay of each view in frames, and a text on what was compared.
    Raises: InputError where a view has masks alone.
    """
    levels = []
    for view in each(progress, "sync", recording.views):
        if view.source is None:
            raise InputError(f"View {view.name} has only masks, in which no light is seen; use --by motion.")
        with open_video(view.source, rate=view.rate) as reader:
            levels.append(np.array([float(image[::8, ::8].mean()) for image in reader]))
    late, kinds = offsets_from_light(levels, [v.name for v in recording.views])
    return late.tolist(), list(kinds)


def _write(recording: Recording, late: list[float], folder: Path, progress: ProgressCall) -> Path:
    """Write masks (PNG, undistorted), depth maps, key points (OpenPose JSON) and videos on a common clock.

    late: frames by which each view is late.
    folder: new folder of the recording.
    Returns: path of the new recording.toml.
    """
    stream, _ = frames_to_examine(recording, progress)
    with stream:
        source = Resampled(stream, late)
        named = zip(recording.views, stream.rig, strict=True)
        masks = {
            k: mask_folder(folder / "masks", v.name, c) for k, (v, c) in enumerate(named) if "depth" not in v.files
        }
        for i in each(progress, "masks", range(len(source))):
            write_frame_masks(source.frame(i).the(Silhouettes), masks, i)
    people = _people(raw_person(recording))
    views = []
    for c, view in enumerate(recording.views):
        files = dict[str, Path]()
        if people and "keypoints" in view.files:
            files["keypoints"] = keypoints = folder_for(folder / "keypoints", view.name)
            for t, shown in enumerate(zip(*(points_at(p[c], late[c]) for p in people), strict=True)):
                write_text(
                    keypoints / f"{keypoints.name}_{t:012d}_keypoints.json", json.dumps(openpose_document(shown)) + "\n"
                )
        if c in masks:
            files["masks"] = masks[c]
            if view.source is not None:
                files["video"] = _video_in_step(view, recording, late[c], folder / "videos")
        else:
            own = folder_for(folder / "depth", view.name)
            files |= {k: view.files[k] for k in view.files.keys() & {"background"}}
            files["depth"] = _depth_in_step(view.files["depth"], recording.frames, late[c], own)
        views.append(replace(view, files=files))
    first, stop = math.ceil(max(0.0, -min(late))), len(recording.frames) - math.ceil(max(0.0, *late))
    made = replace(
        recording,
        views=tuple(views),
        frame_range=(first, stop) if (first, stop) != (0, len(recording.frames)) else None,
        n_frames=len(recording.frames),
        keypoint_lag=0,
        keypoint_pixels="calibration",
        name=f"{recording.name} in step",
    )
    keep_offsets(made, "given", [0.0] * len(views), ["in step"] * len(views), folder)
    return write_recording(made, folder)


def _video_in_step(view: ViewSettings, recording: Recording, late: float, folder: Path) -> Path:
    """Write the pictures of a view on the common clock, each from the nearest frame of its video.

    late: frames by which the view is late.
    folder: folder of the video.
    Returns: path of the video.
    """
    assert view.source is not None
    path, frames = folder / f"{file_name(view.name)}.mp4", recording.frames
    folder.mkdir(parents=True, exist_ok=True)
    with (
        open_video(view.source, rate=view.rate) as reader,
        writing_video(path, recording.frame_rate, reader.size) as writer,
    ):
        for i in range(len(frames)):
            writer.write(reader.read(frames[min(max(round(i + late), 0), len(frames) - 1)]))
    return path


def _depth_in_step(depth: Path, frames: range, late: float, folder: Path) -> Path:
    """Copy the depth maps of a folder to the common clock, each from the nearest frame; empty maps where there is none.

    depth: folder of the maps.
    frames: numbers of the frames of the recording.
    late: frames by which the view is late.
    folder: new folder, which is returned.
    """
    files, (width, height) = list_images(depth), frame_size(depth)
    for i in range(len(frames)):
        nearest = round(i + late)
        if 0 <= nearest < len(frames):
            shutil.copyfile(files[frames[nearest]], folder / f"{i:06d}.png")
        else:
            write_depth_png(folder / f"{i:06d}.png", np.zeros((height, width)))
    return folder


def _people(found: RecordedPerson) -> list[Array]:
    """Collect the key points (C, T, K, 3) px of the calibrated pictures: first of the main person, then of others seen
    by several views; empty without key points.
    """
    out = [found.raw] if found.keypoints else []
    for one in found.one.people[1:]:
        out.append(np.zeros_like(found.raw))
        out[-1][:, one.first : one.last + 1] = one.points[..., [3, 4, 2]].transpose(1, 0, 2, 3)
    return out
