"""Run the studio's jobs: hypose commands in processes of their own, one after the other, with progress, stop and
resume.

Jobs belong to the server, not to a page. A job that is stopped keeps what it has computed, and `resume` continues it
while the server runs; later `hypose track --resume` does. Jobs change in the server's event loop only.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import secrets
import shlex
import sys
import time
from asyncio.subprocess import DEVNULL, PIPE, STDOUT, Process
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from starlette.concurrency import run_in_threadpool

from hypose.app.commands.console import JSON_PROGRESS
from hypose.app.studio.catalog import Catalog, NotFound
from hypose.app.studio.http import Message, NotNow, Topic
from hypose.app.studio.job_kinds import Plan, next_step, plan_job, uncalibrated
from hypose.app.studio.recordings import edit_recording
from hypose.errors import HyposeError
from hypose.io.recordings.recording import load_recording
from hypose.json_text import parse_json
from hypose.pipeline.assessment import EXIT_UNTRUSTED

GO_ON = "go_on"
"""Pseudo kind: the next job on the way from videos to a motion, and then all others."""
_USE = {"what": "use_refined"}
JobState = Literal["queued", "running", "done", "failed", "cancelled"]
ENDED: tuple[JobState, ...] = ("done", "failed", "cancelled")
_KEPT_LINES = 200
_STAGE = '{"stage": '
"""Beginning of a line of progress (`Stages`)."""
_CODE_OF_INPUT = 2
"""Exit code of a command whose input cannot be used."""
_ASSESSMENT = "Assessment: "
_NOTHING_WRITTEN = "nothing is written"
"""Part of the sentence of `check --refine` when it recommends no calibration."""
_KILL_S = 20.0
"""Time after which a process that was asked to end is killed, s."""


@dataclass(eq=False)
class _StudioJob:
    """One job.

    request: request of the page.
    stages: progress by stage, in order, in the form of the page.
    lines: last lines of output.
    error: sentence on why it failed.
    resumable: it has ended early, and the same command with --resume continues.
    """

    id: str
    kind: str
    request: Mapping[str, Any]
    plan: Plan
    created: float = field(default_factory=time.time)
    state: JobState = "queued"
    stages: dict[str, dict[str, Any]] = field(default_factory=dict)
    lines: deque[str] = field(default_factory=lambda: deque(maxlen=_KEPT_LINES))
    error: str | None = None
    began: float | None = None
    ended: float | None = None
    stopping: bool = False
    resumable: bool = False
    process: Process | None = None

    def shown(self) -> dict[str, Any]:
        """Return the job in the form of the page."""
        return {
            "id": self.id,
            "kind": self.kind,
            "title": self.plan.title,
            "command": "hypose " + shlex.join(self.plan.arguments),
            "recording": self.plan.recording,
            "result": self.plan.result,
            "makes": self.plan.makes,
            "state": self.state,
            "options": self.request.get("options") or {},
            "go_on": self.request.get("go_on") is True,
            "stages": list(self.stages.values()),
            "lines": list(self.lines),
            "error": self.error,
            "created": self.created,
            "began": self.began,
            "ended": self.ended,
            "resumable": self.resumable,
        }

    def stop(self) -> None:
        """Remove the job from the queue, or ask its process to end like Ctrl-C."""
        if self.state == "queued":
            self.state, self.ended = "cancelled", time.time()
        if self.state != "running" or self.stopping:
            return
        self.stopping = True
        if self.process is not None:
            self.process.terminate()
            asyncio.get_running_loop().call_later(_KILL_S, self._kill)

    def _kill(self) -> None:
        if self.process is not None:
            self.process.kill()

    def take(self, line: str) -> None:
        """Take a line of the command's output: progress, the error, or text."""
        if line.startswith("error: "):
            self.error = line.removeprefix("error: ")[:2000]
        elif line.startswith(_STAGE):
            with contextlib.suppress(ValueError, TypeError, KeyError):  # another line that begins so
                stage = parse_json(line)["stage"]
                self.stages[stage["name"]] = stage
        elif line:
            self.lines.append(line[:500])

    def end(self, code: int) -> None:
        """Set the final state from the exit code of the process."""

        def said(what: str) -> str:
            return next((t for t in reversed(self.lines) if what in t), "")

        problem, self.error = self.error, None
        self.ended, self.process = time.time(), None
        if self.stopping:
            self.state = "cancelled"
        elif code == 0 or (self.kind == "check" and code == 1 and not problem and self.stages):
            self.state = "done"  # a check that found faults was successful
        elif code == EXIT_UNTRUSTED and not problem:
            self.state = "done"  # everything was tracked; the user judges the result
            self.error = said(_ASSESSMENT).removeprefix(_ASSESSMENT)
        else:
            self.state = "failed"
            # a refinement prints why it wrote nothing as a result, not as an error
            problem = problem or (said(_NOTHING_WRITTEN) if self.kind == "refine" else "")
            self.error = problem or f"The command ended with code {code}; its last words are below."
        # the same input fails again, unless there is a checkpoint to continue from
        kept = self.plan.folder is not None and (self.plan.folder / "checkpoint.npz").is_file()
        hopeless = self.state == "failed" and code == _CODE_OF_INPUT and not kept
        self.resumable = self.plan.resumable and self.state != "done" and not hopeless


