"""Small changes of cameras as unknowns of a least-squares problem, and the gauge: which world a refined rig lives in.

A camera's change is (w, v[, log focal factor]): p' = exp(w) p + v of points p in the camera's frame, focal length
f exp(log factor). Images and points fix a rig only up to a similarity of the whole world; refined rigs are
laid onto the old one so that few cameras move far rather than all a little (iteratively reweighted, an L1 fit).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import Camera, CameraRig
from hypose.geometry import Array, procrustes, se3, se3_inverse, so3_exp, so3_log, transform


@dataclass(frozen=True)
class CameraChange:
    """How far one camera is from where the old calibration had it. turn_deg: angle; move_m: distance of the centres;
    focal: factor on the focal length; image_px: median movement of the person's points in its image, px of the
    calibrated size."""

    name: str
    turn_deg: float
    move_m: float
    focal: float
    image_px: float


def changed(camera: Camera, x: Array) -> Camera:
    """The camera changed by x (6,) or more; a radial term is not part of a Camera and is left to the caller."""
    motion = se3(so3_exp(x[:3]), x[3:6])
    k = camera.K
    if len(x) > 6 and x[6] != 0:
        k = k.copy()
        k[:2, :2] *= np.exp(x[6])
    return replace(camera, K=k, camera_from_world=motion @ camera.camera_from_world)


def by_camera(points_camera: Array, gradient_camera: Array, unknowns: int = 6) -> Array:
    """(R, unknowns) derivative of rows with respect to a camera's change at zero.

    points_camera (R, 3) m, gradient_camera (R, 3): derivative of each row with respect to its point, both in the
    camera's frame; unknowns 6, or 7 with the focal length."""
    parts = [np.cross(points_camera, gradient_camera), gradient_camera]
    if unknowns > 6:  # u - c = f x / z: scaling f scales x and y
        parts.append((points_camera[:, :2] * gradient_camera[:, :2]).sum(1)[:, None])
    return np.concatenate(parts, 1)


def change_from(old: Camera, new: Camera) -> Array:
    """(7,) the change that takes the old camera to the new one; the inverse of `changed`."""
    motion = new.camera_from_world @ se3_inverse(old.camera_from_world)
    return np.r_[so3_log(motion[:3, :3]), motion[:3, 3], np.log(new.K[0, 0] / old.K[0, 0])]


def in_world(rig: CameraRig, new_from_old: Array) -> CameraRig:
    """The same cameras after the whole world moved rigidly: points x -> new_from_old x."""
    back = se3_inverse(new_from_old)
    return CameraRig(tuple(replace(c, camera_from_world=c.camera_from_world @ back) for c in rig))


def gauge(new: CameraRig, old: CameraRig, points_new: Array, rounds: int = 30) -> Array:
    """Rigid old_from_new (4, 4) that lays a refined rig and its world onto the old one.

    Cameras are compared by where their centres lie and where their axes meet the person (points_new (N, 3) m, in the
    refined world): four points each. A camera that really moved is let go (weights 1 / distance)."""
    middle = np.nanmedian(points_new, axis=0)
    reach = float(np.median(np.linalg.norm(new.positions - middle, axis=1)))
    marks_new = np.stack([_marks(c, reach) for c in new])
    marks_old = np.stack([_marks(c, reach) for c in old])
    weight = np.ones(len(new))
    motion = np.eye(4)
    for _ in range(rounds):
        w = np.repeat(weight, marks_new.shape[1])
        motion, _ = procrustes(marks_new.reshape(-1, 3), marks_old.reshape(-1, 3), w)
        gap = np.linalg.norm(transform(motion, marks_new.reshape(-1, 3)) - marks_old.reshape(-1, 3), axis=1)
        distance = np.sqrt((gap.reshape(len(new), -1) ** 2).mean(1))
        weight = 1 / np.maximum(distance, 1e-3 * reach)
    return motion


def _marks(camera: Camera, reach: float) -> Array:
    """(4, 3) points fixed to a camera: its centre, and three where it looks, at the person's distance."""
    local = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.3, 0.0, 1.0], [0.0, 0.3, 1.0]]) * reach
    return transform(se3_inverse(camera.camera_from_world), local)


def changes(old: CameraRig, new: CameraRig, points_world: Array) -> tuple[CameraChange, ...]:
    """What moved between two rigs of one world; points_world (N, 3) m are the person's."""
    out = []
    p = points_world[np.isfinite(points_world).all(1)]
    for a, b in zip(old, new, strict=True):
        turn = np.degrees(np.linalg.norm(so3_log(b.camera_from_world[:3, :3] @ a.camera_from_world[:3, :3].T)))
        shift = np.linalg.norm(a.project_pinhole(p) - b.project_pinhole(p), axis=1)
        out.append(
            CameraChange(
                a.name,
                float(turn),
                float(np.linalg.norm(a.position - b.position)),
                float(b.K[0, 0] / a.K[0, 0]),
                float(np.nanmedian(shift)) if len(p) else float("nan"),
            )
        )
    return tuple(out)


def rescaled(rig: CameraRig, factor: float) -> CameraRig:
    """The rig with all lengths multiplied by a factor."""
    out = []
    for c in rig:
        pose = c.camera_from_world.copy()
        pose[:3, 3] *= factor
        out.append(replace(c, camera_from_world=pose))
    return CameraRig(tuple(out))


def free_cameras(rig: CameraRig, fixed: tuple[str, ...]) -> NDArray[np.bool_]:
    """(C,) True for the cameras that may move; a CalibrationError lists the names there are."""
    if fixed:
        rig.select(fixed)
    return np.array([c.name not in fixed for c in rig])
