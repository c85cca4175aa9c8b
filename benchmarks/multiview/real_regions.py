"""Do the regions of real clips hold what was not used: triangulated key points, a camera or a sensor left out?"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from benchmarks.depth_sensors.fusion_benchmarks import CONFIGURATIONS, main_person, sensor_left_out
from benchmarks.multiview.leave_one_out import CONFIDENT, without_view
from benchmarks.multiview.real_recordings import LIMBS, balancing_recording, in_memory
from benchmarks.multiview.spread_fit import held_rows, squares
from hypose.body.motion import Motion
from hypose.errors import InputError
from hypose.evidence.frame import Frame
from hypose.evidence.keypoints import BODY_25B
from hypose.geometry import Array
from hypose.pipeline.run import track_source
from hypose.pipeline.subject import SubjectOptions, find_subject
from hypose.pipeline.track_loop import FrameList
from hypose.pipeline.track_options import TrackOptions
from hypose.tracking.frame_evidence import MIN_CONFIDENCE
from hypose.tracking.keypoint_offsets import TOGETHER
from hypose.tracking.refinement import joint_group


def regions_of_balancing(motion: Motion, evidence: str, reference: Array, reference_error: Array | None) -> list[Row]:
    """Coverage and level error of the regions of 12 limb joints against triangulated key points (T, 25, 3) m of the
    balancing clip, where a detector's points and the body's joints are brought to the same definition by one offset
    per joint, learnt over the clip. reference_error (T, 25, 3, 3) m^2: what the reference errs by itself, as
    `errors_of_points` has it; None: that counts as the motion's, as it must where both come from the same points."""
    assert motion.poses is not None
    rotations, centres = motion.skeleton.forward(motion.poses[1:])  # key-point file t belongs to video frame t + 1
    covariance = motion.joint_covariance[1:].astype(np.float64)
    found: dict[str, list[Array]] = {}
    for k in LIMBS:
        name = BODY_25B[k]
        j = motion.skeleton.joint(name)
        local = np.einsum("tba,tb->ta", rotations[:, j], reference[: len(centres), k] - centres[: len(reference), j])
        away = np.einsum("tab,tb->ta", rotations[:, j], local - np.nanmean(local, 0))
        known = np.isfinite(away).all(1)
        around = covariance[: len(away), j]
        if reference_error is not None:
            around = around + reference_error[: len(away), k]
            known &= np.isfinite(around).all((1, 2))
        m2 = squares(away[known], around[known], 1.0, 0.0)
        for group in (joint_group(name), "all"):
            found.setdefault(group, []).append(m2)
    rows: list[Row] = []
    for group, parts in found.items():
        rows += held_rows(np.concatenate(parts), 3, f"{evidence}/balancing/{group}")
    return rows


def regions_real(options: BenchOptions) -> BenchReport:
    """regions-real: 90 % regions on real recordings.

    balancing: one camera left out, what three say (key points; both) looked at in its picture, where a detection errs
    by the noise that the other views' have. sensors: one of two Kinects left out, on the recordings that are even by
    their number (`fusion_benchmarks.real`)."""
    recording = balancing_recording(options.folder("pose2sim_balancing"))
    frames = in_memory(recording, 30 if options.quick else len(recording.frames)).frames
    rows: list[Row] = []
    for evidence in ("keypoints", "both"):
        inside: list[Array] = []
        for view, camera in enumerate(recording.rig.names):
            options.progress(f"{evidence} without {camera}", view, len(recording.rig))
            inside.append(_camera_left_out(frames, view, evidence, recording.frame_rate))
            rows.append(Row("coverage_90", f"{evidence}/{camera} left out", float(inside[-1].mean()), "1"))
        rows.append(Row("coverage_90", f"{evidence}/camera left out", float(np.concatenate(inside).mean()), "1"))
    found: dict[tuple[str, str, str], list[float]] = {}
    files = sorted(options.folder("kinect_multitrack").glob("Study_*_Kinect_[012]_*.gz"))[1::2]
    for n, file in enumerate(files[:2] if options.quick else files):
        options.progress("sensors", n, len(files))
        with contextlib.suppress(InputError):  # nobody whom both see
            sensors = main_person(file)
            if len(sensors) >= _LEAST_FRAMES:
                sensor_left_out(sensors, CONFIGURATIONS[file.name.partition("_Kinect_")[2][0]], found)
    rows += [row(metric, f"sensors/{case}", v, unit) for (metric, case, unit), v in found.items() if "cover" in metric]
    return BenchReport(tuple(rows), {"frames": len(frames), "recordings": len(files)})


