"""Find the joints inside a scanned person: fit shape and pose of the template body to the scan.

First the up axis, the facing direction and the pose of the arms are found by comparing the template in every
combination with samples of the scan. Then the best few are refined like the shape of a tracked person
(`tracking.shape_refinement`): the scan counts as a depth map from all sides.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from hypose.body.anthropometry import body_of, entity, prior_covariance, prior_mean
from hypose.body.body import Body
from hypose.body.skin_weights import vertex_normals
from hypose.errors import InputError
from hypose.evidence.terms import DepthTerm
from hypose.geometry import Array, rotation_between, so3_exp
from hypose.tracking.shape_refinement import ShapeSettings, refine_shape
from hypose.tracking.starts import KNOWN_POSES, known_pose


@dataclass(frozen=True)
class ScanSettings:
    """Settings of fitting the template to a scan.

    up: up axes that a file may have, each with a factor on its score; the larger, the less likely.
    compared: number of samples by which stances are compared.
    turns: headings that are tried, a quarter turn apart.
    normals: m of distance, as a share of the stature, that a normal in the opposite direction counts like.
    farthest: distances are cut off there, as a share of the stature.
    within, tried: stances with a score within this factor of the best, and at most so many, are fitted.
    rough, fine: iterations of the first fit of each stance, and of the fit of the best.
    thinned: each so-many-th sample is used in the first fit.
    weight: weight of all samples together, since errors of neighbouring samples are correlated.
    far: distance of a sample, as a share of the stature, beyond which it counts as far from the body.
    unlikely: Mahalanobis distance of proportions above which a scan is no person: heavy people have 6, a person
        squeezed to a pole 10.
    """

    up: Mapping[str, float] = field(
        default_factory=lambda: {"+z": 1.0, "+y": 1.1, "-y": 1.25, "-z": 1.25, "+x": 1.25, "-x": 1.25}
    )
    compared: int = 700
    turns: int = 4
    normals: float = 1 / 12
    farthest: float = 0.2
    within: float = 1.6
    tried: int = 4
    rough: ShapeSettings = ShapeSettings(iterations=(4,), coarse=(4.0,))
    fine: ShapeSettings = ShapeSettings(iterations=(6, 8, 10), coarse=(2.7, 1.4, 0.8))
    thinned: int = 3
    weight: float = 150.0
    far: float = 0.05
    unlikely: float = 8.0


SCAN = ScanSettings()


@dataclass(frozen=True)
class ScanSamples:
    """Samples of the surface of a scan: points (N, 3) m and outward unit normals (N, 3)."""

    points: Array
    normals: Array


@dataclass(frozen=True)
class ScanPose:
    """Orientation and arm pose of a scan.

    upright_from_file: (3, 3) rotation after which z is up and the person faces -y.
    arms: name of the arm pose, one of KNOWN_POSES.
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
    distance: median distance between the two surfaces in both directions, m.
    unlikely: Mahalanobis distance of the proportions from those of the population, the stature left out.
    far: share of the samples farther than 5 % of the stature.
    """

    body: Body
    pose: Array
    distance: float
    unlikely: float
    far: float


def surface_samples(vertices: ArrayLike, faces: ArrayLike, count: int, rng: np.random.Generator) -> ScanSamples:
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
    return ScanSamples(points, normal[chosen] / np.maximum(double[chosen], 1e-30)[:, None])


def find_stances(surface: ScanSamples, template: Body) -> list[ScanPose]:
    """Find the possible orientations and arm poses of a scan.

    surface: samples of the scan, in any unit.
    template: the body to compare with.
    Returns: all combinations, best first. Any axis may be up; z, then y are preferred where scores are similar.
    """
    step = max(1, len(surface.points) // SCAN.compared)
    points, normals = surface.points[::step], surface.normals[::step]
    models = {}
    for name in KNOWN_POSES:
        v = template.skin(known_pose(template, name))
        n = vertex_normals(v, template.coarse.faces)
        models[name] = (_boxed(v)[0], n)
    out = []
    for label in SCAN.up:
        axis = np.eye(3)["xyz".index(label[1])] * (-1 if label[0] == "-" else 1)
        upright = rotation_between(axis, np.array([0.0, 0.0, 1.0]))
        flat = (points @ upright.T)[:, :2]
        _, direction = np.linalg.eigh(np.cov((flat - flat.mean(0)).T))
        widest = np.arctan2(direction[1, 1], direction[0, 1])
        for quarter in range(SCAN.turns):
            turn = so3_exp(np.array([0, 0, -widest + quarter * np.pi / 2])) @ upright
            boxed, _ = _boxed(points @ turn.T)
            facing = normals @ turn.T
            for name, (v, n) in models.items():
                # front and back differ by little else than normals
                a, b = np.hstack([boxed, SCAN.normals * facing]), np.hstack([v, SCAN.normals * n])
                d = np.concatenate([KDTree(b).query(a)[0], KDTree(a).query(b)[0]])
                out.append(ScanPose(turn, name, float(np.minimum(d, SCAN.farthest).mean()), label))
    return sorted(out, key=lambda s: s.score * SCAN.up[s.up])


def _boxed(points: Array) -> tuple[Array, float]:
    """Scale points to height 1, with the feet at z = 0, centred over the origin; return the old height too."""
    low, high = points.min(0), points.max(0)
    height = float(high[2] - low[2])
    return (points - [*(0.5 * (low + high))[:2], low[2]]) / max(height, 1e-12), height


def fit_template(surface: ScanSamples, template: Body, stances: list[ScanPose]) -> tuple[ScanFit, ScanPose]:
    """Fit shape and pose of the template to a scan in metres.

    surface: samples of the scan.
    template: the body to fit.
    stances: as `find_stances` returns them; the first few are tried roughly, the best of these is fitted finely.
    Returns: the fit, in the frame into which the chosen stance rotates the file, and that stance.
    """
    light = replace(template, fine=template.coarse)
    trials = []
    for stance in [s for s in stances if s.score < SCAN.within * stances[0].score][: SCAN.tried]:
        points, normals = surface.points @ stance.upright_from_file.T, surface.normals @ stance.upright_from_file.T
        pose = known_pose(light, stance.arms)
        v, x = light.skin(pose), prior_mean()
        ratio = np.ptp(points[:, 2]) / np.ptp(v[:, 2])
        x[entity("scale")] = np.log(ratio)
        pose[:3] = 0.5 * (points.min(0) + points.max(0)) - 0.5 * ratio * (v.min(0) + v.max(0))
        few = _scan_term(points[:: SCAN.thinned], normals[:: SCAN.thinned])
        fit = refine_shape(light, pose[None], [[few]], options=SCAN.rough, start=x)
        trials.append((fit.cost, stance, fit, points, normals))
    _, stance, fit, points, normals = min(trials, key=lambda t: t[0])
    fit = refine_shape(light, fit.poses, [[_scan_term(points, normals)]], options=SCAN.fine, start=fit.log_factors)
    v, faces = fit.body.skin(fit.poses[0]), fit.body.coarse.faces
    own = np.concatenate([v, v[faces].mean(1)])
    gaps = np.concatenate([KDTree(points).query(own)[0], KDTree(own).query(points)[0]])
    far = float((gaps > SCAN.far * np.ptp(points[:, 2])).mean())
    off = (fit.log_factors - prior_mean())[1:]
    unlikely = float(np.sqrt(off @ np.linalg.solve(prior_covariance()[1:, 1:], off)))
    body = body_of(template, fit.log_factors)
    return ScanFit(body, fit.poses[0], float(np.median(gaps)), unlikely, far), stance


def _scan_term(points: Array, normals: Array) -> DepthTerm:
    """Describe a scan as points that six distant sensors measured, one along each axis, each those that face it.

    points, normals: (N, 3) m and (N, 3), samples of the scan.
    """
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    sensor = (normals @ axes.T).argmax(1)
    order = np.argsort(sensor, kind="stable")
    first = np.searchsorted(sensor[order], np.arange(len(axes) + 1))
    weight = np.full(len(points), SCAN.weight / len(points))
    no_maps = np.zeros((6, 1, 1), np.float32), np.ones((6, 2), np.int64), np.zeros((6, 3, 4))
    return DepthTerm(points[order], normals[order], weight, first, 1e3 * axes, *no_maps)


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
