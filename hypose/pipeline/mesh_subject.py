"""Turn a person's scan, avatar or body model into a trackable body: upright, in metres, with joints, weights and a
coarse mesh.

The scan's pose is removed: the body rests in the template's rest pose, so limits, priors and named poses hold.

The joints inside a scan without a rig are those of the template body, fitted to the scan in shape and pose. First the
up axis, the facing direction and the pose of the arms are found by comparing the template in every combination with
samples of the scan. Then the best few are refined like the shape of a tracked person (`tracking.shape_refinement`): the
scan counts as a depth map from all sides.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from hypose.body.anthropometry import body_of, entity, prior_covariance, prior_mean
from hypose.body.body import Body, Landmarks, Mesh
from hypose.body.default_body import human
from hypose.body.joint_names import match_rig
from hypose.body.skin_weights import (
    body_bones,
    carried_weights,
    coarse_mesh,
    decimated,
    heat_weights,
    influences,
    vertex_normals,
)
from hypose.errors import EvidenceError, InputError
from hypose.evidence.terms import DepthTerm, PointTerm
from hypose.fitting.articulated import SolveSettings, fit_pose
from hypose.geometry import Array, rotation_between, so3_exp
from hypose.io.files import text_of
from hypose.io.motions.meshes import PersonMesh, closed_surface, read_person
from hypose.io.motions.results import save_body
from hypose.pipeline.settings import SETTINGS
from hypose.tracking.refinement import anatomical_prior
from hypose.tracking.shape_refinement import ShapeSettings, refine_shape
from hypose.tracking.start_search import KNOWN_POSES, known_pose

# ---- the template in a scan -----------------------------------------------------------------------------------------


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
        models[name] = (_boxed(v), n)
    out = []
    for label in SCAN.up:
        axis = np.eye(3)["xyz".index(label[1])] * (-1 if label[0] == "-" else 1)
        upright = rotation_between(axis, np.array([0.0, 0.0, 1.0]))
        flat = (points @ upright.T)[:, :2]
        _, direction = np.linalg.eigh(np.cov((flat - flat.mean(0)).T))
        widest = np.arctan2(direction[1, 1], direction[0, 1])
        for quarter in range(SCAN.turns):
            turn = so3_exp(np.array([0, 0, -widest + quarter * np.pi / 2])) @ upright
            boxed = _boxed(points @ turn.T)
            facing = normals @ turn.T
            for name, (v, n) in models.items():
                # front and back differ by little else than normals
                a, b = np.hstack([boxed, SCAN.normals * facing]), np.hstack([v, SCAN.normals * n])
                d = np.concatenate([KDTree(b).query(a)[0], KDTree(a).query(b)[0]])
                out.append(ScanPose(turn, name, float(np.minimum(d, SCAN.farthest).mean()), label))
    return sorted(out, key=lambda s: s.score * SCAN.up[s.up])


def _boxed(points: Array) -> Array:
    """Scale points to height 1, with the feet at z = 0, centred over the origin."""
    low, high = points.min(0), points.max(0)
    return (points - [*(0.5 * (low + high))[:2], low[2]]) / max(high[2] - low[2], 1e-12)


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

    pose: (D,) pose of the surface.
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


# ---- bodies from meshes ---------------------------------------------------------------------------------------------


_UNITS = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}


@dataclass(frozen=True)
class MeshSubject:
    """Trackable body made from a person's mesh.

    body: the body.
    pose: (D,) pose of the scan in the upright frame; the skinned fine mesh in this pose is the scan's surface.
    upright_from_file: (3, 3) turns the file's coordinates upright and scales them to metres.
    distance: median distance of template and scan, m; None for a mesh with its own rig.
    notes: sentences on what was done.
    """

    body: Body
    pose: Array
    upright_from_file: Array
    distance: float | None
    notes: tuple[str, ...]


def subject_from_mesh(
    mesh: str | Path, out: str | Path, *, unit: str = "m", height: float | None = None
) -> MeshSubject:
    """Rig a person's mesh file, and write the body to out/body.npz, like `hypose subject --mesh`.

    unit: unit of the coordinates: m, dm, cm, mm, in or ft.
    height: stature (arms down), m, to which the person is scaled; None: the unit counts.
    Returns: the body and its pose in the scan.
    """
    subject = rig_mesh(mesh, unit=unit, height=height)
    save_body(subject.body, Path(out) / "body.npz")
    return subject


def rig_mesh(mesh: str | Path | PersonMesh | Mesh, *, unit: str = "m", height: float | None = None) -> MeshSubject:
    """Rig a person's mesh; joints and weights of a skinned file are kept.

    mesh: file (OBJ, PLY, STL, GLB, SMPL npz) or mesh in memory.
    unit: unit of the coordinates: m, dm, cm, mm, in or ft.
    height: stature (arms down), m; scales the person whatever the unit.
    Raises: InputError names the cause (open surface, in parts, unit, pose) and the next step.
    """
    if unit not in _UNITS:
        raise InputError(f"There is no unit {unit!r}; the units are {', '.join(_UNITS)}.")
    least, most = SETTINGS.mesh_statures
    if height is not None and not least <= height <= most:
        raise InputError(f"A height of {height} m was given; it must lie between {least} and {most} m.")
    if isinstance(mesh, Mesh):
        person = PersonMesh(np.asarray(mesh.vertices, dtype=np.float64), mesh.faces)
    else:
        person = mesh if isinstance(mesh, PersonMesh) else read_person(mesh)
    if person.rig is not None:
        return _with_own_rig(person, unit, height)
    return _with_new_rig(closed_surface(person), unit, height)


# ---- a mesh without a skin ---------------------------------------------------------------------------------


def _with_new_rig(person: PersonMesh, unit: str, height: float | None) -> MeshSubject:
    template = human()
    surface = surface_samples(person.vertices, person.faces, SETTINGS.mesh_samples, np.random.default_rng(0))
    stances = find_stances(surface, template)
    upright = person.vertices @ stances[0].upright_from_file.T
    extent = float(np.ptp(upright[:, 2]))
    scale = _metres(extent, person.source, unit, height)
    fit, stance = fit_template(replace(surface, points=surface.points * scale), template, stances)
    if height is not None:
        # arms above the head reach higher than the stature: scale again by the fitted body
        again = height / fit.body.stature
        if abs(np.log(again)) > 0.01:
            scale *= again
            fit, stance = fit_template(replace(surface, points=surface.points * scale), template, stances)
    _check_fit(fit, stance, person.source)
    notes = [*person.notes, *_stance_notes(stance, unit, height)]
    vertices = person.vertices @ stance.upright_from_file.T * scale
    faces = person.faces
    if len(vertices) > SETTINGS.mesh_fine_vertices:
        notes.append(f"the display mesh has {SETTINGS.mesh_fine_vertices // 2} of the scan's {len(vertices)} vertices")
        vertices, faces = decimated(vertices, faces, SETTINGS.mesh_fine_vertices // 2)
    weights = heat_weights(vertices, faces, body_bones(fit.body, fit.pose), len(template.skeleton.joint_names))
    names = template.skeleton.joint_names
    body = _assembled(person, fit.body, fit.pose, vertices, faces, weights)
    notes.append(
        f"{body.stature:.2f} m tall, scanned in the pose {stance.arms!r}; the template lies "
        f"{1e3 * fit.distance:.0f} mm from the surface (median), {len(names)} joints placed"
    )
    return MeshSubject(body, fit.pose, stance.upright_from_file * scale, fit.distance, tuple(notes))


def _assembled(
    person: PersonMesh,
    frame: Body,
    pose: Array,
    vertices: Array,
    faces: np.ndarray,
    weights: Array,
) -> Body:
    """Build the body on the skeleton of `frame` from a surface in a pose, with dense weights (V, J)."""
    rough, rough_faces = coarse_mesh(vertices, faces, SETTINGS.mesh_coarse)
    rough_weights = carried_weights(rough, vertex_normals(rough, rough_faces), vertices, faces, weights)
    meshes = []
    for v, f, w in ((rough, rough_faces, rough_weights), (vertices, faces, weights)):
        posed = Mesh(v, np.asarray(f, dtype=np.int32), *influences(w))
        meshes.append(replace(posed, vertices=unposed(frame, pose, v, posed.dense_weights(w.shape[1]))))
    name = text_of(Path(person.source).stem) if person.source != "The mesh" else "own body"
    return Body(name, frame.skeleton, meshes[0], meshes[1], frame.landmarks)


def _metres(extent: float, source: str, unit: str, height: float | None) -> float:
    """Return metres per unit of the file.

    extent: height of the mesh in the file's units.
    Raises: InputError suggests the unit.
    """
    if not extent > 0:
        raise InputError(f"{source} is flat: its height is 0; export the scan again.")
    if height is not None:
        return height / extent
    scale = _UNITS[unit]
    low, high = SETTINGS.mesh_statures
    if low <= extent * scale <= high:
        return scale
    fitting = [u for u, s in _UNITS.items() if low <= extent * s <= high]
    metric = [u for u in fitting if u in ("m", "dm", "cm", "mm")] or fitting
    tall = extent * scale
    shown = f"{tall:.3g} m" if tall >= 0.01 else f"{1e3 * tall:.3g} mm"
    advice = (
        f"its coordinates seem to be in {metric[0]}: give the unit {metric[0]!r}"
        if metric
        else "no usual unit makes that a person: give the person's height instead of a unit"
    )
    raise InputError(f"{source}: in {unit} the person would be {shown} tall; {advice}.")


def _check_fit(fit: ScanFit, stance: ScanPose, source: str) -> None:
    if fit.far <= SETTINGS.mesh_most_far and fit.distance < 0.02 * fit.body.stature and fit.unlikely < SCAN.unlikely:
        return
    raise InputError(
        f"{source} does not look like one person in any known pose: {fit.far:.0%} of the surfaces lie more than "
        f"{5 * fit.body.stature:.0f} cm apart (stance tried: {stance.up} up, arms {stance.arms!r}); scan the "
        f"person alone, upright, arms away from the body ({', '.join(KNOWN_POSES)})."
    )


def _stance_notes(stance: ScanPose, unit: str, height: float | None) -> list[str]:
    notes = []
    if unit != "m" and height is None:
        notes.append(f"coordinates in {unit} became metres")
    if height is not None:
        notes.append(f"scaled to the height given, {height:.2f} m")
    if stance.up != "+z":
        notes.append(f"the file has {stance.up} up; it was turned so that z is up")
    forward = stance.upright_from_file.T @ np.array([0.0, -1.0, 0.0])
    axis = int(np.abs(forward).argmax())
    notes.append(f"the person looks towards {'-' if forward[axis] < 0 else '+'}{'xyz'[axis]} of the file")
    return notes


# ---- a mesh with joints and weights of its own -------------------------------------------------------------


def _with_own_rig(person: PersonMesh, unit: str, height: float | None) -> MeshSubject:
    rig = person.rig
    assert rig is not None
    before = len(person.vertices)
    person = closed_surface(person)
    assert person.rig is not None
    matched = match_rig(rig.names, rig.parents, rig.joints, person.rig.weights, person.source)
    turn, up = _upright(matched.joints)
    extent = float(np.ptp(person.vertices @ turn[2]))
    scale = _metres(extent, person.source, unit, height)
    vertices = person.vertices @ turn.T * scale
    joints = matched.joints @ turn.T * scale
    frame, pose = _pose_from_joints(joints, vertices)
    notes = [*person.notes, *_stance_notes(ScanPose(turn, "", 0.0, up), unit, height)]
    weights, faces = matched.weights, person.faces
    if len(vertices) > 2 * SETTINGS.mesh_fine_vertices:
        notes.append(f"the display mesh has {SETTINGS.mesh_fine_vertices // 2} of the file's {before} vertices")
        small, small_faces = decimated(vertices, faces, SETTINGS.mesh_fine_vertices // 2)
        weights = carried_weights(small, vertex_normals(small, small_faces), vertices, faces, weights)
        vertices, faces = small, small_faces
    body = _assembled(person, frame, pose, vertices, faces, weights)
    notes.append(f"{body.stature:.2f} m tall; joints and weights are the file's ({len(rig.names)} joints)")
    if matched.absent:
        notes.append(f"the rig lacks {', '.join(matched.absent)}: placed by proportion, they carry no skin")
    return MeshSubject(body, pose, turn * scale, None, tuple(notes))


def _upright(joints: Array) -> tuple[Array, str]:
    """Compute the rotation that turns joints (19, 3) so that z is up and the person faces -y, and name the file's up
    axis.
    """
    names = human().skeleton.joint_names

    def at(*which: str) -> Array:
        return np.mean([joints[names.index(n)] for n in which], axis=0)

    up = at("head") - at("left_ankle", "right_ankle")
    up = up / np.linalg.norm(up)
    axis = int(np.abs(up).argmax())
    label = f"{'-' if up[axis] < 0 else '+'}{'xyz'[axis]}"
    if abs(up[axis]) > np.cos(np.radians(12)):  # a person leans a little; the file's axis is the vertical
        up = np.sign(up[axis]) * np.eye(3)[axis]
    left = at("left_hip", "left_shoulder") - at("right_hip", "right_shoulder")
    left = left - (left @ up) * up
    left = left / np.linalg.norm(left)
    return np.stack([left, np.cross(up, left), up]), label


def _pose_from_joints(joints: Array, vertices: Array) -> tuple[Body, Array]:
    """Fit the template to joints (19, 3) m: bones of their length, and the pose (D,) in which it has exactly these
    joints.
    """
    template = human()
    s = template.skeleton
    parents = s.parents
    has = parents >= 0
    offsets = s.rest_offsets.copy()
    own = np.linalg.norm(s.rest_offsets[has], axis=1)
    there = np.linalg.norm(joints[has] - joints[parents[has]], axis=1)
    offsets[has] *= (there / own)[:, None]
    sized = replace(template, skeleton=replace(s, rest_offsets=offsets))
    start = s.rest_pose()
    start[:3] = joints[0]
    term = PointTerm(joints, np.ones(len(joints)), np.arange(len(joints)), np.zeros_like(joints), 0.02)
    fit = fit_pose(
        sized,
        start,
        [term],
        priors=(anatomical_prior(s),),
        options=SolveSettings(iterations=60, coarse_iterations=10),
    )
    rotations, _ = s.forward(fit.pose)
    rest = np.zeros_like(offsets)
    for j in np.flatnonzero(has):
        rest[j] = rotations[parents[j]].T @ (joints[j] - joints[parents[j]])
    apart = np.linalg.norm(joints - sized.joints(fit.pose), axis=1).max()
    if apart > 0.25 * float(np.ptp(vertices[:, 2])):
        raise EvidenceError(
            f"The rig's joints lie up to {apart:.2f} m from those of a person in any pose; rig the mesh "
            "again without its skin."
        )
    pose = fit.pose.copy()
    pose[:3] = joints[0]
    k = float(np.ptp(vertices[:, 2])) / template.stature
    marks = Landmarks(template.landmarks.names, template.landmarks.joint, template.landmarks.offset * k)
    return replace(template, skeleton=replace(s, rest_offsets=rest), landmarks=marks), pose
