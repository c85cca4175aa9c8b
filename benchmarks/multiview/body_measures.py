"""Benchmark of anthropometry: lengths, girths and overlap of fitted bodies on subjects of known shape, and what
tracking gains from them."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from benchmarks.multiview.action_scenes import action_scene, known_subject, subject_of_seed, track_scene
from benchmarks.multiview.real_recordings import FirstFrames, against_keypoints, balancing_recording
from benchmarks.papers.layered_anthropometry import BETAS, K, anthropometry_recipe, powell_start, shape_energy
from benchmarks.synthetic.noisy_masks import noisy_scene
from hypose.body.anthropometry import Sizes, body_of, measure, sizes_of
from hypose.body.body import Body
from hypose.body.default_body import human
from hypose.compute.parts import covered
from hypose.evidence.keypoints import BODY_25B
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.layer import search, stream
from hypose.io.recordings.frames import FrameStream
from hypose.pipeline.subject import (
    SubjectEstimate,
    SubjectOptions,
    TrackedSubject,
    estimate_subject,
    first_start,
)
from hypose.pipeline.track import track_source
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.performance import Angles, Performance, Stance, perform
from hypose.synthetic.scenes import Scene
from hypose.synthetic.subjects import SyntheticSubject, dress, load_subjects
from hypose.tracking.frame_evidence import keypoint_model, prepare
from hypose.tracking.start_search import Start, scaled_to_height

SCALE = 0.5
"""Masks are made at this share of the cameras' size (320 x 240)."""
_POSES: dict[str, dict[str, float]] = {
    "hands-up": {"shoulder_flexion": 25.0, "shoulder_abduction": 160.0, "elbow_flexion": 10.0},
    "a": {"shoulder_abduction": 45.0, "elbow_flexion": 12.0},
    "t": {"shoulder_abduction": 88.0, "elbow_flexion": 6.0},
}


