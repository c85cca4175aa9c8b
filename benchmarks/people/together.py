"""`bench people`: two and three people in the same masks, found, fitted and tracked together, beside each one alone.

Nothing is given: neither heights nor bodies nor starts. Captured boxing where the data are there, else built-in motion.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from benchmarks.multiview.action_scenes import captured, subject_of_seed
from benchmarks.synthetic.noisy_masks import noisy_scene
from benchmarks.synthetic.retarget import retarget
from hypose.body.default_body import human
from hypose.body.motion import Motion
from hypose.compute.warming import warm_up
from hypose.errors import HyposeError
from hypose.evidence.association import people_of
from hypose.evidence.keypoints import BODY_25, to_keypoints
from hypose.geometry import Array
from hypose.pipeline.run import TrackResult, track_people, track_source
from hypose.pipeline.track_loop import FrameList
from hypose.pipeline.track_management import KeypointPeople
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.metrics import joint_errors, population_offsets
from hypose.synthetic.motions import act
from hypose.synthetic.performance import Performance, moved
from hypose.synthetic.scenes import Scene, keypoint_detections, make_scene
from hypose.synthetic.subjects import SyntheticSubject

RATE = 25.0
SECONDS = 4.0
FAR_MM, SOON_S, GOOD_MM = 120.0, 0.4, 30.0
RIGS = {"4": "humaneva-4", "5": "ring-5", "8": "ring-8"}
Performer = tuple[SyntheticSubject, Performance]


@dataclass(frozen=True)
class Setting:
    """make: the people of a seed; near: m, how near the nearest two come; points: with key points; away: s, from when
    to when the second person is out of all views, None: never."""

    make: Callable[[int, Path | None], list[Performer]]
    near: float
    points: bool = False
    away: tuple[float, float] | None = None


def _subjects(seed: int, count: int) -> list[SyntheticSubject]:
    return [subject_of_seed(3 * seed + 5 * k + 1) for k in range(count)]


def _motion(name: str, subject: SyntheticSubject, seed: int, captures: Path | None) -> Performance:
    """A motion about the origin: boxing is a captured one where the folder of captures is there."""
    if name == "box" and captures is not None:
        start = 2.5 + 0.5 * (seed % 8)
        p = retarget(captures / "02.asf", captures / "02_05.amc", subject, RATE, start=start, seconds=SECONDS)
        centre = p.root[:, :2].mean(0)
        return moved(p, 0.0, (-float(centre[0]), -float(centre[1])))
    return act(name, subject, SECONDS, RATE, np.random.default_rng([seed, 17]))


def nearest(a: Performance, b: Performance) -> float:
    """m: how near two people come, between their roots on the floor."""
    n = min(len(a), len(b))
    return float(np.linalg.norm((a.root[:n] - b.root[:n])[:, :2], axis=1).min())


def _turned_to(
    a: Performance,
    b: Performance,
    near: float,
    shift: tuple[float, float] = (0.0, 0.0),
    beside: Sequence[Performance] = (),
) -> Performance:
    """b, turned and shifted so that it comes as near to a as wanted, and no nearer to those beside."""
    tried = [
        moved(b, float(yaw), (shift[0] + float(dx), shift[1] + float(dy)))
        for yaw in np.arange(0, 2 * np.pi, 0.2)
        for dx in (-0.3, 0.0, 0.3)
        for dy in (-0.3, 0.0, 0.3)
    ]

    def amiss(q: Performance) -> float:
        return abs(nearest(a, q) - near) + sum(max(0.0, near - nearest(o, q)) for o in beside)

    return min(tried, key=amiss)


def _walks(near: float, seed: int, captures: Path | None) -> list[Performer]:
    a, b = _subjects(seed, 2)
    one = moved(_motion("walk", a, seed, captures), 0.0, (-0.3, 0.0))
    return [(a, one), (b, _turned_to(one, _motion("walk", b, seed + 50, captures), near, (0.3, 0.0)))]


def _around(seed: int, captures: Path | None) -> list[Performer]:
    a, b = _subjects(seed, 2)
    stands = moved(_motion("wave", b, seed, captures), 0.3 * seed, (0.0, 0.0))
    return [(a, _turned_to(stands, _motion("walk", a, seed, captures), 0.75)), (b, stands)]


def _beside(first: str, second: str, gap: float, seed: int, captures: Path | None) -> list[Performer]:
    a, b = _subjects(seed, 2)
    one, two = _motion(first, a, seed, captures), _motion(second, b, seed + 50, captures)
    return [(a, moved(one, 0.0, (-gap / 2, 0.0))), (b, moved(two, 0.0, (gap / 2, 0.0)))]


def _meeting(first: str, near: float, seed: int, captures: Path | None) -> list[Performer]:
    """Somebody who stays, and somebody who walks past."""
    a, b = _subjects(seed, 2)
    one, two = _motion(first, a, seed, captures), _motion("walk", b, seed + 50, captures)
    one = moved(one, 0.0, (-0.6, 0.0))
    return [(a, one), (b, _turned_to(one, two, near, (0.5, 0.0)))]


def _three(seed: int, captures: Path | None) -> list[Performer]:
    a, b, c = _subjects(seed, 3)
    stands = moved(_motion("wave", b, seed, captures), 0.3, (0.0, 0.0))
    walks = _turned_to(stands, _motion("walk", a, seed, captures), 0.75)
    boxes = _turned_to(walks, _motion("box", c, seed + 50, captures), 0.75, (0.95, 0.95), [stands])
    return [(a, walks), (b, stands), (c, boxes)]


SETTINGS: Mapping[str, Setting] = {
    "crossing": Setting(partial(_walks, 0.7), 0.7),
    "around": Setting(_around, 0.75),
    "beside": Setting(partial(_beside, "box", "wave", 1.0), 1.0),
    "sitting": Setting(partial(_meeting, "sit_down", 0.7), 0.7),
    "returning": Setting(partial(_meeting, "box", 0.7), 0.7, away=(1.2, 2.2)),
    "three": Setting(_three, 0.7),
    "close": Setting(partial(_walks, 0.55), 0.55),
    "touching": Setting(partial(_beside, "box", "wave", 0.55), 0.0),
    "touching+keypoints": Setting(partial(_beside, "box", "wave", 0.55), 0.0, points=True),
}
FOUR, QUICK = tuple(SETTINGS), ("crossing",)
"""Settings seen by four cameras, and those of a quick run; with five and eight all but the touching ones."""


def people(options: BenchOptions) -> BenchReport:
    """People in the same masks beside each person alone: see the page of this benchmark."""
    seeds = options.seed_range(5, first=SEED)
    cases = [(name, "4") for name in (QUICK if options.quick else FOUR)]
    if not options.quick:
        cases += [(name, views) for views in ("5", "8") for name in FOUR if not name.startswith("touching")]
    found: dict[tuple[str, str, int], dict[str, Any]] = {}
    for k, (name, views) in enumerate(cases):
        for n, seed in enumerate(seeds):
            options.progress(f"{name}, {views} cameras, seed {seed}", k * len(seeds) + n, len(cases) * len(seeds))
            part = f"people.{name}.{views}.{seed}"
            found[name, views, seed] = options.part(part, partial(run, name, views, seed, options))
    options.progress("done", 1, 1)
    settings = {"seeds": len(seeds), "first_seed": seeds.start, "seconds": SECONDS, "frame_rate": RATE, "rigs": RIGS}
    return BenchReport(tuple(people_rows(found)), settings)


SEED = 300


@cache
def _warm() -> None:
    """What is compiled or loaded at the first call belongs to nobody's time."""
    warm_up()
    scenes = [make_scene(p, s, RIGS["4"], seconds=0.6, seed=7) for s, p in SETTINGS["beside"].make(1, None)]
    frames = list(replace(scenes[0], others=((scenes[1].subject, scenes[1].performance),)).mask_frames(1.0))[:15]
    with contextlib.suppress(HyposeError):
        track_people(FrameList(frames, RATE), RATE, TrackOptions(evidence="silhouettes"))
    _alone(scenes[0], 15, False)


