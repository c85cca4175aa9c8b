"""A simple person whose bones keep their length, and sensors that see it with noise."""

import numpy as np

from hypose.evidence.frame import SensorJoints
from hypose.fusion import joints as jt
from hypose.geometry import so3_exp

REST = np.array(
    [
        (0, 0, 1.70), (0, 0, 1.50), (0.18, 0, 1.48), (0.20, 0, 1.18), (0.20, -0.05, 0.90), (-0.18, 0, 1.48),
        (-0.20, 0, 1.18), (-0.20, -0.05, 0.90), (0, 0, 1.25), (0.10, 0, 0.98), (0.11, 0, 0.54), (0.11, 0.03, 0.10),
        (-0.10, 0, 0.98), (-0.11, 0, 0.54), (-0.11, 0.03, 0.10),
    ]
)  # fmt: skip


def moving_person(frames, scale=1.0):
    """(T, 15, 3) m: walks to and fro, turns, swings arms and legs; bone lengths are constant."""
    t = np.arange(frames) / 30
    out = np.broadcast_to(scale * REST, (frames, 15, 3)).copy()

    def swing(joint, children, angle):
        r = so3_exp(angle[:, None] * np.array([1.0, 0, 0]))
        for c in children:
            out[:, c] = out[:, joint] + np.einsum("tij,tj->ti", r, out[:, c] - out[:, joint])

    for sign, (shoulder, elbow, hand), (hip, knee, foot) in (
        (1, (2, 3, 4), (9, 10, 11)),
        (-1, (5, 6, 7), (12, 13, 14)),
    ):
        phase = sign * np.sin(2 * np.pi * t)
        swing(elbow, [hand], -0.6 - 0.5 * phase)
        swing(shoulder, [elbow, hand], 0.5 * phase)
        swing(knee, [foot], 0.4 + 0.3 * phase)
        swing(hip, [knee, foot], -0.5 * phase)
    turn = so3_exp((0.6 * np.sin(0.7 * t))[:, None] * np.array([0, 0, 1.0]))
    out = np.einsum("tij,tnj->tni", turn, out)
    out[..., 0] += 0.3 * np.sin(0.5 * t)[:, None]
    return out


def sensor_poses(rng, sensors):
    """Rotations (K, 3, 3) and translations (K, 3): sensor_from_world."""
    r = so3_exp(rng.normal(0, 1.5, (sensors, 3)))
    return r, rng.normal(0, 2, (sensors, 3))


def seen(truth, poses, rng, noise=0.0, names=None):
    """SensorJoints per frame of sensors at poses, with normal noise (m)."""
    r, t = poses
    world = truth[:, None] + rng.normal(0, noise, (len(truth), len(r), 15, 3))
    local = np.einsum("kij,tknj->tkni", r, world) + t[:, None]
    names = names or tuple(f"s{k}" for k in range(len(r)))
    return [
        SensorJoints(local[i], np.full((len(r), 15), 2), np.full(len(r), i / 30), jt.COMMON, names)
        for i in range(len(truth))
    ]


def in_reference(truth, poses):
    """(T, 15, 3) truth in the first sensor's frame."""
    return truth @ poses[0][0].T + poses[1][0]
