"""kill -9 at random moments of every long command: what is lost, what is half written, what a second run makes of it.
So too when files of the cache are damaged before the first run, or the disk is full on the way.

The processes are forked from one that has imported and compiled everything, so that kills fall into the work; those
with a damaged cache from one that has compiled nothing. Every other first run goes over a folder that already holds
finished results: these must stay whole.
"""

from __future__ import annotations

import json
import shutil
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.robustness.circumstances import USUAL, Circumstances
from benchmarks.robustness.fork_server import ForkServer
from benchmarks.robustness.long_commands import LongCommand, long_commands
from benchmarks.robustness.programs import Ended
from hypose.compute.compiled import VARIABLE, cache_folder
from hypose.errors import InputError

_VARIES = {"provenance.json", "report.html", "task.json", "results.csv", "results.html"}
"""Files that tell of the run itself: times, attempts, the command."""
_PATIENCE_S = 900.0
KINDS = ("killed", "cache damaged", "disk full")
_OF_FIVE = (0, 1, 1, 2, 2)
"""Which kind each of five runs is."""


@dataclass
class Tally:
    """Counts of one command's kills of one kind. said: full disks that were told in one sentence."""

    kills: int = 0
    lost: int = 0
    half_written: int = 0
    identical: int = 0
    begun: int = 0
    said: int = 0
    found: list[str] = field(default_factory=list)


def kills(options: BenchOptions) -> BenchReport:
    """lost_results, half_written (files), resumed_identical (share of kills) per command, per kind and over all.

    --seeds: number of first runs (200; at least one per command), in random order; a fifth is killed, two fifths are
    killed with files of the cache damaged, two fifths find the disk full. The moment of a kill is uniform over the time
    that an undisturbed run took; a full disk lets no file grow beyond a size that is drawn (logarithmically) up to that
    of the largest result. Lost: a finished file of before is gone or changed. Half-written: a file with its final name
    cannot be read whole. Identical: the second run ends well, and its files are those of the undisturbed run, byte for
    byte; files that tell of the run itself only have to be whole. In a sentence: a run on a full disk ends so, with
    exit code 2. Ctrl-C gives the rows of the kills so far.
    """
    total = options.seeds or (16 if options.quick else 200)
    rng = np.random.default_rng([options.first_seed or 0, 11])
    tallies: dict[tuple[str, str], Tally] = {}
    with tempfile.TemporaryDirectory() as temporary, ExitStack() as stack:
        root = Path(temporary)
        commands = long_commands(root)
        bench = Bench(root, *(stack.enter_context(ForkServer(warm=warm)) for warm in (True, False)))
        for command in commands:
            bench.undisturbed(command)
        order = [c for c in commands for _ in range(max(1, round(total * c.share)))]
        try:
            for n, k in enumerate(rng.permutation(len(order))):
                options.progress("kills", n, len(order))
                kind, command = KINDS[_OF_FIVE[n % len(_OF_FIVE)]], order[k]
                over_old = bool(rng.random() < 0.5) and not command.refuses
                bench.disturb(command, kind, over_old, rng, tallies.setdefault((command.name, kind), Tally()))
        except KeyboardInterrupt:
            pass
    return BenchReport(
        tuple(_rows(tallies)),
        {
            "kills": sum(t.kills for t in tallies.values()),
            "found": [f for t in tallies.values() for f in t.found],
            "with_checkpoint": {name: sum(t.begun for t in of) for name, of in _groups(tallies).items()},
        },
    )


