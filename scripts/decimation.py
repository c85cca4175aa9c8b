"""Symmetric quadric decimation of closed meshes that stay closed manifolds, and the fit of a coarse mesh to a fine one.

Only the left half (x >= 0) is decimated: vertices in the plane x = 0 stay in it, and by symmetry their quadrics need
no extra boundary term; the mirror image is welded on at the end. Garland & Heckbert, "Surface simplification using
quadric error metrics", SIGGRAPH 1997, with the link condition of Dey et al. 1999, an importance per vertex (few
triangles in hands, feet and face) and optionally only vertices of the input (so that one topology serves many shapes).
"""

from __future__ import annotations

import heapq
import math

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix, identity
from scipy.sparse.linalg import spsolve
from scipy.spatial import KDTree

NEEDLE = 0.1
"""A collapse may not make a face worse when its double area over its longest side squared falls below this
(halved whenever nothing else can be collapsed)."""
EVENNESS = 1e-3
"""Share of an edge's squared length in the cost of its collapse: flat regions stay evenly meshed."""


def left_half(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices (H,) of the vertices with x >= 0 and the faces (G,3) into them of an exactly symmetric mesh none of
    whose faces crosses x = 0."""
    left = faces[(vertices[faces][..., 0] > 0).any(1)]
    kept = np.unique(left)
    if (vertices[kept, 0] < 0).any():
        raise ValueError("a face crosses the plane x = 0: the mesh is not mirrored about it")
    index = np.full(len(vertices), -1)
    index[kept] = np.arange(len(kept))
    return kept, index[left]


def mirrored(half: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The closed mesh (V,3), (F,3) of a left half (H,3), (G,3) and its mirror image; and for each vertex the index of
    its mirror image (V,). The first H vertices are the half's."""
    middle = half[:, 0] == 0
    other = np.where(middle, np.arange(len(half)), len(half) + np.cumsum(~middle) - 1)
    vertices = np.concatenate([half, half[~middle] * [-1, 1, 1]])
    mirror = np.concatenate([other, np.flatnonzero(~middle)])
    return vertices, np.concatenate([faces, other[faces][:, ::-1]]), mirror


class _Half:
    """Mutable half mesh under collapse."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, importance: np.ndarray, subset: bool) -> None:
        self.at: list[list[float]] = vertices.tolist()
        self.faces: list[tuple[int, int, int] | None] = [tuple(map(int, f)) for f in faces]  # type: ignore[misc]
        self.around: list[set[int]] = [set() for _ in vertices]
        for k, f in enumerate(faces):
            for v in f:
                self.around[v].add(k)
        self.middle = vertices[:, 0] == 0
        self.subset = subset
        self.needle = NEEDLE
        corners = vertices[faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(normal, axis=1)
        normal /= np.maximum(area, 1e-15)[:, None]
        area *= importance[faces].mean(1) * 0.5
        plane = np.concatenate([normal, -(normal * corners[:, 0]).sum(1)[:, None]], 1)
        per_face = area[:, None, None] * plane[:, :, None] * plane[:, None, :]
        self.quadric = np.zeros((len(vertices), 4, 4))
        self.weight = np.zeros(len(vertices))
        for c in range(3):
            np.add.at(self.quadric, faces[:, c], per_face)
            np.add.at(self.weight, faces[:, c], area)

    def neighbours(self, v: int) -> set[int]:
        out: set[int] = set()
        for k in self.around[v]:
            out.update(self.faces[k])  # type: ignore[arg-type]
        out.discard(v)
        return out

    def candidate(self, u: int, v: int) -> tuple[float, np.ndarray]:
        """Cost and place of merging u and v."""
        q = self.quadric[u] + self.quadric[v]
        a, b = np.array(self.at[u]), np.array(self.at[v])
        if self.subset:
            places = [p for p, w in ((a, u), (b, v)) if self.middle[w] or not (self.middle[u] or self.middle[v])]
        else:
            mid = 0.5 * (a + b)
            free = [1, 2] if self.middle[u] or self.middle[v] else [0, 1, 2]
            mid[0] *= len(free) == 3
            small = 3e-3 * np.trace(q[:3, :3]) + 1e-12
            m = q[np.ix_(free, free)] + small * np.eye(len(free))
            p = mid.copy()
            p[free] = np.linalg.solve(m, small * mid[free] - q[free, 3])
            far = (p - mid) @ (p - mid) > (a - b) @ (a - b)  # the planes are nearly parallel: no spike
            places = [mid if far else p]
        cost, best = np.inf, places[0]
        for p in places:
            h = np.array([p[0], p[1], p[2], 1.0])
            c = float(h @ q @ h)
            if c < cost:
                cost, best = c, p
        # a little of the edge's length keeps flat regions evenly meshed
        length = (a - b) @ (a - b)
        return max(cost, 0.0) + EVENNESS * (self.weight[u] + self.weight[v]) * length, best

    def allowed(self, u: int, v: int, place: np.ndarray, needle: float) -> bool:
        """Link condition, no chord across the symmetry plane, no flipped or needle-shaped face."""
        shared = self.around[u] & self.around[v]
        near_u, near_v = self.neighbours(u), self.neighbours(v)
        if len(near_u & near_v) != len(shared) or not shared:
            return False
        both = self.middle[u] and self.middle[v]
        if len(shared) != (1 if both else 2):
            return False
        merged_middle = self.middle[u] or self.middle[v]
        if merged_middle:
            rim = sum(self.middle[w] for w in (near_u | near_v) - {u, v})
            if rim != 2:
                return False
        elif place[0] <= 1e-4:
            return False
        if len(near_u | near_v) - 2 < 3:
            return False
        for w in near_u & near_v:  # their valence falls by one
            if len(self.around[w]) - 1 < (2 if self.middle[w] else 3):
                return False
        at, target = self.at, place.tolist()
        for k in (self.around[u] | self.around[v]) - shared:
            f = self.faces[k]
            assert f is not None
            n0, shape0 = _normal_and_shape([at[w] for w in f])
            n1, shape1 = _normal_and_shape([target if w in (u, v) else at[w] for w in f])
            if shape1 < needle and shape1 < shape0:
                return False
            # the normal of a needle says nothing about a flip
            if shape0 > 0.05 and n0[0] * n1[0] + n0[1] * n1[1] + n0[2] * n1[2] < 0.25:
                return False
        return True

    def collapse(self, u: int, v: int, place: np.ndarray) -> None:
        """Merge v into u at place."""
        for k in self.around[u] & self.around[v]:
            for w in self.faces[k]:  # type: ignore[union-attr]
                if w not in (u, v):
                    self.around[w].discard(k)
            self.around[u].discard(k)
            self.around[v].discard(k)
            self.faces[k] = None
        for k in self.around[v]:
            self.faces[k] = tuple(u if w == v else w for w in self.faces[k])  # type: ignore[assignment,union-attr]
            self.around[u].add(k)
        self.around[v] = set()
        self.at[u] = place.tolist()
        self.middle[u] |= self.middle[v]
        if self.middle[u]:
            self.at[u][0] = 0.0
        self.quadric[u] += self.quadric[v]
        self.weight[u] += self.weight[v]


def _normal_and_shape(p: list[list[float]]) -> tuple[tuple[float, float, float], float]:
    """Unit normal of a triangle and its double area over the square of its longest side (0.87 when equilateral)."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = p
    ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    double = math.sqrt(x * x + y * y + z * z) + 1e-30
    wx, wy, wz = vx - ux, vy - uy, vz - uz
    longest = max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz)
    return (x / double, y / double, z / double), double / (longest + 1e-30)


