"""Captured movement seen through the cameras of real recordings: what the benchmarks `cameras` and `gait` track."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.bench_report import BenchOptions
from benchmarks.multiview.action_scenes import subject_of_seed
from benchmarks.multiview.real_recordings import balancing_recording, uu4cam_recording
from benchmarks.synthetic.human4d import Human4d, read_human4d
from benchmarks.synthetic.retarget import retarget
from benchmarks.synthetic.spoilt_keypoints import like_a_detector
from benchmarks.synthetic.treadmill import human4d_joints
from hypose.app.live.simulated_sensors import FRAME_RATE
from hypose.cameras.camera import Camera, CameraRig, triangulate
from hypose.evidence.frame import Frame, Keypoints
from hypose.evidence.keypoints import BODY_25, to_keypoints
from hypose.evidence.one_person import one_person
from hypose.fusion import joints as jt
from hypose.geometry import Array, se3, se3_inverse, transform
from hypose.synthetic.performance import Performance
from hypose.synthetic.scenes import keypoint_places
from hypose.synthetic.subjects import SyntheticSubject

LIMBS = tuple(f"{s}_{p}" for p in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle") for s in ("left", "right"))
_DEPTH_SIZE = (1280, 720)
_LEAST_CONFIDENCE = 0.1


@dataclass(frozen=True)
class Captured:
    """A movement about the origin of a world with z up. names (K) and places (T, K, 3) m of its key points; truth:
    joint name -> (T, 3) m; the subject and its performance where it was retargeted."""

    name: str
    frame_rate: float
    names: tuple[str, ...]
    places: Array
    truth: dict[str, Array]
    subject: SyntheticSubject | None = None
    performance: Performance | None = None


def retargeted(
    options: BenchOptions, clip: str, seed: int, *, rate: float, start: float, seconds: float, keep_trend: float = 0.25
) -> Captured:
    """A capture of CMU's subject 02 on the body of a seed."""
    folder, subject = options.folder("mocap"), subject_of_seed(seed)
    p = retarget(
        folder / "02.asf", folder / f"{clip}.amc", subject, rate, start=start, seconds=seconds, keep_trend=keep_trend
    )
    places = keypoint_places(subject, p.rotations, p.joints)
    truth = {n: places[:, BODY_25.index(n)] for n in LIMBS}
    return Captured(clip, rate, BODY_25, places, truth, subject, p)


def human4d_run(options: BenchOptions, seconds: float, first: float = 0.0) -> Captured:
    """The run of HUMAN4D from second `first` on (no later than that leaves so many): key points and truth are its
    joints as Vicon has them, on nobody's body."""
    run = read_human4d(options.folder("human4d_run"))
    joints, there = _human4d_world(options.folder("human4d_run"))
    x = transform(there, run.joints)
    left_first = np.allclose(joints[:, jt.LEFT_SHOULDER], x[:, 10])  # the file does not say the side
    places: dict[str, Array] = {}
    for side, arm, leg in zip(("left", "right"), (9, 15) if left_first else (15, 9), _legs(joints, x), strict=True):
        parts = {"shoulder": arm + 1, "elbow": arm + 2, "wrist": arm + 3, "hip": leg, "knee": leg + 1, "ankle": leg + 2}
        places |= {f"{side}_{part}": x[:, index] for part, index in parts.items()}
    truth = dict(places)
    for name, part in (("neck", "shoulder"), ("mid_hip", "hip")):
        places[name] = (places[f"left_{part}"] + places[f"right_{part}"]) / 2
    n = min(len(x), round(seconds * FRAME_RATE))
    begin = max(0, min(round(first * FRAME_RATE), len(x) - n))
    part = slice(begin, begin + n)
    where = np.stack(list(places.values()), 1)[part]
    return Captured("human4d", FRAME_RATE, tuple(places), where, {k: v[part] for k, v in truth.items()})


def _legs(joints: Array, x: Array) -> tuple[int, int]:
    """First point of the left and of the right leg among HUMAN4D's."""
    return (21, 27) if np.allclose(joints[:, jt.LEFT_HIP], x[:, 21]) else (27, 21)


def _human4d_world(folder: Path) -> tuple[Array, Array]:
    """(T, 15, 3) joints in a world with z up whose floor is about 0, and world_from_first (4, 4)."""
    joints, _ = human4d_joints(folder)
    up = np.median(joints[:, jt.NECK] - (joints[:, jt.LEFT_HIP] + joints[:, jt.RIGHT_HIP]) / 2, axis=0)
    up /= np.linalg.norm(up)
    side = np.median(joints[:, jt.LEFT_SHOULDER] - joints[:, jt.RIGHT_SHOULDER], axis=0)
    side -= side @ up * up
    side /= np.linalg.norm(side)
    r = np.stack([side, np.cross(up, side), up])
    there = se3(r, np.array([0, 0, 1.18]) - r @ np.median(joints[:, jt.TORSO], axis=0))
    return transform(there, joints), there


