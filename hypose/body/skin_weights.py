"""Prepare the mesh of a body: skinning weights, by heat that diffuses from the bones over the surface; a coarse mesh.

Source: Baran & Popovic 2007, "Automatic rigging and animation of 3D characters", section 4: (-Laplacian + H) w = H p,
    with H = c / d^2 for the distance d to the nearest bone, and p = 1 for that bone. Deviations: the nearest bone is
    chosen among those visible from the vertex through the inside (so that a hand near a thigh does not follow it); a
    joint may have several segments; the Laplacian tolerates needles and non-manifold edges (Sharp & Crane 2020); at
    most four joints per vertex.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_matrix, csc_matrix, diags, identity
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu, spsolve
from scipy.spatial import KDTree

from hypose.body.body import Body, enclosed_volume
from hypose.compute.visibility import nearest_visible
from hypose.errors import InputError, extra
from hypose.geometry import Array

# Smaller weights are dropped before the rest is scaled to sum 1: they are invisible and cost time.
_SMALLEST = 0.01


HEAT = 2.0
"""Constant c (1 in the paper); less makes wider transitions. With 2 the weights are nearer to those of the template,
which artists made (mean absolute difference 0.0136 against 0.0164), and equally smooth.
"""


@dataclass(frozen=True)
class Bones:
    """Line segments that emit heat; a joint may have several.

    start, end: (B, 3) m in the frame of the mesh.
    joint: (B,) joint whose weight a segment feeds.
    """

    start: Array
    end: Array
    joint: NDArray[np.int64]


# Segments of a human body: joint, start and end, each a mean of joints and landmarks. Next to the bones proper: ribs
# (the chest is wide, and with the spine alone the collar bones would carry its front), jaw and ears (the head's joint
# lies level with the nose, and with the skull alone the neck would carry the face), and no heat from the inner half of
# the collar bones, which lies on the chest.
_HUMAN: tuple[tuple[str, tuple[str, ...], tuple[str, ...]], ...] = (
    ("pelvis", ("pelvis",), ("spine",)),
    ("spine", ("spine",), ("chest",)),
    ("chest", ("chest",), ("neck",)),
    ("neck", ("neck",), ("head",)),
    ("head", ("head",), ("head_top",)),
    ("head", ("head",), ("nose",)),
    ("head", ("head",), ("nose", "nose", "neck")),
    *(
        row
        for s in ("left", "right")
        for row in (
            ("pelvis", ("pelvis",), (f"{s}_hip",)),
            ("chest", ("chest", "neck"), ("chest", f"{s}_shoulder")),
            ("head", ("head",), (f"{s}_ear", "head")),
            (f"{s}_clavicle", (f"{s}_clavicle", f"{s}_shoulder"), (f"{s}_shoulder",)),
            (f"{s}_shoulder", (f"{s}_shoulder",), (f"{s}_elbow",)),
            (f"{s}_elbow", (f"{s}_elbow",), (f"{s}_wrist",)),
            (f"{s}_wrist", (f"{s}_wrist",), (f"{s}_knuckle",)),
            (f"{s}_wrist", (f"{s}_wrist",), (f"{s}_thumb_tip",)),
            (f"{s}_hip", (f"{s}_hip",), (f"{s}_knee",)),
            (f"{s}_knee", (f"{s}_knee",), (f"{s}_ankle",)),
            (f"{s}_ankle", (f"{s}_ankle",), (f"{s}_big_toe",)),
            (f"{s}_ankle", (f"{s}_ankle",), (f"{s}_heel",)),
        )
    ),
)


def body_bones(body: Body, pose: ArrayLike | None = None) -> Bones:
    """Make the line segments (bones) of a human body in a pose (D,), in the world; pose None: at rest, in the model
    frame.

    Raises: InputError where the body lacks a joint or a landmark of the human body.
    """
    s, marks = body.skeleton, body.landmarks
    if pose is None:
        joints, points = s.rest_joints, s.rest_joints[marks.joint] + marks.offset
    else:
        joints, points = body.joints(pose), body.landmark_points(pose)

    def middle(names: tuple[str, ...]) -> Array:
        return np.mean([joints[s.joint(n)] if n in s.joint_names else points[marks.index(n)] for n in names], axis=0)

    joint, start, end = zip(*_HUMAN, strict=True)
    first, last = (np.array([middle(names) for names in side]) for side in (start, end))
    return Bones(first, last, np.array([s.joint(name) for name in joint]))


def heat_weights(vertices: ArrayLike, faces: ArrayLike, bones: Bones, n_joints: int) -> Array:
    """Compute dense skinning weights by heat diffusion; the sources are the bones visible from a vertex.

    vertices, faces: (V, 3) m and (F, 3) of one surface.
    bones: segments that emit heat, in the frame of the mesh.
    n_joints: number J of joints.
    Returns: (V, J), not negative, rows sum to 1.
    Raises: InputError where the mesh has no face, or a vertex without face.
    """
    library = extra("robust_laplacian", "A mesh of a person", "mesh", "robust-laplacian")
    v = np.ascontiguousarray(vertices, dtype=np.float64)
    f = np.ascontiguousarray(faces, dtype=np.int64)
    unused = len(v) - len(np.unique(f))
    if not len(f) or unused:
        raise InputError(f"{unused} of the mesh's {len(v)} vertices belong to no face; remove them before rigging.")
    along, rel = bones.end - bones.start, v[:, None] - bones.start
    share = np.clip((rel * along).sum(-1) / np.maximum((along * along).sum(-1), 1e-18), 0, 1)
    closest = bones.start + share[..., None] * along
    distance = np.linalg.norm(v[:, None] - closest, axis=-1)
    near = nearest_visible(v, f, vertex_normals(v, f), closest, distance)
    near = _warm_every_part(near, distance, f)
    source = np.zeros((len(v), n_joints))
    np.add.at(source.T, bones.joint, near.T.astype(np.float64))
    share = (source > 0).astype(np.float64)
    count = share.sum(1)
    nearest = np.where(near, distance, np.inf).min(1)
    # a bone that touches the skin would be an infinite source
    floor = 1e-3 * float(np.ptp(v, axis=0).max())
    strength = np.where(count > 0, count * HEAT / np.maximum(np.where(count > 0, nearest, 1.0), floor) ** 2, 0.0)
    stiffness, mass = library.mesh_laplacian(v, f)
    pull = strength * mass.diagonal()
    right = pull[:, None] * share / np.maximum(count, 1)[:, None]
    weights = np.asarray(splu(csc_matrix(stiffness + diags(pull))).solve(right))
    weights = np.clip(weights, 0.0, None)
    return weights / weights.sum(1, keepdims=True)


def influences(weights: ArrayLike) -> tuple[NDArray[np.int32], Array]:
    """Keep the four largest weights of each vertex.

    weights: (V, J) dense.
    Returns: joints (V, 4) and weights (V, 4), descending, sum 1, unused 0.
    """
    w = np.asarray(weights, dtype=np.float64)
    keep = min(4, w.shape[1])
    index = np.zeros((len(w), 4), dtype=np.int32)
    value = np.zeros((len(w), 4))
    index[:, :keep] = np.argsort(-w, axis=1, kind="stable")[:, :keep]
    value[:, :keep] = np.take_along_axis(w, index[:, :keep].astype(np.int64), 1)
    value[:, 1:] = np.where(value[:, 1:] < _SMALLEST, 0.0, value[:, 1:])
    return np.where(value > 0, index, 0).astype(np.int32), value / value.sum(1, keepdims=True)


def carried_weights(
    points: ArrayLike, normals: ArrayLike, vertices: ArrayLike, faces: ArrayLike, weights: ArrayLike
) -> Array:
    """Transfer skinning weights from a mesh to points near its surface.

    points, normals: (P, 3) m and (P, 3) outward normals.
    vertices, faces, weights: (V, 3) m, (F, 3) and (V, J) dense weights of the mesh.
    Returns: (P, J), the mean over the nearest places of the mesh that face the same way, so that a hand next to a thigh
        does not get the thigh's weights.
    """
    v, w = np.asarray(vertices, dtype=np.float64), np.asarray(weights, dtype=np.float64)
    f = np.asarray(faces, dtype=np.int64)
    p, n = np.asarray(points, dtype=np.float64), np.asarray(normals, dtype=np.float64)
    corner = np.array([(4, 1, 1), (1, 4, 1), (1, 1, 4), (2, 2, 2)]) / 6
    samples = np.einsum("sc,fcd->fsd", corner, v[f]).reshape(-1, 3)
    facing = vertex_normals(v, f)[f].mean(1)
    distance, index = (np.asarray(a) for a in KDTree(samples).query(p, k=min(24, len(samples))))
    face, bary = index // len(corner), corner[index % len(corner)]
    alike = np.einsum("psd,pd->ps", facing[face], n) > 0.3
    alike[~alike.any(1)] = True
    # the nearest three of those
    alike &= np.cumsum(alike, axis=1) <= 3
    share = np.where(alike, 1.0 / np.maximum(distance, 1e-6) ** 2, 0.0)
    share /= share.sum(1, keepdims=True)
    row, column = np.nonzero(alike)
    value = np.einsum("kc,kcj->kj", bary[row, column], w[f[face[row, column]]]) * share[row, column][:, None]
    out = np.zeros((len(p), w.shape[1]))
    np.add.at(out, row, value)
    return out


def vertex_normals(vertices: Array, faces: NDArray[np.integer]) -> Array:
    """Compute unit outward normals (V, 3) of vertices (V, 3), weighted by the areas of the faces (F, 3)."""
    flat, rows = faces.ravel(), np.repeat(_across(vertices, faces), 3, axis=0)
    out = np.stack([np.bincount(flat, rows[:, k], len(vertices)) for k in range(3)], 1)
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12)


def _warm_every_part(near: NDArray[np.bool_], distance: Array, faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Make the nearest bone a source of heat for connected parts of the mesh in which no vertex sees a bone.

    near: (V, B) whether a bone is a source for a vertex.
    distance: (V, B) m.
    faces: (F, 3).
    Returns: (V, B).
    """
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    n = len(near)
    _, part = connected_components(coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n, n)))
    cold = ~(np.bincount(part, near.any(1)) > 0)[part]
    if not cold.any():
        return near
    out = near.copy()
    out[cold] = distance[cold] <= 1.0001 * distance[cold].min(1, keepdims=True)
    return out


