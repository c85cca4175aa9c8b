"""Meshes of people: OBJ, PLY, STL, OFF and GLB files; skinned GLB and SMPL-format .npz with their weights and joints.

Only geometry is read: no materials, textures or other files that the mesh refers to. Nothing is unpickled.
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import enclosed_volume
from hypose.body.joint_names import SMPL_JOINTS
from hypose.errors import InputError, extra
from hypose.geometry import Array
from hypose.io.files import read_bytes
from hypose.io.motions.results import parse_array

MAX_MESH_BYTES = 512 * 2**20
MAX_FACES = 3_000_000
MIN_VERTICES = 100
_TRIMESH = {".obj": "obj", ".ply": "ply", ".stl": "stl", ".glb": "glb", ".off": "off"}
MESH_ENDINGS = (*_TRIMESH, ".npz")
_KIND = "a mesh (" + ", ".join(MESH_ENDINGS) + ")"


@dataclass(frozen=True)
class Rig:
    """Joints and skinning weights of a mesh.

    names: n joint names.
    parents: (n,) index of each joint's parent; -1 for none.
    joints: (n, 3) joint centres in the units of the file.
    weights: (V, n) share of each joint in the movement of each vertex.
    """

    names: tuple[str, ...]
    parents: NDArray[np.int64]
    joints: Array
    weights: Array


@dataclass(frozen=True)
class PersonMesh:
    """The surface of a person as read from a file.

    vertices: (V, 3) in the units and axes of the file.
    faces: (F, 3).
    rig: joints and weights of a skinned file.
    up: the up axis that the format prescribes; empty where it prescribes none.
    source: name of the mesh in error messages.
    notes: sentences about changes that were made to it.
    """

    vertices: Array
    faces: NDArray[np.int32]
    rig: Rig | None = None
    up: str = ""
    source: str = "The mesh"
    notes: tuple[str, ...] = field(default=())


def read_person(path: str | Path) -> PersonMesh:
    """Read the mesh of a person from any of the supported formats.

    Raises: InputError where the file does not exist, is damaged, is too large or holds no mesh.
    """
    p = Path(path)
    ending = p.suffix.lower()
    if ending == ".pkl":
        raise InputError(f"{p} is a pickle, which may run any program when read; save the model as .npz instead.")
    if ending == ".gltf":
        raise InputError(f"{p}: a .gltf names other files; export it as one .glb instead.")
    if ending not in MESH_ENDINGS:
        raise InputError(f"{p} is not {_KIND}; export the scan in one of these formats.")
    data = read_bytes(p, _KIND, MAX_MESH_BYTES)
    if ending == ".npz":
        return _read_smpl(p, data)
    if ending == ".glb":
        from hypose.io.motions.gltf import read_skin

        skinned = read_skin(data, str(p))
        if skinned is not None:
            vertices, faces, names, parents, joints, weights = skinned
            return _checked(PersonMesh(vertices, faces, Rig(names, parents, joints, weights), "+y", str(p)))
    vertices, faces = _read_geometry(p, data, _TRIMESH[ending])
    return _checked(PersonMesh(vertices, faces, None, "+y" if ending == ".glb" else "", str(p)))


def _read_geometry(path: Path, data: bytes, kind: str) -> tuple[Array, NDArray[np.int32]]:
    trimesh = extra("trimesh", "A mesh of a person", "mesh")
    try:
        # from memory and without a resolver, so that no file or address named inside is opened
        scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False, skip_materials=True)
        mesh = scene.to_mesh()
        vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as error:  # noqa: BLE001 - the readers of five formats raise what they like on damaged files
        reason = str(error).split("\n")[0][:120] or type(error).__name__
        raise InputError(f"{path} cannot be read as {kind.upper()} ({reason}); export the scan again.") from None
    return vertices, faces.astype(np.int32)


def _read_smpl(path: Path, data: bytes) -> PersonMesh:
    """Read a body model in SMPL's format from the content of an .npz file, in its rest pose and mean shape.

    Raises: InputError where it is not such a model.
    """
    names = ("v_template", "f", "weights", "J_regressor", "kintree_table")
    arrays: dict[str, np.ndarray] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for name in names:
                info = archive.getinfo(f"{name}.npy")
                if info.file_size > MAX_MESH_BYTES:
                    raise ValueError(f"{name} has {info.file_size / 2**20:.0f} MiB")
                with archive.open(info) as stream:
                    arrays[name] = parse_array(name, stream, info.file_size)
        v = arrays["v_template"].astype(np.float64).reshape(-1, 3)
        f = arrays["f"].astype(np.int64).reshape(-1, 3)
        w, regressor = arrays["weights"].astype(np.float64), arrays["J_regressor"].astype(np.float64)
        parents = arrays["kintree_table"].astype(np.float64)[0]
        n = w.shape[1]
        if w.shape != (len(v), n) or regressor.shape != (n, len(v)) or parents.shape != (n,) or n < len(SMPL_JOINTS):
            shapes = ", ".join(f"{k} {a.shape}" for k, a in arrays.items())
            raise ValueError(f"the shapes {shapes} do not belong to one model of at least {len(SMPL_JOINTS)} joints")
    except (KeyError, ValueError, IndexError, TypeError, zipfile.BadZipFile, OSError, EOFError) as error:
        reason = f"{error} is missing" if isinstance(error, KeyError) else error
        raise InputError(
            f"{path} is not an SMPL-format model ({reason}); save {', '.join(names)} as plain numbers with numpy.savez "
            "(J_regressor.toarray() if it is sparse)."
        ) from None
    # the root's parent is -1, or 2^32 - 1 where it was stored unsigned
    tree = np.where((parents >= 0) & (parents < n), parents, -1).astype(np.int64)
    joint_names = SMPL_JOINTS + tuple(f"extra_{k}" for k in range(len(SMPL_JOINTS), n))
    rig = Rig(joint_names, tree, regressor @ v, w)
    return _checked(PersonMesh(v, f.astype(np.int32), rig, "", str(path)))


def _checked(mesh: PersonMesh) -> PersonMesh:
    """Check the size and the numbers of a mesh, and return it.

    Raises: InputError where it is no surface, too coarse, too large, or has indices or numbers that cannot be.
    """
    v, f, source = mesh.vertices, mesh.faces.astype(np.int64), mesh.source
    if len(v) < MIN_VERTICES or len(f) < MIN_VERTICES:
        kind = "a point cloud" if len(v) >= MIN_VERTICES else "too coarse"
        raise InputError(
            f"{source} has {len(v)} vertices and {len(f)} faces and is {kind}; a person needs a surface of at least "
            f"{MIN_VERTICES} vertices and faces: export the scan as a mesh."
        )
    if len(f) > MAX_FACES:
        raise InputError(f"{source} has {len(f)} faces, at most {MAX_FACES} are read; decimate the scan first.")
    if not np.isfinite(v).all():
        bad = int((~np.isfinite(v).all(1)).sum())
        raise InputError(f"{source} has {bad} vertices that are not finite; repair the scan and export it again.")
    if f.min() < 0 or f.max() >= len(v):
        raise InputError(f"{source} has {len(v)} vertices but a face refers to vertex {int(f.max())}; export it again.")
    if mesh.rig is not None and not (np.isfinite(mesh.rig.weights).all() and np.isfinite(mesh.rig.joints).all()):
        raise InputError(f"{source}: its joints or weights are not finite; export it again.")
    return mesh


def closed_surface(mesh: PersonMesh) -> PersonMesh:
    """Repair a mesh so that it is one closed manifold whose faces point outward.

    Equal vertices are merged, specks are removed and small holes are closed; the notes say so.

    Raises: InputError for large holes, several parts or edges with more than two faces.
    """
    v, f = mesh.vertices, mesh.faces.astype(np.int64)
    notes = list(mesh.notes)
    keep, index = _merged(v)
    f = index[f]
    f = f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]
    if not len(f):
        raise InputError(f"{mesh.source} has no triangle with three different corners; export it again.")
    f = f[np.unique(np.sort(f, 1), axis=0, return_index=True)[1]]
    f, note = _main_part(v[keep], f, mesh.source)
    vertices, f, added, more = _holes_closed(v[keep], _same_turn(f, mesh.source), mesh.source)
    notes += [*note, *more]
    used, f = np.unique(f, return_inverse=True)
    f = f.reshape(-1, 3)
    vertices, source = vertices[used], np.concatenate([keep, keep[added]])[used]
    if enclosed_volume(vertices, f) < 0:
        f = f[:, ::-1]
        notes.append("its faces looked inward and were turned")
    rig = None if mesh.rig is None else replace(mesh.rig, weights=mesh.rig.weights[source])
    return replace(mesh, vertices=vertices, faces=f.astype(np.int32), rig=rig, notes=tuple(notes))


def _merged(v: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Merge equal vertices, which formats with normals or textures split and STL repeats per face.

    Returns: index of the first of each group of equal vertices, and for each vertex the index of its group.
    """
    grid = np.round((v - v.min(0)) / max(float(np.ptp(v, axis=0).max()), 1e-30) * 2**22).astype(np.int64)
    _, first, index = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    return first, index.reshape(-1)


