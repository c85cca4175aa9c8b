"""The fusion paper's treadmill, and captured runs, as simulated depth sensors see them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.distance import cdist

from benchmarks.synthetic.asf import bone_ends, read_amc, read_asf
from benchmarks.synthetic.human4d import read_human4d
from benchmarks.synthetic.sensors import SensorModel, SensorRecording, simulate
from hypose.app.live.simulated_sensors import builtin_joints, ring_sensors, rotated_about_vertical
from hypose.fusion import joints as jt
from hypose.geometry import Array, se3, se3_inverse, transform

# console of two bars, rails and posts of a treadmill, in front of a person who faces -y: a, b, radius in m
BARS = np.array(
    [
        [-0.40, -0.43, 1.01, 0.40, -0.43, 1.01, 0.075],
        [-0.40, -0.45, 1.11, 0.40, -0.45, 1.11, 0.060],
        [-0.39, -0.43, 0.85, -0.39, 0.0, 0.85, 0.028],
        [0.39, -0.43, 0.85, 0.39, 0.0, 0.85, 0.028],
        [-0.39, -0.43, 0.0, -0.39, -0.43, 0.85, 0.035],
        [0.39, -0.43, 0.0, 0.39, -0.43, 0.85, 0.035],
    ]
)


def cmu_joints(folder: Path, name: str, step: int = 4) -> Array:
    """(T, 15, 3) m of a CMU capture of subject 02 ("02_03"), its axes (y up), every step-th frame of 120 Hz."""
    asf, amc = read_asf(folder / "02.asf"), read_amc(folder / f"{name}.amc")
    ends = bone_ends(asf, {k: v[::step] for k, v in amc.items()}) * asf.metres_per_unit
    at = {n: ends[:, i] for i, n in enumerate(asf.names)}
    shoulders, hips = (at["lclavicle"] + at["rclavicle"]) / 2, (at["lhipjoint"] + at["rhipjoint"]) / 2
    arms = [at[s + n] for s in "lr" for n in ("clavicle", "humerus", "hand")]
    legs = [at[s + n] for s in "lr" for n in ("hipjoint", "femur", "tibia")]
    return np.stack([at["head"], at["lowerneck"], *arms, (shoulders + hips) / 2, *legs], 1)


def human4d_joints(folder: Path) -> tuple[Array, Array]:
    """(T, 15, 3) m of the HUMAN4D run in the first camera's frame, and camera_from_first (4, 4, 4)."""
    run = read_human4d(folder)
    x = run.joints
    arms = [np.stack([x[:, s + 1], x[:, s + 2], (x[:, s + 4] + x[:, s + 5]) / 2], 1) for s in (9, 15)]
    legs = [x[:, s : s + 3] for s in (21, 27)]
    up = x[:, 5] - x[:, 0]
    toe = (x[:, 25] - x[:, 23]) + (x[:, 31] - x[:, 29])
    toe -= (toe * up).sum(-1, keepdims=True) / (up * up).sum(-1, keepdims=True) * up
    if np.median(((arms[0][:, 0] - arms[1][:, 0]) * np.cross(up, toe)).sum(-1)) < 0:  # the file does not say the side
        arms, legs = arms[::-1], legs[::-1]
    middle = ((arms[0][:, 0] + arms[1][:, 0]) / 2 + (legs[0][:, 0] + legs[1][:, 0]) / 2) / 2
    top = [x[:, 7:8], x[:, 5:6]]
    return np.concatenate([*top, arms[0], arms[1], middle[:, None], legs[0], legs[1]], 1), run.camera_from_first


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) at unit length."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def on_treadmill(joints: Array) -> Array:
    """Remove travel and turning from a motion (T, 15, 3) m in any axes: the result has z up, faces -y, and stands on
    the floor.
    """
    hips = (joints[:, jt.LEFT_HIP] + joints[:, jt.RIGHT_HIP]) / 2
    up = unit(np.median(joints[:, jt.NECK] - hips, axis=0))
    side = joints[:, jt.LEFT_SHOULDER] - joints[:, jt.RIGHT_SHOULDER] + joints[:, jt.LEFT_HIP] - joints[:, jt.RIGHT_HIP]
    side = gaussian_filter1d(side, 15, axis=0, mode="nearest")
    side = unit(side - (side @ up)[:, None] * up)
    r = np.stack([side, np.cross(up, side), np.broadcast_to(up, side.shape)], 1)
    centre = gaussian_filter1d(hips, 12, axis=0, mode="nearest")
    centre = centre - (centre @ up)[:, None] * up
    out = np.einsum("tij,tnj->tni", r, joints - centre[:, None])
    out[..., 2] -= np.percentile(out[:, [jt.LEFT_FOOT, jt.RIGHT_FOOT], 2], 2) - 0.08
    return out


