"""Find the joints inside a scanned person: fit shape and pose of the template body to the scan.

First the up axis, the facing direction and the pose of the arms are found by comparing the template in every
combination with samples of the scan. Then the best few are refined by a bounded Gauss-Newton search over pose and
proportions, on distances between the surfaces in both directions, along the normals, with a robust weight whose scale
shrinks.
Sources: alternating nearest points (Besl & McKay 1992) and point-to-plane rows (Chen & Medioni 1992); Geman & McClure
    1985; the proportions are the entities of Alcoverro 2014, section 2.3.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body, Landmarks, Mesh, Shape, deform
from hypose.body.skin_weights import vertex_normals
from hypose.compute.linear import weighted_squares
from hypose.compute.losses import geman_mcclure
from hypose.compute.solver import bounded_step
from hypose.errors import InputError
from hypose.geometry import Array, rotation_between, so3_exp, so3_log

# direction of the straight arm in each pose a scan may be taken in, for the left side (model frame)
_ARMS = {"a": (0.75, 0.0, -0.66), "t": (1.0, 0.0, 0.0), "standing": (0.18, 0.0, -1.0), "hands-up": (0.35, 0.0, 1.0)}
SCAN_POSES = tuple(_ARMS)
"""Poses in which a person may be scanned: A-pose, T-pose, standing with hanging arms, hands up."""

_TRUNK = ("pelvis", "spine", "chest")
_SIDES = ("left", "right")


@dataclass(frozen=True)
class _Factor:
    """One proportion; exp(value) multiplies length, girth (along the given axes) or offset of some joints.

    sd: standard deviation of the logarithm between people of one stature.
    """

    name: str
    kind: str
    joints: tuple[str, ...]
    sd: float
    axes: tuple[int, ...] = (0, 1, 2)


def _pair(joint: str) -> tuple[str, ...]:
    return tuple(f"{s}_{joint}" for s in _SIDES)


FACTORS: tuple[_Factor, ...] = (
    _Factor("scale", "scale", (), 1.0),
    _Factor("torso", "length", _TRUNK, 0.05),
    _Factor("neck", "length", ("neck",), 0.10),
    _Factor("head", "size", ("head",), 0.07),
    _Factor("shoulder width", "offset", _pair("shoulder"), 0.10),
    _Factor("hip width", "offset", _pair("hip"), 0.06),
    _Factor("upper arm", "length", _pair("shoulder"), 0.06),
    _Factor("forearm", "length", _pair("elbow"), 0.06),
    _Factor("hand", "size", _pair("wrist"), 0.08),
    _Factor("thigh", "length", _pair("hip"), 0.06),
    _Factor("shank", "length", _pair("knee"), 0.06),
    _Factor("foot", "size", _pair("ankle"), 0.08),
    *(_Factor(f"{j} width", "girth", (j,), 0.15, (0,)) for j in _TRUNK),
    *(_Factor(f"{j} depth", "girth", (j,), 0.20, (1,)) for j in _TRUNK),
    *(_Factor(f"{j} girth", "girth", _pair(j), 0.20) for j in ("shoulder", "elbow", "hip", "knee")),
    _Factor("neck girth", "girth", ("neck",), 0.15),
)


@dataclass(frozen=True)
class _ScanSamples:
    """Samples of the surface of a scan: points (N, 3) m and outward unit normals (N, 3)."""

    points: Array
    normals: Array


@dataclass(frozen=True)
class ScanPose:
    """Orientation and arm pose of a scan.

    upright_from_file: (3, 3) rotation after which z is up and the person faces -y.
    arms: name of the arm pose, one of SCAN_POSES.
    score: mean distance to the template, as a share of the stature.
    up: up axis of the file, such as '+y'.
    """

    upright_from_file: Array
    arms: str
    score: float
    up: str


@dataclass(frozen=True)
class ScanFit:
    """Template fitted to a scan.

    body: body with the scan's proportions, at rest.
    pose: (D,) in the upright frame of the scan.
    factors: (K,) logarithms of FACTORS.
    distance: median distance between the two surfaces in both directions, m.
    far: share of the samples farther than 5 % of the stature.
    """

    body: Body
    pose: Array
    factors: Array
    distance: float
    far: float


def surface_samples(vertices: ArrayLike, faces: ArrayLike, count: int, rng: np.random.Generator) -> _ScanSamples:
    """Draw `count` points spread evenly over the surface of a mesh.

    vertices, faces: (V, 3) m and (F, 3).
    Returns: points (N, 3) m with outward unit normals (N, 3).
    Raises: InputError where the mesh has no area.
    """
    v, f = np.asarray(vertices, dtype=np.float64), np.asarray(faces)
    a, b, c = (v[f[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    double = np.linalg.norm(normal, axis=1)
    if not double.sum() > 0:
        raise InputError("The mesh has no surface: all its triangles have area 0; export it again.")
    edges = np.cumsum(double) / double.sum()
    chosen = np.minimum(np.searchsorted(edges, (np.arange(count) + rng.random(count)) / count), len(f) - 1)
    s, t = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
    points = (1 - s) * a[chosen] + s * (1 - t) * b[chosen] + s * t * c[chosen]
    return _ScanSamples(points, normal[chosen] / np.maximum(double[chosen], 1e-30)[:, None])


def scan_pose(body: Body, name: str) -> Array:
    """Return the pose (D,) of SCAN_POSES by name, with nearly straight arms, at the origin, facing -y.

    Raises: InputError with the list of poses for an unknown name.
    """
    if name not in _ARMS:
        raise InputError(f"There is no scan pose {name!r}; the poses are auto, {', '.join(SCAN_POSES)}.")
    s, pose = body.skeleton, np.zeros(body.skeleton.dof)
    joints = s.rest_joints
    for side, mirror in (("left", 1.0), ("right", -1.0)):
        shoulder, elbow, wrist = (s.joint(f"{side}_{n}") for n in ("shoulder", "elbow", "wrist"))
        upper, fore = joints[elbow] - joints[shoulder], joints[wrist] - joints[elbow]
        pose[s.dofs_of(f"{side}_shoulder")] = so3_log(rotation_between(upper, np.array(_ARMS[name]) * (mirror, 1, 1)))
        bend = np.arccos(np.clip(upper @ fore / np.linalg.norm(upper) / np.linalg.norm(fore), -1, 1))
        pose[s.dofs_of(f"{side}_elbow")] = -0.7 * bend  # people relax their elbows
    return s.clamp(pose)


def find_stances(surface: _ScanSamples, template: Body) -> list[ScanPose]:
    """Find the possible orientations and arm poses of a scan.

    surface: samples of the scan, in any unit.
    template: the body to compare with.
    Returns: all combinations, best first. Any axis may be up; z, then y are preferred where scores are similar.
    """
    from scipy.spatial import KDTree  # takes long to import

    step = max(1, len(surface.points) // 700)
    points, normals = surface.points[::step], surface.normals[::step]
    models = {}
    for name in SCAN_POSES:
        v = template.skin(scan_pose(template, name))
        n = vertex_normals(v, template.coarse.faces)
        models[name] = (_boxed(v)[0], n)
    out = []
    for label, axis, _ in _UPS:
        upright = rotation_between(np.array(axis), np.array([0.0, 0.0, 1.0]))
        flat = (points @ upright.T)[:, :2]
        _, direction = np.linalg.eigh(np.cov((flat - flat.mean(0)).T))
        widest = np.arctan2(direction[1, 1], direction[0, 1])
        for quarter in range(4):
            turn = so3_exp(np.array([0, 0, -widest + quarter * np.pi / 2])) @ upright
            boxed, _ = _boxed(points @ turn.T)
            facing = normals @ turn.T
            for name, (v, n) in models.items():
                # normals count like a distance of a twelfth of the stature: front and back differ by little else
                a, b = np.hstack([boxed, facing / 12]), np.hstack([v, n / 12])
                d = np.concatenate([KDTree(b).query(a)[0], KDTree(a).query(b)[0]])
                out.append(ScanPose(turn, name, float(np.minimum(d, 0.2).mean()), label))
    preference = {label: prefer for label, _, prefer in _UPS}
    return sorted(out, key=lambda s: s.score * preference[s.up])


_UPS = (
    ("+z", (0.0, 0.0, 1.0), 1.0),
    ("+y", (0.0, 1.0, 0.0), 1.1),
    ("-y", (0.0, -1.0, 0.0), 1.25),
    ("-z", (0.0, 0.0, -1.0), 1.25),
    ("+x", (1.0, 0.0, 0.0), 1.25),
    ("-x", (-1.0, 0.0, 0.0), 1.25),
)


def _boxed(points: Array) -> tuple[Array, float]:
    """Scale points to height 1, with the feet at z = 0, centred over the origin; return the old height too."""
    low, high = points.min(0), points.max(0)
    height = float(high[2] - low[2])
    return (points - [*(0.5 * (low + high))[:2], low[2]]) / max(height, 1e-12), height


def fit_template(surface: _ScanSamples, template: Body, stances: list[ScanPose]) -> tuple[ScanFit, ScanPose]:
    """Fit shape and pose of the template to a scan in metres.

    surface: samples of the scan.
    template: the body to fit.
    stances: as `find_stances` returns them; the first few are tried roughly, the best of these is fitted finely.
    Returns: the fit, in the frame into which the chosen stance rotates the file, and that stance.
    """
    light = _light(template)
    few: list[ScanPose] = []
    for s in stances:
        if s.score < 1.6 * stances[0].score and len(few) < 4:
            few.append(s)
    trials = []
    for s in few:
        search = _Search(light, _turned(surface, s.upright_from_file, step=3))
        x, cost = search.run(search.start(s.arms), _ROUGH)
        trials.append((cost, s, x))
    _, stance, x = min(trials, key=lambda t: t[0])
    search = _Search(light, _turned(surface, stance.upright_from_file))
    search.start(stance.arms)
    x, _ = search.run(x, _FINE)
    k = template.skeleton.dof
    body = deform(template, shape_from_factors(x[k:]), template.name)
    distance, far = search.quality(x)
    return ScanFit(body, x[:k], x[k:], distance, far), stance


def _light(body: Body) -> Body:
    """Return the body without display mesh and landmarks, which would cost time in repeated deformation."""
    body.coarse.arrays  # noqa: B018 - builds the edges once, before the copies
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 4), np.int32), np.zeros((0, 4)))
    return replace(body, fine=nothing, landmarks=Landmarks((), np.zeros(0, np.int64), np.zeros((0, 3))))


def shape_from_factors(factors: ArrayLike) -> Shape:
    """Convert the logarithms (K,) of FACTORS into the Shape that `deform` applies."""
    length: dict[str, float] = {}
    girth: dict[str, list[float]] = {}
    offset: dict[str, tuple[float, float, float]] = {}
    scale = 1.0
    for factor, value in zip(FACTORS, np.exp(np.asarray(factors, dtype=np.float64)).tolist(), strict=True):
        if factor.kind == "scale":
            scale = value
        for joint in factor.joints:
            if factor.kind in ("length", "size"):
                length[joint] = length.get(joint, 1.0) * value
            if factor.kind in ("girth", "size"):
                row = girth.setdefault(joint, [1.0, 1.0, 1.0])
                for axis in factor.axes:
                    row[axis] *= value
            if factor.kind == "offset":
                offset[joint] = (value, 1.0, 1.0)
    return Shape(scale, length, {j: (g[0], g[1], g[2]) for j, g in girth.items()}, offset)


def unposed(body: Body, pose: ArrayLike, points_world: ArrayLike, weights: ArrayLike) -> Array:
    """Bring points of a posed surface back to the body's rest pose: the inverse of linear blend skinning.

    pose: (D,) of the surface.
    points_world: (P, 3) m in the world.
    weights: (P, J) dense skinning weights.
    Returns: (P, 3) m in the model frame at rest; skinning them again gives points_world.
    """
    rotations, centres = body.skeleton.forward(pose)
    rest = body.skeleton.rest_joints - body.skeleton.rest_joints[0]
    moves = np.asarray(weights, dtype=np.float64) @ np.hstack(
        [rotations.reshape(-1, 9), centres - np.einsum("jab,jb->ja", rotations, rest)]
    )
    blended = moves[:, :9].reshape(-1, 3, 3)
    shifted = np.asarray(points_world, dtype=np.float64) - moves[:, 9:]
    return np.linalg.solve(blended, shifted[..., None])[..., 0].astype(np.float64)


@dataclass(frozen=True)
class _Stage:
    """Settings of one stage of the search.

    iterations: number of iterations.
    first, last: first and last scale of the robust weight, as shares of the stature.
    shape: True: all proportions are free; False: only the scale.
    """

    iterations: int
    first: float
    last: float
    shape: bool


_ROUGH = _Stage(8, 0.06, 0.04, False)
_FINE = _Stage(24, 0.04, 0.012, True)
# 1 sd of a row: errors of neighbouring rows are correlated, so each counts less than the scan's noise alone would give
_ROW_SD = 0.04
_TANGENT = 0.15  # weight of the directions along the surface: nearest points determine them badly
_FREE = {"shoulder": 0.5, "elbow": 0.4, "hip": 0.3, "knee": 0.2, "ankle": 0.25, "clavicle": 0.12}
_STIFF = 0.12  # 1 sd of the other joints from the start pose, rad


_CORNERS = np.array([(4, 1, 1), (1, 4, 1), (1, 1, 4)]) / 6


class _Search:
    """Damped Gauss-Newton search over the vector x = (pose, logarithms of the factors)."""

    def __init__(self, body: Body, surface: _ScanSamples) -> None:
        from scipy.spatial import KDTree  # takes long to import

        self.body, self.surface = body, surface
        self.tree = KDTree(surface.points)
        self.faces = body.coarse.faces
        self.dof = body.skeleton.dof
        low, high = surface.points.min(0), surface.points.max(0)
        self.low, self.high = low, high
        self.stature = float(high[2] - low[2])

    def start(self, arms: str) -> Array:
        """Make the start vector: the template with the scan's height, over its middle."""
        pose = scan_pose(self.body, arms)
        v = self.body.skin(pose)
        scale = self.stature / np.ptp(v[:, 2])
        middle = 0.5 * (v.min(0) + v.max(0)) * scale
        pose[:3] = 0.5 * (self.low + self.high) - middle
        x = np.concatenate([pose, np.zeros(len(FACTORS))])
        x[self.dof] = np.log(scale)
        self.centre = x.copy()
        sd = np.full(len(x), _STIFF)
        sd[:3], sd[3:6] = 0.3 * self.stature, 0.3
        for d in range(6, self.dof):
            kind = self.body.skeleton.joint_names[self.body.skeleton.joint_of_dof[d]].split("_")[-1]
            sd[d] = _FREE.get(kind, _STIFF)
        sd[self.dof :] = [f.sd for f in FACTORS]
        self.sd = sd
        s = self.body.skeleton
        self.lower = np.concatenate(
            [s.lower, [f_center - 4 * f.sd for f, f_center in zip(FACTORS, x[self.dof :], strict=True)]]
        )
        self.upper = np.concatenate(
            [s.upper, [f_center + 4 * f.sd for f, f_center in zip(FACTORS, x[self.dof :], strict=True)]]
        )
        return x

    def skin(self, x: Array) -> Array:
        return deform(self.body, shape_from_factors(x[self.dof :])).skin(x[: self.dof])

    def derivative(self, x: Array, free: NDArray[np.int64], fresh: bool) -> tuple[Array, Array]:
        """Compute the vertices (V, 3) and their derivatives (P, V, 3) by finite differences, wide enough for float32
        skinning.

        fresh: False: keep the derivatives by the factors from the last call, because they change little.
        """
        shaped = deform(self.body, shape_from_factors(x[self.dof :]))
        h = 2e-3
        turns = free[free < self.dof]
        poses = np.tile(x[: self.dof], (1 + len(turns), 1))
        poses[1 + np.arange(len(turns)), turns] += h
        v = shaped.skin(poses)
        if fresh:
            rows = []
            for k in free[free >= self.dof]:
                y = x.copy()
                y[k] += 0.02
                rows.append((self.skin(y) - v[0]) / 0.02)
            self.by_factor = np.stack(rows)
        return v[0], np.concatenate([(v[1:] - v[0]) / h, self.by_factor])

    def match(self, v: Array) -> tuple[NDArray[np.int64], Array, Array, Array, Array]:
        """Match points of the body with points of the scan, in both directions.

        Returns: face (M,) and barycentric coordinates (M, 3) of the points on the body, target (M, 3) m, normal (M, 3),
            and weight (M,).
        """
        from scipy.spatial import KDTree  # takes long to import

        corner, faces, s = _CORNERS, self.faces, self.surface
        points = np.einsum("sc,fcd->fsd", corner, v[faces]).reshape(-1, 3)
        normals = np.cross(v[faces[:, 1]] - v[faces[:, 0]], v[faces[:, 2]] - v[faces[:, 0]])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        normals = np.repeat(normals, len(corner), 0)
        # body to scan, then scan to body; normals must roughly agree
        gap, near = (np.asarray(a) for a in self.tree.query(points))
        ok = (normals * s.normals[near]).sum(1) > 0.2
        one = np.flatnonzero(ok)
        gap2, back = (np.asarray(a) for a in KDTree(points).query(s.points))
        ok2 = (normals[back] * s.normals).sum(1) > 0.2
        two = np.flatnonzero(ok2)
        index = np.concatenate([one, back[two]])
        target = np.concatenate([s.points[near[one]], s.points[two]])
        normal = np.concatenate([s.normals[near[one]], normals[back[two]]])
        # both directions weigh the same
        weight = np.concatenate([np.full(len(one), 1.0 / len(points)), np.full(len(two), 1.0 / len(s.points))])
        self.unmatched = 0.5 * (1 - ok.mean()) + 0.5 * (1 - ok2.mean())
        self.gaps = np.concatenate([gap, gap2])
        face = index // len(corner)
        return face, corner[index % len(corner)], target, normal, weight * 1500

    def quality(self, x: Array) -> tuple[float, float]:
        """Compute the median distance between the surfaces, m, and the share of samples farther than 5 % of the
        stature.
        """
        self.match(self.skin(x))
        return float(np.median(self.gaps)), float((self.gaps > 0.05 * self.stature).mean())

    def run(self, x: Array, stage: _Stage) -> tuple[Array, float]:
        """Run one stage of the search.

        Returns: the improved vector and its cost: the mean robust distance of the samples, as a share of the stature.
        """
        free = np.arange(self.dof + (len(FACTORS) if stage.shape else 1))
        cost = np.inf
        for k in range(stage.iterations):
            share = stage.first * (stage.last / stage.first) ** (k / max(stage.iterations - 1, 1))
            scale = share * self.stature
            v, dv = self.derivative(x, free, fresh=k % 4 == 0)
            face, bary, target, normal, weight = self.match(v)
            corners = self.faces[face]
            points = np.einsum("mc,mcd->md", bary, v[corners])
            turned = np.ascontiguousarray(dv.transpose(1, 2, 0))  # (V, 3, P): a row's derivatives lie together
            jac = sum(turned[corners[:, c]] * bary[:, c, None, None] for c in range(3))
            apart = points - target
            along = (apart * normal).sum(1)
            w = geman_mcclure((apart**2).sum(1) / scale**2, weight / _ROW_SD**2)[1]
            # three rows each, by a root of n n' + t^2 of the normal n: along it apart weighs 1, across it t
            more = np.sqrt(1 + _TANGENT**2) - _TANGENT
            rows = _TANGENT * jac + (more * normal)[..., None] * np.einsum("mdp,md->mp", jac, normal)[:, None]
            residual = _TANGENT * apart + more * normal * along[:, None]
            hessian, gradient = weighted_squares(rows.reshape(-1, len(free)), np.repeat(w, 3), residual.ravel())
            prior = 1 / self.sd[free] ** 2
            hessian += np.diag(prior)
            gradient += prior * (x[free] - self.centre[free])
            step = bounded_step(hessian, gradient, x[free], self.lower[free], self.upper[free], 1e-3)
            if step is None:
                break
            step *= min(1.0, 0.35 / np.abs(step).max())
            x = x.copy()
            x[free] = np.clip(x[free] + step, self.lower[free], self.upper[free])
            cost = float(geman_mcclure((self.gaps / self.stature / 0.04) ** 2)[0].mean()) + float(self.unmatched)
            if k > 3 and share <= stage.last * 1.3 and np.abs(step).max() < 1e-3:
                break
        return x, cost


def _turned(surface: _ScanSamples, rotation: Array, step: int = 1) -> _ScanSamples:
    return _ScanSamples(surface.points[::step] @ rotation.T, surface.normals[::step] @ rotation.T)
