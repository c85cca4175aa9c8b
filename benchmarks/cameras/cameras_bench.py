"""The benchmark `cameras`: captured movement through three cameras of real recordings, with key points that err like a
detector's, against triangulation of the same points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.cameras.captured_motion import (
    LIMBS,
    RIGS,
    Captured,
    as_frames,
    as_read,
    detected,
    human4d_run,
    retargeted,
    triangulated,
    without_one,
)
from benchmarks.multiview.pose2sim_method import pose2sim_points
from benchmarks.multiview.spread_fit import held_rows, squares
from hypose.body.default_body import human
from hypose.body.motion import Motion
from hypose.cameras.camera import CameraRig
from hypose.errors import HyposeError
from hypose.evidence.frame import Frame
from hypose.geometry import Array
from hypose.pipeline.sources import FrameList
from hypose.pipeline.track import track_source
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.metrics import CARRIERS, population_offsets, with_offsets

RATE, SECONDS = 60.0, 2.0
ACTIONS = {"walk": ("02_01", 0.4), "run": ("02_03", 0.0), "box": ("02_05", 2.5), "vicon-run": ("", 0.0)}
_REFUSED = 1e3  # mm that a scene without a result counts


@dataclass(frozen=True)
class _Measured:
    """Of one scene: left (T, 12) mm without offsets, raw (T, 12) mm, offsets (12,) mm, squares of the regions, and
    distances (T, 12) mm, NaN where there is none, of points triangulated as they are given, with left and right mended
    as for tracking, and by Pose2Sim's method."""

    left: Array
    raw: Array
    offsets: Array
    inside: Array
    plain: Array
    mended: Array
    filtered: Array

    def figures(self) -> dict[str, Any]:
        """As JSON has it."""
        return {k: v.tolist() for k, v in vars(self).items()}


def cameras(options: BenchOptions) -> BenchReport:
    """mean_mm: 12 limb joints, a constant offset per joint taken off in the segment that carries it (offsets_mm), by
    action, rig and all. triangulation_mm: the same points, each by itself, weighted, as given and with left and right
    mended as for tracking; pose2sim_mm: Pose2Sim's method on those given; these against the key points' own places, so
    that no definitions differ. coverage_90, ece, ece_normal (see `held_rows`): of the stated regions, where the
    subject's definitions are known (those of HUMAN4D's run are not). The body is found in the clip itself."""
    seeds = options.seed_range(3)
    seconds = 1.0 if options.quick else SECONDS
    rigs = {name: make(options) for name, make in RIGS.items()}
    jobs = [(a, r, s) for s in seeds for a in ACTIONS for r in (list(RIGS)[s % 3 :][:1] if options.quick else RIGS)]
    found: dict[str, list[_Measured]] = {}
    for k, (action, rig, seed) in enumerate(jobs):
        options.progress(f"{action} {rig} seed {seed}", k, len(jobs))
        part = options.part(
            f"{action}-{rig}-{seed}", lambda a=action, r=rig, s=seed: _measured(options, a, rigs[r], s, seconds)
        )
        one = _Measured(**{k: np.array(v, dtype=np.float64) for k, v in part.items()})
        for case in ("all", action, rig, *(("all but uu4cam",) if rig != "uu4cam" else ())):
            found.setdefault(case, []).append(one)
    options.progress("done", len(jobs), len(jobs))
    rows = list(_rows(found))
    return BenchReport(
        tuple(rows), {"seeds": len(seeds), "first_seed": seeds.start, "seconds": seconds, "scenes": len(jobs)}
    )


def _rows(found: dict[str, list[_Measured]]) -> Iterator[Row]:
    for case in ("all", "all but uu4cam", *ACTIONS, *RIGS):
        if case not in found:
            continue
        means = np.array([m.left.mean() for m in found[case]])
        plain, mended, filtered = (
            float(np.mean([np.nanmean(getattr(m, kind)) for m in found[case]]))
            for kind in ("plain", "mended", "filtered")
        )
        sd = float(means.std(ddof=1)) if len(means) > 1 else None
        yield Row("mean_mm", case, float(means.mean()), "mm", sd, len(means), "triangulation", plain)
        yield Row("median_mm", case, float(np.median(np.concatenate([m.left.ravel() for m in found[case]]))), "mm")
        yield Row("raw_mm", case, float(np.mean([m.raw.mean() for m in found[case]])), "mm", n=len(means))
        yield Row("triangulation_mm", case, plain, "mm", n=len(means))
        yield Row("triangulation_mm", f"{case}, sides corrected", mended, "mm", n=len(means))
        yield Row("pose2sim_mm", case, filtered, "mm", n=len(means))
        inside = np.concatenate([m.inside for m in found[case]])
        if len(inside):
            yield from held_rows(inside, 3, case)
    offsets = np.array([m.offsets for m in found["all"]])
    for part in dict.fromkeys(n.split("_")[1] for n in LIMBS):
        which = [k for k, n in enumerate(LIMBS) if n.endswith(part)]
        yield Row("offsets_mm", part, float(offsets[:, which].mean()), "mm", n=offsets[:, which].size)


