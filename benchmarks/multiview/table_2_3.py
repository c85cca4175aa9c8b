"""The published comparison of particle filters on HumanEva-like scenes (Alcoverro 2014, Table 2.3)."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.multiview import product
from benchmarks.multiview.action_scenes import (
    ACTIONS,
    LOST_M,
    Outcome,
    action_scene,
    captured,
    median_row,
    track_scene,
)
from hypose.body.body import Body
from hypose.evidence.frame import Frame
from hypose.synthetic.metrics import joint_errors
from hypose.synthetic.scenes import Scene

PRODUCT = "default, estimated body"
PRESETS = ("apf", "hpf", "hpf-apo", "hpf-apo+", "hpf+", "default", PRODUCT)


def table_2_3(options: BenchOptions) -> BenchReport:
    """Mean joint error of the presets on walk, box, run and combo.

    Scenes: subjects of another shape space than the tracker's body, dressed, one per seed; captured motion where the
    data folder has it (walk, box, run), built-in motion otherwise; rig humaneva-4; masks with outline jitter, holes,
    blobs and shadow (level-1). The tracker is given the subject's height (not shape) and starts at the inverse
    kinematics of the true joints in frame 0. Errors after population offsets of the joint definitions (no subject
    information). `default, estimated body` is the product as a user has it: the body from the silhouettes of another
    clip of the subject, all frames solved together at the end. Medians over the seeds. Baseline of every row: apf on
    the same scenes in the same run. Evaluations per frame: 3600 (apf), 4004 (hpf), 4000 (hpf-apo, hpf-apo+); those of
    hpf+ (hpf with a contour solve of its start and of each estimate, and recovery) and of the default are their own.
    """
    seeds = options.seed_range(5)
    seconds = 0.6 if options.quick else 2.0
    actions = ("walk",) if options.quick else ACTIONS
    jobs = [(a, s) for a in actions for s in seeds]
    found: dict[tuple[str, str], list[Outcome]] = {}
    body_of = cache(partial(product.estimated_body, options=options))  # only for what has not been measured yet
    for n, (action, seed) in enumerate(jobs):
        options.progress(f"{action} seed {seed}", n, len(jobs))
        measure = partial(_all_presets, action, seed, seconds, options, body_of)
        for preset, outcome in options.part(f"table-2.3.{seed}.{action}", measure).items():
            found.setdefault((preset, action), []).append(Outcome.of(outcome))
    options.progress("done", len(jobs), len(jobs))
    rows = table_rows(found, actions)
    settings = {"seeds": len(seeds), "seconds": seconds, "rig": "humaneva-4", "corruption": "level-1", "frame_rate": 25}
    settings["first_seed"] = seeds.start
    settings["motion"] = "captured" if captured(options) else "built-in"
    return BenchReport(tuple(rows), settings)


def _all_presets(
    action: str, seed: int, seconds: float, options: BenchOptions, body_of: Callable[[int], Body]
) -> dict[str, Any]:
    scene = action_scene(action, seed, seconds, options)
    frames = list(scene.mask_frames(1.0))
    found = {preset: track_scene(scene, frames, preset, seed) for preset in PRESETS if preset != PRODUCT}
    found[PRODUCT] = _product_outcome(scene, frames, body_of(seed), seed)
    return {preset: outcome.plain() for preset, outcome in found.items()}


def table_rows(found: Mapping[tuple[str, str], Sequence[Outcome]], actions: Sequence[str]) -> list[Row]:
    """Rows of runs by (preset, action), one outcome per seed: medians over the seeds, of the mean over the actions for
    the case all."""
    rows = []
    presets = [p for p in PRESETS if (p, actions[0]) in found]
    for preset in presets:
        for action in (*actions, "all"):
            chosen = [a for a in actions if action in (a, "all")]
            case = f"{preset}/{action}"

            def values(read: Callable[[Outcome], float], name: str = preset, of: Sequence[str] = chosen) -> list[float]:
                runs = zip(*(found[name, a] for a in of), strict=False)
                return [float(np.mean([read(o) for o in over_actions])) for over_actions in runs]

            base = float(np.median(values(lambda o: 1e3 * o.errors.mean(), presets[0])))
            mean = values(lambda o: 1e3 * o.errors.mean())
            against = {"baseline": f"{presets[0]}/{action}", "baseline_value": base}
            rows.append(median_row("mean_error_mm", case, mean, "mm", **against))
            rows.append(median_row("sd_error_mm", case, values(lambda o: 1e3 * o.errors.mean(1).std()), "mm"))
            rows.append(median_row("p95_error_mm", case, values(lambda o: 1e3 * np.percentile(o.errors, 95)), "mm"))
            rows.append(median_row("lost_share", case, values(lambda o: (o.errors.mean(1) > LOST_M).mean()), "1"))
            base = float(np.median(values(lambda o: o.seconds_per_frame, presets[0])))
            against = {"baseline": f"{presets[0]}/{action}", "baseline_value": base}
            rows.append(median_row("seconds_per_frame", case, values(lambda o: o.seconds_per_frame), "s", **against))
    return rows


def _product_outcome(scene: Scene, frames: list[Frame], body: Body, seed: int) -> Outcome:
    begin = time.perf_counter()
    motion = product.product_motion(scene, frames, body, seed)
    seconds = (time.perf_counter() - begin) / len(frames)
    return Outcome(joint_errors(product.aligned_joints(motion, scene), scene.joints[: len(frames)]), seconds)
