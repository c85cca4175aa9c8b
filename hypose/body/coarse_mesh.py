"""Make a coarse closed mesh of 450-600 vertices, for scoring silhouettes, from any closed mesh.

Quadric decimation alone cuts convex corners, so that the silhouettes would be too thin. The decimated mesh is therefore
fitted to samples of the surface (linear least squares on signed distances along the vertex normals), and then given the
volume of the original.
Source: Garland & Heckbert 1997 (fast-simplification).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_matrix, csc_matrix, identity
from scipy.sparse.linalg import spsolve
from scipy.spatial import KDTree

from hypose.body.body import enclosed_volume
from hypose.body.skin_weights import vertex_normals
from hypose.errors import InputError, extra
from hypose.geometry import Array

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


def _across(v: Array, f: Faces) -> Array:
    """Compute the outward normals (F, 3) of faces, as long as twice their area."""
    return np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
