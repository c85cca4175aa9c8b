"""Fuse the skeletons of one person in a recorded clip (`fuse_clip`).

The sensors are registered and the bone lengths measured over the whole clip; then one of the methods fuses it frame by
frame. For skeletons that arrive live see `hypose.fusion.people`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.motion import Motion, isotropic
from hypose.body.skeleton import Skeleton
from hypose.errors import InputError, refuse
from hypose.evidence.frame import TRACKED, SensorJoints
from hypose.fusion import joints as jt
from hypose.fusion.fit import (
    DOUBTFUL_P,
    LOST_AFTER_S,
    FitEstimate,
    clip_lengths,
    fit_step,
    remaining_uncertainty,
    start_fit,
)
from hypose.fusion.register import (
    Registration,
    alone,
    by_triangles,
    check_same_person,
    common_joints,
    register,
)
from hypose.fusion.swarm import (
    IMPROVED,
    PUBLISHED,
    SwarmEstimate,
    SwarmSettings,
    confidence_step,
    normalised,
    start_confidence,
    start_swarm,
    swarm_step,
)
from hypose.geometry import Array, interpolated

FIT, SWARM, PUBLISHED_SWARM, PUBLISHED_WINDOW = "fit", "swarm", "published", "published-window"
FUSION_METHODS = (FIT, SWARM, PUBLISHED_SWARM, PUBLISHED_WINDOW)
"""Methods of `fuse_clip`. "fit": articulated fit. "swarm": improved swarm. "published": the swarm of Asteriadis et al.
2013, every frame registered by its triangle of shoulders and torso. "published-window": the same swarm, registered over
the clip like the other methods.
"""


@dataclass(frozen=True)
class Fused:
    """Fused clip of T frames and K sensors.

    motion: the 15 common joints first, then the others of the set; without poses.
    shares: (T, 15, K) share of each sensor in each joint; of a swarm, the share in its population.
    registration: registration of the sensors; with "published" that of the last frame.
    lengths: (18,) m, lengths of joints.SKELETON_BONES, 0 where unknown.
    sensor_names: names of the K sensors.
    """

    motion: Motion
    shares: Array
    registration: Registration
    lengths: Array
    sensor_names: tuple[str, ...]


def fuse_clip(
    joints: Sequence[SensorJoints],
    method: str = FIT,
    registration: Registration | None = None,
    *,
    seed: int = 0,
    swarm: SwarmSettings | None = None,
    watch: Callable[[int], None] | None = None,
) -> Fused:
    """Fuse the skeletons of one person from a recorded clip.

    joints: one per frame, all of the same sensors and joint set.
    method: one of FUSION_METHODS.
    registration: registration of the sensors; None: estimated robustly from the whole clip and all joints. "published"
        ignores it.
    seed: seed of the swarm's random numbers.
    swarm: settings of the swarm; None: those of the method.
    watch: called after every frame with the number of frames fused.
    Returns: the fused motion with its sources; bone lengths are medians over the clip.
    Raises: InputError for an unknown method, for frames whose sensors or joints differ, for a clip without any joint,
        and for sensors that see different people.
    """
    unknown = f"There is no fusion method {method!r}; choose one of {', '.join(FUSION_METHODS)}"
    none = "There are no frames to fuse; give at least one"
    refuse("", {unknown: method not in FUSION_METHODS, none: not len(joints)})
    first = joints[0]
    for t, frame in enumerate(joints):
        faults = {
            f" has the sensors {', '.join(frame.sensor_names)} instead of {', '.join(first.sensor_names)}; give every "
            "frame all sensors, with NaN for those that report nothing": frame.sensor_names != first.sensor_names,
            f" has {len(frame.joint_names)} joints ({frame.joint_names[0]}, ...) instead of {len(first.joint_names)}; "
            "map sensors of different joint sets to the common ones first (fusion.register.common_joints)": (
                frame.joint_names != first.joint_names
            ),
        }
        refuse(f"Frame {t}", faults)
    times = _clip_times(joints)
    # where no sensor sees the person, time goes on, so that the person gets lost
    joints = [
        f if np.isfinite(f.times).any() else replace(f, times=np.full(len(f.times), t))
        for f, t in zip(joints, times, strict=True)
    ]
    raw = [common_joints(f) for f in joints]
    positions, states = np.stack([f.positions for f in raw]), np.stack([f.state for f in raw])
    if not np.isfinite(positions).any():
        raise InputError("No sensor reports any joint in the whole clip; check that a person was tracked.")
    if method == PUBLISHED_SWARM:  # every frame by its triangles
        places = list(itertools.accumulate(positions, by_triangles, initial=alone(positions.shape[1])))[1:]
    else:
        if registration is None:
            registration = register(positions, states)
            check_same_person(positions, registration, first.sensor_names)
        places = [registration] * len(raw)
    world = np.stack([place.apply(p) for place, p in zip(places, positions, strict=True)])
    lengths = clip_lengths(positions, states)
    eyes = np.stack([place.common_from_sensor[:, :3, 3] for place in places])
    if method == FIT:
        estimates = _fitted(world, states, times, eyes, lengths)
    else:
        chosen = _swarm(raw, world, swarm or (IMPROVED if method == SWARM else PUBLISHED), seed)
        estimates = _chosen(world, states, times, eyes, lengths, chosen)
    fused = list[FitEstimate]()
    for estimate in estimates:
        fused.append(estimate)
        if watch is not None:
            watch(len(fused))
    shares = np.stack([f.shares for f in fused])
    variance, systematic, wrong = (
        np.stack([getattr(f, n) for f in fused]) for n in ("variance", "systematic", "wrong")
    )
    known = {"sd": np.sqrt(variance + systematic), "systematic": np.sqrt(systematic), "wrong": wrong}
    motion = _motion(
        *_with_rest(joints, places, np.stack([f.joints for f in fused]), known, shares),
        times,
        np.array([f.lost for f in fused]),
        np.isfinite(world[..., 0]).any(2).sum(1),
        lengths,
        {"recipe": f"fusion-{method}", "seed": seed},
    )
    return Fused(motion, shares, places[-1], lengths, first.sensor_names)


def _clip_times(joints: Sequence[SensorJoints]) -> Array:
    """Compute the time (T,) of each frame of a clip, s: the latest of its sensors; gaps are interpolated, and a clip
    without any time has 30 frames per second.
    """
    times = np.array([np.nanmax(f.times) if np.isfinite(f.times).any() else np.nan for f in joints])
    return interpolated(times) if np.isfinite(times).any() else np.arange(len(times)) / 30


def _swarm(raw: Sequence[SensorJoints], world: Array, s: SwarmSettings, seed: int) -> Iterator[SwarmEstimate]:
    """Yield the swarm's estimate of each frame.

    raw: T frames of the common joints in the sensors' frames.
    world: (T, K, 15, 3) m, the same joints registered.
    s, seed: settings and seed of the swarm.
    """
    sensors = world.shape[1]
    swarm, memory = start_swarm(sensors), start_confidence(sensors)
    for frame, registered in zip(raw, world, strict=True):
        measured = [] if frame.joint_depth is None else [frame.joint_depth]
        seen = frame.positions, frame.state, measured, frame.times
        memory, inputs = confidence_step(memory, *seen, s.cured)
        swarm, estimate = swarm_step(swarm, registered, s.rules.noise(*normalised(inputs, s.cured)), 0.0, s, seed)
        yield estimate


def _fitted(
    world: Array, states: NDArray[np.uint8], times: Array, eyes: Array, lengths: Array
) -> Iterator[FitEstimate]:
    """Yield the articulated fit of each frame.

    world: (T, K, 15, 3) m registered.
    states: (T, K, 15) joint states.
    times: (T,) s.
    eyes: (T, K, 3) m, positions of the sensors.
    lengths: (18,) m, lengths of joints.SKELETON_BONES.
    """
    fit = start_fit(lengths)
    for frame in zip(world, states, times.tolist(), eyes, strict=True):
        fit, estimate = fit_step(fit, *frame)
        yield estimate


def _chosen(
    world: Array,
    states: NDArray[np.uint8],
    times: Array,
    eyes: Array,
    lengths: Array,
    swarm: Iterator[SwarmEstimate],
) -> Iterator[FitEstimate]:
    """Yield the swarm's estimate of each frame with its uncertainty; arguments as in `_fitted`."""
    seen = np.full(15, -np.inf)
    for points, state, time, at, choice in zip(world, states, times, eyes, swarm, strict=True):
        reported = np.isfinite(points[..., 0])
        seen = np.where(reported.any(0), time, seen)
        variance = choice.spread**2 / 3
        left = choice.joints[jt.LEFT_SHOULDER] - choice.joints[jt.RIGHT_SHOULDER]
        systematic, wrong = remaining_uncertainty(points, state, at, left, lengths, choice.joints, variance)
        lost = bool(not reported.any() and time - seen.max() > LOST_AFTER_S)
        yield FitEstimate(choice.joints, variance, systematic, wrong, choice.shares, lost)


