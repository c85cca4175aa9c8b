"""Benchmarks on real recordings that are given by folder (`--data`): agreement with key points, masks, hulls."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.multiview.leave_one_out import agreement_with_the_tool, leave_one_out, pose2sim_of, rows_of
from hypose.body.body import Body
from hypose.body.default_body import human
from hypose.cameras.camera import Camera, CameraRig, triangulate
from hypose.evidence.frame import Frame, Silhouettes
from hypose.evidence.hull import hull_iou, visual_hull
from hypose.evidence.keypoints import BODY_25B
from hypose.evidence.silhouettes import as_mask, biggest_parts, make_silhouettes
from hypose.geometry import Array, se3, so3_exp
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import Recording, ViewSettings, load_recording
from hypose.io.videos.video import open_video
from hypose.pipeline.run import track_source
from hypose.pipeline.subject import SubjectOptions, find_subject
from hypose.pipeline.track_loop import FrameList
from hypose.pipeline.track_options import TrackOptions
from hypose.tracking.frame_evidence import KeypointModel, prepare

LIMBS = tuple(
    BODY_25B.index(f"{side}_{part}")
    for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    for side in ("left", "right")
)
_SEGMENTS = ((0, 2), (1, 3), (2, 4), (3, 5), (6, 8), (7, 9), (8, 10), (9, 11))
"""the limbs' segments by pairs of LIMBS"""


def balancing_recording(folder: Path, *, keypoints: bool = True) -> Recording:
    """The Pose2Sim balancing clip with its refined extrinsics and the measured cures: key-point file t belongs to video
    frame t + 1, camera 1's images lie 6 px to the left of its key points, cameras 1-2 were stretched."""
    recording = load_recording(folder)
    refined = json.loads((folder / "extrinsics_refined.json").read_text())
    cameras = []
    for camera, rvec, tvec in zip(recording.rig, refined["rvec"], refined["tvec"], strict=True):
        cameras.append(replace(camera, camera_from_world=se3(so3_exp(np.ravel(rvec)), np.ravel(tvec))))
    views = list(recording.views)
    views[0] = replace(views[0], image_shift=(6.0, 0.0))
    for n, view in enumerate(views):
        plates = sorted(folder.glob(f"calibration/extrinsics/*cam0{n + 1}*/*.png"))
        views[n] = replace(view, files={**view.files, "background": plates[0]} if plates else view.files)
        views[n] = views[n] if keypoints else views[n].without("keypoints")
    return replace(recording, rig=CameraRig(tuple(cameras)), views=tuple(views), keypoint_lag=1)


def real_balancing(options: BenchOptions) -> BenchReport:
    """Distance of 12 limb joints to the triangulated key points of the clip (not marker truth), fixed joint alignment.

    silhouettes: tracked from silhouettes alone after a subject and a start from key points; masks made without key
    points. silhouettes, masks with key points: the background is taken where the key points' skeleton is not.
    keypoints, both: the same clip with key points as evidence (judged against themselves). pose2sim: that tool's method
    on the same key points and extrinsics; agreement_mm: its median distance from the tool's own result file.
    loco_px: median distance, in the camera left out, of what the other three say (`leave_one_out`).
    """
    folder = options.folder("pose2sim_balancing")
    reference = np.load(folder / "kp3d_refined_m.npy")
    recording = balancing_recording(folder)
    rate = recording.frame_rate
    n = 20 if options.quick else len(recording.frames)
    with_points = in_memory(recording, n)
    without = in_memory(balancing_recording(folder, keypoints=False), n)
    rows: list[Row] = []
    options.progress("subject", 0, 10)
    subject = find_subject(with_points.frame, n, SubjectOptions("keypoints", frame_rate=rate))
    cases = (
        ("silhouettes", without, "silhouettes"),
        ("silhouettes, masks with key points", with_points, "silhouettes"),
        ("keypoints", with_points, "keypoints"),
        ("both", with_points, "both"),
    )
    for k, (case, source, evidence) in enumerate(cases):
        options.progress(case, k + 1, 10)
        result = track_source(source, rate, TrackOptions(evidence=evidence), subject=subject)
        assert result.motion.poses is not None and subject.keypoints is not None
        assert subject.keypoints.names == BODY_25B  # the order of the reference
        # key-point file t belongs to video frame t + 1: frame 0 of the video has none
        rows += against_keypoints(case, subject.body, subject.keypoints, result.motion.poses[1:], reference[: n - 1])
        rows += _overlap(case, subject.body, result.motion.poses, source)
    rows += _pose2sim(folder, recording, with_points.frames[1:], reference)
    if not options.quick:
        left_out = leave_one_out(
            with_points.frames[1:], recording.rig, rate, lambda c: options.progress("leave one out", 5 + c, 10)
        )
        rows += rows_of(left_out)
    options.progress("done", 10, 10)
    return BenchReport(
        tuple(rows), {"frames": n, "extrinsics": "refined", "joints": 12, "subject": list(subject.notes)}
    )


