"""2D key points of a synthetic scene, as a detector would give them."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from hypose.body.ready_bodies import JOINT_NAMES
from hypose.cameras.camera import CameraRig
from hypose.evidence.keypoints import BODY_25
from hypose.geometry import Array
from hypose.synthetic.performance import Performance
from hypose.synthetic.subjects import SyntheticSubject


class Filmed(Protocol):
    """What is filmed of a scene (`hypose.synthetic.scenes.Scene`)."""

    @property
    def subject(self) -> SyntheticSubject:
        """Who moves."""
        ...

    @property
    def performance(self) -> Performance:
        """How."""
        ...

    @property
    def rig(self) -> CameraRig:
        """What films it."""
        ...

    @property
    def seed(self) -> int:
        """Of the noise."""
        ...

    def __len__(self) -> int:
        """Number of frames."""
        ...

    def shown(self, view: int, index: int, /) -> int:
        """The frame that a view shows at frame index."""
        ...

    def dead(self, view: int, index: int, /) -> bool:
        """Does the view show nothing then?"""
        ...


def surface_landmarks(subject: SyntheticSubject) -> dict[str, tuple[int, Array]]:
    """Nose, eyes, ears, toes and heels of a subject: name -> (joint, point (3,) m in the model frame at
    rest)."""
    v, j, part = subject.vertices, subject.joints, subject.main_joint
    out: dict[str, tuple[int, Array]] = {}
    head = v[part == 4] if (part == 4).any() else j[4:5] + [[0, -0.1, 0.08], [0, 0.1, 0.08], [0, 0, 0.2]]
    low, high = head.min(0), head.max(0)
    size = high - low
    face = j[4] * [1, 0, 0] + [0, low[1], low[2] + 0.48 * size[2]]
    out["nose"] = (4, face)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        out[f"{side}_eye"] = (4, face + [sign * 0.2 * size[0], 0.09 * size[1], 0.12 * size[2]])
        out[f"{side}_ear"] = (4, face + [sign * 0.47 * size[0], 0.5 * size[1], 0.05 * size[2]])
        k = 15 if side == "left" else 18
        foot = v[part == k] if (part == k).any() else j[k] + np.array([[0, -0.18, -0.08], [0, 0.06, -0.08]])
        ground = foot[:, 2].min() + 0.02
        front, back, middle = foot[:, 1].min(), foot[:, 1].max(), float(foot[:, 0].mean())
        out[f"{side}_big_toe"] = (k, np.array([middle - sign * 0.02, front + 0.02, ground]))
        out[f"{side}_small_toe"] = (k, np.array([middle + sign * 0.03, front + 0.05, ground]))
        out[f"{side}_heel"] = (k, np.array([middle, back - 0.01, ground]))
    return out


def keypoint_places(subject: SyntheticSubject, rotations: Array, joints: Array) -> Array:
    """(T, 25, 3) m: where the points of BODY_25 are on a subject; rotations (T, 19, 3, 3) world_from_joint, joints
    (T, 19, 3)."""
    marks = surface_landmarks(subject)
    world = np.zeros((len(joints), len(BODY_25), 3))
    for k, name in enumerate(BODY_25):
        if name in ("neck", "mid_hip"):
            a, b = (6, 10) if name == "neck" else (13, 16)
            world[:, k] = (joints[:, a] + joints[:, b]) / 2
        elif name in marks:
            j, point = marks[name]
            world[:, k] = joints[:, j] + rotations[:, j] @ (point - subject.joints[j])
        else:
            world[:, k] = joints[:, JOINT_NAMES.index(name)]
    return world


def keypoint_detections(scene: Filmed, view: int, noise_px: float = 4.0) -> Array:
    """(T, 25, 3) = (u px, v px, confidence): BODY_25 detections of the subject in the camera's own
    (distorted) images.

    Where joints and surface landmarks really are, plus noise of noise_px at a person 250 px tall, in
    proportion to the size: half of it white, half slow (detectors err alike in neighbouring frames). 2 % of
    the points are off by ten times that, with low confidence, 2 % are missing. Detectors' systematic offsets
    and left-right swaps are not imitated.
    """
    p, camera = scene.performance, scene.rig[view]
    t = np.array([scene.shown(view, k) for k in range(len(scene))])
    world = keypoint_places(scene.subject, p.rotations[t], p.joints[t])
    uv = camera.project(world)
    rng = np.random.default_rng([scene.seed, 100, view])
    height = np.nanmax(uv[..., 1], axis=1) - np.nanmin(uv[..., 1], axis=1)
    sd = noise_px * height[:, None] / 250.0
    knots = rng.normal(size=(len(t) // 8 + 3, len(BODY_25), 2))
    at = np.arange(len(t)) / 8
    low = at.astype(int)
    s = (at - low)[:, None, None]
    slow = ((1 - s) * knots[low] + s * knots[low + 1]) / np.sqrt((1 - s) ** 2 + s**2)
    white = rng.normal(size=uv.shape)
    wild = rng.random(uv.shape[:2]) < 0.02
    error = (slow + white) / np.sqrt(2) * np.where(wild, 10.0, 1.0)[..., None]
    points = uv + sd[..., None] * error
    confidence = np.clip(rng.normal(0.8, 0.08, uv.shape[:2]) - 0.45 * wild, 0.05, 1.0)
    w, h = camera.size
    inside = np.isfinite(points).all(-1) & (points >= 0).all(-1) & (points < [w, h]).all(-1)
    dead = np.array([scene.dead(view, k) for k in range(len(scene))])
    seen = inside & (rng.random(uv.shape[:2]) > 0.02) & ~dead[:, None]
    return np.where(seen[..., None], np.concatenate([points, confidence[..., None]], -1), 0.0)
