"""A body without any data file: tapered capsules around a skeleton's bones, joined smoothly and meshed.

An independent double of the baked template, for tests and the benchmark of rigging: it shares nothing with the
template but the joint tree. Deterministic.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body, Landmarks, Mesh
from hypose.body.default_body import JOINT_NAMES, human_skeleton
from hypose.errors import InputError
from hypose.geometry import Array

_STATURE = 1.70


@dataclass(frozen=True)
class Proportions:
    """Segment lengths in m of a body 1.70 m tall (use `scaled` for another stature) and its thickness.

    girth multiplies the radii of all capsules, depth the trunk's front-to-back measure alone."""

    torso: float = 0.54
    neck: float = 0.10
    head: float = 0.13
    shoulder_width: float = 0.36
    hip_width: float = 0.18
    upper_arm: float = 0.28
    forearm: float = 0.25
    hand: float = 0.17
    thigh: float = 0.42
    shank: float = 0.42
    ankle_height: float = 0.08
    foot: float = 0.18
    girth: float = 1.0
    depth: float = 1.0

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"Proportion {f.name} is {value}; it must be a positive number.")

    def scaled(self, stature: float) -> Proportions:
        """All lengths in proportion for a stature in m; girth and depth stay."""
        if not 0.5 <= stature <= 2.5:
            raise InputError(f"A stature of {stature} m was given; it must lie between 0.5 and 2.5 m.")
        k = stature / self.stature
        return replace(self, **{f.name: getattr(self, f.name) * k for f in fields(self)[:-2]})

    @property
    def stature(self) -> float:
        """Floor to the top of the head in m, legs straight."""
        return self.ankle_height + self.shank + self.thigh + _HIP_DROP + self.torso + self.neck + self.head


_HIP_DROP = 0.01  # the hip joints lie a little below the pelvis joint
# Directions from parent to child in the rest pose (an A-pose with slightly bent elbows, like the baked template's).
_UPPER_ARM, _FOREARM, _LEG = (0.77, 0.0, -0.64), (0.62, -0.35, -0.70), (0.07, 0.0, -1.0)


def procedural_body(proportions: Proportions | None = None, coarse: int = 550, fine: int = 2500) -> Body:
    """A 36-dof body of capsules with a coarse and a fine closed mesh of about the given numbers of vertices.

    Source: own; smooth union by the log-sum-exp of signed distances, marching cubes, quadric decimation, skinning
    weights that fall off with the distance to the bones' capsules and are smoothed over the mesh.
    """
    p = proportions or Proportions()
    joints, ends = _rest_points(p)
    size = p.stature / _STATURE
    capsules = _capsules(p, joints, ends, size)
    surface = _isosurface(capsules, 0.013 * size)
    meshes = [_mesh(surface, target, capsules, size) for target in (coarse, fine)]
    return Body("procedural", human_skeleton(joints), meshes[0], meshes[1], _landmarks(joints, ends, size))


def _rest_points(p: Proportions) -> tuple[Array, dict[str, Array]]:
    """Joint centres (19, 3) and the free ends of the outermost segments, model frame, m."""

    def unit(v: tuple[float, float, float]) -> Array:
        return np.array(v) / np.linalg.norm(v)

    at: dict[str, Array] = {"pelvis": np.zeros(3)}
    at["spine"] = np.array([0.0, 0.01, 0.17 * p.torso])
    at["chest"] = np.array([0.0, 0.015, 0.45 * p.torso])
    at["neck"] = np.array([0.0, 0.01, p.torso])
    at["head"] = at["neck"] + [0.0, -0.02 * p.neck / 0.1, p.neck]
    ends = {"head_top": at["head"] + [0.0, 0.0, p.head]}
    left = {
        "clavicle": np.array([0.025, -0.005, 0.87 * p.torso]),
        "shoulder": np.array([p.shoulder_width / 2, 0.005, 0.83 * p.torso]),
        "hip": np.array([p.hip_width / 2, 0.0, -_HIP_DROP]),
    }
    left["elbow"] = left["shoulder"] + p.upper_arm * unit(_UPPER_ARM)
    left["wrist"] = left["elbow"] + p.forearm * unit(_FOREARM)
    left["knee"] = left["hip"] + p.thigh * unit(_LEG)
    left["ankle"] = left["knee"] + p.shank * unit(_LEG)
    tips = {
        "hand_tip": left["wrist"] + p.hand * unit(_FOREARM),
        "toe": left["ankle"] + [0.01, -p.foot, 0.025 - p.ankle_height],
        "heel": left["ankle"] + [0.0, 0.25 * p.foot, 0.03 - p.ankle_height],
    }
    for side, sign in (("left", 1.0), ("right", -1.0)):
        at |= {f"{side}_{k}": v * [sign, 1, 1] for k, v in left.items()}
        ends |= {f"{side}_{k}": v * [sign, 1, 1] for k, v in tips.items()}
    return np.array([at[n] for n in JOINT_NAMES]), ends


