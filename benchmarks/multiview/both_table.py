"""Both kinds of evidence against the better one alone, with key points and calibrations spoilt in twelve ways."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np

from benchmarks.bench_report import BenchOptions, Row
from benchmarks.multiview.doubt_scenes import CASES, EVIDENCE, scene_of, spoilt_frames, tracked
from benchmarks.synthetic.spoilt_keypoints import SPOILS
from hypose.synthetic.metrics import EVALUATED

DEGRADATIONS = (*SPOILS, "moved_camera")
"""Eleven ways to spoil key points; the last one spoils the calibration, of the masks as well."""
SCENES = ("walk", "box", "serve", "cross-arms")


def both_table(options: BenchOptions, seeds: Sequence[int]) -> list[Row]:
    """Median over the scenes (each of SCENES for each of the seeds) of the error of both over the least of one alone:
    of the median error of a scene's joints and frames, and of the largest. plain: nothing is spoilt."""
    names = SCENES[:1] if options.quick else SCENES
    kinds = ("plain", *DEGRADATIONS[3:4]) if options.quick else ("plain", *DEGRADATIONS)
    found: dict[str, list[tuple[float, float]]] = {}
    for k, (name, seed) in enumerate((n, s) for s in seeds for n in names):
        options.progress("both", k, len(names) * len(seeds))
        for kind, ratio in options.part(f"both-{name}-{seed}", lambda n=name, s=seed: _ratios(n, s, kinds)).items():
            found.setdefault(kind, []).append((float(ratio[0]), float(ratio[1])))
    rows = []
    for kind, ratios in found.items():
        middle = np.median(np.array(ratios), 0)
        rows += [
            Row("both_ratio_median", kind, float(middle[0]), "1", n=len(ratios)),
            Row("both_ratio_max", kind, float(middle[1]), "1", n=len(ratios)),
        ]
    worst = np.array([np.median(np.array(r), 0) for kind, r in found.items() if kind != "plain"]).max(0)
    return rows + [
        Row(f"both_ratio_{n}", "worst", float(x), "1") for n, x in zip(("median", "max"), worst, strict=True)
    ]


def _ratios(name: str, seed: int, kinds: Sequence[str]) -> dict[str, list[float]]:
    """{degradation: [of the median error, of the largest]} of a scene."""
    scene, plain = scene_of(CASES[name], seed)
    alone: dict[str, tuple[float, float]] = {}

    def error(kind: str, evidence: str) -> tuple[float, float]:
        rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
        found = tracked(name, scene, spoilt_frames(plain, kind, rng), seed, evidence, kind).error[:, EVALUATED]
        return float(np.median(found)), float(found.max())

    out = {}
    for kind in kinds:
        masks = kind if kind == "moved_camera" else "plain"  # what else is spoilt is none of the masks'
        if masks not in alone:
            alone[masks] = error(masks, EVIDENCE[0])
        parts = np.minimum(alone[masks], error(kind, EVIDENCE[1]))
        out[kind] = (np.array(error(kind, EVIDENCE[2])) / parts).tolist()
    return out
