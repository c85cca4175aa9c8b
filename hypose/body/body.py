"""Body: a skeleton with skinned meshes and landmarks; linear blend skinning and shape deformation.

Source: Alcoverro 2014, section 2.3: skinning (2.12), bone-length deformation and radial deformation, all through the
    skinning weights.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.skeleton import Skeleton, check_shapes
from hypose.compute import kinematics
from hypose.compute.arrays import MeshArrays
from hypose.compute.kinematics import forward_kinematics
from hypose.errors import InputError, refuse
from hypose.geometry import Array


@dataclass(frozen=True)
class Mesh:
    """Skinned triangle mesh in the model frame at rest.

    vertices: (V, 3) m.
    faces: (F, 3) vertex indices, counter-clockwise seen from outside.
    skin_index: (V, 4) joints that carry a vertex.
    skin_weight: (V, 4) their weights (sum 1, unused 0).
    Raises: InputError where shapes or indices do not agree, or a vertex is not finite.
    """

    vertices: Array
    faces: NDArray[np.int32]
    skin_index: NDArray[np.int32]
    skin_weight: Array

    def __post_init__(self) -> None:
        v = len(self.vertices)
        check_shapes(self, {"skin_index": (v, 4), "skin_weight": (v, 4)})
        low, high = self.faces.min(initial=0), self.faces.max(initial=-1)
        faults = {
            f"{v} vertices but a face refers to vertex {high}": low < 0 or high >= v,
            "vertices that are not finite": not np.isfinite(self.vertices).all(),
        }
        refuse("The mesh has ", faults)

    @cached_property
    def edges(self) -> NDArray[np.int32]:
        """Edges of the mesh (E, 4): vertices a and b, the face that runs from a to b, the face that runs from b to a.

        Raises: InputError where the mesh is not a closed manifold.
        """
        owner: dict[tuple[int, int], int] = {}
        for f, (a, b, c) in enumerate(self.faces.tolist()):
            for edge in ((a, b), (b, c), (c, a)):
                if edge in owner:
                    raise InputError(f"The mesh is not a manifold: the directed edge {edge} belongs to two faces.")
                owner[edge] = f
        open_edges = sum((b, a) not in owner for a, b in owner)
        if open_edges:
            raise InputError(f"The mesh is not closed: {open_edges} edges have one face only.")
        return np.array([(a, b, f, owner[b, a]) for (a, b), f in owner.items() if a < b], dtype=np.int32)

    @cached_property
    def arrays(self) -> MeshArrays:
        """Mesh as flat arrays for compiled code; the weights of each vertex are in descending order."""
        order = np.argsort(-self.skin_weight, axis=1, kind="stable")
        index = np.take_along_axis(self.skin_index, order, 1).astype(np.int32)
        weight = np.take_along_axis(self.skin_weight, order, 1).astype(np.float32)
        return MeshArrays(
            np.ascontiguousarray(self.vertices, dtype=np.float32),
            np.ascontiguousarray(self.faces, dtype=np.int32),
            self.edges,
            np.ascontiguousarray(index),
            np.ascontiguousarray(weight / weight.sum(1, keepdims=True)),
            (weight > 0).sum(1).astype(np.int32),
        )

    @cached_property
    def main_joint(self) -> NDArray[np.int64]:
        """(V,) body part of each vertex: the joint of largest skinning weight."""
        best = self.skin_weight.argmax(1)[:, None]
        return np.take_along_axis(self.skin_index, best, 1)[:, 0].astype(np.int64)

    @cached_property
    def face_joint(self) -> NDArray[np.int64]:
        """(F,) body part of each face: that of two of its corners (see `main_joint`), else that of its first corner."""
        a, b, c = self.main_joint[self.faces].T
        return np.where(b == c, b, a)

    def dense_weights(self, n_joints: int) -> Array:
        """Return the skinning weights as a dense matrix (V, J) for a body of n_joints = J joints."""
        v = len(self.vertices)
        place = n_joints * np.arange(v)[:, None] + self.skin_index
        weights = np.bincount(place.ravel(), self.skin_weight.ravel(), v * n_joints)
        return np.asarray(weights, dtype=np.float64).reshape(v, n_joints)

    def moved(self, vertices: Array) -> Mesh:
        """Copy the mesh with other vertices (V, 3), m."""
        out = replace(self, vertices=vertices)
        if "edges" in self.__dict__:  # the topology is the same; building it again would dominate a shape search
            out.__dict__["edges"] = self.edges
        return out

    @cached_property
    def rings(self) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
        """Faces around each vertex, as a pair (first, rows).

        first: (V + 1,) the rows first[v] to first[v + 1] - 1 belong to vertex v, one per face around it.
        rows: (3 F, 3) columns 0 and 1: the two other corners of the face, in its order; column 2: the row of the next
            face around the same vertex, which shares the edge to the corner in column 0 (the row itself where there is
            none).
        """
        faces = np.asarray(self.faces)
        corners, count = faces.ravel(), len(self.vertices)
        order = np.argsort(corners, kind="stable")
        first = np.searchsorted(corners[order], np.arange(count + 1)).astype(np.int64)
        others = np.stack([np.roll(faces, -k, axis=1)[:, 1:] for k in range(3)], 1).reshape(-1, 2)[order]
        begins, ends = (corners[order] * count + others[:, k] for k in (0, 1))
        by_end = np.argsort(ends, kind="stable")
        nearby = by_end[np.minimum(np.searchsorted(ends[by_end], begins), len(ends) - 1)]
        nearby = np.where(ends[nearby] == begins, nearby, np.arange(len(ends)))
        return first, np.ascontiguousarray(np.column_stack([others, nearby]), dtype=np.int32)

    @property
    def volume(self) -> float:
        """Enclosed volume, m^3 (positive where the faces are oriented outwards)."""
        return enclosed_volume(self.vertices, self.faces)


def enclosed_volume(vertices: ArrayLike, faces: ArrayLike) -> float:
    """Compute the volume inside a closed mesh.

    vertices, faces: (V, 3) m and (F, 3).
    Returns: m^3, positive where the faces are oriented outwards.
    """
    v = np.asarray(vertices, dtype=np.float64)
    a, b, c = np.moveaxis((v - v.mean(0))[np.asarray(faces)], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@dataclass(frozen=True)
class Shape:
    """Factors of a shape deformation, relative to the body to which they are applied; joints not named keep 1.

    scale: uniform factor on everything, applied first.
    length: by joint, factor on the bone from that joint to its child. The skin is stretched along the bone and children
        are carried ("scale" in section 2.3.2).
    girth: by joint, factor or (3,) factors along model x, y, z on the distance of the skin from the bone ("radial"; per
        direction for width and depth of the torso).
    offset: by joint, (3,) factors along model x, y, z on the offset of the joint from its parent (hip and shoulder
        width).
    """

    scale: float = 1.0
    length: dict[str, float] = field(default_factory=dict)
    girth: dict[str, float | tuple[float, float, float]] = field(default_factory=dict)
    offset: dict[str, tuple[float, float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Landmarks:
    """Named points fixed to joints.

    names: (L) names.
    joint: (L,) joint to which each is fixed.
    offset: (L, 3) m in the joint's rest frame.
    """

    names: tuple[str, ...]
    joint: NDArray[np.int64]
    offset: Array

    def index(self, name: str) -> int:
        """Return the index of a landmark by name; raises InputError with the list of names where there is none."""
        if name not in self.names:
            raise InputError(f"There is no landmark {name!r}; the landmarks are {', '.join(self.names)}.")
        return self.names.index(name)

    def positions(self, body: Body, poses: ArrayLike) -> Array:
        """Compute the positions (..., L, 3), m, of the points in the world, for poses (..., D) of a body."""
        return body.skeleton.points(self.joint, self.offset, poses)


@dataclass(frozen=True, eq=False)  # compared by identity, so that results can be cached per body
class Body:
    """Body that can be tracked.

    name: name of the body.
    skeleton: joint tree with degrees of freedom.
    coarse: closed mesh for scoring silhouettes.
    fine: mesh for display.
    landmarks: named points fixed to joints.
    """

    name: str
    skeleton: Skeleton
    coarse: Mesh
    fine: Mesh
    landmarks: Landmarks

    def joints(self, poses: ArrayLike) -> Array:
        """Compute the joint centres (..., J, 3) m in the world for poses (..., D)."""
        return self.skeleton.forward(poses)[1]

    def skin(self, poses: ArrayLike, mesh: Mesh | None = None) -> Array:
        """Compute the vertices (..., V, 3) m in the world for poses (..., D), by linear blend skinning.

        mesh: the mesh to skin; None: the coarse one.
        Source: Alcoverro 2014, eq. 2.12. Deviation: a vertex follows four joints at most.
        """
        q = np.asarray(poses, dtype=np.float64)
        m = mesh or self.coarse
        rotations, centres = forward_kinematics(
            np.ascontiguousarray(q.reshape(-1, self.skeleton.dof)), self.skeleton.tree
        )
        v = kinematics.skin(rotations, centres, self.skeleton.tree, m.arrays)
        return v.reshape(*q.shape[:-1], *v.shape[1:])

    def landmark_points(self, poses: ArrayLike) -> Array:
        """Compute the positions (..., L, 3), m, of the body's landmarks in the world, for poses (..., D)."""
        return self.landmarks.positions(self, poses)

    @property
    def stature(self) -> float:
        """Height of the mesh at rest, m."""
        return float(np.ptp(self.fine.vertices[:, 2]))

    def segment_lengths(self) -> dict[str, float]:
        """Measure the segments at rest, from joint to joint.

        Returns: m by name: torso, neck, shoulder_width, hip_width; upper_arm, forearm, thigh and shank, each with the
            prefix left_ and right_.
        """
        j, s = self.skeleton.rest_joints, self.skeleton
        return {k: float(np.linalg.norm(j[s.joint(a)] - j[s.joint(b)])) for k, (a, b) in _SEGMENTS.items()}