def in_memory(recording: Recording, n: int) -> FrameList:
    """The first n frames of a recording."""
    with FrameStream(recording) as stream:
        return FrameList([stream.frame(i) for i in range(n)], recording.frame_rate)


def _overlap(case: str, body: Body, poses: Array, source: FrameList) -> list[Row]:
    """IoU of body and masks, mean over the frames, in each view and over all."""
    by_view = [
        prepare(frame, body, pose).silhouettes.overlap(body, pose)
        for pose, frame in zip(poses, source.frames, strict=True)
        if frame.silhouettes is not None
    ]
    mean = np.nanmean(by_view, axis=0)
    rows = [Row("iou", f"{case}/view {c + 1}", float(x), "1", n=len(by_view)) for c, x in enumerate(mean)]
    return [*rows, Row("iou", case, float(mean.mean()), "1", n=len(by_view))]


def _pose2sim(folder: Path, recording: Recording, frames: Sequence[Frame], reference: Array) -> list[Row]:
    """The same figures for points made by Pose2Sim's method, and how near that is to the tool's own result."""
    own = pose2sim_of(frames, recording.rig, recording.frame_rate)
    distance = np.linalg.norm(own - reference[: len(own)], axis=-1)[:, LIMBS] * 1e3
    points = own[:, LIMBS]
    lengths = [np.nanstd(np.linalg.norm(points[:, a] - points[:, b], axis=-1)) * 1e3 for a, b in _SEGMENTS]
    agreement = agreement_with_the_tool(folder, frames, load_recording(folder).rig, BODY_25B)
    return [
        Row("median_mm", "pose2sim", float(np.nanmedian(distance)), "mm", n=distance.size),
        Row("p95_mm", "pose2sim", float(np.nanpercentile(distance, 95)), "mm", n=distance.size),
        Row("bone_sd_mm", "pose2sim", float(np.mean(lengths)), "mm", n=len(lengths)),
        Row("agreement_mm", "pose2sim", 1e3 * agreement, "mm", n=len(own)),
    ]


class FirstFrames:
    """The first n frames of a stream."""

    def __init__(self, stream: FrameStream, n: int) -> None:
        self.stream, self.n = stream, n

    def __len__(self) -> int:
        return self.n

    def frame(self, index: int, /) -> Frame:
        """Frame number index."""
        return self.stream.frame(index)


def against_keypoints(case: str, body: Body, model: KeypointModel, poses: Array, reference: Array) -> list[Row]:
    """Rows of 12 limb joints of poses (T, D) against triangulated key points (T, 25, 3) m, NaN = not seen."""
    rotations, centres = body.skeleton.forward(poses)
    limbs = np.array(LIMBS)
    joint, offset = model.joint[limbs], model.offset[limbs]
    r, p = rotations[:, joint], centres[:, joint]
    target = reference[: len(poses)][:, limbs]
    # one offset per joint in its segment's frame, learnt once over the clip: joint definitions differ
    local = np.einsum("tkba,tkb->tka", r, target - p)
    fixed = np.nanmean(local, axis=0)
    aligned = np.linalg.norm(p + np.einsum("tkab,kb->tka", r, fixed) - target, axis=-1) * 1e3
    given = np.linalg.norm(p + np.einsum("tkab,kb->tka", r, offset) - target, axis=-1) * 1e3
    points = p + np.einsum("tkab,kb->tka", r, fixed)
    sd = [np.std(np.linalg.norm(points[:, a] - points[:, b], axis=-1)) * 1e3 for a, b in _SEGMENTS]
    joints = body.joints(poses)
    bones = [
        np.std(np.linalg.norm(joints[:, j] - joints[:, q], axis=-1)) * 1e3
        for j, q in enumerate(body.skeleton.parents)
        if q >= 0
    ]
    return [
        Row("median_mm", case, float(np.nanmedian(aligned)), "mm", n=aligned.size),
        Row("p95_mm", case, float(np.nanpercentile(aligned, 95)), "mm", n=aligned.size),
        Row("median_mm, offsets of the subject", case, float(np.nanmedian(given)), "mm", n=given.size),
        Row("bone_sd_mm", case, float(np.max(bones)), "mm", n=len(bones)),
        Row("marker_distance_sd_mm", case, float(np.median(sd)), "mm", n=len(sd)),
    ]


