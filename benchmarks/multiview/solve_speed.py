"""Speed of the contour solve, and what its speed costs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row, best, row
from benchmarks.multiview.action_scenes import action_scene, known_subject
from benchmarks.multiview.real_recordings import against_keypoints, balancing_recording
from hypose.body.body import Body
from hypose.evidence.frame import Frame
from hypose.evidence.outlines import WORKING_HEIGHT
from hypose.evidence.terms import ContourTerm, KeypointTerm, contour_term
from hypose.fitting import PoseFit, Quadratic, SolveSettings, fit_pose
from hypose.geometry import Array
from hypose.io.recordings.frames import FrameSettings, FrameStream
from hypose.pipeline.subject import SubjectOptions, find_subject
from hypose.tracking.frame_evidence import keypoint_term
from hypose.tracking.refinement import anatomical_prior

_FAST, _LONG = SolveSettings(), SolveSettings(iterations=60, coarse_iterations=4, tolerance=1e-6)
_GAIN = 0.8


@dataclass(frozen=True)
class _Solved:
    """Per frame: seconds (T,), iterations (T,), poses (T, D)."""

    seconds: Array
    iterations: Array
    poses: Array


def contour_solve(options: BenchOptions) -> BenchReport:
    """Milliseconds per frame of the robust solve from the prediction (8 iterations, 4 views, one thread).

    contours: as the tracker prepares them (distances around the person); keypoints: 25 key points a view. With --data,
    the balancing clip: median_mm to its key points (12 limb joints, aligned) of the solve alone, and of a slow
    reference with the same cost: whole distances in images of twice the size, outlines three times as dense, 60
    iterations.
    """
    scene = action_scene("walk", 0, 0.4 if options.quick else 1.0, options)
    subject = known_subject(scene)
    body, start = subject.body, subject.start
    rows = []
    terms = [_fast_term(f) for f in scene.mask_frames(1.0)]
    solved = _follow(body, start, terms, [None] * len(terms), _FAST, repeats=3)
    rows.append(row("ms_per_frame", "contours", 1e3 * solved.seconds, "ms"))
    rows.append(Row("iterations_p90", "contours", float(np.percentile(solved.iterations, 90)), "1", n=len(terms)))
    points = [
        keypoint_term(f.keypoints, body) if f.keypoints is not None else None
        for f in scene.mask_frames(0.5, keypoints=True)
    ]
    solved = _follow(body, start, [None] * len(points), points, _FAST, repeats=3)
    rows.append(row("ms_per_frame", "keypoints", 1e3 * solved.seconds, "ms"))
    if options.data is not None and (options.data / "pose2sim_balancing").exists() and not options.quick:
        rows += _balancing(options)
    return BenchReport(tuple(rows), {"views": 4, "iterations": 8, "dof": body.skeleton.dof})


def _fast_term(frame: Frame) -> ContourTerm:
    assert frame.silhouettes is not None
    return contour_term(frame.silhouettes, working_height=WORKING_HEIGHT)


def _slow_term(frame: Frame) -> ContourTerm:
    assert frame.silhouettes is not None
    term = contour_term(frame.silhouettes, outline_count=390)
    return term._replace(row_spacing_px=term.row_spacing_px / 3)


def _solve(
    body: Body, q: Array, contours: ContourTerm | None, points: KeypointTerm | None, options: SolveSettings
) -> PoseFit:
    priors = (anatomical_prior(body.skeleton), Quadratic(q, np.full(len(q), 0.1)))
    return fit_pose(body, q, [t for t in (contours, points) if t is not None], priors=priors, options=options)


def _follow(
    body: Body,
    start: Array,
    contours: Iterable[ContourTerm | None],
    points: Iterable[KeypointTerm | None],
    options: SolveSettings,
    repeats: int = 0,
) -> _Solved:
    """Solves frame after frame from the constant-velocity prediction; timed when repeats > 0."""
    s = body.skeleton
    seconds, iterations, poses = [], [], [start, start]
    for c, k in zip(contours, points, strict=True):
        q = s.clamp(poses[-1] + _GAIN * (poses[-1] - s.on_branch(poses[-2], poses[-1])))
        fit = _solve(body, q, c, k, options)
        if repeats:
            seconds.append(best(lambda q=q, c=c, k=k: _solve(body, q, c, k, options), repeats))
        iterations.append(fit.iterations)
        poses.append(fit.pose)
    return _Solved(np.array(seconds), np.array(iterations), np.stack(poses[2:]))


def _balancing(options: BenchOptions) -> list[Row]:
    folder = options.folder("pose2sim_balancing")
    reference = np.load(folder / "kp3d_refined_m.npy")
    rows: list[Row] = []
    with FrameStream(balancing_recording(folder), FrameSettings(masks=False)) as stream:
        rate = stream.recording.frame_rate
        chosen = SubjectOptions("keypoints", frame_rate=rate, girths=False)
        subject = find_subject(stream.frame, len(stream), chosen)
    assert subject.keypoints is not None
    value = float("nan")
    for case, size, make, solve in (("slow reference", 960, _slow_term, _LONG), ("balancing", 480, _fast_term, _FAST)):
        options.progress(case, 0, 1)
        with FrameStream(balancing_recording(folder), FrameSettings(longer_side=size)) as stream:
            terms = [make(f) for f in stream]
        solved = _follow(subject.body, subject.start, terms, [None] * len(terms), solve, int(case == "balancing"))
        found = against_keypoints(case, subject.body, subject.keypoints, solved.poses[1:], reference)[0]
        if case == "balancing":
            found = replace(found, baseline="slow reference", baseline_value=value)
            rows.append(row("ms_per_frame", "balancing", 1e3 * solved.seconds, "ms"))
        rows.append(found)
        value = found.value
    return rows
