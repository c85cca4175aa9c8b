"""Automatic rigging measured: weights against the artists', joints of scanned subjects against their truth, seconds."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from benchmarks.multiview.procedural import procedural_body
from hypose.body.body import Body
from hypose.body.default_body import JOINT_NAMES, human
from hypose.body.skin_weights import Bones, body_bones, heat_weights
from hypose.geometry import Array
from hypose.io.motions.meshes import PersonMesh
from hypose.pipeline.mesh_subject import rig_mesh
from hypose.pipeline.scan_fit import SCAN_POSES, scan_pose
from hypose.synthetic.subjects import SyntheticSubject, load_subjects

_LEGS = ((13, 14, 15), (16, 17, 18))
_ARMS = ((6, 7, 8), (10, 11, 12))
_TORSO = (0, 1, 2)


def scan_of(subject: SyntheticSubject, arms: str, noise_m: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Vertices (V, 3) m and true joints (19, 3) m of a subject as a scanner sees them: in a pose of SCAN_POSES with
    every limb some degrees off it (5 sd), and noise on the vertices (1 sd)."""
    body = human()
    s = body.skeleton
    pose = scan_pose(body, arms)
    moving = s.dofs_of(*(f"{side}_{k}" for side in ("left", "right") for k in ("shoulder", "elbow", "hip", "knee")))
    pose[moving] += np.radians(5) * rng.standard_normal(len(moving))
    rotations, _ = s.forward(s.clamp(pose))
    vertices = subject.skin(rotations, np.zeros(3))
    return vertices + noise_m * rng.standard_normal(vertices.shape), subject.place_joints(rotations, np.zeros(3))


def weight_rows(
    case: str, weights: Array, body_weights: Array, vertices: Array, joints: Array, faces: NDArray[np.int32]
) -> list[Row]:
    """Quality of weights (V, 19) on vertices (V, 3) with joints (19, 3), compared with reference weights (V, 19)."""
    w, own = weights, body_weights
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    jump = 0.5 * np.abs(w[edges[:, 0]] - w[edges[:, 1]]).sum(1)
    other, torso = [], []
    for k in range(2):
        leg = own[:, list(_LEGS[k])].sum(1) > 0.9
        below = vertices[:, 2] < joints[_LEGS[k][0], 2] - 0.2
        other.append(w[np.ix_(leg & below, _LEGS[1 - k])].sum(1))
        far = np.linalg.norm(vertices - joints[_ARMS[k][0]], axis=1) > 0.2
        torso.append(w[np.ix_((own[:, list(_TORSO)].sum(1) > 0.9) & far, _ARMS[k])].sum(1))
    return [
        row("largest error of the weights' sum", case, np.abs(w.sum(1) - 1).max(), "1"),
        row("smallest weight", case, w.min(), "1"),
        row("mean change of weight along an edge", case, jump.mean(), "share"),
        row("largest change of weight along an edge", case, jump.max(), "share"),
        row(
            "other leg's weight on a leg, 20 cm below the hip joint, largest",
            case,
            np.concatenate(other).max(),
            "share",
        ),
        row("arms' weight on the torso, 20 cm from the shoulder, mean", case, np.concatenate(torso).mean(), "share"),
        row("arms' weight on the torso, 20 cm from the shoulder, largest", case, np.concatenate(torso).max(), "share"),
        row("mean absolute difference from the reference weights", case, np.abs(w - own).mean(), "share"),
        row("same main joint as the reference", case, (w.argmax(1) == own.argmax(1)).mean(), "share"),
    ]


def _subject_bones(subject: SyntheticSubject) -> Bones:
    """The template's bones moved to a subject's own joints."""
    body = human()
    bones, rest = body_bones(body), body.skeleton.rest_joints
    k = subject.stature / body.stature
    shift = subject.joints[bones.joint] - rest[bones.joint] * k
    start, end = bones.start * k + shift, bones.end * k + shift
    # where a bone ends in a joint it ends in the subject's
    for b in range(len(end)):
        near = np.linalg.norm(rest - bones.end[b], axis=1)
        if near.min() < 1e-6:
            end[b] = subject.joints[int(near.argmin())]
    return Bones(start, end, bones.joint)


def rigging(options: BenchOptions) -> BenchReport:
    """Weights on template, procedural body and two subjects; joints and seconds of rigged scans in every pose."""
    rows: list[Row] = []
    bodies: list[tuple[str, Body]] = [("template", human()), ("procedural body", procedural_body())]
    for case, body in bodies:
        mesh = body.fine
        w = heat_weights(mesh.vertices, mesh.faces, body_bones(body), len(JOINT_NAMES))
        seconds = []
        for _ in range(1 if options.quick else 4):
            begin = time.perf_counter()
            heat_weights(mesh.vertices, mesh.faces, body_bones(body), len(JOINT_NAMES))
            seconds.append(time.perf_counter() - begin)
        rows += weight_rows(case, w, mesh.dense_weights(19), mesh.vertices, body.skeleton.rest_joints, mesh.faces)
        rows.append(row(f"heat weights of {len(mesh.vertices)} vertices", case, min(seconds), "s"))
    subjects = load_subjects()
    for name in ("slim", "heavy"):
        s = subjects[name]
        w = heat_weights(s.vertices, s.faces, _subject_bones(s), len(JOINT_NAMES))
        rows += weight_rows(f"subject {name}", w, s.dense_weights, s.vertices, s.joints, s.faces)
    chosen = list(subjects)[: options.seeds or (2 if options.quick else 8)]
    poses = SCAN_POSES[:3]
    for p, arms in enumerate(poses):
        mean, largest, seconds, girth = [], [], [], []
        for k, name in enumerate(chosen):
            options.progress(f"rigging scans in the pose {arms}", p * len(chosen) + k, len(poses) * len(chosen))
            rng = np.random.default_rng([p, k])
            vertices, joints = scan_of(subjects[name], arms, 0.003, rng)
            begin = time.perf_counter()
            rigged = rig_mesh(PersonMesh(vertices, subjects[name].faces))
            seconds.append(time.perf_counter() - begin)
            truth = joints @ rigged.upright_from_file.T
            error = np.linalg.norm(rigged.body.joints(rigged.pose) - truth, axis=1)
            mean.append(error.mean() * 100)
            largest.append(error.max() * 100)
            girth.append(abs(rigged.body.coarse.volume / rigged.body.fine.volume - 1))
        case = f"{len(chosen)} scans, pose {arms}, noise 3 mm"
        rows.append(row("joints, mean error", case, mean, "cm"))
        rows.append(row("joints, largest error", case, largest, "cm"))
        rows.append(row("whole rigging", case, seconds, "s"))
        rows.append(row("volume lost by the coarse mesh", case, girth, "share"))
    return BenchReport(tuple(rows), {"subjects": chosen, "poses": list(poses)})