# ---- coarse mesh ---------------------------------------------------------------------------------------------------
# Make a coarse closed mesh of 450-600 vertices, for scoring silhouettes, from any closed mesh.
#
# Quadric decimation alone cuts convex corners, so that the silhouettes would be too thin. The decimated mesh is
# therefore fitted to samples of the surface (linear least squares on signed distances along the vertex normals), and
# then given the volume of the original.
# Source: Garland & Heckbert 1997 (fast-simplification).


Faces = NDArray[np.int32]
# which aggressiveness keeps the mesh a closed manifold depends on the shape
_AGGRESSIVENESS = (5, 6, 4, 7, 3, 8)


def decimated(vertices: ArrayLike, faces: ArrayLike, target: int) -> tuple[Array, Faces]:
    """Decimate a closed manifold mesh to about `target` vertices.

    vertices, faces: (V, 3) m and (F, 3).
    Returns: vertices and faces of a closed manifold; the mesh itself where it has no more vertices than that.
    Raises: InputError where no closed mesh of that size can be made.
    """
    library = extra("fast_simplification", "A mesh of a person", "mesh", "fast-simplification")
    v = np.ascontiguousarray(vertices, dtype=np.float64)
    f = np.ascontiguousarray(faces, dtype=np.int32)
    if len(v) <= target:
        return v, f
    # the library works in float32: about the origin it keeps micrometres
    centre = v.mean(0)
    # a noisy scan folds over itself where its triangles are smaller than the noise: smoothing undoes that
    for passes in (0, 3, 10, 30):
        smooth = _smoothed(v - centre, f, passes)
        for wanted in (target, int(0.93 * target), int(1.06 * target)):
            for aggressiveness in _AGGRESSIVENESS:
                w, g, *_ = library.simplify(smooth, f, target_count=2 * wanted, agg=aggressiveness)
                kept, index = np.unique(np.asarray(g, dtype=np.int32), return_inverse=True)
                w, g = (np.asarray(w, dtype=np.float64) + centre)[kept], index.reshape(-1, 3).astype(np.int32)
                sound = ((g[:, 0] != g[:, 1]) & (g[:, 1] != g[:, 2]) & (g[:, 2] != g[:, 0])).all()
                if len(g) and abs(len(w) - target) <= 0.1 * target and sound and is_closed(g):
                    return w, g
    raise InputError(
        f"No closed mesh of about {target} vertices could be made from this one ({len(v)} vertices); remesh the "
        "scan evenly (Blender: Remesh modifier, voxel size 1 cm) and try again."
    )


