"""Use the skeletons that sensors' programs report: solve them together with cameras, assess fused ones, and fit poses.

With cameras there is one solve on all evidence. The cameras alone give a first motion and the body. These show where
each skeleton's sensor stands, where it exchanges left and right, and where its joints sit on the body. Then all frames
are tracked again with the skeletons' joints as additional points.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.default_body import human
from hypose.body.motion import Motion
from hypose.calibration.diagnose_person import UNIT_ERRORS
from hypose.calibration.findings import INVALID, REVIEW, Finding
from hypose.errors import InputError
from hypose.evidence.frame import TRACKED, Frame, SensorJoints
from hypose.evidence.terms import PointTerm
from hypose.fitting import fit_clip
from hypose.fusion import joints as jt
from hypose.fusion.align import offset_by_movement
from hypose.fusion.fuse import common_positions
from hypose.fusion.register import LARGEST_RESIDUAL_M, Registration, common_joints, register
from hypose.geometry import Array
from hypose.io.sensors.skeleton_files import (
    SensorStream,
    SkeletonRecording,
    join_observations,
    resample,
    shifted,
)
from hypose.pipeline.assessment import Assessment, assess
from hypose.pipeline.run import TrackResult
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.sources import FrameSource
from hypose.pipeline.track import track_source
from hypose.pipeline.track_loop import StageProgress
from hypose.pipeline.track_options import TrackOptions
from hypose.tracking.refinement import KEYPOINT_SHARE, anatomical_prior
from hypose.tracking.subject import subject_from_keypoints


@dataclass(frozen=True)
class SkeletonRows:
    """Joints of sensors' skeletons as additional evidence for tracking (`hypose.evidence.cues.OwnEvidence`).

    points: (T, P, 3) m, world, NaN where missing.
    weight: (T, P) weight of each point.
    joint, offset: (P,) and (P, 3) m in the joint's frame: where the points sit on the body.
    row: row of the arrays by frame index.
    """

    points: Array
    weight: Array
    joint: NDArray[np.int64]
    offset: Array
    row: Mapping[int, int]

    def rows(self, body: Body, frame: Frame, /) -> PointTerm | None:
        """Return the points of a frame as a term for the solver; None where there are none."""
        n = self.row.get(frame.index)
        if n is None or not (self.weight[n] > 0).any():
            return None
        return PointTerm(self.points[n], self.weight[n], self.joint, self.offset, SETTINGS.sensor_scale_m)

    def energy(self, body: Body, poses: Array, frame: Frame, /) -> Array:
        """Compute the energy (N,) of poses for the search: the solver's cost in the unit of the masks' energy."""
        n = self.row.get(frame.index)
        used = np.flatnonzero(self.weight[n] > 0) if n is not None else np.zeros(0, np.int64)
        if n is None or not len(used):
            return np.zeros(len(poses))
        at = body.skeleton.points(self.joint[used], self.offset[used], poses)
        squared = ((at - self.points[n, used]) ** 2).sum(-1) / (2 * SETTINGS.sensor_scale_m) ** 2
        return KEYPOINT_SHARE * 2 * (self.weight[n, used] * np.log1p(squared)).sum(-1)


def fuse_mixture(
    source: FrameSource,
    frame_rate: float,
    skeletons: Sequence[SensorJoints] | Callable[[Motion], Sequence[SensorJoints]],
    options: TrackOptions,
    *,
    progress: StageProgress | None = None,
    results: Path | None = None,
    record: Mapping[str, Any] | None = None,
) -> TrackResult:
    """Track a person from cameras and skeletons in one solve.

    source: frames with depth maps, silhouettes or both, in a world with z up.
    skeletons: one per frame, of K sensors, with any known set of joints (`hypose.fusion.register.common_joints`), each
        in the sensor's frame; or a function that makes them from the motion of the cameras alone.
    results: folder for motion.npz and a checkpoint; None: nothing is written.
    record: provenance of the motion.
    progress: function of stage, done, total.
    Returns: the motion; when interrupted early, that of the cameras so far.
    Raises: InputError where the numbers of frames and skeletons differ, or no sensor moves like the person; a single
        such sensor is left out.
    """
    made = None if callable(skeletons) else _checked(skeletons, len(source))
    first = track_source(source, frame_rate, options, progress=progress, find_places=False)
    if not first.complete:
        return first
    if made is None:
        assert callable(skeletons)
        made = _checked(skeletons(first.motion), len(source))
    indices = [source.frame(n).index for n in range(len(source))]
    own, place = skeleton_rows(first.motion, made, indices)
    if not place.registered[1:].any():
        raise InputError(
            "No sensor's skeletons move as the person before the cameras does; check that they are of the same "
            "recording and that the clocks agree."
        )
    return track_source(
        source,
        frame_rate,
        options,
        body=first.body,
        progress=progress,
        own=(own,),
        results=results,
        record=record,
    )


def _checked(skeletons: Sequence[SensorJoints], frames: int) -> list[SensorJoints]:
    """Convert one skeleton per frame to the common joints.

    Raises: InputError where frames or sensors are missing.
    """
    if len(skeletons) != frames:
        raise InputError(f"There are {len(skeletons)} skeletons for {frames} frames; give one per frame.")
    common = [common_joints(s) for s in skeletons]
    if len(sensors := {s.sensor_names for s in common}) > 1:
        raise InputError(f"Every frame needs the same sensors, got {sorted(sensors)}; a missing one has NaN.")
    return common


def skeleton_rows(
    motion: Motion, skeletons: Sequence[SensorJoints], indices: Sequence[int]
) -> tuple[SkeletonRows, Registration]:
    """Make evidence from skeletons (T) in the world of a motion (T) of the same person.

    indices: (T,) indices of the frames.
    Returns: the evidence, and the registration of the sensors; its sensor 0 is the motion itself. A sensor that stays
        apart from the motion is not registered and gives no evidence.
    """
    assert motion.poses is not None
    known = motion.joints[:, jt.BODY_JOINT]  # (T, 15, 3)
    known = np.where(motion.lost[:, None, None], np.nan, known)
    seen = np.stack([s.positions for s in skeletons])  # (T, K, 15, 3)
    state = np.stack([s.state for s in skeletons])
    states = np.concatenate([np.full_like(state[:, :1], TRACKED), state], axis=1)
    place = register(np.concatenate([known[:, None], seen], axis=1), states)
    # a sensor behind the person may exchange left and right
    world = place.apply(np.concatenate([known[:, None], seen], axis=1))[:, 1:]
    straight, mirrored = (_median_away(w, known) for w in (world, world[:, :, jt.MIRROR]))
    exchanged = (mirrored < 0.7 * straight)[..., None]
    # a person filmed at another time can be registered, but stays apart
    away = np.where(exchanged[..., 0], mirrored, straight)
    alike = [bool(len(a := w[np.isfinite(w)])) and np.median(a) <= LARGEST_RESIDUAL_M for w in away.T]
    place = replace(place, registered=place.registered & np.array([True, *alike]))
    world = np.where(place.registered[1:, None, None], world, np.nan)
    world = np.where(exchanged[..., None], world[:, :, jt.MIRROR], world)
    state = np.where(exchanged, state[:, :, jt.MIRROR], state)
    rotations, centres = motion.skeleton.forward(motion.poses)
    rotations, centres = rotations[:, jt.BODY_JOINT], centres[:, jt.BODY_JOINT]
    own = np.einsum("tjba,tkjb->tkja", rotations, world - centres[:, None])
    own = np.where((state == TRACKED)[..., None], own, np.nan)
    sensors = world.shape[1]
    enough = np.isfinite(own[..., 0]).sum(0) >= SETTINGS.sensor_fewest  # (K, 15)
    offset = np.nanmedian(np.where(enough[..., None], own, 0.0), axis=0)
    there = np.isfinite(world).all(-1) & enough
    weight = np.where(there, SETTINGS.sensor_weight * state / TRACKED, 0.0)
    flat = world.reshape(len(world), -1, 3)
    rows = SkeletonRows(
        np.where(there.reshape(len(world), -1)[..., None], flat, np.nan),
        weight.reshape(len(world), -1),
        np.tile(jt.BODY_JOINT, sensors).astype(np.int64),
        offset.reshape(-1, 3),
        {int(index): n for n, index in enumerate(indices)},
    )
    return rows, place


def _median_away(points: Array, known: Array) -> Array:
    """Compute the median distance (T, K) m over the joints between points (T, K, 15, 3) and known (T, 15, 3); infinite
    where none is seen.
    """
    away = np.linalg.norm(points - known[:, None], axis=-1)
    counted = np.isfinite(away)
    middle = np.nanmedian(np.where(counted.any(-1, keepdims=True), away, 1e9), axis=-1)
    return np.where(counted.any(-1), middle, np.inf)


def skeletons_at_frames(recording: SkeletonRecording, motion: Motion) -> list[SensorJoints]:
    """Resample the skeletons of a recording at the frames of a motion of the same person.

    The clock offset is found from the movement: one for all sensors, or one for each where they have their own clocks.
    Of several persons the one that a sensor sees longest is taken.
    Raises: InputError where a clock offset cannot be found.
    """
    known = np.where(motion.lost[:, None, None], np.nan, motion.joints[:, jt.BODY_JOINT])
    rows = np.arange(len(motion))
    offset: float | None = None
    synced: list[SensorStream] = []
    for stream in recording.streams:
        if offset is None or not recording.common_clock:
            offset = _offset(motion, known, stream)
        synced.append(resample(shifted(stream, offset), motion.times))
    columns = [np.where((s.state[rows, c] > 0).any(1), c, -1) for s, c in ((s, _longest(s.state)) for s in synced)]
    if len({s.joint_names for s in synced}) > 1:
        raise InputError(
            f"The sensors of {recording.name} report different sets of joints; give them one after the other."
        )
    return join_observations(synced, motion.times, columns)


def _longest(state: NDArray[np.uint8]) -> int:
    """Return the index of the person seen longest, of states (T, P, J)."""
    return int((state > 0).any(2).sum(0).argmax())


def _offset(motion: Motion, known: Array, stream: SensorStream) -> float:
    """Compute the seconds to add to a stream's times."""
    common = jt.joint_set(stream.joint_names).common
    begin = float(motion.times[0] - stream.times[0])
    seen = stream.positions[:, _longest(stream.state)][:, common]
    found, likeness = offset_by_movement(motion.times, known, stream.times + begin, seen)
    if likeness < SETTINGS.sensor_alike:
        raise InputError(
            f"The skeletons of {stream.name} move otherwise than the person before the cameras (correlation "
            f"{likeness:.2f}), so their clock cannot be set; give recordings of one person at one time."
        )
    return begin + found


