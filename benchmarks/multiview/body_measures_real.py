"""A real person's body from silhouettes alone: tracking with it, and its lengths against those of key points."""

from __future__ import annotations

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.multiview.real_recordings import FirstFrames, against_keypoints, balancing_recording
from hypose.body.default_body import human
from hypose.evidence.keypoints import BODY_25B
from hypose.io.recordings.frames import FrameStream
from hypose.pipeline.first_frame import SubjectOptions, TrackedSubject, find_subject, first_start
from hypose.pipeline.run import track_source
from hypose.pipeline.subject_from_motion import SubjectEstimate, estimate_subject, size_uncertainty
from hypose.pipeline.track_options import TrackOptions
from hypose.tracking.keypoint_evidence import keypoint_model


def subject_balancing(options: BenchOptions) -> BenchReport:
    """The Pose2Sim balancing clip with a subject from silhouettes alone: masks made without key points, no height.

    start from key points: the pose in the first frame that has key points, found with the template's own proportions,
    is all that is taken from them; start from the hull: nothing is. Both against the triangulated key points, as in
    real-balancing. length_cm, width_cm: of the fitted body, baseline: of a body whose lengths come from the key points
    of 40 frames; sd: the fit's own.
    """
    folder = options.folder("pose2sim_balancing")
    reference = np.load(folder / "kp3d_refined_m.npy")
    recording = balancing_recording(folder, keypoints=False)
    with FrameStream(balancing_recording(folder)) as with_points, FrameStream(recording) as without:
        n = 30 if options.quick else len(without)
        rate = recording.frame_rate
        options.progress("key points", 0, 3)
        by_points = find_subject(with_points.frame, n, SubjectOptions("keypoints", frame_rate=rate, girths=False))
        rows: list[Row] = []
        template = human()
        starts = {
            "start from key points": first_start(template, keypoint_model(template, BODY_25B), with_points.frame, n)[0],
            "start from the hull": None,
        }
        for k, (case, start) in enumerate(starts.items()):
            options.progress(case, k + 1, 3)
            found = estimate_subject(without.frame, n, rate, template, None, start)
            model = keypoint_model(found.body, BODY_25B)
            subject = TrackedSubject(found.body, model, found.start, found.notes)
            result = track_source(FirstFrames(without, n), rate, TrackOptions(), subject=subject)
            assert result.motion.poses is not None
            # key-point file t belongs to video frame t + 1: frame 0 of the video has none
            rows += against_keypoints(case, found.body, model, result.motion.poses[1:], reference[: n - 1])
            rows.append(Row("iou", case, 1 - float(np.nanmean(result.motion.cost)), "1", n=n))
            rows += _lengths(case, found, by_points.body.segment_lengths())
    return BenchReport(tuple(rows), {"frames": n, "extrinsics": "refined", "joints": 12})


_NAMES = {"upper_arm": "upper arm", "forearm": "forearm", "thigh": "thigh", "shank": "shank", "torso": "torso"}


def _lengths(case: str, found: SubjectEstimate, by_points: dict[str, float]) -> list[Row]:
    own, sd = found.body.segment_lengths(), size_uncertainty(found, human())
    rows = [Row("stature_cm", case, 100 * found.body.stature, "cm")]
    for key in ("torso", "left_upper_arm", "left_forearm", "left_thigh", "left_shank", "shoulder_width", "hip_width"):
        name = _NAMES.get(key.removeprefix("left_"), key.replace("_", " "))
        given = {"baseline": "lengths of the key points", "baseline_value": 100 * by_points[key]}
        rows.append(Row("length_cm", f"{case}/{name}", 100 * own[key], "cm", 100 * sd[name], **given))
    return rows
