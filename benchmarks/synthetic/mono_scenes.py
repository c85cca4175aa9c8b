"""Scenes for one camera with known truth: `arm_scene` (7 dof, 8 s) and `body_scene` (30 dof, oblique).

What makes them hard is what made the published sequences hard (Sminchisescu & Triggs 2001, section 6): a cluttered
textured background with a strong vertical edge, specular light, loose clothing whose folds wander, and limbs that
cross the trunk, the edge and each other. The subject comes from another shape space than the tracker's body, which
knows its lengths and girths only up to the errors of measuring (mono_subjects). The same seed gives the same scene.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.synthetic.mono_motions import arm_reach, body_motion
from benchmarks.synthetic.mono_subjects import MeasuringError, arm_dofs, measured_body, pose_of_truth, with_hand
from hypose.body.body import Body
from hypose.body.default_body import JOINT_NAMES, human
from hypose.cameras.camera import Camera, CameraRig
from hypose.evidence.keypoints import BODY_25
from hypose.geometry import Array, Image
from hypose.synthetic.metrics import CARRIERS, population_offsets
from hypose.synthetic.performance import Performance, heading
from hypose.synthetic.render_rgb import (
    Backdrop,
    Outfit,
    develop,
    make_outfit,
    noise_bank,
    render_person,
)
from hypose.synthetic.scenes import Scene, keypoint_detections, look_at, make_scene
from hypose.synthetic.subjects import SyntheticSubject, dress, load_subjects
from hypose.tracking.monocular.settings import body_dofs

SIZE = (384, 288)
FRAME_RATE = 25.0
CLOTHING_M = 0.03
FOLDS_PERIOD_S = 1.7
NOISE_SD = 5.0
START_ERROR_RAD = 0.02
"""Error of the first pose of a limb, 1 sd; less where a dof usually moves less."""

# first numbers of the random streams: (seed, stream)
_CLOTHES, _OTHER_FOLDS, _COLORS, _CLUTTER, _NOISE, _MEASURE, _CAMERA, _MOTION, _START = range(9)


@dataclass(frozen=True)
class Mark:
    """A point whose error is measured: fixed to a joint at an offset (3,) m in that joint's frame. Joints of two bodies
    are defined at slightly different places: `definition` (3,) m is added to the estimate in the frame of the joint
    `carrier`, the same for every subject and frame (metrics.population_offsets)."""

    name: str
    joint: int
    offset: Array
    carrier: int
    definition: Array


@dataclass(frozen=True)
class MonoScene:
    """subject: dressed; other_folds: the same one with its clothes in other folds, between which it wanders.
    performance: what it does. camera: a pinhole. body, active, start (D,): what the tracker is given: a measured body,
    the dof to estimate, and the pose of frame 0 up to START_ERROR_RAD. marks: where errors are measured; root_aligned:
    after the pelves were made to coincide."""

    name: str
    seed: int
    subject: SyntheticSubject
    other_folds: SyntheticSubject
    performance: Performance
    camera: Camera
    backdrop: Backdrop
    outfit: Outfit
    body: Body
    active: NDArray[np.int64]
    start: Array
    marks: tuple[Mark, ...]
    root_aligned: bool
    noise: NDArray[np.int16] = field(repr=False)

    def dressed(self, index: int) -> SyntheticSubject:
        """The subject with its clothes as they hang in frame `index`."""
        share = 0.5 + 0.5 * np.sin(2 * np.pi * self.performance.times[index] / FOLDS_PERIOD_S + self.seed)
        vertices = (1 - share) * self.subject.vertices + share * self.other_folds.vertices
        return replace(self.subject, vertices=vertices)

    def image(self, index: int) -> Image:
        """Picture `index`, (h, w, 3) uint8 BGR."""
        subject, p = self.dressed(index), self.performance
        picture = self.backdrop.image.copy()
        vertices = subject.skin(p.rotations[index], p.root[index])
        render_person(picture, self.backdrop, self.camera, subject, self.outfit, vertices, samples=2)
        rng = np.random.default_rng([self.seed, _NOISE, 1 + index])
        return develop(picture, np.ones(3), self.noise, rng)

    @cached_property
    def plain(self) -> Scene:
        """The same performance as a scene of one camera: exact masks (`clean_mask`) and key points come from it."""
        rig = CameraRig((self.camera,))
        return make_scene(self.performance, self.subject, rig, seed=self.seed, clothing_m=0.0)

    @cached_property
    def keypoints(self) -> Array:
        """(T, 25, 3) = (u px, v px, confidence): BODY_25 detections with a detector's noise."""
        return keypoint_detections(self.plain, 0)

    @property
    def keypoint_names(self) -> tuple[str, ...]:
        """The names of `keypoints`."""
        return BODY_25

    def true_marks(self) -> Array:
        """(T, M, 3) m: the marks on the truth."""
        p = self.performance
        joint = [m.joint for m in self.marks]
        offset = np.stack([m.offset for m in self.marks])
        return p.joints[:, joint] + np.einsum("tmab,mb->tma", p.rotations[:, joint], offset)

    def estimated_marks(self, poses: Array) -> Array:
        """(..., M, 3) m: the marks on the tracker's body at poses (..., D), where the truth defines them."""
        rotations, centres = self.body.skeleton.forward(poses)
        joint, carrier = [m.joint for m in self.marks], [m.carrier for m in self.marks]
        offset, definition = (np.stack([getattr(m, f) for m in self.marks]) for f in ("offset", "definition"))
        on_joint = np.einsum("...mab,mb->...ma", rotations[..., joint, :, :], offset)
        moved = np.einsum("...mab,mb->...ma", rotations[..., carrier, :, :], definition)
        return centres[..., joint, :] + on_joint + moved


