"""Leave one camera out: what three cameras say, looked at through the fourth, on the real balancing clip."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.bench_report import Row
from benchmarks.multiview.pose2sim_method import pose2sim_points
from hypose.cameras.camera import CameraRig
from hypose.evidence.frame import Frame, Keypoints, Silhouettes
from hypose.evidence.keypoints import triangulate_keypoints
from hypose.evidence.terms import contour_term
from hypose.fitting import fit_pose
from hypose.geometry import Array
from hypose.io.motions.marker_files import read_trc
from hypose.pipeline.subject import SubjectOptions, TrackedSubject, find_subject
from hypose.tracking.frame_evidence import keypoint_term
from hypose.tracking.keypoint_clip import solve_keypoint_clip
from hypose.tracking.refinement import anatomical_prior
from hypose.tracking.smoothing import smooth_poses

CONFIDENT = 0.5
"""Key points of the camera left out count from this confidence on."""
METHODS = ("triangulation", "pose2sim", "keypoints", "both")


@dataclass(frozen=True)
class LeftOut:
    """What came of one camera left out: error_px (T, K) of each method in full-size pixels of that camera, NaN where
    the camera does not show the point or a method has none there."""

    camera: str
    error_px: dict[str, Array]


def without_view(frame: Frame, view: int) -> Frame:
    """The frame as the other cameras alone saw it."""

    def rest(rig: CameraRig) -> CameraRig:
        return CameraRig(tuple(c for k, c in enumerate(rig) if k != view))

    s, k = frame.silhouettes, frame.keypoints
    given = s or k
    keep = [i for i in range(len(given.rig)) if i != view] if given is not None else []
    return replace(
        frame,
        silhouettes=None
        if s is None
        else Silhouettes(s.masks[keep], rest(s.rig), s.usable[keep], tuple(s.reasons[i] for i in keep)),
        keypoints=None if k is None else Keypoints(k.points[keep], k.names, rest(k.rig)),
    )


def leave_one_out(
    frames: Sequence[Frame], rig: CameraRig, frame_rate: float, progress: Callable[[int], None]
) -> list[LeftOut]:
    """Each camera of a recording left out in turn; frames with silhouettes and key points of all views, the
    recording's full-size rig. Lengths, girths, offsets and noise come from the other cameras alone."""
    out = []
    for view, camera in enumerate(rig.pinhole()):
        progress(view)
        rest = [without_view(f, view) for f in frames]
        found = _methods(rest, CameraRig(tuple(c for k, c in enumerate(rig.pinhole()) if k != view)), frame_rate)
        seen = np.stack([_full_size(_given(f), rig)[view] for f in frames])
        error = {
            name: np.where(
                seen[..., 2] > CONFIDENT, np.linalg.norm(camera.project_pinhole(x) - seen[..., :2], axis=-1), np.nan
            )
            for name, x in found.items()
        }
        everywhere = np.all([np.isfinite(e) for e in error.values()], axis=0)
        out.append(LeftOut(camera.name, {name: np.where(everywhere, e, np.nan) for name, e in error.items()}))
    return out


def _given(frame: Frame) -> Keypoints:
    assert frame.keypoints is not None
    return frame.keypoints


def pose2sim_of(frames: Sequence[Frame], rig: CameraRig, frame_rate: float) -> Array:
    """(T, K, 3) m: Pose2Sim's points from the frames' key points; rig: their full-size cameras."""
    return pose2sim_points(rig.pinhole(), np.stack([_full_size(_given(f), rig) for f in frames]), frame_rate)


def _full_size(keypoints: Keypoints, rig: CameraRig) -> Array:
    """(C, K, 3) with pixels of the full-size cameras."""
    out = keypoints.points.copy()
    for c, camera in enumerate(rig):
        scale = np.array(camera.size) / np.array(keypoints.rig[c].size)
        out[c, :, :2] = (out[c, :, :2] + 0.5) * scale - 0.5
    return out