_LEAST_FRAMES = 300


def _camera_left_out(frames: Sequence[Frame], view: int, evidence: str, rate: float) -> Array:
    """(N,) whether the limbs' key points that the camera left out shows lie in the regions of what the others say."""
    used = [without_view(f, view) for f in frames]
    used = [replace(f, silhouettes=None) for f in used] if evidence == "keypoints" else used
    source = FrameList(used, rate)
    subject = find_subject(source.frame, len(source), SubjectOptions("keypoints", frame_rate=rate))
    motion = track_source(source, rate, TrackOptions(evidence=evidence), subject=subject).motion
    model = subject.keypoints
    assert model is not None and model.sd is not None and motion.poses is not None
    places, noise, inside = model.positions(subject.body, motion.poses), float(np.median(model.sd)) / TOGETHER, []
    for t, frame in enumerate(frames):
        seen = frame.keypoints
        if seen is None:
            continue
        p = seen.rig.projections[view]
        for k in LIMBS:
            u, v, confidence = seen.points[view, k]
            if not confidence > CONFIDENT:
                continue
            h = p[:, :3] @ places[t, k] + p[:, 3]
            slope = (p[:2, :3] - (h[:2] / h[2])[:, None] * p[2, :3]) / h[2]
            around = motion.joint_covariance[t, motion.skeleton.joint(BODY_25B[k])].astype(np.float64)
            spread = slope @ around @ slope.T + (noise * float(seen.rig[view].K[0, 0]) / h[2]) ** 2 * np.eye(2)
            off = np.array([u, v]) - h[:2] / h[2]
            inside.append(off @ np.linalg.solve(spread, off) <= chi2.ppf(0.9, 2))
    return np.array(inside)


def errors_of_points(frames: Sequence[Frame], points_world: Array) -> Array:
    """(T, K, 3, 3) m^2, NaN where a point is not seen twice: covariances of points (T, K, 3) m that were triangulated
    from the key points of frames, from what these leave in each view."""
    found = [f.keypoints for f in frames]
    rig = next(k for k in found if k is not None).rig
    shape = points_world.shape[:2]
    seen = np.stack([np.zeros((len(rig), shape[1], 3)) if k is None else np.nan_to_num(k.points) for k in found], 1)
    information = np.zeros((*shape, 3, 3))
    for c in range(len(rig)):
        p = rig.projections[c]
        h = points_world @ p[:, :3].T + p[:, 3]
        uv = h[..., :2] / h[..., 2:]
        slope = (p[:2, :3] - uv[..., None] * p[2, :3]) / h[..., 2, None, None]
        use = (seen[c, ..., 2] > MIN_CONFIDENCE) & np.isfinite(uv).all(-1)
        left = np.linalg.norm(seen[c, ..., :2] - uv, axis=-1)[use]
        # the median of a Rayleigh distance is 1.18 sd; of 2 C coordinates a point has taken 3
        sd = float(np.median(left)) / 1.177 / np.sqrt((2 * len(rig) - 3) / (2 * len(rig)))
        rows = np.where(use[..., None, None], np.nan_to_num(slope), 0.0) / sd
        information += np.einsum("tkia,tkib->tkab", rows, rows)
    twice = (seen[..., 2] > MIN_CONFIDENCE).sum(0) > 1
    out = np.linalg.inv(information + 1e-9 * np.eye(3))
    return np.where(twice[..., None, None], out, np.nan)