def uu4cam_recording(folder: Path) -> Recording:
    """The four-camera recording of a seated person: calibration in mm with z down, background clips."""
    given = json.loads((folder / "calib_refined.json").read_text())
    flip = np.diag([1.0, -1.0, -1.0])  # world of the board (z down) -> z up
    cameras, views = [], []
    for n in range(1, 5):
        c = given[str(n)]
        rotation = so3_exp(np.ravel(c["rvec"])) @ flip.T
        pose = se3(rotation, np.ravel(c["tvec"]) / 1000)
        cameras.append(Camera(f"cam{n}", np.array(c["K"]), np.ravel(c["D"]).astype(float), pose, (644, 486)))
        here = folder / f"cam{n}"
        views.append(ViewSettings(f"cam{n}", {"video": here / "video.avi", "background": here / "background.avi"}))
    n = min(open_video(v.files["video"]).n_frames for v in views)
    return Recording(folder, "uu4cam", CameraRig(tuple(cameras)), tuple(views), 50.0, (0, n))


def clicked_joints(rig: CameraRig) -> dict[str, Array]:
    """Triangulate the joints of the seated man of uu4cam that were clicked in the pictures (uu4cam_clicks.csv): (3,) m
    by name, good to 2 to 4 cm."""
    lines = [x for x in Path(__file__).with_name("uu4cam_clicks.csv").read_text().splitlines() if x[:1] not in "#"]
    clicks = [x.split(",") for x in lines[1:] if x]
    names = sorted({joint for _, joint, _, _ in clicks})
    points, weights = np.zeros((len(rig), len(names), 2)), np.zeros((len(rig), len(names)))
    for camera, joint, u, v in clicks:
        c, k = rig.names.index(camera), names.index(joint)
        points[c, k], weights[c, k] = rig[c].undistort_points(np.array([[float(u), float(v)]]))[0], 1.0
    return dict(zip(names, triangulate(rig.pinhole(), points, weights)[0], strict=True))


def real_uu4cam(options: BenchOptions) -> BenchReport:
    """Masks against those of a student's work, and the visual hull against the masks."""
    folder = options.folder("uu4cam")
    recording = uu4cam_recording(folder)
    stream = FrameStream(recording)
    step = 40 if options.quick else 10
    masks_iou: list[Array] = []
    hulls: list[Array] = []
    volumes = []
    theirs = [open_video(v.files["video"].parent / "foreground_mask.avi") for v in recording.views]
    indices = range(0, len(stream), step)
    for k, i in enumerate(indices):
        options.progress("masks and hulls", k, len(indices))
        frame = stream.frame(i)
        assert frame.silhouettes is not None
        given = _undistorted([as_mask(reader.read(i)) for reader in theirs], recording.rig, frame.silhouettes)
        # the student's masks hold specks all over the room: the person is the largest piece of either
        a, b = _largest(frame.silhouettes.masks), _largest(given.masks)
        masks_iou.append((a & b).sum((1, 2)) / np.maximum((a | b).sum((1, 2)), 1))
        hull = visual_hull(frame.silhouettes, voxel=0.02)
        hulls.append(hull_iou(hull, frame.silhouettes))
        volumes.append(1e3 * hull.volume)
    rows = [
        Row("mask_iou", v.name, float(np.mean(masks_iou, 0)[c]), "1", n=len(masks_iou))
        for c, v in enumerate(recording.views)
    ]
    rows.append(Row("mask_iou", "worst view", float(np.mean(masks_iou, 0).min()), "1", n=len(masks_iou)))
    rows += [
        Row("hull_iou", v.name, float(np.mean(hulls, 0)[c]), "1", n=len(hulls)) for c, v in enumerate(recording.views)
    ]
    rows.append(Row("hull_iou", "worst view", float(np.mean(hulls, 0).min()), "1", n=len(hulls)))
    rows.append(Row("hull_volume_l", "all", float(np.mean(volumes)), "l", n=len(volumes)))
    return BenchReport(tuple(rows), {"frames": len(masks_iou), "body": human().name})


def _largest(masks: np.ndarray) -> np.ndarray:
    return np.stack([biggest_parts(m, 1.0) for m in masks]) > 0


def _undistorted(masks: list[np.ndarray], rig: CameraRig, like: Silhouettes) -> Silhouettes:
    """Masks of the stored images warped to the working cameras of `like`."""
    out = []
    for mask, camera, small in zip(masks, rig, like.rig, strict=True):
        maps = camera.undistort_maps(small.size, (mask.shape[1], mask.shape[0]))
        out.append((cv2.remap(mask.astype(np.uint8) * 255, *maps, cv2.INTER_LINEAR) > 127).astype(np.uint8))
    return make_silhouettes(out, like.rig)