def _with_rest(
    frames: Sequence[SensorJoints],
    places: Sequence[Registration],
    joints: Array,
    known: Mapping[str, Array],
    shares: Array,
) -> tuple[tuple[str, ...], list[int], Array, dict[str, Array]]:
    """Append the joints beyond the common ones. Each moves with the common joint from which it hangs (the nearest one
    towards the root), is averaged with the sensors' shares in that joint, and has the same uncertainty.

    frames: what the sensors reported, T frames.
    places: registration of each frame.
    joints: (T, 15, 3) m, fused common joints.
    known: uncertainties (T, 15) of them, by name.
    shares: (T, 15, K) share of each sensor in each common joint.
    Returns: names (J,); common joint from which each joint hangs (J,), -1 for the torso; joints (T, J, 3);
        uncertainties (T, J) by name.
    """
    of = jt.joint_set(frames[0].joint_names)
    rest = np.setdiff1d(np.arange(len(of.joint_names)), of.common).tolist()
    names, parents = (*jt.COMMON, *(of.joint_names[j] for j in rest)), jt.PARENT.tolist()
    world = np.stack([place.apply(f.positions) for place, f in zip(places, frames, strict=True)])
    states = np.stack([f.state for f in frames])
    common = {int(j): i for i, j in enumerate(of.common)}
    for j in rest:
        anchor = j
        while anchor >= 0 and anchor not in common:
            anchor = int(of.parent[anchor])
        at = common.get(anchor, jt.TORSO)
        offsets = world[:, :, j] - world[:, :, of.common[at]]
        weights = np.where(np.isfinite(offsets[..., 0]), shares[:, at], 0.0) * states[:, :, j] / TRACKED
        total = weights.sum(1)
        mean = np.einsum("tk,tka->ta", weights, np.nan_to_num(offsets)) / np.maximum(total, 1e-300)[:, None]
        joints = np.concatenate([joints, np.where((total > 0)[:, None], joints[:, at] + mean, np.nan)[:, None]], 1)
        hidden = np.where(total > 0, 0.0, np.nan)
        known = {n: np.column_stack([values, values[:, at] + hidden]) for n, values in known.items()}
        parents.append(at)
    return names, parents, joints, dict(known)


