"""Benchmarks of skeleton fusion: errors against a known truth, and what two real sensors agree on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, row
from benchmarks.depth_sensors.baselines import BASELINES, fuse_baseline, single_sensor
from benchmarks.depth_sensors.fusion_scenes import FRESH_SEED, HANDS, scene_recording, scene_settings
from benchmarks.multiview.error_fit import auroc
from benchmarks.synthetic.sensors import SensorRecording
from hypose.app.jobs.fuse_job import run_fuse
from hypose.app.live.simulated_sensors import FRAME_RATE
from hypose.app.options import FuseCommand
from hypose.body.motion import Motion
from hypose.errors import InputError
from hypose.evidence.frame import SensorJoints
from hypose.fusion import joints as jt
from hypose.fusion.align import Instant, SensorBody, SensorView
from hypose.fusion.fit import LARGE_ERROR_M, fit_step, start_fit
from hypose.fusion.fuse import common_positions, fuse_clip
from hypose.fusion.people import PeopleTracker
from hypose.fusion.register import common_joints, register
from hypose.geometry import Array, transform
from hypose.io.files import csv_rows
from hypose.io.sensors.skeleton_files import read_skeletons
from hypose.pipeline.assessment import GOOD, UNTRUSTED


def human4d(options: BenchOptions) -> BenchReport:
    """fusion-human4d: MPJPE of all methods on A, B (treadmill) and H (HUMAN4D's run from its four real camera
    poses)."""
    seeds = options.seed_range(10, first=FRESH_SEED)
    scenes = "ABH" if options.data is not None else "AB"
    found: dict[str, list[float]] = {}
    shares: dict[tuple[str, str], list[float]] = {}
    for s, seed in enumerate(seeds):
        for scene in scenes:
            options.progress(f"scene {scene}", s, len(seeds))
            recording = scene_recording(scene, seed, options)
            frames, truth = recording.frames(), recording.truth_in(0)
            # "published-window" tells what is due to the swarm and what to registering every frame on three joints
            for method in ("fit", "swarm", "published", "published-window", *BASELINES):
                if method == "best_single":
                    value = _best_single(recording)
                else:
                    fused = None if method in BASELINES else fuse_clip(frames, method, seed=s)
                    joints = fuse_baseline(frames, method) if fused is None else common_positions(fused.motion)
                    error = np.linalg.norm(joints - truth, axis=-1)
                    value = float(np.nanmean(error))
                    found.setdefault(f"hands/{scene}/{method}", []).append(
                        1e3 * float(np.nanmean(error[:, list(HANDS)]))
                    )
                    if fused is not None and method == "fit":
                        for metric, share in _trusted(fused.motion, error).items():
                            shares.setdefault((metric, scene), []).append(share)
                        causal = _causal(frames, truth)
                        found.setdefault(f"{scene}/fit/causal", []).append(1e3 * causal)
                found.setdefault(f"{scene}/{method}", []).append(1e3 * value)
    rows = [row("mpjpe_mm", case, values, "mm") for case, values in found.items()]
    rows += [row(metric, scene, values, "share") for (metric, scene), values in shares.items()]
    return BenchReport(tuple(rows), scene_settings(options, seeds))


def _trusted(motion: Motion, error: Array) -> dict[str, float]:
    """What a motion says of its errors (T, 15) m: the share inside the 90 % regions, what is wrong, what is said to
    be, and how well it is told which."""
    order = [motion.skeleton.joint(n) for n in jt.COMMON]
    # 90 % of an isotropic normal error in 3D lie within 2.5003 sd per axis
    known, inside = np.isfinite(error), error < 2.5003 * motion.joint_sd[:, order]
    p, wrong = np.asarray(motion.error_probability)[:, order], error > LARGE_ERROR_M
    out = {"coverage_90": inside, "wrong": wrong, "error_probability": p}
    shares = {metric: float(value[known].mean()) for metric, value in out.items()}
    return shares | ({"wrong_auroc": auroc(p[known], wrong[known])} if wrong.any() else {})


def _causal(frames: Sequence[SensorJoints], truth: Array) -> float:
    """Mean error m of the live fusion: registration and bone lengths learned as frames come in; the first 5 s not
    counted."""
    state, errors, unknown = start_fit(), [], np.full((len(frames[0].state), 3), np.nan)
    for t, (frame, world) in enumerate(zip(frames, _causal_world(frames), strict=True)):
        state, fused = fit_step(state, world, frame.state, float(np.nanmax(frame.times)), unknown)
        if t >= min(5 * FRAME_RATE, len(frames) // 2):
            errors.append(np.linalg.norm(fused.joints - truth[t], axis=-1))
    return float(np.mean(errors))


def _best_single(recording: SensorRecording) -> float:
    """m: the best sensor in hindsight, in its own frame, so without any error of registration."""
    return min(
        float(np.linalg.norm(single_sensor(recording.positions, k) - recording.truth_in(k), axis=-1).mean())
        for k in range(recording.positions.shape[1])
    )


# ---- two real sensors ----

CONFIGURATIONS = {"0": "parallel", "1": "45", "2": "90"}


def real(options: BenchOptions) -> BenchReport:
    """fusion-real: two Kinect v2 on one person, no truth: agreement between the sensors after registration, bone
    lengths and jitter after fusion, leaving one sensor out. Three recordings per configuration, their first 400 common
    frames; with "/even" those that are even by their number in the order of their
    names, on which nothing was chosen that `hypose.fusion.fit` holds."""
    found: dict[tuple[str, str, str], list[float]] = {}
    used: dict[str, int] = {}
    files = sorted(options.folder("kinect_multitrack").glob("Study_*_Kinect_[012]_*.gz"))
    for n, file in enumerate(files):
        options.progress("recordings", n, len(files))
        configuration = file.name.partition("_Kinect_")[2][0]
        if used.get(configuration, 0) >= 3 and options.quick:
            continue
        try:
            frames = main_person(file)
        except InputError:
            continue
        name = CONFIGURATIONS[configuration]
        even = n % 2 == 1
        if even and not options.quick:
            _verdicts(file, frames, found)
        if len(frames) < 300:
            continue
        if even and not options.quick:
            sensor_left_out(frames, name, found)
        used[configuration] = used.get(configuration, 0) + 1
        if used[configuration] <= 3:
            _measure_pair(frames[:400], name, found)
    rows = [row(metric, case, values, unit) for (metric, case, unit), values in found.items()]
    return BenchReport(tuple(rows), {"recordings": {CONFIGURATIONS[c]: n for c, n in used.items()}})


def sensor_left_out(frames: list[SensorJoints], name: str, found: dict[tuple[str, str, str], list[float]]) -> None:
    """What one sensor alone says of its joints, against the other one; of all joints, and ("/clear") of those that the
    other one alone does not doubt. Sensors that see the same make the same errors: at 0 degrees that is no test."""
    positions, states = np.stack([f.positions for f in frames]), np.stack([f.state for f in frames])
    registration = register(positions, states)
    world = registration.apply(positions)
    apart = np.linalg.norm(world[:, 0] - world[:, 1], axis=-1)
    found.setdefault(("agreement_mm", f"{name}/even", "mm"), []).append(1e3 * float(np.nanmedian(apart)))
    found.setdefault(("agreement_mean_mm", f"{name}/even", "mm"), []).append(1e3 * float(np.nanmean(apart)))
    motions = []
    for kept in range(2):
        alone = np.where(np.arange(2)[:, None, None] == kept, positions, np.nan)
        one = [replace(f, positions=alone[t]) for t, f in enumerate(frames)]
        motions.append(fuse_clip(one, "fit", registration).motion)
    order = [motions[0].skeleton.joint(n) for n in jt.COMMON]
    for kept, motion in enumerate(motions):
        away = np.linalg.norm(common_positions(motion) - world[:, 1 - kept], axis=-1)
        clear = ~np.asarray(motions[1 - kept].low_confidence_joints)[:, order]
        for more, counted in (("", away), ("/clear", np.where(clear, away, np.nan))):
            for metric, share in _trusted(motion, counted).items():
                found.setdefault((metric, name + more, "share"), []).append(share)


def _verdicts(file: Path, frames: list[SensorJoints], found: dict[tuple[str, str, str], list[float]]) -> None:
    """How `hypose fuse` ends: 1 or 0 per recording, of which that is so of any of its people."""
    header, rows = csv_rows(file, "a CSV of KinectMultiTrack")
    hard = bool({cells[header.index("Scenario_Id")] for _, cells in rows} & {"4", "5", "6", "8"})
    with TemporaryDirectory() as folder:
        people, *_ = run_fuse(read_skeletons(file), Path(folder), FuseCommand(formats="csv"))
    words = [assessment.word for _, assessment in people]
    case = "occlusion or two people" if hard else "one person"
    found.setdefault(("not_good", case, "share"), []).append(float(any(w != GOOD for w in words)))
    found.setdefault(("untrusted", case, "share"), []).append(float(UNTRUSTED in words))
    low_confidence = [m.low_confidence[~m.lost].mean() for m, _ in people if m.low_confidence is not None]
    found.setdefault(("doubtful_frames", case, "share"), []).append(float(np.mean(low_confidence)))


def main_person(file: Path) -> list[SensorJoints]:
    """Instants in which both sensors report the person that is seen most, common joints."""
    recording = read_skeletons(file)
    if len(recording.streams) < 2:
        raise InputError(f"{file} holds one sensor; two are compared here.")
    a, b = recording.streams[:2]
    ids, counts = np.unique(a.person_ids[a.person_ids >= 0], return_counts=True)
    person = int(ids[counts.argmax()])
    # the logger writes both sensors under one time
    seen = {round(float(t), 4): i for i, t in enumerate(b.times)}
    out = []
    for i, t in enumerate(a.times):
        k = seen.get(round(float(t), 4))
        if k is None or not (person in a.person_ids[i] and person in b.person_ids[k]):
            continue
        ca, cb = int((a.person_ids[i] == person).argmax()), int((b.person_ids[k] == person).argmax())
        both = SensorJoints(
            np.stack([a.positions[i, ca], b.positions[k, cb]]),
            np.stack([a.state[i, ca], b.state[k, cb]]),
            np.full(2, t),
            a.joint_names,
            (a.name, b.name),
        )
        out.append(common_joints(both))
    return out


def _measure_pair(frames: list[SensorJoints], name: str, found: dict[tuple[str, str, str], list[float]]) -> None:
    positions, states = np.stack([f.positions for f in frames]), np.stack([f.state for f in frames])

    def add(metric: str, case: str, value: float) -> None:
        found.setdefault((metric, case, "mm"), []).append(1e3 * value)

    registration = register(positions, states)
    for case, world in ((name, registration.apply(positions)), (f"{name}/causal", _causal_world(frames))):
        add("agreement_mm", case, float(np.nanmedian(np.linalg.norm(world[:, 0] - world[:, 1], axis=-1))))
    fused = {"mean": fuse_baseline(frames, "weighted_mean", registration)}
    for method in ("fit", "swarm"):
        result = fuse_clip(frames, method, registration)
        fused[method] = common_positions(result.motion)
    for label, joints in fused.items():
        for metric, value in (("bone_sd_mm", bone_sd(joints)), ("jitter_mm", jitter(joints))):
            add(metric, f"{label}/{name}", value)
            add(metric, label, value)


def _causal_world(frames: Sequence[SensorJoints]) -> Array:
    """All sensors as the live fusion registers them (T, K, 15, 3)."""
    tracker, out, unknown = PeopleTracker(), [], np.full((4, 4), np.nan)
    for n, frame in enumerate(frames):
        seen = zip(frame.sensor_names, frame.positions, frame.state, strict=True)
        views = [SensorView(name, True, 0, (SensorBody(0, p, s),) if s.any() else ()) for name, p, s in seen]
        tracker.update(Instant(n, float(np.nanmax(frame.times)), tuple(views)))
        places = tracker.transforms
        out.append(transform(np.stack([places.get(name, unknown) for name in frame.sensor_names]), frame.positions))
    return np.array(out)


def bone_sd(joints: Array) -> float:
    """m: sd over time of the length of arms' and legs' bones and of the shoulders', mean over the bones."""
    limbs = [b for b in jt.SKELETON_BONES[2:14].tolist() if jt.TORSO not in b]
    return float(np.mean([np.nanstd(np.linalg.norm(joints[:, a] - joints[:, b], axis=-1)) for a, b in limbs]))


def jitter(joints: Array) -> float:
    """m: median over joints and frames of the second difference."""
    return float(np.nanmedian(np.linalg.norm(joints[2:] - 2 * joints[1:-1] + joints[:-2], axis=-1)))