_LEGS = ([jt.LEFT_HIP, jt.LEFT_KNEE, jt.LEFT_FOOT], [jt.RIGHT_HIP, jt.RIGHT_KNEE, jt.RIGHT_FOOT])
_CURE = "place the sensors so that one of them sees each side of the person, and nothing is in between"


def assess_fused(
    motion: Motion, clip: Sequence[SensorJoints], registration: Registration, names: Sequence[str]
) -> Assessment:
    """Assess one person's fused motion.

    clip: what the sensors reported of the person at the motion's times.
    registration: registration of the sensors.
    names: names of the sensors.
    """
    late = [Finding("clock", (), t) for t in _of_clocks(motion.times, clip, names)]
    found = [*(Finding("unit", (), text) for text in _of_size(motion)), *late]
    for name, apart in zip(names, registration.residual.tolist(), strict=True):
        if apart > SETTINGS.sensor_apart_m[0] and not late:
            text = (
                f"{name} and {names[0]} see the joints {1e3 * apart:.0f} mm apart (median), more "
                "than two sensors of one person do: look whether both are in metres, name left and right alike, are "
                "not mirrored, and saw the same movement"
            )
            severity = INVALID if apart > SETTINGS.sensor_apart_m[1] else REVIEW
            found.append(Finding("sensors disagree", (name,), text, size=apart, severity=severity))
    # frames without the person are no failure of the sensors
    if (away := float(motion.lost.mean())) > SETTINGS.verdict_lost_share:
        text = f"no sensor saw the person in {100 * away:.0f} % of the frames"
        found.append(Finding("away", (), text, size=away, severity=REVIEW))
    there = (
        motion
        if motion.low_confidence is None
        else replace(motion, low_confidence=motion.low_confidence & ~motion.lost)
    )
    return assess(there, found, _CURE, 1.0)