# ---- motion of points ------------------------------------------------------------------------------------------------
# Convert fused points into a Motion with a skeleton that only names joints, parents before children.


def _motion(
    names: Sequence[str],
    parents: Sequence[int],
    joints: Array,
    known: Mapping[str, Array],
    times: Array,
    lost: NDArray[np.bool_],
    n_sensors: NDArray[np.int64],
    lengths: Array,
    provenance: Mapping[str, Any],
) -> Motion:
    """Make a motion from fused points, with parents before children (the torso is the root).

    names, parents, joints, known: as `_with_rest` returns them.
    times: (T,) s.
    lost: (T,) whether the person is lost.
    n_sensors: (T,) number of sensors with evidence.
    lengths: (18,) m, lengths of joints.SKELETON_BONES.
    provenance: facts on the origin of the motion, stored with it.
    """
    order = [jt.TORSO]
    for j in order:
        order += [i for i, p in enumerate(parents) if p == j]
    place = {j: i for i, j in enumerate(order)}
    bone = {tuple(sorted(b)): v for b, v in zip(jt.SKELETON_BONES.tolist(), lengths.tolist(), strict=True)}
    bones = [bone.get(tuple(sorted((j, parents[j]))), 0.2) for j in order[1:]]
    # a skeleton that only names joints: rigid, with six degrees of freedom
    offsets, six = np.zeros((len(order), 3)), np.ones(6)
    offsets[1:, 2] = bones
    above = np.array([place.get(parents[j], -1) for j in order], dtype=np.int64)
    tree = tuple(names[j] for j in order), above, offsets, np.arange(len(order)) == 0
    dofs = tuple(f"{names[order[0]]}_{a}" for a in ("tx", "ty", "tz", "rx", "ry", "rz"))
    moves = np.tile(np.eye(3), (2, 1)), np.zeros(6, dtype=np.int64), dofs
    skeleton = Skeleton(*tree, *moves, -1e3 * six, 1e3 * six, 0.1 * six)
    wrong = known["wrong"]
    p = np.nan_to_num(np.where(lost[:, None], np.fmax(wrong, 0.5), wrong)[:, order]).astype(np.float32)
    low_confidence = np.asarray(p > DOUBTFUL_P)
    return Motion(
        skeleton,
        times,
        joints[:, order],
        None,
        isotropic(known["sd"][:, order]),
        lost,
        n_sensors == 0,
        n_sensors,
        np.full(len(times), np.nan),
        provenance,
        error_probability=p,
        low_confidence_joints=low_confidence,
        low_confidence=np.asarray(low_confidence.any(1)),
        systematic_covariance=isotropic(known["systematic"][:, order]),
    )


def common_positions(motion: Motion) -> Array:
    """Return the positions (T, 15, 3) m of the common joints in the order of joints.COMMON (the motion itself starts at
    the torso).
    """
    return motion.joints[:, [motion.skeleton.joint(n) for n in jt.COMMON]]
