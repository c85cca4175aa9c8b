"""What a new user waits for: installing into a fresh environment, the first start, which compiles, and later ones; and
how much of a long run is not tracking."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.bench_origin import ROOT
from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.robustness.small_recordings import small_scene, write_masks
from hypose.body.ready_bodies import human
from hypose.compute import VARIABLE
from hypose.errors import InputError
from hypose.io.motions.results import save_body
from hypose.synthetic.scenes import make_scene
from hypose.synthetic.write_recording import write_scene

_TRACK = """
import sys, time
from pathlib import Path
began, recording, out, body = float(sys.argv[1]), *map(Path, sys.argv[2:5])
from hypose.app import cli
from hypose.app.jobs.job import Job, run_job
from hypose.io.motions.results import ResultsFolder
from hypose.io.recordings.recording import load_recording
from hypose.pipeline.run import TrackOptions

class First(Exception): pass

def progress(stage, done, total):
    if stage == "track" and done:
        raise First

def first_pose():
    try:
        run_job(Job(load_recording(recording), TrackOptions(subject=str(body)), ResultsFolder(out)), progress)
    except First:
        return time.time()

first = first_pose() - began
again = time.time()
print(first, first_pose() - again)
"""
_FUSE = """
import sys, time
began = float(sys.argv[1])
from hypose.app import cli
from hypose.fusion.live import LiveFuser
LiveFuser()
first, again = time.time() - began, time.time()
LiveFuser()
print(first, time.time() - again)
"""
_WHOLE = """
import json, sys
from pathlib import Path
from hypose.app.commands.console import Stages
from hypose.app.jobs.job import Job, run_job
from hypose.io.motions.results import ResultsFolder
from hypose.io.recordings.recording import load_recording
from hypose.pipeline.run import TrackOptions

sys.setswitchinterval(5e-4)  # as the command's
with Stages(quiet=True) as stages:
    run_job(Job(load_recording(Path(sys.argv[1])), TrackOptions(), ResultsFolder(Path(sys.argv[2]))), stages)
print(json.dumps(stages.seconds))
"""
_LARGEST = ("llvmlite", "numba", "numpy", "scipy", "cv2", "opencv_python_headless")


def start(options: BenchOptions) -> BenchReport:
    """install_mib, install_seconds: a wheel of this tree and what it requires, by pip into an empty environment, whose
    own pip is not counted; baseline: LLVM, numba, numpy, scipy and OpenCV alone. cold_seconds, warm_seconds: from the
    start of the process to the first pose, less what the same takes once more in that process, which is work on the
    recording: masks of four cameras and a given body (track), two frames of a skeleton (fuse); cold with an empty cache
    of compiled code, warm the fastest of three. whole_over_tracking: seconds of `hypose track` with overlay, exports
    and report over those up to the motion, 60 s of walking before four cameras (quick: 2 s).
    """
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        options.progress("install", 0, 1)
        python, mib, largest, seconds = _install(root)
        options.progress("install", 1, 1)
        rows = [
            Row(
                "install_mib", "core", mib, "MiB", baseline="LLVM, numba, numpy, scipy, OpenCV", baseline_value=largest
            ),
            Row("install_seconds", "core", seconds, "s"),
        ]
        recording = write_masks(small_scene(0, 5), root / "masks")
        save_body(human(), root / "body.npz")
        given = {"track": (_TRACK, (recording, root / "out", root / "body.npz")), "fuse": (_FUSE, ())}
        for n, (name, (program, arguments)) in enumerate(given.items()):
            options.progress("start", n, len(given))
            cold, *warm = (_seconds(python, program, arguments, root / f"cache-{name}") for _ in range(4))
            rows.append(Row("cold_seconds", name, cold, "s"))
            rows.append(Row("warm_seconds", name, min(warm), "s", n=len(warm)))
        options.progress("start", len(given), len(given))
        length = 2.0 if options.quick else 60.0
        stages = _stages(python, root, length)
        done = list(stages)
        tracking = sum(stages[s] for s in done[: done.index("export")])
        ratio = sum(stages.values()) / tracking
        rows.append(
            Row("whole_over_tracking", f"{length:g} s", ratio, "1", baseline="tracking, s", baseline_value=tracking)
        )
    return BenchReport(tuple(rows), {"python": sys.version.split()[0], "stages_s": stages})


def _install(root: Path) -> tuple[Path, float, float, float]:
    """A fresh environment with hypose: its python, MiB of all that was installed, of the largest packages, seconds."""
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(root / "wheel")]
    _run(build, ROOT)
    (wheel,) = (root / "wheel").glob("*.whl")
    _run([sys.executable, "-m", "venv", str(root / "fresh")], root)
    python = root / "fresh" / ("Scripts" if os.name == "nt" else "bin") / "python"
    before = sum(_sizes(root / "fresh").values())
    begin = time.perf_counter()
    _run([str(python), "-m", "pip", "install", "--quiet", "--no-cache-dir", "--only-binary=:all:", str(wheel)], root)
    seconds = time.perf_counter() - begin
    sizes = _sizes(root / "fresh")
    largest = sum(size for name, size in sizes.items() if name.startswith(_LARGEST))
    return python, (sum(sizes.values()) - before) / 2**20, largest / 2**20, seconds


def _sizes(environment: Path) -> dict[str, int]:
    """Bytes on disk of each folder of packages."""
    (packages,) = environment.glob("[Ll]ib/**/site-packages")
    return {
        one.name: sum(f.stat().st_size for f in (one.rglob("*") if one.is_dir() else [one]) if f.is_file())
        for one in packages.iterdir()
    }


def _seconds(python: Path, program: str, arguments: Sequence[Path], cache: Path) -> float:
    """Of a start: what the program prints first, less what it prints second."""
    command = [str(python), "-c", program, repr(time.time()), *map(str, arguments)]
    first, again = map(float, _run(command, cache.parent, cache).split()[-2:])
    return first - again


def _stages(python: Path, root: Path, seconds: float) -> dict[str, float]:
    """Seconds of the stages of `hypose track`, compiling aside, in their order."""
    folder, cache = root / "clip", root / "cache-track"
    write_scene(make_scene("walk", rig="humaneva-4", seconds=seconds, seed=1), folder)
    command = [str(python), "-m", "hypose.app", "track", str(folder)]
    _run([*command, "--frames", "0:8", "--out", str(root / "compile")], root, cache)
    told = _run([str(python), "-c", _WHOLE, str(folder), str(root / "results")], root, cache)
    return dict(json.loads(told.splitlines()[-1]))


def _run(command: Sequence[str], folder: Path, cache: Path | None = None) -> str:
    """What a command prints."""
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "NUMBA_NUM_THREADS")}
    environment |= {VARIABLE: str(cache)} if cache is not None else {}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise InputError(f"{' '.join(command[:4])} ended with {done.returncode}: {done.stderr.strip()[-400:]}")
    return done.stdout
