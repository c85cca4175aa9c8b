"""`hypose correct`: correct a tracked motion. Tracking starts again from a clicked pose in one frame.

The old result stays unchanged. In the new one, the frames after the correction (and before it, backwards, as far as the
correction says) are tracked from the corrected pose with the same body, recipe and evidence; all other frames are those
of the old result.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from hypose.app.commands.console import ProgressCall, Stages, each, say
from hypose.app.jobs.job import compile_before, split_names
from hypose.app.reports.report import write_report
from hypose.app.reports.report_parts import require_found
from hypose.app.studio.view_bundle import find_recording, load_view
from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.errors import InputError
from hypose.evidence.frame import Frame
from hypose.geometry import Array
from hypose.io.files import check_writable, claimed, read_json
from hypose.io.motions.export import export_motion
from hypose.io.motions.results import load_body, load_motion
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import Recording
from hypose.options import MOST_FRAMES, Formats, Option, Threads
from hypose.pipeline.assessment import later, list_changes, trace_of, with_trace
from hypose.pipeline.recorded_frames import frames_wanted
from hypose.pipeline.run import TrackResult
from hypose.pipeline.sources import FrameSource
from hypose.pipeline.subject import GIVEN, SubjectOptions, TrackedSubject, find_subject
from hypose.pipeline.track import track_source
from hypose.pipeline.track_management import per_frame
from hypose.pipeline.track_options import TrackOptions

_READ_AT_ONCE = 64
"""Frames that are kept in memory for tracking backwards."""
_FROM_HERE = "the start is the corrected pose"


@dataclass(frozen=True)
class Correction:
    """Corrected pose of one frame.

    frame: number in the recording.
    pose: (D,) corrected pose, rad and m.
    name: name of the saved clicks.
    since: first frame to track again, backwards from `frame`; None: `frame`.
    until: frame after the last to track again; None: the end of the recording.
    """

    frame: int
    pose: Array
    name: str
    since: int | None = None
    until: int | None = None


def read_correction(path: Path) -> Correction:
    """Load the clicks of a frame with their pose, as the studio saves them (starts/NAME.json).

    Raises: InputError where the file holds no usable pose.
    """
    with contextlib.suppress(ValueError, TypeError, KeyError):
        value = read_json(path, "saved clicks")
        pose, frames = (
            np.array(value["pose"], dtype=np.float64),
            [value["frame"], value.get("since"), value.get("until")],
        )
        whole = type(frames[0]) is int and all(type(f) is int and f >= 0 for f in frames if f is not None)
        if value["format"] == "hypose-clicks" and whole and pose.ndim == 1 and np.isfinite(pose).all():
            return Correction(frames[0], pose, path.stem, *frames[1:])
    raise InputError(f"{path} holds no corrected pose; correct a frame in `hypose view` and save it there.")


def correct(
    results: Annotated[Path, Option("Results folder of hypose track.", argument=True)],
    clicks: Annotated[Path, Option("The corrected pose: starts/NAME.json, saved in hypose view.", argument=True)],
    until: Annotated[
        int | None, Option("Track again up to this frame of the recording. [default: to the end]", 1, MOST_FRAMES)
    ] = None,
    out: Annotated[Path | None, Option("Results folder. [default: RESULTS-corrected]")] = None,
    formats: Formats = "trc,c3d,bvh,glb,csv,mot",
    threads: Threads = None,
) -> None:
    """Track a result again from a frame whose pose was corrected; other frames stay unchanged."""
    recording = find_recording(results)
    if recording is None:
        raise InputError(f"{results} lies in no recording; give the results folder inside the recording's folder.")
    folder = out or results.with_name(f"{results.name}-corrected")
    correction, names = read_correction(clicks), split_names(formats)
    if until is not None:
        correction = replace(correction, until=until)
    with claimed(folder), Stages() as progress:
        if folder.resolve() == results.resolve():
            raise InputError("The corrected motion needs a folder of its own; choose another with --out.")
        check_writable(folder)
        motion, body = _tracked_again(recording, results, correction, progress)
        TrackResult(motion, body, True, ()).save(folder)
        for name in each(progress, "export", names):
            export_motion(motion, body, folder, (name,))
        for path in each(progress, "report", [folder / "report.html"]):
            write_report(path, load_view(folder, recording))
    say(f"Frames {correction.frame} and after tracked again, {int(motion.lost.sum())} of {len(motion)} frames lost.")
    say(f"Results: {folder}")
    require_found(motion, recording.name, folder)


def _tracked_again(
    recording: Recording, old: Path, correction: Correction, progress: ProgressCall
) -> tuple[Motion, Body]:
    """Track a result again from a corrected frame; return the whole motion and the body.

    old: folder of the result.
    correction: corrected pose, and the frames to track again.
    Raises: InputError where the correction does not fit the result.
    """
    motion, body = load_motion(old / "motion.npz"), load_body(old / "body.npz")
    options, first = _options(motion, old)
    start, row, stop = _rows(motion, correction, first)
    if len(correction.pose) != body.skeleton.dof:
        raise InputError(f"{correction.name} is the pose of another body; correct a frame of {old} itself.")
    compile_before(progress)
    record: dict[str, Any] = {"frame": correction.frame, "until": first + stop}
    record |= {"clicks": correction.name, "of": old.name}
    # the corrected pose also defines left and right
    sure, joined = replace(options, sure_start=True), motion

    def tracked(frames: range, turned: bool) -> Motion:
        part = replace(recording, frame_range=(frames.start, frames.stop))
        with FrameStream(part, frames_wanted(part, options)) as stream:
            source = Backwards(stream) if turned else stream
            subject = _subject(source, part, options, body, correction.pose)
            found = track_source(source, motion.frame_rate, sure, subject=subject, progress=progress).motion
        return _time_reversed(found) if turned else found

    if start < row:
        record["since"] = first + start
        joined = join(joined, tracked(range(first + start, first + row + 1), True), start, None)
    return join(joined, tracked(range(first + row, first + stop), False), row, record), body


class Backwards:
    """Frames of a stream in reverse order, with increasing times. The stream is read forwards in blocks, since videos
    are slow to read in another order.
    """

    def __init__(self, stream: FrameStream) -> None:
        self._stream = stream
        self._kept: dict[int, Frame] = {}

    def __len__(self) -> int:
        return len(self._stream)

    def frame(self, index: int, /) -> Frame:
        """Return frame `index` in reverse order; its number and time count upwards, as if the clip ran backwards."""
        number = len(self._stream) - 1 - index
        if number not in self._kept:
            first = number - number % _READ_AT_ONCE
            self._kept = {i: self._stream.frame(i) for i in range(first, number + 1)}
        turned = self._stream.frames[-1] + index
        return replace(self._kept[number], index=turned, time=turned / self._stream.recording.frame_rate)


def _time_reversed(motion: Motion) -> Motion:
    """Reverse the frames of a motion, but not its times."""
    n = len(motion)
    trace = [replace(c, frames=range(n - c.frames.stop, n - c.frames.start)) for c in trace_of(motion)]
    turned = replace(motion, **per_frame(motion, np.arange(n)[::-1]) | {"times": motion.times})
    return with_trace(turned, trace)


_UNKNOWN = {
    **dict.fromkeys(("poses", "joints", "joint_covariance", "lost", "extrapolated", "n_views", "cost"), np.nan),
    **{"low_confidence": False, "low_confidence_joints": False, "error_probability": np.nan, "angle_sd": np.nan},
    **{"systematic_covariance": 0.0, "rivals": np.nan, "rival_weights": 0},
}
"""Arrays of a motion with one row per frame, and their values where a part of the motion has none."""


def join(old: Motion, new: Motion, row: int, record: Mapping[str, Any] | None) -> Motion:
    """Replace rows of a motion by those of another one.

    row: row of `old` in which `new` begins.
    record: added to the corrections in the provenance; None: nothing is added.
    Returns: the joined motion. Values that `new` does not have are those of `_UNKNOWN` in its rows.
    """
    series, stop = {}, row + len(new)
    if old.low_confidence is None and new.low_confidence is not None:
        old = replace(old, low_confidence=np.zeros(len(old), dtype=bool))
    for name, unknown in _UNKNOWN.items():
        before, after = getattr(old, name), getattr(new, name)
        if before is not None:
            series[name] = before.copy()
            reported = after is not None and after.shape == before[row:stop].shape
            series[name][row:stop] = after if reported else unknown
    if row:  # one branch of the root's rotation, so that interpolation between the two parts does not turn around
        poses = series["poses"]
        for t in range(row, stop):
            poses[t] = old.skeleton.on_branch(poses[t], poses[t - 1])
    corrections = [*old.provenance.get("corrections", []), *([] if record is None else [dict(record)])]
    joined = replace(old, **series, provenance={**old.provenance, "corrections": corrections})
    moved = np.linalg.norm(joined.joints - old.joints, axis=-1)
    corrected = list_changes(
        "correct", old.skeleton.joint_names, moved, "tracked again from a pose that a person corrected"
    )
    return with_trace(joined, [*trace_of(old), *later(trace_of(new), row), *corrected])


def _options(motion: Motion, old: Path) -> tuple[TrackOptions, int]:
    """Read how a result was tracked.

    old: its folder, for the error.
    Returns: options of tracking, and the number of its first frame.
    Raises: InputError where it cannot be tracked again.
    """
    settings = motion.provenance.get("settings", {})
    known = {f.name for f in fields(TrackOptions)} - {"start", "subject", "height"}
    frames = settings.get("frames")
    options = TrackOptions(**{k: v for k, v in settings.items() if k in known})
    if motion.poses is None or not frames or "recipe" not in settings or options.of_picture:
        raise InputError(
            f"{old} was not tracked by `hypose track` with several cameras, so it cannot be tracked on from a "
            "corrected frame; with one camera start it again: hypose track --recipe monocular --start CLICKS."
        )
    return options, int(frames[0])


def _rows(motion: Motion, correction: Correction, first: int) -> tuple[int, int, int]:
    """Compute the rows of a motion to track again.

    first: number of the frame in row 0.
    Returns: the first row, the corrected one, and the one after the last.
    Raises: InputError where they are outside the result.
    """
    last = first + len(motion)
    stop = last if correction.until is None else correction.until
    since = correction.frame if correction.since is None else correction.since
    if not first <= since <= correction.frame < stop <= last:
        raise InputError(
            f"The frames {since} to {stop} are not part of this result, which has the frames {first} to "
            f"{last - 1}; correct one of these, and end at most at {last}."
        )
    return since - first, correction.frame - first, stop - first


def _subject(source: FrameSource, part: Recording, options: TrackOptions, body: Body, pose: Array) -> TrackedSubject:
    """Make the subject that tracking starts with: the known body at the corrected pose, with the places of key points
    where they are evidence.

    source: frames to track.
    part: recording limited to these frames.
    pose: (D,) corrected pose.
    """
    if options.looks_at == "silhouettes":
        return TrackedSubject(body, None, pose, (GIVEN, _FROM_HERE))
    wanted = SubjectOptions("keypoints", girths=False, body=body, frame_rate=part.frame_rate, seed=options.seed)
    return replace(find_subject(source.frame, len(source), wanted), start=pose, notes=(GIVEN, _FROM_HERE))
