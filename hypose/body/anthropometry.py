"""Anthropometry: the factors that describe a person's shape, their statistics, and sizes measured on a mesh.

A shape is a vector of log factors relative to a body, one per entity, the same for both sides. The prior is a normal
distribution of the log factors about the body scaled to the person's height: Table 2.1 for lengths; for girths one
common factor (slim to heavy) plus an own part. Sizes can be measured on any mesh with joint centres (lengths between
joints, heights above the floor, girths as a tape measures them: the convex outline of a cross-section), so that a
fitted body and a scanned or synthetic person are measured by the same function.
Source: Alcoverro 2014, section 2.3.3, Table 2.1 (after DinBelg 2005) and eq. 2.13. The statistics of girths are an
    addition.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body, Mesh, Shape, deform
from hypose.body.default_body import JOINT_NAMES
from hypose.body.skin_weights import vertex_normals
from hypose.errors import InputError
from hypose.geometry import Array

_SIDES = ("left", "right")


@dataclass(frozen=True)
class Entity:
    """One factor of the shape, the same for both sides.

    name: name of the factor.
    kind: 'scale', 'length', 'girth' or 'clothing'.
    sd: standard deviation of its logarithm in the population, at equal stature.
    fat: part of that sd which follows the common factor from slim to heavy.
    mean: mean of its logarithm in the prior.
    """

    name: str
    kind: str
    sd: float
    fat: float = 0.0
    mean: float = 0.0


# Lengths: sigma / mean of Table 2.1 (head 25 +- 2.2 cm, clavicles 35 +- 2.6, upper arms 25.5 +- 2, lower arms 30.5
# +- 3.2, torso 52 +- 2.8; legs 90.5 +- 4.1 for thigh and shank together, which vary against each other about as much).
# What the table lacks is set by hand: girths as anthropometric surveys have them, rounded.
SHAPE_FACTORS: tuple[Entity, ...] = (
    Entity("scale", "scale", 0.12),
    Entity("torso length", "length", 0.054),
    Entity("neck length", "length", 0.10),
    Entity("head", "length", 0.05),
    Entity("upper arm length", "length", 0.078),
    Entity("forearm length", "length", 0.09),
    Entity("thigh length", "length", 0.065),
    Entity("shank length", "length", 0.065),
    Entity("shoulder width", "length", 0.075),
    Entity("hip width", "length", 0.05),
    Entity("hands", "length", 0.06),
    Entity("feet", "length", 0.05),
    Entity("chest width", "girth", 0.09, 0.07),
    Entity("chest depth", "girth", 0.13, 0.11),
    Entity("waist width", "girth", 0.13, 0.12),
    Entity("waist depth", "girth", 0.18, 0.17),
    Entity("pelvis width", "girth", 0.09, 0.07),
    Entity("pelvis depth", "girth", 0.13, 0.11),
    Entity("neck girth", "girth", 0.09, 0.06),
    Entity("upper arm girth", "girth", 0.16, 0.12),
    Entity("forearm girth", "girth", 0.12, 0.08),
    Entity("thigh girth", "girth", 0.14, 0.10),
    Entity("shank girth", "girth", 0.12, 0.08),
    Entity("clothing", "clothing", 0.06, 0.0, 0.09),
)
SHAPE_FACTOR_NAMES = tuple(e.name for e in SHAPE_FACTORS)

CLOTHING_UNIT = 0.1
"""m, unit of the factor "clothing", which is not a logarithm but a thickness: 9 +- 6 mm in the prior."""
# Share of the thickness of clothes by the kind of joint that carries the skin; 1 elsewhere.
_COVERED = {"head": 0.0, "neck": 0.2, "wrist": 0.0, "ankle": 0.0}

TABLE_2_1: dict[str, tuple[float, float]] = {
    "shoulder height": (140.0, 17.0),
    "head": (25.0, 5.0),
    "clavicles": (35.0, 7.0),
    "arms": (55.5, 10.0),
    "upper arms": (25.5, 4.0),
    "lower arms": (30.5, 10.0),
    "legs": (90.5, 17.0),
    "torso": (52.0, 8.0),
}
"""Mean (cm) and variance (cm^2) of each size. Source: Alcoverro 2014, Table 2.1."""

# Joint without its side: factor of its bone's length, and factors of the skin's distance from the bone: of width and
# depth where there are two, else the same in all directions (so that a hand, a foot keep their proportions).
_SHAPED: dict[str, tuple[str, ...]] = {
    "pelvis": ("torso length", "pelvis width", "pelvis depth"),
    "spine": ("torso length", "waist width", "waist depth"),
    "chest": ("torso length", "chest width", "chest depth"),
    "neck": ("neck length", "neck girth", "neck girth"),
    "head": ("head", "head", "head"),
    "clavicle": ("", "shoulder width", "chest depth"),
    "shoulder": ("upper arm length", "upper arm girth"),
    "elbow": ("forearm length", "forearm girth"),
    "wrist": ("hands", "hands"),
    "hip": ("thigh length", "thigh girth"),
    "knee": ("shank length", "shank girth"),
    "ankle": ("feet", "feet"),
}


def shape_of(log_factors: ArrayLike) -> Shape:
    """Convert log factors (K,) in the order of SHAPE_FACTORS into the Shape that `deform` applies."""
    x = np.asarray(log_factors, dtype=np.float64)
    if x.shape != (len(SHAPE_FACTORS),):
        raise InputError(f"A shape has {len(SHAPE_FACTORS)} log factors, got shape {x.shape}.")
    f = dict(zip(SHAPE_FACTOR_NAMES, np.exp(x).tolist(), strict=True))
    length, girth = dict[str, float](), dict[str, float | tuple[float, float, float]]()
    for joint in JOINT_NAMES:
        along, *across = _SHAPED[joint.split("_")[-1]]
        length[joint] = f.get(along, 1.0)
        girth[joint] = f[across[0]] if len(across) == 1 else (f[across[0]], f[across[1]], 1.0)
    torso, shoulders = f["torso length"], f["shoulder width"]
    upwards = 1.0, 1 / torso, 1.0  # the torso grows upwards only
    offset: dict[str, tuple[float, float, float]] = dict.fromkeys(("spine", "chest", "neck"), upwards)
    for side in _SIDES:
        # hips are children of the pelvis, clavicles of the chest: undo the trunk's stretch across the body
        offset[f"{side}_hip"] = (f["hip width"] / torso, 1 / torso, 1.0)
        offset[f"{side}_clavicle"] = (shoulders / torso, 1 / torso, 1.0)
        offset[f"{side}_shoulder"] = (shoulders, 1.0, 1.0)
    return Shape(f["scale"], length, girth, offset)


def body_of(template: Body, factors: ArrayLike, *, clothed: bool = True) -> Body:
    """Deform the template to the shape of log factors (K,), in the order of SHAPE_FACTORS.

    clothed: whether to add the thickness of the clothes.
    Returns: the body.
    Raises: InputError where the number of factors is wrong.
    """
    x = np.asarray(factors, dtype=np.float64)
    shaped = deform(template, shape_of(x))
    thickness = CLOTHING_UNIT * float(x[entity("clothing")])
    if not clothed or thickness == 0:
        return shaped
    fine = shaped.fine if template.fine is template.coarse else dressed(shaped.fine, thickness)
    coarse = dressed(shaped.coarse, thickness)
    return replace(shaped, coarse=coarse, fine=coarse if template.fine is template.coarse else fine)


def dressed(mesh: Mesh, thickness: float) -> Mesh:
    """Move the surface of a mesh of the 19-joint body outwards by `thickness` m where clothes usually are."""
    normals = vertex_normals(mesh.vertices, mesh.faces)
    share = np.array([_COVERED.get(n.split("_")[-1], 1.0) for n in JOINT_NAMES])
    covered = (share[mesh.skin_index] * mesh.skin_weight).sum(1)
    return mesh.moved(mesh.vertices + thickness * covered[:, None] * normals)


def prior_mean() -> Array:
    """Return the mean (K,) of the log factors in the prior."""
    return np.array([e.mean for e in SHAPE_FACTORS])


def prior_covariance() -> Array:
    """Compute the covariance (K, K) of the log factors at equal stature: own variances plus the common slim-to-heavy
    factor.
    """
    sd, fat = np.array([e.sd for e in SHAPE_FACTORS]), np.array([e.fat for e in SHAPE_FACTORS])
    return np.diag(sd**2 - fat**2) + np.outer(fat, fat)


def length_rows(body: Body) -> tuple[Array, Array, Array]:
    """Make the linear priors of Table 2.1 on the sizes that are sums of segments: arms, legs and shoulder height.

    body: the body at factors 0, scaled to the person's height.
    Returns: derivatives (3, K) of the logarithm of each size by the log factors; means (3,) of these logarithms
        relative to the body, which are 0; and their standard deviations (3,).
    """
    lengths = body.segment_lengths()
    ua, fa = lengths["left_upper_arm"], lengths["left_forearm"]
    th, sh, torso = lengths["left_thigh"], lengths["left_shank"], lengths["torso"]
    rows = np.zeros((3, len(SHAPE_FACTORS)))
    rows[0, [entity("upper arm length"), entity("forearm length")]] = np.array([ua, fa]) / (ua + fa)
    rows[1, [entity("thigh length"), entity("shank length")]] = np.array([th, sh]) / (th + sh)
    parts = [entity("torso length"), entity("thigh length"), entity("shank length")]
    rows[2, parts] = np.array([torso, th, sh]) / (torso + th + sh)
    sd = [np.sqrt(TABLE_2_1[n][1]) / TABLE_2_1[n][0] for n in ("arms", "legs", "shoulder height")]
    return rows, np.zeros(3), np.array(sd)


def entity(name: str) -> int:
    """Return the index of an entity by name; raises InputError with the list of names where there is none."""
    if name not in SHAPE_FACTOR_NAMES:
        raise InputError(f"There is no entity {name!r}; the entities are {', '.join(SHAPE_FACTOR_NAMES)}.")
    return SHAPE_FACTOR_NAMES.index(name)


# --- sizes measured on a mesh ---------------------------------------------------------------------------------------

# girth: (joint, towards joint, share of the way, plane normal: along the bone, or z); '+' continues past the end
_GIRTH_SITES: dict[str, tuple[str, str, float, bool]] = {
    "chest": ("chest", "neck", 0.10, False),
    "waist": ("spine", "chest", 0.25, False),
    "hips": ("left_hip", "right_hip", 0.5, False),
    "neck": ("neck", "head", 0.5, True),
    "upper arm": ("shoulder", "elbow", 0.5, True),
    "forearm": ("elbow", "wrist", 0.3, True),
    "thigh": ("hip", "knee", 0.45, True),
    "shank": ("knee", "ankle", 0.3, True),
}
SEGMENTS: dict[str, tuple[str, str]] = {
    "torso": ("pelvis", "neck"),
    "upper arm": ("shoulder", "elbow"),
    "forearm": ("elbow", "wrist"),
    "thigh": ("hip", "knee"),
    "shank": ("knee", "ankle"),
    "shoulder width": ("left_shoulder", "right_shoulder"),
    "hip width": ("left_hip", "right_hip"),
}
"""Lengths to measure: the distance between two joint centres, the mean of both sides where there are two."""


@dataclass(frozen=True)
class Sizes:
    """Sizes of a person, m.

    stature: height of the person.
    shoulder_height: height of the shoulder joints above the floor.
    lengths: by segment (SEGMENTS).
    girths: by site (chest, waist, hips, neck, upper arm, forearm, thigh, shank).
    """

    stature: float
    shoulder_height: float
    lengths: dict[str, float]
    girths: dict[str, float]

    @property
    def in_cm(self) -> dict[str, float]:
        """All sizes in cm by name: "stature", "shoulder height", the segments by their names, "<site> girth"."""
        out = {"stature": self.stature, "shoulder height": self.shoulder_height, **self.lengths}
        out |= {f"{k} girth": v for k, v in self.girths.items()}
        return {k: 100 * v for k, v in out.items()}


def sizes_of(body: Body) -> Sizes:
    """Measure the sizes of a body on its fine mesh at rest."""
    return measure(body.fine.vertices, body.fine.faces, body.skeleton.rest_joints)


def measure(vertices: Array, faces: NDArray[np.integer], joints: Array) -> Sizes:
    """Measure the sizes of a person at rest (standing, arms away from the body).

    vertices: (V, 3) m, z up.
    faces: (F, 3) faces of the closed mesh.
    joints: (19, 3) m, joint centres in the order of default_body.JOINT_NAMES.
    Returns: the sizes. A girth is the length of the convex outline of the cross-section around the bone.
    Raises: InputError where a plane misses the mesh.
    """
    j = np.asarray(joints, dtype=np.float64)
    at = JOINT_NAMES.index

    def distance(a: str, b: str) -> float:
        pairs = [(a, b)] if a in JOINT_NAMES and b in JOINT_NAMES else [(f"{s}_{a}", f"{s}_{b}") for s in _SIDES]
        return float(np.mean([np.linalg.norm(j[at(p)] - j[at(q)]) for p, q in pairs]))

    floor = float(np.min(vertices[:, 2]))
    shoulders = float(np.mean([j[at(f"{s}_shoulder"), 2] for s in _SIDES])) - floor
    girths = {}
    for site, (a, b, share, along) in _GIRTH_SITES.items():
        pairs = [(a, b)] if a in JOINT_NAMES else [(f"{s}_{a}", f"{s}_{b}") for s in _SIDES]
        found = []
        for p, q in pairs:
            start, bone = j[at(p)], j[at(q)] - j[at(p)]
            normal = bone / np.linalg.norm(bone) if along else np.array([0.0, 0.0, 1.0])
            found.append(girth_at(vertices, faces, start + share * bone, normal, site))
        girths[site] = float(np.mean(found))
    lengths = {k: distance(a, b) for k, (a, b) in SEGMENTS.items()}
    return Sizes(float(np.ptp(vertices[:, 2])), shoulders, lengths, girths)


def girth_at(vertices: Array, faces: NDArray[np.integer], point: Array, normal: Array, what: str = "section") -> float:
    """Measure the convex outline of a mesh's cross-section: of the loop around a point, or of the nearest loop.

    vertices, faces: (V, 3) m and (F, 3) of a closed mesh.
    point: (3,) m in the plane.
    normal: (3,) unit normal of the plane.
    what: name of the section in the message.
    Returns: m.
    Raises: InputError where the plane misses the mesh.
    """
    loops = cross_section(vertices, faces, point, normal)
    if not loops:
        raise InputError(f"The plane of the {what} misses the mesh; the joints do not fit the mesh.")
    x = np.cross(normal, np.eye(3)[int(np.abs(normal).argmin())])
    x /= np.linalg.norm(x)
    basis = np.stack([x, np.cross(normal, x)], 1)
    flat: list[Array] = [np.asarray((loop - point) @ basis, dtype=np.float64) for loop in loops]
    # seen from the point, no gap of a loop around it reaches half a turn
    turns = [np.sort(np.arctan2(f[:, 1], f[:, 0])) for f in flat]
    around = [f for f, a in zip(flat, turns, strict=True) if np.diff(a, append=a[0] + 2 * np.pi).max() < np.pi]
    if around:
        return _tape(max(around, key=len))
    return _tape(min(flat, key=lambda f: float(np.linalg.norm(f, axis=1).min())))


def cross_section(vertices: Array, faces: NDArray[np.integer], point: Array, normal: Array) -> list[Array]:
    """Cut a closed mesh by a plane.

    vertices, faces: (V, 3) m and (F, 3).
    point, normal: (3,) m in the plane, and (3,) normal of the plane.
    Returns: the points of each closed loop, (n, 3) m, in any order.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    height = (np.asarray(vertices, dtype=np.float64) - point) @ normal
    height = np.where(height == 0, 1e-12, height)  # no vertex lies in the plane: every cut face has two cut edges
    above = height > 0
    corners = np.asarray(faces)[np.ptp(above[faces].astype(np.int8), axis=1) > 0]
    edges = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], -1), axis=-1)
    crossed, ends = np.unique(edges[above[edges[..., 0]] != above[edges[..., 1]]], axis=0, return_inverse=True)
    low, high = crossed.T
    share = (height[low] / (height[low] - height[high]))[:, None]
    points = vertices[low] + share * (vertices[high] - vertices[low])
    a, b = ends.reshape(-1, 2).T
    _, loop = connected_components(coo_matrix((np.ones(len(a)), (a, b)), shape=(len(points), len(points))))
    loops = [points[loop == k] for k in np.unique(loop)]
    return [one for one in loops if len(one) > 2]


