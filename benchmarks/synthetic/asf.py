"""Acclaim motion capture files: ASF (skeleton) and AMC (motion), as of the CMU database.

Axes, lengths and angles are those of the files (CMU: Y up, the subject faces +Z at rest, +X is its left;
degrees; a unit of 56 mm); Asf has the factors to metres and radians, and rotations are matrices. A bone
turns, relative to its parent, by C M C^T: C is the bone's constant `axis` rotation and M its motion, both
compositions about fixed axes in the order stated (XYZ: first x, so Rz Ry Rx). At M = 1 a bone points along
its `direction`.

Source: Acclaim ASF/AMC format (J. Lander, "Working with Motion Capture File Formats", 1998).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from hypose.errors import InputError
from hypose.geometry import Array, so3_exp
from hypose.io.files import text_lines

_MAX_BONES = 1000


@dataclass(frozen=True)
class Asf:
    """Skeleton of an ASF file; bone 0 is the root, parents come before children.

    names (B); parents (B,), -1 for the root; directions (B, 3) unit vectors in the file's axes at rest (0 for
    the root); lengths (B,) file units; axes (B, 3, 3) the constant rotations C; dofs: per bone the order of
    its channels, of rx ry rz (the root also tx ty tz); unit_angle: radians per angle unit; metres_per_unit:
    length unit in metres by CMU's convention (inches / the length factor).
    """

    names: tuple[str, ...]
    parents: np.ndarray
    directions: Array
    lengths: Array
    axes: Array
    dofs: tuple[tuple[str, ...], ...]
    unit_angle: float
    metres_per_unit: float

    def index(self, name: str) -> int:
        """Index of a bone by name; an InputError lists the names."""
        if name not in self.names:
            raise InputError(f"There is no bone {name!r}; the bones are {', '.join(self.names)}.")
        return self.names.index(name)


def read_asf(path: str | Path) -> Asf:
    """Read an ASF skeleton. An InputError names the file, and the line or bone that cannot be used."""
    sections = _sections(path)
    if "bonedata" not in sections or "hierarchy" not in sections:
        raise InputError(f"{path} is not an ASF skeleton: it lacks :bonedata or :hierarchy.")
    units = {w[0]: w[1] for _, w in sections.get("units", []) if len(w) > 1}
    angle = 1.0 if units.get("angle", "deg").startswith("rad") else np.pi / 180
    factor = _floats([units.get("length", "1")], path, 0)[0]
    if factor <= 0:
        raise InputError(f"{path}: the length unit is {factor:g}; it must be positive.")
    root = {w[0].lower(): (n, w[1:]) for n, w in sections.get("root", [])}
    bones = {"root": _root(root, angle, path), **_bones(sections["bonedata"], angle, path)}
    parents = _parents(sections["hierarchy"], bones, path)
    order = ["root"]
    for name in order:  # breadth first; grows while it is walked
        order += [child for child, parent in parents.items() if parent == name]
    if len(order) != len(bones):
        lost = next(b for b in bones if b not in order)
        raise InputError(f"{path}: the bone {lost!r} does not hang on the root in :hierarchy.")
    return Asf(
        tuple(order),
        np.array([-1] + [order.index(parents[b]) for b in order[1:]]),
        np.array([bones[b].direction for b in order]),
        np.array([bones[b].length for b in order]),
        np.array([bones[b].axis for b in order]),
        tuple(bones[b].dofs for b in order),
        angle,
        0.0254 / factor,
    )


def read_amc(path: str | Path) -> dict[str, Array]:
    """Read an AMC motion: the channels (T, n) of every bone, in the file's order and units.

    Every frame must have the same bones. An InputError names the line that cannot be used.
    """
    values: dict[str, list[list[float]]] = {}
    frames, seen = 0, 0
    for number, line in enumerate(text_lines(path, "an AMC motion"), start=1):
        words = line.split("#", 1)[0].split()
        if not words or words[0].startswith(":"):
            continue
        if len(words) == 1 and words[0].isdigit():
            if frames and seen != len(values):
                raise InputError(f"{path}: the frame before line {number} lacks a bone that other frames have.")
            frames, seen = frames + 1, 0
            continue
        if not frames:
            raise InputError(f"{path} is not an AMC motion: line {number} is neither a keyword nor a frame number.")
        row = _floats(words[1:], path, number)
        column = values.setdefault(words[0], [])
        if len(column) != frames - 1 or (column and len(column[0]) != len(row)):
            raise InputError(f"{path}: line {number}: the bone {words[0]!r} differs from its other frames.")
        column.append(row)
        seen += 1
    if not frames or not values:
        raise InputError(f"{path} is not an AMC motion: it has no frames.")
    if seen != len(values):
        raise InputError(f"{path}: the last frame lacks a bone that other frames have; the file may be truncated.")
    return {name: np.array(rows, dtype=np.float64).reshape(frames, -1) for name, rows in values.items()}


def global_rotations(asf: Asf, frames: Mapping[str, ArrayLike]) -> tuple[Array, dict[str, Array]]:
    """Root positions (T, 3) in file units and, per bone name, world_from_bone rotations (T, 3, 3) in the
    file's axes.

    A rotation takes the bone from its rest to its posture in the frame: its direction is rotation @
    direction. `frames` is what read_amc returns; bones without channels follow their parents. An InputError
    names a bone whose channels do not fit.
    """
    unknown = [name for name in frames if name not in asf.names]
    if unknown:
        raise InputError(f"The motion moves the bone {unknown[0]!r}, which the skeleton lacks; give the matching ASF.")
    if "root" not in frames:
        raise InputError("The motion has no root channels; give a complete AMC file.")
    count = len(np.asarray(frames["root"]))
    position = np.zeros((count, 3))
    out: dict[str, Array] = {}
    for b, name in enumerate(asf.names):
        dofs = asf.dofs[b]
        values = np.asarray(frames.get(name, np.zeros((count, len(dofs)))), dtype=np.float64)
        if values.shape != (count, len(dofs)):
            raise InputError(
                f"The motion has channels of shape {values.shape} for {name!r}, the skeleton needs "
                f"{(count, len(dofs))}; give the matching ASF."
            )
        motion = np.broadcast_to(np.eye(3), (count, 3, 3))
        for k, dof in enumerate(dofs):
            if dof[0] == "t":
                position[:, "xyz".index(dof[1])] = values[:, k]
            else:
                motion = _about(dof[1], values[:, k] * asf.unit_angle) @ motion
        local = asf.axes[b] @ motion @ asf.axes[b].T
        out[name] = local if b == 0 else out[asf.names[asf.parents[b]]] @ local
    return position, out


def bone_ends(asf: Asf, frames: Mapping[str, ArrayLike]) -> Array:
    """End point (T, B, 3) of every bone in file units and axes, in the order of asf.names; the root's is
    its position."""
    position, rotations = global_rotations(asf, frames)
    out = np.zeros((len(position), len(asf.names), 3))
    out[:, 0] = position
    for b in range(1, len(asf.names)):
        out[:, b] = out[:, asf.parents[b]] + rotations[asf.names[b]] @ (asf.directions[b] * asf.lengths[b])
    return out


@dataclass(frozen=True)
class _Bone:
    direction: Array
    length: float
    axis: Array
    dofs: tuple[str, ...]


def _about(axis: str, angle: ArrayLike) -> Array:
    return so3_exp(np.asarray(angle, dtype=np.float64)[..., None] * np.eye(3)["xyz".index(axis)])


def _sections(path: str | Path) -> dict[str, list[tuple[int, list[str]]]]:
    """Words of the lines below each :keyword, with their line numbers."""
    out: dict[str, list[tuple[int, list[str]]]] = {}
    current: list[tuple[int, list[str]]] | None = None
    for number, line in enumerate(text_lines(path, "an ASF skeleton"), start=1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        if words[0].startswith(":"):
            current = out.setdefault(words[0][1:].lower(), [])
        elif current is None:
            raise InputError(f"{path} is not an ASF skeleton: line {number} stands before the first :keyword.")
        else:
            current.append((number, words))
    return out


def _floats(words: list[str], path: str | Path, number: int) -> list[float]:
    try:
        values = [float(w) for w in words]
    except ValueError:
        raise InputError(f"{path}: line {number} holds something that is not a number.") from None
    if not np.isfinite(values).all():
        raise InputError(f"{path}: line {number} holds a number that is not finite.")
    return values


def _axis(words: list[str], order: str, angle: float, path: str | Path, number: int) -> Array:
    values = _floats(words, path, number)
    if len(values) != 3 or sorted(order.lower()) != ["x", "y", "z"]:
        raise InputError(f"{path}: line {number}: an axis needs three angles and an order such as XYZ.")
    out = np.eye(3)
    for k, value in zip(order.lower(), values, strict=True):
        out = _about(k, value * angle) @ out
    return out


def _root(root: dict[str, tuple[int, list[str]]], angle: float, path: str | Path) -> _Bone:
    number, order = root.get("order", (0, ["TX", "TY", "TZ", "RX", "RY", "RZ"]))
    dofs = tuple(w.lower() for w in order)
    if len(set(dofs)) < len(dofs) or not set(dofs) <= {"tx", "ty", "tz", "rx", "ry", "rz"}:
        raise InputError(f"{path}: line {number}: the root's order must be of TX TY TZ RX RY RZ.")
    _, axis_order = root.get("axis", (0, ["XYZ"]))
    number, turn = root.get("orientation", (0, ["0", "0", "0"]))
    axis = _axis(turn, axis_order[0] if axis_order else "", angle, path, number)
    return _Bone(np.zeros(3), 0.0, axis, dofs)


def _bones(lines: list[tuple[int, list[str]]], angle: float, path: str | Path) -> dict[str, _Bone]:
    bones: dict[str, _Bone] = {}
    entry: dict[str, tuple[int, list[str]]] | None = None
    for number, words in lines:
        key = words[0].lower()
        if key == "begin":
            entry = {}
        elif entry is None:
            raise InputError(f"{path}: line {number} stands outside begin and end.")
        elif key == "end":
            name, bone = _bone(entry, angle, path, number)
            if name in bones or name == "root" or len(bones) >= _MAX_BONES:
                raise InputError(f"{path}: line {number}: the bone {name!r} occurs twice, or there are too many bones.")
            bones[name] = bone
            entry = None
        else:
            entry[key] = (number, words[1:])
    if entry is not None or not bones:
        raise InputError(f"{path}: :bonedata is empty or ends inside a bone; the file may be truncated.")
    return bones


def _bone(entry: dict[str, tuple[int, list[str]]], angle: float, path: str | Path, number: int) -> tuple[str, _Bone]:
    missing = [k for k in ("name", "direction", "length") if not entry.get(k, (0, []))[1]]
    if missing:
        raise InputError(f"{path}: the bone that ends in line {number} lacks its {missing[0]}.")
    name = entry["name"][1][0]
    direction = np.array(_floats(entry["direction"][1], path, entry["direction"][0]))
    length = _floats(entry["length"][1][:1], path, entry["length"][0])[0]
    norm = np.linalg.norm(direction) if direction.shape == (3,) else 0.0
    if norm == 0 or length < 0:
        raise InputError(f"{path}: the bone {name!r} needs a direction of three numbers, not all 0, and a length >= 0.")
    line, turn = entry.get("axis", (number, ["0", "0", "0", "XYZ"]))
    axis = _axis(turn[:3], turn[3] if len(turn) > 3 else "XYZ", angle, path, line)
    dofs = tuple(w.lower() for w in entry.get("dof", (0, []))[1])
    if not set(dofs) <= {"rx", "ry", "rz"} or len(set(dofs)) < len(dofs):
        raise InputError(f"{path}: the bone {name!r} has channels {' '.join(dofs)}; rx, ry and rz can be read.")
    return name, _Bone(direction / norm, length, axis, dofs)


def _parents(lines: list[tuple[int, list[str]]], bones: Mapping[str, _Bone], path: str | Path) -> dict[str, str]:
    parents: dict[str, str] = {}
    for number, words in lines:
        if words[0].lower() in ("begin", "end") and len(words) == 1:
            continue
        for name in words:
            if name not in bones:
                raise InputError(f"{path}: line {number} names the bone {name!r}, which :bonedata lacks.")
        for child in words[1:]:
            if child in parents or child == "root":
                raise InputError(f"{path}: line {number}: the bone {child!r} has two parents.")
            parents[child] = words[0]
    return parents
