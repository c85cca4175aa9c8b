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

_RATE = 25.0
_FROM_S, _FOR_S = 1.6, 2.0


@dataclass(frozen=True)
class Spoilt:
    """frames to track; truth (T, 19, 3) m of each; first and stop of the fault;"""

    frames: list[Frame]
    truth: Array
    first: int
    stop: int


def _span() -> tuple[int, int]:
    return round(_FROM_S * _RATE), round((_FROM_S + _FOR_S) * _RATE)


def _changed(scene: Scene, change: Callable[[Frame], Frame]) -> Spoilt:
    """Every frame of the fault's time changed."""
    first, stop = _span()
    frames = list(scene.mask_frames())
    spoilt = [change(f) if first <= t < stop else f for t, f in enumerate(frames)]
    return Spoilt(spoilt, scene.joints, first, stop)


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


def no_fault(scene: Scene) -> Spoilt:
    """Nothing is wrong: what is flagged here is a false alarm."""
    return _changed(scene, lambda f: f)


FAULTS: dict[str, Callable[[Scene], Spoilt]] = {
    "none": no_fault,
    "camera-stops": camera_stops,
    "empty-masks": empty_masks,
    "full-masks": full_masks,
    "frames-dropped": frames_dropped,
    "clock-jump": clock_jump,
    "person-leaves": person_leaves,
    "two-people": two_people,
}


def aftermath(scene: Scene, spoilt: Spoilt, subject: TrackedSubject, seed: int) -> dict[str, float]:
    """Track the spoilt frames with a subject that is known, and measure.

    Returns: by metric: error_before_mm, error_during_mm, error_after_mm (last second): median joint errors;
    recovered_s from the fault's end until the error (median over 0.4 s) stays within 1.5 times that of before + 20 mm
    (inf: never); flagged_share: of the fault's frames; wrong: share of the frames from the fault's begin on beyond that
    limit; unflagged_wrong: of these, without a flag (lost, extrapolated, fewer views, low confidence); finite: 1 when
    no pose has a NaN or an infinity."""
    frames = FrameList([replace(f, index=i, time=i / _RATE) for i, f in enumerate(spoilt.frames)])
    motion = track_source(frames, _RATE, TrackOptions(seed=seed), subject=subject).motion
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
    return {
        "error_before_mm": before,
        "error_during_mm": float(np.median(error[inside])),
        "error_after_mm": float(np.median(error[-round(_RATE) :])),
        "recovered_s": float(recovered),
        "flagged_share": float(flags[inside].mean()),
        "wrong": float(wrong.mean()),
        "unflagged_wrong": float((wrong & ~flags[spoilt.first :]).mean()),
        "finite": float(motion.poses is not None and np.isfinite(motion.poses).all()),
    }


def _errors(scene: Scene, motion: Motion, truth: Array) -> Array:
    """(T,) m mean over joints."""
    assert motion.poses is not None
    rotations, _ = motion.skeleton.forward(motion.poses)
    offsets = population_offsets(human()) * scene.subject.stature
    return joint_errors(motion.joints, truth, offsets, rotations).mean(1)


def faults(options: BenchOptions) -> BenchReport:
    """Per fault the metrics of `aftermath`, medians over the seeds. The fault "none" tells how much is flagged, and
    wrong, when nothing happens.

    Scenes: walk, rig humaneva-4 at half size, 6 s, masks with level-1 corruption; the subject's height is given, the
    body is fitted to the scene without the fault. The fault begins at 1.6 s and lasts 2 s (a stopped camera: to the
    end)."""
    seeds = options.seed_range(3)
    names = ("empty-masks", "clock-jump") if options.quick else tuple(FAULTS)
    found: dict[str, list[dict[str, float]]] = {}
    for k, seed in enumerate(seeds):
        cameras = camera_rig("humaneva-4").scaled(0.5)
        scene = noisy_scene("walk", "", cameras, seconds=6.0, seed=seed)
        frames = FrameList(list(scene.mask_frames()))
        wanted = SubjectOptions("hull", height=scene.subject.stature, frame_rate=_RATE)
        subject = find_subject(frames.frame, len(frames), wanted)
        for n, name in enumerate(names):
            options.progress("faults", k * len(names) + n, len(names) * len(seeds))
            found.setdefault(name, []).append(aftermath(scene, FAULTS[name](scene), subject, seed))
    rows = [
        Row(metric, name, float(np.median([run[metric] for run in runs])), _unit(metric), n=len(runs))
        for name, runs in found.items()
        for metric in runs[0]
    ]
    return BenchReport(
        tuple(rows), {"seeds": len(seeds), "first_seed": seeds.start, "scenes": "walk, humaneva-4 at 0.5"}
    )


def _unit(metric: str) -> str:
    return metric.rpartition("_")[2] if metric.endswith(("_mm", "_s")) else "1"