def _of_size(motion: Motion) -> Iterator[str]:
    joints = motion.joints[:, [motion.skeleton.joint(n) for n in jt.COMMON]]
    legs = [np.linalg.norm(np.diff(joints[:, leg], axis=1), axis=-1).sum(1) for leg in _LEGS]
    long = float(np.nanmedian(np.concatenate(legs)[np.tile(~motion.lost, 2)])) if (~motion.lost).any() else np.nan
    if np.isfinite(long) and not SETTINGS.sensor_legs_m[0] <= long <= SETTINGS.sensor_legs_m[1]:
        tall = long / SETTINGS.sensor_of_height
        units = [w for factor, w in UNIT_ERRORS for f in (factor, 1 / factor) if 1.3 <= tall / f <= 2.1]
        unit = f": {units[0]}" if units else ""
        yield (
            f"the person would be {tall:.3g} m tall, by their legs{unit}; correct the unit, since skeletons must be in "
            "metres"
        )


def _of_clocks(times: Array, clip: Sequence[SensorJoints], names: Sequence[str]) -> Iterator[str]:
    seen, rate = np.stack([common_joints(f).positions for f in clip]), 1 / float(np.median(np.diff(times)))
    for k, name in enumerate(names):
        if k == 0 or not np.isfinite(seen[:, k]).any() or not np.isfinite(seen[:, 0]).any():
            continue
        late, likeness = offset_by_movement(times, seen[:, 0], times, seen[:, k])
        if likeness < SETTINGS.sensor_like or abs(late) < SETTINGS.sensor_late_s:
            continue
        there, then = _apart(seen[:, [0, k]], 0), _apart(seen[:, [0, k]], round(late * rate))
        if then < min(SETTINGS.sensor_apart_m[0], SETTINGS.sensor_nearer * there):
            when = f"{abs(late):.2f} s {'early' if late > 0 else 'late'}"
            yield (
                f"{name} reports the movements of {names[0]} {when}, so their clocks differ: correct its "
                'times, or say "clock": "own" in a session.json'
            )


