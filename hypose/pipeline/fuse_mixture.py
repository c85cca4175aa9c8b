"""Skeletons that makers' programs report beside depth maps and silhouettes: one solve on all of it.

The cameras alone give a first motion and the body; it tells where each skeleton's sensor stands, on which side of the
body it takes left for right, and where its joints sit on the body. Then everything is tracked once more, the
skeletons' joints as points beside the other rows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.errors import InputError
from hypose.evidence.frame import TRACKED, Frame, SensorJoints
from hypose.fitting import PointTerm
from hypose.fusion import joints as jt
from hypose.fusion.clocks import offset_by_movement
from hypose.fusion.register import LARGEST_RESIDUAL_M, Registration, common_joints, register
from hypose.geometry import Array
from hypose.io.motions.results import ResultsFolder
from hypose.io.sensors.skeleton_streams import (
    SensorStream,
    SkeletonRecording,
    one_person,
    resample,
    shifted,
)
from hypose.pipeline.run import TrackOptions, TrackResult, track_source
from hypose.pipeline.track_loop import FrameSource, Progress
from hypose.tracking.refinement import KEYPOINT_SHARE

SCALE_M, WEIGHT = 0.04, 0.3
"""m: sd of a reported joint; weight of one in units of the robust rows' cost, half of it where it was inferred"""
_FEWEST = 10


@dataclass(frozen=True)
class SkeletonRows:
    """Joints of sensors' skeletons as evidence of one's own (`hypose.tracking.frame_evidence.OwnEvidence`).

    points (T, P, 3) m, world, NaN where missing; weight (T, P); joint (P,), offset (P, 3) m in the joint's frame: where
    they sit on the body; row: of a frame's index."""

    points: Array
    weight: Array
    joint: NDArray[np.int64]
    offset: Array
    row: Mapping[int, int]

    def rows(self, body: Body, frame: Frame, /) -> PointTerm | None:
        """For the solver."""
        n = self.row.get(frame.index)
        if n is None or not (self.weight[n] > 0).any():
            return None
        return PointTerm(self.points[n], self.weight[n], self.joint, self.offset, SCALE_M)

    def energy(self, body: Body, poses: Array, frame: Frame, /) -> Array:
        """(N,) for the search: the same cost, in shares of the masks."""
        n = self.row.get(frame.index)
        used = np.flatnonzero(self.weight[n] > 0) if n is not None else np.zeros(0, np.int64)
        if n is None or not len(used):
            return np.zeros(len(poses))
        rotations, centres = body.skeleton.forward(poses)
        joint = self.joint[used]
        at = centres[:, joint] + np.einsum("nkab,kb->nka", rotations[:, joint], self.offset[used])
        squared = ((at - self.points[n, used]) ** 2).sum(-1) / (2 * SCALE_M) ** 2
        return KEYPOINT_SHARE * 2 * (self.weight[n, used] * np.log1p(squared)).sum(-1)


def fuse_mixture(
    source: FrameSource,
    frame_rate: float,
    skeletons: Sequence[SensorJoints] | Callable[[Motion], Sequence[SensorJoints]],
    options: TrackOptions,
    *,
    progress: Progress | None = None,
    results: ResultsFolder | None = None,
    record: Mapping[str, Any] | None = None,
) -> TrackResult:
    """The motion from cameras and skeletons in one solve.

    source: frames with depth maps, silhouettes or both, in a world with z up; skeletons: one per frame, of K sensors
    of any set of joints that is known (`hypose.fusion.register.common_joints`), each in its own frame and at the
    frame's time; or what makes them of the motion that the cameras give alone. results, record: as for `track_source`.
    A sensor that moves otherwise than the person before the cameras is left out. An InputError when their
    numbers differ, or when no sensor is left. What is interrupted gives the motion of the cameras until then."""
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
    """The common joints of one skeleton per frame."""
    if len(skeletons) != frames:
        raise InputError(f"There are {len(skeletons)} skeletons for {frames} frames; give one per frame.")
    common = [common_joints(s) for s in skeletons]
    if len(sensors := {s.sensor_names for s in common}) > 1:
        raise InputError(f"Every frame needs the same sensors, got {sorted(sensors)}; a missing one has NaN.")
    return common


def skeleton_rows(
    motion: Motion, skeletons: Sequence[SensorJoints], indices: Sequence[int]
) -> tuple[SkeletonRows, Registration]:
    """Skeletons (T) as evidence in the world of a motion (T) of the same person, and where their sensors stand: sensor
    0 of the registration is the motion itself; sensors that stay apart from it are not registered, and no evidence.
    indices (T,): of the frames."""
    assert motion.poses is not None
    known = motion.joints[:, jt.BODY_JOINT]  # (T, 15, 3)
    known = np.where(motion.lost[:, None, None], np.nan, known)
    seen = np.stack([s.positions for s in skeletons])  # (T, K, 15, 3)
    state = np.stack([s.state for s in skeletons])
    states = np.concatenate([np.full_like(state[:, :1], TRACKED), state], axis=1)
    place = register(np.concatenate([known[:, None], seen], axis=1), states)
    # who sees a back may take left for right
    world = place.apply(np.concatenate([known[:, None], seen], axis=1))[:, 1:]
    straight, mirrored = (_median_away(w, known) for w in (world, world[:, :, jt.MIRROR]))
    exchanged = (mirrored < 0.7 * straight)[..., None]
    # who was filmed at another time is registered, too, but stays apart
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
    enough = np.isfinite(own[..., 0]).sum(0) >= _FEWEST  # (K, 15)
    offset = np.zeros((sensors, 15, 3))
    for k, j in np.argwhere(enough):
        offset[k, j] = np.nanmedian(own[:, k, j], axis=0)
    there = np.isfinite(world).all(-1) & enough
    weight = np.where(there, WEIGHT * state / TRACKED, 0.0)
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
    """(T, K) m: median over the joints of how far points (T, K, 15, 3) lie from known (T, 15, 3); infinite where none
    is seen."""
    away = np.linalg.norm(points - known[:, None], axis=-1)
    counted = np.isfinite(away)
    middle = np.nanmedian(np.where(counted.any(-1, keepdims=True), away, 1e9), axis=-1)
    return np.where(counted.any(-1), middle, np.inf)


_ALIKE = 0.5
"""correlation of movements below which two clocks cannot be brought together"""


def skeletons_at_frames(recording: SkeletonRecording, motion: Motion) -> list[SensorJoints]:
    """The skeletons of a recording at the frames of a motion of the same person. Their clock is set by the movement:
    one for all sensors, or one for each where they have their own. Of several persons the one that a sensor sees
    longest counts. An InputError when a clock cannot be set."""
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
    return one_person(synced, motion.times, columns)


def _longest(state: NDArray[np.uint8]) -> int:
    """Who is seen longest, of states (T, P, J)."""
    return int((state > 0).any(2).sum(0).argmax())


def _offset(motion: Motion, known: Array, stream: SensorStream) -> float:
    """s to add to a stream's times."""
    common = jt.joint_set(stream.joint_names).common
    begin = float(motion.times[0] - stream.times[0])
    seen = stream.positions[:, _longest(stream.state)][:, common]
    found, likeness = offset_by_movement(motion.times, known, stream.times + begin, seen)
    if likeness < _ALIKE:
        raise InputError(
            f"The skeletons of {stream.name} move otherwise than the person before the cameras (correlation "
            f"{likeness:.2f}), so their clock cannot be set; give recordings of one person at one time."
        )
    return begin + found