def arm_scene(seed: int, seconds: float = 8.0) -> MonoScene:
    """Somebody near the camera moves the right arm across trunk, face and pillar and back the same way; the tracker
    knows where the trunk is. Errors are those of elbow, wrist and knuckles, in the world."""
    subject, folds = _dressed(seed)
    rng = np.random.default_rng([seed, _MOTION])
    performance = arm_reach(subject, seconds, FRAME_RATE, rng)
    pelvis = performance.root[0]
    place = np.random.default_rng([seed, _CAMERA]).normal(0, 0.03, 3) + [-0.45, -1.75, 0.55]
    camera = look_at("cam1", pelvis + place, pelvis + [-0.28, 0.0, 0.34], 1.25 * SIZE[0], SIZE)
    body = with_hand(_measured(subject, seed))
    active = arm_dofs(body.skeleton)
    marks = tuple(_mark(body, subject, name) for name in ("right_elbow", "right_wrist"))
    knuckle = body.landmarks.index("right_knuckle")
    wrist = JOINT_NAMES.index("right_wrist")
    hand = Mark("right_knuckle", wrist, body.landmarks.offset[knuckle], marks[1].carrier, marks[1].definition)
    return _scene("arm", seed, subject, folds, performance, camera, body, active, (*marks, hand), (0.30, 0.43), False)


def body_scene(seed: int, seconds: float = 1.2, *, mocap: Path | None = None, motion: str = "") -> MonoScene:
    """A whole person, about 210 px tall, seen obliquely (limbs hide each other); captured motion where the folder
    `mocap` is given, else built-in ones. motion: one of mono_motions.body_motion ('': chosen by the seed). Errors are
    those of 14 joints after the pelves were made to coincide."""
    subject, folds = _dressed(seed)
    performance = body_motion(motion, subject, seconds, FRAME_RATE, seed, mocap)
    rng = np.random.default_rng([seed, _CAMERA])
    side = 1.0 if seed % 2 == 0 else -1.0
    azimuth = heading(performance.rotations[0, 0]) + side * np.radians(rng.uniform(40.0, 65.0))
    middle = 0.5 * (performance.root.min(0) + performance.root.max(0))
    place = [3.6 * np.sin(azimuth), -3.6 * np.cos(azimuth), 0.5]
    camera = look_at("cam1", middle + place, middle + [0, 0, -0.08], 1.55 * SIZE[1], SIZE)
    body = _measured(subject, seed)
    names = [n for n in JOINT_NAMES if n.split("_")[-1] not in ("pelvis", "spine", "chest", "clavicle")]
    marks = tuple(_mark(body, subject, name) for name in names)
    active = body_dofs(body.skeleton)
    name = f"body-{performance.name}"
    return _scene(name, seed, subject, folds, performance, camera, body, active, marks, (0.50, 0.57), True)


def _dressed(seed: int) -> tuple[SyntheticSubject, SyntheticSubject]:
    known = load_subjects()
    naked = known[sorted(known)[seed % len(known)]]
    first, second = (dress(naked, CLOTHING_M, np.random.default_rng([seed, k])) for k in (_CLOTHES, _OTHER_FOLDS))
    return first, second


