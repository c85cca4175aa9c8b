"""Subjects: truth bodies of synthetic scenes, from another shape space than the tracker's own body.

A subject has its own mesh and joint centres and is posed by one global rotation per joint (linear blend
skinning over the 19-joint tree), never by the tracker's degrees of freedom, so that the truth is not confined
to what the tracker can express. The subjects in hypose/assets/subjects.npz are described in
hypose/assets/LICENSE-assets.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from importlib import resources

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.ready_bodies import JOINT_NAMES, PARENTS
from hypose.errors import InputError
from hypose.geometry import Array


@dataclass(frozen=True)
class Subject:
    """A person whose every point is known.

    vertices (V, 3) m and joints (19, 3) m in the model frame at rest (origin at the pelvis joint, x = the
    subject's left, y = backward, z = up); faces (F, 3) counter-clockwise from outside; skin_index,
    skin_weight (V, 4); cloth_weight (V,) 0..1: where clothing may lie; clothing_m: the thickness it was
    dressed with.
    """

    name: str
    vertices: Array
    joints: Array
    faces: NDArray[np.int32]
    skin_index: NDArray[np.int32]
    skin_weight: Array
    cloth_weight: Array
    clothing_m: float = 0.0

    def __post_init__(self) -> None:
        v = len(self.vertices)
        if self.joints.shape != (len(JOINT_NAMES), 3):
            raise InputError(f"Subject {self.name}: joints must be ({len(JOINT_NAMES)}, 3), got {self.joints.shape}.")
        if self.skin_index.shape != (v, 4) or self.skin_weight.shape != (v, 4) or self.cloth_weight.shape != (v,):
            raise InputError(f"Subject {self.name}: skin and cloth weights must have one row per vertex ({v}).")

    @property
    def stature(self) -> float:
        """Height of the rest mesh, m."""
        return float(np.ptp(self.vertices[:, 2]))

    @property
    def leg_length(self) -> float:
        """Thigh plus shank, mean of both sides, m."""
        j = self.joints
        return float(np.mean([np.linalg.norm(j[a] - j[a + 1]) for a in (13, 14, 16, 17)]) * 2)

    @cached_property
    def dense_weights(self) -> Array:
        """(V, 19) skinning weights, rows sum to 1."""
        w = np.zeros((len(self.vertices), len(JOINT_NAMES)))
        for k in range(4):
            np.add.at(w, (np.arange(len(w)), self.skin_index[:, k]), self.skin_weight[:, k])
        return w / w.sum(1, keepdims=True)

    @cached_property
    def main_joint(self) -> NDArray[np.int64]:
        """(V,) the joint of largest weight."""
        return self.dense_weights.argmax(1)

    def place_joints(self, rotations: ArrayLike, root: ArrayLike) -> Array:
        """Joint centres (..., 19, 3) m for world_from_joint rotations (..., 19, 3, 3) and pelvis positions
        (..., 3)."""
        r, p = np.asarray(rotations, dtype=np.float64), np.asarray(root, dtype=np.float64)
        out = np.zeros((*r.shape[:-3], len(JOINT_NAMES), 3))
        out[..., 0, :] = p
        for j, q in enumerate(PARENTS):
            if q >= 0:
                out[..., j, :] = out[..., q, :] + r[..., q, :, :] @ (self.joints[j] - self.joints[q])
        return out

    def skin(self, rotations: ArrayLike, root: ArrayLike) -> Array:
        """Skinned vertices (V, 3) m for one pose: rotations (19, 3, 3), root (3,). Linear blend skinning."""
        r = np.asarray(rotations, dtype=np.float64)
        centres = self.place_joints(r, root)
        offset = centres - np.einsum("jab,jb->ja", r, self.joints)
        moves = np.concatenate([r.reshape(-1, 9), offset], 1)
        m = self.dense_weights @ moves
        return np.einsum("vab,vb->va", m[:, :9].reshape(-1, 3, 3), self.vertices) + m[:, 9:]


@lru_cache(maxsize=1)
def load_subjects() -> dict[str, Subject]:
    """The baked subjects by name; an InputError when the asset is missing from the installation."""
    file = resources.files("hypose.assets").joinpath("subjects.npz")
    try:
        with file.open("rb") as stream:
            data = dict(np.load(stream, allow_pickle=False))
    except FileNotFoundError:
        raise InputError(
            "The synthetic subjects (hypose/assets/subjects.npz) are missing from this installation; "
            "install hypose again, or use a procedural subject."
        ) from None
    vertices = np.cumsum(data["vertices_step"], axis=0) * float(data["vertex_scale"])  # kept as what people differ by
    out = {}
    for k, name in enumerate(data["names"].tolist()):
        joints = data["joints"][k].astype(np.float64)
        out[str(name)] = Subject(
            str(name),
            vertices[k] - joints[0],
            joints - joints[0],
            data["faces"].astype(np.int32),
            data["skin_index"].astype(np.int32),
            data["skin_weight"].astype(np.float64),
            data["cloth_weight"].astype(np.float64),
        )
    return out


def vertex_normals(vertices: Array, faces: NDArray[np.int32]) -> Array:
    """Unit outward normals (V, 3) of vertices (V, 3), weighted by the area of the faces (F, 3)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    n = np.cross(b - a, c - a)
    flat = faces.ravel()
    rows = np.repeat(n, 3, axis=0)
    out = np.stack([np.bincount(flat, rows[:, k], len(vertices)) for k in range(3)], 1)
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12)


