"""Skinned meshes of GLB files: positions, joints at bind time and weights (Khronos glTF 2.0, section 3.7.3)."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.errors import InputError
from hypose.geometry import Array

_DTYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}

Skinned = tuple[Array, NDArray[np.int32], tuple[str, ...], NDArray[np.int64], Array, Array]


def read_skin(data: bytes, where: str) -> Skinned | None:
    """Vertices (V, 3), faces (F, 3), joint names (n), parents (n,), joint centres (n, 3) and weights (V, n) of the
    first skin of a GLB, in the mesh's space at bind time; None when nothing in it is skinned.

    An InputError when the file is damaged or compressed."""
    from pygltflib import GLTF2

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what it warns of becomes an error below, in words
            gltf = GLTF2.load_from_bytes(data)
        if gltf is None or not gltf.skins:
            return None
        blob = gltf.binary_blob()
        if blob is None:
            raise ValueError("it has no binary part")
        return _skin(gltf, blob)
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001 - a damaged file may fail in any step of the reader
        reason = str(error).split("\n")[0][:120] or type(error).__name__
        raise InputError(
            f"{where} cannot be read as a skinned GLB ({reason}); export it again, uncompressed."
        ) from None


def _skin(gltf: Any, blob: bytes) -> Skinned | None:
    users = [n for n in gltf.nodes if n.skin is not None and n.mesh is not None]
    if not users:
        return None
    number = users[0].skin
    skin = gltf.skins[number]
    nodes = list(skin.joints)
    inverse = _array(gltf, blob, skin.inverseBindMatrices).reshape(-1, 4, 4).swapaxes(1, 2)
    if len(inverse) != len(nodes):
        raise ValueError("the skin has another number of matrices than of joints")
    joints = np.linalg.inv(inverse)[:, :3, 3].astype(np.float64)
    parent_node = {c: k for k, n in enumerate(gltf.nodes) for c in n.children or []}
    place = {node: k for k, node in enumerate(nodes)}
    parents = []
    for node in nodes:
        up, steps = parent_node.get(node), 0
        while up is not None and up not in place and steps < len(gltf.nodes):
            up, steps = parent_node.get(up), steps + 1
        parents.append(place.get(up, -1) if up is not None else -1)
    names = tuple(gltf.nodes[k].name or f"joint_{k}" for k in nodes)
    points, faces, weights, count = [], [], [], 0
    for user in (u for u in users if u.skin == number):
        for primitive in gltf.meshes[user.mesh].primitives:
            a = primitive.attributes
            if a.JOINTS_0 is None or a.WEIGHTS_0 is None or primitive.mode not in (None, 4):
                continue
            v = _array(gltf, blob, a.POSITION)
            index = np.arange(len(v)) if primitive.indices is None else _array(gltf, blob, primitive.indices).ravel()
            w = np.zeros((len(v), len(nodes)))
            for j, x in ((a.JOINTS_0, a.WEIGHTS_0), (getattr(a, "JOINTS_1", None), getattr(a, "WEIGHTS_1", None))):
                if j is not None and x is not None:
                    which = _array(gltf, blob, j).astype(np.int64)
                    np.add.at(w, (np.arange(len(v))[:, None], which), _array(gltf, blob, x))
            points.append(v)
            faces.append(index.astype(np.int64).reshape(-1, 3) + count)
            weights.append(w)
            count += len(v)
    if not points:
        return None
    f = np.concatenate(faces).astype(np.int32)
    return np.concatenate(points), f, names, np.array(parents, dtype=np.int64), joints, np.concatenate(weights)


def _array(gltf: Any, blob: bytes, number: int) -> Array:
    """The values of an accessor as float64 (count, columns); normalized integers become fractions."""
    a = gltf.accessors[number]
    if a.bufferView is None or a.sparse is not None:
        raise ValueError("sparse or compressed data")
    view = gltf.bufferViews[a.bufferView]
    if view.buffer != 0:
        raise ValueError("its data lie in another file")
    dtype, columns = np.dtype(_DTYPES[a.componentType]), _COLUMNS[a.type]
    step = view.byteStride or dtype.itemsize * columns
    start = (view.byteOffset or 0) + (a.byteOffset or 0)
    if a.count < 1 or start < 0 or start + step * (a.count - 1) + dtype.itemsize * columns > len(blob):
        raise ValueError("an array reaches beyond the end of the file")
    raw = np.ndarray((a.count, columns), dtype, blob, start, (step, dtype.itemsize)).astype(np.float64)
    return raw / np.iinfo(dtype).max if a.normalized and dtype.kind in "iu" else raw
