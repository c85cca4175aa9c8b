"""Entry points of sensor fusion: a recorded clip (`fuse_clip`), or a stream frame by frame (`start`, `fuse_frame`).

Both run the same steps: registration, heading, and one of the methods. A clip is registered and measured as a whole
before it is fused; a stream refits its registration to the last seconds once per second, and learns bone lengths as it
runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.motion import Motion, isotropic
from hypose.body.skeleton import Skeleton
from hypose.errors import InputError
from hypose.evidence.frame import SensorJoints
from hypose.fusion import joints as jt
from hypose.fusion.confidence import ConfidenceState, confidence_step, normalised, start_confidence
from hypose.fusion.fit import (
    DOUBTFUL_P,
    FitSettings,
    FitState,
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
    confidence_of,
    identity_registration,
    measured_joint_depth,
    register,
)
from hypose.fusion.swarm import IMPROVED, PUBLISHED, SwarmSettings, SwarmState, start_swarm, swarm_step
from hypose.geometry import Array

FIT, SWARM, PUBLISHED_SWARM, PUBLISHED_WINDOW = "fit", "swarm", "published", "published-window"
FUSION_METHODS = (FIT, SWARM, PUBLISHED_SWARM, PUBLISHED_WINDOW)


@dataclass(frozen=True)
class FusionSettings:
    """Settings of the fusion of one person.

    method: one of FUSION_METHODS. "fit" is the articulated fit. "swarm" is the improved swarm. "published" is
        Asteriadis et al. 2013 with their registration, by the triangle of every frame. "published-window" is the same
        swarm, registered like the other methods.
    registered: whether positions are in a common frame already.
    window_s: s of the last frames that the registration of a stream uses.
    refit_s: s between two refits of that registration.
    diagnose: whether to run the swarm in parallel to the fit and report its choice of sensors.
    seed: of the swarm.
    check: whether to refuse sensors that see different people.
    fit: settings of the articulated fit.
    swarm: settings of the swarm; None: those of the method.
    Raises: InputError for an unknown method.
    """

    method: str = FIT
    registered: bool = False
    window_s: float = 5.0
    refit_s: float = 1.0
    diagnose: bool = False
    seed: int = 0
    check: bool = True
    fit: FitSettings = field(default_factory=FitSettings)
    swarm: SwarmSettings | None = None

    def __post_init__(self) -> None:
        if self.method not in FUSION_METHODS:
            raise InputError(f"There is no fusion method {self.method!r}; choose one of {', '.join(FUSION_METHODS)}.")

    @property
    def swarm_settings(self) -> SwarmSettings:
        """Settings of the swarm: the given ones, else those of the method."""
        return self.swarm or (PUBLISHED if self.method in (PUBLISHED_SWARM, PUBLISHED_WINDOW) else IMPROVED)

    @property
    def per_frame(self) -> bool:
        """Whether every frame is registered by its own triangle."""
        return self.method == PUBLISHED_SWARM and not self.registered


@dataclass(frozen=True)
class FusedFrame:
    """Fused skeleton at one instant.

    time: s.
    joint_names: (J,) the 15 common joints, then the other joints of the sensors' set.
    joints: (J, 3) m in the common frame, NaN where never seen.
    sd: (J,) m per axis, total standard deviation.
    systematic: (J,) m per axis, the part of sd that would remain with more frames or sensors.
    wrong: (J,) probability that the joint is off by more than fit.LARGE_ERROR_M, NaN where unknown.
    shares: (15, K) share of each sensor in each common joint (fit: weights; swarm: population).
    choice: (15, K) population of the swarm where it runs, else None.
    lost: whether there was no evidence for too long.
    n_sensors: number of sensors with evidence.
    """

    time: float
    joint_names: tuple[str, ...]
    joints: Array
    sd: Array
    systematic: Array
    wrong: Array
    shares: Array
    choice: Array | None
    lost: bool
    n_sensors: int


@dataclass(frozen=True)
class FusionState:
    """Memory of a stream between two frames.

    settings: of the fusion.
    sensor_names: names of the K sensors.
    joint_set: joints that the sensors report.
    registration: of the sensors to the common frame.
    next_refit: s, time of the next refit of the registration.
    window: recent (positions, state, time) for the registration.
    fit: memory of the articulated fit.
    swarm, confidence: memory of the swarm and of its noise; None unless the swarm runs.
    fixed_registration: whether the registration is not refitted.
    rest: indices of the set's joints beyond the common ones.
    joint_names: of the fused joints.
    """

    settings: FusionSettings
    sensor_names: tuple[str, ...]
    joint_set: jt.JointSet
    registration: Registration
    next_refit: float
    window: tuple[tuple[Array, NDArray[np.uint8], float], ...]
    fit: FitState
    swarm: SwarmState | None
    confidence: ConfidenceState | None
    fixed_registration: bool
    rest: NDArray[np.int64]
    joint_names: tuple[str, ...]


WINDOW_FRAMES = 40
"""Number of frames to which the registration of a stream is fitted; up to twice as many are kept."""


@dataclass(frozen=True)
class Fused:
    """Fused clip of T frames and K sensors.

    motion: the 15 common joints first, then the others of the set; without poses.
    shares: (T, 15, K) share of each sensor in each joint.
    choice: (T, 15, K) population of the swarm, or None.
    registration: of the sensors; with "published" that of the last frame.
    lengths: (18,) m of joints.SKELETON_BONES.
    sensor_names: names of the K sensors.
    """

    motion: Motion
    shares: Array
    choice: Array | None
    registration: Registration
    lengths: Array
    sensor_names: tuple[str, ...]


def start(
    first: SensorJoints,
    settings: FusionSettings | None = None,
    registration: Registration | None = None,
    lengths: Array | None = None,
) -> FusionState:
    """Make the state of a stream before its first frame.

    first: a frame that defines the sensors and the joint set of the stream; it is not fused.
    registration: a known one, which is then kept (but "published" registers every frame again).
    lengths: (18,) m of joints.SKELETON_BONES, known ones, which are then kept.
    Raises: InputError where the joints are of no known set.
    """
    s = settings or FusionSettings()
    sensors = len(first.sensor_names)
    swarms = s.method != FIT or s.diagnose
    known_set = jt.joint_set(first.joint_names)
    rest = np.setdiff1d(np.arange(len(first.joint_names)), known_set.common)
    known = None if s.per_frame else registration
    if known is None:
        known = identity_registration(sensors) if s.registered else alone(sensors)
    return FusionState(
        s,
        first.sensor_names,
        known_set,
        known,
        -np.inf,
        (),
        start_fit(lengths),
        start_swarm(sensors) if swarms else None,
        start_confidence(sensors, s.swarm_settings.confidence) if swarms else None,
        registration is not None or s.registered,
        rest,
        (*jt.COMMON, *(first.joint_names[i] for i in rest)),
    )


def fuse_frame(state: FusionState, frame: SensorJoints) -> tuple[FusionState, FusedFrame]:
    """Fuse the next frame of a stream, causally.

    state: memory of the stream.
    frame: joints of all sensors; NaN for those that report nothing.
    Returns: the new memory and the fused frame.
    Raises: InputError where the sensors or joints are not those of the start.
    """
    _check_alike(frame, state.sensor_names, state.joint_set.joint_names)
    s = state.settings
    raw = common_joints(frame)
    latest = max((float(t) for t in frame.times if t == t), default=state.fit.time)
    time = latest if latest == latest else 0.0
    state = _refit(state, raw, time)
    world = state.registration.apply(raw.positions)
    state, noise = _noise(state, raw)
    choice, estimate = None, None
    swarm = state.swarm
    if swarm is not None and noise is not None:
        swarm, estimate = swarm_step(swarm, world, noise, 0.0, s.swarm_settings, s.seed)
        choice = estimate.shares
    n_sensors = int(np.isfinite(world[..., 0]).any(1).sum())
    # sensors that report in a common frame may stand anywhere
    eyes = np.full((len(world), 3), np.nan) if s.registered else state.registration.common_from_sensor[:, :3, 3]
    if s.method == FIT or estimate is None:
        fit, found = fit_step(state.fit, world, raw.state, time, s.fit, eyes)
        joints, shares, lost = found.joints, found.shares, found.lost
        variance, systematic, wrong = found.variance, found.systematic, found.wrong
    else:
        known = np.isfinite(world[..., 0]).any()
        seen = np.where(np.isfinite(world[..., 0]).any(0), time, state.fit.seen)
        fit = replace(state.fit, time=time, seen=seen)
        joints, variance, shares = estimate.joints, estimate.spread**2 / 3, estimate.shares
        left = joints[jt.LEFT_SHOULDER] - joints[jt.RIGHT_SHOULDER]
        systematic, wrong = remaining_uncertainty(world, raw.state, eyes, left, state.fit.lengths, joints, variance)
        lost = not known and time - seen.max() > s.fit.lost_after_s
    sd, systematic = np.sqrt(variance + systematic), np.sqrt(systematic)
    joints, sd, systematic, wrong = _with_rest(state, frame, joints, (sd, systematic, wrong), shares)
    fused = FusedFrame(
        *(time, state.joint_names, joints, sd, systematic, wrong, shares, choice),
        *(bool(lost), n_sensors),
    )
    return replace(state, fit=fit, swarm=swarm), fused


def fuse_clip(
    joints: Sequence[SensorJoints],
    method: str = FIT,
    settings: FusionSettings | None = None,
    registration: Registration | None = None,
    *,
    watch: Callable[[int], None] | None = None,
) -> Fused:
    """Fuse the skeletons of one person from a recorded clip.

    joints: one per frame, all of the same sensors and joint set.
    method: one of FUSION_METHODS; it replaces the method of the settings.
    registration: of the sensors; None: estimated robustly from the whole clip and all joints ("published" registers
        every frame by its triangle).
    watch: called after every frame with the number of frames fused.
    Returns: the fused motion with its sources; bone lengths are medians over the clip.
    Raises: InputError for frames whose sensors or joints differ, and for sensors that see different people.
    """
    if not len(joints):
        raise InputError("There are no frames to fuse; give at least one.")
    s = replace(settings or FusionSettings(), method=method)
    for t, frame in enumerate(joints):
        _check_alike(frame, joints[0].sensor_names, joints[0].joint_names, t)
    raw = [common_joints(f) for f in joints]
    positions, states = np.stack([f.positions for f in raw]), np.stack([f.state for f in raw])
    if not np.isfinite(positions).any():
        raise InputError("No sensor reports any joint in the whole clip; check that a person was tracked.")
    if registration is None:
        registration = identity_registration(positions.shape[1]) if s.registered else register(positions, states)
        if s.check:
            check_same_person(positions, registration, joints[0].sensor_names)
    lengths = clip_lengths(positions, states)
    times = _clip_times(joints)
    state = start(joints[0], s, registration, lengths)
    frames: list[FusedFrame] = []
    for t, frame in enumerate(joints):
        if not np.isfinite(frame.times).any():  # no sensor sees the person: time goes on, so that the person gets lost
            frame = replace(frame, times=np.full(len(frame.times), times[t]))
        state, fused = fuse_frame(state, frame)
        frames.append(fused)
        if watch is not None:
            watch(len(frames))
    motion = points_motion(
        state.joint_names,
        np.stack([f.joints for f in frames]),
        np.stack([f.sd for f in frames]),
        times,
        np.array([f.lost for f in frames]),
        np.array([f.n_sensors for f in frames]),
        lengths,
        {"recipe": f"fusion-{s.method}", "seed": s.seed},
        np.stack([f.systematic for f in frames]),
        np.stack([f.wrong for f in frames]),
    )
    choice = None if frames[0].choice is None else np.stack([f.choice for f in frames if f.choice is not None])
    return Fused(
        motion,
        np.stack([f.shares for f in frames]),
        choice,
        state.registration,
        lengths,
        joints[0].sensor_names,
    )


def _check_alike(
    frame: SensorJoints, sensor_names: tuple[str, ...], joint_names: tuple[str, ...], number: int | None = None
) -> None:
    where = "A frame" if number is None else f"Frame {number}"
    if frame.sensor_names != sensor_names:
        raise InputError(
            f"{where} has the sensors {', '.join(frame.sensor_names)} instead of {', '.join(sensor_names)}; give every "
            "frame all sensors, with NaN for those that report nothing."
        )
    if frame.joint_names != joint_names:
        raise InputError(
            f"{where} has {len(frame.joint_names)} joints ({frame.joint_names[0]}, ...) instead of {len(joint_names)}; "
            "map sensors of different joint sets to the common ones first (fusion.register.common_joints)."
        )


def _refit(state: FusionState, raw: SensorJoints, time: float) -> FusionState:
    """Add a frame to the registration window, and refit the registration where that is due ("published": by this
    frame).

    raw: the common joints of the frame, in the sensors' frames.
    time: s of the frame.
    Returns: the new memory of the stream.
    """
    s = state.settings
    if s.per_frame:
        return replace(state, registration=by_triangles(state.registration, raw.positions))
    if state.fixed_registration:
        return state
    window = state.window
    # on all joints: the trunk alone is so small that its joints' constant errors turn into degrees (scene A of the
    # simulator, 3 seeds: 44 against 35 mm at the end). Neighbouring frames are nearly equal: keep them further apart
    # as the window grows
    if (
        not window
        or time < window[-1][2]
        or time - window[-1][2] >= min(time - window[0][2], s.window_s) / WINDOW_FRAMES
    ):
        window = (*window, (raw.positions, raw.state, time))
    while len(window) > 1 and not 0 <= time - window[0][2] <= s.window_s:
        window = window[1:]
    if len(window) > 2 * WINDOW_FRAMES:
        window = window[::2]
    if time < state.next_refit:
        return replace(state, window=window)
    positions, states = np.stack([w[0] for w in window]), np.stack([w[1] for w in window])
    new = register(positions, states, start=state.registration, iterations=8)
    pause = s.refit_s if new.registered.all() and len(window) > 30 else min(0.2, s.refit_s)
    return replace(state, window=window, registration=new, next_refit=time + pause)


def _noise(state: FusionState, raw: SensorJoints) -> tuple[FusionState, Array | None]:
    """Compute the noise lambda of this frame.

    raw: the common joints of the frame, in the sensors' frames.
    Returns: the new memory of the stream, and lambda (K, 15); None unless the swarm runs.
    """
    if state.confidence is None:
        return state, None
    s = state.settings.swarm_settings
    depth = measured_joint_depth(raw)
    memory, inputs = confidence_step(state.confidence, raw.positions, raw.state, depth, raw.times, s.confidence)
    return replace(state, confidence=memory), s.rules.noise(*normalised(inputs, s.confidence))


def _with_rest(
    state: FusionState, frame: SensorJoints, joints: Array, known: Sequence[Array], shares: Array
) -> list[Array]:
    """Append the joints beyond the common ones to the fused joints and to their uncertainties.

    known: uncertainties (15,) of the common joints.
    Returns: joints (J, 3), then each uncertainty (J,). Each further joint moves with the common joint that it hangs
        from, is averaged with the sensors' shares in that joint, and has the same uncertainty.
    """
    rest = state.rest
    raw, common = frame.positions, state.joint_set.common
    out = np.full((len(rest), 3), np.nan)
    sure = np.full((len(known), len(rest)), np.nan)
    world = state.registration.apply(raw)
    anchors = anchors_of(state.joint_set)
    for i, j in enumerate(rest):
        anchor = anchors[int(j)]
        weights = np.where(np.isfinite(world[:, j, 0]) & np.isfinite(world[:, common[anchor], 0]), shares[anchor], 0.0)
        weights = weights * confidence_of(frame.state[:, j])
        if weights.sum() > 0:
            offsets = np.where(weights[:, None] > 0, world[:, j] - world[:, common[anchor]], 0.0)
            out[i] = joints[anchor] + weights @ offsets / weights.sum()
            sure[:, i] = [value[anchor] for value in known]
    return [np.concatenate(both) for both in zip((joints, *known), (out, *sure), strict=True)]


def _clip_times(joints: Sequence[SensorJoints]) -> Array:
    """Compute the time (T,) of each frame of a clip, s: the latest of its sensors; gaps are interpolated, and a clip
    without any time has 30 frames per second."""
    times = np.array([np.nanmax(f.times) if np.isfinite(f.times).any() else np.nan for f in joints])
    missing = ~np.isfinite(times)
    if missing.all():
        return np.arange(len(times)) / 30
    index = np.arange(len(times))
    times[missing] = np.interp(index[missing], index[~missing], times[~missing])
    return times


# ---- motion of points ------------------------------------------------------------------------------------------------
# Convert fused points into a Motion with a skeleton that only names joints, parents before children.


def point_skeleton(
    joint_names: Sequence[str], parents: Sequence[int], lengths: Mapping[str, float] | None = None
) -> Skeleton:
    """Make a skeleton that only names joints, for motions without poses: rigid, with six degrees of freedom.

    joint_names: of all joints, the root first.
    parents: index of the parent of each joint, -1 for the root.
    lengths: m by joint name, of the bone to the parent, 0.2 m where not given; at rest joints stand above each other by
        these.
    """
    n = len(joint_names)
    offsets = np.zeros((n, 3))
    offsets[1:, 2] = [(lengths or {}).get(name, 0.2) for name in joint_names[1:]]
    dofs = tuple(f"{joint_names[0]}_{a}" for a in ("tx", "ty", "tz", "rx", "ry", "rz"))
    return Skeleton(
        tuple(joint_names),
        np.array(parents, dtype=np.int64),
        offsets,
        np.arange(n) == 0,
        np.tile(np.eye(3), (2, 1)),
        np.zeros(6, dtype=np.int64),
        dofs,
        np.full(6, -1e3),
        np.full(6, 1e3),
        np.full(6, 0.1),
    )


def points_motion(
    names: tuple[str, ...],
    joints: Array,
    sd: Array,
    times: Array,
    lost: NDArray[np.bool_],
    n_sensors: NDArray[np.int64],
    lengths: Array,
    provenance: Mapping[str, Any],
    systematic: Array | None = None,
    wrong: Array | None = None,
) -> Motion:
    """Make a motion from fused points, with parents before children (the torso is the root).

    names: (J,) of the joints.
    joints: (T, J, 3) m.
    sd: (T, J) m per axis, total standard deviation.
    times: (T,) s.
    lost: (T,) whether the person is lost.
    n_sensors: (T,) number of sensors with evidence.
    lengths: (18,) m of joints.SKELETON_BONES.
    provenance: facts on the origin of the motion, stored with it.
    systematic: (T, J) m per axis, the part of sd that would remain with more frames or sensors.
    wrong: (T, J) probability that a joint is wrong.
    """
    order, parents = _topological(names)
    bone = {tuple(sorted(b)): float(v) for b, v in zip(jt.SKELETON_BONES.tolist(), lengths, strict=True)}
    by_name = {
        n: bone.get(tuple(sorted((i, int(jt.PARENT[i])))), 0.2) for i, n in enumerate(jt.COMMON) if jt.PARENT[i] >= 0
    }
    skeleton = point_skeleton([names[i] for i in order], parents, by_name)
    motion = Motion(
        skeleton,
        times,
        joints[:, order],
        None,
        isotropic(sd[:, order]),
        lost,
        n_sensors == 0,
        n_sensors,
        np.full(len(times), np.nan),
        provenance,
    )
    if wrong is None or systematic is None:
        return motion
    lasting = isotropic(systematic[:, order])
    p = np.nan_to_num(np.where(lost[:, None], np.fmax(wrong, 0.5), wrong)[:, order]).astype(np.float32)
    low_confidence = p > DOUBTFUL_P
    return replace(
        motion,
        error_probability=p,
        low_confidence_joints=low_confidence,
        low_confidence=low_confidence.any(1),
        systematic_covariance=lasting,
    )


def _topological(names: tuple[str, ...]) -> tuple[list[int], list[int]]:
    """Order the joints with parents first, and find the parent of each in that order."""
    parent = [int(p) for p in jt.PARENT]
    if len(names) > 15:
        sets = [k for k in jt.joint_sets() if len(k.joint_names) == len(names)]
        known = sets[0] if sets else None
        anchors = anchors_of(known) if known is not None else {}
        at = {jt.plain_name(n): i for i, n in enumerate(known.joint_names)} if known is not None else {}
        parent += [anchors.get(at.get(jt.plain_name(n), -1), jt.TORSO) for n in names[15:]]
    order = [jt.TORSO]
    for j in order:
        order += [i for i, p in enumerate(parent) if p == j]
    place = {j: i for i, j in enumerate(order)}
    return order, [place[parent[j]] if parent[j] >= 0 else -1 for j in order]


def anchors_of(known: jt.JointSet) -> dict[int, int]:
    """Find for every joint of the set the common joint (0-14) from which it hangs: the nearest one towards the root,
    else the torso.
    """
    place = {int(j): i for i, j in enumerate(known.common)}
    out: dict[int, int] = {}
    for j in range(len(known.joint_names)):
        a = j
        while a >= 0 and a not in place:
            a = int(known.parent[a])
        out[j] = place.get(a, jt.TORSO)
    return out


def common_positions(motion: Motion) -> Array:
    """Return the positions (T, 15, 3) m of the common joints in the order of joints.COMMON (the motion itself starts at
    the torso).
    """
    return motion.joints[:, [motion.skeleton.joint(n) for n in jt.COMMON]]
