"""Semi-synthetic: real depth crops of hand signs pasted into simulated rooms, split by time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from benchmarks.depth_gestures.gesture_data import SEEDS, TESTED, TRAINED, teach
from benchmarks.depth_gestures.gesture_pictures import CLUTTERED, GestureFrame, picture
from benchmarks.depth_gestures.gesture_scores import Judged, judge
from hypose.compute.forests import DepthImage
from hypose.errors import InputError
from hypose.gestures.depth_pictures import KINECT
from hypose.gestures.forest import ForestSettings
from hypose.gestures.online import Example, Learner, LearnSettings
from hypose.io.sensors.depth import read_depth_png

LETTERS = "abcdefghiklmnopqrstuvwxy"
TRAINED_SHARE = 0.7
"""Of each letter's pictures, in the order of time, are learned; the rest is tested."""
_BACKGROUNDS = 24
PASSES = 3
_REACH_MM = 90
"""The crops end about there."""


def load_letters(folder: Path) -> dict[str, list[DepthImage]]:
    """The crops (h, w) uint16 mm of every letter in the order of time."""
    out = {}
    for letter in LETTERS:
        files = sorted((folder / letter).glob("*.png"))
        out[letter] = [np.rint(read_depth_png(f) * 1000).astype(np.uint16) for f in files]
    if not any(out.values()):
        raise InputError(f"{folder} holds no depth crops; it must have a folder of 16-bit PNG per letter.")
    return out


def hand_point(crop: DepthImage) -> tuple[float, float, float] | None:
    """(x, y) px and depth mm of the middle of the near surface (within 12 cm of the nearest); None without one."""
    measured = crop[crop > 0]
    if len(measured) < 200:
        return None
    nearest = float(np.percentile(measured, 3))
    rows, columns = np.nonzero((crop > 0) & (crop < nearest + 120))
    if len(rows) < 100:
        return None
    k = int(np.argmin((columns - np.median(columns)) ** 2 + (rows - np.median(rows)) ** 2))
    return float(columns[k]), float(rows[k]), float(crop[rows[k], columns[k]])


def paste(crop: DepthImage, background: DepthImage, rng: np.random.Generator) -> tuple[DepthImage, int, int]:
    """The crop somewhere in a room whose contents nearer than 1.3 m are removed."""
    out = background.copy()
    out[out < 1300] = 0
    h, w = crop.shape
    x, y = int(rng.integers(60, out.shape[1] - w - 60)), int(rng.integers(60, out.shape[0] - h - 60))
    out[y : y + h, x : x + w] = crop
    return out, x, y


def _frames(
    crops: Mapping[str, list[DepthImage]], rooms: list[DepthImage], rng: np.random.Generator
) -> list[GestureFrame]:
    out = []
    for k, (letter, several) in enumerate(crops.items()):
        for crop in several:
            at = hand_point(crop)
            if at is None:
                continue
            depth, x, y = paste(crop, rooms[rng.integers(len(rooms))], rng)
            position = KINECT.point(x + at[0], y + at[1], at[2] / 1000)
            out.append(GestureFrame(depth, k + 1, x + at[0], y + at[1], position, -1, letter))
    return out


def semi_synthetic(options: BenchOptions) -> BenchReport:
    """AP of every letter against all others: real hands, one person, simulated rooms around them."""
    crops = load_letters(options.folder("asl_depth_crops"))
    chosen = "afl" if options.quick else LETTERS
    seeds = options.seed_range(SEEDS)
    values: dict[str, list[Judged]] = {}
    for repetition, seed in enumerate(seeds):
        rooms = cache(partial(_rooms, seed))
        for done, letter in enumerate(chosen):
            measure = partial(_learn_letter, crops, rooms, letter, seed)
            part = options.part(f"gesture-semi-synthetic.{seed}.{letter}", measure)
            values.setdefault(letter, []).append(Judged.of(part))
            options.progress("learn", repetition * len(chosen) + done + 1, len(seeds) * len(chosen))
    rows: list[Row] = []
    for case, take in (("", Judged.ap), ("/5cm", Judged.ap_metres)):
        every = np.array([[take(j) for j in values[c]] for c in chosen])
        rows.append(row("mean_ap", f"letters{case}", every.mean(0), "1"))
        rows += [row("ap", f"{c}{case}", every[k], "1") for k, c in enumerate(chosen)]
    settings = {"data": "semi-synthetic: real crops of one person in simulated rooms", "seeds": list(seeds)}
    share = 1 / len([c for c in LETTERS if crops[c]])
    return BenchReport(tuple(rows), settings | {"split_by_time": TRAINED_SHARE, "share_of_positives": share})


def _rooms(seed: int) -> tuple[list[DepthImage], list[DepthImage]]:
    """Pictures of rooms to paste into, to learn and to test."""
    rng = np.random.default_rng([85, seed])
    both = [
        [picture(p, "movement", CLUTTERED, rng).depth for p in (people * 7)[:_BACKGROUNDS]]
        for people in (TRAINED, TESTED)
    ]
    return both[0], both[1]


def _learn_letter(
    crops: Mapping[str, list[DepthImage]],
    rooms: Callable[[], tuple[list[DepthImage], list[DepthImage]]],
    letter: str,
    seed: int,
) -> dict[str, Any]:
    to_learn, to_test = rooms()
    split = {c: round(TRAINED_SHARE * len(v)) for c, v in crops.items()}
    number = LETTERS.index(letter) + 1
    rng = np.random.default_rng([85, seed, number])
    test = _frames({c: v[split[c] :] for c, v in crops.items()}, to_test, np.random.default_rng([85, seed, 0]))
    learner = Learner.new(rng, ForestSettings(reach_mm=_REACH_MM), LearnSettings())
    for _ in range(PASSES):
        shown = {c: list(v[: split[c]]) for c, v in crops.items()}
        for c in LETTERS:
            few = rng.permutation(len(shown[c]))[:9] if c != letter else np.tile(np.arange(len(shown[c])), 3)
            shown[c] = [shown[c][i] for i in few]
        frames = _frames(shown, to_learn, rng)
        every = [Example(f.depth, KINECT, int(f.gesture == number), f.x, f.y) for f in frames]
        teach(learner, every, shuffle=True)
    return judge(learner.forest.freeze(), test, number).plain()
