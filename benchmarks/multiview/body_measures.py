"""Benchmark of anthropometry: lengths, girths and overlap of fitted bodies on subjects of known shape, and what
tracking gains from them."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from benchmarks.multiview.action_scenes import action_scene, subject_of_seed, track_scene
from benchmarks.synthetic.noisy_masks import noisy_scene
from hypose.body.anthropometry import Sizes, measure, sizes_of
from hypose.body.body import Body
from hypose.body.default_body import human
from hypose.compute.parts import covered
from hypose.geometry import Array
from hypose.pipeline.subject_from_motion import AnthropometryOptions, SubjectEstimate, estimate_subject
from hypose.synthetic.performance import Angles, Performance, Stance, perform
from hypose.synthetic.scenes import Scene
from hypose.synthetic.subjects import SyntheticSubject, dress, load_subjects
from hypose.tracking.subject import scaled_to_height

SCALE = 0.5
"""Masks are made at this share of the cameras' size (320 x 240)."""
_POSES: dict[str, dict[str, float]] = {
    "hands-up": {"shoulder_flexion": 25.0, "shoulder_abduction": 160.0, "elbow_flexion": 10.0},
    "a": {"shoulder_abduction": 45.0, "elbow_flexion": 12.0},
    "t": {"shoulder_abduction": 88.0, "elbow_flexion": 6.0},
}


@dataclass(frozen=True)
class FitErrors:
    """Errors of one fit: lengths m by segment, shoulder height m, girths (share) against the dressed and the naked
    subject, overlap with clean masks (least of the views' means over the frames, worst single image, mean), seconds by
    the clock and of processor time."""

    lengths: dict[str, float]
    shoulder_height: float
    girths: dict[str, float]
    naked_girths: dict[str, float]
    min_iou: float
    worst_iou: float
    mean_iou: float
    seconds: float
    cpu_seconds: float


def anthropometry(options: BenchOptions) -> BenchReport:
    """Fitted bodies of all subjects against their own mesh, and the tracking error with the fitted body.

    motion: 3 s of the built-in combination of movements; one_pose: a held hands-up, A- or T-pose (by turns). Rig
    ring-5, level-1 masks at half size, clothes of 20 mm (about 13 mm in the mean), no height, no start pose given.
    Truth of the lengths: the subject's joints, with the template's lengths corrected by the ratio between the neutral
    subject and the template once for all (joint definitions). Truth of the girths: cross-sections of the subject's
    mesh in its clothes; under "naked" the skin's, against the fit without its estimated clothes. IoU
    against the clean masks of the fitted frames: min_view_iou is the least, over subjects and views, of a view's mean
    over the frames; worst_image_iou the worst single image. Baseline of lengths and girths: the template at the true
    height.
    tracking_gain: walk and box scenes of table-2.3 with the default recipe, the same start (true joints of frame 0); a
    body fitted without knowing the height, to another take of the same person (combo), against the template at the true
    height: 1 - error / error.
    """
    subjects = [s for k, s in load_subjects().items() if k != "neutral"]
    subjects = subjects[: options.seeds or (2 if options.quick else len(subjects))]
    gain_seeds = 1 if options.quick else min(8, len(subjects))
    total = 2 * len(subjects) + gain_seeds
    found: dict[str, list[FitErrors]] = {"motion": [], "one_pose": []}
    template: list[FitErrors] = []
    for n, subject in enumerate(subjects):
        moving, held = motion_scene(subject, n), pose_scene(subject, n)
        for k, (case, scene) in enumerate((("motion", moving), ("one_pose", held))):
            options.progress(f"{case} {subject.name}", 2 * n + k, total)
            estimate, seconds = fit_scene(scene, tuple(_POSES)[n % 3] if case == "one_pose" else None)
            found[case].append(fit_errors(scene, subject, estimate, seconds))
        template.append(_template_errors(moving.subject, subject))
    rows = _rows(found, template)
    gains = []
    for seed in range(gain_seeds):
        options.progress(f"tracking {seed}", 2 * len(subjects) + seed, total)
        gains.append(tracking_errors(seed, options))
    rows += _gain_rows(gains)
    settings = {
        "subjects": len(subjects),
        "rig": "ring-5",
        "corruption": "level-1",
        "scale": SCALE,
        "recipe": "default",
    }
    return BenchReport(tuple(rows), settings)