def _capsules(
    p: Proportions, joints: Array, ends: dict[str, Array], size: float
) -> list[tuple[int, Array, Array, Any]]:
    """(joint that carries it, start, end, (radius at start, at end, depth factor)) of every capsule."""
    point = {n: joints[k] for k, n in enumerate(JOINT_NAMES)} | ends
    flat = 0.72 * p.depth
    rows = [
        ("pelvis", "pelvis", "spine", 0.150, 0.140, flat),
        ("spine", "spine", "chest", 0.135, 0.148, flat),
        ("chest", "chest", "neck", 0.150, 0.060, flat),
        ("neck", "neck", "head", 0.055, 0.055, 1.0),
        ("head", "head", "head_top", 0.075, 0.075, 1.2),
    ]
    for s in ("left_", "right_"):
        rows += [
            (s + "clavicle", s + "clavicle", s + "shoulder", 0.055, 0.058, 1.0),
            (s + "shoulder", s + "shoulder", s + "elbow", 0.052, 0.041, 1.0),
            (s + "elbow", s + "elbow", s + "wrist", 0.041, 0.029, 1.0),
            (s + "wrist", s + "wrist", s + "hand_tip", 0.034, 0.022, 0.8),
            (s + "hip", s + "hip", s + "knee", 0.084, 0.053, 1.05),
            (s + "knee", s + "knee", s + "ankle", 0.053, 0.038, 1.05),
            (s + "ankle", s + "ankle", s + "toe", 0.040, 0.026, 1.0),
            (s + "ankle", s + "ankle", s + "heel", 0.038, 0.030, 1.0),
        ]
    out = []
    for carrier, a, b, ra, rb, depth in rows:
        end = point[b].copy()
        if b == "head_top":
            end[2] -= rb * size  # the sphere at the end reaches the top, not its centre
        radii = (ra * size * p.girth, rb * size * p.girth, depth)
        if carrier in ("head", "left_ankle", "right_ankle"):
            radii = (ra * size, rb * size, depth)  # stout people have no bigger skulls and feet
        out.append((JOINT_NAMES.index(carrier), point[a], end, radii))
    return out


def _signed_distance(points: Array, start: Array, end: Array, radii: tuple[float, float, float]) -> Array:
    """Approximate signed distance (...) of points (..., 3) to a tapered capsule; depth (y) is scaled."""
    bone = end - start
    rel = points - start
    t = np.clip(rel @ bone / (bone @ bone), 0, 1)
    off = rel - t[..., None] * bone
    off[..., 1] /= radii[2]
    return np.linalg.norm(off, axis=-1) - (radii[0] + t * (radii[1] - radii[0]))


def _isosurface(capsules: list[tuple[int, Array, Array, Any]], step: float) -> tuple[Array, NDArray[np.int64]]:
    """Vertices and outward faces of the smooth union's surface; the grid is mirrored, so the surface is symmetric."""
    from skimage.measure import marching_cubes

    reach = np.array([np.maximum(a, b) + 0.2 * np.array([1, 1, 1]) for _, a, b, _ in capsules]).max(0)
    low = np.array([np.minimum(a, b) - 0.2 for _, a, b, _ in capsules]).min(0)
    x, y, z = (np.arange(a, b, step) for a, b in zip((0.0, low[1], low[2]), reach, strict=True))
    grid = np.stack(np.meshgrid(x, y, z, indexing="ij"), -1)
    sharpness = 90.0  # 1/m: joints round off over about a centimetre
    total = np.zeros(grid.shape[:-1])
    for _, a, b, radii in capsules:
        total += np.exp(-sharpness * np.clip(_signed_distance(grid, a, b, radii), -0.3, 0.3))
    field = -np.log(total) / sharpness
    field = np.concatenate([field[:0:-1], field])
    vertices, faces, _, _ = marching_cubes(field, 0.0, spacing=(step,) * 3)
    vertices = vertices.astype(np.float64) + [-step * (len(x) - 1), low[1], low[2]]
    faces = faces.astype(np.int64)
    return vertices, faces if _volume(vertices, faces) > 0 else faces[:, ::-1]


