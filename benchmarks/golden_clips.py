"""Track the golden clips: twelve short clips of every kind, whose errors, verdicts and speed are kept.

Synthetic clips move by the built-in motions, so that they are the same with and without real recordings.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import islice
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_report import BenchOptions
from benchmarks.depth_sensors.depth_tracking import aligned
from benchmarks.depth_sensors.depth_tracking import scene_of as depth_scene_of
from benchmarks.depth_sensors.fusion_scenes import scene_recording
from benchmarks.multiview.action_scenes import known_subject
from benchmarks.multiview.error_scenes import CASES, Case, bare_scene, cut
from benchmarks.multiview.product import aligned_joints, estimated_body
from benchmarks.multiview.real_recordings import LIMBS, balancing_recording, clicked_joints, uu4cam_recording
from benchmarks.multiview.things_in_masks import with_thing
from benchmarks.people.together import RIGS, SETTINGS
from benchmarks.synthetic.depth_frames import depth_frames
from benchmarks.synthetic.noisy_masks import noisy_scene
from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.evidence.frame import Frame
from hypose.evidence.keypoints import BODY_25B
from hypose.fusion import joints as jt
from hypose.fusion.fuse import common_positions, fuse_clip
from hypose.geometry import Array
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import Recording
from hypose.pipeline.assessment import GOOD, LOOK, UNTRUSTED
from hypose.pipeline.run import TrackResult
from hypose.pipeline.sensor_skeletons import assess_fused
from hypose.pipeline.sources import FrameList
from hypose.pipeline.subject import SubjectOptions, find_subject
from hypose.pipeline.track import track_people, track_source
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.metrics import EVALUATED

RATE = 25.0
T = TypeVar("T")
VERDICTS = (GOOD, LOOK, UNTRUSTED)
"""Worse and worse; a row has the number."""


@dataclass(frozen=True)
class Outcome:
    """What came out of a clip.

    error: (T, J) m from the truth (or the reference), NaN where that is not known.
    p: (T, J), probability of each joint of being wrong.
    doubtful: (T,), frames that are marked.
    verdict: index in VERDICTS.
    seconds: s of processor time per frame.
    """

    error: Array
    p: Array
    low_confidence: NDArray[np.bool_]
    assessment: int
    seconds: float


Measure = Callable[[int, Path], Iterator[tuple[str, Outcome]]]
"""Tracks a clip of a seed, with the folder of recordings; yields (case, outcome)."""


@dataclass(frozen=True)
class Clip:
    """measure: tracks it; recording: folder of the recordings that it needs, "" for none; quick: in the short run."""

    measure: Measure
    recording: str = ""
    quick: bool = False


@cache
def _body(seed: int) -> Body:
    return estimated_body(seed, BenchOptions())


def _outcome(
    motion: Motion, error: Array, joints: Sequence[int] | NDArray[np.int64], assessment: str, seconds: float
) -> Outcome:
    """joints: indices of the motion's joints that error (T, J) is of."""
    assert motion.error_probability is not None and motion.low_confidence is not None
    p = motion.error_probability[-len(error) :][:, joints].astype(np.float64)
    return Outcome(error, p, motion.low_confidence, VERDICTS.index(assessment), seconds / len(motion))


def _timed(call: Callable[[], T]) -> tuple[T, float]:
    begin = time.process_time()
    return call(), time.process_time() - begin


def _names_exchanged(frames: list[Frame], view: int) -> list[Frame]:
    """Left and right exchanged in the names of all key points of one view."""
    out = []
    for f in frames:
        assert f.keypoints is not None
        names, points = f.keypoints.names, f.keypoints.points.copy()
        turned = {"left": "right", "right": "left"}
        other = ["_".join(turned.get(word, word) for word in n.split("_")) for n in names]
        points[view] = points[view, [names.index(n) for n in other]]
        out.append(replace(f, keypoints=replace(f.keypoints, points=points)))
    return out


