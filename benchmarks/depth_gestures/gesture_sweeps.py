"""What alpha and beta do, and how balanced the trees are (Figs. 3.5, 3.6, 3.9): "pause", as in gesture-table-3.2."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from benchmarks.depth_gestures.gesture_benchmarks import learn_offline, learn_online, shoot
from benchmarks.depth_gestures.gesture_data import FULL, QUICK, SEEDS, examples, for_gesture
from benchmarks.depth_gestures.gesture_scores import Judged, judge
from benchmarks.papers.offline_forests import collect
from hypose.gestures.forest import Forest, ForestSettings
from hypose.synthetic.gesture_poses import GESTURES

ALPHAS, BETAS = (50, 100, 300, 600, 1200), (0.0, 0.02, 0.05, 0.1)
WIDEST = 10
"""Levels: larger differences of height are counted there."""


def sweeps(options: BenchOptions) -> BenchReport:
    """AP of one gesture over alpha (beta 0) and over beta (alpha 300), and the balance of online and offline trees."""
    seeds = options.seed_range(SEEDS)
    parts = []
    for done, seed in enumerate(seeds):
        parts.append(options.part(f"gesture-sweeps.{seed}", partial(_sweep, seed, options)))
        options.progress("seed", done + 1, len(seeds))
    curves = {}
    rows: list[Row] = []
    for case in parts[0]["judged"]:
        judged = [Judged.of(p["judged"][case]) for p in parts]
        rows.append(row("ap", case, [j.ap() for j in judged], "1"))
        curves[case] = [j.curve() for j in judged]
    for name in parts[0]["balance"]:
        rows.append(row("nodes", name, [p["nodes"][name] for p in parts], "1"))
        shares = np.array([p["balance"][name] for p in parts])  # (seeds, differences)
        rows.append(row("balanced_share", name, shares[:, WIDEST], "1"))
        rows.append(row("mean_imbalance", name, shares @ np.abs(np.arange(-WIDEST, WIDEST + 1)), "levels"))
    mean = {n: np.mean([p["balance"][n] for p in parts], axis=0).round(4).tolist() for n in parts[0]["balance"]}
    return BenchReport(tuple(rows), {"seeds": list(seeds), "gesture": "pause", "curves": curves, "balance": mean})


def _sweep(seed: int, options: BenchOptions) -> dict[str, Any]:
    number = GESTURES.index("pause") + 1
    data = shoot(seed, options, QUICK if options.quick else FULL)
    shown, test = examples(data.train, number), for_gesture(data.test, number)
    trees: dict[str, Forest] = {"offline": learn_offline(collect(shown, np.random.default_rng([83, seed])), seed)}
    judged = {}
    for name, settings in _tried().items():
        forest = learn_online(shown, seed, settings=settings)
        judged[name] = judge(forest, test, number).plain()
        if name.startswith("alpha"):
            trees[name] = forest
    return {
        "judged": judged,
        "nodes": {n: int(f.size.sum()) for n, f in trees.items()},
        "balance": {n: _histogram(f) for n, f in trees.items()},
    }


def _tried() -> dict[str, ForestSettings]:
    alphas = {f"alpha_{a:g}": ForestSettings(alpha=a) for a in ALPHAS}
    return alphas | {f"beta_{b:g}": ForestSettings(beta=b) for b in BETAS if b}


def balance(forest: Forest) -> np.ndarray:
    """Height of the left minus the right branch, of every node with children (Fig. 3.9)."""
    out = list[np.ndarray]()
    for left, n in zip(forest.left, forest.size, strict=True):
        height = np.zeros(n, np.int64)
        inner = np.flatnonzero(left[:n] >= 0)
        for i in inner[::-1]:  # children are numbered after their parent
            height[i] = 1 + max(height[left[i]], height[left[i] + 1])
        out.append(height[left[inner]] - height[left[inner] + 1])
    return np.concatenate(out) if out else np.zeros(0, np.int64)


def _histogram(forest: Forest) -> list[float]:
    """Share of the nodes with children for each height of the left minus the right branch, -WIDEST to WIDEST."""
    difference = np.clip(balance(forest), -WIDEST, WIDEST)
    counts = np.bincount(difference + WIDEST, minlength=2 * WIDEST + 1)
    return (counts / max(len(difference), 1)).tolist()
