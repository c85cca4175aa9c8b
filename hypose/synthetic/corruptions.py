"""Faults of real recordings, by name: in the images, the timing and the calibration. Simulated key points too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.body.default_body import JOINT_NAMES
from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.evidence.keypoints import BODY_25
from hypose.geometry import Array, se3, so3_exp
from hypose.synthetic.subjects import SyntheticSubject


@dataclass(frozen=True)
class Corruptions:
    """Faults of a synthetic recording; the defaults corrupt nothing.

    occluder: "", "table" or "treadmill", in front of the person in several views; it belongs to the room.
    dropped: share of frames that a camera does not deliver (its last image is repeated).
    dead_camera: index of a camera whose images are black from a third of the recording on, -1 for none.
    desync: delay of each camera in frames; the c-th camera is late by desync[c % len], so (0, 1, 0, 2) delays the
        second camera by one frame and the fourth by two.
    calibration_error: relative standard deviation of the error of the calibration; 0.01 changes focal lengths and
        positions by 1 %.
    """

    occluder: str = ""
    dropped: float = 0.0
    dead_camera: int = -1
    desync: tuple[int, ...] = (0,)
    calibration_error: float = 0.0


CORRUPTIONS: dict[str, dict[str, Any]] = {
    "table": {"occluder": "table"},
    "treadmill": {"occluder": "treadmill"},
    "dropped-frames": {"dropped": 0.08},
    "dead-camera": {"dead_camera": 1},
    "desync": {"desync": (0, 1, 0, 2)},
    "calibration-error": {"calibration_error": 0.01},
    "bad-calibration": {"calibration_error": 0.03},
}
"""Fields of `Corruptions` that each named corruption sets."""


def corruptions(*names: str) -> Corruptions:
    """Combine named corruptions (CORRUPTIONS); where two set the same fault, the later one counts.

    Raises: InputError with the list of names for an unknown name.
    """
    changed: dict[str, Any] = {}
    for name in names:
        if name not in CORRUPTIONS:
            raise InputError(f"There is no corruption {name!r}; the corruptions are {', '.join(CORRUPTIONS)}.")
        changed |= CORRUPTIONS[name]
    return Corruptions(**changed)


def smooth_noise(rng: np.random.Generator, shape: tuple[int, int], cell: float) -> NDArray[np.float32]:
    """Draw a picture of smooth random noise of standard deviation 0.8.

    rng: random numbers.
    shape: (h, w).
    cell: size of its waves, px.
    Returns: (h, w) float32.
    """
    h, w = shape
    s = max(1, round(cell))
    coarse = rng.normal(size=(h // s + 3, w // s + 3)).astype(np.float32)
    fine = cv2.resize(coarse, ((w // s + 3) * s, (h // s + 3) * s), interpolation=cv2.INTER_CUBIC)
    return np.asarray(fine[:h, :w], dtype=np.float32)


def box_mesh(low: tuple[float, float, float], high: tuple[float, float, float]) -> tuple[Array, NDArray[np.int32]]:
    """Make a mesh of an axis-aligned box with corners low and high, m.

    Returns: vertices (8, 3) m, and faces (12, 3), counter-clockwise seen from outside.
    """
    x, y, z = zip(low, high, strict=True)
    v = np.array([[a, b, c] for a in x for b in y for c in z], dtype=np.float64)
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    f = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return v, np.array(f, dtype=np.int32)


def joined_meshes(parts: Sequence[tuple[Array, NDArray[np.int32]]]) -> tuple[Array, NDArray[np.int32]]:
    """Join meshes, each of vertices (V, 3) and faces (F, 3), into one."""
    first = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
    faces = np.concatenate([f + n for n, (_, f) in zip(first, parts, strict=True)])
    return np.concatenate([v for v, _ in parts]), faces.astype(np.int32)


def occluder_mesh(name: str) -> tuple[Array, NDArray[np.int32]] | None:
    """Make the mesh of an occluder in the world.

    name: "" for none. "table": 1.6 x 0.7 m, 0.75 m high, 1.55 m from the centre of the volume, before the cameras near
        azimuth 218 degrees (all rigs but court-4 have one there). "treadmill": two hand rails with posts, 0.55 m left
        and right of the centre, 1.0 m high, and a console bar in front (for people who stay at the centre).
    Returns: vertices (V, 3) m and faces (F, 3); None for "".
    Raises: InputError for an unknown name.
    """
    if name == "":
        return None
    turn = np.eye(3)
    if name == "table":
        boxes = [((-0.8, -1.9, 0.71), (0.8, -1.2, 0.75))]
        boxes += [((x, y, 0.0), (x + 0.05, y + 0.05, 0.71)) for x in (-0.78, 0.73) for y in (-1.88, -1.27)]
        boxes.append(((-0.75, -1.86, 0.3), (0.75, -1.83, 0.71)))  # its front board hides most
        turn = so3_exp([0.0, 0.0, np.radians(218.0 - 270.0)])
    elif name == "treadmill":
        boxes = []
        for x in (-0.58, 0.53):
            boxes.append(((x, -0.75, 0.96), (x + 0.05, 0.35, 1.01)))
            boxes += [((x, y, 0.0), (x + 0.05, y + 0.05, 0.96)) for y in (-0.75, 0.3)]
        boxes.append(((-0.58, -0.8, 1.0), (0.58, -0.75, 1.2)))
    else:
        raise InputError(f"There is no occluder {name!r}; the occluders are table and treadmill.")
    vertices, faces = joined_meshes([box_mesh(low, high) for low, high in boxes])
    return vertices @ turn.T, faces


def disturb_rig(rig: CameraRig, relative: float, rng: np.random.Generator) -> CameraRig:
    """Disturb the calibration of a rig as a careless calibration would.

    relative: sd; for 0.01 focal lengths change by 1 %, camera positions by 1 % of the distance to the centre of the
        volume per axis, and the image of that centre by 1 % of half the image width.
    Returns: the disturbed rig; image size and lens distortion stay.
    """
    if relative <= 0:
        return rig
    out = []
    target = np.array([0.0, 0.0, 0.95])
    for c in rig.cameras:
        k = c.K.copy()
        k[0, 0] *= 1 + rng.normal(0, relative)
        k[1, 1] = k[0, 0] * c.K[1, 1] / c.K[0, 0]
        r, p = c.camera_from_world[:3, :3], c.position
        new = p + rng.normal(0, relative * np.linalg.norm(target - p), 3)
        # turn it so that the centre stays in sight, up to the aiming error
        a, b = r @ (target - p), r @ (target - new)
        axis = np.cross(b, a)
        sine = np.linalg.norm(axis) / (np.linalg.norm(a) * np.linalg.norm(b))
        aim = so3_exp(axis / max(float(np.linalg.norm(axis)), 1e-12) * np.arcsin(min(float(sine), 1.0)))
        wobble = np.append(rng.normal(0, relative * 0.5 * c.size[0] / c.K[0, 0], 2), 0.0)
        r = so3_exp(wobble) @ aim @ r
        out.append(replace(c, K=k, camera_from_world=se3(r, -r @ new)))
    return CameraRig(tuple(out))


def dropped_frames(n_frames: int, share: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Draw the frames that a camera does not deliver: single frames and short runs, never the first frame.

    n_frames: number T of frames.
    share: share of the frames that is missing.
    Returns: (T,) True where there is no image.
    """
    out = np.zeros(n_frames, dtype=bool)
    t = 1
    while share > 0 and t < n_frames:
        if rng.random() < share / 1.5:
            length = 1 if rng.random() < 0.67 else 2
            out[t : t + length] = True
            t += length
        t += 1
    return out


# ---- simulated key points --------------------------------------------------------------------------------------------
# 2D key points of a synthetic scene, as a detector would give them.


def surface_landmarks(subject: SyntheticSubject) -> dict[str, tuple[int, Array]]:
    """Compute the positions of nose, eyes, ears, toes and heels on a subject.

    Returns: by name, the joint that carries it and the point (3,) m in the model frame at rest.
    """
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
    """Compute the positions (T, 25, 3) m of the points of BODY_25 on a subject.

    rotations: (T, 19, 3, 3) world_from_joint.
    joints: (T, 19, 3) m.
    """
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