MAX_CLOTHING_M = 0.04


def dress(subject: Subject, thickness_m: float, rng: np.random.Generator) -> Subject:
    """The subject in clothes: a smooth outward displacement of 0.3 to 1 times thickness_m (<= 4 cm) where
    cloth_weight is 1, less towards the naked parts. Joints stay where they are.

    The folds are a sum of random plane waves over the body (wavelengths about 15 to 60 cm), so that clothing
    differs from place to place, as it does on real people, without roughness that no silhouette would show.
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


# height of each joint, lateral place and depth as shares of the stature (Drillis & Contini's segment shares,
# rounded)
_PROPORTIONS = {
    "pelvis": (0.0, 0.0, 0.53),
    "spine": (0.0, 0.01, 0.60),
    "chest": (0.0, 0.02, 0.70),
    "neck": (0.0, 0.02, 0.83),
    "head": (0.0, 0.0, 0.88),
    "clavicle": (0.015, 0.0, 0.81),
    "shoulder": (0.105, 0.01, 0.805),
    "elbow": (0.20, 0.02, 0.66),
    "wrist": (0.29, -0.01, 0.545),
    "hip": (0.052, 0.0, 0.515),
    "knee": (0.06, 0.0, 0.28),
    "ankle": (0.065, 0.01, 0.045),
}
# ellipsoids: centre between two joints (or joint + offset), radii as shares of the stature, the joint that
# carries them
_RADII = {"shoulder": (0.032, 0.026), "elbow": (0.026, 0.018), "hip": (0.052, 0.036), "knee": (0.036, 0.024)}


def procedural_subject(rng: np.random.Generator, stature: float | None = None) -> Subject:
    """A person of ellipsoids with random proportions: the fallback when no baked subjects exist, and the
    tests' double.

    Segments vary by +-6 %, girths by +-15 %. Every part is a closed surface of its own; parts overlap.
    """
    h = float(rng.uniform(1.5, 1.95)) if stature is None else float(stature)
    girth = float(rng.uniform(0.85, 1.2))
    joints = np.zeros((len(JOINT_NAMES), 3))
    jitter = {k: rng.uniform(0.94, 1.06) for k in _PROPORTIONS}
    for j, name in enumerate(JOINT_NAMES):
        kind = name.split("_")[-1]
        x, y, z = _PROPORTIONS[kind]
        sign = -1.0 if name.startswith("right") else 1.0
        rest = np.array([sign * x, y, z]) * h
        p = PARENTS[j]
        if p >= 0:
            # the segment's length varies, its direction does not
            pk = JOINT_NAMES[p].split("_")[-1]
            px, py, pz = _PROPORTIONS[pk]
            rest = joints[p] + (rest - np.array([sign * px, py, pz]) * h) * jitter[kind]
        joints[j] = rest
    joints -= joints[0]

    parts: list[tuple[Array, Array, Array, int, float]] = []  # a, b, radii (along, x, y), joint, cloth

    def limb(a: str, b: str, r: tuple[float, float], cloth: float) -> None:
        i, k = JOINT_NAMES.index(a), JOINT_NAMES.index(b)
        parts.append((joints[i], joints[k], np.array(r) * h * girth, i, cloth))

    for side in ("left", "right"):
        limb(f"{side}_shoulder", f"{side}_elbow", _RADII["shoulder"], 1.0)
        limb(f"{side}_elbow", f"{side}_wrist", _RADII["elbow"], 0.3)
        limb(f"{side}_hip", f"{side}_knee", _RADII["hip"], 1.0)
        limb(f"{side}_knee", f"{side}_ankle", _RADII["knee"], 1.0)
        w, e = JOINT_NAMES.index(f"{side}_wrist"), JOINT_NAMES.index(f"{side}_elbow")
        along = (joints[w] - joints[e]) / np.linalg.norm(joints[w] - joints[e])
        parts.append((joints[w], joints[w] + along * 0.095 * h, np.array([0.018, 0.024]) * h, w, 0.0))
        a = JOINT_NAMES.index(f"{side}_ankle")
        sole = joints[a] + np.array([0, 0, -0.018]) * h
        parts.append((sole + [0, 0.02 * h, 0], sole + [0, -0.09 * h, 0], np.array([0.022, 0.022]) * h, a, 0.2))
        limb(f"{side}_clavicle", f"{side}_shoulder", (0.04, 0.04), 1.0)
    n, hd = joints[3], joints[4]
    parts.append((n, hd, np.array([0.033, 0.033]) * h, 3, 0.0))
    parts.append((hd + [0, 0, 0.0], hd + [0, -0.01 * h, 0.1 * h], np.array([0.045, 0.05]) * h, 4, 0.0))
    parts.append((joints[0] + [0, 0, -0.02 * h], joints[1], np.array([0.085, 0.07]) * h * girth, 0, 1.0))
    parts.append((joints[1], joints[2], np.array([0.075, 0.062]) * h * girth, 1, 1.0))
    parts.append((joints[2], joints[3], np.array([0.092, 0.065]) * h * girth, 2, 1.0))

    vertices, faces, owner, cloth_weight = [], [], [], []
    for a, b, r, j, cloth in parts:
        v, f = _capsule(a, b, float(r[0]), float(r[1]))
        faces.append(f + sum(len(x) for x in vertices))
        vertices.append(v)
        owner.append(np.full(len(v), j))
        cloth_weight.append(np.full(len(v), cloth))
    index = np.zeros((sum(map(len, vertices)), 4), dtype=np.int32)
    index[:, 0] = np.concatenate(owner)
    weight = np.zeros(index.shape)
    weight[:, 0] = 1.0
    return Subject(
        "procedural",
        np.concatenate(vertices),
        joints,
        np.concatenate(faces).astype(np.int32),
        index,
        weight,
        np.concatenate(cloth_weight),
    )


def _capsule(
    a: Array, b: Array, r0: float, r1: float, around: int = 14, rings: int = 12
) -> tuple[Array, NDArray[np.int64]]:
    """Closed tapered capsule from a to b, faces counter-clockwise from outside."""
    axis = b - a
    length = np.linalg.norm(axis)
    z = axis / length
    x = np.cross(z, np.eye(3)[int(np.abs(z).argmin())])
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    s = np.linspace(0, np.pi, rings + 1)[1:-1]  # latitude from a's end to b's end
    height = np.where(np.cos(s) > 0, -np.cos(s) * r0, length - np.cos(s) * r1)
    radius = np.sin(s) * np.where(np.cos(s) > 0, r0, r1)
    phi = np.linspace(0, 2 * np.pi, around, endpoint=False)
    circle = np.cos(phi)[:, None] * x + np.sin(phi)[:, None] * y
    rows = a + height[:, None, None] * z + radius[:, None, None] * circle
    v = np.concatenate([rows.reshape(-1, 3), [a - r0 * z, b + r1 * z]])
    n, m = len(rows), around
    f = []
    for i in range(n - 1):
        for k in range(m):
            p, q = i * m + k, i * m + (k + 1) % m
            f += [[p, q, q + m], [p, q + m, p + m]]
    for k in range(m):
        q = (k + 1) % m
        f += [[n * m, q, k], [n * m + 1, (n - 1) * m + k, (n - 1) * m + q]]
    return np.asarray(v, dtype=np.float64), np.array(f, dtype=np.int64)
