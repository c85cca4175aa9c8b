"""Superquadric parts: tapered and bent superellipsoids, their nodes, and a body made of them.

A part has nine parameters x_d: semi-axes a1, a2, a3 (m, a3 along the bone), the exponents e1 (along) and e2 (around),
tapers t1, t2 of the two cross axes along the bone, and a circular bend of curvature k (1/m) in the plane at angle alpha
to the first axis. Nodes lie on a grid of the part's two angles, so a node's place is a smooth function of x_d.
Source: the model of Sminchisescu & Triggs 2001, section 2 (equation (1): D(x_d, u)); superquadrics and tapering Barr
1984, bending Solina & Bajcsy 1990, here written so that curvature 0 is no special case.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from hypose.body.body import BONE_END, Body, Mesh
from hypose.errors import InputError
from hypose.geometry import Array, rotation_between

PARAMETERS = ("a1", "a2", "a3", "e1", "e2", "t1", "t2", "k", "alpha")
"""Names of x_d, in order."""
RINGS, SECTORS = 7, 10
"""Nodes along and around a part, poles not counted."""
_SERIES = 1e-3
"""rad: below this, sines and cosines of the bend are series"""


def grid(rings: int = RINGS, sectors: int = SECTORS) -> tuple[Array, NDArray[np.int32]]:
    """Angles (N, 2) of a part's nodes (along, around) in the topological domain, and the closed mesh (F, 3) on them,
    counter-clockwise from outside. The first and last node are the poles."""
    if rings < 1 or sectors < 3:
        raise InputError(f"A part needs at least 1 ring of 3 nodes, got {rings} of {sectors}.")
    along = np.linspace(-np.pi / 2, np.pi / 2, rings + 2)[1:-1]
    around = np.linspace(-np.pi, np.pi, sectors, endpoint=False) + np.pi / sectors
    ring = np.stack(np.meshgrid(along, around, indexing="ij"), -1).reshape(-1, 2)
    angles = np.concatenate([[[-np.pi / 2, 0.0]], ring, [[np.pi / 2, 0.0]]])
    faces = []
    top = 1 + rings * sectors
    for k in range(sectors):
        n = (k + 1) % sectors
        faces.append((0, 1 + n, 1 + k))
        for r in range(rings - 1):
            a, b = 1 + r * sectors, 1 + (r + 1) * sectors
            faces += [(a + k, a + n, b + n), (a + k, b + n, b + k)]
        last = 1 + (rings - 1) * sectors
        faces.append((last + k, last + n, top))
    return angles, np.array(faces, dtype=np.int32)


def nodes(parameters: ArrayLike, angles: Array) -> Array:
    """Nodes (N, 3) m of a part in its own frame (origin at its middle, third axis along the bone), from its parameters
    (9,), at angles (N, 2) of `grid`: D of equation (1)."""
    x_d = np.asarray(parameters, dtype=np.float64)
    if x_d.shape != (9,) or not (x_d[:5] > 0).all():
        raise InputError(f"A part has nine parameters {', '.join(PARAMETERS)}, the first five above 0, got {x_d}.")
    a1, a2, a3, e1, e2, t1, t2, k, alpha = x_d
    along, height = _power(np.cos(angles[:, 0]), e1), _power(np.sin(angles[:, 0]), e1)
    x = (1 + t1 * height) * a1 * along * _power(np.cos(angles[:, 1]), e2)
    y = (1 + t2 * height) * a2 * along * _power(np.sin(angles[:, 1]), e2)
    return _bend(np.stack([x, y, a3 * height], -1), k, alpha)


def _bend(p: Array, k: float, alpha: float) -> Array:
    """Points (N, 3) after a bend of curvature k in the plane at angle alpha: with g = k z and r the coordinate in that
    plane, r moves to r cos g + (1 - cos g) / k and z to sin g (1 / k - r)."""
    u, v = np.cos(alpha), np.sin(alpha)
    x, y, z = p.T
    g = k * z
    small = np.abs(g) < _SERIES
    safe, r = np.where(small, 1.0, g), u * x + v * y
    sine = np.where(small, 1 - g**2 / 6, np.sin(safe) / safe)
    cosine = np.where(small, g / 2 - g**3 / 24, (1 - np.cos(safe)) / safe)
    shift = z * cosine - r * (1 - np.cos(g))
    return np.stack([x + u * shift, y + v * shift, z * sine - r * np.sin(g)], -1)


def _power(c: Array, exponent: float) -> Array:
    """sign(c) |c|^exponent; 0 where c is 0 up to rounding."""
    return np.sign(c) * np.where(np.abs(c) < 1e-12, 0.0, np.abs(c)) ** exponent


@dataclass(frozen=True)
class Part:
    """A superquadric on a joint. joint: its index; rotation (3, 3) and centre (3,) m of the part in the joint's rest
    frame; parameters (9,)."""

    joint: int
    rotation: Array
    centre: Array
    parameters: Array

    def place(self, points: Array) -> Array:
        """Points (..., 3) of the part's frame in the joint's rest frame."""
        return points @ self.rotation.T + self.centre


def fit_parts(body: Body) -> list[Part]:
    """One superquadric per joint that carries skin, fitted to that skin at rest (no bend).

    The distance is the radial one of Whaite & Ferrie 1991, taken with the taper undone."""
    names, rest = body.skeleton.joint_names, body.skeleton.rest_joints
    parts = []
    for j, name in enumerate(names):
        skin = body.fine.vertices[body.fine.main_joint == j] - rest[j]
        if len(skin) < 12:
            continue
        end = BONE_END.get(name)
        spread = np.linalg.eigh(np.cov(skin.T))[1][:, -1]
        axis = np.array([0.0, 0, 1]) if end is None else rest[names.index(end)] - rest[j]
        if name.endswith(("wrist", "ankle")):
            axis = spread * np.sign(spread @ (skin.mean(0)))  # hands and feet have no bone of their own
        rotation = rotation_between(np.array([0.0, 0, 1]), axis)
        local = skin @ rotation
        low, high = np.quantile(local, 0.01, axis=0), np.quantile(local, 0.99, axis=0)
        middle, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 0.01)
        parts.append(Part(j, rotation, rotation @ middle, _fit(local - middle, half)))
    return parts


def _fit(points: Array, half: Array) -> Array:
    """Parameters (9,) of the unbent superquadric nearest to points (V, 3) of its own frame."""

    def radial(p: Array) -> Array:
        a, e1, e2, taper = p[:3], p[3], p[4], p[5:7]
        u = np.clip(points[:, 2] / a[2], -1, 1)
        x = np.abs(points[:, 0] / (1 + taper[0] * u)) / a[0]
        y = np.abs(points[:, 1] / (1 + taper[1] * u)) / a[1]
        z = np.abs(points[:, 2]) / a[2]
        inside = (x ** (2 / e2) + y ** (2 / e2)) ** (e2 / e1) + z ** (2 / e1)
        return np.linalg.norm(points, axis=1) * (1 - np.maximum(inside, 1e-9) ** (-e1 / 2))

    start = np.concatenate([half, [0.7, 1.0, 0.0, 0.0]])
    low = np.concatenate([0.6 * half, [0.4, 0.5, -0.6, -0.6]])
    high = np.concatenate([1.4 * half, [1.0, 1.2, 0.6, 0.6]])
    found = least_squares(radial, start, bounds=(low, high), loss="soft_l1", f_scale=0.01, max_nfev=60).x
    return np.concatenate([found, [0.0, 0.0]])


def superquadric_body(body: Body, rings: int = RINGS, sectors: int = SECTORS) -> Body:
    """The body with superquadric parts instead of skin: the same skeleton and landmarks, meshes of separate closed
    parts whose nodes follow one joint each, as in equation (1).

    Deviation: tracking takes the skinned body unless it is given this one."""
    parts = fit_parts(body)
    angles, faces = grid(rings, sectors)
    n = len(angles)
    vertices = [p.place(nodes(p.parameters, angles)) + body.skeleton.rest_joints[p.joint] for p in parts]
    index = np.zeros((n * len(parts), 4), dtype=np.int32)
    weight = np.zeros((n * len(parts), 4))
    index[:, 0], weight[:, 0] = np.repeat([p.joint for p in parts], n), 1.0
    mesh = Mesh(
        np.concatenate(vertices),
        np.concatenate([faces + k * n for k in range(len(parts))]).astype(np.int32),
        index,
        weight,
    )
    return Body(f"{body.name}-superquadrics", body.skeleton, mesh, mesh, body.landmarks)
