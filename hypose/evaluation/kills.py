"""kill -9 at random moments of every long command: what is lost, what is half written, what a second run makes of it.

The processes are forked from one that has imported and compiled everything, so that kills fall into the work. Every
other kill hits a run over a folder that already holds finished results: these must stay whole.
"""

from __future__ import annotations

import importlib
import json
import shutil
import tempfile
import time
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from hypose import compute
from hypose.evaluation.benchmarks import BenchOptions, BenchReport, Row
from hypose.evaluation.long_commands import LongCommand, long_commands
from hypose.evaluation.programs import fork
from hypose.pipeline.chunked import FOLDER as CHUNKS

_VARIES = {"provenance.json", "report.html", "task.json", "results.csv", "results.html"}
"""Files that tell of the run itself: times, attempts, the command."""
_PATIENCE_S = 900.0


@dataclass
class Tally:
    """Counts of one command's kills."""

    kills: int = 0
    lost: int = 0
    half_written: int = 0
    identical: int = 0
    begun: int = 0
    found: list[str] = field(default_factory=list)


def kills(options: BenchOptions) -> BenchReport:
    """lost_results, half_written (files), resumed_identical (share of kills) per command and over all.

    --seeds: number of kills (200; at least one per command), in random order. The moment is uniform over the
    time that an undisturbed run took. Lost: a finished file of before is gone or changed. Half-written: a file with its
    final name cannot be read whole. Identical: the second run ends well, and its files are those of the undisturbed
    run, byte for byte; files that tell of the run itself only have to be whole. Ctrl-C gives the rows of the kills so
    far.
    """
    total = options.seeds or (16 if options.quick else 200)
    rng = np.random.default_rng([options.first_seed or 0, 11])
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        commands = long_commands(root)
        _preload()
        seconds = {c.name: _undisturbed(c, root) for c in commands}
        order = [c for c in commands for _ in range(max(1, round(total * c.share)))]
        tallies = {c.name: Tally() for c in commands}
        try:
            for n, k in enumerate(rng.permutation(len(order))):
                options.progress("kills", n, len(order))
                command = order[k]
                over_old = n % 2 == 0 and not command.refuses
                kill_once(command, root, seconds[command.name], over_old, rng, tallies[command.name])
        except KeyboardInterrupt:
            pass
    done = sum(t.kills for t in tallies.values())
    return BenchReport(
        tuple(_rows(tallies)),
        {
            "kills": done,
            "found": [f for t in tallies.values() for f in t.found],
            "with_checkpoint": {n: t.begun for n, t in tallies.items()},
        },
    )


def _preload() -> None:
    """What all commands import and compile; OpenCV without threads, which a fork would lose."""
    cv2.setNumThreads(1)
    compute.warm_up(monocular=True)
    for name in ("job", "report", "overlay", "fuse_job", "gesture_job", "checking", "batch", "mono_job", "correct"):
        importlib.import_module(f"hypose.app.{name}")


def _undisturbed(command: LongCommand, root: Path) -> float:
    """Seconds of a run that nobody kills, the shorter of two; its results are what the others are compared with."""
    log, seconds = root / "log", []
    for _ in range(2):
        shutil.rmtree(root / "reference" / command.name, ignore_errors=True)
        begin = time.monotonic()
        if fork(command.to(root / "reference" / command.name), log).wait(_PATIENCE_S) != 0:
            raise RuntimeError(f"{command.name} failed undisturbed: {log.read_text()[-500:]}")
        seconds.append(time.monotonic() - begin)
    return min(seconds)


def kill_once(
    command: LongCommand, root: Path, seconds: float, over_old: bool, rng: np.random.Generator, tally: Tally
) -> None:
    """One run of a command killed, one to go on. over_old: it begins over finished results."""
    reference, out, log = root / "reference" / command.name, root / "killed" / command.name, root / "log"
    for _ in range(50):
        shutil.rmtree(out, ignore_errors=True)
        if over_old:
            shutil.copytree(reference, out)
        begin = time.monotonic()
        process = fork(command.to(out), log)
        ended = process.wait(float(rng.uniform(0.0, seconds)))
        if ended is None:
            process.kill()
            break
        seconds = min(seconds, time.monotonic() - begin)  # it takes less time than it did
        if ended != 0:
            tally.found.append(f"{command.name}: ended with {ended} by itself: {log.read_text()[-300:]}")
    else:
        return  # always over before its time
    wanted = _contents(reference)
    tally.kills += 1
    tally.begun += any(
        p.name == "checkpoint.npz" or (p.parent.name == CHUNKS and p.stem.isdigit()) for p in out.rglob("*.npz")
    )
    after = _contents(out)
    damaged = [p for p in after if not _whole(out / p, after[p], wanted.get(p))]
    gone = [p for p in wanted if over_old and p not in after]
    tally.half_written += len(damaged)
    tally.lost += len(gone) + (len(damaged) if over_old else 0)
    second = fork(command.to(out, again=True), log)
    code = second.wait(_PATIENCE_S)
    if code is None:
        second.kill()
    final = _contents(out)
    same = code == 0 and set(wanted) <= set(final) and not any(Path(p).name == "checkpoint.npz" for p in final)
    same = same and all(_whole(out / p, final[p], wanted.get(p)) for p in final)
    tally.identical += same
    if damaged or gone or not same:
        tally.found.append(f"{command.name}: damaged {damaged}, gone {gone}, then {code}: {log.read_text()[-300:]}")


def _contents(folder: Path) -> dict[str, bytes]:
    """Files by their path in the folder; temporary ones, whose names begin with a dot, are no results."""
    files = (p for p in sorted(folder.rglob("*")) if p.is_file() and not p.name.startswith("."))
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in files}


def _whole(path: Path, data: bytes, wanted: bytes | None) -> bool:
    """A file that the reference has is the same; any other one can be read to its end."""
    if wanted is not None and path.name not in _VARIES:
        return data == wanted
    try:
        if path.suffix == ".json":
            json.loads(data)
        elif path.suffix == ".html":
            return data.endswith(b"</html>\n")
        elif path.suffix == ".npz":
            with zipfile.ZipFile(path) as archive:
                return archive.testzip() is None
        return len(data) > 0
    except (ValueError, zipfile.BadZipFile):
        return False


def _rows(tallies: dict[str, Tally]) -> Sequence[Row]:
    rows = []
    for name, of in [*((n, [t]) for n, t in tallies.items()), ("all", list(tallies.values()))]:
        n = sum(t.kills for t in of)
        rows += [
            Row("lost_results", name, float(sum(t.lost for t in of)), "files", n=n),
            Row("half_written", name, float(sum(t.half_written for t in of)), "files", n=n),
            Row("resumed_identical", name, sum(t.identical for t in of) / max(n, 1), "1", n=n),
        ]
    return rows
