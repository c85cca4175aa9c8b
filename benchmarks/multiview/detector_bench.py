"""What hypose's own detector gives: points and masks from videos alone, on a real clip and on rendered people."""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.multiview.leave_one_out import CONFIDENT, without_view
from benchmarks.multiview.product import aligned_joints
from benchmarks.multiview.real_recordings import LIMBS, balancing_recording, in_memory
from benchmarks.multiview.real_regions import errors_of_points, regions_of_balancing
from benchmarks.people.together import SETTINGS
from hypose.body.motion import Motion
from hypose.evidence.frame import Frame
from hypose.evidence.keypoints import BODY_25B
from hypose.geometry import Array
from hypose.io.keypoints.detectors import open_network
from hypose.io.recordings.recording import Recording, load_recording, write_recording
from hypose.pipeline.assessment import GOOD, LOOK, UNTRUSTED
from hypose.pipeline.detect_keypoints import detect_keypoints
from hypose.pipeline.sources import FrameList
from hypose.pipeline.subject import SubjectOptions, find_subject
from hypose.pipeline.track import track, track_source
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.metrics import EVALUATED
from hypose.synthetic.scenes import Scene, make_scene
from hypose.synthetic.write_recording import write_scene
from hypose.tracking.frame_evidence import prepare

VERDICTS = (GOOD, LOOK, UNTRUSTED)
EVIDENCE = ("both", "silhouettes", "keypoints")
SCENES = (
    *(("walk", "humaneva-4"), ("box", "humaneva-4"), ("jog", "ring-5"), ("combo", "humaneva-4")),
    *(("cross_arms", "ixmas-5"), ("wave", "ring-4"), ("punch", "humaneva-4"), ("serve", "ring-4")),
)
FIRST_SEED = 7100
SECONDS, SECONDS_TOGETHER = 1.6, 3.0


def detector(options: BenchOptions) -> BenchReport:
    """Track videos alone by the detector's points and masks.

    balancing: distance of 12 limb joints to triangulated key points of another detector, as in real-balancing, with
    refined cameras; loco_px: what three cameras say, in the fourth, to the detector's points there and to those of
    another; verdict of the cameras as shipped (0 good, 1 look, 2 not to be trusted); memory_mb: the most that detection
    and the first tracking held, without what the other comparisons keep. scenes: mean joint error on
    rendered people, baseline: background subtraction with simulated key points (both). crossing: two rendered people.
    """
    rows: list[Row] = []
    if options.data is not None:
        rows += _balancing(options)
    for n, seed in enumerate(options.seed_range(len(SCENES), quick=2, first=FIRST_SEED)):
        options.progress("scenes", n, len(SCENES))
        name, rig = SCENES[n % len(SCENES)]
        found = options.part(f"{name}-{seed}", lambda name=name, rig=rig, seed=seed: scene_errors(name, rig, seed))
        for evidence in EVIDENCE:
            value, base = found[evidence], found[f"background/{evidence}"]
            rows.append(
                Row("error_mm", f"{evidence}/{name}", value, "mm", None, 1, f"background/{evidence}/{name}", base)
            )
        rows.append(Row("coverage_90", f"both/{name}", found["coverage"], "1"))
    for evidence in EVIDENCE:
        some = [r for r in rows if r.metric == "error_mm" and r.case.startswith(evidence + "/")]
        mean, base = np.mean([r.value for r in some]), np.mean([r.baseline_value or np.nan for r in some])
        rows.append(
            Row("error_mm", evidence, float(mean), "mm", None, len(some), f"background/{evidence}", float(base))
        )
    for seed in options.seed_range(2, quick=0, first=FIRST_SEED):
        options.progress("crossing", 0, 1)
        found = options.part(f"crossing-{seed}", lambda seed=seed: crossing(seed))
        case = f"crossing/seed {seed}"
        rows.append(Row("exchanged_frames", case, float(found["exchanged"]), "1"))
        rows += [Row("error_mm", f"{case}/person {k + 1}", e, "mm") for k, e in enumerate(found["error"])]
    return BenchReport(tuple(rows), {"detector": open_network().identity})


def bare(recording: Recording, folder: Path) -> Recording:
    """The recording with nothing but its videos and cameras, written to a folder."""
    views = tuple(v.without("background", "keypoints", "masks") for v in recording.views)
    write_recording(replace(recording, views=views, keypoint_set=None, keypoint_lag=0), folder)
    return load_recording(folder)


