"""Faults while a person is tracked: what was computed before survives, the result says what happened, and tracking
comes back. The evidence is spoilt for a while; the truth is known throughout."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import medfilt

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.synthetic.noisy_masks import noisy_scene
from hypose.body.default_body import human
from hypose.body.motion import Motion
from hypose.evidence.frame import Frame
from hypose.geometry import Array
from hypose.pipeline.first_frame import SubjectOptions, TrackedSubject, find_subject
from hypose.pipeline.run import track_source
from hypose.pipeline.track_loop import FrameList
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.metrics import joint_errors, population_offsets
from hypose.synthetic.performance import moved
from hypose.synthetic.scenes import Scene, camera_rig, make_scene
from hypose.synthetic.subjects import load_subjects
from hypose.tracking.subject import scaled_to_height

_RATE = 25.0
_FROM_S, _FOR_S = 1.6, 2.0


@dataclass(frozen=True)
class Spoilt:
    """frames to track; truth (T, 19, 3) m of each; first and stop of the fault; evidence: what is tracked."""

    frames: list[Frame]
    truth: Array
    first: int
    stop: int
    evidence: str = "silhouettes"


def _span() -> tuple[int, int]:
    return round(_FROM_S * _RATE), round((_FROM_S + _FOR_S) * _RATE)


def _changed(scene: Scene, change: Callable[[Frame], Frame], evidence: str = "silhouettes") -> Spoilt:
    """Every frame of the fault's time changed."""
    first, stop = _span()
    frames = list(scene.mask_frames(keypoints=evidence != "silhouettes"))
    spoilt = [change(f) if first <= t < stop else f for t, f in enumerate(frames)]
    return Spoilt(spoilt, scene.joints, first, stop, evidence=evidence)


def _without(frame: Frame, views: Sequence[int], reason: str) -> Frame:
    """The frame with the views' masks empty and marked so."""
    s = frame.silhouettes
    assert s is not None
    masks, usable = s.masks.copy(), s.usable.copy()
    masks[list(views)], usable[list(views)] = 0, False
    reasons = tuple(reason if c in views else r for c, r in enumerate(s.reasons))
    return replace(frame, silhouettes=replace(s, masks=masks, usable=usable, reasons=reasons))


def camera_stops(scene: Scene) -> Spoilt:
    """One of four cameras delivers nothing from some moment on."""
    made = _changed(scene, lambda f: f)
    frames = [_without(f, [1], "no frame") if t >= made.first else f for t, f in enumerate(made.frames)]
    return replace(made, frames=frames, stop=len(frames))


def empty_masks(scene: Scene) -> Spoilt:
    """Nothing in any mask for two seconds; the person goes on moving."""
    return _changed(scene, lambda f: _without(f, range(4), "empty mask"))


def full_masks(scene: Scene) -> Spoilt:
    """The light changes: everything is foreground, and nobody has marked it."""

    def flood(frame: Frame) -> Frame:
        s = frame.silhouettes
        assert s is not None
        return replace(frame, silhouettes=replace(s, masks=np.ones_like(s.masks)))

    return _changed(scene, flood)


