"""The published comparison of particle filters on HumanEva-like scenes (Alcoverro 2014, Table 2.3)."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hypose.body.body import Body
from hypose.body.models import human
from hypose.evaluation.benchmarks import BenchOptions, BenchReport, Row
from hypose.evaluation.metrics import EVALUATED, JointErrors, carriers, joint_errors, population_offsets
from hypose.evaluation.retarget import retarget
from hypose.evaluation.scenes import Scene, make_scene
from hypose.evaluation.subjects import Subject, load_subjects
from hypose.evidence.frame import Frame
from hypose.pipeline.subject import Subject as TrackedSubject
from hypose.tracking.initialise import start_from_keypoints
from hypose.tracking.recipes import recipe
from hypose.tracking.subject import scaled_to_height
from hypose.tracking.tracker import Tracker, TrackerSettings, motion_of

PRODUCT = "default, estimated body"
PRESETS = ("apf", "hpf", "hpf-apo", "hpf-apo+", "default", PRODUCT)
ACTIONS = ("walk", "box", "run", "combo")
_CAPTURES = {"walk": ("02_01", 0.0), "run": ("02_03", 0.0), "box": ("02_05", 2.5)}
_BUILT_IN = {"walk": "walk", "run": "jog", "box": "box", "combo": "combo"}


@dataclass(frozen=True)
class Outcome:
    """errors of one run and its seconds per frame."""

    errors: JointErrors
    seconds_per_frame: float


def table_2_3(options: BenchOptions) -> BenchReport:
    """Mean joint error of the presets on walk, box, run and combo.

    Scenes: subjects of another shape space than the tracker's body, dressed, one per seed; captured motion where the
    data folder has it (walk, box, run), built-in motion otherwise; rig humaneva-4; masks with outline jitter, holes,
    blobs and shadow (level-1). The tracker is given the subject's height (not shape) and starts at the inverse
    kinematics of the true joints in frame 0. Errors after population offsets of the joint definitions (no subject
    information). `default, estimated body` is the product as a user has it: the body from the silhouettes of another
    clip of the subject, all frames solved together at the end. Medians over the seeds. Baseline of every row: apf on
    the same scenes in the same run. Evaluations per frame: 3600 (apf), 4004 (hpf), 4000 (hpf-apo, hpf-apo+); the
    default's budget is its own.
    """
    from hypose.evaluation import product  # which is built on the scenes of this module

    seeds = options.seed_range(5)
    seconds = 0.6 if options.quick else 2.0
    actions = ("walk",) if options.quick else ACTIONS
    jobs = [(a, s) for a in actions for s in seeds]
    found: dict[tuple[str, str], list[Outcome]] = {}
    bodies: dict[int, Body] = {}
    for n, (action, seed) in enumerate(jobs):
        scene = action_scene(action, seed, seconds, options)
        frames = list(scene.mask_frames(1.0))
        for k, preset in enumerate(PRESETS):
            options.progress(f"{preset} {action} seed {seed}", n * len(PRESETS) + k, len(jobs) * len(PRESETS))
            if preset == PRODUCT:
                bodies[seed] = bodies.get(seed) or product.estimated_body(seed, options)
                outcome = _product_outcome(scene, frames, bodies[seed], seed)
            else:
                outcome = track_scene(scene, frames, preset, seed)
            found.setdefault((preset, action), []).append(outcome)
    options.progress("done", len(jobs) * len(PRESETS), len(jobs) * len(PRESETS))
    rows = table_rows(found, actions)
    settings = {"seeds": len(seeds), "seconds": seconds, "rig": "humaneva-4", "corruption": "level-1", "frame_rate": 25}
    settings["first_seed"] = seeds.start
    settings["motion"] = "captured" if _mocap(options) else "built-in"
    return BenchReport(tuple(rows), settings)


def table_rows(found: Mapping[tuple[str, str], Sequence[Outcome]], actions: Sequence[str]) -> list[Row]:
    """Rows of runs by (preset, action), one outcome per seed: medians over the seeds, of the mean over the actions for
    the case all."""
    rows = []
    presets = [p for p in PRESETS if (p, actions[0]) in found]
    for preset in presets:
        for action in (*actions, "all"):
            chosen = [a for a in actions if action in (a, "all")]
            case = f"{preset}/{action}"

            def values(read: Callable[[Outcome], float], name: str = preset, of: Sequence[str] = chosen) -> list[float]:
                runs = zip(*(found[name, a] for a in of), strict=False)
                return [float(np.mean([read(o) for o in over_actions])) for over_actions in runs]

            base = float(np.median(values(lambda o: 1e3 * o.errors.mean, presets[0])))
            mean = values(lambda o: 1e3 * o.errors.mean)
            against = {"baseline": f"{presets[0]}/{action}", "baseline_value": base}
            rows.append(median_row("mean_error_mm", case, mean, "mm", **against))
            rows.append(median_row("sd_error_mm", case, values(lambda o: 1e3 * o.errors.sd), "mm"))
            rows.append(median_row("p95_error_mm", case, values(lambda o: 1e3 * o.errors.p95), "mm"))
            rows.append(median_row("lost_share", case, values(lambda o: o.errors.lost_share), "1"))
            rows.append(median_row("seconds_per_frame", case, values(lambda o: o.seconds_per_frame), "s"))
    return rows


def median_row(metric: str, case: str, values: Sequence[float], unit: str, **more: Any) -> Row:
    """The median of values (n,) over the seeds with their sd; NaN counts as missing."""
    v = np.asarray(values, dtype=np.float64)
    v = v[np.isfinite(v)]
    sd = float(v.std(ddof=1)) if len(v) > 1 else None
    return Row(metric, case, float(np.median(v)) if len(v) else float("nan"), unit, sd, len(v), **more)


def _mocap(options: BenchOptions) -> bool:
    return options.data is not None and (options.data / "mocap" / "02.asf").exists()


def subject_of_seed(seed: int) -> Subject:
    """The truth body of a seed: spread over all subjects, the neutral one left out."""
    subjects = [s for name, s in load_subjects().items() if name != "neutral"]
    return subjects[(7 * seed) % len(subjects)]


def action_scene(action: str, seed: int, seconds: float, options: BenchOptions) -> Scene:
    """The scene of an action and a seed; see table_2_3."""
    subject = subject_of_seed(seed)
    if action in _CAPTURES and _mocap(options):
        clip, start = _CAPTURES[action]
        folder = options.folder("mocap")
        performance = retarget(folder / "02.asf", folder / f"{clip}.amc", subject, 25.0, start=start, seconds=seconds)
        return make_scene(performance, subject, "humaneva-4", seed=seed, corruption=("level-1",))
    return make_scene(_BUILT_IN[action], subject, "humaneva-4", seconds=seconds, seed=seed, corruption=("level-1",))


def known_subject(scene: Scene, body: Body | None = None) -> TrackedSubject:
    """A body (default: the tracker's, scaled to the subject's height), posed at the true joints of frame 0 (definitions
    aligned)."""
    stature = scene.subject.stature
    body = scaled_to_height(human(), stature) if body is None else body
    offsets = population_offsets(human()) * stature
    # an offset is fixed in the segment that carries it, seen from that segment's own joint
    rest, carrier = body.skeleton.rest_joints, carriers()
    place = rest + offsets - rest[carrier]
    start = start_from_keypoints(body, scene.joints[0][EVALUATED], carrier[EVALUATED], place[EVALUATED])
    return TrackedSubject(body, None, start.pose, ("height and start pose are given",))


def track_scene(scene: Scene, frames: list[Frame], preset: str, seed: int, body: Body | None = None) -> Outcome:
    """One preset on one scene from the given subject and start; body as for `known_subject`."""
    subject = known_subject(scene, body)
    made = recipe(preset, subject.body, frame_rate=scene.frame_rate)
    tracker = Tracker(subject.body, made, TrackerSettings(seed=seed, frame_rate=scene.frame_rate))
    begin = time.perf_counter()
    estimates = [estimate for _, estimate in tracker.follow(tracker.start(subject.start), frames)]
    seconds = (time.perf_counter() - begin) / len(frames)
    motion = motion_of(subject.body, scene.times[: len(frames)], estimates)
    assert motion.poses is not None
    rotations, _ = subject.body.skeleton.forward(motion.poses)
    offsets = population_offsets(human()) * scene.subject.stature
    return Outcome(joint_errors(motion.joints, scene.joints[: len(frames)], offsets, rotations), seconds)


def _product_outcome(scene: Scene, frames: list[Frame], body: Body, seed: int) -> Outcome:
    from hypose.evaluation import product

    begin = time.perf_counter()
    motion = product.product_motion(scene, frames, body, seed)
    seconds = (time.perf_counter() - begin) / len(frames)
    return Outcome(joint_errors(product.aligned_joints(motion, scene), scene.joints[: len(frames)]), seconds)
