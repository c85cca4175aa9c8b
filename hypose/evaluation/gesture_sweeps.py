"""What alpha and beta do, and how balanced the trees are (Figs. 3.5, 3.6, 3.9): "pause", as in gesture-table-3.2."""

from __future__ import annotations

from typing import Any

import numpy as np

from hypose.evaluation.benchmarks import BenchOptions, BenchReport, Row
from hypose.evaluation.gesture_benchmarks import curve, learn_offline, learn_online, shoot
from hypose.evaluation.gesture_data import FULL, QUICK, examples, for_gesture, seeds_of
from hypose.evaluation.gesture_metrics import judge
from hypose.evaluation.gesture_poses import GESTURES
from hypose.gestures.forest import Forest, ForestSettings
from hypose.gestures.offline import collect

ALPHAS, BETAS = (50, 100, 300, 600, 1200), (0.0, 0.02, 0.05, 0.1)
WIDEST = 10
"""Levels: larger differences of height are counted there."""


def sweeps(options: BenchOptions) -> BenchReport:
    """AP of one gesture over alpha (beta 0) and over beta (alpha 300), and the balance of online and offline trees."""
    seed, number = seeds_of(options, most=1)[0], GESTURES.index("pause") + 1
    data = shoot(seed, options, QUICK if options.quick else FULL)
    shown, test = examples(data.train, number), for_gesture(data.test, number)
    tried = [("alpha", a, ForestSettings(alpha=a)) for a in ALPHAS]
    tried += [("beta", b, ForestSettings(beta=b)) for b in BETAS if b]
    rows: list[Row] = []
    curves: dict[str, Any] = {}
    trees: dict[str, Forest] = {"offline": learn_offline(collect(shown, np.random.default_rng([83, seed])), seed)}
    for k, (name, value, settings) in enumerate(tried):
        forest = learn_online(shown, seed, settings=settings)
        judged = judge(forest, test, number)
        rows.append(Row("ap", f"{name}_{value:g}", judged.ap(), "1"))
        curves[f"{name}_{value:g}"] = curve(judged)
        if name == "alpha":
            trees[f"alpha_{value:g}"] = forest
        options.progress("learn", k + 1, len(tried))
    for name, forest in trees.items():
        rows.append(Row("nodes", name, float(forest.size.sum()), "1"))
        difference = np.abs(forest.balance())
        if not len(difference):  # nothing but roots
            continue
        rows.append(Row("balanced_share", name, float(np.mean(difference == 0)), "1"))
        rows.append(Row("mean_imbalance", name, float(difference.mean()), "levels"))
    settings_out = {"seed": seed, "gesture": "pause", "curves": curves}
    return BenchReport(tuple(rows), settings_out | {"balance": {n: _histogram(f) for n, f in trees.items()}})


def _histogram(forest: Forest) -> list[float]:
    """Share of the nodes with children for each height of the left minus the right branch, -WIDEST to WIDEST."""
    difference = np.clip(forest.balance(), -WIDEST, WIDEST)
    counts = np.bincount(difference + WIDEST, minlength=2 * WIDEST + 1)
    return np.round(counts / max(len(difference), 1), 4).tolist()
