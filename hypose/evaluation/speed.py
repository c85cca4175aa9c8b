"""Speed of the hot parts and of whole tracking, each against a baseline measured in the same run."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from hypose.evaluation.benchmarks import BenchOptions, BenchReport, Row, row
from hypose.evaluation.published import action_scene, known_subject
from hypose.evaluation.timing import best
from hypose.evaluation.write_recording import write_scene
from hypose.evidence.frame import Frame
from hypose.fitting.articulated import SolveOptions, contour_term, fit_pose
from hypose.io.frames import FrameStream
from hypose.io.recording import load_recording
from hypose.io.video import open_video
from hypose.tracking.recipes import recipe
from hypose.tracking.refinement import anatomical_prior, prediction_prior
from hypose.tracking.tracker import Tracker, TrackerSettings


def contour_solve(options: BenchOptions) -> BenchReport:
    """Milliseconds per frame of the robust contour solve (8 iterations, 4 views) and its iterations."""
    scene = action_scene("walk", 0, 0.4 if options.quick else 1.0, options)
    subject = known_subject(scene)
    body, start = subject.body, subject.start
    rows = []
    for case, scale in (("contours", 1.0), ("contours, half size", 0.5)):
        seconds, iterations, pose = [], [], start
        for frame in scene.mask_frames(scale):
            assert frame.silhouettes is not None
            term = contour_term(frame.silhouettes)
            priors = (anatomical_prior(body.skeleton), prediction_prior(pose, 0.1))
            fit = fit_pose(body, pose, contours=term, priors=priors, options=SolveOptions())
            seconds.append(
                best(
                    lambda q=pose, t=term, p=priors: fit_pose(body, q, contours=t, priors=p, options=SolveOptions()), 3
                )
            )
            iterations.append(fit.iterations)
            pose = fit.pose
        rows.append(row("ms_per_frame", case, 1e3 * np.array(seconds), "ms"))
        rows.append(Row("iterations_p90", case, float(np.percentile(iterations, 90)), "1", n=len(iterations)))
    return BenchReport(tuple(rows), {"views": 4, "iterations": 8, "dof": body.skeleton.dof})


def multiview_speed(options: BenchOptions) -> BenchReport:
    """Frames per second of whole tracking from masks and from 640 x 480 videos, per preset, against merely decoding."""
    seconds = 0.4 if options.quick else 2.0
    scene = action_scene("walk", 0, seconds, options)
    frames = list(scene.mask_frames(1.0))
    rows = []
    for preset in ("default",) if options.quick else ("default", "hpf", "apf"):
        options.progress(preset, 0, 1)
        rows.append(
            Row("frames_per_second", f"masks:{preset}/4", _tracking_rate(scene, frames, preset), "1/s", n=len(frames))
        )
    with tempfile.TemporaryDirectory() as folder:
        recording = load_recording(write_scene(scene, Path(folder)).parent)
        decode = best(lambda: [list(open_video(v.video)) for v in recording.views if v.video], 2) / len(frames)
        stream = FrameStream(recording)
        begin = time.perf_counter()
        from_video = [stream.frame(i) for i in range(len(stream))]
        evidence = (time.perf_counter() - begin) / len(from_video)
        track = 1 / _tracking_rate(scene, from_video, "default")
        total = evidence + track
        against = {"baseline": "decoding the videos alone", "baseline_value": 1 / decode}
        rows.append(Row("frames_per_second", "480p:default/4", 1 / total, "1/s", n=len(frames), **against))
        for stage, value in (("evidence", evidence), ("tracking", track)):
            rows.append(Row("stage_share", stage, value / total, "1"))
    return BenchReport(tuple(rows), {"views": 4, "size": [640, 480], "seconds": seconds})


def _tracking_rate(scene, frames: list[Frame], preset: str) -> float:  # noqa: ANN001 - a Scene
    subject = known_subject(scene)
    made, particles = recipe(preset, subject.body, frame_rate=scene.frame_rate)
    tracker = Tracker(subject.body, made, particles, TrackerSettings(frame_rate=scene.frame_rate))
    state, _ = tracker.step(tracker.start(subject.start), frames[0])
    begin = time.perf_counter()
    for frame in frames[1:]:
        state, _ = tracker.step(state, frame)
    return (len(frames) - 1) / (time.perf_counter() - begin)