def _apart(pair: Array, frames: int) -> float:
    """Compute the median distance (m) between the joints (T, 2, 15, 3) of two registered sensors, with the second's
    shifted by `frames`.
    """
    first, second = (
        (pair[frames:, 0], pair[: len(pair) - frames, 1]) if frames >= 0 else (pair[:frames, 0], pair[-frames:, 1])
    )
    both = np.stack([first, second], 1)
    return float(np.nan_to_num(register(both, np.where(np.isfinite(both[..., 0]), 2, 0)).residual[1], nan=np.inf))


# the 15 common joints by the names of key points; the torso cannot be separated from the spine
SENSOR_JOINT_NAMES = (
    "head",
    "neck",
    "left_shoulder",
    "left_elbow",
    "left_wrist",
    "right_shoulder",
    "right_elbow",
    "right_wrist",
    "torso",
    "left_hip",
    "left_knee",
    "left_ankle",
    "right_hip",
    "right_knee",
    "right_ankle",
)


def pose_fused(fused: Motion, body: Body | None = None, smoothness: float = 1.0) -> tuple[Body, Motion]:
    """Fit a body with the person's bone lengths, and poses (T, 36), to fused joints.

    fused: motion of points (fusion.fuse.Fused.motion) in a world with z up, m.
    body: the template; default: human().
    smoothness: strength of the penalty on acceleration.
    Returns: body and motion; frames in which the person is lost are interpolated and stay marked as lost.
    Raises: InputError where no frame has enough joints.
    """
    points = common_positions(fused)
    points[np.asarray(fused.lost)] = np.nan
    if np.isfinite(points).all(-1).sum(1).max(initial=0) < 8:
        raise InputError("No frame of the fused motion has 8 joints; poses cannot be found from so few.")
    subject = subject_from_keypoints(body or human(), points, SENSOR_JOINT_NAMES)
    model = subject.keypoints
    known = np.flatnonzero(model.known)
    solved = np.flatnonzero(np.isfinite(subject.poses).all(1))
    nearest = solved[np.abs(np.arange(len(points))[:, None] - solved).argmin(1)]
    terms = [[PointTerm(p[known], np.ones(len(known)), model.joint[known], model.offset[known], 0.03)] for p in points]
    prior = anatomical_prior(subject.body.skeleton)
    poses = fit_clip(subject.body, subject.poses[nearest], terms, acceleration=smoothness, priors=(prior,))
    skeleton = subject.body.skeleton
    joints = subject.body.joints(poses)
    names = [SENSOR_JOINT_NAMES[k] for k in known if SENSOR_JOINT_NAMES[k] in skeleton.joint_names]
    # the fused joints of a motion start at the torso; look each up by its name there
    own = [fused.skeleton.joint(n.replace("wrist", "hand").replace("ankle", "foot")) for n in names]
    there = [skeleton.joint(n) for n in names]
    known_of_joints = {
        "joint_covariance": np.nan,
        "systematic_covariance": np.nan,
        "error_probability": np.nan,
        "low_confidence_joints": False,
    }
    arrays = {}
    for name, unknown in known_of_joints.items():
        if (given := getattr(fused, name)) is not None:
            arrays[name] = np.full((*joints.shape[:2], *given.shape[2:]), unknown, given.dtype)
            arrays[name][:, there] = given[:, own]
    return subject.body, replace(fused, skeleton=skeleton, joints=joints, poses=poses, **arrays)
