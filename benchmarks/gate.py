"""Speed gate: has a ratio become worse than benchmarks/baseline.json by more than its margin?

Every speed is divided by the time OpenCV needs for one silhouette (project, fill each front triangle, XOR) in the same
run, so that another machine, or a busy one, moves both. A figure that seems too slow is measured again, up to three
times, before it fails; margins are wide because machines are shared: the gate is for changes that cost a factor.

    python -m benchmarks.gate             exit status 1 when something got slower; under a minute
    python -m benchmarks.gate --update    write the ratios of this run as the new baseline (say why in the commit)
"""

import argparse
import json
import os
import sys
from pathlib import Path

from benchmarks.bench_origin import machine
from benchmarks.bench_report import BenchOptions, BenchReport
from benchmarks.multiview.action_scenes import action_scene, known_subject
from benchmarks.multiview.scorer_speed import opencv_unit, silhouette_scorer
from benchmarks.multiview.solve_speed import contour_solve
from hypose.compute.warming import warm_up

BASELINE = Path(__file__).with_name("baseline.json")
ATTEMPTS = 3


def value(report: BenchReport, metric: str, case: str) -> float:
    """The figure of one row; fails with the rows there are, so that a renamed row is not taken for a fast one."""
    for row in report.rows:
        if (row.metric, row.case) == (metric, case):
            return row.value
    names = ", ".join(f"{r.metric} {r.case}" for r in report.rows)
    raise SystemExit(f"There is no row {metric} {case}; the benchmark has {names}.")


def scorer() -> dict[str, float]:
    """Time per silhouette / OpenCV's, one thread."""
    return {"silhouette-scorer 1t": value(silhouette_scorer(BenchOptions(quick=True)), "ratio_to_opencv", "1t")}


def solve() -> dict[str, float]:
    """Time per contour solve / OpenCV's time per silhouette, the mean of it before and after."""
    options = BenchOptions(quick=True)
    scene = action_scene("walk", 0, 0.2, options)
    frame, subject = next(iter(scene.mask_frames(1.0))), known_subject(scene)
    before = opencv_unit(frame, subject.body, subject.start)
    seconds = value(contour_solve(options), "ms_per_frame", "contours") / 1e3
    after = opencv_unit(frame, subject.body, subject.start)
    return {"contour-solve contours": seconds / (0.5 * (before + after))}


def main() -> int:
    """Measure, compare, print; the exit status."""
    parser = argparse.ArgumentParser(description="Speed gate.")
    parser.add_argument("--update", action="store_true", help="write this run's ratios as the baseline")
    update = parser.parse_args().update
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    print(f"kernels ready after {warm_up():.1f} s")
    baseline = json.loads(BASELINE.read_text(encoding="utf-8")) if BASELINE.exists() else {"ratios": {}}
    measured: dict[str, float] = {}
    failed = False
    for measure in (scorer, solve):
        for attempt in range(ATTEMPTS):
            for name, ratio in measure().items():
                measured[name] = min(ratio, measured.get(name, ratio))
            slow = [
                n for n in measured if n in baseline["ratios"] and _times(baseline, measured, n) > _margin(baseline, n)
            ]
            if not slow or update:
                break
            print(f"attempt {attempt + 1}: {', '.join(slow)} above the margin")
    for name, ratio in measured.items():
        if name not in baseline["ratios"]:
            print(f"{name}: {ratio:.4g} (no baseline)")
            failed |= not update
            continue
        times, margin = _times(baseline, measured, name), _margin(baseline, name)
        verdict = "SLOWER" if times > margin else "ok"
        failed |= times > margin and not update
        print(f"{name}: {ratio:.4g}, {times:.2f} x the baseline (at most {margin}): {verdict}")
    if update:
        ratios = {
            n: {"ratio": float(f"{r:.4g}"), "margin": baseline["ratios"].get(n, {}).get("margin", 1.8)}
            for n, r in measured.items()
        }
        document = {"unit": "OpenCV's time per silhouette in the same run", "machine": machine(), "ratios": ratios}
        BASELINE.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8", newline="\n")
    return int(failed)


def _times(baseline: dict, measured: dict[str, float], name: str) -> float:
    return measured[name] / baseline["ratios"][name]["ratio"]


def _margin(baseline: dict, name: str) -> float:
    return baseline["ratios"][name]["margin"]


if __name__ == "__main__":
    sys.exit(main())
