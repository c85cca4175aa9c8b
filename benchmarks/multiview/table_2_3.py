"""The published comparison of particle filters on HumanEva-like scenes (Alcoverro 2014, Table 2.3), and the product's
recipes on the same actions."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import cache, lru_cache, partial
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
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
from benchmarks.multiview.paired import paired_rows
from hypose.body.body import Body
from hypose.evidence.frame import Frame
from hypose.synthetic.metrics import joint_errors
from hypose.synthetic.scenes import Scene

FILTERS: dict[str, dict[str, Any]] = {"apf": {}, "hpf": {}, "hpf-apo": {}}
LITERAL = {
    "apf, eqs. 2.9 and 2.10": {"betas": [(k + 1) / 15 for k in range(15)]},
    "hpf, beta 1": {"betas": [1.0] * 7},
}
"""The filters by name, with their options; the literal ones are measured on the first LITERAL_SEEDS seeds."""
LITERAL_SEEDS = 1
FIRST_SEED = 2000
"""First of the seeds that nothing was tuned on."""
JUDGED = 5
"""One frame of so many is judged, as the thesis annotates IXMAS."""
PRODUCT = "default, estimated body"
PRESETS = ("default", PRODUCT)


def table_2_3(options: BenchOptions) -> BenchReport:
    """Mean joint error of the published filters, without solve and recovery, and their paired differences.

    One clip of 10 s per seed, of walk, box, run and combo in turn (built-in motions, on which the filters' steps were
    not measured). Subjects are of another shape space than the tracker's body, dressed; rig humaneva-4; masks with
    outline jitter, holes, blobs and shadow (level-1). All filters have the same body, estimated from the silhouettes of
    another clip of the subject, and start at the inverse kinematics of the true joints in frame 0. Every fifth frame is
    judged, after population offsets of the joint definitions (no subject information). Evaluations per frame: 3600
    (apf), 4004 (hpf), 4000 (hpf-apo). Mean and sd over the clips; differences of two filters on the same clips with the
    95 % interval of Student's t.
    """
    seeds = options.seed_range(30, first=FIRST_SEED)
    seconds = 0.6 if options.quick else 10.0
    found: dict[str, list[Outcome]] = {}
    for n, seed in enumerate(seeds):
        options.progress(f"seed {seed}", n, len(seeds))
        for name, own in (FILTERS | (LITERAL if n < LITERAL_SEEDS else {})).items():
            part = options.part(f"table-2.3.{seed}.{name}", partial(_filtered, name, own, seed, seconds))
            found.setdefault(name, []).append(Outcome.of(part))
    errors = {name: [1e3 * float(o.errors.mean()) for o in of] for name, of in found.items()}
    actions = [ACTIONS[seed % len(ACTIONS)] for seed in seeds]
    rows = paired_rows("mean_error_mm", errors, (("apf", "hpf"), ("hpf", "hpf-apo"), ("apf", "hpf-apo")), actions)
    for name, outcomes in found.items():
        rows.append(row("sd_error_mm", name, [1e3 * o.errors.mean(1).std() for o in outcomes], "mm"))
        rows.append(row("lost_share", name, [(o.errors.mean(1) > LOST_M).mean() for o in outcomes], "1"))
        rows.append(row("seconds_per_frame", name, [o.seconds_per_frame for o in outcomes], "s"))
    settings = {"seeds": list(seeds), "actions": actions, "seconds": seconds, "per_seed_mm": errors, "judged": JUDGED}
    return BenchReport(tuple(rows), settings | {"rig": "humaneva-4", "corruption": "level-1", "frame_rate": 25})


def _filtered(name: str, own: Mapping[str, Any], seed: int, seconds: float) -> dict[str, Any]:
    """One filter on the clip of a seed."""
    scene, frames, body = _clip(seed, seconds)
    return track_scene(scene, frames, name.split(",")[0], seed, body, every=JUDGED, **own).plain()


@lru_cache(1)
def _clip(seed: int, seconds: float) -> tuple[Scene, list[Frame], Body]:
    """The clip of a seed and the body of its subject, from built-in motion."""
    scene = action_scene(ACTIONS[seed % len(ACTIONS)], seed, seconds, BenchOptions())
    return scene, list(scene.mask_frames(1.0)), product.estimated_body(seed, BenchOptions())


def product_table(options: BenchOptions) -> BenchReport:
    """Mean joint error of the product's recipes on walk, box, run and combo.

    Scenes: subjects of another shape space than the tracker's body, dressed, one per seed; captured motion where the
    data folder has it (walk, box, run), built-in motion otherwise; rig humaneva-4; masks with outline jitter, holes,
    blobs and shadow (level-1). The tracker is given the subject's height (not shape) and starts at the inverse
    kinematics of the true joints in frame 0. Errors after population offsets of the joint definitions (no subject
    information). `default, estimated body` is the product as a user has it: the body from the silhouettes of another
    clip of the subject, all frames solved together at the end. Medians over the seeds. Baseline of every row: default
    on the same scenes in the same run.
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
        for preset, outcome in options.part(f"product.{seed}.{action}", measure).items():
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