def decimate_half(
    vertices: np.ndarray,
    faces: np.ndarray,
    target: int,
    importance: np.ndarray,
    subset: bool = False,
    shortest: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Decimate a left half (H,3), (G,3) until the whole mesh has about `target` vertices.

    importance (H,) multiplies the squared error of the faces around a vertex. With subset=True the result uses only
    vertices of the input. Edges shorter than `shortest` (m) go first, whatever the error: that clears the needles of
    marching cubes, which would block better collapses later.

    Returns vertices (h,3), faces (g,3) and source (h,): the input vertex each one grew from (with subset=True the very
    vertex).
    """
    mesh = _Half(vertices, faces, importance, subset)
    source = np.arange(len(vertices))
    stamp = np.zeros(len(vertices), int)
    heap: list[tuple[float, int, int, int, int]] = []
    refused: dict[int, set[int]] = {}  # edges to try again when the faces around them have changed

    def push(u: int, v: int) -> None:
        u, v = min(u, v), max(u, v)
        length = math.dist(mesh.at[u], mesh.at[v])
        cost = mesh.candidate(u, v)[0] if length >= shortest else length - shortest
        heapq.heappush(heap, (cost, u, v, int(stamp[u]), int(stamp[v])))

    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1), axis=0)
    for u, v in edges.tolist():
        push(u, v)
    middles = int(mesh.middle.sum())
    count = 2 * (len(vertices) - middles) + middles
    while count > target:
        if not heap:  # only refused edges are left: be less choosy about the shape of faces
            mesh.needle *= 0.5
            for u in sorted(refused):
                for v in sorted(refused[u] & mesh.neighbours(u)):
                    if u < v:
                        push(u, v)
            refused.clear()
            if not heap or mesh.needle < 1e-4:
                break
        cost, u, v, su, sv = heapq.heappop(heap)
        if stamp[u] != su or stamp[v] != sv or not mesh.around[u] or not mesh.around[v]:
            continue
        place = mesh.candidate(u, v)[1]
        if not mesh.allowed(u, v, place, mesh.needle if cost >= 0 else 0.0):
            refused.setdefault(u, set()).add(v)
            refused.setdefault(v, set()).add(u)
            continue
        count -= 1 if mesh.middle[u] and mesh.middle[v] else 2
        nearer = source[u] if math.dist(mesh.at[u], place) <= math.dist(mesh.at[v], place) else source[v]
        mesh.collapse(u, v, place)
        source[u] = nearer
        ring = mesh.neighbours(u)
        stamp[u] += 1
        for w in sorted(ring):
            push(u, w)
        for w in sorted(ring):
            near = refused.pop(w, None)
            if near:
                for x in sorted(near & mesh.neighbours(w) - {u}):
                    refused.get(x, set()).discard(w)
                    push(w, x)
        refused.pop(u, None)
    out = np.array([f for f in mesh.faces if f is not None])
    kept = np.unique(out)
    index = np.full(len(vertices), -1)
    index[kept] = np.arange(len(kept))
    return np.array([mesh.at[i] for i in kept]), index[out], source[kept]


def fit_surface(
    vertices: np.ndarray, faces: np.ndarray, mirror: np.ndarray, samples: np.ndarray, volume: float, rounds: int = 4
) -> np.ndarray:
    """Move the vertices (V,3) of a coarse closed mesh along their normals so that the mesh runs through the middle of
    the dense samples (S,3) of the true surface instead of inside it, and then offset it to enclose `volume` (m^3).
    Linear least squares on the signed distances, with a weak pull to the start; stays symmetric."""
    k = 6
    corner = np.array([(i, j, k - i - j) for i in range(k + 1) for j in range(k + 1 - i)]) / k
    out = vertices.copy()
    for _ in range(rounds):
        points = np.einsum("sc,fcd->fsd", corner, out[faces])
        nearest = KDTree(points.reshape(-1, 3)).query(samples)[1]
        face, bary = nearest // len(corner), corner[nearest % len(corner)]
        normal, face_normal = vertex_normals(out, faces)
        n = face_normal[face]
        signed = ((samples - points.reshape(-1, 3)[nearest]) * n).sum(1)
        keep = np.abs(signed) < 0.03
        entries = bary * np.einsum("sd,scd->sc", n, normal[faces[face]])
        rows = np.repeat(np.flatnonzero(keep), 3)
        a = coo_matrix((entries[keep].ravel(), (rows, faces[face][keep].ravel())), shape=(len(samples), len(out)))
        a = csc_matrix(a)
        lhs = a.T @ a + identity(len(out), format="csc") * (0.15 * len(samples) / len(out))
        step = np.asarray(spsolve(csc_matrix(lhs), a.T @ np.where(keep, signed, 0)))
        out = _symmetric(out + 0.8 * step[:, None] * normal, mirror)
    for _ in range(4):
        normal, face_normal = vertex_normals(out, faces)
        area = 0.5 * np.linalg.norm(_cross(out, faces), axis=1).sum()
        out = _symmetric(out + (volume - enclosed_volume(out, faces)) / area * normal, mirror)
    return out


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit outward normals of vertices (V,3), angle-free area-weighted, and of faces (F,3)."""
    cross = _cross(vertices, faces)
    normal = np.zeros_like(vertices)
    for c in range(3):
        np.add.at(normal, faces[:, c], cross)
    return (
        normal / (np.linalg.norm(normal, axis=1, keepdims=True) + 1e-15),
        cross / (np.linalg.norm(cross, axis=1, keepdims=True) + 1e-15),
    )


def enclosed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Signed volume of a closed mesh, positive when its faces turn outward."""
    a, b, c = np.moveaxis(vertices[faces].astype(float), 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _cross(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    p = vertices[faces]
    return np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])


def _symmetric(vertices: np.ndarray, mirror: np.ndarray) -> np.ndarray:
    return 0.5 * (vertices + vertices[mirror] * [-1, 1, 1])
