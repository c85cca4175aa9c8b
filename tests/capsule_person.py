"""A small test body that needs no asset: capsules around the human skeleton's bones, one closed mesh."""

from functools import lru_cache

import numpy as np
from skimage.measure import marching_cubes

from hypose.body.body import Body, Landmarks, Mesh
from hypose.body.default_body import JOINT_NAMES, human_skeleton

LEFT = {
    "clavicle": (0.03, 0.0, 0.42),
    "shoulder": (0.17, 0.02, 0.43),
    "elbow": (0.42, 0.03, 0.40),
    "wrist": (0.66, -0.03, 0.38),
    "hip": (0.09, 0.0, -0.05),
    "knee": (0.11, -0.01, -0.46),
    "ankle": (0.12, 0.02, -0.87),
}
MIDDLE = {
    "pelvis": (0, 0, 0),
    "spine": (0, 0.01, 0.10),
    "chest": (0, 0.02, 0.25),
    "neck": (0, 0.02, 0.50),
    "head": (0, 0, 0.58),
}
CAPSULES = [
    ("pelvis", "spine", 0.13),
    ("spine", "chest", 0.13),
    ("chest", "neck", 0.12),
    ("neck", "head", 0.06),
    *(
        (f"{s}_{a}", f"{s}_{b}", r)
        for s in ("left", "right")
        for a, b, r in (
            ("shoulder", "elbow", 0.055),
            ("elbow", "wrist", 0.045),
            ("hip", "knee", 0.08),
            ("knee", "ankle", 0.06),
        )
    ),
    ("chest", "left_shoulder", 0.075),
    ("chest", "right_shoulder", 0.075),
]


def rest_joints():
    out = dict(MIDDLE)
    for name, p in LEFT.items():
        out[f"left_{name}"], out[f"right_{name}"] = p, (-p[0], p[1], p[2])
    return np.array([out[n] for n in JOINT_NAMES], dtype=np.float64)


@lru_cache(maxsize=2)
def capsule_person(pitch: float = 0.055) -> Body:
    """A person of capsules; 826 vertices at the default pitch (m)."""
    j = rest_joints()
    at = {n: j[k] for k, n in enumerate(JOINT_NAMES)}
    pieces = [(at[a], at[b], r, JOINT_NAMES.index(a)) for a, b, r in CAPSULES]
    pieces.append((at["head"], at["head"] + [0, -0.01, 0.12], 0.10, JOINT_NAMES.index("head")))
    for s in ("left", "right"):
        foot, hand = at[f"{s}_ankle"], at[f"{s}_wrist"]
        pieces.append((foot + [0, 0, -0.03], foot + [0, -0.15, -0.04], 0.05, JOINT_NAMES.index(f"{s}_ankle")))
        pieces.append(
            (hand, hand + 0.12 * np.sign(hand[0]) * np.array([1.0, -0.1, 0]), 0.04, JOINT_NAMES.index(f"{s}_wrist"))
        )

    def distances(points):
        out = np.empty((len(points), len(pieces)))
        for k, (a, b, r, _) in enumerate(pieces):
            t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
            out[:, k] = np.linalg.norm(points - a - t[:, None] * (b - a), axis=1) - r
        return out

    axes = [np.arange(lo, hi, pitch) for lo, hi in ((-0.95, 0.95), (-0.3, 0.3), (-1.05, 0.9))]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    field = distances(grid.reshape(-1, 3)).min(1).reshape(grid.shape[:3])
    v, f, _, _ = marching_cubes(field, 0.0, gradient_direction="ascent")
    v = v * pitch + [a[0] for a in axes]
    near = distances(v)
    weights = np.zeros((len(v), len(JOINT_NAMES)))
    for k, piece in enumerate(pieces):
        weights[:, piece[3]] += np.exp(-near[:, k] / 0.015)
    order = np.argsort(-weights, 1)[:, :4]
    w = np.take_along_axis(weights, order, 1)
    w[w < 0.05 * w[:, :1]] = 0
    mesh = Mesh(v, f.astype(np.int32), order.astype(np.int32), w / w.sum(1, keepdims=True))
    if mesh.volume < 0:
        mesh = Mesh(v, f[:, ::-1].astype(np.int32).copy(), mesh.skin_index, mesh.skin_weight)
    return Body("capsules", human_skeleton(j), mesh, mesh, Landmarks((), np.zeros(0, np.int64), np.zeros((0, 3))))


def look_at(position, target, f, size):
    """camera_from_world (4, 4) and K (3, 3) of a camera at position (3,) that looks at target (3,), z up."""
    z = np.subtract(target, position)
    z = z / np.linalg.norm(z)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    r = np.stack([x, np.cross(z, x), z])
    m = np.eye(4)
    m[:3, :3], m[:3, 3] = r, -r @ position
    return m, np.array([[f, 0, size[0] / 2 - 0.5], [0, f, size[1] / 2 - 0.5], [0, 0, 1.0]])


def ring(n, f=320.0, size=(320, 240), radius=3.2, height=1.2, target=(0, 0, 0.95)):
    """A rig of n cameras on a circle."""
    from hypose.cameras.camera import Camera, CameraRig

    cameras = []
    for k in range(n):
        a = 0.4 + 2 * np.pi * k / n
        m, kk = look_at((radius * np.cos(a), radius * np.sin(a), height), target, f, size)
        cameras.append(Camera(f"cam{k + 1}", kk, np.zeros(5), m, size))
    return CameraRig(tuple(cameras))


def random_pose(body, rng, spread=0.3):
    """A pose near standing upright at the origin, inside the limits."""
    s = body.skeleton
    q = rng.normal(size=s.dof) * spread
    q[:3] = [0.05 * q[0], 0.05 * q[1], 0.95]
    q[3:5] *= 0.3
    return s.clamp(q)
