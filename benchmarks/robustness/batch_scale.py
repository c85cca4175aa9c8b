"""`hypose batch` over many short recordings: one worker against two, of which two are killed on the way."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.robustness.programs import HYPOSE, workers_of
from benchmarks.robustness.small_recordings import small_scene, write_masks
from hypose.body.default_body import human
from hypose.io.motions.results import save_body

_FRAMES = 30


def batch(options: BenchOptions) -> BenchReport:
    """speed_up of two workers over one, the latter with two random kill -9 of a worker; identical: share of the motions
    that are the same, byte for byte.

    --seeds: number of recordings (100; quick: 6), each of 30 frames in four views of masks; the body is given, so that
    a task is tracking. Every worker has one thread.
    """
    count = options.seeds or (6 if options.quick else 100)
    rng = np.random.default_rng([options.first_seed or 0, 12])
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        save_body(human(), root / "subject" / "body.npz")
        for n in range(count):
            write_masks(small_scene(n, _FRAMES), root / "study" / f"r{n:03d}")
        (root / "study.csv").write_text(
            "\n".join(["recording,subject", *(f"study/r{n:03d},{root}/subject" for n in range(count))])
        )
        options.progress("batch", 0, 3)
        _run(root, "warm", 1, [], "--dry-run")
        options.progress("batch", 1, 3)
        one = _run(root, "one", 1, [])
        options.progress("batch", 2, 3)
        two = _run(root, "two", 2, sorted(rng.uniform(0.1, 0.4, 2) * one))
        options.progress("batch", 3, 3)
        first, second = _motions(root / "one"), _motions(root / "two")
    same = [first[k] == second.get(k) for k in first]
    rows = (
        Row("speed_up", "two workers", one / two, "1", baseline="one worker, s", baseline_value=one),
        Row("identical", "two kills", float(np.mean(same)), "1", n=len(same)),
    )
    return BenchReport(rows, {"recordings": count, "frames": _FRAMES, "seconds": [one, two]})


def _run(root: Path, name: str, workers: int, kills: list[float], *more: str) -> float:
    """Seconds of a batch; at each of the moments (s) one of its workers is killed."""
    command = [*HYPOSE, "batch", str(root / "study.csv"), "--workers", str(workers), "--threads", "1"]
    begin = time.monotonic()
    with (root / f"{name}.log").open("w") as log:
        process = subprocess.Popen([*command, "--out", str(root / name), *more], stdout=log, stderr=log)
        for moment in kills:
            time.sleep(max(0.0, begin + moment - time.monotonic()))
            if found := workers_of(process.pid):
                os.kill(found[0], signal.SIGKILL)
        code = process.wait()
    if code != 0:
        raise RuntimeError(f"the batch ended with {code}: {(root / f'{name}.log').read_text()[-500:]}")
    return time.monotonic() - begin


def _motions(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.glob("*/*/motion.npz")}
