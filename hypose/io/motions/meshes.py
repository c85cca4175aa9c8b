"""Meshes of people: OBJ, PLY, STL, OFF and GLB files; skinned GLB and SMPL-format .npz with their weights and joints.

Only geometry is read: no materials, textures or other files that the mesh refers to. Nothing is unpickled.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.joint_names import SMPL_JOINTS
from hypose.errors import InputError, extra, refuse
from hypose.geometry import Array
from hypose.io.files import numbers_of, read_bytes
from hypose.io.motions.results import Archive
from hypose.json_text import parse_json

MAX_MESH_BYTES = 512 * 2**20
MAX_FACES = 3_000_000
MIN_VERTICES = 100
_TRIMESH = {".obj": "obj", ".ply": "ply", ".stl": "stl", ".glb": "glb", ".off": "off"}
MESH_ENDINGS = (*_TRIMESH, ".npz")
# Widest hole that is closed, as a share of the largest extent; a hand's breadth of a person.
_WIDEST_HOLE = 0.08
_PLAIN = "as plain numbers with numpy.savez (J_regressor.toarray() if it is sparse)"
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
    faults = {
        " is a pickle, which may run any program when read; save the model as .npz instead": ending == ".pkl",
        ": a .gltf names other files; export it as one .glb instead": ending == ".gltf",
        f" is not {_KIND}; export the scan in one of these formats": ending not in MESH_ENDINGS,
    }
    refuse(str(p), faults)
    if ending == ".npz":
        return _read_smpl(p)
    data = read_bytes(p, _KIND, MAX_MESH_BYTES)
    if ending == ".glb":
        skinned = _read_skin(data, str(p))
        if skinned is not None:
            return _checked(skinned)
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


_DTYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_LARGEST = 1e12


def _read_skin(data: bytes, where: str) -> PersonMesh | None:
    """Read the meshes with the first skin of a GLB file, in the mesh's space at bind time.

    data: content of the file.
    where: name of the file in error messages.
    Returns: None without a skinned mesh.
    Raises: InputError where the file is damaged or compressed.
    Source: Khronos glTF 2.0, sections 3.7.3 (skins) and 4.4 (GLB).
    """
    if data[:4] != b"glTF":
        return None
    length = int.from_bytes(data[12:16], "little")
    with numbers_of(f"{where}, read as a skinned GLB,"):
        document, blob = parse_json(data[20 : 20 + length]), data[28 + length :]
        nodes = document.get("nodes", ())
        users = [n for n in nodes if n.get("skin") is not None and n.get("mesh") is not None]
        if not users:
            return None
        skin = document["skins"][users[0]["skin"]]
        own = skin["joints"]
        inverse = _array(document, blob, skin["inverseBindMatrices"]).reshape(len(own), 4, 4).swapaxes(1, 2)
        parent_of = {c: k for k, n in enumerate(nodes) for c in n.get("children", ())}
        place: dict[Any, int] = {node: k for k, node in enumerate(own)}
        parents = []
        for node in own:
            up, steps = parent_of.get(node), 0
            while up is not None and up not in place and steps < len(nodes):
                up, steps = parent_of.get(up), steps + 1
            parents.append(place.get(up, -1))
        points, faces, weights = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], [np.zeros((0, len(own)))]
        users = [u for u in users if u["skin"] == users[0]["skin"]]
        for primitive in (p for u in users for p in document["meshes"][u["mesh"]]["primitives"]):
            attributes = primitive["attributes"]
            if "JOINTS_0" not in attributes or primitive.get("mode", 4) != 4:
                continue
            v = _array(document, blob, attributes["POSITION"])
            index = _array(document, blob, primitive["indices"]) if "indices" in primitive else np.arange(len(v))
            w = np.zeros((len(v), len(own)))
            for k in (k for k in (0, 1) if f"JOINTS_{k}" in attributes):
                which = _array(document, blob, attributes[f"JOINTS_{k}"]).astype(np.int64)
                np.add.at(w, (np.arange(len(v))[:, None], which), _array(document, blob, attributes[f"WEIGHTS_{k}"]))
            faces.append(index.astype(np.int64).reshape(-1, 3) + sum(map(len, points)))
            points.append(v)
            weights.append(w)
        names = tuple(str(nodes[k].get("name") or f"joint_{k}") for k in own)
        joints = np.linalg.inv(inverse)[:, :3, 3].astype(np.float64)
        rig = Rig(names, np.array(parents, dtype=np.int64), joints, np.concatenate(weights))
        whole = PersonMesh(np.concatenate(points), np.concatenate(faces).astype(np.int32), rig, "+y", where)
    return whole if len(whole.vertices) else None


def _array(document: Any, blob: bytes, number: int) -> Array:
    """Read an array of a GLB file as float64 (count, columns); normalised integers become fractions.

    document, blob: its JSON and its binary part.
    number: number of the accessor.
    Raises: ValueError where it is compressed, in another file, reaches beyond the end of the file, or holds NaN or huge
        numbers.
    """
    a = document["accessors"][number]
    view = document["bufferViews"][a["bufferView"]]
    if "sparse" in a or view["buffer"] != 0:
        raise ValueError("its data are compressed or lie in another file")
    dtype, columns = np.dtype(_DTYPES[a["componentType"]]), _COLUMNS[a["type"]]
    step = view.get("byteStride") or dtype.itemsize * columns
    start, count = view.get("byteOffset", 0) + a.get("byteOffset", 0), a["count"]
    if count < 1 or start < 0 or start + step * (count - 1) + dtype.itemsize * columns > len(blob):
        raise ValueError("an array reaches beyond the end of the file")
    raw = np.ndarray((count, columns), dtype, blob, start, (step, dtype.itemsize))
    if not np.isfinite(raw).all() or np.abs(raw).max() > _LARGEST:
        raise ValueError("its numbers are not finite, or too large")
    return raw / float(np.iinfo(dtype).max) if a.get("normalized") and dtype.kind in "iu" else raw.astype(np.float64)


def _read_smpl(path: Path) -> PersonMesh:
    """Read a body model in SMPL's format from an .npz file, in its rest pose and mean shape.

    Raises: InputError where it is not such a model.
    """
    names = ("v_template", "f", "weights", "J_regressor", "kintree_table")
    step = f"save {', '.join(names)} {_PLAIN}"

    def build(arrays: dict[str, np.ndarray]) -> PersonMesh:
        v = arrays["v_template"].astype(np.float64).reshape(-1, 3)
        f = arrays["f"].astype(np.int64).reshape(-1, 3)
        w, regressor = arrays["weights"].astype(np.float64), arrays["J_regressor"].astype(np.float64)
        parents = arrays["kintree_table"].astype(np.float64)[0]
        n = w.shape[1]
        if w.shape != (len(v), n) or regressor.shape != (n, len(v)) or parents.shape != (n,) or n < len(SMPL_JOINTS):
            shapes = ", ".join(f"{k} {a.shape}" for k, a in arrays.items())
            raise ValueError(f"the arrays do not belong to one model of at least {len(SMPL_JOINTS)} joints: {shapes}")
        # the root's parent is -1, or 2^32 - 1 where it was stored unsigned
        tree = np.where((parents >= 0) & (parents < n), parents, -1).astype(np.int64)
        joint_names = SMPL_JOINTS + tuple(f"extra_{k}" for k in range(len(SMPL_JOINTS), n))
        return PersonMesh(v, f.astype(np.int32), Rig(joint_names, tree, regressor @ v, w), "", str(path))

    return _checked(Archive("model in SMPL's format", step, packed=MAX_MESH_BYTES).load(path, build, names))


def _checked(mesh: PersonMesh) -> PersonMesh:
    """Check the size and the numbers of a mesh, and return it.

    Raises: InputError where it is no surface, too coarse, too large, or has indices or numbers that cannot be.
    """
    v, f, source, rig = mesh.vertices, mesh.faces.astype(np.int64), mesh.source, mesh.rig
    kind = "a point cloud" if len(v) >= MIN_VERTICES else "too coarse"
    bad, last = int((~np.isfinite(v).all(1)).sum()), int(f.max(initial=0))
    faults = {
        f"has {len(v)} vertices and {len(f)} faces and is {kind}; a person needs a surface of at least {MIN_VERTICES} "
        "vertices and faces: export the scan as a mesh": len(v) < MIN_VERTICES or len(f) < MIN_VERTICES,
        f"has {len(f)} faces, at most {MAX_FACES} are read; decimate the scan first": len(f) > MAX_FACES,
        f"has {bad} vertices that are not finite; repair the scan and export it again": bad > 0,
        f"has {len(v)} vertices but a face refers to vertex {last}; export it again": (
            last >= len(v) or f.min(initial=0) < 0
        ),
        "has joints or weights that are not finite; export it again": rig is not None
        and not (np.isfinite(rig.weights).all() and np.isfinite(rig.joints).all()),
    }
    refuse(f"{source} ", faults)
    return mesh


def closed_surface(mesh: PersonMesh) -> PersonMesh:
    """Repair a mesh with trimesh so that it is one closed manifold whose faces point outward.

    Equal vertices are merged, specks are removed and small holes are closed; the notes say so.

    Raises: InputError for large holes, several parts or edges with more than two faces.
    """
    trimesh = extra("trimesh", "A mesh of a person", "mesh")
    extra("networkx", "Repairing a mesh of a person", "mesh")  # trimesh needs it to turn faces and to find holes
    source, notes = mesh.source, list(mesh.notes)
    numbers = {"number": np.arange(len(mesh.vertices))}
    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False, vertex_attributes=numbers)
    surface.merge_vertices()
    f = surface.faces
    corners = (f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])
    surface.update_faces(corners & surface.unique_faces())
    if specks := _keep_main_part(trimesh, surface, source):
        notes.append(f"{specks} small loose parts were left out")
    _, count = np.unique(surface.edges_sorted, axis=0, return_counts=True)
    if (count > 2).any():
        raise InputError(
            f"{source} is not a manifold: {int((count > 2).sum())} edges belong to three or more faces; remesh the "
            "scan (Blender: Remesh modifier, or Mesh > Clean Up > Merge by Distance)."
        )
    trimesh.repair.fix_winding(surface)
    if not surface.is_winding_consistent:
        raise InputError(f"{source} has no inside and outside (its faces cannot all turn one way); remesh the scan.")
    faces = len(surface.faces)
    closed = trimesh.repair.fill_holes(surface, use_fan=True)
    added = surface.triangles[faces:]
    widest = np.linalg.norm(added - np.roll(added, 1, axis=1), axis=-1).max(initial=0) / np.ptp(surface.bounds, 0).max()
    if not closed or widest > _WIDEST_HOLE:
        holes = f" around holes of up to {widest:.0%} of its height" if len(added) else ""
        raise InputError(
            f"{source} is not closed: {int((count == 1).sum())} edges have one face only{holes}; close the scan "
            "(MeshLab: Screened Poisson; Blender: Remesh modifier with voxel size 1 cm) and try again."
        )
    if len(added):
        notes.append("small holes were closed")
    if surface.volume < 0:
        surface.invert()
        notes.append("its faces looked inward and were turned")
    kept = surface.vertex_attributes["number"]
    rig = None if mesh.rig is None else replace(mesh.rig, weights=mesh.rig.weights[kept])
    vertices, turned = np.asarray(surface.vertices, dtype=np.float64), np.asarray(surface.faces, dtype=np.int32)
    return replace(mesh, vertices=vertices, faces=turned, rig=rig, notes=tuple(notes))


def _keep_main_part(trimesh: Any, surface: Any, source: str) -> int:
    """Keep the faces of the one part that is a person; specks below 2 % of the surface are removed.

    trimesh: the package.
    surface: mesh of trimesh, which is changed.
    source: name of the mesh in error messages.
    Returns: number of specks.
    Raises: InputError where there are several parts.
    """
    edges = np.concatenate([surface.faces[:, :2], surface.faces[:, 1:]])
    part = trimesh.graph.connected_component_labels(edges, len(surface.vertices))[surface.faces[:, 0]]
    share = np.bincount(part, surface.area_faces) / max(surface.area, 1e-30)
    large = np.flatnonzero(share > 0.02)
    if len(large) != 1:
        sizes = ", ".join(f"{100 * s:.0f} %" for s in sorted(share[large], reverse=True)[:6])
        raise InputError(
            f"{source} consists of {len(large)} parts ({sizes} of its surface); one closed surface is needed: keep the "
            "person alone, or join the parts (Blender: Remesh modifier, voxel size 1 cm)."
        )
    surface.update_faces(part == large[0])
    surface.remove_unreferenced_vertices()
    return len(np.unique(part)) - 1
