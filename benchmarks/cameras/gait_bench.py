"""The benchmark `gait`: foot strikes, steps and their intervals of a captured walk, against the captured feet."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.cameras.captured_motion import (
    Captured,
    as_frames,
    as_read,
    balancing_rig,
    detected,
    retargeted,
    without_one,
)
from hypose.errors import HyposeError
from hypose.evidence.keypoints import BODY_25
from hypose.geometry import Array
from hypose.pipeline.gait import Gait, GaitEvent, facing_of, gait_of, turns
from hypose.pipeline.sources import FrameList
from hypose.pipeline.track import track_source
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.metrics import JOINT_NAMES

RATE, SECONDS = 60.0, 2.8
_MATCHED = 0.2  # s
_SURE = 1.645


def gait(options: BenchOptions) -> BenchReport:
    """foot_strike_frames, foot_off_frames: median distance in frames (60/s) from the same event of the captured feet;
    step_length_mm: median error; coverage_90: share in the stated 90 % intervals; missed, invented: shares of events.

    CMU's walk (02_01) overground on the body of a seed, 2.8 s, three of the balancing clip's cameras, key points alone
    that err like a detector's."""
    seeds = options.seed_range(10, quick=2)
    rig, walks = balancing_rig(options), list[dict[str, Any]]()
    for k, seed in enumerate(seeds):
        options.progress(f"walk seed {seed}", k, len(seeds))
        walks.append(options.part(f"gait-{seed}", lambda s=seed: _walk(options, rig, s)))
    return BenchReport(
        tuple(_rows(walks)), {"seeds": len(seeds), "first_seed": seeds.start, "seconds": SECONDS, "rate": RATE}
    )


def _rows(walks: list[dict[str, Any]]) -> list[Row]:
    rows, inside = list[Row](), list[NDArray[np.bool_]]()

    def errors(kind: str) -> Array:
        """Errors over all walks; whether each lies within its interval is kept in `inside`."""
        error, sd = np.array([pair for walk in walks for pair in walk[kind]]).reshape(-1, 2).T
        inside.append(np.abs(error) <= _SURE * sd)
        return error

    for kind in ("strike", "off"):
        error = errors(kind)
        rows.append(Row(f"foot_{kind}_frames", "all", float(np.median(np.abs(error)) * RATE), "frames", n=len(error)))
        rows.append(Row(f"foot_{kind}_bias_frames", "all", float(np.median(error) * RATE), "frames", n=len(error)))
        rows.append(Row("coverage_90", kind, float(inside[-1].mean()), "1", n=len(error)))
    error = errors("lengths")
    there, missed, invented = (sum(walk[k] for walk in walks) for k in ("there", "missed", "invented"))
    return [
        *rows,
        Row("step_length_mm", "all", float(1e3 * np.median(np.abs(error))), "mm", n=len(error)),
        Row("step_length_bias_mm", "all", float(1e3 * np.median(error)), "mm", n=len(error)),
        Row("coverage_90", "step length", float(inside[-1].mean()), "1", n=len(error)),
        Row("coverage_90", "all", float(np.concatenate(inside).mean()), "1", n=sum(map(len, inside))),
        Row("missed", "all", missed / max(1, there), "1", n=there),
        Row("invented", "all", invented / max(1, there), "1", n=there),
    ]


def _walk(options: BenchOptions, rig: Any, seed: int) -> dict[str, Any]:
    walk = retargeted(options, "02_01", seed, rate=RATE, start=0.0, seconds=SECONDS, keep_trend=1.0)
    three = without_one(rig, seed)
    points = detected(walk, three, [seed, 9])
    truth = _truth(walk)
    try:
        frames = as_read(walk, as_frames(walk, three, points))
        result = track_source(FrameList(frames, RATE), RATE, TrackOptions(evidence="keypoints", seed=seed))
        shown = gait_of(result.motion, result.body)
    except HyposeError as error:
        print(f"walk {seed}: {error}", flush=True)
        shown = Gait((), (), ())
    out: dict[str, Any] = {"strike": [], "off": [], "lengths": [], "missed": 0, "there": len(truth)}
    taken = set[int]()
    for t in truth:
        near = [
            (abs(e.time - t.time), k)
            for k, e in enumerate(shown.events)
            if (e.side, e.kind) == (t.side, t.kind) and k not in taken and abs(e.time - t.time) < _MATCHED
        ]
        if not near:
            out["missed"] += 1
            continue
        k = min(near)[1]
        taken.add(k)
        out[t.kind].append((shown.events[k].time - t.time, shown.events[k].sd))
    out["invented"] = len(shown.events) - len(taken)
    lengths = _lengths(walk, truth)
    for step in shown.steps:
        near = [(abs(step.time - at), length) for side, at, length in lengths if side == step.side]
        if near and min(near)[0] < _MATCHED:
            out["lengths"].append((step.length - min(near)[1], step.length_sd))
    return out


def _feet(walk: Captured) -> tuple[dict[str, tuple[Array, Array]], Array, Array]:
    """{side: (heel (T, 3), toes (T, 3))}, pelvis (T, 3) and the direction faced (T, 3) of the captured person."""
    assert walk.performance is not None
    at = {n: walk.places[:, k] for k, n in enumerate(BODY_25)}
    feet = {}
    for side in ("left", "right"):
        heel, toes = at[f"{side}_heel"], (at[f"{side}_big_toe"] + at[f"{side}_small_toe"]) / 2
        feet[side] = (heel, toes)
    pelvis = JOINT_NAMES.index("pelvis")
    p = walk.performance
    return feet, p.joints[:, pelvis], facing_of(p.rotations[:, pelvis], RATE)


def _truth(walk: Captured) -> list[GaitEvent]:
    """The events of the captured feet by the same definition, without error."""
    feet, pelvis, facing = _feet(walk)
    times = np.arange(len(pelvis)) / RATE
    known, sure = np.ones(len(times), dtype=np.bool_), np.zeros(len(times))
    out = []
    for side, points in feet.items():
        for kind, point, sign in (("strike", points[0], 1.0), ("off", points[1], -1.0)):
            series = sign * np.einsum("ta,ta->t", point - pelvis, facing)
            out += [GaitEvent(t, 0.0, side, kind, point[k]) for t, _, k in turns(series, times, sure, RATE, known)]
    return sorted(out, key=lambda e: e.time)


def _lengths(walk: Captured, truth: list[GaitEvent]) -> list[tuple[str, float, float]]:
    """(side, time, step length m) of the captured steps, between the heels along the direction faced."""
    feet, _, facing = _feet(walk)
    strikes = [e for e in truth if e.kind == "strike"]
    out = []
    for before, now in zip(strikes, strikes[1:], strict=False):
        if before.side != now.side:
            k = min(len(facing) - 1, round(now.time * RATE))
            out.append((now.side, now.time, float((feet[now.side][0][k] - feet[before.side][0][k]) @ facing[k])))
    return out