def balancing_rig(options: BenchOptions) -> CameraRig:
    """The refined cameras of the balancing clip, about where its person stands."""
    folder = options.folder("pose2sim_balancing")
    middle = np.nanmean(np.load(folder / "kp3d_refined_m.npy"), (0, 1)) * (1, 1, 0)
    return _about(balancing_recording(folder).rig, middle)


def uu4cam_rig(options: BenchOptions) -> CameraRig:
    """The cameras of uu4cam with their wide lenses, about where their axes meet."""
    rig = uu4cam_recording(options.folder("uu4cam")).rig
    ways = [se3_inverse(c.camera_from_world)[:3, 2] for c in rig]
    across = [np.eye(3) - np.outer(v, v) for v in ways]
    sums = np.sum([a @ p for a, p in zip(across, rig.positions, strict=True)], 0)
    middle: Array = np.linalg.solve(np.sum(across, 0), sums).astype(np.float64)
    return _about(rig, middle * (1, 1, 0))


def human4d_rig(options: BenchOptions) -> CameraRig:
    """The four depth cameras of HUMAN4D, mounted sideways, about where its person runs."""
    folder = options.folder("human4d_run")
    run: Human4d = read_human4d(folder)
    _, there = _human4d_world(folder)
    cameras = [
        Camera(f"depth{n}", k, np.zeros(5), pose @ se3_inverse(there), _DEPTH_SIZE)
        for n, (k, pose) in enumerate(zip(run.intrinsics, run.camera_from_first, strict=True), 1)
    ]
    return CameraRig(tuple(cameras))


def _about(rig: CameraRig, middle: Array) -> CameraRig:
    there = se3(np.eye(3), middle)
    return CameraRig(tuple(replace(c, camera_from_world=c.camera_from_world @ there) for c in rig))


RIGS: dict[str, Callable[[BenchOptions], CameraRig]] = {
    "balancing": balancing_rig,
    "uu4cam": uu4cam_rig,
    "human4d": human4d_rig,
}


def without_one(rig: CameraRig, view: int) -> CameraRig:
    """All cameras but one."""
    return CameraRig(tuple(c for k, c in enumerate(rig) if k != view % len(rig)))


def detected(captured: Captured, rig: CameraRig, seed: Sequence[int]) -> Array:
    """(T, C, K, 3): u, v px of the cameras' own pictures and confidence, erring like a detector's."""
    views = []
    for camera in rig:
        uv = camera.project(captured.places)
        inside = np.asarray(np.isfinite(uv).all(-1) & (uv >= 0).all(-1) & (uv < camera.size).all(-1))
        views.append(np.where(inside[..., None], np.concatenate([uv, np.ones((*uv.shape[:2], 1))], -1), 0.0))
    return like_a_detector(
        np.nan_to_num(np.stack(views, 1)), captured.names, np.random.default_rng(list(seed)), captured.frame_rate
    )


def as_frames(captured: Captured, rig: CameraRig, points: Array) -> list[Frame]:
    """Frames with key points (T, C, K, 3) alone, as they are given."""
    pinhole = rig.pinhole()
    return [
        Frame(k / captured.frame_rate, k, None, to_keypoints(list(p), captured.names, rig, pinhole))
        for k, p in enumerate(points)
    ]


def as_read(captured: Captured, frames: Sequence[Frame]) -> list[Frame]:
    """Frames with the key points that tracking gets when a recording is read: of one person by the views' rays, left
    and right that one view exchanges mended."""
    given = [f.keypoints for f in frames if f.keypoints is not None]
    candidates = [[view[None] for view in k.points] for k in given]
    one = one_person(candidates, captured.names, given[0].rig, captured.frame_rate)
    return [
        replace(f, keypoints=Keypoints(p[..., :3].copy(), captured.names, given[0].rig))
        for f, p in zip(frames, one.points, strict=True)
    ]


def triangulated(frames: Sequence[Frame]) -> Array:
    """(T, K, 3) m: each point of each frame by itself, linear, weighted by scores; NaN with fewer than two views."""
    assert frames[0].keypoints is not None
    points = np.stack([f.keypoints.points for f in frames if f.keypoints is not None], 1)  # (C, T, K, 3)
    weights = np.where(points[..., 2] >= _LEAST_CONFIDENCE, points[..., 2], 0.0)
    found, views = triangulate(frames[0].keypoints.rig, points[..., :2], weights)
    return np.where((views >= 2)[..., None], found, np.nan)
