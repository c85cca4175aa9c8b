"""The command line run as real processes: to the end, under limits, or killed on the way."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

HYPOSE = (sys.executable, "-m", "hypose.app.cli")
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


def kill_after(arguments: Sequence[str | Path], seconds: float, seen: Callable[[], None] | None = None) -> bool:
    """Start `hypose ARGUMENTS` and send SIGKILL to it after some seconds; False when it ended before. seen() is called
    often while it runs."""
    process = subprocess.Popen(
        [*HYPOSE, *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline and process.poll() is None:
        if seen is not None:
            seen()
        time.sleep(min(0.05, max(0.0, deadline - time.monotonic())))
    running = process.poll() is None
    process.send_signal(signal.SIGKILL)
    process.wait()
    return running


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