def _scene(name: str, evidence: str, exchanged: bool, seed: int, data: Path) -> Iterator[tuple[str, Outcome]]:
    """A case of error_scenes, tracked by one evidence; exchanged: left and right names of a view."""
    case: Case = CASES[name]
    scene = bare_scene(case, seed, 1.2)
    frames = list(scene.mask_frames(1.0, keypoints=evidence != "silhouettes"))
    frames = with_thing(frames, scene, case.thing) if case.thing else frames
    frames = _names_exchanged(frames, 1) if exchanged else frames
    frames = [replace(f, silhouettes=None) for f in frames] if evidence == "keypoints" else frames
    body = None if case.own or exchanged else _body(seed)

    def track() -> TrackResult:
        source, subject = FrameList(frames, scene.frame_rate), None
        if body is not None and evidence == "silhouettes":
            subject = known_subject(scene, body)
        elif body is not None:
            how = SubjectOptions("keypoints", frame_rate=scene.frame_rate, body=body)
            subject = find_subject(source.frame, len(source), how)
        return track_source(source, scene.frame_rate, TrackOptions(seed=seed, evidence=evidence), subject=subject)

    found, seconds = _timed(track)
    away = np.linalg.norm(aligned_joints(found.motion, scene) - scene.joints[: len(frames)], axis=-1)
    yield "", _outcome(found.motion, away[:, EVALUATED], EVALUATED, found.assessment.word, seconds)