def _methods(frames: Sequence[Frame], rig: CameraRig, rate: float) -> dict[str, Array]:
    """Points (T, K, 3) m of each method from the frames of three cameras."""
    subject, poses = solved_clip(frames, rate)
    return {
        "triangulation": triangulate_keypoints([_given(f) for f in frames])[0],
        "pose2sim": pose2sim_of(frames, rig, rate),
        "keypoints": body_points(subject, poses),
        "both": body_points(subject, both_clip(subject, frames, poses, rate)),
    }


def solved_clip(frames: Sequence[Frame], rate: float) -> tuple[TrackedSubject, Array]:
    """The subject of key points alone and its poses (T, D), the clip solved as one."""
    subject = find_subject(lambda i: frames[i], len(frames), SubjectOptions("keypoints", frame_rate=rate))
    assert subject.keypoints is not None
    poses, _ = solve_keypoint_clip(subject.body, subject.keypoints, [_given(f) for f in frames], subject.start, rate)
    return subject, poses


def body_points(subject: TrackedSubject, poses: Array) -> Array:
    """(T, K, 3) m: where a subject's key points are; NaN for those that the body does not have."""
    assert subject.keypoints is not None
    model = subject.keypoints
    return np.where(model.known[:, None], model.positions(subject.body, poses), np.nan)


def both_clip(
    subject: TrackedSubject, frames: Sequence[Frame], poses: Array, rate: float, weight: float = 0.05
) -> Array:
    """Poses (T, D) of a whole clip from key points and contours together, from those of the key points."""
    s = subject.body.skeleton
    fits = []
    for f, q in zip(frames, poses, strict=True):
        points = None if f.keypoints is None else keypoint_term(f.keypoints, subject.body, subject.keypoints, q)
        seen = f.silhouettes is not None and f.silhouettes.usable.any()
        contours = contour_term(f.silhouettes, weight) if f.silhouettes is not None and seen else None
        fits.append(
            fit_pose(subject.body, q, [t for t in (contours, points) if t is not None], priors=(anatomical_prior(s),))
        )
    return smooth_poses(subject.body, np.stack([f.pose for f in fits]), np.stack([f.information for f in fits]), rate)


def rows_of(results: Sequence[LeftOut]) -> list[Row]:
    """loco_px per method over all cameras and for each; baseline: Pose2Sim's method on the same samples."""
    rows = []
    for case, chosen in (("", results), *((f"/{r.camera}", [r]) for r in results)):
        middle = {m: _median([r.error_px[m] for r in chosen]) for m in METHODS}
        for method, (value, n) in middle.items():
            rows.append(Row("loco_px", method + case, value, "px", None, n, f"pose2sim{case}", middle["pose2sim"][0]))
    return rows


def _median(errors: Sequence[Array]) -> tuple[float, int]:
    all_of = np.concatenate([e[np.isfinite(e)] for e in errors])
    return float(np.median(all_of)), len(all_of)


def agreement_with_the_tool(folder: Path, frames: Sequence[Frame], shipped: CameraRig, names: Sequence[str]) -> float:
    """Median distance (m) of our form of Pose2Sim's method from the tool's own result file, on its own calibration:
    how far the comparison may be trusted. NaN without the file."""
    found = sorted((folder / "pose2sim_0.10.49_output").glob("*filt_butterworth.trc"))
    if not found:
        return float("nan")
    tool = read_trc(found[0])
    own = pose2sim_of(frames, shipped, tool.frame_rate)
    alike = {n.lower().replace("_", ""): k for k, n in enumerate(names)}
    distances = []
    for m, name in enumerate(tool.names):
        long = {"R": "right", "L": "left"}.get(name[0], "") + name[1:].lower()
        k = alike.get(long if long in alike else name.lower())
        if k is not None:
            n = min(len(own), len(tool.points))
            distances.append(np.linalg.norm(own[:n, k] - tool.points[:n, m], axis=-1))
    return float(np.nanmedian(np.concatenate(distances)))
