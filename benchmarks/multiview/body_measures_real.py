"""Measure tracking with a real person's body from silhouettes alone."""

from __future__ import annotations

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.multiview.real_recordings import FirstFrames, against_keypoints, balancing_recording
from hypose.body.default_body import human
from hypose.evidence.keypoints import BODY_25B
from hypose.io.recordings.frames import FrameStream
from hypose.pipeline.first_frame import TrackedSubject, first_start
from hypose.pipeline.run import track_source
from hypose.pipeline.subject_from_motion import estimate_subject
from hypose.pipeline.track_options import TrackOptions
from hypose.tracking.keypoint_evidence import keypoint_model


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
            found = estimate_subject(without.frame, n, rate, template, None, start)
            model = keypoint_model(found.body, BODY_25B)
            subject = TrackedSubject(found.body, model, found.start, found.notes)
            result = track_source(FirstFrames(without, n), rate, TrackOptions(), subject=subject)
            assert result.motion.poses is not None
            # key-point file t belongs to video frame t + 1: frame 0 of the video has none
            rows += against_keypoints(case, found.body, model, result.motion.poses[1:], reference[: n - 1])
            rows.append(Row("iou", case, 1 - float(np.nanmean(result.motion.cost)), "1", n=n))
    return BenchReport(tuple(rows), {"frames": n, "extrinsics": "refined", "joints": 12})