def run(name: str, views: str, seed: int, options: BenchOptions) -> dict[str, Any]:
    """One setting: everybody together, and each alone."""
    _warm()
    setting = SETTINGS[name]
    performers = setting.make(seed, options.folder("mocap") if captured(options) else None)
    seconds = 1.6 if options.quick else SECONDS
    scenes = [
        noisy_scene(p, s, RIGS[views], seconds=seconds, seed=1000 + 10 * seed + k)
        for k, (s, p) in enumerate(performers)
    ]
    present = np.ones((len(scenes), len(scenes[0])), dtype=np.bool_)
    if setting.away is not None:
        a, b = (round(t * RATE) for t in setting.away)
        present[1, a:b] = False
        scenes[1] = replace(scenes[1], performance=out_of_view(scenes[1].performance, ~present[1]))
    together = replace(scenes[0], others=tuple((s.subject, s.performance) for s in scenes[1:]))
    count = round(seconds * RATE)
    union = list(together.mask_frames(1.0))[:count]
    clock = _Clock()
    tracked = track_people(
        FrameList(union, RATE),
        RATE,
        TrackOptions(evidence="both" if setting.points else "silhouettes"),
        progress=clock,
        points=_points(scenes, count) if setting.points else None,
    )
    alone = [_alone(s, count, setting.points) for s in scenes]
    return {
        **_judged(tracked.people, scenes, present[:, :count], setting),
        "alone": [e for e, _ in alone],
        "time": clock.track - clock.starts,
        "time_of_late_starts": clock.starts,
        "time_alone": [t for _, t in alone],
        "near": min(nearest(a.performance, b.performance) for k, a in enumerate(scenes) for b in scenes[:k]),
    }


