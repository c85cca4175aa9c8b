"""The doctor and the refinement on the real balancing clip, whose faults were measured by hand before."""

from __future__ import annotations

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from hypose.calibration.diagnostics import Cured, PersonReport, examine
from hypose.io.recordings.recording import load_recording
from hypose.pipeline.recording_diagnostics import (
    ALL_VIEWS,
    LEFT_OUT,
    cured_recording,
    observe_recording,
    refine_recording,
)

POSE2SIM_LEFT_OUT_PX = 24.19
"""Median px of Pose2Sim 0.10.49 (filtered) in the view left out, on the shipped calibration, all frames; measured once,
by running it on three views at a time."""


def doctor_real(options: BenchOptions) -> BenchReport:
    """pose2sim_balancing: what the doctor finds by itself (1 = found), and the median residual on frames that were not
    used: shipped, refined from key points, from silhouettes (masks that know nothing of the key points; body and start
    poses from the key points). Left-out residuals against Pose2Sim's."""
    recording = load_recording(options.folder("pose2sim_balancing"))
    options.progress("doctor", 0, 3)
    observed = observe_recording(recording, 60 if options.quick else 100)
    report, cured = examine(observed)
    rows = [Row("found", case, value, "1") for case, value in _found(report, cured).items()]
    rows += [Row("findings", "all", float(len(report.findings)), "1")]
    healed = cured_recording(recording, cured)
    methods = ("keypoints",) if options.quick else ("keypoints", "silhouettes")
    for k, case in enumerate(methods):
        options.progress(case, k + 1, 3)
        result = refine_recording(healed, case, late=cured.late)
        (shipped, refined), (shipped_out, refined_out) = (result.residuals[what] for what in (ALL_VIEWS, LEFT_OUT))
        if k == 0:
            rows += [Row("refined_residual_px", "shipped", shipped, "px"), _left_out("shipped", shipped_out)]
        rows += [Row("refined_residual_px", case, refined, "px"), _left_out(case, refined_out)]
    return BenchReport(tuple(rows), {"frames": len(recording.frames), "used": 17})


def _left_out(case: str, value: float) -> Row:
    return Row("left_out_px", case, value, "px", baseline="Pose2Sim, shipped", baseline_value=POSE2SIM_LEFT_OUT_PX)


def _found(report: PersonReport, cured: Cured) -> dict[str, float]:
    def has(kind: str, view: str = "") -> bool:
        return any(f.kind == kind and (not view or view in f.views) for f in report.findings)

    shift = cured.shift[0]
    return {
        "scaled videos of cameras 1 and 2": float(has("size", "cam_01") and has("size", "cam_02")),
        "key points one frame early": float(cured.keypoint_lag == 1),
        "6 px shift in camera 1": float(has("keypoint_shift", "cam_01") and abs(shift[0] - 6) < 1.5),
        "biased extrinsics": float(has("extrinsics")),
        "nothing else": float(
            {f.kind for f in report.findings} <= {"size", "keypoint_lag", "keypoint_shift", "extrinsics"}
            and not cured.shift[1:].any()
        ),
    }
