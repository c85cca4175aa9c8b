"""A small body and a motion of it, made by hand: motion files need no template and no tracker."""

import numpy as np
import pytest

from hypose.body.body import Body, Landmarks, Mesh
from hypose.body.default_body import JOINT_NAMES, PARENTS, human_skeleton
from hypose.body.motion import Motion, isotropic
from scripts.fuzz_targets import write_good
from tests import missing

# joint centres of a standing adult, arms 45 degrees out, elbows a little bent; x left, y backward, z up
_LEFT = {
    "clavicle": (0.02, 0.00, 0.44),
    "shoulder": (0.18, 0.02, 0.47),
    "elbow": (0.37, 0.04, 0.28),
    "wrist": (0.54, -0.02, 0.11),
    "hip": (0.09, 0.01, -0.03),
    "knee": (0.11, 0.00, -0.44),
    "ankle": (0.12, 0.04, -0.86),
}
_MIDDLE = {
    "pelvis": (0.0, 0.0, 0.0),
    "spine": (0.0, 0.01, 0.10),
    "chest": (0.0, 0.02, 0.28),
    "neck": (0.0, 0.02, 0.52),
    "head": (0.0, -0.01, 0.62),
}


def rest_joints():
    out = []
    for name in JOINT_NAMES:
        side, _, joint = name.partition("_")
        place = np.array(_LEFT[joint] if joint else _MIDDLE[name])
        out.append(place * [-1, 1, 1] if side == "right" else place)
    return np.array(out)


def _boxes(joints):
    """One box per bone; each vertex is shared between the bone's joint and that joint's parent."""
    corner = np.array([[x, y, z] for z in (0, 1) for y in (-1, 1) for x in (-1, 1)], dtype=float)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    vertices, faces, index, weight = [], [], [], []
    for j, p in enumerate(PARENTS):
        if p < 0:
            continue
        first = 8 * len(vertices)
        a, b = joints[p], joints[j]
        w = (b - a) / np.linalg.norm(b - a)
        u = np.cross(w, np.eye(3)[np.abs(w).argmin()])
        u /= np.linalg.norm(u)
        v = np.cross(w, u)
        vertices.append(a + corner[:, :1] * 0.03 * u + corner[:, 1:2] * 0.03 * v + corner[:, 2:] * (b - a))
        faces += [(first + q[0], first + q[i], first + q[i + 1]) for q in quads for i in (1, 2)]
        index += [(p, max(PARENTS[p], 0), 0, 0)] * 8
        weight += [(0.75, 0.25, 0, 0)] * 8
    return Mesh(
        np.concatenate(vertices),
        np.array(faces, dtype=np.int32),
        np.array(index, dtype=np.int32),
        np.array(weight, dtype=np.float64),
    )


@pytest.fixture(scope="session")
def small_body():
    joints = rest_joints()
    mesh = _boxes(joints)
    marks = Landmarks(("crown",), np.array([4]), np.array([[0.0, 0.0, 0.2]]))
    return Body("small", human_skeleton(joints), mesh, mesh, marks)


@pytest.fixture(scope="session")
def small_motion(small_body):
    """60 frames at 30 fps: every dof swings within its limits, the body turns once and walks; 5 frames are lost."""
    skeleton, rng, n = small_body.skeleton, np.random.default_rng(5), 60
    times = 0.4 + np.arange(n) / 30
    phase, speed = rng.uniform(0, 2 * np.pi, skeleton.dof), rng.uniform(0.5, 2, skeleton.dof)
    swing = 0.5 * np.sin(phase + 2 * np.pi * speed * (times[:, None] - times[0]) / 2)
    middle, half = np.zeros(skeleton.dof), np.ones(skeleton.dof)
    middle[6:] = (skeleton.lower[6:] + skeleton.upper[6:]) / 2
    half[6:] = (skeleton.upper[6:] - skeleton.lower[6:]) / 2
    poses = middle + half * swing
    poses[:, 2] += 0.95
    poses[:, 5] += np.linspace(0, 2 * np.pi, n)
    lost = np.zeros(n, dtype=bool)
    lost[20:25] = True
    extrapolated = np.zeros(n, dtype=bool)
    extrapolated[30] = True
    return Motion(
        skeleton,
        times,
        skeleton.forward(poses)[1],
        poses,
        isotropic(np.full((n, 19), 0.0042)),
        lost,
        extrapolated,
        np.where(lost, 0, 4),
        np.full(n, np.nan),
        {"recipe": "test"},
    )


@pytest.fixture(scope="session")
def opensim():
    """The OpenSim library; tests that compare with it are skipped, by name, where it is not installed."""
    module = missing.module("opensim", "agreement with OpenSim", "pip install opensim")
    module.Logger.setLevelString("Error")
    return module


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A folder with a good file of every reader."""
    folder = tmp_path_factory.mktemp("good")
    write_good(folder)
    return folder