class Jobs(Topic):
    """Topic of all jobs of a server; every change of a job is sent to the pages that listen."""

    name = "jobs"

    def __init__(self, catalog: Catalog) -> None:
        super().__init__()
        self._catalog = catalog
        self._jobs: dict[str, _StudioJob] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._turn = asyncio.Lock()  # jobs run one after the other, in their order

    def hello(self) -> Message:
        """Return all jobs."""
        return {"t": "jobs", "jobs": [j.shown() for j in self.every()]}

    def every(self) -> list[_StudioJob]:
        """List all jobs, newest first."""
        return list(self._jobs.values())[::-1]

    def find(self, id: str) -> _StudioJob:
        """Find a job by its id.

        Raises: NotFound where there is none.
        """
        if id not in self._jobs:
            raise NotFound(f"There is no job {id[:40]!r}.")
        return self._jobs[id]

    async def start(self, kind: Any, request: Mapping[str, Any]) -> dict[str, Any]:
        """Add a job to the queue and return it in the form of the page.

        kind: one of `JOB_KINDS`, or GO_ON.
        request: id of the recording or result, and the options of the job.
        Raises: InputError for an unknown kind or invalid options; NotNow where the same job for the same result is
            waiting or running.
        """
        if kind == GO_ON:
            kind, request = await run_in_threadpool(self._next, request, "")
        return self._queue(kind, request, await run_in_threadpool(plan_job, kind, request, self._catalog))

    async def resume(self, id: str) -> dict[str, Any]:
        """Continue a job that was stopped or failed, as a new job, which is returned in the form of the page.

        Raises: NotNow where it cannot be resumed.
        """
        old = self.find(id)
        if not old.resumable:
            raise NotNow(f"The job {old.plan.title!r} is {old.state} and cannot be resumed; start it again.")
        arguments = [a for a in old.plan.arguments if a != "--resume"]
        return self._queue(old.kind, old.request, replace(old.plan, arguments=(*arguments, "--resume")))

    async def cancel(self, id: str) -> dict[str, Any]:
        """Stop a job and return it in the form of the page; its work is kept.

        Raises: NotNow where it has ended.
        """
        job = self.find(id)
        if job.state in ENDED:
            raise NotNow(f"The job {job.plan.title!r} is {job.state} already.")
        job.stop()
        self._tell(job)
        return job.shown()

    def needs(self, id: str) -> bool:
        """Return whether an unfinished job uses the recording or result with this id."""
        return any(id in (j.plan.recording, j.plan.result) for j in self.every() if j.state not in ENDED)

    async def close(self) -> None:
        """Stop all jobs and wait for the running one."""
        while self._tasks:
            for job in self.every():
                job.stop()
            await asyncio.wait(self._tasks)

    def _queue(self, kind: str, request: Mapping[str, Any], made: Plan) -> dict[str, Any]:
        """Add a job to the queue and return it in the form of the page.

        kind, request: what the page requested.
        made: its command.
        Raises: NotNow where the same job for the same result is waiting or running.
        """
        waiting = [j for j in self.every() if j.state not in ENDED]
        if made.result and any(j.plan.result == made.result and j.kind == kind for j in waiting):
            raise NotNow(f"{made.title} is under way already; stop it first, or give the result another name.")
        job = _StudioJob(secrets.token_hex(6), kind, request, made)
        self._jobs[job.id] = job
        task = asyncio.ensure_future(self._run(job))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        self._tell(job)
        return job.shown()

    def _tell(self, job: _StudioJob) -> None:
        """Report a changed job."""
        self.post({"t": "job", "job": job.shown()}, key=job.id)
        if job.state in ENDED:
            self.post({"t": "files"})

    async def _run(self, job: _StudioJob) -> None:
        """Run a job when it is its turn, and then the one that follows on the way to a motion, where all of them were
        requested.
        """
        async with self._turn:
            if job.state != "queued":
                return
            job.state, job.began = "running", time.time()
            self._tell(job)
            await self._process(job)
            self._tell(job)
        useful = job.state == "done" or (job.kind, job.state) == ("sync", "failed")
        if job.request.get("go_on") is True and useful:
            with contextlib.suppress(HyposeError):
                await self.start(*await run_in_threadpool(self._following, job))

    def _following(self, job: _StudioJob) -> tuple[str, Mapping[str, Any]]:
        """Return kind and request of the job after one that has ended; a refined calibration is used from now on."""
        if job.kind == "refine":
            edit_recording(self._catalog.find("recording", str(job.plan.recording)).path, None, _USE, self._catalog)
        return self._next({**job.request, "recording": job.plan.makes or job.plan.recording}, job.kind)

    def _next(self, request: Mapping[str, Any], after: str) -> tuple[str, Mapping[str, Any]]:
        """Return kind and request of the next job of a recording on the way to a motion.

        after: kind of the job that has just ended.
        Raises: NotNow where the user must act first.
        """
        item = self._catalog.find("recording", str(request.get("recording")))
        recording = load_recording(item.path, uncalibrated=uncalibrated(item.path))
        anyway = request.get("anyway") is True
        step = next_step(item.path, recording, after, anyway)
        if step is None:
            raise NotNow(f"{item.path.name} needs you first: see its steps.")
        return step[0], {"recording": item.id, "options": step[1], "go_on": True, "anyway": anyway}

    async def _process(self, job: _StudioJob) -> None:
        """Run the process of a job, take its output line by line, and end the job."""
        try:
            job.process = await asyncio.create_subprocess_exec(
                # neither import modules nor read settings of libraries from the served folder
                *(sys.executable, "-P", "-m", "hypose.app", *job.plan.arguments),
                cwd=Path(__file__).parent,
                env={**os.environ, JSON_PROGRESS: "1", "PYTHONUNBUFFERED": "1", "COLUMNS": "160"},
                stdin=DEVNULL,
                stdout=PIPE,
                stderr=STDOUT,
                start_new_session=True,  # Ctrl-C ends the server, which then stops its jobs itself
                limit=1 << 20,
            )
        except OSError as error:
            job.error = f"The job could not be started ({error.strerror})."
            return job.end(1)
        if job.stopping:  # while the process was starting
            job.process.terminate()
        assert job.process.stdout is not None
        async for line in job.process.stdout:
            job.take(line.decode(errors="replace").rstrip())
            self._tell(job)
        job.end(await job.process.wait())