def _main_part(v: Array, f: NDArray[np.int64], source: str) -> tuple[NDArray[np.int64], list[str]]:
    """Keep the faces of the one part that is a person; specks below 2 % of the surface are removed.

    v: (V, 3) vertices.
    f: (F, 3) faces.
    source: name of the mesh in error messages.
    Returns: the faces that are kept, and notes.
    Raises: InputError where there are several parts.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    edges = np.concatenate([f[:, [0, 1]], f[:, [1, 2]]])
    _, part = connected_components(
        coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(v), len(v)))
    )
    area = np.linalg.norm(np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]]), axis=1)
    share = np.bincount(part[f[:, 0]], area)
    share = share / max(share.sum(), 1e-30)
    large = np.flatnonzero(share > 0.02)
    if len(large) != 1:
        sizes = ", ".join(f"{100 * s:.0f} %" for s in sorted(share[large], reverse=True)[:6])
        raise InputError(
            f"{source} consists of {len(large)} parts ({sizes} of its surface); one closed surface is needed: keep the "
            "person alone, or join the parts (Blender: Remesh modifier, voxel size 1 cm)."
        )
    kept = f[part[f[:, 0]] == large[0]]
    specks = int((np.bincount(part[f[:, 0]]) > 0).sum()) - 1
    return kept, [f"{specks} small loose parts were left out"] if specks else []


def _same_turn(f: NDArray[np.int64], source: str) -> NDArray[np.int64]:
    """Orient all faces the same way, each as its neighbours.

    Raises: InputError where edges have more than two faces or no common orientation exists.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    n = int(f.max()) + 1
    edges = np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]])
    key = edges.min(1) * n + edges.max(1)
    _, count = np.unique(key, return_counts=True)
    if (count > 2).any():
        raise InputError(
            f"{source} is not a manifold: {int((count > 2).sum())} edges belong to three or more faces; remesh the "
            "scan (Blender: Remesh modifier, or Mesh > Clean Up > Merge by Distance)."
        )
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order]) == 0)
    one, other = order[first], order[first + 1]  # the two sides of each edge
    same = edges[one, 0] == edges[other, 0]
    if not same.any():
        return f
    # every face is in the graph twice, as it is and reversed (+ count); consistent neighbours are connected
    count = len(f)
    a, b = one % count, other % count + count * same
    a, b = np.concatenate([a, a + count]), np.concatenate([b, (b + count) % (2 * count)])
    _, part = connected_components(coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(2 * count, 2 * count)))
    if (part[:count] == part[count:]).any():
        raise InputError(f"{source} has no inside and outside (its faces cannot all turn one way); remesh the scan.")
    turned = part[:count] > part[count:]
    return np.where(turned[:, None], f[:, ::-1], f)


