"""Depth maps of a posed body before a wall, without any fault, for tests."""

import numpy as np

from hypose.body.body import Body
from hypose.cameras.camera import Camera, CameraRig
from hypose.compute.zbuffer import rasterize
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Frame
from hypose.evidence.silhouettes import make_silhouettes
from hypose.synthetic.scenes import look_at

WALL_M = 5.0


def sensors(count: int = 2) -> CameraRig:
    """Small depth cameras around the origin."""
    angles = np.arange(count) * np.pi / 2
    eyes = [(2.7 * np.sin(a), -2.7 * np.cos(a), 1.2) for a in angles]
    return CameraRig(tuple(look_at(f"d{k}", eye, (0, 0, 0.95), 190.0, (240, 216)) for k, eye in enumerate(eyes)))


def drawn(body: Body, pose, rig: CameraRig):
    """(C, h, w) m of the scoring mesh and the wall behind it, and the person's pixels."""
    vertices = body.skin(pose)
    maps, persons = [], []
    for camera in rig:
        z = vertices @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
        own = rasterize(camera.project_pinhole(vertices), z, body.coarse.faces, camera.size)[0]
        maps.append(np.minimum(own, WALL_M))
        persons.append((own < WALL_M).astype(np.uint8))
    return np.stack(maps).astype(np.float32), np.stack(persons)


def frame_of(body: Body, pose, rig: CameraRig, index: int = 0, **more) -> Frame:
    """A frame with silhouettes and depth, and more pieces."""
    maps, persons = drawn(body, pose, rig)
    silhouettes = make_silhouettes(list(persons), rig)
    return Frame(index / 25, index, silhouettes, depth=Depth(maps, persons, rig, np.ones(len(rig), bool)), **more)


def seen_in_room(camera: Camera, person: bool = True, wall: float = 4.0, x: float = 0.0) -> np.ndarray:
    """(h, w) m of what a camera with its own lens sees: the floor z = 0, a wall at y, and a board of a person's size
    at x, a metre before the wall."""
    v, u = np.indices((camera.size[1], camera.size[0]))
    eye, rays = camera.rays(np.stack([u, v], -1))
    with np.errstate(divide="ignore"):
        down = np.where(rays[..., 2] < 0, -eye[2] / rays[..., 2], np.inf)
        there = np.where(rays[..., 1] > 0, (wall - eye[1]) / rays[..., 1], np.inf)
        before = np.where(rays[..., 1] > 0, (wall - 1 - eye[1]) / rays[..., 1], np.inf)
    at = eye + np.where(np.isfinite(before), before, 0.0)[..., None] * rays
    board = person & np.isfinite(before) & (np.abs(at[..., 0] - x) < 0.25) & (at[..., 2] > 0) & (at[..., 2] < 1.7)
    along = np.minimum(np.where(board, before, np.inf), np.minimum(down, there))
    z = along * (rays @ camera.camera_from_world[2, :3])
    return np.where(np.isfinite(z), z, 0).astype(np.float32)