def _measured(options: BenchOptions, action: str, rig: CameraRig, seed: int, seconds: float) -> dict[str, Any]:
    clip, start = ACTIONS[action]
    captured = (
        retargeted(options, clip, seed, rate=RATE, start=start, seconds=seconds)
        if clip
        else human4d_run(options, 2 * seconds, first=seed * seconds)
    )
    three = without_one(rig, seed)
    points = detected(captured, three, [seed, list(ACTIONS).index(action)])
    frames = as_frames(captured, three, points)
    read = as_read(captured, frames)
    plain, mended = _from_places(captured, triangulated(frames)), _from_places(captured, triangulated(read))
    filtered = _from_places(captured, pose2sim_points(three.pinhole(), _points_of(frames), captured.frame_rate))
    source = FrameList(read, captured.frame_rate)
    try:
        motion = track_source(source, captured.frame_rate, TrackOptions(evidence="keypoints", seed=seed)).motion
    except HyposeError as error:
        print(f"{action} {seed}: {error}", flush=True)
        none = np.full((len(frames), len(LIMBS)), _REFUSED)
        nowhere = np.full(none.size if clip else 0, np.inf)
        return _Measured(none, none, none[0], nowhere, plain, mended, filtered).figures()
    away, offsets = _offsets_off(motion, captured)
    return _Measured(
        1e3 * np.linalg.norm(away, axis=-1),
        1e3 * np.linalg.norm(_truth(captured) - _estimated(motion), axis=-1),
        1e3 * np.linalg.norm(offsets, axis=-1),
        _regions(motion, captured),
        plain,
        mended,
        filtered,
    ).figures()


def _truth(captured: Captured) -> Array:
    return np.stack([captured.truth[n] for n in LIMBS], 1)


def _estimated(motion: Motion) -> Array:
    return motion.joints[:, [motion.skeleton.joint(n) for n in LIMBS]]


def _offsets_off(motion: Motion, captured: Captured) -> tuple[Array, Array]:
    """(T, 12, 3) m from the estimate to the truth less what is constant in the carrying segment, and that (12, 3)."""
    assert motion.poses is not None
    rotations, _ = motion.skeleton.forward(motion.poses)
    carried = rotations[:, CARRIERS[[motion.skeleton.joint(n) for n in LIMBS]]]
    local = np.einsum("tjba,tjb->tja", carried, _truth(captured) - _estimated(motion))
    offsets = local.mean(0)
    return local - offsets, offsets


def _regions(motion: Motion, captured: Captured) -> Array:
    """Mahalanobis distances squared of the truth, where definitions are known: as tables and `doubt` align them."""
    if captured.performance is None or captured.subject is None or motion.poses is None:
        return np.zeros(0)
    rotations, _ = motion.skeleton.forward(motion.poses)
    offsets = population_offsets(human()) * captured.subject.stature
    away = captured.performance.joints - with_offsets(motion.joints, rotations, offsets)
    which = [motion.skeleton.joint(n) for n in LIMBS]
    covariance = motion.joint_covariance[:, which].astype(np.float64)
    return squares(away[:, which].reshape(-1, 3), covariance.reshape(-1, 3, 3), 1.0, 0.0)


def _points_of(frames: list[Frame]) -> Array:
    """(T, C, K, 3) key points."""
    return np.stack([f.keypoints.points for f in frames if f.keypoints is not None])


def _from_places(captured: Captured, points: Array) -> Array:
    """(T, 12) mm from the limbs' places to points (T, K, 3) m."""
    which = [captured.names.index(n) for n in LIMBS]
    return 1e3 * np.linalg.norm((points - captured.places)[:, which], axis=-1)
