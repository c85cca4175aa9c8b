"""What an NVIDIA device does for the particle filters: speed against the processor beside it, and the same results."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
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
from hypose.synthetic.write_recording import write_scene

_PRESETS = (("hpf", 1), ("hpf", 8), ("sir", 1), ("partitioned", 1), ("apf", 1), ("default", 1))
"""Each with so many times its particles."""


def device(options: BenchOptions) -> BenchReport:
    """Without a device an InputError: nothing is claimed. Baseline of every row: the processor of the same machine,
    with all its cores, in the same run.

    us_per_silhouette: as in silhouette-scorer, of 500 poses and of 4000. max_count_difference_px: against the
    rasterizer in numpy. frames_per_second: masks in memory, or four videos of 1440 x 1080 with their backgrounds, to
    poses. mean_error_mm: hpf on the scenes of table 2.3, from the same random numbers; difference_mm: between the
    joints of the two, which follow other ancestors once a pixel is counted otherwise.
    """
    name, quick = compute.require_cuda(), options.quick
    scene = action_scene("walk", 0, 0.6 if quick else 4.0, options)
    known, frames, rate = known_subject(scene), list(scene.mask_frames(1.0)), scene.frame_rate
    rows = _silhouettes(frames[0], known, 40 if quick else 200)
    for preset, times in _PRESETS:
        case = f"cuda:{preset}{f' x {times}' if times > 1 else ''}/4"
        options.progress(case, 0, 1)
        few = frames[: len(frames) // times]
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
    """Frames per second of a call on the device against the processor, the best of three in turn."""
    least = {"cuda": np.inf, "cpu": np.inf}
    for _ in range(4):  # the first compiles
        for backend in least:
            with compute.use(backend):
                begin = time.perf_counter()
                done = call()
                least[backend] = min(least[backend], (time.perf_counter() - begin) / done)
    return Row("frames_per_second", case, 1 / least["cuda"], "1/s", n=frames, **_beside(1 / least["cpu"]))


def _beside(value: float) -> dict[str, Any]:
    return {"baseline": f"the processor, {compute.default_threads()} cores", "baseline_value": value}


def _same_results(options: BenchOptions) -> list[Row]:
    rows = []
    for action in ACTIONS[: 1 if options.quick else None]:
        found: dict[str, list[float]] = {"cuda": [], "cpu": []}
        apart = []
        for n, seed in enumerate(options.seed_range(3)):
            options.progress(f"{action} seed {seed}", n, 3)
            scene = action_scene(action, seed, 0.6 if options.quick else 2.0, options)
            frames, distances = list(scene.mask_frames(1.0)), []
            for backend, errors in found.items():
                with compute.use(backend):
                    outcome = track_scene(scene, frames, "hpf", seed)
                errors.append(1e3 * outcome.errors.mean)
                distances.append(outcome.errors.distances)
            apart.append(1e3 * float(np.abs(distances[0] - distances[1]).mean()))
        beside = _beside(float(np.median(found["cpu"])))
        rows += [
            median_row("mean_error_mm", f"cuda:hpf/{action}", found["cuda"], "mm", **beside),
            median_row("difference_mm", f"cuda:hpf/{action}", apart, "mm"),
        ]
    return rows