_LIMBS = {
    "upper_arm": ("shoulder", "elbow"),
    "forearm": ("elbow", "wrist"),
    "thigh": ("hip", "knee"),
    "shank": ("knee", "ankle"),
}
_SEGMENTS = {
    "torso": ("pelvis", "neck"),
    "neck": ("neck", "head"),
    **{f"{s}_{name}": (f"{s}_{a}", f"{s}_{b}") for s in ("left", "right") for name, (a, b) in _LIMBS.items()},
    "shoulder_width": ("left_shoulder", "right_shoulder"),
    "hip_width": ("left_hip", "right_hip"),
}
# the child that ends each limb bone: the bone's axis in radial and length deformation
BONE_END = {f"{side}_{a}": f"{side}_{b}" for side in ("left", "right") for a, b in _LIMBS.values()}


def deform(body: Body, shape: Shape, name: str | None = None) -> Body:
    """Change the size, bone lengths and girths of a body.

    body: the body.
    shape: factors to apply.
    name: name of the new body; None: that of the old one.
    Returns: the new body. Every vertex moves by the blend of its joints' deformations, so that segments stay joined.
        Limb bones stretch along the bone and widen across it; the other joints (pelvis, spine, chest, neck, head,
        hands, feet) stretch along model z and widen along x and y.
    Raises: InputError where the shape names an unknown joint.
    Source: Alcoverro 2014, section 2.3.2. Deviations: the skin of a bone is stretched along it by the factor of its
        length, where the thesis shifts it by the gain in length. The radial direction is away from the bone's infinite
        axis, not from the closest point of the bone, so that a girth changes no length at the ends of the bone. The
        distance from the axis is multiplied, where the thesis adds a multiple of it (beta = girth - 1).
    """
    s = body.skeleton
    names, parents = s.joint_names, s.parents
    known = set(names)
    unknown = {*shape.length, *shape.girth, *shape.offset} - known
    if unknown:
        raise InputError(f"The shape names unknown joints {sorted(unknown)}; the joints are {', '.join(names)}.")
    old, stretch = s.rest_joints, np.array([shape.length.get(name, 1.0) for name in names])
    offsets = s.rest_offsets * shape.scale
    offsets[1:] *= stretch[parents[1:], None]
    offsets *= np.array([shape.offset.get(name, (1.0, 1.0, 1.0)) for name in names])
    # dataclasses.replace builds a new object, so cached properties of the old shape are not carried over
    skeleton = replace(s, rest_offsets=offsets)
    new = skeleton.rest_joints

    # the skin about a joint stretches along an axis and widens across it
    girths = np.array([np.broadcast_to(shape.girth.get(name, 1.0), 3) for name in names])
    axes = np.tile([0.0, 0.0, 1.0], (len(names), 1))
    for joint, end in BONE_END.items():
        if joint in known:
            axes[names.index(joint)] = old[names.index(end)] - old[names.index(joint)]
    along = axes[:, :, None] * axes[:, None] / (axes**2).sum(1)[:, None, None]
    change = shape.scale * (along * stretch[:, None, None] + girths[:, :, None] * (np.eye(3) - along))

    def deform_mesh(mesh: Mesh) -> Mesh:
        # in fixed order: no threaded BLAS
        w, v = mesh.dense_weights(len(names)), np.asarray(mesh.vertices, dtype=np.float64)
        turned = np.einsum("vj,jk->vk", w, change.reshape(-1, 9)).reshape(-1, 3, 3)
        moved = np.einsum("vab,vb->va", turned, v) + np.einsum(
            "vj,ja->va", w, new - np.einsum("jab,jb->ja", change, old)
        )
        return mesh.moved(moved)

    marks = body.landmarks
    moved_marks = np.einsum("lab,lb->la", change[marks.joint], marks.offset)
    coarse = deform_mesh(body.coarse)
    fine = coarse if body.fine is body.coarse else deform_mesh(body.fine)  # shape searches have no display mesh
    return Body(name or body.name, skeleton, coarse, fine, replace(marks, offset=moved_marks))
