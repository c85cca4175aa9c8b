"""Fuzz the readers: spoilt inputs, each read under limits of time and memory.

    python -m scripts.fuzz [--minutes 10] [--only trc,c3d] [--seed 0] [--out fuzz-findings]
    python -m scripts.fuzz --replay fuzz-findings

A reader may return a value or raise a HyposeError of one sentence. Everything else is a finding: another exception,
more than 5 s of processor time or 768 MB more memory, a crash of the process, a program started, a socket opened, a
file written. The input of each finding is kept in --out; tests/io/corpus holds those of the past. Inputs follow from
the seed, so a run can be repeated. Exit code 1 when something was found.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hypose.errors import HyposeError
from scripts.fuzz_mutations import mutate
from scripts.fuzz_targets import Target, targets, write_good

TIME_S = 5
MEMORY = 768 << 20
_ROUND = 400  # inputs of one target before the next has its turn
_FORBIDDEN = {
    *("os.system", "os.exec", "os.fork", "os.forkpty", "os.posix_spawn", "os.spawn", "subprocess.Popen"),
    *("socket.connect", "socket.bind", "urllib.Request", "pickle.find_class", "ctypes.dlopen", "shutil.rmtree"),
}


class TooSlow(BaseException):
    """An input took longer than TIME_S. No Exception, so that no reader takes it for one of its own."""


@dataclass(frozen=True)
class Finding:
    """target; number of the input (follows from the seed); what went wrong."""

    target: str
    number: int
    what: str


# ---- one process that reads ------------------------------------------------------------------------------------


def forbid_programs(allowed: Path) -> list[str]:
    """From now on what a reader must not do goes into the list that is returned; writing below `allowed` is fine."""
    seen: list[str] = []

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        if event in _FORBIDDEN:
            seen.append(f"{event} {arguments!r}"[:200])
        elif event == "open" and isinstance(arguments[1], str) and set(arguments[1]) & set("wax+"):
            if not str(arguments[0]).startswith((str(allowed), "/dev/null")):
                seen.append(f"wrote {arguments[0]!r}")

    sys.addaudithook(watch)
    return seen


def judge(target: Target, folder: Path, data: bytes, forbidden: list[str]) -> str:
    """Empty when the reader behaves; else what it did. `folder`: a copy of the good inputs, to be spoilt."""
    forbidden.clear()
    file = folder / target.file
    whole = file.read_bytes()
    file.write_bytes(data)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # processor time: by the clock any input takes long on a busy machine; who sleeps is ended by the watching process
    signal.signal(signal.SIGPROF, _too_slow)
    signal.setitimer(signal.ITIMER_PROF, TIME_S)
    try:
        target.read(data if target.lines else folder / (target.given or target.file))
    except HyposeError as error:
        if len(str(error)) > 4000:
            return f"a sentence of {len(str(error))} characters"
    except TooSlow:
        return f"longer than {TIME_S} s: " + _where(3)
    except MemoryError:
        return "out of memory: " + _where(3)
    except Exception as error:
        where = _where(3)
        return f"{type(error).__name__}: {str(error)[:600]}" + (f" at {where}" if where else "")
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        file.write_bytes(whole)
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) << 10
    if grown > MEMORY // 2:
        return f"grew by {grown >> 20} MB"
    return next((f for f in forbidden if not f.startswith(target.allowed)), "")


def _where(depth: int) -> str:
    """The innermost lines of the package in the traceback under way."""
    frames = [f for f in traceback.extract_tb(sys.exc_info()[2]) if "hypose" in f.filename]
    return " < ".join(f"{Path(f.filename).name}:{f.lineno}" for f in reversed(frames[-depth:]))


def input_of(target: Target, good: bytes, seed: int, number: int) -> bytes:
    """The spoilt input of a number."""
    name = [int(b) for b in target.name.encode()]
    return mutate(good, target.kind, np.random.default_rng([seed, number, *name]))


def read_many(name: str, good: Path, seed: int, first: int, count: int) -> None:
    """Runs in a process of its own: tells each number on stdout before it is read, and each finding."""
    faulthandler.enable()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "in"
        shutil.copytree(good, folder)
        target = targets()[name]
        data = (good / target.file).read_bytes()
        # what a reader imports and compiles is loaded by the good input, before limits and watch
        target.read(data if target.lines else folder / (target.given or target.file))
        limit = _address_space() + MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        forbidden = forbid_programs(Path(temporary))
        for number in range(first, first + count):
            print(json.dumps({"number": number}), flush=True)
            what = judge(target, folder, input_of(target, data, seed, number), forbidden)
            if what:
                print(json.dumps({"number": number, "what": what}), flush=True)


def _too_slow(number: int, frame: Any) -> None:
    raise TooSlow


def _address_space() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


# ---- the process that watches ----------------------------------------------------------------------------------


def watch(name: str, good: Path, seed: int, first: int, count: int) -> Iterator[Finding | int]:
    """Findings of some inputs of a target, and at the end how many were read; begins again after a crash."""
    stop = first + count
    while first < stop:
        command = [sys.executable, "-m", "scripts.fuzz", "--read", name, "--good", str(good), "--seed", str(seed)]
        command += ["--first", str(first), "--count", str(stop - first)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, errors="replace")
        last, complaint = first - 1, ""
        try:
            # per-input alarms end what is slow; this one ends what no alarm reaches, inside a library
            out, complaint = process.communicate(timeout=120 + 2 * TIME_S * count)
        except subprocess.TimeoutExpired:
            process.kill()
            out, _ = process.communicate()
        for line in out.splitlines():
            message = json.loads(line)
            last = message["number"]
            if "what" in message:
                yield Finding(name, last, message["what"])
        if process.returncode == 0:
            break
        tail = " ".join(complaint.split())[:400]
        if last < first:
            raise RuntimeError(f"{name}: its good input cannot be read: {tail}")
        yield Finding(name, last, f"the process ended with {process.returncode}: {tail}")
        first = last + 1
    yield count


def fuzz(names: list[str], minutes: float, seed: int, out: Path) -> int:
    """Rounds over the targets until the time is over; returns the number of different findings."""
    known = targets()
    known_places: set[str] = set()
    counts = dict.fromkeys(names, 0)
    deadline = time.monotonic() + 60 * minutes
    with tempfile.TemporaryDirectory() as temporary:
        good = Path(temporary) / "good"
        good.mkdir()
        write_good(good)
        while time.monotonic() < deadline:
            for name in names:
                if time.monotonic() > deadline:
                    break
                first = counts[name]
                for message in watch(name, good, seed, first, _ROUND):
                    if isinstance(message, int):
                        counts[name] += message
                        continue
                    place = f"{name}: {message.what.split(' at ')[-1] if ' at ' in message.what else message.what[:60]}"
                    if place in known_places:
                        continue
                    known_places.add(place)
                    data = input_of(known[name], (good / known[name].file).read_bytes(), seed, message.number)
                    out.mkdir(parents=True, exist_ok=True)
                    (out / f"{name}--{message.number}{Path(known[name].file).suffix}").write_bytes(data)
                    print(f"{name} {message.number}: {message.what}", flush=True)
            print(f"{sum(counts.values())} inputs, {len(known_places)} findings", flush=True)
    return len(known_places)


def replay(folder: Path) -> int:
    """Read kept inputs again, whose names begin with their target's; returns how many still misbehave."""
    bad = 0
    with tempfile.TemporaryDirectory() as temporary:
        good = Path(temporary) / "good"
        good.mkdir()
        write_good(good)
        known = targets()
        forbidden = forbid_programs(Path(temporary))
        for path in sorted(p for p in folder.iterdir() if p.is_file()):
            what = judge(known[path.name.partition("--")[0]], good, path.read_bytes(), forbidden)
            bad += bool(what)
            print(f"{path.name}: {what or 'fine'}", flush=True)
    return bad


def main() -> None:
    """The command line."""
    known = list(targets())
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--only", default=",".join(known), help="targets, separated by commas")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("fuzz-findings"))
    parser.add_argument("--replay", type=Path)
    for hidden in ("--read", "--good", "--first", "--count"):
        parser.add_argument(hidden, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.read:
        read_many(given.read, Path(given.good), given.seed, int(given.first), int(given.count))
        return
    if given.replay:
        sys.exit(min(1, replay(given.replay)))
    names = given.only.split(",")
    if unknown := set(names) - set(known):
        parser.error(f"there is no target {min(unknown)}; the targets are {', '.join(known)}")
    sys.exit(min(1, fuzz(names, given.minutes, given.seed, given.out)))


if __name__ == "__main__":
    main()