def motion_scene(subject: SyntheticSubject, seed: int) -> Scene:
    """3 s of movement of a dressed subject before five cameras."""
    return noisy_scene("combo", subject, "ring-5", seconds=3.0, seed=seed)


def pose_scene(subject: SyntheticSubject, seed: int) -> Scene:
    """A held pose (hands-up, A or T by the seed), eight frames."""
    dressed = dress(subject, 0.02, np.random.default_rng([seed, 0]))
    held = held_pose(tuple(_POSES)[seed % 3], dressed)
    return noisy_scene(held, dressed, "ring-5", seed=seed)


def held_pose(name: str, subject: SyntheticSubject, frames: int = 8, frame_rate: float = 25.0) -> Performance:
    """A subject that holds a known pose with its legs slightly open."""
    t = np.arange(frames) / frame_rate
    values = {f"{side}_{k}": np.full(frames, v) for side in ("left", "right") for k, v in _POSES[name].items()}
    return perform(Angles(name, t, values, Stance(half_width=0.2)), subject)


def fit_scene(scene: Scene, pose: str | None) -> tuple[SubjectEstimate, tuple[float, float]]:
    """The fitted subject of a scene and the seconds it took by the clock and of processor time, evidence given."""
    frames = list(scene.mask_frames(SCALE))
    how = AnthropometryOptions()
    if pose is not None:
        how = replace(how, poses=(pose,), rate=25.0, frames=4)
    begin, cpu = time.perf_counter(), time.process_time()
    estimate = estimate_subject(lambda i: frames[i], len(frames), scene.frame_rate, human(), how)
    return estimate, (time.perf_counter() - begin, time.process_time() - cpu)


def fit_errors(
    scene: Scene, naked: SyntheticSubject, estimate: SubjectEstimate, seconds: tuple[float, float]
) -> FitErrors:
    """Errors of an estimate; see FitErrors."""
    iou = clean_iou(scene, estimate.body, estimate.poses, estimate.frames)
    found = _size_errors(estimate.body, scene.subject)
    return replace(
        found,
        naked_girths=_size_errors(estimate.naked, naked).girths,
        min_iou=float(iou.mean(0).min()),
        worst_iou=float(iou.min()),
        mean_iou=float(iou.mean()),
        seconds=seconds[0],
        cpu_seconds=seconds[1],
    )


def _template_errors(dressed: SyntheticSubject, naked: SyntheticSubject) -> FitErrors:
    body = scaled_to_height(human(), dressed.stature)
    return replace(_size_errors(body, dressed), naked_girths=_size_errors(body, naked).girths)


def _size_errors(body: Body, subject: SyntheticSubject) -> FitErrors:
    got, true = sizes_of(body), subject_sizes(subject)
    ratio, shoulder = definition_ratios()
    return FitErrors(
        {k: abs(got.lengths[k] * ratio[k] - v) for k, v in true.lengths.items()},
        abs(got.shoulder_height * shoulder - true.shoulder_height),
        {k: abs(got.girths[k] / v - 1) for k, v in true.girths.items()},
        {},
        *([float("nan")] * 5),
    )


def subject_sizes(subject: SyntheticSubject) -> Sizes:
    """Sizes of a subject's own mesh and joints."""
    return measure(subject.vertices, subject.faces, subject.joints)


def definition_ratios() -> tuple[dict[str, float], float]:
    """True length over the template's, per stature, of the neutral subject: where two bodies define a joint differs."""
    true, own = subject_sizes(load_subjects()["neutral"]), sizes_of(human())
    ratio = {k: true.lengths[k] / true.stature * own.stature / own.lengths[k] for k in own.lengths}
    return ratio, true.shoulder_height / true.stature * own.stature / own.shoulder_height