def anthropometry(options: BenchOptions) -> BenchReport:
    """Fitted bodies of all subjects against their own mesh, and the tracking error with the fitted body.

    motion: 3 s of the built-in combination of movements; one_pose: a held hands-up, A- or T-pose (by turns). Rig
    ring-5, level-1 masks at half size, clothes of 20 mm (about 13 mm in the mean), no height, no start pose given.
    Truth of the lengths: the subject's joints, with the template's lengths corrected by the ratio between the neutral
    subject and the template once for all (joint definitions). Truth of the girths: cross-sections of the subject's
    mesh in its clothes. IoU
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
    found: dict[str, list[dict[str, float]]] = {"motion": [], "one_pose": []}
    template: list[dict[str, float]] = []
    for n, subject in enumerate(subjects):
        moving, held = motion_scene(subject, n), pose_scene(subject, n)
        for k, (case, scene) in enumerate((("motion", moving), ("one_pose", held))):
            options.progress(f"{case} {subject.name}", 2 * n + k, total)
            estimate, seconds = fit_scene(scene, tuple(_POSES)[n % 3] if case == "one_pose" else None)
            found[case].append(fit_errors(scene, estimate, seconds))
        template.append(size_errors(scaled_to_height(human(), moving.subject.stature), moving.subject))
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


def fit_scene(scene: Scene, pose: str | None) -> tuple[SubjectEstimate, float]:
    """The fitted subject of a scene and the seconds it took by the clock, evidence given."""
    frames = list(scene.mask_frames(SCALE))
    how = SubjectOptions(frame_rate=scene.frame_rate, frames=10, tracked=36, passes=2)
    if pose is not None:
        how = replace(how, start=pose, rate=25.0, frames=4)
    begin = time.perf_counter()
    estimate = estimate_subject(lambda i: frames[i], len(frames), how)
    return estimate, time.perf_counter() - begin


def size_errors(body: Body, subject: SyntheticSubject) -> dict[str, float]:
    """Errors of a body: "length/SEGMENT" and shoulder_height in cm, "girth/PART" in %."""
    got, true = sizes_of(body), subject_sizes(subject)
    ratio, shoulder = definition_ratios()
    out = {f"length/{k}": 100 * abs(got.lengths[k] * ratio[k] - v) for k, v in true.lengths.items()}
    out |= {f"girth/{k}": 100 * abs(got.girths[k] / v - 1) for k, v in true.girths.items()}
    return out | {"shoulder_height": 100 * abs(got.shoulder_height * shoulder - true.shoulder_height)}


def fit_errors(scene: Scene, estimate: SubjectEstimate, seconds: float) -> dict[str, float]:
    """`size_errors` of an estimate, its least view's and worst image's overlap with clean masks, and seconds."""
    iou = clean_iou(scene, estimate.body, estimate.poses, estimate.frames)
    overlap = {"min_view": float(iou.mean(0).min()), "worst_image": float(iou.min()), "mean": float(iou.mean())}
    return size_errors(estimate.body, scene.subject) | overlap | {"seconds": seconds}


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


def _mean(errors: dict[str, float], kind: str) -> float:
    return float(np.mean([v for k, v in errors.items() if k.startswith(kind)]))


def _rows(found: dict[str, list[dict[str, float]]], template: list[dict[str, float]]) -> list[Row]:
    rows = []

    def against(kind: str) -> dict[str, Any]:
        value = float(np.mean([_mean(e, kind) for e in template]))
        return {"baseline": "template at the true height", "baseline_value": value}

    for case, fits in found.items():
        rows.append(row("segment_error_cm", case, [_mean(e, "length/") for e in fits], "cm", **against("length/")))
        for k in (k for k in fits[0] if k.startswith("length/")):
            name = f"{case}/{k.removeprefix('length/')}"
            rows.append(row("segment_error_cm", name, [e[k] for e in fits], "cm", **against(k)))
    every = [e for fits in found.values() for e in fits]
    for case, fits in (*found.items(), ("all", every)):
        rows += [
            row("shoulder_height_error_cm", case, [e["shoulder_height"] for e in fits], "cm"),
            row("girth_error_pct", case, [_mean(e, "girth/") for e in fits], "%", **against("girth/")),
            row("min_view_iou", case, min(e["min_view"] for e in fits), "1"),
            row("worst_image_iou", case, min(e["worst_image"] for e in fits), "1"),
            row("mean_iou", case, [e["mean"] for e in fits], "1"),
            row("seconds_per_subject", case, [e["seconds"] for e in fits], "s"),
        ]
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


def layered(options: BenchOptions) -> BenchReport:
    """Bodies by the thesis' own method (Alcoverro 2014, 2.3.3 and 2.3.4), from one frame of a held, known pose of a
    dressed subject: the template, Powell's start from it, and the layered filter of Table 2.2 from Powell's start, by a
    survival rate and with the printed exponents.

    Scenes as the case one_pose of `anthropometry`, masks at half size. The pose is that of the true joints on the
    template. segment_error_cm, girth_error_pct: means over segments and parts; energy: eq. 2.8 of the body and pose.
    """
    seeds = options.seed_range(20)
    found: dict[str, list[tuple[dict[str, float], float]]] = {}
    for n, seed in enumerate(seeds):
        options.progress(f"seed {seed}", n, len(seeds))
        scene = pose_scene(subject_of_seed(seed), seed)
        template = human()
        frame = prepare(next(iter(scene.mask_frames(SCALE))), template, known_subject(scene, template).start)
        states = {"template": np.concatenate([np.zeros(K), frame.prediction])}
        states["powell"] = powell_start(template, frame.prediction, frame)
        for case, betas in (("filter", None), ("filter, printed beta", BETAS)):
            how = anthropometry_recipe(template, betas=betas)
            around = Hypotheses.uniform(np.repeat(states["powell"][None], how.particles, 0))
            states[case] = search(around, how, frame, partial(stream, seed, 0)).estimate
        for case, state in states.items():
            errors = size_errors(body_of(template, state[:K]), scene.subject)
            found.setdefault(case, []).append((errors, shape_energy(template, state, frame)))
    rows = []
    for case, of in found.items():
        for metric, kind, unit in (("segment_error_cm", "length/", "cm"), ("girth_error_pct", "girth/", "pct")):
            means = [np.mean([v for k, v in errors.items() if k.startswith(kind)]) for errors, _ in of]
            rows.append(row(metric, case, means, unit))
        rows.append(row("energy", case, [energy for _, energy in of], "1"))
    return BenchReport(tuple(rows), {"seeds": list(seeds), "rig": "ring-5", "corruption": "level-1", "scale": SCALE})


def subject_balancing(options: BenchOptions) -> BenchReport:
    """The Pose2Sim balancing clip with a subject from silhouettes alone: masks made without key points, no height.

    start from key points: the pose in the first frame that has key points, found with the template's own proportions,
    is all that is taken from them; start from the hull: nothing is. Both against the triangulated key points, as in
    real-balancing.
    """
    folder = options.folder("pose2sim_balancing")
    reference = np.load(folder / "kp3d_refined_m.npy")
    recording = balancing_recording(folder, keypoints=False)
    with FrameStream(balancing_recording(folder)) as with_points, FrameStream(recording) as without:
        n = 30 if options.quick else len(without)
        rate = recording.frame_rate
        rows: list[Row] = []
        template = human()
        starts = {
            "start from key points": first_start(template, keypoint_model(template, BODY_25B), with_points.frame, n)[0],
            "start from the hull": None,
        }
        for k, (case, start) in enumerate(starts.items()):
            options.progress(case, k, 2)
            tried = () if start is None else ((0, Start(template, start, 0.0)),)
            found = estimate_subject(
                without.frame, n, SubjectOptions(frame_rate=rate, tried=tried, frames=10, passes=2)
            )
            model = keypoint_model(found.body, BODY_25B)
            subject = TrackedSubject(found.body, model, found.start, found.notes)
            result = track_source(FirstFrames(without, n), rate, TrackOptions(), subject=subject)
            assert result.motion.poses is not None
            # key-point file t belongs to video frame t + 1: frame 0 of the video has none
            rows += against_keypoints(case, found.body, model, result.motion.poses[1:], reference[: n - 1])
            rows.append(Row("iou", case, 1 - float(np.nanmean(result.motion.cost)), "1", n=n))
    return BenchReport(tuple(rows), {"frames": n, "extrinsics": "refined", "joints": 12})
