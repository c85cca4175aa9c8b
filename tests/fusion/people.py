"""A simple person whose bones keep their length, and sensors that see it with noise."""

import numpy as np

from hypose.evidence.frame import SensorJoints
from hypose.fusion import joints as jt
from hypose.geometry import so3_exp
from tests.depth_sensors import walker


def moving_person(frames, scale=1.0):
    """(T, 15, 3) m: walks to and fro, turns, swings arms and legs; bone lengths are constant."""
    return scale * np.stack([walker(t / 30) for t in range(frames)])


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
