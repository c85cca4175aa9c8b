"""Compare errors, verdicts and speed of the golden clips with the figures kept in golden.json.

`./run bench golden` ends with 1 when a figure is worse than the kept one by more than its tolerance; `--keep` keeps the
figures of this run instead; `--other` takes the clips of other seeds, on which nothing is tuned; `--quick` a few clips,
whose times are shown and not compared, since the machine that checks a change may be busy.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench_origin import yardstick
from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.golden_clips import CLIPS, VERDICTS, Clip, Outcome
from benchmarks.multiview.error_fit import ece
from benchmarks.multiview.error_scenes import DATA
from hypose.compute.warming import warm_up
from hypose.errors import HyposeError
from hypose.io.files import write_text
from hypose.io.motions.results import to_json
from hypose.tracking.error_model import WRONG_M

KEPT = Path(__file__).with_name("golden.json")
SEEDS = {"golden": 1400, "other": 1500}
"""Seed of each set of clips."""
ATTEMPTS = 3
"""Times that a clip is tracked at most while it seems too slow: machines are shared."""
Figures = Mapping[str, Mapping[str, float]]
"""Value by case and metric."""
Tolerances = Mapping[str, Mapping[str, float]]


def golden(options: BenchOptions) -> BenchReport:
    """Measure the golden clips: rows per case of error, wrong joints, doubt, verdict and processor time.

    mean_error_mm, p95_mm: of joints from the truth (or the reference); wrong_100, wrong_150: share of joints beyond 100
    and 150 mm; doubtful: share of frames; ece: of P(wrong); verdict: 0 good, 1 look, 2 not to be trusted; time_ratio:
    processor time of a frame over that of the yardstick around it. Without --data: the recordings next to the
    checkout."""
    data, which = options.data or DATA, "other" if options.other else "golden"
    compared = _compared(options.quick)
    chosen = {name: clip for name, clip in CLIPS.items() if clip.quick or not options.quick}
    found: dict[str, Mapping[str, float]] = {}
    failed: dict[str, str] = {}
    skipped = [n for n, clip in chosen.items() if clip.recording and not (data / clip.recording).exists()]
    warm_up()
    for n, name in enumerate(name for name in chosen if name not in skipped):
        options.progress(name, n, len(chosen))
        try:
            found |= _measured(name, chosen[name], SEEDS[which], data, document()[which], compared)
        except HyposeError as error:
            failed[name] = str(error)
    options.progress("done", len(chosen), len(chosen))
    rows = [Row(m, case, v, "mm" if m.endswith("mm") else "1") for case, of in found.items() for m, v in of.items()]
    settings = {"seed": SEEDS[which], "clips": which, "quick": options.quick, "skipped": skipped, "failed": failed}
    return BenchReport(tuple(rows), settings)


def _compared(quick: bool) -> Tolerances:
    """The tolerances of the metrics that are compared."""
    return {m: t for m, t in document()["tolerances"].items() if not (quick and m == "time_ratio")}


def _measured(name: str, clip: Clip, seed: int, data: Path, kept: Figures, compared: Tolerances) -> Figures:
    """Figures by case; while a case is too slow the clip is tracked again, and the fastest time counts."""
    found: dict[str, Mapping[str, float]] = {}
    for _ in range(ATTEMPTS):
        before = yardstick()
        outcomes = {f"{name}/{part}" if part else name: o for part, o in clip.measure(seed, data)}
        unit = 1e-6 * (before + yardstick()) / 2
        for case, outcome in outcomes.items():
            ratio = min(outcome.seconds / unit, found.get(case, {}).get("time_ratio", np.inf))
            found[case] = {**figures(outcome), "time_ratio": ratio}
        if not any(": time_ratio" in line for line in beyond(kept, found, compared)):
            break
    return found


def figures(outcome: Outcome) -> dict[str, float]:
    """Reduce an outcome to its figures, time left out."""
    known = np.isfinite(outcome.error)
    error, p = outcome.error[known], outcome.p[known]
    return {
        "mean_error_mm": 1e3 * float(error.mean()),
        "p95_mm": 1e3 * float(np.percentile(error, 95)),
        "wrong_100": float((error > 0.1).mean()),
        "wrong_150": float((error > 0.15).mean()),
        "doubtful": float(outcome.low_confidence.mean()),
        "ece": ece(p, error > WRONG_M),
        "verdict": float(outcome.assessment),
    }


def document() -> dict[str, Any]:
    """Read golden.json: tolerances by metric, and for each set of clips the kept figures by case and metric."""
    return json.loads(KEPT.read_text(encoding="utf-8"))


def beyond(kept: Figures, found: Figures, tolerances: Tolerances) -> Iterator[str]:
    """Yield one line for each figure that is worse than the kept one by more than its tolerance, or was never kept.

    tolerances: by metric, {"more": added to the kept value}, {"times": a factor of it}, {} = must be equal."""
    for case, values in found.items():
        for metric, allowed in tolerances.items():
            old, new = kept.get(case, {}).get(metric), values[metric]
            if old is None:
                yield f"{case}: {metric} {_said(metric, new)}, nothing is kept"
            elif allowed and new > (most := old * allowed.get("times", 1.0) + allowed.get("more", 0.0)):
                yield f"{case}: {metric} {_said(metric, new)}, kept {_said(metric, old)}, at most {_said(metric, most)}"
            elif not allowed and new != old:
                yield f"{case}: {metric} {_said(metric, new)}, kept {_said(metric, old)}"


def _said(metric: str, value: float) -> str:
    return VERDICTS[int(value)] if metric == "verdict" else f"{value:.4g}"


def conclude(report: Mapping[str, Any], keep: bool) -> tuple[int, list[str]]:
    """Compare the report of `golden` with what is kept, or keep it (its cases replace the kept ones of these names).

    Returns the exit status and lines to print."""
    found: dict[str, dict[str, float]] = {}
    for r in report["results"]:
        found.setdefault(r["case"], {})[r["metric"]] = r["value"]
    kept, settings = document(), report["settings"]
    which = settings["clips"]
    lines = [f"SKIPPED: {name}, its recording is not in the data folder" for name in settings["skipped"]]
    failures = [f"{name}: {error}" for name, error in settings["failed"].items()]
    if keep:
        for case, values in found.items():
            old, factor = kept[which].get(case, {}).get("time_ratio", 0.0), kept["tolerances"]["time_ratio"]["times"]
            if old / factor < values["time_ratio"] < old * factor:
                values["time_ratio"] = old  # else times would creep upwards with each change that is kept
            kept[which][case] = {m: float(f"{v:.6g}") for m, v in values.items()}
        write_text(KEPT, to_json(kept))
        return int(bool(failures)), [*lines, *failures, f"Kept in {KEPT.name}: {', '.join(found)}"]
    worse = [*failures, *beyond(kept[which], found, _compared(settings["quick"]))]
    lines += [f"WORSE: {line}" for line in worse]
    lines.append(f"{len(found)} cases compared, {len(worse)} figures beyond.")
    if worse:
        lines.append("What is wanted is kept by --keep.")
    return int(bool(worse)), lines
