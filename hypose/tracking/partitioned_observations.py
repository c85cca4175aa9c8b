"""Partitioned observations (APO) and steps of a limb in its own directions, both for layered filters.

Partitioned observations weigh each layer only where its body parts are likely to be seen. A layer's box in space stands
around the joints it places (by the mean of the set so far), its picture in every view is a box too, and the silhouette
cost is counted inside; parts of later layers are not drawn.
Source: Alcoverro 2014, section 2.4.1, eq. 2.15.

Steps of a limb in its own directions draw the swing of a ball joint apart from the twist about the bone. A shoulder's
twist is not seen before the forearm is drawn, so a layered filter searches the swing with the upper arm and the twist
with the forearm. Balls are rotation vectors, in which neither is a coordinate; here both are turns in the bone's own
frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.skeleton import Skeleton
from hypose.cameras.camera import CameraRig
from hypose.compute.scorer import silhouette_xor
from hypose.evidence.frame import Silhouettes
from hypose.geometry import Array, nearest_branch, so3_exp, so3_log
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.kernels import HeavyTail, reflect
from hypose.tracking.costs import evidence_energy
from hypose.tracking.frame_evidence import PreparedFrame


@dataclass(frozen=True)
class BallStep:
    """start: first coordinate of a ball; axis (3,): unit direction of the bone that hangs on it, model frame at rest;
    swing: rad, sd of each turn across the bone; twist: rad, sd of the turn about it."""

    start: int
    axis: Array
    swing: float
    twist: float


def ball_step(skeleton: Skeleton, joint: str, child: str, swing: float, twist: float) -> BallStep:
    """The BallStep of a named joint whose bone ends at the joint `child`."""
    bone = skeleton.rest_offsets[skeleton.joint(child)]
    return BallStep(int(skeleton.dofs_of(joint)[0]), bone / np.linalg.norm(bone), swing, twist)


@dataclass(frozen=True)
class LimbDiffusion:
    """Kernel: Gaussian steps, sigma (D,) per coordinate, and for some balls (whose sigma must be 0) swing and twist.

    R -> R exp(w), w = swing (g - (g.a) a) + twist (t a) with normal g (3,), t. Bounds by `reflect` on what moved.
    tail: longer steps for a share of the set, on the coordinates it names.
    """

    skeleton: Skeleton
    sigma: Array
    balls: tuple[BallStep, ...] = ()
    tail: HeavyTail | None = None

    def __call__(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """The moved set."""
        s = self.skeleton
        gain = np.ones((h.count, s.dof)) if self.tail is None else self.tail.gain(h.count, s.dof)
        step = rng.standard_normal(h.values.shape) * self.sigma * gain
        moved = np.array(self.sigma > 0)
        values = h.values + step
        for ball in self.balls:
            columns = slice(ball.start, ball.start + 3)
            g, t = rng.standard_normal((h.count, 3)), rng.standard_normal(h.count)
            across = g - np.einsum("na,a->n", g, ball.axis)[:, None] * ball.axis
            turn = gain[:, columns] * (ball.swing * across + ball.twist * t[:, None] * ball.axis)
            before = h.values[:, columns]
            after = so3_log(so3_exp(before) @ so3_exp(turn))
            values[:, columns] = nearest_branch(after, before)
            moved[columns] = True
        return replace(h, values=np.where(moved, reflect(values, s.lower, s.upper), h.values))


_NEAREST = 0.05
"""m; a box that reaches nearer to a camera's plane fills its image."""


@dataclass(frozen=True)
class Region:
    """Where a layer looks, from the joints of the mean pose.

    joints (Y,): the joints of the layer, with the points that end its parts (`ends`: landmark indices). half: (3,) m,
    half the box's extent along the world's axes about the mean of those points (the published form, fixed), or None:
    the box that bounds the points. margin: m, added on every side.
    """

    joints: NDArray[np.int64]
    ends: NDArray[np.int64]
    half: Array | None
    margin: float

    def box(self, body: Body, pose: Array) -> Array:
        """(2, 3) m: lowest and highest corner in the world for a pose (D,)."""
        points = body.joints(pose)[self.joints]
        if len(self.ends):
            points = np.concatenate([points, body.landmark_points(pose)[self.ends]])
        if self.half is not None:
            centre = points.mean(0)
            return np.stack([centre - self.half, centre + self.half]) + [[-self.margin], [self.margin]]
        return np.stack([points.min(0) - self.margin, points.max(0) + self.margin])


