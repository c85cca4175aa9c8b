"""Speed of the whole-clip solve on key points."""

from __future__ import annotations

import time

from benchmarks.bench_report import Row
from hypose.pipeline.first_frame import TrackedSubject
from hypose.synthetic.scenes import Scene
from hypose.tracking.keypoint_clip import solve_keypoint_clip
from hypose.tracking.keypoint_evidence import keypoint_model


def keypoint_clip_rows(scene: Scene, subject: TrackedSubject, repeats: int) -> list[Row]:
    """frames_per_second and cpu_ms_per_frame of `solve_keypoint_clip` (key points in, poses of all frames out), the
    least of some runs; 25 key points in every view, half-size pictures."""
    seen = [f.keypoints for f in scene.mask_frames(0.5, keypoints=True)]
    names = next(k.names for k in seen if k is not None)
    model = keypoint_model(subject.body, names)
    walls, cpus = [], []
    for _ in range(repeats + 1):  # the first one loads the kernels
        wall, cpu = time.perf_counter(), time.process_time()
        solve_keypoint_clip(subject.body, model, seen, subject.start, scene.frame_rate)
        walls.append((time.perf_counter() - wall) / len(seen))
        cpus.append((time.process_time() - cpu) / len(seen))
    case = f"keypoints:clip/{len(scene.rig)}"
    return [
        Row("frames_per_second", case, 1 / min(walls), "1/s", n=len(seen)),
        Row("cpu_ms_per_frame", case, 1e3 * min(cpus), "ms", n=len(seen)),
    ]