def coarse_mesh(vertices: ArrayLike, faces: ArrayLike, target: int = 550) -> tuple[Array, Faces]:
    """Make a coarse mesh for scoring silhouettes: it keeps the volume and, on average, the surface of the original.

    vertices, faces: (V, 3) m and (F, 3) of a closed manifold whose faces are oriented outwards.
    target: approximate number of vertices.
    Returns: vertices and faces of a closed manifold; the mesh itself where it has no more vertices than that.
    Raises: InputError where no closed mesh of that size can be made.
    """
    v = np.asarray(vertices, dtype=np.float64)
    f = np.asarray(faces, dtype=np.int32)
    out, g = decimated(v, f, target)
    if len(out) == len(v):
        return out, g
    corners = v[f]
    samples = np.concatenate([v, corners.mean(1), *(0.5 * (corners[:, k] + corners[:, k - 1]) for k in range(3))])
    if len(samples) > 20_000:  # vertices and faces of a scan come in no useful order, so a stride is an even choice
        samples = samples[:: len(samples) // 20_000 + 1]
    out = _fitted(out, g, samples)
    volume = enclosed_volume(v, f)
    for _ in range(4):
        area = 0.5 * np.linalg.norm(_across(out, g), axis=1).sum()
        out = out + (volume - enclosed_volume(out, g)) / area * vertex_normals(out, g)
    return out, g


def is_closed(faces: ArrayLike) -> bool:
    """Return whether every edge belongs to two faces that run through it in opposite directions."""
    f = np.asarray(faces, dtype=np.int64)
    edges = np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]])
    n = int(f.max()) + 1
    forward, backward = np.unique(edges @ [n, 1]), np.unique(edges @ [1, n])
    return len(forward) == len(edges) and np.array_equal(forward, backward)


