"""Measure automatic rigging: joints of scanned subjects against their truth, and seconds."""

from __future__ import annotations

import time

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from hypose.body.default_body import human
from hypose.body.fit_skeleton import SCAN_POSES, scan_pose
from hypose.geometry import Array
from hypose.io.motions.meshes import PersonMesh
from hypose.pipeline.mesh_subject import rig_mesh
from hypose.synthetic.subjects import SyntheticSubject, load_subjects


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


def rigging(options: BenchOptions) -> BenchReport:
    """Joints and seconds of rigged scans in every pose."""
    rows, subjects = list[Row](), load_subjects()
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
