"""Benchmarks of the monocular tracker on scenes with known truth: mono-arm, mono-body, mono-speed.

Seeds 900 to 919 (arm) and 0 to 7 (body) are reported; settings, inflation included, were chosen on seeds 100 to 106.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from benchmarks.one_camera.mono_runs import (
    KEPT_FRAMES,
    KEPT_MEDIAN_M,
    KEPT_PX,
    MonoRun,
    pictures,
    solve_scene,
    track_scene,
)
from benchmarks.papers.superquadrics import superquadric_body
from benchmarks.synthetic.mono_scenes import MonoScene, arm_scene, body_scene
from hypose.compute.losses import quadratic
from hypose.geometry import Image
from hypose.tracking.monocular.problem import grey
from hypose.tracking.monocular.settings import MonoSettings


def hypotheses(count: int, directions: int) -> MonoSettings:
    """So many hypotheses from so many uncertain directions."""
    settings = MonoSettings()
    return replace(settings, search=replace(settings.search, hypotheses=count, directions=directions))


FIRST_ARM = 900
"""First of the arm's seeds, on which nothing was chosen."""
ARM, SINGLE = hypotheses(3, 1), hypotheses(1, 0)
"""The published arm experiment: 3 hypotheses, one uncertain direction; and one hypothesis alone."""
BODY = hypotheses(7, 3)
"""The published body experiment: 7 hypotheses, three uncertain directions."""
LISTED = replace(BODY, velocity=0.0, search=replace(BODY.search, memory=0.0, reach=1.0))
"""BODY as Figure 4 lists it: no memory of costs, samples at one standard deviation (p_f = 1), no velocity."""

KEYPOINTS, SUPERQUADRICS = "keypoints", "superquadrics"
"""The variants that see a detector's points too, and that track with the paper's body of superquadrics."""
WHOLE = ("robust_3", "robust_1", "full", "full/8s")
"""The variants whose clips are also solved as a whole."""


def mono_arm(options: BenchOptions) -> BenchReport:
    """A 7-dof arm for 8 s. kept_track: number of seeds in which it was kept to the end (mono_runs.MonoRun.kept);
    hand_kept: number of seeds whose knuckles are within KEPT_MEDIAN_M of the truth over the last frames; mean_error_mm,
    depth_mm, image_error_px: means over elbow, wrist and knuckles, in the world, over all seeds, sd over the seeds;
    kept_error_mm: over the seeds kept; alive: hypotheses really alive. '/whole_clip': the clip solved as a whole
    (hypose.tracking.monocular.recipe). quick: one seed, its first second."""
    seeds = options.seed_range(20, first=FIRST_ARM)
    seconds = 1.0 if options.quick else 8.0  # the first ones of the same motion
    variants = {"robust_3": ARM, "robust_1": SINGLE, "gaussian_1": SINGLE.robust(quadratic)}
    scenes = (arm_scene(s) for s in seeds)
    rows = _table(scenes, variants, options, len(seeds), "mean_error_mm", seconds)
    return BenchReport(tuple(rows), _settings(seeds, seconds))


def mono_body(options: BenchOptions) -> BenchReport:
    """A 30-dof body for 1.2 s (and, without --quick, for 8 s), 7 hypotheses.

    root_aligned_mm, depth_mm: 14 joints, pelves made to coincide; image_error_px; oracle_mm: the best of all modes;
    '/whole_clip' as in mono_arm; coverage_90: share of joints and frames whose truth lies in the 90 % region of any
    mode, coverage_90_best in that of the best hypothesis; kept_track: number of scenes. keypoints: with a detector's
    points besides. quick: half a second of one scene.
    """
    seeds = options.seed_range(8)
    seconds = 0.5 if options.quick else 1.2
    mocap = _mocap(options)
    variants = {
        "full": BODY,
        "gaussian": BODY.robust(quadratic),
        KEYPOINTS: BODY,
        "as_printed": LISTED,
        SUPERQUADRICS: BODY,
    }
    scenes = (body_scene(s, 1.2, mocap=mocap) for s in seeds)
    rows = _table(scenes, variants, options, len(seeds), "root_aligned_mm", seconds)
    if not options.quick:
        longer = (body_scene(s, 8.0, mocap=mocap) for s in seeds[:4])
        pair = {"full/8s": BODY, "gaussian/8s": BODY.robust(quadratic)}
        rows += _table(longer, pair, options, len(seeds[:4]), "root_aligned_mm")
    return BenchReport(tuple(rows), {**_settings(seeds, seconds), "captured_motion": mocap is not None})