def _tape(flat: Array) -> float:
    from scipy.spatial import ConvexHull, QhullError  # takes long to import

    try:
        return float(ConvexHull(flat).area)  # in two dimensions the "area" is the perimeter
    except QhullError:
        return 0.0


# kg/m^3.
_DENSITY = 1000.0
_CUBE = 0.01  # m


@dataclass(frozen=True)
class SegmentMass:
    """Mass properties of one body segment.

    mass: kg.
    centre: (3,) m, centre of mass in the model frame at rest.
    inertia: (3, 3) kg m^2 about the centre, along the axes of the model frame.
    """

    mass: float
    centre: Array
    inertia: Array


def segment_masses(body: Body, segments: Mapping[str, Sequence[str]]) -> dict[str, SegmentMass]:
    """Compute mass, centre of mass and inertia of body segments from the volume of the mesh.

    body: the body at rest.
    segments: by name, the joints that carry the skin of the segment.
    Returns: by name. A segment without volume (a user's body may have no hands) becomes one cube at its first joint,
        because simulations fail for a segment without mass.
    """
    from scipy.spatial import KDTree  # takes long to import

    points = _inside(body.fine)
    carrier = body.fine.main_joint[KDTree(body.fine.vertices).query(points)[1]]
    each, out = _DENSITY * _CUBE**3, {}
    for name, joints in segments.items():
        own = points[np.isin(carrier, [body.skeleton.joint(j) for j in joints])]
        if not len(own):
            own = body.skeleton.rest_joints[[body.skeleton.joint(joints[0])]]
        centre = own.mean(0)
        d = own - centre
        # a cube's own inertia is 1/6 of its mass times its edge squared, about any axis
        inertia = each * ((d * d).sum() * np.eye(3) - d.T @ d + len(own) * _CUBE**2 / 6 * np.eye(3))
        out[name] = SegmentMass(each * len(own), centre, inertia)
    return out