def _measured(subject: SyntheticSubject, seed: int) -> Body:
    return measured_body(human(), subject, MeasuringError(), np.random.default_rng([seed, _MEASURE]))


def _mark(body: Body, subject: SyntheticSubject, name: str) -> Mark:
    joint = JOINT_NAMES.index(name)
    definition = population_offsets(human())[joint] * subject.stature
    return Mark(name, joint, np.zeros(3), int(CARRIERS[joint]), definition)


def _scene(
    name: str,
    seed: int,
    subject: SyntheticSubject,
    folds: SyntheticSubject,
    performance: Performance,
    camera: Camera,
    body: Body,
    active: NDArray[np.int64],
    marks: tuple[Mark, ...],
    pillar: tuple[float, float],
    root_aligned: bool,
) -> MonoScene:
    rng = np.random.default_rng([seed, _COLORS])
    plain = make_outfit(subject, rng)
    color = plain.color * woven(subject.vertices, rng)[:, None]
    outfit = replace(plain, color=color.astype(np.float32))
    start = pose_of_truth(body, performance.rotations[0], performance.joints[0])
    error = np.random.default_rng([seed, _START]).normal(0, START_ERROR_RAD, len(active))
    start[active] += error * np.minimum(1.0, body.skeleton.sigma[active] / np.radians(5.0))
    return MonoScene(
        f"{name}-{seed}",
        seed,
        subject,
        folds,
        performance,
        camera,
        cluttered(SIZE, pillar, np.random.default_rng([seed, _CLUTTER])),
        outfit,
        body,
        active,
        body.skeleton.clamp(start),
        marks,
        root_aligned,
        noise_bank(SIZE, NOISE_SD, np.random.default_rng([seed, _NOISE])),
    )


_SHAPES = 70
_PILLAR, _SHADE = 235.0, 40.0


def cluttered(size: tuple[int, int], pillar: tuple[float, float], rng: np.random.Generator) -> Backdrop:
    """A picture (width, height) = size full of edges that are nobody's: boxes and lines in all colours under a
    texture, and a white pillar with a dark side between the shares `pillar` of the width (the white pillar of
    Sminchisescu & Triggs 2001, section 6)."""
    s = 2  # drawn twice as large, so that edges are as soft as a lens makes them
    w, h = size[0] * s, size[1] * s
    image = np.full((h, w, 3), 110.0)
    for _ in range(_SHAPES):
        color = (rng.uniform(30, 220) + rng.normal(0, 15, 3)).tolist()
        x, y = rng.uniform(0, w), rng.uniform(0, h)
        a, b = rng.uniform(0.03, 0.2) * w, rng.uniform(0.03, 0.3) * h
        if rng.random() < 0.6:
            cv2.rectangle(image, (int(x), int(y)), (int(x + a), int(y + b)), color, -1)
        else:
            end = int(x + rng.normal(0, 2 * a)), int(y + rng.normal(0, b))
            cv2.line(image, (int(x), int(y)), end, color, int(rng.integers(2, 8)))
    for _ in range(3):
        cell = int(rng.integers(4, 20))
        image += cv2.resize(rng.normal(0, 9, (h // cell, w // cell)), (w, h), interpolation=cv2.INTER_CUBIC)[..., None]
    left, right = (round(p * w) for p in pillar)
    image[:, left:right] = _PILLAR + rng.normal(0, 2, (h, right - left, 1))
    image[:, right : right + round(0.012 * w)] = _SHADE
    small = cv2.resize(np.clip(image, 0, 255), size, interpolation=cv2.INTER_AREA)
    return Backdrop(
        np.asarray(small, dtype=np.float32),
        np.zeros((size[1], size[0]), dtype=np.bool_),
        np.full((size[1], size[0]), np.inf, dtype=np.float32),
    )


def woven(vertices: Array, rng: np.random.Generator, depth: float = 0.28) -> Array:
    """(V,) brightness factors of a solid texture that sticks to the surface of vertices (V, 3) m: optical flow has
    something to follow. Sums of plane waves of 3 to 15 cm."""
    total = np.zeros(len(vertices))
    bands = (18.0, 44.0, 90.0)
    for per_metre in bands:
        for _ in range(5):
            k = rng.normal(size=3)
            k *= per_metre * rng.uniform(0.7, 1.4) / np.linalg.norm(k)
            total += np.cos(vertices @ k + rng.uniform(0, 2 * np.pi)) / len(bands)
    return np.clip(1 + depth * total, 0.2, 1.8)
