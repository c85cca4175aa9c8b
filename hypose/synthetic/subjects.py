"""Subjects: true bodies of synthetic scenes, from another shape space than the tracker's own body.

A subject has its own mesh and joint centres and is posed by one global rotation per joint (linear blend skinning over
the 19-joint tree), never by the tracker's degrees of freedom, so that the truth is not limited to the poses of the
tracker. The subjects in hypose/assets/subjects.npz are described in hypose/assets/LICENSE-assets.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from hypose.body.body import Mesh
from hypose.body.default_body import JOINT_NAMES, PARENTS, asset_arrays
from hypose.body.skin_weights import vertex_normals
from hypose.errors import InputError
from hypose.geometry import Array


@dataclass(frozen=True)
class SyntheticSubject(Mesh):
    """Person with exactly known mesh and joints.

    The mesh is at rest in the model frame: origin at the pelvis joint, x = the subject's left, y = backward, z = up.

    name: name of the subject.
    joints: (19, 3) m in the model frame at rest.
    cloth_weight: (V,) 0..1, where clothes may lie.
    clothing_m: thickness of the clothes, m.
    """

    name: str
    joints: Array
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

    @cached_property
    def _weights(self) -> Array:
        """(V, 19) skinning weights, rows sum to 1."""
        w = self.dense_weights(len(JOINT_NAMES))
        return w / w.sum(1, keepdims=True)

    def place_joints(self, rotations: ArrayLike, root: ArrayLike) -> Array:
        """Compute the joint centres (..., 19, 3) m for world_from_joint rotations (..., 19, 3, 3) and pelvis positions
        (..., 3).
        """
        r, p = np.asarray(rotations, dtype=np.float64), np.asarray(root, dtype=np.float64)
        out = np.zeros((*r.shape[:-3], len(JOINT_NAMES), 3))
        out[..., 0, :] = p
        for j, q in enumerate(PARENTS):
            if q >= 0:
                out[..., j, :] = out[..., q, :] + r[..., q, :, :] @ (self.joints[j] - self.joints[q])
        return out

    def skin(self, rotations: ArrayLike, root: ArrayLike) -> Array:
        """Compute the vertices (V, 3) m for one pose by linear blend skinning: rotations (19, 3, 3), root (3,) m."""
        r = np.asarray(rotations, dtype=np.float64)
        centres = self.place_joints(r, root)
        offset = centres - np.einsum("jab,jb->ja", r, self.joints)
        moves = np.concatenate([r.reshape(-1, 9), offset], 1)
        m = self._weights @ moves
        return np.einsum("vab,vb->va", m[:, :9].reshape(-1, 3, 3), self.vertices) + m[:, 9:]


@lru_cache(maxsize=1)
def load_subjects() -> dict[str, SyntheticSubject]:
    """Load the synthetic people that are shipped with the package.

    Returns: dictionary of the people by name.
    """
    data = asset_arrays("subjects.npz")
    vertices = np.cumsum(data["vertices_step"], axis=0) * float(data["vertex_scale"])  # stored as differences
    out = {}
    for k, name in enumerate(data["names"].tolist()):
        joints = data["joints"][k].astype(np.float64)
        out[str(name)] = SyntheticSubject(
            vertices[k] - joints[0],
            data["faces"].astype(np.int32),
            data["skin_index"].astype(np.int32),
            data["skin_weight"].astype(np.float64),
            str(name),
            joints - joints[0],
            data["cloth_weight"].astype(np.float64),
        )
    return out


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
    direction = rng.normal(size=(8, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    wave = 2 * np.pi / rng.uniform(0.15, 0.6, 8)
    phase = rng.uniform(0, 2 * np.pi, 8)
    folds = np.sin(subject.vertices @ (direction * wave[:, None]).T + phase).sum(1) / 4
    amount = thickness_m * np.clip(0.65 + 0.35 * folds, 0.3, 1.0) * subject.cloth_weight
    normals = vertex_normals(subject.vertices, subject.faces)
    # neighbours share their direction, so that concave places (crotch, armpits) do not fold over
    neighbours = np.zeros_like(normals)
    for k in range(3):
        np.add.at(neighbours, subject.faces[:, k], normals[subject.faces[:, (k + 1) % 3]])
    normals = normals + 0.3 * neighbours
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return replace(subject, vertices=subject.vertices + amount[:, None] * normals, clothing_m=float(thickness_m))
