"""Subjects: true bodies of synthetic scenes, from another shape space than the tracker's own body.

A subject has its own mesh and joint centres and is posed by one global rotation per joint (linear blend skinning over
its tree of joints), never by the tracker's degrees of freedom, so that the truth is not limited to the poses of the
tracker. The subjects in hypose/assets/subjects.npz are described in hypose/assets/LICENSE-assets.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hypose.body.body import Mesh
from hypose.body.default_body import PARENTS, asset_arrays
from hypose.body.skin_weights import vertex_normals
from hypose.errors import InputError
from hypose.geometry import Array, unit


@dataclass(frozen=True)
class JointedPerson(Mesh):
    """Person with exactly known mesh and J joints, posed by one rotation per joint.

    The mesh is at rest in the model frame: origin at the pelvis joint, x = the person's left, y = backward, z = up.

    name: name of the person.
    joints: (J, 3) m in the model frame at rest.
    parents: J numbers of the parents of the joints, which come first; -1 for the pelvis.
    """

    name: str
    joints: Array
    parents: tuple[int, ...]

    @cached_property
    def weights(self) -> Array:
        """(V, J) skinning weights, rows sum to 1."""
        w = self.dense_weights(len(self.parents))
        return w / w.sum(1, keepdims=True)

    def place_joints(self, rotations: ArrayLike, root: ArrayLike) -> Array:
        """Compute the joint centres (..., J, 3) m for world_from_joint rotations (..., J, 3, 3) and pelvis positions
        (..., 3).
        """
        r, p = np.asarray(rotations, dtype=np.float64), np.asarray(root, dtype=np.float64)
        out = np.zeros((*r.shape[:-2], 3))
        out[..., 0, :] = p
        for j, q in enumerate(self.parents):
            if q >= 0:
                out[..., j, :] = out[..., q, :] + r[..., q, :, :] @ (self.joints[j] - self.joints[q])
        return out

    def skin(self, rotations: ArrayLike, root: ArrayLike) -> Array:
        """Compute the vertices (V, 3) m for one pose by linear blend skinning: rotations (J, 3, 3), root (3,) m."""
        r = np.asarray(rotations, dtype=np.float64)
        centres = self.place_joints(r, root)
        offset = centres - np.einsum("jab,jb->ja", r, self.joints)
        moves = np.concatenate([r.reshape(-1, 9), offset], 1)
        m = self.weights @ moves
        return np.einsum("vab,vb->va", m[:, :9].reshape(-1, 3, 3), self.vertices) + m[:, 9:]


@dataclass(frozen=True)
class SyntheticSubject(JointedPerson):
    """Person with the 19 joints of the tracker's body.

    cloth_weight: (V,) 0..1, where clothes may lie.
    clothing_m: thickness of the clothes, m.
    """

    cloth_weight: Array
    clothing_m: float = 0.0

    @property
    def stature(self) -> float:
        """Height of the mesh at rest, m."""
        return float(np.ptp(self.vertices[:, 2]))

    @property
    def leg_length(self) -> float:
        """Thigh plus shank, mean of both sides, m."""
        j = self.joints
        return float(np.mean([np.linalg.norm(j[a] - j[a + 1]) for a in (13, 14, 16, 17)]) * 2)


def people_arrays(asset: str) -> tuple[dict[str, np.ndarray], list[tuple[Any, ...]]]:
    """Read an asset of several people with one topology, whose vertices are stored as differences between people.

    Returns: arrays of the asset, and the fields of `JointedPerson` for each person.
    """
    data = asset_arrays(asset)
    vertices = np.cumsum(data["vertices_step"], axis=0) * float(data["vertex_scale"])
    shared = data["faces"].astype(np.int32), data["skin_index"].astype(np.int32), data["skin_weight"].astype(np.float64)
    parents = tuple(map(int, data.get("parents", PARENTS)))
    each = zip(vertices, data["names"].tolist(), data["joints"].astype(np.float64), strict=True)
    return data, [(v - j[0], *shared, str(name), j - j[0], parents) for v, name, j in each]


@lru_cache(maxsize=1)
def load_subjects() -> dict[str, SyntheticSubject]:
    """Load the synthetic people that are shipped with the package.

    Returns: dictionary of the people by name.
    """
    data, people = people_arrays("subjects.npz")
    subjects = [SyntheticSubject(*fields, cloth_weight=data["cloth_weight"].astype(np.float64)) for fields in people]
    return {subject.name: subject for subject in subjects}


MAX_CLOTHING_M = 0.04


def dress(subject: SyntheticSubject, thickness_m: float, rng: np.random.Generator) -> SyntheticSubject:
    """Dress a subject: move its surface outwards, joints stay.

    thickness_m: thickness of the clothes (<= 0.04 m); the displacement is 0.3 to 1 times this where cloth_weight is 1,
        less towards bare parts.
    Returns: the dressed subject.
    Raises: InputError for a thickness outside the range.

    The folds are a sum of random plane waves over the body (wavelengths about 15 to 60 cm), so that the thickness
    varies as on real people, without roughness too fine for a silhouette.
    """
    if not 0 <= thickness_m <= MAX_CLOTHING_M:
        raise InputError(f"Clothing of {thickness_m} m was asked for; between 0 and {MAX_CLOTHING_M} m is possible.")
    direction = unit(rng.normal(size=(8, 3)))
    wave = 2 * np.pi / rng.uniform(0.15, 0.6, 8)
    phase = rng.uniform(0, 2 * np.pi, 8)
    folds = np.sin(subject.vertices @ (direction * wave[:, None]).T + phase).sum(1) / 4
    amount = thickness_m * np.clip(0.65 + 0.35 * folds, 0.3, 1.0) * subject.cloth_weight
    normals = vertex_normals(subject.vertices, subject.faces)
    # neighbours share their direction, so that concave places (crotch, armpits) do not fold over
    neighbours = np.zeros_like(normals)
    for k in range(3):
        np.add.at(neighbours, subject.faces[:, k], normals[subject.faces[:, (k + 1) % 3]])
    normals = unit(normals + 0.3 * neighbours)
    return replace(subject, vertices=subject.vertices + amount[:, None] * normals, clothing_m=float(thickness_m))