def seen_by_detector(recording: Recording, folder: Path, frames: int | None = None) -> tuple[Recording, float]:
    """A bare recording after the detector has looked at it, and pictures per second of processor time."""
    loaded, begin = bare(recording, folder), time.process_time()
    wanted = range(loaded.n_frames if frames is None else frames)
    detect_keypoints(loaded, open_network(), folder / "keypoints", frames=wanted)
    return load_recording(folder), len(wanted) * len(loaded.views) / (time.process_time() - begin)


def _balancing(options: BenchOptions) -> list[Row]:
    folder = options.folder("pose2sim_balancing")
    reference = np.load(folder / "kp3d_refined_m.npy")
    given = balancing_recording(folder)
    n = 20 if options.quick else len(given.frames)
    places = np.full((n, *reference.shape[1:]), np.nan)
    places[1:] = reference[: n - 1]
    reference_error = errors_of_points(in_memory(given, n).frames, places)[1:]
    rows = list[Row]()
    with tempfile.TemporaryDirectory() as place:
        options.progress("detect", 0, 4)
        recording, speed = seen_by_detector(given, Path(place) / "refined", n)
        rows.append(Row("pictures_per_cpu_s", "detect", speed, "1/s", n=4 * n))
        begin, source = time.process_time(), in_memory(recording, n)
        for k, evidence in enumerate(EVIDENCE):
            options.progress(evidence, k + 1, 4)
            result = track_source(source, recording.frame_rate, TrackOptions(evidence=evidence))
            if not k:
                spent = time.process_time() - begin + 4 * n / speed
                rows.append(Row("pictures_per_cpu_s", "all", 4 * n / spent, "1/s", n=4 * n))
                rows.append(Row("memory_mb", "all", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, "MB"))
            error = limb_errors(result.motion, reference)
            rows.append(Row("median_mm", evidence, float(np.nanmedian(error)), "mm", n=error.size))
            rows.append(Row("p95_mm", evidence, float(np.nanpercentile(error, 95)), "mm", n=error.size))
            poses = result.motion.poses
            assert poses is not None
            overlap = [
                prepare(f, result.body, q).silhouettes.overlap(result.body, q)
                for q, f in zip(poses, source.frames, strict=True)
            ]
            rows.append(Row("iou", evidence, float(np.nanmean(overlap)), "1", n=n))
            rows += regions_of_balancing(result.motion, evidence, reference, reference_error)
        others = in_memory(given, n).frames
        left_out = [_left_out(source.frames, others, c, recording.frame_rate) for c in range(len(recording.views))]
        for k, whose in enumerate(("both", "both/another detector's")):
            for camera, found in zip(recording.rig.names, left_out, strict=True):
                rows.append(Row("loco_px", f"{whose}/{camera}", float(np.median(found[k])), "px", n=len(found[k])))
            together = np.concatenate([found[k] for found in left_out])
            rows.append(Row("loco_px", whose, float(np.median(together)), "px", n=len(together)))
        shipped, _ = seen_by_detector(load_recording(folder), Path(place) / "shipped", n)
        result = track_source(in_memory(shipped, n), shipped.frame_rate, TrackOptions(evidence="both"))
        word = VERDICTS.index(result.assessment.word)
        rows.append(Row("verdict", "both/shipped cameras", float(word), "1"))
    return rows


def limb_errors(motion: Motion, reference: Array) -> Array:
    """(12, T) mm: limb joints from triangulated key points (T, 25, 3) m, with one offset per joint; the key points'
    frame t belongs to video frame t + 1."""
    assert motion.poses is not None
    rotations, centres = motion.skeleton.forward(motion.poses[1:])
    out = []
    for k in LIMBS:
        j, target = motion.skeleton.joint(BODY_25B[k]), reference[: len(centres), k]
        local = np.einsum("tba,tb->ta", rotations[:, j], target - centres[:, j])
        out.append(1e3 * np.linalg.norm(local - np.nanmean(local, 0), axis=1))
    return np.array(out)


