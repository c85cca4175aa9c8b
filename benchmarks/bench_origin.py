"""Where figures come from: commit, command and machine, with a yardstick that makes its speed comparable."""

from __future__ import annotations

import os
import platform
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.bench_report import BenchOptions, Row, best

ROOT = Path(__file__).resolve().parent.parent
YARDSTICK = "OpenCV fill"
_PER_SECOND = {"s": 1.0, "ms": 1e3, "us": 1e6, "1/s": 1.0}
_NO_SPEED = ("recovery_s", "recovered_s")


def commit() -> str | None:
    """The commit of this checkout, with a + when files of the product or of the benchmarks differ from it; None outside
    a checkout."""
    try:
        found = _git("rev-parse", "--short=10", "HEAD").stdout.strip()
        if not found:
            return None
        changed = _git("diff", "--quiet", "HEAD", "--", "hypose", "benchmarks", ":!benchmarks/results").returncode
    except OSError:
        return None
    return found + ("+" if changed else "")


def _git(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=False)


def command(name: str, case: str, options: BenchOptions) -> str:
    """What was called, with DATA and PARTS in place of folders of this machine."""
    words = ["./run bench", name, *([f"--case {case}"] if case else [])]
    words += ["--quick"] if options.quick else []
    words += [f"--seeds {options.seeds}"] if options.seeds else []
    words += [f"--first-seed {options.first_seed}"] if options.first_seed is not None else []
    words += ["--data DATA"] if options.data is not None else []
    words += ["--parts PARTS"] if options.parts is not None else []
    words += ["--other"] if options.other else []
    return " ".join(words)


def machine() -> dict[str, Any]:
    """Processor, number of usable cores, python and load of this machine."""
    model = platform.processor() or platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                model = line.split(":", 1)[1].strip()
                break
    except OSError:
        pass
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {"processor": model, "cores": cores, "python": platform.python_version(), "load": load}


def yardstick() -> float:
    """Microseconds that OpenCV takes on one thread to fill 550 small triangles in 640 x 480 and to compare the picture
    with another: about the work of one silhouette of a person, measured in the same run as what is compared with it."""
    rng = np.random.default_rng(0)
    triangles = (rng.uniform((270, 110), (360, 370), (550, 1, 2)) + rng.uniform(-8, 8, (550, 3, 2))).astype(np.int32)
    mask, image = np.zeros((2, 480, 640), np.uint8)

    def fill() -> int:
        image[:] = 0
        for triangle in triangles:
            cv2.fillConvexPoly(image, triangle, 255)
        return cv2.countNonZero(cv2.bitwise_xor(image, mask))

    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        fill()
        return 1e6 * best(fill, 25)
    finally:
        cv2.setNumThreads(threads)


def beside_yardstick(row: Row, microseconds: float) -> Row:
    """A row of speed (a time per something, or something per second) that has no baseline of its own gets the yardstick
    as its baseline; other rows as they are."""
    if row.baseline or row.unit not in _PER_SECOND or row.metric.startswith(_NO_SPEED):
        return row
    unit = 1e6 / microseconds if row.unit == "1/s" else 1e-6 * microseconds * _PER_SECOND[row.unit]
    return replace(row, baseline=YARDSTICK, baseline_value=unit)