def _inside(mesh: Mesh) -> Array:
    """Find the centres (N, 3) m of the cubes inside a closed mesh: those with an odd number of faces above them."""
    corners = mesh.vertices[mesh.faces]
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    # the grid is shifted a little, so that no ray runs along an edge of a symmetric mesh
    axes = [
        np.arange(a + 0.5 * _CUBE + 1.2e-5 * k, b, _CUBE) for k, (a, b) in enumerate(zip(low, high, strict=True), 1)
    ]
    x, y, z = axes
    above = np.zeros((len(x), len(y), len(z)), dtype=np.int64)
    for a, b, c in corners:
        i = slice(*np.searchsorted(x, (min(a[0], b[0], c[0]), max(a[0], b[0], c[0]))))
        j = slice(*np.searchsorted(y, (min(a[1], b[1], c[1]), max(a[1], b[1], c[1]))))
        area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        if area == 0 or i.start == i.stop or j.start == j.stop:
            continue
        px, py = x[i, None], y[None, j]
        v = ((b[0] - px) * (c[1] - py) - (c[0] - px) * (b[1] - py)) / area
        w = ((c[0] - px) * (a[1] - py) - (a[0] - px) * (c[1] - py)) / area
        hit = (v >= 0) & (w >= 0) & (v + w <= 1)
        height = v * a[2] + w * b[2] + (1 - v - w) * c[2]
        above[i, j] += (hit[..., None] & (z < height[..., None])).astype(np.int64)
    chosen = np.argwhere(above % 2 == 1)
    return np.stack([axis[chosen[:, k]] for k, axis in enumerate(axes)], axis=1)