def _points(scenes: Sequence[Scene], count: int) -> KeypointPeople:
    """Key points of everybody, as detectors give them: per view several people, in no order."""
    seen = [[keypoint_detections(s, c) for c in range(len(s.rig))] for s in scenes]
    small = scenes[0].given_rig.pinhole()
    frames = []
    for t in range(count):
        flat = [to_keypoints([v[t] for v in one], BODY_25, scenes[0].given_rig, small).points for one in seen]
        frames.append([np.stack([f[c] for f in flat]) for c in range(len(small))])
    return KeypointPeople(people_of(frames, BODY_25, small, RATE), BODY_25, small)


def out_of_view(p: Performance, away: NDArray[np.bool_]) -> Performance:
    """The performance with the person far below every view in the frames `away`."""
    down = np.where(away, -200.0, 0.0)
    root, joints = p.root.copy(), p.joints.copy()
    root[:, 2] += down
    joints[..., 2] += down[:, None]
    return Performance(p.name, p.times, p.rotations, root, joints)


class _Clock:
    """A progress call that measures the processor's time of tracking: what else runs on the machine does not count."""

    def __init__(self) -> None:
        self._since: dict[str, float] = {}
        self.track = self.starts = 0.0
        """s, from the first frame to the last, and, of these, of starts: of whoever is found later"""

    def __call__(self, stage: str, done: int, total: int) -> None:
        now = time.process_time()
        if done == 0:
            self._since[stage] = now
        took = now - self._since.get(stage, now)
        if stage == "track":
            self.track = took
        elif stage == "subject" and done == total and "track" in self._since:
            self.starts += took


def _alone(scene: Scene, count: int, points: bool) -> tuple[float, float]:
    """mm and s: the same person by the product with nobody else in the masks."""
    frames = list(replace(scene, others=()).mask_frames(1.0, keypoints=points))[:count]
    clock = _Clock()
    try:
        found = track_source(
            FrameList(frames, RATE),
            RATE,
            TrackOptions(evidence="both" if points else "silhouettes"),
            progress=clock,
        )
    except HyposeError:
        return float("nan"), float("nan")
    errors = _errors(found.motion, scene)
    seen = scene.performance.root[: len(errors), 2] > -100
    return float(errors[seen].mean()), clock.track


def _errors(motion: Motion, scene: Scene) -> Array:
    """(T, 15) mm."""
    assert motion.poses is not None
    rotations, _ = motion.skeleton.forward(motion.poses)
    offsets = population_offsets(human()) * scene.subject.stature
    return 1e3 * joint_errors(motion.joints, scene.joints[: len(motion)], offsets, rotations)