class Bench:
    """Runs commands in a folder, and keeps what undisturbed runs gave, and in how many seconds."""

    def __init__(self, root: Path, warm: ForkServer, cold: ForkServer) -> None:
        self._root, self._warm, self._cold = root, warm, cold
        self._seconds: dict[tuple[str, bool], float] = {}
        cache = cache_folder()
        if cache is None:
            raise InputError(f"There is no folder for the cache that could be damaged; name one with {VARIABLE}.")
        self._cache = cache

    def undisturbed(self, command: LongCommand) -> None:
        """Runs that nobody kills; the results are what the others are compared with."""
        for server in (self._warm, self._cold):
            for _ in range(2):  # what the first has to compile, the second loads
                shutil.rmtree(self._reference(command), ignore_errors=True)
                ended = server.start(command.to(self._reference(command))).wait(_PATIENCE_S)
                if ended is None or ended.code != 0:
                    said = ended.err[-500:] if ended else "no end"
                    raise RuntimeError(f"{command.name} failed undisturbed: {said}")
                self._seconds[command.name, server is self._cold] = ended.seconds

    def disturb(self, command: LongCommand, kind: str, over_old: bool, rng: np.random.Generator, tally: Tally) -> None:
        """One run of a command disturbed, one to go on. over_old: it begins over finished results."""
        reference, out = self._reference(command), self._root / "disturbed" / command.name
        circumstances = self._with_damaged_cache(rng) if kind == "cache damaged" else USUAL
        for _ in range(50):
            shutil.rmtree(out, ignore_errors=True)
            if over_old:
                shutil.copytree(reference, out)
            if kind == "disk full":
                ended = self._on_full_disk(command, out, rng)
                over = ended is not None and ended.code == 0
            else:
                ended = self._killed(command, out, circumstances, rng)
                over = ended is not None
            if not over:
                break
            if ended is not None and ended.code != 0:
                tally.found.append(f"{command.name}: ended with {ended.code} by itself: {ended.err[-300:]}")
        else:
            return  # always over before its time
        if kind == "disk full":
            told = ended is not None and _told(command, ended)
            tally.said += told
            if not told:
                tally.found.append(f"{command.name}: on a full disk {ended}")
        self._go_on(command, kind, over_old, circumstances, tally)
        tally.kills += 1  # not one that Ctrl-C has cut short

    def _go_on(
        self, command: LongCommand, kind: str, over_old: bool, circumstances: Circumstances, tally: Tally
    ) -> None:
        """Look what the first run has left, run the command again, and look again."""
        reference, out = self._reference(command), self._root / "disturbed" / command.name
        wanted, after = _contents(reference), _contents(out)
        tally.begun += any(out.rglob("checkpoint.npz"))
        damaged = [p for p in after if not _whole(out / p, after[p], wanted.get(p))]
        gone = [p for p in wanted if over_old and p not in after]
        tally.half_written += len(damaged)
        tally.lost += len(gone) + (len(damaged) if over_old else 0)
        second = self._server(kind).start(command.to(out, again=True), circumstances)
        ended = second.wait(_PATIENCE_S) or second.kill()
        final = _contents(out)
        same = (
            ended.code == 0 and set(wanted) <= set(final) and not any(Path(p).name == "checkpoint.npz" for p in final)
        )
        same = same and all(_whole(out / p, final[p], wanted.get(p)) for p in final)
        tally.identical += same
        if damaged or gone or not same:
            found = f"damaged {damaged}, gone {gone}, then {ended.code}: {ended.err[-300:]}"
            tally.found.append(f"{command.name}, {kind}: {found}")

    def _killed(
        self, command: LongCommand, out: Path, circumstances: Circumstances, rng: np.random.Generator
    ) -> Ended | None:
        """Kill a run at some moment; how it ended when it was over before."""
        key = (command.name, circumstances != USUAL)
        process = self._server(KINDS[key[1]]).start(command.to(out), circumstances)
        ended = process.wait(float(rng.uniform(0.0, self._seconds[key])))
        if ended is None:
            process.kill()
        else:
            self._seconds[key] = min(self._seconds[key], ended.seconds)  # it takes less time than it did
        return ended

    def _on_full_disk(self, command: LongCommand, out: Path, rng: np.random.Generator) -> Ended | None:
        """Run where no file may grow beyond a size; how it ended."""
        largest = max(p.stat().st_size for p in self._reference(command).rglob("*") if p.is_file())
        process = self._warm.start(command.to(out), Circumstances(file_bytes=int(largest ** rng.random())))
        return process.wait(_PATIENCE_S) or process.kill()

    def _with_damaged_cache(self, rng: np.random.Generator) -> Circumstances:
        """A copy of the cache with damaged files, for this run and the next."""
        cache = self._root / "cache"
        shutil.rmtree(cache, ignore_errors=True)
        shutil.copytree(self._cache, cache)
        damage(cache, rng)
        return Circumstances({VARIABLE: str(cache)})

    def _server(self, kind: str) -> ForkServer:
        return self._cold if kind == "cache damaged" else self._warm

    def _reference(self, command: LongCommand) -> Path:
        return self._root / "reference" / command.name


def damage(folder: Path, rng: np.random.Generator, files: int = 4) -> None:
    """Spoil up to so many of the files below a folder: emptied, cut, bytes turned, replaced by another file, removed,
    a folder in their place."""
    whole = [(p, p.read_bytes()) for p in sorted(folder.rglob("*")) if p.is_file() and p.stat().st_size]
    for k in rng.permutation(len(whole))[: int(rng.integers(1, files + 1))]:
        path, data = whole[k][0], bytearray(whole[k][1])
        how = int(rng.integers(6))
        if how == 0:
            path.write_bytes(data[: int(rng.integers(len(data)))])
        elif how == 1:
            for at in rng.choice(len(data), 5):
                data[at] ^= 1 << int(rng.integers(8))
            path.write_bytes(data)
        elif how == 2:
            path.write_bytes(rng.bytes(len(data)))
        elif how == 3:
            path.write_bytes(whole[k - 1][1])
        else:
            path.unlink()
            if how == 4:
                path.mkdir()


def _told(command: LongCommand, ended: Ended) -> bool:
    """Whether a run that could not write said so, and not as if it were a bug."""
    failed = ended.code == command.failed and "cannot be written" in ended.out + ended.err
    return ended.in_one_sentence or failed


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


def _groups(tallies: Mapping[tuple[str, str], Tally]) -> dict[str, list[Tally]]:
    """The tallies of each command, of each kind, and all."""
    names = sorted({name for name, _ in tallies})
    groups = {name: [t for (n, _), t in tallies.items() if n == name] for name in names}
    groups |= {kind: [t for (_, k), t in tallies.items() if k == kind] for kind in KINDS}
    return {**groups, "all": list(tallies.values())}


def _rows(tallies: Mapping[tuple[str, str], Tally]) -> Sequence[Row]:
    rows = []
    for name, of in _groups(tallies).items():
        n = sum(t.kills for t in of)
        rows += [
            Row("lost_results", name, float(sum(t.lost for t in of)), "files", n=n),
            Row("half_written", name, float(sum(t.half_written for t in of)), "files", n=n),
            Row("resumed_identical", name, sum(t.identical for t in of) / max(n, 1), "1", n=n),
        ]
    full = [t for (_, kind), t in tallies.items() if kind == "disk full"]
    n = sum(t.kills for t in full)
    return [*rows, Row("in_a_sentence", "disk full", sum(t.said for t in full) / max(n, 1), "1", n=n)]
