"""Make body scans of synthetic subjects: their pose and the noise of a scanner."""

from __future__ import annotations

import numpy as np

from hypose.body.default_body import human
from hypose.geometry import Array
from hypose.synthetic.subjects import SyntheticSubject
from hypose.tracking.start_search import known_pose


def scan_of(subject: SyntheticSubject, arms: str, noise_m: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Vertices (V, 3) m and true joints (19, 3) m of a subject as a scanner sees them: in a pose of KNOWN_POSES with
    every limb some degrees off it (5 sd), and noise on the vertices (1 sd)."""
    body = human()
    s = body.skeleton
    pose = known_pose(body, arms)
    moving = s.dofs_of(*(f"{side}_{k}" for side in ("left", "right") for k in ("shoulder", "elbow", "hip", "knee")))
    pose[moving] += np.radians(5) * rng.standard_normal(len(moving))
    rotations, _ = s.forward(s.clamp(pose))
    vertices = subject.skin(rotations, np.zeros(3))
    return vertices + noise_m * rng.standard_normal(vertices.shape), subject.place_joints(rotations, np.zeros(3))
