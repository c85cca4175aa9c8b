"""What an NVIDIA device does for the particle filters: speed against the processor beside it, and the same results."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.multiview.action_scenes import ACTIONS, action_scene, known_subject, median_row, track_scene
from benchmarks.multiview.path_speed import anew, enlarged, follow, frames_of
from benchmarks.multiview.scorer_speed import around, ways_to_count
from benchmarks.short_calls import best
from hypose import compute
from hypose.evidence.ahead import look_ahead, prepared_masks
from hypose.evidence.frame import Frame
from hypose.io.recordings.frames import build_backgrounds
from hypose.io.recordings.recording import load_recording
from hypose.pipeline.first_frame import Subject
from hypose.synthetic.scenes import Scene
from hypose.synthetic.write_recording import write_scene
from hypose.tracking.recipes import recipe
from hypose.tracking.tracker import Tracker, TrackerSettings

_PRESETS = (("hpf", 1), ("hpf", 8), ("sir", 1), ("apf", 1), ("default", 1))
"""Each with so many times its particles."""
_SECONDS = 2.0


def device(options: BenchOptions) -> BenchReport:
    """Without a device an InputError: nothing is claimed. Baseline of every row: the processor of the same machine,
    with all its cores, in the same run.

    us_per_silhouette: as in silhouette-scorer, of 500 poses and of 4000. max_count_difference_px: against the
    rasterizer in numpy. frames_per_second: masks in memory, or four videos of 1440 x 1080 with their backgrounds, to
    poses. difference_mm: between the joints that a frame's search finds by either, from the same set and the same
    random numbers, a mean over joints, its median and its 95th percentile over the frames; they differ where a pixel
    that is counted otherwise makes a particle follow another ancestor. mean_error_mm: hpf on the scenes of table 2.3;
    what one pixel begins, a clip makes another path of.
    """
    name, quick = compute.require_cuda(), options.quick
    scene = action_scene("walk", 0, 0.6 if quick else _SECONDS, options)
    known, frames, rate = known_subject(scene), list(scene.mask_frames(1.0)), scene.frame_rate
    rows = _silhouettes(frames[0], known, 40 if quick else 200)
    for preset, times in _PRESETS:
        case = f"cuda:{preset}{f' x {times}' if times > 1 else ''}/4"
        options.progress(case, 0, 1)
        few = frames[: len(frames) // min(times, 4)]
        rows.append(
            _faster(case, lambda p=preset, n=times, f=few: follow(look_ahead(anew(f)), known, rate, p, n), len(few))
        )
    with tempfile.TemporaryDirectory() as folder:
        options.progress("videos", 0, 1)
        small = load_recording(write_scene(scene, Path(folder) / "480p").parent)
        large = enlarged(small, Path(folder) / "1080p", 2.25)
        seen = build_backgrounds(large)
        for preset in ("hpf", "default"):
            rows.append(
                _faster(
                    f"cuda:1080p:{preset}/4",
                    lambda p=preset: follow(look_ahead(frames_of(large, seen)), known, rate, p),
                    len(large.frames),
                )
            )
    rows += _same_results(options)
    return BenchReport(tuple(rows), {"device": name, "views": 4, "first_seed": options.seed_range(3).start})


def _silhouettes(frame: Frame, known: Subject, compared: int) -> list[Row]:
    assert frame.silhouettes is not None
    masks, body = prepared_masks(frame.silhouettes), known.body
    tree, mesh, views = body.skeleton.tree, body.coarse.arrays, len(frame.silhouettes.masks)
    rows = []
    for n, case in ((500, "cuda"), (4000, "cuda, 4000 poses")):
        poses = around(body, known.start, 2 * body.skeleton.sigma, n)

        def call(q: Any = poses) -> object:
            return compute.silhouette_xor(q, tree, mesh, masks)

        us = 1e6 / (n * views)
        call()
        processor = us * best(call, 9)
        with compute.use("cuda"):
            call()
            rows.append(Row("us_per_silhouette", case, us * best(call, 25), "us", n=n, **_beside(processor)))
    poses, worst = around(body, known.start, 4 * body.skeleton.sigma, compared), 0
    whole_bodies = list(ways_to_count(body, masks).values())[:4]
    for more in whole_bodies:
        with compute.use("cuda"):
            ours = compute.silhouette_xor(poses, tree, mesh, masks, **more)
        with compute.use("reference"):
            worst = max(worst, int(np.abs(ours - compute.silhouette_xor(poses, tree, mesh, masks, **more)).max()))
    return [*rows, Row("max_count_difference_px", "all", float(worst), "px", n=compared * views * len(whole_bodies))]


def _faster(case: str, call: Callable[[], int], frames: int) -> Row:
    """Frames per second of a call on the device against the processor, the best of two in turn."""
    least = {"cuda": np.inf, "cpu": np.inf}
    for _ in range(3):  # the first compiles
        for backend in least:
            with compute.use(backend):
                begin = time.perf_counter()
                done = call()
                least[backend] = min(least[backend], (time.perf_counter() - begin) / done)
    return Row("frames_per_second", case, 1 / least["cuda"], "1/s", n=frames, **_beside(1 / least["cpu"]))


def _beside(value: float) -> dict[str, Any]:
    return {"baseline": f"the processor, {compute.default_threads()} cores", "baseline_value": value}


def _same_results(options: BenchOptions) -> list[Row]:
    rows, away = [], []
    for action in ACTIONS[: 1 if options.quick else None]:
        found: dict[str, list[float]] = {"cuda": [], "cpu": []}
        for n, seed in enumerate(options.seed_range(3)):
            options.progress(f"{action} seed {seed}", n, 3)
            scene = action_scene(action, seed, 0.6 if options.quick else _SECONDS / 2, options)
            frames = list(scene.mask_frames(1.0))
            if n == 0:
                away += _apart(scene, frames, seed)
            for backend, errors in found.items():
                with compute.use(backend):
                    errors.append(1e3 * track_scene(scene, frames, "hpf", seed).errors.mean)
        beside = _beside(float(np.median(found["cpu"])))
        rows.append(median_row("mean_error_mm", f"cuda:hpf/{action}", found["cuda"], "mm", **beside))
    for case, share in (("median", 50), ("p95", 95)):
        rows.append(Row("difference_mm", f"cuda:hpf, {case}", float(np.percentile(away, share)), "mm", n=len(away)))
    return rows


def _apart(scene: Scene, frames: Sequence[Frame], seed: int) -> list[float]:
    """mm between the joints of the two ways, of every frame from what the processor made of the frames before."""
    known = known_subject(scene)
    body = known.body
    settings = TrackerSettings(seed=seed, frame_rate=scene.frame_rate)
    tracker = Tracker(body, recipe("hpf", body, frame_rate=scene.frame_rate), settings)
    state, out = tracker.start(known.start), []
    for frame in frames:
        with compute.use("cuda"):
            ours = tracker.step(state, frame)[1].pose
        state, estimate = tracker.step(state, frame)
        joints = body.joints(np.stack([ours, estimate.pose]))
        out.append(1e3 * float(np.linalg.norm(joints[0] - joints[1], axis=-1).mean()))
    return out
