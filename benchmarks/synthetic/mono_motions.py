"""Motions of the single-camera scenes: an arm that reaches across everything, whole bodies, a nearly straight knee."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from benchmarks.synthetic.retarget import retarget
from hypose.body.default_body import JOINT_NAMES
from hypose.errors import InputError
from hypose.synthetic.motions import act
from hypose.synthetic.performance import (
    Angles,
    Performance,
    Stance,
    assemble,
    global_rotations,
    hanging_from_rest,
    joint_rotations,
    perform,
    turn,
)
from hypose.synthetic.subjects import SyntheticSubject

# key poses of the right arm, degrees: flexion, abduction and inward turn of the shoulder, elbow, twist of the forearm,
# bend and deviation of the wrist
_REACH = np.array(
    [
        [8, 18, 10, 35, 0, 0, 0],
        [25, 40, 20, 70, 25, 15, 0],
        [55, 15, 45, 85, 35, 10, 8],
        [75, -12, 55, 60, 10, -10, 0],
        [85, 5, 30, 95, -15, 15, -8],
        [60, 45, 10, 75, -20, 20, 5],
        [30, 60, 5, 45, 0, 0, 0],
    ],
    dtype=np.float64,
)
_SPREAD_DEG = 6.0


def arm_reach(subject: SyntheticSubject, seconds: float, frame_rate: float, rng: np.random.Generator) -> Performance:
    """The right arm of somebody who stands still: across the trunk and the face, out past the pillar, and back the same
    way in the second half (the published sequence ends with the reversed way)."""
    n = round(seconds * frame_rate)
    times = np.arange(n) / frame_rate
    keys = _REACH + rng.normal(0, _SPREAD_DEG, _REACH.shape)
    phase = 1 - np.abs(2 * times / times[-1] - 1)  # there and back
    at = phase * (len(keys) - 1)
    curve = gaussian_filter1d(PchipInterpolator(np.arange(len(keys)), keys)(at), 2.5, axis=0, mode="nearest")
    flexion, abduction, inward, elbow, twist, bend, deviation = (np.asarray(c) for c in curve.T)
    relaxed = {"left_shoulder_abduction": 9.0, "left_shoulder_internal": 12.0, "left_elbow_flexion": 18.0}
    values = {k: np.full(n, v) for k, v in relaxed.items()}
    values |= {
        "right_shoulder_flexion": flexion,
        "right_shoulder_abduction": abduction,
        "right_shoulder_internal": inward,
        "right_elbow_flexion": elbow,
    }
    still = perform(Angles("reach", times, values, Stance()), subject)
    local = joint_rotations(Angles("reach", times, values))
    elbow_joint, wrist = JOINT_NAMES.index("right_elbow"), JOINT_NAMES.index("right_wrist")
    local[:, elbow_joint] = local[:, elbow_joint] @ turn(2, twist)
    local[:, wrist] = turn(0, -bend) @ turn(1, deviation)
    moving = global_rotations(local) @ hanging_from_rest(subject)
    rotations = still.rotations.copy()
    rotations[:, [elbow_joint, wrist]] = moving[:, [elbow_joint, wrist]]
    return assemble("reach", subject, times, rotations, still.root)


# what the seed chooses from: files and start (s) of captured motion, or built-in motions
_CAPTURED = {"captured-walk": ("02_01", 0.5), "captured-punch": ("02_05", 2.5), "captured-punch-2": ("02_05", 7.0)}
_BUILT_IN = ("box", "wave", "cross_arms", "serve", "walk", "punch")
STRAIGHT_KNEE = "straight-knee"


def body_motion(
    name: str, subject: SyntheticSubject, seconds: float, frame_rate: float, seed: int, mocap: Path | None
) -> Performance:
    """A motion of a whole body by name: captured-walk, captured-punch, captured-punch-2 (need the folder `mocap` with
    CMU's subject 02), a built-in one (motions.MOTIONS), or 'straight-knee'; '' lets the seed choose, captured ones in
    two of three seeds when there is a folder."""
    long = seconds > 2.5  # the captured walk is over by then
    if not name:
        captured = [k for k in _CAPTURED if not (long and k == "captured-walk")] if mocap is not None else []
        if captured and seed % 3 < 2:
            name = captured[(seed - seed // 3) % len(captured)]
        else:
            still = _BUILT_IN[:4] if long else _BUILT_IN
            name = still[(seed // 3 if captured else seed) % len(still)]
    rng = np.random.default_rng([seed, 50])
    if name == STRAIGHT_KNEE:
        return _straight_knee(subject, seconds, frame_rate, rng)
    if name not in _CAPTURED:
        return act(name, subject, seconds, frame_rate, rng)
    if mocap is None:
        raise InputError(f"The motion {name} needs the folder of captured motions (02.asf, 02_01.amc, 02_05.amc).")
    file, start = _CAPTURED[name]
    start += float(rng.uniform(0.0, 0.6))
    return retarget(mocap / "02.asf", mocap / f"{file}.amc", subject, frame_rate, start=start, seconds=seconds)


def _straight_knee(
    subject: SyntheticSubject, seconds: float, frame_rate: float, rng: np.random.Generator
) -> Performance:
    """The left leg swings forward and back with a knee that stays between 0 and 8 degrees, so that the image alone
    would often rather bend it the wrong way."""
    times = np.arange(round(seconds * frame_rate)) / frame_rate
    swing = np.sin(2 * np.pi * (times / 1.2 + rng.uniform(-0.1, 0.1)))
    values = {
        "left_hip_flexion": 22 + 30 * swing,
        "left_knee_flexion": 4 - 4 * swing,
        "right_knee_flexion": np.full(len(times), 3.0),
        "left_shoulder_flexion": -12 * swing,
        "right_shoulder_flexion": 12 * swing,
    }
    for side in ("left", "right"):
        values[f"{side}_shoulder_abduction"] = np.full(len(times), 14.0)
        values[f"{side}_elbow_flexion"] = np.full(len(times), 20.0)
    stood = perform(Angles(STRAIGHT_KNEE, times, values), subject)
    ankle = stood.joints[:, JOINT_NAMES.index("right_ankle")]
    root = stood.root - (ankle - ankle[:1])  # the standing foot does not travel
    return assemble(STRAIGHT_KNEE, subject, times, stood.rotations, root)
