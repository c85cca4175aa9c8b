"""What a background model takes for the person and nobody's body explains: a chair, a skirt, a coat, a backpack, a bag.

They are drawn into the masks of scenes as convex pieces that stand still or go with a part of the body.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.body.default_body import JOINT_NAMES
from hypose.cameras.camera import CameraRig
from hypose.evidence.frame import Frame
from hypose.geometry import Array, so3_exp
from hypose.synthetic.scenes import Scene

_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_ROUND = np.stack([np.cos(a := np.linspace(0, 2 * np.pi, 12, endpoint=False)), np.sin(a), 0 * a], 1)
_FORWARD = np.array([0.0, -1.0, 0.0])
"""of a person in the rest pose"""


def chair(joints: Array, rotations: Array) -> list[Array]:
    """Seat, back and four legs under who sits with joints (J, 3) m, rotations (J, 3, 3): corners (8, 3) of boxes."""
    facing = rotations[0] @ _FORWARD
    turn = so3_exp([0.0, 0.0, float(np.arctan2(facing[0], -facing[1]))])
    seat = float(joints[0, 2]) - 0.12
    at = np.array([joints[0, 0], joints[0, 1], 0.0]) + turn @ np.array([0.0, -0.1, 0.0])
    boxes = [((0.0, 0.0, seat - 0.02), (0.42, 0.42, 0.04)), ((0.0, 0.2, seat + 0.2), (0.40, 0.03, 0.36))]
    boxes += [((x, y, seat / 2), (0.04, 0.04, seat)) for x in (-0.19, 0.19) for y in (-0.19, 0.19)]
    return [(np.array(c) + _CORNERS * size) @ turn.T + at for c, size in boxes]


def skirt(joints: Array, rotations: Array) -> list[Array]:
    """From the waist to below the knees, as wide as the step."""
    waist = joints[0] + (_ROUND * (0.17, 0.13, 0.0) + (0.0, 0.0, 0.06)) @ rotations[0].T
    knees = joints[[JOINT_NAMES.index(f"{s}_knee") for s in ("left", "right")]]
    apart = float(np.linalg.norm(knees[0] - knees[1]))
    hem = knees.mean(0) + _ROUND * (0.17 + apart / 2) - (0.0, 0.0, 0.08)
    return [np.concatenate([waist, hem])]


def coat(joints: Array, rotations: Array) -> list[Array]:
    """Open, from the shoulders to the middle of the thighs, and wide sleeves."""
    chest, hips = JOINT_NAMES.index("chest"), joints[0]
    rings = [
        joints[chest] + (_ROUND * (0.21, 0.15, 0.0) + (0.0, 0.0, 0.16)) @ rotations[chest].T,
        hips + (_ROUND * (0.22, 0.18, 0.0)) @ rotations[0].T,
        hips + (_ROUND * (0.26, 0.21, 0.0) - (0.0, 0.0, 0.24)) @ rotations[0].T,
    ]
    pieces = [np.concatenate(pair) for pair in zip(rings, rings[1:], strict=False)]
    for side in ("left", "right"):
        ends = joints[[JOINT_NAMES.index(f"{side}_{n}") for n in ("shoulder", "elbow", "wrist")]]
        pieces += [
            np.concatenate([a + _CORNERS * 0.15, b + _CORNERS * 0.15]) for a, b in zip(ends, ends[1:], strict=False)
        ]
    return pieces


def backpack(joints: Array, rotations: Array) -> list[Array]:
    """A box on the back."""
    chest = JOINT_NAMES.index("chest")
    return [joints[chest] + (_CORNERS * (0.3, 0.17, 0.44) + (0.0, 0.2, 0.05)) @ rotations[chest].T]


def bag(joints: Array, rotations: Array) -> list[Array]:
    """Hanging from the right hand."""
    hand = joints[JOINT_NAMES.index("right_wrist")] - (0.0, 0.0, 0.12)
    return [np.stack([hand, hand + (0.02, 0.0, 0.0)]), hand - (0.0, 0.0, 0.25) + _CORNERS * (0.13, 0.34, 0.32)]


THINGS: Mapping[str, Callable[[Array, Array], list[Array]]] = {
    f.__name__: f for f in (chair, skirt, coat, backpack, bag)
}
"""Points (N, 3) m of the convex pieces of each thing, of who has joints (J, 3) m and rotations (J, 3, 3)."""
STANDING = ("chair",)
"""stay where they are in the first frame"""


def with_thing(frames: list[Frame], scene: Scene, thing: str) -> list[Frame]:
    """Frames of a scene whose masks show the thing as well."""
    out = []
    for f in frames:
        assert f.silhouettes is not None
        s, t = f.silhouettes, 0 if thing in STANDING else f.index
        drawn = _drawn(s.rig, THINGS[thing](scene.joints[t], scene.rotations[t]), s.masks.shape)
        out.append(replace(f, silhouettes=replace(s, masks=s.masks | drawn)))
    return out


def _drawn(cameras: CameraRig, pieces: list[Array], shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """(C, h, w) masks of convex pieces."""
    out = np.zeros(shape, np.uint8)
    for c, camera in enumerate(cameras):
        w, h = camera.size
        for piece in pieces:
            corners = np.round(camera.project_pinhole(piece)).astype(np.int32)
            cv2.fillConvexPoly(out[c, :h, :w], cv2.convexHull(corners), 1)
    return out
