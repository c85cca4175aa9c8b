"""Speed of the whole path, masks or video files in and poses out, against merely decoding the videos."""

from __future__ import annotations

import gc
import resource
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.multiview.action_scenes import action_scene, known_subject
from benchmarks.multiview.real_recordings import balancing_recording
from hypose.compute.threads import default_threads
from hypose.evidence.background import BackgroundModel
from hypose.evidence.frame import Frame
from hypose.evidence.outlines import WORKING_HEIGHT
from hypose.evidence.prefetch import look_ahead
from hypose.evidence.terms import contour_term
from hypose.io.recordings.frames import FrameSettings, FrameStream, build_backgrounds
from hypose.io.recordings.recording import Recording, load_recording
from hypose.io.videos.video import open_video, writing_video
from hypose.pipeline.subject import SubjectOptions, TrackedSubject, find_subject
from hypose.synthetic.scenes import Scene
from hypose.synthetic.write_recording import write_scene
from hypose.tracking.frame_evidence import keypoint_model
from hypose.tracking.keypoint_clip import solve_keypoint_clip
from hypose.tracking.recipes import recipe
from hypose.tracking.tracker import Tracker, TrackerSettings

_PRESETS = ("default", "hpf", "apf")


@dataclass(frozen=True)
class _Cost:
    """Seconds per frame: by the clock, and of processor time over all threads."""

    wall: float
    cpu: float


def _cost(call: Callable[[], int], repeats: int) -> _Cost:
    """Least cost per frame of some calls that return how many frames they did: what other load disturbs least."""
    walls, cpus = [], []
    for _ in range(repeats):
        gc.collect()
        wall, cpu = time.perf_counter(), time.process_time()
        n = call()
        walls.append((time.perf_counter() - wall) / n)
        cpus.append((time.process_time() - cpu) / n)
    return _Cost(min(walls), min(cpus))


def multiview_speed(options: BenchOptions) -> BenchReport:
    """Frames per second of whole tracking (masks in, or video files in) per preset, and decode_ratio.

    decode_ratio CASE: processor time from video files to prepared evidence (masks, distances, outlines) over that of
    decoding alone. decode_ratio CASE, poses: time by the clock from video files to poses over that of decoding alone.

    With --data also the balancing clip, whose videos are 1080p.
    """
    seconds = 0.6 if options.quick else 4.0
    repeats = 2 if options.quick else 6  # the first warms up, and others share the machine
    scene = action_scene("walk", 0, seconds, options)
    known = known_subject(scene)
    frames = list(scene.mask_frames(1.0))
    rows = _masks_in(options, scene, known, frames, repeats)
    rows += _keypoint_clip_rows(scene, known, repeats)
    with tempfile.TemporaryDirectory() as folder:
        options.progress("videos", 0, 1)
        small = load_recording(write_scene(scene, Path(folder) / "480p").parent)

        rows += videos_in("480p", small, known, repeats)
        rows += videos_in("1080p", enlarged(small, Path(folder) / "1080p", 2.25), known, repeats)
    if options.data is not None and (options.data / "pose2sim_balancing").exists():
        options.progress("balancing", 0, 1)
        real = balancing_recording(options.folder("pose2sim_balancing"))
        with FrameStream(real, FrameSettings(masks=False)) as points:
            chosen = SubjectOptions("keypoints", frame_rate=real.frame_rate, girths=False)
            person = find_subject(points.frame, len(points), chosen)
        without = balancing_recording(options.folder("pose2sim_balancing"), keypoints=False)
        rows += videos_in("balancing 1080p", without, person, repeats)
    rows.append(Row("peak_memory_mib", "all", _peak_mib(), "MiB"))
    return BenchReport(tuple(rows), {"views": 4, "seconds": seconds, "repeats": repeats})


def _masks_in(
    options: BenchOptions, scene: Scene, subject: TrackedSubject, frames: list[Frame], repeats: int
) -> list[Row]:
    rows = []
    for preset in _PRESETS[:1] if options.quick else _PRESETS:
        options.progress(preset, 0, 1)
        cost = _cost(lambda p=preset: follow(look_ahead(anew(frames)), subject, scene.frame_rate, p), repeats)
        rows.append(Row("frames_per_second", f"masks:{preset}/4", 1 / cost.wall, "1/s", n=len(frames)))
        rows.append(Row("cpu_ms_per_frame", f"masks:{preset}/4", 1e3 * cost.cpu, "ms", n=len(frames)))

    return rows


