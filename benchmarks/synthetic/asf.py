"""Acclaim motion capture files: ASF (skeleton) and AMC (motion), as of the CMU database.

Axes, lengths and angles are those of the files (CMU: Y up, the subject faces +Z at rest, +X is its left;
degrees; a unit of 56 mm); Asf has the factors to metres and radians, and rotations are matrices. A bone
turns, relative to its parent, by C M C^T: C is the bone's constant `axis` rotation and M its motion, both
compositions about fixed axes in the order stated (XYZ: first x, so Rz Ry Rx). At M = 1 a bone points along
its `direction`. Files are taken to be as CMU writes them.

Source: Acclaim ASF/AMC format (J. Lander, "Working with Motion Capture File Formats", 1998).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from hypose.geometry import Array, so3_exp
from hypose.io.files import text_lines


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
        """Index of a bone by name."""
        return self.names.index(name)


def read_asf(path: str | Path) -> Asf:
    """Read an ASF skeleton."""
    sections = _sections(path)
    units = {w[0]: w[1] for w in sections["units"] if len(w) > 1}
    angle = 1.0 if units["angle"].startswith("rad") else np.pi / 180
    bones, entry = {"root": {w[0].lower(): w[1:] for w in sections["root"]}}, dict[str, list[str]]()
    for words in sections["bonedata"]:
        if words[0] == "end":
            bones[entry["name"][0]], entry = entry, {}
        else:
            entry[words[0]] = words[1:]
    parents = {child: words[0] for words in sections["hierarchy"] for child in words[1:]}
    order = ["root"]
    for name in order:  # breadth first; grows while it is walked
        order += [child for child, parent in parents.items() if parent == name]
    root = bones["root"]
    turns = [[*root["orientation"], *root["axis"]], *(bones[b]["axis"] for b in order[1:])]
    directions = np.array([[0.0, 0.0, 0.0], *([float(x) for x in bones[b]["direction"]] for b in order[1:])])
    directions[1:] /= np.linalg.norm(directions[1:], axis=1, keepdims=True)
    return Asf(
        tuple(order),
        np.array([-1] + [order.index(parents[b]) for b in order[1:]]),
        directions,
        np.array([0.0] + [float(bones[b]["length"][0]) for b in order[1:]]),
        np.array([_composed(turn[3].lower(), [float(x) * angle for x in turn[:3]]) for turn in turns]),
        tuple(tuple(w.lower() for w in bones[b].get("dof", bones[b].get("order", []))) for b in order),
        angle,
        0.0254 / float(units["length"]),
    )


def read_amc(path: str | Path) -> dict[str, Array]:
    """Read an AMC motion: the channels (T, n) of every bone, in the file's order and units."""
    values: dict[str, list[list[float]]] = {}
    for line in text_lines(path, "an AMC motion"):
        words = line.split("#", 1)[0].split()
        if len(words) > 1 and not words[0].startswith(":"):
            values.setdefault(words[0], []).append([float(w) for w in words[1:]])
    return {name: np.array(rows) for name, rows in values.items()}


def global_rotations(asf: Asf, frames: Mapping[str, ArrayLike]) -> tuple[Array, dict[str, Array]]:
    """Root positions (T, 3) in file units and, per bone name, world_from_bone rotations (T, 3, 3) in the
    file's axes.

    A rotation takes the bone from its rest to its posture in the frame: its direction is rotation @
    direction. `frames` is what read_amc returns; bones without channels follow their parents.
    """
    count = len(np.asarray(frames["root"]))
    position = np.zeros((count, 3))
    out: dict[str, Array] = {}
    for b, name in enumerate(asf.names):
        channels = dict(
            zip(asf.dofs[b], np.asarray(frames.get(name, np.zeros((count, 0))), np.float64).T, strict=False)
        )
        for k, axis in enumerate("xyz"):
            position[:, k] += channels.get(f"t{axis}", 0.0)
        turning = [dof for dof in channels if dof[0] == "r"]
        motion = _composed([dof[1] for dof in turning], [channels[dof] * asf.unit_angle for dof in turning])
        local = np.broadcast_to(asf.axes[b] @ motion @ asf.axes[b].T, (count, 3, 3))
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


def _composed(order: Sequence[str], angles: Sequence[ArrayLike]) -> Array:
    """Rotations (..., 3, 3) about fixed axes of the order (such as "xyz", the first one first) by angles in radians."""
    out = np.eye(3)
    for axis, angle in zip(order, angles, strict=True):
        out = so3_exp(np.asarray(angle, dtype=np.float64)[..., None] * np.eye(3)["xyz".index(axis)]) @ out
    return out


def _sections(path: str | Path) -> dict[str, list[list[str]]]:
    """Words of the lines below each :keyword, without those that begin and end a list."""
    out: dict[str, list[list[str]]] = {}
    current = list[list[str]]()
    for line in text_lines(path, "an ASF skeleton"):
        words = line.split("#", 1)[0].split()
        if words and words[0].startswith(":"):
            current = out.setdefault(words[0][1:].lower(), [])
        elif words and words[0] != "begin":
            current.append(words)
    return out