def clean_iou(scene: Scene, body: Body, poses: Array, indices: tuple[int, ...]) -> Array:
    """(F, C) overlap of the body's fine mesh with the clean masks."""
    cameras = scene.rig.pinhole().scaled(SCALE)
    out = np.zeros((len(indices), len(cameras)))
    for f, (i, pose) in enumerate(zip(indices, poses, strict=True)):
        v = body.skin(pose, body.fine)
        for c, camera in enumerate(cameras):
            z = v @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
            own = covered(camera.project_pinhole(v), z, body.fine.faces, camera.size[::-1]) > 0
            true = scene.clean_mask(c, i, SCALE) > 0
            out[f, c] = (own & true).sum() / max((own | true).sum(), 1)
    return out


def tracking_errors(seed: int, options: BenchOptions) -> dict[str, tuple[float, float]]:
    """Mean joint error m (template, fitted) on walk and box of a subject; see `anthropometry`."""
    take = noisy_scene("combo", subject_of_seed(seed), "humaneva-4", seconds=3.0, seed=seed)
    estimate, _ = fit_scene(take, None)
    out = {}
    for action in ("walk", "box"):
        scene = action_scene(action, seed, 2.0, options)
        frames = list(scene.mask_frames(1.0))
        errors = []
        for body in (None, estimate.body):
            errors.append(track_scene(scene, frames, "default", seed, body).errors.mean())
        out[action] = (errors[0], errors[1])
    return out


def _rows(found: dict[str, list[FitErrors]], template: list[FitErrors]) -> list[Row]:
    rows = []
    for case, fits in found.items():
        base = float(np.mean([100 * np.mean(list(e.lengths.values())) for e in template]))
        values = [100 * np.mean(list(e.lengths.values())) for e in fits]
        against = {"baseline": "template at the true height", "baseline_value": base}
        rows.append(row("segment_error_cm", case, values, "cm", **against))
        for k in fits[0].lengths:
            own = float(np.mean([100 * e.lengths[k] for e in template]))
            values = [100 * e.lengths[k] for e in fits]
            rows.append(row("segment_error_cm", f"{case}/{k}", values, "cm", **{**against, "baseline_value": own}))
    everything = [e for fits in found.values() for e in fits]
    for case, fits in (*found.items(), ("all", everything)):
        rows.append(row("shoulder_height_error_cm", case, [100 * e.shoulder_height for e in fits], "cm"))
        base = float(np.mean([100 * np.mean(list(e.girths.values())) for e in template]))
        against = {"baseline": "template at the true height", "baseline_value": base}
        rows.append(
            row("girth_error_pct", case, [100 * np.mean(list(e.girths.values())) for e in fits], "%", **against)
        )
        naked = [100 * np.mean(list(e.naked_girths.values())) for e in fits]
        rows.append(row("girth_error_pct", f"{case}/naked", naked, "%"))
        rows.append(row("min_view_iou", case, float(np.min([e.min_iou for e in fits])), "1"))
        rows.append(row("worst_image_iou", case, float(np.min([e.worst_iou for e in fits])), "1"))
        rows.append(row("mean_iou", case, [e.mean_iou for e in fits], "1"))
        rows.append(row("seconds_per_subject", case, [e.seconds for e in fits], "s"))
        rows.append(row("seconds_per_subject", f"{case}/slowest", max(e.seconds for e in fits), "s"))
        rows.append(row("cpu_seconds_per_subject", case, [e.cpu_seconds for e in fits], "s"))
    return rows


def _gain_rows(found: list[dict[str, tuple[float, float]]]) -> list[Row]:
    both = np.array([[e[a] for a in ("walk", "box")] for e in found])  # (S, 2 actions, 2 bodies)
    template, fitted = both[..., 0].mean(1), both[..., 1].mean(1)
    rows = [
        row("tracking_gain", "all", 1 - fitted / template, "1"),
        row("tracking_gain", "worst", float((1 - fitted / template).min()), "1"),
        row("tracking_error_mm", "template/all", 1e3 * template, "mm"),
        row(
            "tracking_error_mm",
            "fitted/all",
            1e3 * fitted,
            "mm",
            baseline="template/all",
            baseline_value=float(1e3 * template.mean()),
        ),
    ]
    for k, action in enumerate(("walk", "box")):
        rows.append(row("tracking_error_mm", f"template/{action}", 1e3 * both[:, k, 0], "mm"))
        rows.append(row("tracking_error_mm", f"fitted/{action}", 1e3 * both[:, k, 1], "mm"))
    return rows
