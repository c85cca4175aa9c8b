"""A process that has imported (and, warm, compiled) everything, and forks one that runs a command: what takes seconds
at every start need not be done again, so that hundreds of runs are quick and kills fall into the work.

    python -m benchmarks.robustness.fork_server [warm]

reads jobs as lines of JSON, one at a time.
"""

from __future__ import annotations

import contextlib
import fcntl
import importlib
import json
import os
import runpy
import select
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import cv2

from benchmarks.robustness.circumstances import USUAL, Circumstances
from benchmarks.robustness.programs import Ended
from hypose.compute.warming import warm_up

_PIPE_BYTES = 1 << 20  # what a command may print before it would have to wait for a reader
_MODULES = (
    *("cli", "jobs.job", "jobs.fuse_job", "jobs.gesture_job", "jobs.checking", "jobs.correct"),
    *("reports.report", "reports.result_pictures", "reports.report_parts", "batch", "studio.server"),
)


class ForkServer:
    """Runs one command at a time. warm: its processes find all kernels compiled, else none; environment: of its own."""

    def __init__(self, *, warm: bool, environment: Circumstances = USUAL) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__, *(["warm"] if warm else [])],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            preexec_fn=environment.impose,
        )
        self._running: Forked | None = None
        self._answer()  # once it is ready

    def start(self, arguments: Sequence[str | Path], circumstances: Circumstances = USUAL) -> Forked:
        """Start `hypose ARGUMENTS`; the one before must have ended."""
        job = {"arguments": [os.fspath(a) for a in arguments], "circumstances": circumstances.as_json()}
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(job).encode() + b"\n")
        self._process.stdin.flush()
        self._running = Forked(self, int(json.loads(self._answer())["pid"]))
        return self._running

    def close(self) -> None:
        """End the server, and what it runs."""
        if self._running is not None and self._running.ended is None:
            self._running.kill()
        self._process.communicate()

    def __enter__(self) -> ForkServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _answer(self) -> bytes:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError("The process that starts commands has ended; what it said is above.")
        return line

    def _answered_within(self, seconds: float) -> bool:
        assert self._process.stdout is not None
        return bool(select.select([self._process.stdout], [], [], max(0.0, seconds))[0])


class Forked:
    """A process that runs a command; the same interface as a `Program`."""

    def __init__(self, server: ForkServer, pid: int) -> None:
        self.pid = pid
        self.ended: Ended | None = None
        self._server, self._began = server, time.monotonic()

    def wait(self, seconds: float) -> Ended | None:
        """How it ended, None when it still runs after some seconds."""
        if self.ended is None and self._server._answered_within(seconds):
            answer = json.loads(self._server._answer())
            self.ended = Ended(answer["code"], answer["out"], answer["err"], time.monotonic() - self._began)
        return self.ended

    def kill(self) -> Ended:
        """SIGKILL, and how it ended."""
        if self.ended is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
        ended = self.wait(60.0)
        assert ended is not None
        return ended


# ---- in the server ---------------------------------------------------------------------------------------------


def serve(warm: bool) -> None:
    """Answer the jobs on stdin until it ends: the process's number when it runs, and how it ended."""
    cv2.setNumThreads(1)  # a fork would lose its threads
    for name in _MODULES:
        importlib.import_module(f"hypose.app.{name}")
    if warm:
        warm_up("solver", "scorer", "outlines", "pictures", "monocular")
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    print("ready", file=answers, flush=True)
    for line in sys.stdin.buffer:
        job = json.loads(line)
        pipes = [os.pipe(), os.pipe()]
        for _, write in pipes:
            fcntl.fcntl(write, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        pid = os.fork()
        if not pid:
            _run(job["arguments"], Circumstances.from_json(job["circumstances"]), [write for _, write in pipes])
        for _, write in pipes:
            os.close(write)
        print(json.dumps({"pid": pid}), file=answers, flush=True)
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        out, err = (_drain(read) for read, _ in pipes)
        print(json.dumps({"code": code, "out": out, "err": err}), file=answers, flush=True)


def _run(arguments: list[str], circumstances: Circumstances, printed: list[int]) -> None:
    """The rest of a forked process's life."""
    code = 1
    try:
        for stream, pipe in enumerate(printed, start=1):
            os.dup2(pipe, stream)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
        circumstances.impose()
        sys.argv = ["hypose", *arguments]
        runpy.run_module("hypose.app", run_name="__main__")
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)


def _drain(pipe: int) -> str:
    """What has been printed; a process that a killed one has left behind may hold the other end, so nobody waits."""
    os.set_blocking(pipe, False)
    parts = []
    with contextlib.suppress(BlockingIOError):
        while part := os.read(pipe, 1 << 16):
            parts.append(part)
    os.close(pipe)
    return b"".join(parts).decode(errors="replace")


if __name__ == "__main__":
    serve(sys.argv[1:] == ["warm"])
