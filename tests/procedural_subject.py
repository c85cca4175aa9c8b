"""A person of ellipsoids with random proportions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hypose.body.ready_bodies import JOINT_NAMES, PARENTS
from hypose.geometry import Array
from hypose.synthetic.subjects import Subject

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