def frames_doubled(scene: Scene) -> Spoilt:
    """For two seconds every image comes twice in all cameras, then the present returns at once."""
    made = _changed(scene, lambda f: f)
    index = [t if not made.first <= t < made.stop else made.first + (t - made.first) // 2 for t in range(len(scene))]
    return replace(made, frames=[made.frames[t] for t in index], truth=made.truth[index])


def frames_dropped(scene: Scene) -> Spoilt:
    """One camera repeats old images: it lags by up to four frames for two seconds."""
    made = _changed(scene, lambda f: f)
    out = list(made.frames)
    for t in range(made.first, made.stop):
        now, old = out[t].silhouettes, made.frames[made.first + (t - made.first) // 5 * 5].silhouettes
        assert now is not None and old is not None
        masks = now.masks.copy()
        masks[2] = old.masks[2]
        out[t] = replace(out[t], silhouettes=replace(now, masks=masks))
    return replace(made, frames=out)


def clock_jump(scene: Scene) -> Spoilt:
    """Ten frames are missing in all cameras at once: the person is 0.4 s further on."""
    frames = list(scene.mask_frames())
    first, _ = _span()
    keep = [t for t in range(len(frames)) if not first <= t < first + 10]
    return Spoilt([frames[t] for t in keep], scene.joints[keep], first, first + 1)


def person_leaves(scene: Scene) -> Spoilt:
    """The person leaves and comes back two seconds later, a metre away and turned by a quarter."""
    elsewhere = replace(scene, performance=moved(scene.performance, np.pi / 2, (0.9, 0.5)))
    first, stop = _span()
    here, there = list(scene.mask_frames()), list(elsewhere.mask_frames())
    gone = [_without(f, range(4), "empty mask") for f in here[first:stop]]
    truth = np.concatenate([scene.joints[:stop], elsewhere.joints[stop:]])
    return Spoilt([*here[:first], *gone, *there[stop:]], truth, first, stop)


def two_people(scene: Scene) -> Spoilt:
    """A second person walks nearby for two seconds and is in the masks, which has to be said."""
    known = load_subjects()
    other = known[sorted(known)[3]]
    walking = moved(
        make_scene("walk", other, scene.rig, seconds=len(scene) / _RATE, seed=77).performance, 2.0, (1.3, 1.0)
    )
    crowd = list(replace(scene, others=((other, walking),)).mask_frames())
    first, stop = _span()
    frames = list(scene.mask_frames())
    return Spoilt([*frames[:first], *crowd[first:stop], *frames[stop:]], scene.joints, first, stop)


def nan_keypoints(scene: Scene) -> Spoilt:
    """Key points that are NaN, with full confidence, beside good masks."""

    def poison(frame: Frame) -> Frame:
        assert frame.keypoints is not None
        points = frame.keypoints.points.copy()
        points[:, ::2, :2] = np.nan
        return replace(frame, keypoints=replace(frame.keypoints, points=points))

    return _changed(scene, poison, "both")


def no_fault(scene: Scene) -> Spoilt:
    """Nothing is wrong: what is flagged here is a false alarm."""
    return _changed(scene, lambda f: f)


FAULTS: dict[str, Callable[[Scene], Spoilt]] = {
    "none": no_fault,
    "camera-stops": camera_stops,
    "empty-masks": empty_masks,
    "full-masks": full_masks,
    "frames-doubled": frames_doubled,
    "frames-dropped": frames_dropped,
    "clock-jump": clock_jump,
    "person-leaves": person_leaves,
    "two-people": two_people,
    "nan-keypoints": nan_keypoints,
}
WITH_TEMPLATE = ("none", "camera-stops", "empty-masks", "frames-dropped", "two-people")
"""The faults that are tracked with a body that was not fitted as well."""


@dataclass(frozen=True)
class Aftermath:
    """before_mm, during_mm, after_mm: median joint errors before, in and in the last second after the fault;
    recovered_s from its end until the error (median over 0.4 s) stays within 1.5 times that of before + 20 mm (inf:
    never); flagged: share of the fault's frames that the result flags; wrong: share of the frames from the fault's
    begin to the end of the clip that are beyond that limit; unflagged_wrong: of those, what is not flagged (lost,
    extrapolated, fewer views, doubtful); finite: no NaN or infinity in any pose."""

    before_mm: float
    during_mm: float
    after_mm: float
    recovered_s: float
    flagged: float
    wrong: float
    unflagged_wrong: float
    finite: bool


def subject_of(scene: Scene, *, fitted: bool = True) -> TrackedSubject:
    """The subject's body as `hypose track` fits it, from the scene without its fault; or the template at the subject's
    height."""
    frames = FrameList(list(scene.mask_frames()))
    tall = scene.subject.stature
    wanted = SubjectOptions("hull", height=tall, frame_rate=_RATE)
    if not fitted:
        wanted = replace(wanted, body=scaled_to_height(human(), tall), known=True)
    return find_subject(frames.frame, len(frames), wanted)


def aftermath(scene: Scene, spoilt: Spoilt, subject: TrackedSubject, seed: int) -> Aftermath:
    """Track the spoilt frames with a subject that is known, and measure."""
    options = TrackOptions(evidence=spoilt.evidence, seed=seed)
    motion = track_source(
        FrameList([replace(f, index=i, time=i / _RATE) for i, f in enumerate(spoilt.frames)]),
        _RATE,
        options,
        subject=subject,
    ).motion
    error = _errors(scene, motion, spoilt.truth) * 1000
    before = float(np.median(error[5 : spoilt.first]))
    limit = 1.5 * before + 20
    after = error[spoilt.stop :]
    late = np.flatnonzero(medfilt(after, 11) > limit) if len(after) else np.zeros(0)
    recovered = (late[-1] + 1 if len(late) else 0) / _RATE
    if len(late) and late[-1] >= len(after) - 6:  # the median's half width
        recovered = float("inf")
    inside = slice(spoilt.first, spoilt.stop)
    full = int(motion.n_views[: spoilt.first].max(initial=0))
    flags = motion.lost | motion.extrapolated | (motion.n_views < full)
    if motion.low_confidence is not None:
        flags |= motion.low_confidence
    wrong = error[spoilt.first :] > limit
    tail = error[-round(_RATE) :]
    return Aftermath(
        before,
        float(np.median(error[inside])),
        float(np.median(tail)),
        float(recovered),
        float(flags[inside].mean()),
        float(wrong.mean()),
        float((wrong & ~flags[spoilt.first :]).mean()),
        bool(motion.poses is not None and np.isfinite(motion.poses).all() and np.isfinite(motion.joints).all()),
    )


def _errors(scene: Scene, motion: Motion, truth: Array) -> Array:
    """(T,) m mean over joints."""
    assert motion.poses is not None
    rotations, _ = motion.skeleton.forward(motion.poses)
    offsets = population_offsets(human()) * scene.subject.stature
    return joint_errors(motion.joints, truth, offsets, rotations).mean(1)


def faults(options: BenchOptions) -> BenchReport:
    """Per fault: error before, during and after (mm), recovered_s, flagged_share, wrong, unflagged_wrong, finite;
    medians over the seeds. The fault "none" tells how much is flagged, and wrong, when nothing happens.

    Scenes: walk, rig humaneva-4 at half size, 6 s, masks with level-1 corruption; the subject's height is given, the
    body is fitted to the scene without the fault; with "template" in the case it is the template at that height. The
    fault begins at 1.6 s and lasts 2 s (a stopped camera: to the end)."""
    seeds = options.seed_range(3)
    names = ("empty-masks", "clock-jump") if options.quick else tuple(FAULTS)
    cases = [(n, True) for n in names] + [(n, False) for n in WITH_TEMPLATE if n in names]
    found: dict[str, list[Aftermath]] = {}
    for k, seed in enumerate(seeds):
        cameras = camera_rig("humaneva-4").scaled(0.5)
        scene = noisy_scene("walk", "", cameras, seconds=6.0, seed=seed)
        subjects = {fitted: subject_of(scene, fitted=fitted) for fitted in (True, False)}
        for n, (name, fitted) in enumerate(cases):
            options.progress("faults", k * len(cases) + n, len(cases) * len(seeds))
            case = name if fitted else f"{name}, template"
            found.setdefault(case, []).append(aftermath(scene, FAULTS[name](scene), subjects[fitted], seed))
    options.progress("faults", len(cases) * len(seeds), len(cases) * len(seeds))
    settings = {"seeds": len(seeds), "first_seed": seeds.start, "scenes": "walk, humaneva-4 at 0.5"}
    return BenchReport(tuple(_rows(found)), settings)


def _rows(found: dict[str, list[Aftermath]]) -> list[Row]:
    columns = (
        ("error_before_mm", "mm", lambda a: a.before_mm),
        ("error_during_mm", "mm", lambda a: a.during_mm),
        ("error_after_mm", "mm", lambda a: a.after_mm),
        ("recovered_s", "s", lambda a: a.recovered_s),
        ("flagged_share", "1", lambda a: a.flagged),
        ("wrong", "1", lambda a: a.wrong),
        ("unflagged_wrong", "1", lambda a: a.unflagged_wrong),
        ("finite", "1", lambda a: float(a.finite)),
    )
    return [
        Row(metric, name, float(np.median([read(a) for a in runs])), unit, n=len(runs))
        for name, runs in found.items()
        for metric, unit, read in columns
    ]
