"""Front and back: how often silhouettes alone leave the body turned around, and what is left of it when stretches that
were turned around are tracked again."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from benchmarks.synthetic.noisy_masks import noisy_scene
from hypose.body.body import Body
from hypose.body.default_body import human
from hypose.geometry import Array
from hypose.pipeline.first_frame import SubjectOptions, TrackedSubject, find_subject
from hypose.pipeline.left_right import FrameRange, correct_left_right
from hypose.pipeline.passes import ClipState, track_clip, tracker_of
from hypose.pipeline.track_loop import FrameList
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.metrics import joint_errors, population_offsets
from hypose.synthetic.scenes import Scene, camera_rig
from hypose.tracking.left_right import turned_around
from hypose.tracking.tracker import FrameEstimate, Tracker

_MOTIONS = ("walk", "jog", "combo")


def front_back(options: BenchOptions) -> BenchReport:
    """turned: share of the frames in which the hips lie the other way round than the person's; error_mm: mean over
    joints and frames; each `as tracked`, frame after frame, and `corrected`. Cases: the start that the product finds by
    itself; a start that is turned around on purpose. seconds_per_frame: of tracking from the own start, against the
    same without looking for exchanged sides, in the same run.

    Scenes: walk, jog and combo, 6 s, rig humaneva-4 at half size, masks with level-1 corruption, the subject's height
    given and the body estimated from the same clip; seeds from 20 on. What is measured are the tracker's poses, not
    smoothed."""
    seeds = options.seed_range(6, first=20)
    motions = _MOTIONS[:1] if options.quick else _MOTIONS
    seconds = 2.0 if options.quick else 6.0
    found: dict[tuple[str, str], list[tuple[float, float]]] = {}
    touched, seconds_with, seconds_without = 0, list[float](), list[float]()
    for n, (seed, motion) in enumerate((s, m) for s in seeds for m in motions):
        options.progress("front and back", n, len(seeds) * len(motions))
        cameras = camera_rig("humaneva-4").scaled(0.5)
        scene = noisy_scene(motion, "", cameras, seconds=seconds, seed=seed)
        source = FrameList(list(scene.mask_frames()), scene.frame_rate)
        wanted = SubjectOptions("hull", height=scene.subject.stature, frame_rate=scene.frame_rate)
        subject = find_subject(source.frame, len(source), wanted)
        tracker = tracker_of(subject, TrackOptions(seed=seed), scene.frame_rate)
        alone = replace(tracker, settings=replace(tracker.settings, rival_every=1e6))
        for of, times in ((alone, seconds_without), (tracker, seconds_with)):
            clock = time.perf_counter()
            _tracked(source, of, subject.start, subject)
            times.append((time.perf_counter() - clock) / len(source))
        for case, start in (("own start", subject.start), ("turned start", turned_around(subject.body, subject.start))):
            done = _tracked(source, tracker, start, subject)
            mended, again = correct_left_right(tracker, done, _reader(source))
            touched += bool(again) and case == "own start"
            for how, estimates in (("as tracked", done), ("corrected", mended)):
                found.setdefault((case, how), []).append(_measured(scene, subject.body, estimates))
    options.progress("front and back", len(seeds) * len(motions), len(seeds) * len(motions))
    rows: list[Row] = []
    for case in ("own start", "turned start"):
        before, after = np.array(found[case, "as tracked"]), np.array(found[case, "corrected"])
        for k, (metric, unit) in enumerate((("turned", "1"), ("error_mm", "mm"))):
            tracked = row(metric, f"{case}, as tracked", before[:, k], unit)
            rows.append(tracked)
            base = {"baseline": "as tracked", "baseline_value": tracked.value}
            rows.append(row(metric, f"{case}, corrected", after[:, k], unit, **base))
            worse = float((after[:, k] > before[:, k] + (0.02 if k == 0 else 2.0)).sum())
            rows.append(Row(f"{metric}_worse", case, worse, "clips", n=len(after)))
    rows.append(Row("tracked_again", "own start", float(touched), "clips", n=len(found["own start", "corrected"])))
    base = {"baseline": "no looks", "baseline_value": float(np.mean(seconds_without))}
    rows.append(row("seconds_per_frame", "own start", seconds_with, "s", **base))
    settings = {"seeds": len(seeds), "first_seed": seeds.start, "motions": motions, "seconds": seconds}
    return BenchReport(tuple(rows), settings)


def _tracked(source: FrameList, tracker: Tracker, start: Array, subject: TrackedSubject) -> list[FrameEstimate]:
    subject = replace(subject, start=start, rivals=None)
    done = track_clip(ClipState(source, source.frame_rate, TrackOptions(), subject=subject, tracker=tracker)).tracked
    assert done is not None
    return done.estimates


def _reader(source: FrameList) -> FrameRange:
    return lambda numbers: (source.frame(t) for t in numbers)


def _measured(scene: Scene, body: Body, estimates: list[FrameEstimate]) -> tuple[float, float]:
    """Share of turned frames; mm, mean over joints and frames."""
    s = body.skeleton
    poses = np.stack([e.pose for e in estimates])
    rotations, joints = s.forward(poses)
    left, right = s.joint("left_hip"), s.joint("right_hip")

    def across(of: Array) -> Array:
        return of[: len(poses), left, :2] - of[: len(poses), right, :2]

    turned = (across(joints) * across(scene.joints)).sum(1) < 0
    offsets = population_offsets(human()) * scene.subject.stature
    error = joint_errors(joints, scene.joints[: len(poses)], offsets, rotations).mean()
    return float(turned.mean()), 1000 * float(error)