def _judged(
    found: Sequence[TrackResult], scenes: Sequence[Scene], present: NDArray[np.bool_], setting: Setting
) -> dict[str, Any]:
    """Who was tracked how well. Everybody tracked is the true person whom they are nearest to in most frames; frames in
    which they are nearer to another one are exchanges of identity."""
    true = np.stack([s.joints[: present.shape[1], :1, :2].mean(1) for s in scenes])  # (P, T, 2)
    mine: dict[int, TrackResult] = {}
    swaps = invented = 0
    for one in found:
        at = one.motion.joints[:, 0, :2]
        away = np.where(present, np.linalg.norm(true - at, axis=-1), np.inf)
        shown = one.there & np.isfinite(away).any(0)
        who = away.argmin(0)[shown]
        owner = int(np.bincount(who, minlength=len(scenes)).argmax()) if len(who) else -1
        near = away.min(0)[shown] < 0.5 if len(who) else np.zeros(0, dtype=bool)
        if owner < 0 or owner in mine or near.mean() < 0.5:
            invented += 1
            continue
        mine[owner] = one
        swaps += int((who != owner).sum())
    errors, frames_far, start_ok, born, flagged = [], 0, [], [], []
    for k, scene in enumerate(scenes):
        comes = [0] + [t for t in range(1, present.shape[1]) if present[k, t] and not present[k, t - 1]]
        if k not in mine:
            errors.append(None)
            start_ok.append(False)
            born += [False] * len(comes)
            continue
        e, one = _errors(mine[k].motion, scene), mine[k]
        seen = present[k] & one.there
        errors.append(e[seen].ravel().tolist())
        frames_far += int((e[seen].mean(1) > FAR_MM).sum()) + int((present[k] & ~one.there).sum() > 0.6 * RATE)
        after = round(1.0 * RATE)
        start_ok.append(bool(e[after - 3 : after + 3].mean() <= GOOD_MM))
        soon = round(SOON_S * RATE)
        born += [bool(one.there[t : t + soon + 1].any()) for t in comes]
        flagged.append(one.assessment.word != "good")
    return {
        "errors": errors,
        "far": frames_far,
        "swaps": swaps,
        "invented": invented,
        "start_ok": start_ok,
        "born": born,
        "flagged": flagged,
        "people": len(scenes),
    }


def people_rows(found: Mapping[tuple[str, str, int], Mapping[str, Any]]) -> list[Row]:
    """Rows of runs by (setting, cameras, seed)."""
    rows: list[Row] = []
    over: dict[str, list[float]] = {}
    for name, views in dict.fromkeys((n, v) for n, v, _ in found):
        runs = [r for (n, v, _), r in found.items() if (n, v) == (name, views)]
        case = f"{name}/{views}"
        means = [float(np.mean(e)) for r in runs for e in r["errors"] if e]
        alone = [float(a) for r in runs for a in r["alone"]]
        every = np.concatenate([np.array(e) for r in runs for e in r["errors"] if e] or [np.zeros(0)])
        rows.append(row("mean_mm", case, means, "mm"))
        rows.append(
            Row("p95_mm", case, float(np.percentile(every, 95)) if len(every) else float("nan"), "mm", n=len(runs))
        )
        rows.append(row("alone_mm", case, [a for a in alone if np.isfinite(a)] or [np.nan], "mm"))
        rows.append(
            Row("flagged", case, float(np.mean([f for r in runs for f in r["flagged"]] or [np.nan])), "1", n=len(runs))
        )
        kind = {"close": f"0.55 m, {views} cameras"}.get(name, name if "touching" in name else f"{views} cameras")
        pairs = [(e, a) for r in runs for e, a in zip(r["errors"], r["alone"], strict=True)]
        over.setdefault(kind, []).extend(float(np.mean(e)) - a for e, a in pairs if e and np.isfinite(a))
    rows += [row("over_alone_mm", kind, values or [np.nan], "mm") for kind, values in over.items()]
    apart = [r for (n, _, _), r in found.items() if SETTINGS[n].near >= 0.7]
    runs = list(found.values())
    rows.append(Row("frames_120", "all", float(sum(r["far"] for r in apart)), "1", n=len(apart)))
    rows.append(Row("identity_swaps", "all", float(sum(r["swaps"] for r in apart)), "1", n=len(apart)))
    rows.append(Row("invented", "all", float(sum(r["invented"] for r in runs)), "1", n=len(runs)))
    born = [b for r in apart for b in r["born"]]
    rows.append(Row("births_found", "all", float(np.mean(born or [np.nan])), "1", n=len(born)))
    rows.append(Row("births_false", "all", float(sum(r["invented"] for r in apart)), "1", n=len(apart)))
    starts = [s for r in apart for s in r["start_ok"]]
    rows.append(Row("start_ok", "both", float(np.mean(starts or [np.nan])), "1", n=len(starts)))
    for count in (2, 3):
        some = [r for r in runs if r["people"] == count and np.isfinite(r["time_alone"]).all()]
        if some:
            rows.append(row("time_ratio", str(count), [r["time"] / sum(r["time_alone"]) for r in some], "1"))
    return rows