def _mesh(
    surface: tuple[Array, NDArray[np.int64]], target: int, capsules: list[tuple[int, Array, Array, Any]], size: float
) -> Mesh:
    """The surface decimated to about `target` vertices, swollen to the surface's volume, with skinning weights."""
    import fast_simplification

    dense_vertices, dense_faces = surface
    volume = _volume(dense_vertices, dense_faces)
    for aggressiveness in (5, 6, 4, 7):  # which of them keeps the mesh a closed manifold depends on the shape
        v, f, *_ = fast_simplification.simplify(
            np.ascontiguousarray(dense_vertices),
            np.ascontiguousarray(dense_faces, dtype=np.int32),
            target_count=2 * target,
            agg=aggressiveness,
        )
        if _is_closed(f):
            break
    else:
        raise InputError(
            f"No closed mesh of {target} vertices could be made from these proportions; ask for more vertices."
        )
    v, f = v.astype(np.float64), f.astype(np.int32)
    for _ in range(3):
        cross = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
        normals = np.zeros_like(v)
        for k in range(3):
            np.add.at(normals, f[:, k], cross)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
        area = 0.5 * np.linalg.norm(cross, axis=1).sum()
        v = v + (volume - _volume(v, f)) / area * normals
    index, weight = _weights(v, f, capsules, size)
    return Mesh(v, f, index, weight)


def _weights(
    v: Array, f: NDArray[np.int32], capsules: list[tuple[int, Array, Array, Any]], size: float
) -> tuple[NDArray[np.int32], Array]:
    """(V, 4) joints and weights: soft minimum over the signed distances to the capsules, smoothed over the mesh."""
    w = np.zeros((len(v), len(JOINT_NAMES)))
    for joint, a, b, radii in capsules:
        w[:, joint] += np.exp(-_signed_distance(v, a, b, radii) / (0.012 * size))
    w /= w.sum(1, keepdims=True)
    edges = np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]])
    degree = np.bincount(edges[:, 0], minlength=len(v))[:, None]
    for _ in range(2):
        near = np.zeros_like(w)
        np.add.at(near, edges[:, 0], w[edges[:, 1]])
        w = 0.5 * w + 0.5 * near / degree
    index = np.argsort(-w, axis=1, kind="stable")[:, :4]
    best = np.take_along_axis(w, index, 1)
    best = np.where(best < 0.02, 0, best)
    return np.where(best > 0, index, 0).astype(np.int32), best / best.sum(1, keepdims=True)


def _landmarks(joints: Array, ends: dict[str, Array], size: float) -> Landmarks:
    """The template's landmarks, placed by rule."""
    at = {n: joints[k] for k, n in enumerate(JOINT_NAMES)}
    points: dict[str, tuple[str, Array]] = {
        "nose": ("head", at["head"] + np.array([0, -0.105, 0.03]) * size),
        "head_top": ("head", ends["head_top"]),
        "neck_base": ("chest", 0.5 * (at["left_shoulder"] + at["right_shoulder"])),
    }
    for side, sign in (("left", 1.0), ("right", -1.0)):
        wrist, ankle = at[f"{side}_wrist"], f"{side}_ankle"
        tip, toe, heel = (ends[f"{side}_{k}"] for k in ("hand_tip", "toe", "heel"))
        floor = heel[2] - 0.03 * size
        points |= {
            f"{side}_eye": ("head", at["head"] + np.array([0.03 * sign, -0.08, 0.055]) * size),
            f"{side}_ear": ("head", at["head"] + np.array([0.075 * sign, 0.0, 0.035]) * size),
            f"{side}_knuckle": (f"{side}_wrist", wrist + 0.5 * (tip - wrist)),
            f"{side}_hand_tip": (f"{side}_wrist", tip),
            f"{side}_thumb_tip": (f"{side}_wrist", wrist + 0.6 * (tip - wrist) + np.array([0, -0.04, 0]) * size),
            f"{side}_big_toe": (ankle, toe + np.array([-0.02 * sign, -0.02, 0]) * size),
            f"{side}_small_toe": (ankle, toe + np.array([0.02 * sign, 0.02, 0]) * size),
            f"{side}_heel": (ankle, heel + np.array([0, 0.03, 0]) * size),
            f"{side}_sole_heel": (ankle, np.array([heel[0], heel[1], floor])),
            f"{side}_sole_ball": (ankle, np.array([toe[0], toe[1] + 0.05 * size, floor])),
            f"{side}_sole_toe": (ankle, np.array([toe[0], toe[1], floor])),
        }
    index = np.array([JOINT_NAMES.index(joint) for joint, _ in points.values()], dtype=np.int64)
    offset = np.array([place for _, place in points.values()]) - joints[index]
    return Landmarks(tuple(points), index, offset)


def _volume(v: Array, f: NDArray[Any]) -> float:
    a, b, c = (v[f[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _is_closed(f: NDArray[Any]) -> bool:
    """Every edge has exactly two faces that run through it in opposite directions."""
    edges = np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]]).astype(np.int64)
    forward = np.unique(edges[:, 0] * (f.max() + 1) + edges[:, 1])
    backward = np.unique(edges[:, 1] * (f.max() + 1) + edges[:, 0])
    return len(forward) == len(edges) and np.array_equal(forward, backward)
