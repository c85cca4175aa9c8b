"""What a user waits for: the first start, which compiles, later ones, and a short clip; and how much is installed."""

from __future__ import annotations

import contextlib
import os
import re
import resource
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from benchmarks.bench_origin import ROOT
from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.robustness.small_recordings import small_scene, write_masks
from hypose.body.default_body import human
from hypose.compute.compiled import VARIABLE
from hypose.errors import InputError
from hypose.io.motions.results import save_body

_CLOCK = """
import os, subprocess, sys
from pathlib import Path

def clock():  # processor time of this process and of those that it started
    return sum(os.times()[:4])
"""
_TRACK = """
recording, out, body = map(Path, sys.argv[1:4])
from hypose.app import cli
from hypose.app.jobs.job import job_of, run_job
from hypose.app.options import TrackCommand

class First(Exception): pass

def progress(stage, done, total):
    if stage == "track" and done:
        raise First

def first_pose():
    try:
        run_job(job_of(TrackCommand(recording=recording, subject=str(body), out=out)), progress)
    except First:
        return clock()

if __name__ == "__main__":
    first = first_pose()
    print(first, first_pose() - first)
"""
_FUSE = """
from hypose.app import cli
from hypose.fusion.people import LiveFuser

if __name__ == "__main__":
    LiveFuser()
    first = clock()
    LiveFuser()
    print(first, clock() - first)
"""
_HELP = """
before = clock()
subprocess.run([sys.executable, "-m", "hypose", "track", "--help"], check=True, stdout=subprocess.DEVNULL)
print(clock() - before, 0.0)
"""
_LARGEST = ("llvmlite", "numba", "numpy", "scipy", "opencv-python-headless")


def start(options: BenchOptions) -> BenchReport:
    """install_mb: this tree and the packages that it requires here; baseline: LLVM, numba, numpy, scipy and OpenCV
    alone. cold_start_s, warm_start_s: processor time from the start of the process to the first pose, less what the
    same takes once more in that process, which is work on the recording: masks of four cameras and a given body
    (track), two frames of a skeleton (fuse); all of `hypose track --help` (help). Cold with an empty cache of compiled
    code, which is compiled by as many processes as there are cores; warm the least of three.
    """
    sizes = _installed()
    largest = sum(sizes[name] for name in _LARGEST)
    base = {"baseline": "LLVM, numba, numpy, scipy, OpenCV", "baseline_value": largest}
    rows = [Row("install_mb", "core", sum(sizes.values()), "MB", **base)]
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        recording = write_masks(small_scene(0, 5), root / "masks")
        save_body(human(), root / "body.npz")
        given = {"track": (_TRACK, (recording, root / "out", root / "body.npz"))}
        given |= {"fuse": (_FUSE, ()), "help": (_HELP, ())}
        for n, (name, (program, arguments)) in enumerate(given.items()):
            options.progress("start", n, len(given))
            script = root / f"{name}_program.py"
            script.write_text(_CLOCK + program)
            command = [sys.executable, str(script), *map(str, arguments)]
            told = [_run(command, root, root / f"cache-{name}")[0].split()[-2:] for _ in range(4)]
            cold, *warm = (float(first) - float(again) for first, again in told)
            if name != "help":  # which compiles nothing
                rows.append(Row("cold_start_s", name, cold, "s"))
            rows.append(Row("warm_start_s", name, min(warm), "s", n=len(warm)))
        options.progress("start", len(given), len(given))
    return BenchReport(tuple(rows), {"python": sys.version.split()[0], "mb": sizes})


def short_clip(options: BenchOptions) -> BenchReport:
    """cpu_s: processor time of `hypose track` on the key points of the balancing clip, 100 frames from four cameras,
    the least of three runs (quick: one). all: every file and the report, without the overlay; trc: motion.trc alone,
    no report.
    """
    folder, runs = options.folder("pose2sim_balancing"), 1 if options.quick else 3
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        track = [sys.executable, "-m", "hypose", "track", str(folder), "--evidence", "keypoints", "--no-overlay"]
        track += ["--out", str(root / "results")]
        commands = {"all": (track, root), "trc": ([*track, "--no-report", "--formats", "trc"], root)}
        for command, where in commands.values():  # what is compiled by the first run
            _run(command, where)
        seconds = [{name: _run(*command)[1] for name, command in commands.items()} for _ in range(runs)]
    least = {name: min(s[name] for s in seconds) for name in commands}
    rows = [Row("cpu_s", name, least[name], "s", n=runs) for name in ("all", "trc")]
    return BenchReport(tuple(rows), {"frames": 100, "cameras": 4, "runs_s": seconds})


def _installed() -> dict[str, float]:
    """MB of this tree and of each package that it requires, directly or not, as they are installed here."""
    tree = (p for p in (ROOT / "hypose").rglob("*") if p.is_file() and "__pycache__" not in p.parts)
    sizes = {"hypose": sum(p.stat().st_size for p in tree) / 1e6}
    left = list(tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["dependencies"])
    while left:
        requirement, _, marker = left.pop().partition(";")
        name = re.sub(r"[-_.]+", "-", re.split(r"[^\w.-]", requirement.strip())[0]).lower()
        if name not in sizes and "extra" not in marker:
            with contextlib.suppress(PackageNotFoundError):  # of another platform or an older Python
                files = {Path(str(f.locate())) for f in distribution(name).files or ()}
                sizes[name] = sum(f.stat().st_size for f in files if f.is_file()) / 1e6
                left += distribution(name).requires or []
    return sizes


def _run(command: Sequence[str], folder: Path, cache: Path | None = None) -> tuple[str, float]:
    """What a command prints, and the processor time of it and all its processes, s."""
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_NUM_THREADS"} | {"PYTHONPATH": str(ROOT)}
    environment |= {VARIABLE: str(cache)} if cache is not None else {}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise InputError(f"{' '.join(command[:4])} ended with {done.returncode}: {done.stderr.strip()[-400:]}")
    return done.stdout, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
