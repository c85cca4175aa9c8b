"""Weigh layers of a layered filter on partitioned observations (APO).

A layer is weighed only where its body parts are likely to be seen: the silhouette cost is counted inside a box around
the joints of the layer (at the mean of the set), projected into every view; parts of later layers are not drawn.
Source: Alcoverro 2014, section 2.4.1, eq. 2.15.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.cameras.camera import CameraRig
from hypose.compute.scorer import silhouette_xor
from hypose.evidence.frame import Silhouettes
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.frame_evidence import PreparedFrame, evidence_energy

_NEAREST = 0.05
"""m; a box that reaches nearer to a camera's plane fills its image."""


@dataclass(frozen=True)
class Region:
    """Box in space in which a layer of the search compares body and masks; it is placed by the mean pose of the
    hypotheses.

    joints: (Y,) the joints of the layer; ends: indices of the landmarks at the ends of the layer's body parts.
    half: (3,) half the box's extent along the world's axes about the mean of those points, m (the published, fixed
        form); None: the box that bounds the points.
    margin: m, added on every side.
    """

    joints: NDArray[np.int64]
    ends: NDArray[np.int64]
    half: Array | None
    margin: float

    def points(self, body: Body, pose: Array) -> Array:
        """Compute the world positions (N, 3), m, of the joints and then of the landmarks at a pose (D,)."""
        return np.concatenate([body.joints(pose)[self.joints], body.landmark_points(pose)[self.ends]])

    def box(self, body: Body, pose: Array) -> Array:
        """Compute the lowest and highest corner (2, 3) of the box in the world, m, for a pose (D,)."""
        points, half = self.points(body, pose), self.half
        middle = points.mean(0)
        low, high = (points.min(0), points.max(0)) if half is None else (middle - half, middle + half)
        return np.stack([low - self.margin, high + self.margin])


def chain_region(body: Body, joints: tuple[str, ...], ends: tuple[str, ...] = (), *, girth: float = 0.12) -> Region:
    """Build the published box of a limb: centred at the mean of its points, with a size fixed by the person's body.

    It is a cube that holds the limb however it is bent: half its length, plus girth, on every side of the centre.
    joints, ends: names of joints and landmarks.
    girth: m at a stature of 1.75 m; the thesis gives no factors.
    """
    region = bounding_region(body, joints, ends, margin=girth)
    points = region.points(body, np.zeros(body.skeleton.dof))
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    return replace(region, half=np.full(3, 0.5 * length))


def torso_region(body: Body, joints: tuple[str, ...], ends: tuple[str, ...]) -> Region:
    """Build the fixed box of trunk and head: as wide as the shoulders, from the hips to the top of the head.

    joints, ends: names of the joints and landmarks that the box bounds.
    """
    region = bounding_region(body, joints, ends, margin=0.12)
    low, high = region.box(body, np.zeros(body.skeleton.dof))
    half = 0.5 * (high - low)
    half[:2] = half[:2].max()  # whichever way the person faces
    return replace(region, half=half, margin=0.0)


def bounding_region(body: Body, joints: tuple[str, ...], ends: tuple[str, ...] = (), *, margin: float) -> Region:
    """Build a region whose box always bounds the points of a limb in its present pose.

    joints, ends: names of joints and landmarks.
    margin: distance added on every side, m at a stature of 1.75 m.
    """
    index = np.array([body.skeleton.joint(n) for n in joints])
    marks = np.array([body.landmarks.index(n) for n in ends], dtype=np.int64)
    return Region(index, marks, None, margin * body.stature / 1.75)


def boxes_in_views(box: Array, rig: CameraRig) -> NDArray[np.int64]:
    """Project a box (2, 3), m, into all views as bounding rectangles inside the images.

    A box that touches a camera's plane fills the image (the projection of its corners does not enclose it); a box
    behind the camera gives an empty rectangle.
    Returns: (C, 4) x0, x1, y0, y1, px, half open.
    Source: Alcoverro 2014, section 2.4.1 step 2.
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
    """Select the triangles (F,) of the coarse mesh that belong to the parts of the named joints, by most of their
    corners.
    """
    wanted = np.isin(body.coarse.main_joint, [body.skeleton.joint(n) for n in joints])
    return np.asarray(wanted[body.coarse.faces].sum(1) >= 2)


@dataclass(frozen=True)
class PartitionedXor:
    """Partitioned energy: E = sum over usable views of XOR(M_v, S_v inside Omega_v) / C(Omega_v); the weight is
    exp(-E).

    Omega_v: projection of the region's box about the mean of the set; C: its pixels inside the image.
    Views whose image the box misses are left out; with no view the energy is 0.
    faces: (F,) true for the triangles drawn; None: all.
    Deviation: the mean is that of the set to be weighed, whose last steps have mean 0; in the thesis it is that of the
        previous layer.
    Source: Alcoverro 2014, eq. 2.15.
    """

    body: Body
    region: Region
    faces: NDArray[np.bool_] | None = None

    def __call__(self, h: Hypotheses, frame: PreparedFrame, /) -> Array:
        """Compute the energies (N,) of h.values (N, D), with those of all evidence except masks and depth added."""
        others = [one for one in frame.evidence if one is not frame.silhouettes and one is not frame.depth]
        own = evidence_energy(self.body, h.values, others)
        if not frame.silhouettes.seen:
            return own
        # a box needs no mean on SO(3): a set around one pose has its rotation vectors on one branch
        boxes = boxes_in_views(self.region.box(self.body, h.mean()), frame.frame.the(Silhouettes).rig)
        masks, body = frame.silhouettes.masks, self.body
        pixels = (boxes[:, 1] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 2])
        use = masks.usable & (pixels > 0)
        flat = np.ascontiguousarray(h.values, dtype=np.float64)
        counts = silhouette_xor(flat, body.skeleton.tree, body.coarse.arrays, masks, boxes, faces=self.faces)
        return (counts[:, use, 0] / pixels[use]).sum(1) + own