def _smoothed(v: Array, f: Faces, passes: int) -> Array:
    """Smooth a mesh without shrinking it (Taubin 1995): every pass moves vertices towards the mean of their neighbours,
    then a little more back.

    v, f: vertices (V, 3), m, and faces (F, 3).
    passes: number of passes.
    Returns: (V, 3) m.
    """
    edges = np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]])
    n = len(v)
    near = csc_matrix(coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n, n)))
    degree = np.maximum(np.asarray(near.sum(1)), 1.0).reshape(-1, 1)
    out = v
    for step in (0.5, -0.53) * passes:
        out = out + step * (near @ out / degree - out)
    return out


def _fitted(v: Array, f: Faces, samples: Array, rounds: int = 3) -> Array:
    """Move vertices along their normals until the mesh runs through the middle of surface samples.

    v, f: vertices (V, 3), m, and faces (F, 3).
    samples: (S, 3) m.
    rounds: number of least-squares solves.
    Returns: (V, 3) m.
    """
    k = 5
    corner = np.array([(i, j, k - i - j) for i in range(k + 1) for j in range(k + 1 - i)]) / k
    size = float(np.ptp(v, axis=0).max())
    out = v
    for _ in range(rounds):
        points = np.einsum("sc,fcd->fsd", corner, out[f]).reshape(-1, 3)
        gap, nearest = KDTree(points).query(samples)
        face, bary = nearest // len(corner), corner[nearest % len(corner)]
        normal = vertex_normals(out, f)
        across = _across(out, f)
        n = (across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-15))[face]
        signed = ((samples - points[nearest]) * n).sum(1)
        keep = gap < 0.02 * size
        entries = bary * np.einsum("sd,scd->sc", n, normal[f[face]])
        rows = np.repeat(np.arange(int(keep.sum())), 3)
        a = csc_matrix(
            coo_matrix((entries[keep].ravel(), (rows, f[face][keep].ravel())), shape=(int(keep.sum()), len(out)))
        )
        lhs = a.T @ a + identity(len(out), format="csc") * (0.2 * len(samples) / len(out))
        step = np.asarray(spsolve(csc_matrix(lhs), a.T @ signed[keep]))
        out = out + np.clip(0.8 * step, -0.01 * size, 0.01 * size)[:, None] * normal
    return out


def _across(v: Array, f: NDArray[np.integer]) -> Array:
    """Compute the outward normals (F, 3) of faces, as long as twice their area."""
    return np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
