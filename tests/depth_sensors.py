"""A walking stick person, and sensors around it that report its joints with their own clocks."""

import numpy as np

from hypose.evidence.frame import SensorReport
from hypose.fusion.joints import COMMON
from hypose.geometry import se3, so3_exp, transform

# z up, facing -y, left = +x
REST = np.array(
    [[0, 0, 1.65], [0, 0, 1.45], [0.18, 0, 1.4], [0.22, 0, 1.1], [0.24, -0.05, 0.85], [-0.18, 0, 1.4], [-0.22, 0, 1.1]]
    + [[-0.24, -0.05, 0.85], [0, 0, 1.15], [0.1, 0, 0.95], [0.11, -0.02, 0.5], [0.11, 0, 0.08], [-0.1, 0, 0.95]]
    + [[-0.11, -0.02, 0.5], [-0.11, 0, 0.08]]
)


def walker(t, place=(0.0, 0.0), phase=0.0):
    """(15, 3) m in the world: arms and legs swing (bones keep their lengths), the person turns and sways."""
    joints, swing = REST.copy(), 0.6 * np.sin(2 * np.pi * 0.9 * t + phase)
    for sign, limbs in ((1, ((2, 3, 4), (12, 13, 14))), (-1, ((5, 6, 7), (9, 10, 11)))):
        for root, middle, end in limbs:
            turn = so3_exp([sign * swing, 0, 0])
            upper, lower = REST[middle] - REST[root], REST[end] - REST[middle]
            joints[middle] = joints[root] + turn @ upper
            joints[end] = joints[middle] + turn @ so3_exp([-0.3 if end in (4, 7) else 0.3, 0, 0]) @ lower
    turn = so3_exp([0, 0, 0.5 * np.sin(0.4 * t + phase)])
    sway = np.array([place[0] + 0.3 * np.sin(0.5 * t + phase), place[1] + 0.2 * np.cos(0.6 * t + phase), 0.0])
    return joints @ turn.T + sway


def camera(degrees, distance=3.0, height=1.2):
    """camera_from_world (4, 4), looking at the origin's person; 0 = from the front."""
    a = np.radians(degrees)
    eye = np.array([np.sin(a) * distance, -np.cos(a) * distance, height])
    z = np.array([0, 0, 1.0]) - eye
    z /= np.linalg.norm(z)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    r = np.stack([x, np.cross(z, x), z])
    return se3(r, -r @ eye)


def places(people):
    return [(1.5 * (p % 3 - 1), 1.5 * (p // 3)) for p in range(people)] if people > 1 else [(0.0, 0.0)]


def reports(rng, seconds, angles=(0, 60, -60), people=1, rate=30.0, noise=0.008, silent=(), epochs=None):
    """Reports in order of arrival. silent: (sensor, from, to) during which a sensor is dead; epochs: {sensor: [(from,
    clock's reading at t = 0)]}: its clock from then on."""
    out = []
    for k, angle in enumerate(angles):
        view, phase = camera(angle), rng.uniform(0, 1 / rate)
        drift = 1 + 5e-5 * rng.normal()
        for n in range(int(seconds * rate)):
            t = phase + n / rate
            if any(s == k and a <= t < b for s, a, b in silent):
                continue
            epoch = [e for start, e in (epochs or {}).get(k, [(0.0, 1000.0 * k)]) if t >= start][-1]
            arrival = t + 0.002 + rng.exponential(0.002)
            for p in rng.permutation(people):
                joints = walker(t, places(people)[p], 1.3 * p) + noise * rng.normal(size=(15, 3))
                state = np.full(15, 2, dtype=np.uint8)
                positions = transform(view, joints)
                # every sensor numbers persons in its own way
                out.append(SensorReport(f"s{k}", epoch + t * drift, int(p + 10 * k), COMMON, positions, state, arrival))
    return sorted(out, key=lambda r: r.arrival)