def _holes_closed(
    v: Array, f: NDArray[np.int64], source: str
) -> tuple[Array, NDArray[np.int64], NDArray[np.int64], list[str]]:
    """Close small holes with a fan of triangles around their centre.

    A hole is small when its rim is at most a quarter of the mesh's largest extent long.

    v: (V, 3) vertices.
    f: (F, 3) faces, all turned the same way.
    source: name of the mesh in error messages.
    Returns: vertices, faces, for each new vertex the index of a vertex whose weights it takes, and notes.
    Raises: InputError for larger holes.
    """
    n = int(f.max()) + 1
    edges = np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]])
    open_edges = edges[~np.isin(edges @ [n, 1], edges @ [1, n])]
    if not len(open_edges):
        return v, f, np.zeros(0, np.int64), []
    loops = _loops(open_edges)
    size = float(np.ptp(v[np.unique(f)], axis=0).max())
    lengths = [float(np.linalg.norm(v[x] - v[np.roll(x, 1)], axis=1).sum()) for x in loops or []]
    if loops is None or max(lengths) > 0.25 * size:
        holes = (
            "" if loops is None else f" around {len(loops)} holes, the largest {max(lengths) / size:.0%} of its height"
        )
        raise InputError(
            f"{source} is not closed: {len(open_edges)} edges have one face only{holes}; close the scan (MeshLab: "
            "Screened Poisson; Blender: Remesh modifier with voxel size 1 cm) and try again."
        )
    rows = [
        (len(v) + n, int(b), int(a))
        for n, loop in enumerate(loops)
        for a, b in zip(loop, np.roll(loop, -1), strict=True)
    ]
    return (
        np.concatenate([v, np.array([v[loop].mean(0) for loop in loops])]),
        np.concatenate([f, np.array(rows, dtype=np.int64)]),
        np.array([loop[0] for loop in loops], dtype=np.int64),
        [f"{len(loops)} small holes were closed"],
    )


def _loops(open_edges: NDArray[np.int64]) -> list[NDArray[np.int64]] | None:
    """Order the edges of the holes into rings of vertices; None where two rims have a common vertex."""
    after = dict(open_edges.tolist())
    if len(after) < len(open_edges):
        return None
    out = []
    while after:
        ring = [next(iter(after))]
        while (k := after.pop(ring[-1], None)) not in (None, ring[0]):
            ring.append(k)
        if k is None:
            return None
        out.append(np.array(ring, dtype=np.int64))
    return out