def mono_speed(options: BenchOptions) -> BenchReport:
    """Seconds of the processor per frame of 384 x 288 px on one core (median over the frames), beside those of OpenCV's
    optical flow of the whole picture in the same run."""
    frames = 15 if options.quick else 50
    rows: list[Row] = []
    for case, scene, settings in (
        ("arm", arm_scene(0), ARM),
        ("body", body_scene(0, frames / 25.0, motion="box"), BODY),
    ):
        images = pictures(scene, frames / 25.0)
        flow = _flow_seconds(images)
        total = track_scene(scene, settings, images).seconds[2:]  # the first ones compile
        value, sd = float(np.median(total)), float(total.std())
        rows.append(Row("seconds_per_frame", case, value, "s", sd, len(total), "optical flow", flow))
    return BenchReport(tuple(rows), {"frames": frames, "size": [384, 288]})


def _flow_seconds(images: Sequence[Image]) -> float:
    """Seconds of the processor that OpenCV's DIS flow takes from one picture to the next, one way (median)."""
    solver = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    greys, out = [grey(image) for image in images], []
    for before, after in pairwise(greys):
        begin = time.process_time()
        solver.calc(before, after, None)  # type: ignore[call-overload]
        out.append(time.process_time() - begin)
    return float(np.median(out))


def _table(
    scenes: Iterable[MonoScene],
    variants: Mapping[str, MonoSettings],
    options: BenchOptions,
    count: int,
    error: str,
    seconds: float | None = None,
) -> list[Row]:
    """Every variant on (the first seconds of) every scene, one scene's pictures at a time, and the rows."""
    runs: dict[str, list[MonoRun]] = {name: [] for name in variants}
    whole: dict[str, list[MonoRun]] = {name: [] for name in WHOLE if name in variants}
    for k, scene in enumerate(scenes):
        images = pictures(scene, seconds)
        for n, (name, settings) in enumerate(variants.items()):
            options.progress(f"{scene.name}: {name}", k * len(variants) + n, count * len(variants))
            if name in whole:
                run, solved = solve_scene(scene, settings, images)
                whole[name].append(solved)
            else:
                body = superquadric_body(scene.body) if name == SUPERQUADRICS else scene.body
                run = track_scene(replace(scene, body=body), settings, images, keypoints=name == KEYPOINTS)
            runs[name].append(run)
    cases = runs | {f"{name}/whole_clip": solved for name, solved in whole.items()}
    return [r for name, found in cases.items() for r in _rows(name, found, error)]


def _rows(case: str, runs: Sequence[MonoRun], error: str) -> list[Row]:
    kept = [r for r in runs if r.kept]
    out = [
        Row("kept_track", case, float(len(kept)), "runs", n=len(runs)),
        row(error, case, [1e3 * r.mean for r in runs], "mm"),
        row("median_error_mm", case, [1e3 * np.median(r.errors) for r in runs], "mm"),
        row("depth_mm", case, [1e3 * r.depth.mean() for r in runs], "mm"),
        row("image_error_px", case, [r.pixels.mean() for r in runs], "px"),
        row("oracle_mm", case, [1e3 * r.oracle.mean() for r in runs], "mm"),
        row("coverage_90", case, [r.inside.mean() for r in runs], "1"),
        row("coverage_90_best", case, [r.inside_best.mean() for r in runs], "1"),
        row("alive", case, [r.mode_count.mean() for r in runs], "1"),
    ]
    if runs[0].kind == "arm":
        near = sum(r.errors[-KEPT_FRAMES:, -1].mean() <= KEPT_MEDIAN_M for r in runs)
        out.insert(1, Row("hand_kept", case, float(near), "runs", n=len(runs)))
    if kept:
        out.append(row("kept_error_mm", case, [1e3 * r.mean for r in kept], "mm"))
    return out


def _mocap(options: BenchOptions) -> Path | None:
    folder = options.data / "mocap" if options.data is not None else None
    return folder if folder is not None and (folder / "02.asf").is_file() else None


def _settings(seeds: Sequence[int], seconds: float) -> dict[str, object]:
    return {"seeds": list(seeds), "seconds": seconds, "kept_median_m": KEPT_MEDIAN_M, "kept_px": KEPT_PX}
