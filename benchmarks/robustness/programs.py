"""The command line run as real processes: to the end, in circumstances of their own, or killed on the way."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.robustness.circumstances import USUAL, Circumstances

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
        _, found, text = self.err.replace("Error: ", "error: ").partition("error: ")
        return " ".join(text.split()) if found else ""


class Program:
    """A process of the command line that has been started."""

    def __init__(
        self,
        arguments: Sequence[str | Path],
        circumstances: Circumstances = USUAL,
        program: Sequence[str] = HYPOSE,
    ) -> None:
        self._began = time.monotonic()
        self._process = subprocess.Popen(
            [*program, *(os.fspath(a) for a in arguments)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            preexec_fn=None if circumstances == USUAL else circumstances.impose,
        )
        self.pid = self._process.pid

    def wait(self, seconds: float) -> Ended | None:
        """How it ended, None when it still runs after some seconds."""
        try:
            out, err = self._process.communicate(timeout=max(0.0, seconds))
        except subprocess.TimeoutExpired:
            return None
        return Ended(self._process.returncode, out, err, time.monotonic() - self._began)

    def kill(self) -> Ended:
        """SIGKILL, and how it ended."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGKILL)
        out, err = self._process.communicate()
        return Ended(self._process.returncode, out, err, time.monotonic() - self._began)


def run(arguments: Sequence[str | Path], circumstances: Circumstances = USUAL, *, timeout: float = _TIMEOUT_S) -> Ended:
    """Run `hypose ARGUMENTS` to its end. A time-out ends it with code -9."""
    program = Program(arguments, circumstances)
    return program.wait(timeout) or program.kill()


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
