"""Depth cameras whose places nobody knows, brought together by the person who moves before them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.body.ready_bodies import human
from hypose.calibration.depth_registration import (
    Rough,
    in_camera,
    refine_registration,
    rough_registration,
)
from hypose.cameras.camera import CameraRig
from hypose.errors import HyposeError, InputError
from hypose.evidence.depth_evidence import Depth, SurfacePoints
from hypose.evidence.frame import Frame
from hypose.evidence.silhouettes import make_silhouettes
from hypose.geometry import Array, se3_inverse
from hypose.pipeline.first_frame import Subject
from hypose.pipeline.run import TrackOptions, TrackResult, track_source
from hypose.pipeline.subject_from_motion import AnthropometryOptions, different_poses, estimate_subject
from hypose.pipeline.track_loop import FrameList

_FRAMES = 24
"""different poses that are solved for together"""
_ROUNDS = 2
Report = Callable[[str, int, int], None]


@dataclass(frozen=True)
class RegisteredSensors:
    """rig: the sensors in the world of the first; seconds (C,): to add to each one's times; body; rough: what each of
    the others was found by at first."""

    rig: CameraRig
    seconds: Array
    body: Body
    rough: tuple[Rough, ...]


def register_depth(
    clips: Sequence[Sequence[Frame]], frame_rate: float, *, seed: int = 0, progress: Report | None = None
) -> RegisteredSensors:
    """The places of depth cameras from what each alone saw of one person.

    clips: frames of each sensor, whose rig is that sensor alone in a world of its own with z up and the floor at z = 0
    (`hypose.evidence.depth_floor.camera_on_floor`); times on its own clock. The first one's world is kept. An
    InputError with fewer than two; a CalibrationError when the movements do not belong together; errors name the
    sensors. A KeyboardInterrupt in progress ends it."""
    if len(clips) < 2:
        raise InputError("Bringing depth cameras together needs at least two; one stands where it stands.")
    report = progress or (lambda stage, done, total: None)
    options = TrackOptions(seed=seed)
    own = [clip[0].depth for clip in clips]
    if any(d is None for d in own):
        raise InputError("Every clip must have depth; leave cameras without it out.")
    alone = [d.rig[0] for d in own if d is not None]
    joints, times = [], [np.array([f.time for f in clip]) for clip in clips]
    ends = np.cumsum([len(clip) for clip in clips]).tolist()
    for k, clip in enumerate(clips):

        def tracked_alone(stage: str, done: int, _: int, before: int = ends[k] - len(clip)) -> None:
            if stage == "track":
                report("each sensor alone", before + done, ends[-1])

        with _named(alone[k].name):
            found = track_source(FrameList(clip, frame_rate), frame_rate, options, progress=tracked_alone)
            joints.append(_whole(found).joints)
    rough = list[Rough]()
    for k in range(1, len(clips)):
        with _named(f"{alone[0].name} and {alone[k].name}"):
            rough.append(rough_registration(times[0], joints[0], times[k], joints[k]))
    seconds = np.array([0.0, *(r.seconds for r in rough)])
    cameras = np.stack(
        [alone[0].camera_from_world]
        + [c.camera_from_world @ se3_inverse(r.a_from_b) for c, r in zip(alone[1:], rough, strict=True)]
    )
    paired = _pairs(times, seconds, frame_rate)
    body = human()
    for n in range(_ROUNDS):
        report("together", n, _ROUNDS)
        rig = CameraRig(tuple(replace(c, camera_from_world=e) for c, e in zip(alone, cameras, strict=True)))
        frames = [_together(clips, row, rig) for row in paired]
        how = AnthropometryOptions(frames=8, tracked=24, passes=1, seed=seed)
        estimate = estimate_subject(lambda i, f=frames: f[i], len(frames), frame_rate, human(), how)
        body = estimate.body
        subject = Subject(body, None, estimate.start, ())
        source = FrameList(frames, frame_rate)
        tracked = _whole(track_source(source, frame_rate, options, subject=subject, find_places=False))
        poses = tracked.poses
        assert poses is not None
        chosen = different_poses(body, poses, 1 - tracked.cost, _FRAMES)
        seen = [[_surface(clips[k][paired[t][k]]) for t in chosen] for k in range(len(clips))]
        cameras = refine_registration(body, poses[chosen], seen, cameras).camera_from_world
    report("together", _ROUNDS, _ROUNDS)
    rig = CameraRig(tuple(replace(c, camera_from_world=e) for c, e in zip(alone, cameras, strict=True)))
    return RegisteredSensors(rig, seconds, body, tuple(rough))


@contextmanager
def _named(who: str) -> Iterator[None]:
    """Errors within name whom they are about."""
    try:
        yield
    except HyposeError as error:
        raise type(error)(f"{who}: {error}") from error


def _whole(found: TrackResult) -> Motion:
    """The motion; a run that was interrupted gives the part before, with which nothing goes on."""
    if not found.complete:
        raise KeyboardInterrupt
    return found.motion


def _pairs(times: Sequence[Array], seconds: Array, frame_rate: float) -> list[list[int]]:
    """Per frame of the first sensor which all see: the frame of each that is nearest in time."""
    out = []
    for k, t in enumerate(times[0]):
        row = [k]
        for own, shift in zip(times[1:], seconds[1:], strict=True):
            at = int(np.abs(own + shift - t).argmin())
            if abs(own[at] + shift - t) <= 0.6 / frame_rate:
                row.append(at)
        if len(row) == len(times):
            out.append(row)
    if len(out) < 10:
        raise InputError("The depth cameras share fewer than ten instants; start them together, or record for longer.")
    return out


def _surface(frame: Frame) -> SurfacePoints:
    """What a sensor's frame shows, in the sensor's own frame."""
    assert frame.depth is not None
    return in_camera(frame.depth.surface, frame.depth.rig[0].camera_from_world)


def _together(clips: Sequence[Sequence[Frame]], row: Sequence[int], rig: CameraRig) -> Frame:
    """One frame of all sensors."""
    own = [clip[k].depth for clip, k in zip(clips, row, strict=True)]
    sizes = rig.sizes
    h, w = int(sizes[:, 1].max()), int(sizes[:, 0].max())
    maps, masks = np.zeros((len(rig), h, w), np.float32), []
    for c, depth in enumerate(own):
        assert depth is not None
        width, height = sizes[c]
        maps[c, :height, :width] = depth.maps[0, :height, :width]
        masks.append(depth.person[0, :height, :width])
    silhouettes = make_silhouettes(masks, rig)
    first = clips[0][row[0]]
    return Frame(first.time, first.index, silhouettes, depth=Depth(maps, silhouettes.masks, rig, silhouettes.usable))