def chain_region(body: Body, joints: tuple[str, ...], ends: tuple[str, ...] = (), *, girth: float = 0.12) -> Region:
    """The published box of a limb: centred at the mean of its points, with sizes fixed by the subject's anthropometry.

    A cube that holds the limb however it is bent: half its length from the first point to the last, and girth (m at a
    stature of 1.75 m) on every side. joints, ends: names of joints and landmarks. The thesis gives no factors.
    """
    s = body.skeleton
    index = np.array([s.joint(n) for n in joints])
    marks = np.array([body.landmarks.index(n) for n in ends], dtype=np.int64)
    points = s.rest_joints[index]
    if len(marks):
        tips = s.rest_joints[body.landmarks.joint[marks]] + body.landmarks.offset[marks]
        points = np.concatenate([points, tips])
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    return Region(index, marks, np.full(3, 0.5 * length), girth * body.stature / 1.75)


def bounding_region(body: Body, joints: tuple[str, ...], ends: tuple[str, ...] = (), *, margin: float) -> Region:
    """The box that bounds a limb's points, as it is posed, with a margin (m at a stature of 1.75 m) on every side."""
    index = np.array([body.skeleton.joint(n) for n in joints])
    marks = np.array([body.landmarks.index(n) for n in ends], dtype=np.int64)
    return Region(index, marks, None, margin * body.stature / 1.75)


def boxes_in_views(box: Array, rig: CameraRig) -> NDArray[np.int64]:
    """(C, 4) = x0, x1, y0, y1 px (half open), inside each image: what encloses the projected corners of box (2, 3) m.

    A box that touches a camera's plane fills the image (the projection of its corners does not enclose it); one behind
    the camera is empty. Source: Alcoverro 2014, section 2.4.1 step 2.
    """
    corners = np.array([[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    homogeneous = np.einsum("cab,nb->cna", rig.projections[:, :, :3], corners) + rig.projections[:, None, :, 3]
    depth = homogeneous[..., 2]
    uv = homogeneous[..., :2] / np.where(depth > _NEAREST, depth, 1.0)[..., None]
    w, h = rig.sizes[:, 0].astype(np.float64), rig.sizes[:, 1].astype(np.float64)
    low, high = np.floor(uv.min(1)), np.ceil(uv.max(1)) + 1
    touches = (depth <= _NEAREST).any(1)
    behind = (depth <= _NEAREST).all(1)
    out = np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], 1)
    out[touches] = np.stack([0 * w, w, 0 * h, h], 1)[touches]
    out[behind] = 0
    out = np.clip(out, 0, np.stack([w, w, h, h], 1))
    out[:, 1::2] = np.maximum(out[:, 1::2], out[:, ::2])
    return out.astype(np.int64)


def faces_of_parts(body: Body, joints: tuple[str, ...]) -> NDArray[np.bool_]:
    """(F,) triangles of the coarse mesh that belong to the parts of the named joints (by most of their corners)."""
    wanted = np.isin(body.coarse.main_joint, [body.skeleton.joint(n) for n in joints])
    return np.asarray(wanted[body.coarse.faces].sum(1) >= 2)


@dataclass(frozen=True)
class PartitionedXor:
    """Energy E = sum over usable views of XOR(M_v, S_v inside Omega_v) / C(Omega_v), so that the weight is exp(-E).

    Omega_v: the picture of the region's box about the mean of the set, C: its pixels inside the image; a view whose
    image the box misses is left out. faces (F,) bool: the triangles drawn, None for all. With no view the energy is 0.
    The mean is that of the set to be weighed, whose last steps have mean 0 (the thesis: that of the layer before).
    Source: Alcoverro 2014, eq. 2.15.
    """

    body: Body
    region: Region
    faces: NDArray[np.bool_] | None = None

    def __call__(self, h: Hypotheses, frame: PreparedFrame, /) -> Array:
        """(N,) energies of h.values (N, D), with what cues other than masks and depth say added."""
        others = [one for one in frame.evidence if one is not frame.silhouettes and one is not frame.depth]
        own = evidence_energy(self.body, h.values, others)
        if not frame.silhouettes.seen:
            return own
        # a box needs no mean on SO(3): a set around one pose has its rotation vectors on one branch
        boxes = boxes_in_views(self.region.box(self.body, h.mean()), frame.frame.the(Silhouettes).rig)
        return partitioned_energy(self.body, h.values, frame, boxes, self.faces) + own


def partitioned_energy(
    body: Body, poses: Array, frame: PreparedFrame, boxes: NDArray[np.int64], faces: NDArray[np.bool_] | None = None
) -> Array:
    """(N,) energies of eq. 2.15 for poses (N, D) in boxes (C, 4) px; zeros when no usable view has a box."""
    masks = frame.silhouettes.masks
    pixels = (boxes[:, 1] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 2])
    use = masks.usable & (pixels > 0)
    if not use.any():
        return np.zeros(len(poses))
    flat = np.ascontiguousarray(poses, dtype=np.float64)
    counts = silhouette_xor(flat, body.skeleton.tree, body.coarse.arrays, masks, boxes, faces=faces)
    return (counts[:, use, 0] / pixels[use]).sum(1)
