"""HUMAN4D: a run measured by Vicon, as seen from four real depth cameras (tofis/human4d_dataset, MIT).

The annotations are an HDF5 file of the oldest kind (superblock 0, contiguous arrays); reading its three arrays takes
fewer lines than an HDF5 library would take megabytes.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hypose.errors import InputError
from hypose.geometry import Array, se3, se3_inverse, transform

# (camera, frames) whose positions contradict the other views by more than 10 mm
_BAD = {2: set(range(236, 278)), 1: {266, 269, 279}, 3: {266, 269, 272, 278, 279}}


@dataclass(frozen=True)
class Human4d:
    """joints (T, 33, 3) m in the first camera's frame; camera_from_first (4, 4, 4): the four cameras, OpenCV axes;
    intrinsics (4, 3, 3) px."""

    joints: Array
    camera_from_first: Array
    intrinsics: Array


def read_human4d(folder: Path) -> Human4d:
    """The run of the folder human4d_run; an InputError names a file that cannot be used."""
    try:
        data = (folder / "running_annot.h5").read_bytes()
        arrays = {name: _dataset(data, name) for name in ("pose/3d", "camera", "frame")}
        lenses = np.array([_dataset(data, f"intrinsics/M72{name}") for name in "ehij"], dtype=np.float64)
        text = json.loads((folder / "extrinsics_from_procrustes.json").read_text())["cam1_to_camk"]
    except (OSError, KeyError, ValueError, struct.error) as e:
        raise InputError(f"{folder} is not the HUMAN4D run ({e}); give the folder with running_annot.h5.") from e
    extrinsics = se3([v["R"] for v in text.values()], np.array([v["t"] for v in text.values()], dtype=np.float64) / 1e3)
    camera, frame = arrays["camera"], arrays["frame"].astype(np.int64).ravel()
    names = sorted(set(camera.ravel().tolist()))
    pose = arrays["pose/3d"].astype(np.float64) / 1e3
    first_from_camera = se3_inverse(extrinsics)
    seen: dict[int, list[Array]] = {}
    for i, (name, at) in enumerate(zip(camera.ravel().tolist(), frame.tolist(), strict=True)):
        k = names.index(name)
        if at not in _BAD.get(k, ()) and np.isfinite(pose[i]).all() and np.abs(pose[i]).max() > 1e-3:
            seen.setdefault(at, []).append(transform(first_from_camera[k], pose[i]))
    return Human4d(np.array([np.median(seen[at], axis=0) for at in sorted(seen)]), extrinsics, lenses)


def _dataset(data: bytes, path: str) -> np.ndarray:
    """One contiguous or chunk-free array of an HDF5 file with superblock 0."""
    if data[:8] != b"\x89HDF\r\n\x1a\n" or data[8] != 0:
        raise ValueError("not an HDF5 file of version 0")
    header = struct.unpack_from("<Q", data, 64)[0]
    for part in path.split("/"):
        header = _members(data, header)[part]
    shape: tuple[int, ...] = ()
    kind, address = "", 0
    for message, at in _messages(data, header):
        if message == 0x1:
            rank = data[at + 1]
            shape = struct.unpack_from(f"<{rank}Q", data, at + (8 if data[at] == 1 else 4))
        elif message == 0x3:
            size = struct.unpack_from("<I", data, at + 4)[0]
            signed = "i" if data[at + 1] & 8 else "u"
            kind = {0: f"<{signed}{size}", 1: f"<f{size}", 3: f"S{size}"}[data[at] & 15]
        elif message == 0x8:
            if data[at : at + 2] != b"\x03\x01":
                raise ValueError(f"{path} is not stored in one piece")
            address = struct.unpack_from("<Q", data, at + 2)[0]
    return np.frombuffer(data, kind, int(np.prod(shape)), address).reshape(shape)


def _messages(data: bytes, header: int) -> list[tuple[int, int]]:
    """(type, position of its content) of an object's messages."""
    blocks = [(header + 16, struct.unpack_from("<I", data, header + 8)[0])]
    out = []
    for at, size in blocks:
        end = at + size
        while at + 8 <= end:
            message, length = struct.unpack_from("<HH", data, at)
            if message == 0x10:
                blocks.append(struct.unpack_from("<QQ", data, at + 8))
            out.append((message, at + 8))
            at += 8 + length
    return out


def _members(data: bytes, header: int) -> dict[str, int]:
    """Names and object headers of a group."""
    tree, heap = next(struct.unpack_from("<QQ", data, at) for message, at in _messages(data, header) if message == 0x11)
    names = struct.unpack_from("<Q", data, heap + 24)[0]
    out: dict[str, int] = {}
    nodes = [tree]
    while nodes:
        at = nodes.pop()
        count = struct.unpack_from("<H", data, at + 6)[0]
        if data[at : at + 4] == b"TREE":
            nodes += [struct.unpack_from("<Q", data, at + 32 + 16 * i)[0] for i in range(count)]
        else:
            for i in range(count):
                offset, target = struct.unpack_from("<QQ", data, at + 8 + 40 * i)
                out[data[names + offset : data.index(b"\0", names + offset)].decode()] = target
    return out
