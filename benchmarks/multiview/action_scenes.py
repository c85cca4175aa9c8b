"""Scenes of four actions, as HumanEva has them, and one preset tracked on one of them: what the tables measure."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, Row
from benchmarks.synthetic.noisy_masks import noisy_scene
from benchmarks.synthetic.retarget import retarget
from hypose.body.body import Body
from hypose.body.default_body import human
from hypose.evidence.frame import Frame
from hypose.geometry import Array
from hypose.pipeline.subject import TrackedSubject as TrackedSubject
from hypose.synthetic.metrics import CARRIERS, EVALUATED, joint_errors, population_offsets
from hypose.synthetic.scenes import Scene
from hypose.synthetic.subjects import SyntheticSubject, load_subjects
from hypose.tracking.recipes import recipe
from hypose.tracking.start_search import scaled_to_height, start_from_keypoints
from hypose.tracking.tracker import Tracker, TrackerSettings, motion_of

ACTIONS = ("walk", "box", "run", "combo")
_CAPTURES = {"walk": ("02_01", 0.0), "run": ("02_03", 0.0), "box": ("02_05", 2.5)}
_BUILT_IN = {"walk": "walk", "run": "jog", "box": "box", "combo": "combo"}


LOST_M = 0.120
"""m; a frame whose mean error is larger counts as lost."""


@dataclass(frozen=True)
class Outcome:
    """errors (T, 15) m of one run and its seconds per frame."""

    errors: Array
    seconds_per_frame: float

    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        return {"distances": self.errors, "seconds_per_frame": self.seconds_per_frame}

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> Outcome:
        """The outcome of `plain`."""
        return cls(np.asarray(plain["distances"], dtype=np.float64), plain["seconds_per_frame"])


def median_row(metric: str, case: str, values: Sequence[float], unit: str, **more: Any) -> Row:
    """The median of values (n,) over the seeds with their sd; NaN counts as missing."""
    v = np.asarray(values, dtype=np.float64)
    v = v[np.isfinite(v)]
    sd = float(v.std(ddof=1)) if len(v) > 1 else None
    return Row(metric, case, float(np.median(v)) if len(v) else float("nan"), unit, sd, len(v), **more)


def captured(options: BenchOptions) -> bool:
    """Is there captured motion in the data folder?"""
    return options.data is not None and (options.data / "mocap" / "02.asf").exists()


def subject_of_seed(seed: int) -> SyntheticSubject:
    """The truth body of a seed: spread over all subjects, the neutral one left out."""
    subjects = [s for name, s in load_subjects().items() if name != "neutral"]
    return subjects[(7 * seed) % len(subjects)]


def action_scene(action: str, seed: int, seconds: float, options: BenchOptions) -> Scene:
    """The scene of an action and a seed; see table_2_3.table_2_3."""
    subject = subject_of_seed(seed)
    if action in _CAPTURES and captured(options):
        clip, start = _CAPTURES[action]
        folder = options.folder("mocap")
        performance = retarget(folder / "02.asf", folder / f"{clip}.amc", subject, 25.0, start=start, seconds=seconds)
        return noisy_scene(performance, subject, "humaneva-4", seed=seed)
    return noisy_scene(_BUILT_IN[action], subject, "humaneva-4", seconds=seconds, seed=seed)


def known_subject(scene: Scene, body: Body | None = None) -> TrackedSubject:
    """A body (default: the tracker's, scaled to the subject's height), posed at the true joints of frame 0 (definitions
    aligned)."""
    stature = scene.subject.stature
    body = scaled_to_height(human(), stature) if body is None else body
    offsets = population_offsets(human()) * stature
    # an offset is fixed in the segment that carries it, seen from that segment's own joint
    rest, carrier = body.skeleton.rest_joints, CARRIERS
    place = rest + offsets - rest[carrier]
    start = start_from_keypoints(body, scene.joints[0][EVALUATED], carrier[EVALUATED], place[EVALUATED])
    return TrackedSubject(body, None, start.pose, ("height and start pose are given",))


def track_scene(
    scene: Scene, frames: list[Frame], preset: str, seed: int, body: Body | None = None, *, every: int = 1, **own: Any
) -> Outcome:
    """One preset on one scene from the given subject and start; body as for `known_subject`; every: one frame of so
    many is judged; own: options of the recipe."""
    subject = known_subject(scene, body)
    made = recipe(preset, subject.body, frame_rate=scene.frame_rate, **own)
    tracker = Tracker(subject.body, made, TrackerSettings(seed=seed, frame_rate=scene.frame_rate))
    begin = time.perf_counter()
    estimates = [estimate for _, estimate in tracker.follow(tracker.start(subject.start), frames)]
    seconds = (time.perf_counter() - begin) / len(frames)
    motion = motion_of(subject.body, scene.times[: len(frames)], estimates)
    assert motion.poses is not None
    judged = slice(0, len(frames), every)
    rotations, _ = subject.body.skeleton.forward(motion.poses[judged])
    offsets = population_offsets(human()) * scene.subject.stature
    return Outcome(joint_errors(motion.joints[judged], scene.joints[judged], offsets, rotations), seconds)