def _crossing(seed: int, data: Path) -> Iterator[tuple[str, Outcome]]:
    """Two people who pass each other, tracked together, where they are nearest."""
    performers = SETTINGS["crossing"].make(seed, None)
    one, two = (p.root[:, :2] for _, p in performers)
    nearest = int(np.linalg.norm(one - two, axis=1).argmin())
    count = round(1.4 * RATE)
    first = min(max(nearest - count // 2, 0), len(one) - count)
    scenes = [
        cut(noisy_scene(p, s, RIGS["4"], seconds=len(one) / RATE, seed=seed + k), first)
        for k, (s, p) in enumerate(performers)
    ]
    both = replace(scenes[0], others=((scenes[1].subject, scenes[1].performance),))
    frames = list(islice(both.mask_frames(1.0), count))
    options = TrackOptions(seed=seed, evidence="silhouettes")
    found, seconds = _timed(lambda: track_people(FrameList(frames, RATE), RATE, options).people)
    # each true person's track is the nearest one: of a person who is not tracked that is the other one's, far away
    outcomes = []
    for scene in scenes:
        tried = [np.linalg.norm(aligned_joints(p.motion, scene) - scene.joints[:count], axis=-1) for p in found]
        k = int(np.argmin([a.mean() for a in tried]))
        person = found[k]
        outcomes.append(_outcome(person.motion, tried[k][:, EVALUATED], EVALUATED, person.assessment.word, seconds))
    a, b = outcomes
    yield (
        "",
        Outcome(
            np.concatenate([a.error, b.error]),
            np.concatenate([a.p, b.p]),
            np.concatenate([a.low_confidence, b.low_confidence]),
            max(a.assessment, b.assessment),
            a.seconds,
        ),
    )


def _depth(seed: int, data: Path) -> Iterator[tuple[str, Outcome]]:
    """A person before two depth cameras."""
    scene = depth_scene_of(seed, "depth-2", 1.2, BenchOptions())
    source = FrameList(list(depth_frames(scene)), RATE)
    found, seconds = _timed(lambda: track_source(source, RATE, TrackOptions(seed=seed)))
    away = np.linalg.norm(aligned(found.motion, scene) - scene.joints[: len(source)], axis=-1)
    yield "", _outcome(found.motion, away[:, EVALUATED], EVALUATED, found.assessment.word, seconds)


def _first_of(recording: Recording, first: int, count: int) -> FrameList:
    with FrameStream(replace(recording, frame_range=(first, first + count))) as stream:
        return FrameList([stream.frame(i) for i in range(count)], recording.frame_rate)


def _balancing(seed: int, data: Path) -> Iterator[tuple[str, Outcome]]:
    """A real clip by silhouettes, by key points and by both, against triangulated key points: one subject for all."""
    folder = data / "pose2sim_balancing"
    first = 1 + seed % 40
    source = _first_of(balancing_recording(folder), first, 25)
    reference = np.load(folder / "kp3d_refined_m.npy")[first - 1 :][: len(source), LIMBS]  # points t: video frame t + 1
    rate = source.frame_rate
    subject, found_in = _timed(
        lambda: find_subject(source.frame, len(source), SubjectOptions("keypoints", frame_rate=rate))
    )
    for evidence in ("silhouettes", "keypoints", "both"):
        options = TrackOptions(seed=seed, evidence=evidence)
        found, seconds = _timed(lambda o=options: track_source(source, rate, o, subject=subject))
        motion = found.motion
        assert motion.poses is not None
        joints = [motion.skeleton.joint(BODY_25B[k]) for k in LIMBS]
        rotations, centres = motion.skeleton.forward(motion.poses)
        # key points and joints are defined differently: one offset per joint in its segment's frame
        local = np.einsum("tkba,tkb->tka", rotations[:, joints], reference - centres[:, joints])
        error = np.linalg.norm(local - np.nanmean(local, 0), axis=-1)
        yield evidence, _outcome(motion, error, joints, found.assessment.word, seconds + found_in / 3)


def _uu4cam(seed: int, data: Path) -> Iterator[tuple[str, Outcome]]:
    """A real seated person by silhouettes, against joints clicked in the pictures."""
    recording = uu4cam_recording(data / "uu4cam")
    source = _first_of(recording, seed % 100, 25)
    options = TrackOptions(seed=seed, evidence="silhouettes")
    found, seconds = _timed(lambda: track_source(source, source.frame_rate, options))
    clicks = clicked_joints(recording.rig)
    joints = [found.motion.skeleton.joint(name) for name in clicks]
    error = np.linalg.norm(found.motion.joints[:, joints] - np.stack(list(clicks.values())), axis=-1)
    yield "", _outcome(found.motion, error, joints, found.assessment.word, seconds)


def _human4d(seed: int, data: Path) -> Iterator[tuple[str, Outcome]]:
    """A real run as four simulated sensors report it, fused."""
    recording = scene_recording("H", seed, BenchOptions(data=data))
    frames = recording.frames()
    fused, seconds = _timed(lambda: fuse_clip(frames))
    error = np.linalg.norm(common_positions(fused.motion) - recording.truth_in(0), axis=-1)
    joints = [fused.motion.skeleton.joint(n) for n in jt.COMMON]
    assessment = assess_fused(fused.motion, frames, fused.registration, fused.sensor_names)
    yield "", _outcome(fused.motion, error, joints, assessment.word, seconds)


CLIPS: Mapping[str, Clip] = {
    "walk": Clip(partial(_scene, "walk", "silhouettes", False), quick=True),
    "box": Clip(partial(_scene, "box", "both", False)),
    "run": Clip(partial(_scene, "run", "keypoints", False), quick=True),
    "combo": Clip(partial(_scene, "combo", "silhouettes", False)),
    "seated-chair": Clip(partial(_scene, "seated-chair", "silhouettes", False), quick=True),
    "names-exchanged": Clip(partial(_scene, "walk", "both", True), quick=True),
    "coat": Clip(partial(_scene, "coat-walk", "silhouettes", False)),
    "crossing": Clip(_crossing),
    "depth": Clip(_depth),
    "balancing": Clip(_balancing, "pose2sim_balancing", quick=True),
    "uu4cam": Clip(_uu4cam, "uu4cam"),
    "human4d": Clip(_human4d, "human4d_run", quick=True),
}
"""All clips by name."""
