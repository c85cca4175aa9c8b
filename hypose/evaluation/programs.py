"""The command line run as real processes: to the end, under limits, or killed on the way."""

from __future__ import annotations

import contextlib
import os
import resource
import runpy
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

HYPOSE = (sys.executable, "-m", "hypose.app")
_TIMEOUT_S = 1800.0


@dataclass(frozen=True)
class Ended:
    """How a process ended: exit code (negative: the signal), what it printed, seconds."""

    code: int
    out: str
    err: str
    seconds: float

    @property
    def sentence(self) -> str:
        """What follows "error: ", with line breaks taken out; empty when there is none."""
        _, found, text = self.err.partition("error: ")
        return " ".join(text.split()) if found else ""

    @property
    def in_one_sentence(self) -> bool:
        """A user's error as it should be: exit code 2, one sentence, no traceback."""
        return self.code == 2 and bool(self.sentence) and "Traceback" not in self.err


def run(
    arguments: Sequence[str | Path],
    *,
    program: Sequence[str] = HYPOSE,
    file_bytes: int | None = None,
    memory_bytes: int | None = None,
    user: int | None = None,
    timeout: float = _TIMEOUT_S,
) -> Ended:
    """Run `hypose ARGUMENTS` to its end. file_bytes: no file may grow larger (as on a full disk); memory_bytes: of
    address space; user: run as that user (needs root). A time-out ends it with code -9."""

    def limit() -> None:
        if file_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))
        if memory_bytes is not None:
            resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
        if user is not None:
            os.setuid(user)

    limited = any(x is not None for x in (file_bytes, memory_bytes, user))
    begin = time.monotonic()
    process = subprocess.Popen(
        [*program, *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        preexec_fn=limit if limited else None,
    )
    try:
        out, err = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        process.kill()
        out, err = process.communicate()
    return Ended(process.returncode, out, err, time.monotonic() - begin)


@dataclass(frozen=True)
class Forked:
    """A process that runs `hypose ARGUMENTS`, forked from this one: what this one has imported and compiled need not be
    loaded again, so that a kill falls into the work. Its output goes to a file."""

    pid: int
    log: Path

    def wait(self, seconds: float) -> int | None:
        """Exit code (negative: the signal), None when it still runs after some seconds."""
        deadline = time.monotonic() + seconds
        while True:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                return os.waitstatus_to_exitcode(status)
            left = deadline - time.monotonic()
            if left <= 0:
                return None
            time.sleep(min(0.02, left))

    def kill(self) -> None:
        """SIGKILL, and wait for its end."""
        os.kill(self.pid, signal.SIGKILL)
        os.waitpid(self.pid, 0)


def fork(arguments: Sequence[str | Path], log: Path) -> Forked:
    """Start `hypose ARGUMENTS` in a fork of this process, which must have no running threads but numba's."""
    pid = os.fork()
    if pid:
        return Forked(pid, log)
    code = 1
    try:
        os.dup2(os.open(log, os.O_CREAT | os.O_TRUNC | os.O_WRONLY), 1)
        os.dup2(1, 2)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
        sys.argv = ["hypose", *map(str, arguments)]
        runpy.run_module("hypose.app", run_name="__main__")
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    finally:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)


def workers_of(process: int) -> list[int]:
    """Worker processes of a batch: descendants that multiprocessing spawned (Linux)."""
    children: dict[int, list[int]] = {}
    spawned = set()
    for entry in os.listdir("/proc"):
        if not entry.isdigit():
            continue
        try:
            parent = int(Path(f"/proc/{entry}/stat").read_text().rsplit(")", 1)[1].split()[1])
            if "spawn_main" in Path(f"/proc/{entry}/cmdline").read_text():
                spawned.add(int(entry))
        except (OSError, IndexError):
            continue
        children.setdefault(parent, []).append(int(entry))
    found, left = [], [process]
    while left:
        for child in children.get(left.pop(), []):
            left.append(child)
            if child in spawned:
                found.append(child)
    return found