def looped(joints: Array, frames: int, blend: int = 8) -> Array:
    """Repeat a clip for `frames` frames: it is cut between its two most similar frames and cross-faded over `blend`
    frames.
    """
    t, flat = len(joints), joints.reshape(len(joints), -1)
    velocity = np.diff(flat, axis=0, append=flat[-1:])
    cost = cdist(flat, flat, "sqeuclidean") + 25 * cdist(velocity, velocity, "sqeuclidean")
    begins, ends = np.ogrid[:t, :t]
    far = (ends >= np.maximum(begins + 20, t // 2)) & (ends < t - blend - 1)
    cost[~(far & (begins >= 2) & (begins < max(3, t // 3)))] = np.inf
    a, b = np.unravel_index(int(cost.argmin()), cost.shape)
    m, segment = min(blend, int(a)), joints[a:b].copy()
    w = (np.arange(1, m + 1) / (m + 1))[:, None, None]
    segment[-m:] = (1 - w) * segment[-m:] + w * joints[a - m : a]
    return np.concatenate([segment] * (frames // len(segment) + 1))[:frames]


def turn_then_run(run: Array, walk: Array, frames: int) -> tuple[Array, Array]:
    """The paper's sequences: turn 45 degrees to the left, back, to the right, back while stepping, then run. Returns
    joints (frames, 15, 3) m and heading (frames,)."""
    k = frames // 2
    q = k // 8
    heading = np.zeros(frames)

    def ramp(i: int, j: int, start: float, stop: float) -> None:
        x = np.linspace(0, 1, j - i)
        heading[i:j] = start + (stop - start) * (3 * x**2 - 2 * x**3)

    a = np.pi / 4
    ramp(q, 2 * q, 0, a)
    heading[2 * q : 3 * q] = a
    ramp(3 * q, 5 * q, a, -a)
    heading[5 * q : 6 * q] = -a
    ramp(6 * q, 7 * q, -a, 0)
    running = looped(run, frames - k + 10)
    out = np.concatenate([looped(walk, k), running[10:]])[:frames]
    w = (np.arange(1, 11) / 11)[:, None, None]
    out[k - 10 : k] = (1 - w) * out[k - 10 : k] + w * running[:10]
    return rotated_about_vertical(out, heading), heading


def treadmill_recording(
    scene: str, rng: np.random.Generator, data: Path | None = None, model: SensorModel | None = None, take: int = 0
) -> SensorRecording:
    """Sequence "A" (600 frames, treadmill with bars) or "B" (900 frames, none); sensors in front, 60 degrees left and
    right, at 2.5 m. data: folder of real recordings (even takes: HUMAN4D's run, odd ones CMU's; stepping: CMU's walk);
    None: built-in motions. The paper gives neither the sensors' angle nor the number of frames."""
    if data is not None:
        walk = on_treadmill(cmu_joints(data / "mocap", "02_01"))
        source = (
            cmu_joints(data / "mocap", "02_03") if take % 2 else human4d_joints(data / "human4d_run")[0]
        )  # both are runs
    else:
        walk, source = on_treadmill(builtin_joints("walk", 12, rng)), builtin_joints("jog", 10, rng)
    joints, heading = turn_then_run(on_treadmill(source), walk, 600 if scene == "A" else 900)
    bars = BARS if scene == "A" else np.zeros((0, 7))
    return simulate(joints, heading, ring_sensors([0, 60, -60]), rng, model or SensorModel(), bars)


def human4d_recording(data: Path, rng: np.random.Generator, model: SensorModel | None = None) -> SensorRecording:
    """HUMAN4D's run seen from its four real camera poses (one sees the back); the reference is the frontal one."""
    joints, camera_from_first = human4d_joints(data / "human4d_run")
    up = unit(np.median(joints[:, jt.NECK] - (joints[:, jt.LEFT_HIP] + joints[:, jt.RIGHT_HIP]) / 2, axis=0))
    side = np.median(joints[:, jt.LEFT_SHOULDER] - joints[:, jt.RIGHT_SHOULDER], axis=0)
    side = unit(side - side @ up * up)
    r = np.stack([side, np.cross(up, side), up])
    world_from_first = se3(r, np.array([0, 0, 1.18]) - r @ np.median(joints[:, jt.TORSO], axis=0))
    world = transform(world_from_first, joints)
    side_line = world[:, jt.LEFT_SHOULDER] - world[:, jt.RIGHT_SHOULDER]
    heading = np.unwrap(np.arctan2(side_line[:, 1], side_line[:, 0]))
    cameras = (camera_from_first @ se3_inverse(world_from_first))[[1, 0, 2, 3]]
    return simulate(world, heading, cameras, rng, model or SensorModel(), np.zeros((0, 7)))
