"""One view of the balancing clip: the monocular tracker against the key points triangulated from all four views."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.multiview.real_recordings import LIMBS, balancing_recording
from hypose.evidence.keypoints import BODY_25B
from hypose.geometry import Array
from hypose.io.recordings.frames import FrameSettings, FrameStream
from hypose.io.recordings.recording import Recording
from hypose.pipeline.recorded_frames import needs_masks, one_view
from hypose.pipeline.run import TrackResult, track_source
from hypose.pipeline.subject import SubjectOptions, TrackedSubject, find_subject
from hypose.pipeline.track_options import TrackOptions

CAMERA = "cam03"
_HIPS = tuple(LIMBS.index(BODY_25B.index(f"{side}_hip")) for side in ("left", "right"))
CASES = (
    "keypoints",
    "keypoints/live",
    "both",
    "edges",
    "edges/live",
    "silhouettes",
    "keypoints/one_view",
    "keypoints/one_view/live",
    "both/one_view",
)


def mono_real(options: BenchOptions) -> BenchReport:
    """root_aligned_mm: mean distance of 12 limb joints to the triangulated key points (good to 2-3 cm, not marker
    truth), middles of the hips made to coincide; offsets between detector's points and joints are those of the subject
    fitted to all four views. depth_mm: its part along the optical axis; image_error_px of the 1088 x 1920 picture.

    keypoints, both (with silhouettes): start and every frame from this view's own key points, which took part in the
    reference; edges, silhouettes: only the start from key points, then edges and flow, and masks besides. The body is
    the one of all four views, or, in '/one_view', found from this view alone and the height. '/live': frame after
    frame, where the others solve the whole clip. quick: 15 frames of the first case, with the girths of the template,
    so that no video but that one is read.
    """
    folder = options.folder("pose2sim_balancing")
    reference = np.load(folder / "kp3d_refined_m.npy")
    whole = balancing_recording(folder)
    n = 16 if options.quick else len(whole.frames)
    options.progress("subject", 0, 1)
    subject_options = SubjectOptions("keypoints", girths=not options.quick, frame_rate=whole.frame_rate)
    with FrameStream(whole, FrameSettings(masks=False) if options.quick else None) as stream:
        subject = find_subject(stream.frame, len(stream), subject_options)
    recording = replace(one_view(whole, CAMERA), frame_range=(1, n))  # key points begin with video frame 1
    rows: list[Row] = []
    cases = CASES[:1] if options.quick else CASES
    for k, case in enumerate(cases):
        options.progress(case, k, len(cases))
        found = _track(recording, case, subject)
        rows += _rows(case, found, subject, recording, reference)
    return BenchReport(tuple(rows), {"frames": n - 1, "camera": CAMERA, "joints": len(LIMBS), "frame_rate": 60})


def _track(recording: Recording, case: str, subject: TrackedSubject) -> TrackResult:
    evidence, known = case.split("/")[0], "/one_view" not in case
    height = None if known else subject.body.stature
    options = TrackOptions("monocular", evidence=evidence, height=height, smooth=not case.endswith("/live"))
    with FrameStream(recording, FrameSettings(masks=needs_masks(recording, evidence))) as stream:
        return track_source(stream, recording.frame_rate, options, body=subject.body if known else None)


def _rows(case: str, found: TrackResult, subject: TrackedSubject, recording: Recording, reference: Array) -> list[Row]:
    assert found.motion.poses is not None and found.modes is not None and subject.keypoints is not None
    model = subject.keypoints
    limbs = np.array(LIMBS)
    rotations, centres = found.body.skeleton.forward(found.motion.poses)
    joint, offset = model.joint[limbs], model.offset[limbs]
    points = centres[:, joint] + np.einsum("tkab,kb->tka", rotations[:, joint], offset)
    truth = reference[: len(points)][:, limbs]  # key-point file t belongs to video frame t + 1
    camera = recording.rig[0]
    shown = np.linalg.norm(camera.project_pinhole(points) - camera.project_pinhole(truth), axis=-1)
    apart = points - points[:, _HIPS].mean(1, keepdims=True) - truth + truth[:, _HIPS].mean(1, keepdims=True)
    error = 1e3 * np.linalg.norm(apart, axis=-1)
    depth = 1e3 * np.abs(apart @ camera.camera_from_world[2, :3])
    per_frame = np.nanmean(error, axis=1)
    return [
        Row("root_aligned_mm", case, float(np.nanmean(error)), "mm", float(np.nanstd(per_frame)), len(error)),
        Row("median_mm", case, float(np.nanmedian(error)), "mm", n=len(error)),
        Row("depth_mm", case, float(np.nanmean(depth)), "mm", n=len(error)),
        Row("image_error_px", case, float(np.nanmean(shown)), "px", n=len(error)),
        Row("alive", case, float(found.modes.alive.mean()), "1", n=len(error)),
    ]