def _keypoint_clip_rows(scene: Scene, subject: TrackedSubject, repeats: int) -> list[Row]:
    """frames_per_second and cpu_ms_per_frame of `solve_keypoint_clip` (key points in, poses of all frames out), the
    least of some runs; 25 key points in every view, half-size pictures."""
    seen = [f.keypoints for f in scene.mask_frames(0.5, keypoints=True)]
    names = next(k.names for k in seen if k is not None)
    model = keypoint_model(subject.body, names)

    def solve() -> int:
        solve_keypoint_clip(subject.body, model, seen, subject.start, scene.frame_rate)
        return len(seen)

    solve()  # loads the kernels
    cost = _cost(solve, repeats)
    case = f"keypoints:clip/{len(scene.rig)}"
    return [
        Row("frames_per_second", case, 1 / cost.wall, "1/s", n=len(seen)),
        Row("cpu_ms_per_frame", case, 1e3 * cost.cpu, "ms", n=len(seen)),
    ]


def anew(frames: Iterable[Frame]) -> Iterator[Frame]:
    """The same frames as new objects: what is made ahead is kept with the silhouettes."""
    for frame in frames:
        assert frame.silhouettes is not None
        yield replace(frame, silhouettes=replace(frame.silhouettes))


def follow(frames: Iterable[Frame], subject: TrackedSubject, rate: float, preset: str) -> int:
    """Track the frames by a preset; how many frames there were."""
    made = recipe(preset, subject.body, frame_rate=rate)

    tracker = Tracker(subject.body, made, TrackerSettings(frame_rate=rate), subject.keypoints)
    return sum(1 for _ in tracker.follow(tracker.start(subject.start), frames))


def videos_in(case: str, recording: Recording, subject: TrackedSubject, repeats: int) -> list[Row]:
    """Rows of one recording: opening, decoding, evidence, and all of it with the tracker."""
    begin = time.perf_counter(), time.process_time()
    backgrounds = build_backgrounds(recording)
    opening = time.perf_counter() - begin[0], time.process_time() - begin[1]
    with FrameStream(recording, None, backgrounds) as warm:
        first = warm.frame(0)
        assert first.silhouettes is not None
        contour_term(first.silhouettes)
    decoding = _cost(lambda: _decode(recording), repeats)
    evidence = _cost(lambda: _prepare(recording, backgrounds), repeats)
    rate = recording.frame_rate
    whole = _cost(lambda: follow(look_ahead(frames_of(recording, backgrounds)), subject, rate, "default"), repeats)
    n = len(recording.frames)
    against = {"baseline": "decoding the videos alone", "baseline_value": 1 / decoding.wall}
    return [
        Row("frames_per_second", f"{case}:default/4", 1 / whole.wall, "1/s", n=n, **against),
        Row("frames_per_second", f"{case}:evidence/4", 1 / evidence.wall, "1/s", n=n, **against),
        Row("cpu_ms_per_frame", f"{case}:decoding", 1e3 * decoding.cpu, "ms", n=n),
        Row("cpu_ms_per_frame", f"{case}:evidence", 1e3 * evidence.cpu, "ms", n=n),
        Row("decode_ratio", case, evidence.cpu / decoding.cpu, "1", n=n),
        Row("decode_ratio", f"{case}, poses", whole.wall / decoding.wall, "1", n=n),
        Row("opening_seconds", case, opening[0], "s"),
        Row("opening_cpu_seconds", case, opening[1], "s"),
    ]


def _decode(recording: Recording) -> int:
    """Every view in its own thread, as in the stream of frames, and as sparingly."""
    threads = max(1, default_threads() // len(recording.views))

    def read(path: Path) -> None:
        with open_video(path, threads) as reader:
            memory = None
            for i in recording.frames:
                memory = reader.read(i, memory)

    with ThreadPoolExecutor(len(recording.views)) as pool:
        list(pool.map(read, [v.source for v in recording.views if v.source is not None]))
    return len(recording.frames)


def frames_of(recording: Recording, backgrounds: tuple[BackgroundModel | None, ...]) -> Iterator[Frame]:
    """The frames with their silhouettes, from the videos."""
    with FrameStream(recording, None, backgrounds) as stream:
        yield from stream


def _prepare(recording: Recording, backgrounds: tuple[BackgroundModel | None, ...]) -> int:
    for frame in frames_of(recording, backgrounds):
        if frame.silhouettes is not None and frame.silhouettes.usable.any():
            contour_term(frame.silhouettes, working_height=WORKING_HEIGHT)
    return len(recording.frames)


def enlarged(recording: Recording, folder: Path, factor: float) -> Recording:
    """The same recording with videos enlarged by a factor."""
    folder.mkdir(parents=True)
    views = []
    for view in recording.views:
        made = dict(view.files)
        for kind in ("video", "background"):
            made[kind] = folder / f"{view.name}-{kind}.mp4"
            with open_video(view.files[kind]) as reader:
                size = (round(reader.size[0] * factor) // 2 * 2, round(reader.size[1] * factor) // 2 * 2)
                with writing_video(made[kind], recording.frame_rate, size) as writer:
                    for picture in reader:
                        writer.write(np.asarray(cv2.resize(picture, size), dtype=np.uint8))
        views.append(replace(view, files=made))
    return replace(recording, views=tuple(views))


def _peak_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