def _left_out(frames: Sequence[Frame], others: Sequence[Frame], view: int, rate: float) -> tuple[Array, Array]:
    """(N,) px of the stored picture: how far the limb points of the detector, and of another one, in a camera are from
    what the other cameras say."""
    source = FrameList([without_view(f, view) for f in frames], rate)
    subject = find_subject(source.frame, len(source), SubjectOptions("keypoints", frame_rate=rate))
    motion = track_source(source, rate, TrackOptions(evidence="both"), subject=subject).motion
    model = subject.keypoints
    assert model is not None and motion.poses is not None
    places = model.positions(subject.body, motion.poses)

    def away(frames: Sequence[Frame]) -> Array:
        out = list[float]()
        for frame, points in zip(frames, places, strict=True):
            if frame.keypoints is None:
                continue
            camera, names = frame.keypoints.rig[view], frame.keypoints.names
            for name in (BODY_25B[n] for n in LIMBS):
                u, v, confidence = frame.keypoints.points[view, names.index(name)]
                if confidence > CONFIDENT:
                    gap = camera.project_pinhole(points[model.names.index(name)]) - (u, v)
                    out.append(1920 / max(camera.size) * float(np.linalg.norm(gap)))
        return np.array(out)

    return away(frames), away(others)


def scene_errors(name: str, rig: str, seed: int) -> dict[str, Any]:
    """Mean joint errors, mm, of a rendered scene by evidence, of the detector and of background subtraction with
    simulated key points; coverage of the 90 % regions (both, detector)."""
    scene = make_scene(name, rig=rig, seconds=SECONDS, seed=seed, distorted=True)
    with tempfile.TemporaryDirectory() as place:
        write_scene(scene, Path(place) / "scene", keypoints=True)
        given = load_recording(Path(place) / "scene")
        found, _ = seen_by_detector(given, Path(place) / "bare")
        out = dict[str, Any]()
        for label, recording in (("", found), ("background/", given)):
            source = in_memory(recording, len(scene))
            for evidence in EVIDENCE:
                motion = track_source(source, recording.frame_rate, TrackOptions(evidence=evidence)).motion
                away = aligned_joints(motion, scene)[:, EVALUATED] - scene.joints[: len(motion), EVALUATED]
                out[label + evidence] = 1e3 * float(np.linalg.norm(away, axis=-1).mean())
                if (label, evidence) == ("", "both"):
                    out["coverage"] = _coverage(motion, away, scene)
    return out


def crossing(seed: int) -> dict[str, Any]:
    """Two rendered people who pass each other at 0.7 m, tracked from the videos alone: mean joint errors, mm, of each,
    and frames in which the other one is nearer to where a person was tracked."""
    performers = SETTINGS["crossing"].make(seed, None)
    scenes = [
        make_scene(p, s, "humaneva-4", seconds=SECONDS_TOGETHER, seed=seed, distorted=True) for s, p in performers
    ]
    together = replace(scenes[0], others=tuple((s.subject, s.performance) for s in scenes[1:]))
    with tempfile.TemporaryDirectory() as place:
        write_scene(together, Path(place) / "scene")
        recording, _ = seen_by_detector(load_recording(Path(place) / "scene"), Path(place) / "bare")
        found = track(recording, people="all").people
    places = np.array([s.joints[:, 0] for s in scenes])
    errors, exchanged = np.full(len(scenes), np.nan), 0
    for person in found:
        motion = person.motion
        rows = np.round(motion.times * scenes[0].frame_rate).astype(int)
        away = np.linalg.norm(motion.joints[:, 0] - places[:, rows], axis=-1)
        whose = int(np.argmin(np.median(away, axis=1)))
        exchanged += int((np.argmin(away, axis=0) != whose).sum())
        theirs = aligned_joints(motion, scenes[whose])[:, EVALUATED] - scenes[whose].joints[rows][:, EVALUATED]
        errors[whose] = 1e3 * float(np.linalg.norm(theirs, axis=-1).mean())
    return {"error": errors.tolist(), "exchanged": exchanged, "found": len(found)}


def _coverage(motion: Motion, away: Array, scene: Scene) -> float:
    """Share of joints whose 90 % region holds the truth."""
    around = motion.joint_covariance[:, EVALUATED].astype(np.float64)
    squares = np.einsum("tja,tjab,tjb->tj", away, np.linalg.pinv(around), away)
    return float((squares <= 6.2514).mean())
