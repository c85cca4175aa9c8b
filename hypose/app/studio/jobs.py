"""Run the studio's jobs: hypose commands in processes of their own, one after the other, with progress, stop and
resume.

Jobs belong to the served folder, not to a page. A job that is stopped, or whose server ends, keeps what it has
computed, and `resume` continues it, also with a later server: a file of the folder keeps the list with the pages'
requests. A resumed job is planned again from its request, so that this file cannot start a command that a page could
not.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import shlex
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from hypose.app.commands.console import COUNTED_IN_FRAMES, JSON_PROGRESS
from hypose.app.studio.catalog import Catalog, NotFound
from hypose.app.studio.http import NotNow
from hypose.app.studio.hub import Hub, Message, Topic
from hypose.app.studio.job_kinds import JOB_KINDS, Plan, next_step, plan_job, uncalibrated, with_result_name
from hypose.app.studio.recordings import edit_recording
from hypose.app.studio.view_bundle import json_values
from hypose.errors import HyposeError
from hypose.io.files import read_json, write_text
from hypose.io.recordings.recording import load_recording
from hypose.json_text import parse_json
from hypose.pipeline.assessment import EXIT_UNTRUSTED

NAME = ".studio-jobs.json"
GO_ON = "go_on"
"""Pseudo kind: the next job on the way from videos to a motion, and then all others."""
_USE = {"what": "use_refined"}
JobState = Literal["queued", "running", "done", "failed", "cancelled"]
ENDED: tuple[JobState, ...] = ("done", "failed", "cancelled")
_KEPT_JOBS, _MOST_WAITING, _KEPT_LINES = 100, 20, 200
_CODE_OF_INPUT = 2
"""Exit code of a command whose input cannot be used."""
_ASSESSMENT = "Assessment: "
_NOTHING_WRITTEN = "nothing is written"
"""Part of the sentence of `check --refine` when it recommends no calibration."""
_KILL_S = 20.0
"""Time after which a process that was asked to end is killed, s."""
_INTERRUPTED = "The server ended while this job was under way; what it had computed is kept."


@dataclass
class _StudioJob:
    """One job; changed only under the lock of Jobs.

    request: request of the page.
    stages: progress by stage, in order, in the form of the page.
    lines: last lines of output.
    error: sentence on why it failed.
    hopeless: resuming would fail in the same way.
    starts: when each stage began.
    """

    id: str
    kind: str
    request: Mapping[str, Any]
    plan: Plan
    created: float
    command: str
    state: JobState = "queued"
    stages: dict[str, dict[str, Any]] = field(default_factory=dict)
    lines: deque[str] = field(default_factory=lambda: deque(maxlen=_KEPT_LINES))
    error: str | None = None
    began: float | None = None
    ended: float | None = None
    stopping: bool = False
    hopeless: bool = False
    process: subprocess.Popen[str] | None = None
    starts: dict[str, float] = field(default_factory=dict)

    def shown(self) -> dict[str, Any]:
        """Return the job in the form of the page."""
        return {
            "id": self.id,
            "kind": self.kind,
            "title": self.plan.title,
            "command": self.command,
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
            "resumable": self.plan.resumable and self.state in ("failed", "cancelled") and not self.hopeless,
        }

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> _StudioJob:
        """Restore a job of an earlier server; one that was running counts as failed."""
        shown, interrupted = record["job"], record["job"]["state"] not in ENDED
        if shown["kind"] not in JOB_KINDS:
            raise ValueError(shown["kind"])
        ids, resumable = (shown["recording"], shown["result"]), bool(record["resumable"])
        return cls(
            id=str(shown["id"]),
            kind=shown["kind"],
            request=dict(record["request"]),
            plan=Plan((), str(shown["title"]), *ids, resumable=resumable, makes=shown["makes"]),
            created=float(shown["created"]),
            command=str(shown["command"]),
            state="failed" if interrupted else shown["state"],
            stages={str(s["name"]): dict(s) for s in shown["stages"]},
            lines=deque(map(str, shown["lines"]), _KEPT_LINES),
            error=_INTERRUPTED if interrupted else shown["error"],
            began=shown["began"],
            ended=shown["ended"],
        )


class Jobs(Topic):
    """All jobs of a server and of earlier servers. Changes are posted to the topic from any thread."""

    name = "jobs"

    def __init__(self, catalog: Catalog, hub: Hub) -> None:
        self._catalog, self._hub = catalog, hub
        self._lock, self._keeping = threading.Condition(), threading.Lock()
        self._jobs = {j.id: j for j in read_jobs(catalog)}
        self._closed = False
        self._worker = threading.Thread(target=self._work, name="jobs", daemon=True)
        self._worker.start()

    def hello(self) -> Message:
        """Return all jobs."""
        return {"t": "jobs", "jobs": [j.shown() for j in self.every()]}

    def every(self) -> list[_StudioJob]:
        """List all jobs, newest first."""
        with self._lock:
            return sorted(self._jobs.values(), key=lambda j: -j.created)

    def find(self, id: str) -> _StudioJob:
        """Find a job by its id.

        Raises: NotFound where there is none.
        """
        with self._lock:
            if id not in self._jobs:
                raise NotFound(f"There is no job {id[:40]!r}.")
            return self._jobs[id]

    def start(self, kind: str, request: Mapping[str, Any]) -> _StudioJob:
        """Add a job to the queue and return it.

        kind: one of `JOB_KINDS`, or GO_ON.
        request: id of the recording or result, and the options of the job.
        Raises: InputError for an unknown kind or invalid options; NotNow where the queue is full, or the same job for
            the same result is waiting or running.
        """
        if kind == GO_ON:
            kind, request = self._next(request, "")
        request = with_result_name(kind, request, self._catalog)
        return self._queue(kind, request, plan_job(kind, request, self._catalog))

    def resume(self, id: str) -> _StudioJob:
        """Continue a job that was stopped or failed, as a new job.

        Raises: NotNow where it cannot be resumed.
        """
        old = self.find(id)
        if not old.shown()["resumable"]:
            raise NotNow(f"The job {old.plan.title!r} is {old.state} and cannot be resumed; start it again.")
        made = plan_job(old.kind, old.request, self._catalog)
        return self._queue(old.kind, old.request, replace(made, arguments=(*made.arguments, "--resume")))

    def cancel(self, id: str) -> _StudioJob:
        """Stop a job; its work is kept.

        Raises: NotNow where it has ended.
        """
        job = self.find(id)
        with self._lock:
            if job.state in ENDED:
                raise NotNow(f"The job {job.plan.title!r} is {job.state} already.")
            self._stop(job)
        self._changed(job)
        return job

    def needs(self, id: str) -> bool:
        """Return whether an unfinished job uses the recording or result with this id."""
        with self._lock:
            return any(id in (j.plan.recording, j.plan.result) for j in self._jobs.values() if j.state not in ENDED)

    def close(self) -> None:
        """Stop all jobs and wait for the running one."""
        with self._lock:
            self._closed = True
            for job in self._jobs.values():
                self._stop(job)
            self._lock.notify_all()
        self._worker.join(_KILL_S + 5)
        write_jobs(self._catalog, self.every())

    def _queue(self, kind: str, request: Mapping[str, Any], made: Plan) -> _StudioJob:
        """Add a job to the queue and return it; the oldest ended jobs beyond _KEPT_JOBS are forgotten.

        kind, request: what the page requested.
        made: its command.
        Raises: NotNow where the queue is full, or the same job for the same result is waiting or running.
        """
        job = _StudioJob(secrets.token_hex(6), kind, request, made, time.time(), "hypose " + shlex.join(made.arguments))
        with self._lock:
            waiting = [j for j in self._jobs.values() if j.state not in ENDED]
            if len(waiting) >= _MOST_WAITING:
                raise NotNow(f"{len(waiting)} jobs wait already; let some end first.")
            if made.result and any(j.plan.result == made.result and j.kind == kind for j in waiting):
                raise NotNow(f"{made.title} is under way already; stop it first, or give the result another name.")
            self._jobs[job.id] = job
            for old in sorted(self._jobs.values(), key=lambda j: j.created)[: max(0, len(self._jobs) - _KEPT_JOBS)]:
                if old.state in ENDED:
                    del self._jobs[old.id]
            self._lock.notify_all()
        self._changed(job)
        return job

    def _stop(self, job: _StudioJob) -> None:
        """Remove a job from the queue, or ask its process to end like Ctrl-C; called with the lock held."""
        if job.state == "queued":
            job.state, job.ended = "cancelled", time.time()
        if job.state != "running" or job.stopping:
            return
        job.stopping = True
        if job.process is not None:
            job.process.terminate()
            timer = threading.Timer(_KILL_S, job.process.kill)
            timer.daemon = True
            timer.start()

    def _changed(self, job: _StudioJob) -> None:
        """Save and report a changed job."""
        with self._keeping:
            write_jobs(self._catalog, self.every())
        self._tell(job)
        if job.state in ENDED:
            self._hub.post(self.name, {"t": "files"})

    def _tell(self, job: _StudioJob) -> None:
        self._hub.post(self.name, {"t": "job", "job": job.shown()}, key=job.id)

    # ---- the thread that runs them ----

    def _work(self) -> None:
        """Run the jobs of the queue one after the other, until the server ends; the work of the thread."""
        while True:
            with self._lock:
                self._lock.wait_for(lambda: self._closed or self._waiting_job() is not None)
                job = self._waiting_job()
                if job is None:
                    return
                job.state, job.began = "running", time.time()
            self._changed(job)
            self._run(job)
            self._changed(job)
            self._go_on(job)

    def _go_on(self, job: _StudioJob) -> None:
        """Start the job that follows on the way to a motion, where the page requested all of them."""
        if job.request.get("go_on") is not True or not (
            job.state == "done" or (job.kind, job.state) == ("sync", "failed")
        ):
            return
        with contextlib.suppress(HyposeError):
            if job.kind == "refine":
                edit_recording(self._catalog.find("recording", str(job.plan.recording)).path, None, _USE, self._catalog)
            asked = {**job.request, "recording": job.plan.makes or job.plan.recording}
            self.start(*self._next(asked, job.kind))

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

    def _waiting_job(self) -> _StudioJob | None:
        waiting = [j for j in self._jobs.values() if j.state == "queued"]
        return min(waiting, key=lambda j: j.created, default=None)

    def _run(self, job: _StudioJob) -> None:
        """Run the process of a job, take its output line by line, and end the job."""
        try:
            process = subprocess.Popen(
                # neither import modules nor read settings of libraries from the served folder
                [sys.executable, "-P", "-m", "hypose.app", *job.plan.arguments],
                cwd=Path(__file__).parent,
                env={**os.environ, JSON_PROGRESS: "1", "PYTHONUNBUFFERED": "1", "COLUMNS": "160"},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                encoding="utf-8",
                errors="replace",
                start_new_session=True,  # Ctrl-C ends the server, which then stops its jobs itself
            )
        except OSError as error:
            return self._end(job, f"The job could not be started ({error.strerror}).", 1)
        with self._lock:
            job.process = process
            if job.stopping:
                process.terminate()
        problem = ""
        for line in process.stdout or ():
            text = line.rstrip()
            with self._lock:
                if text.startswith("error: "):
                    problem = text.removeprefix("error: ")[:2000]
                elif text and not (text.startswith('{"stage"') and _progress(job, text)):
                    job.lines.append(text[:500])
            self._tell(job)
        self._end(job, problem, process.wait())

    def _end(self, job: _StudioJob, problem: str, code: int) -> None:
        """Set the final state of a job.

        problem: sentence of the command on why it failed; "" where it gave none.
        code: exit code of the process.
        """

        def said(what: str) -> str:
            return next((t for t in reversed(job.lines) if what in t), "")

        with self._lock:
            job.ended, job.process = time.time(), None
            if job.stopping:
                job.state = "cancelled"
            elif code == 0 or (job.kind == "check" and code == 1 and not problem and job.stages):
                job.state = "done"  # a check that found faults was successful
            elif code == EXIT_UNTRUSTED and not problem:
                job.state = "done"  # everything was tracked; the user judges the result
                job.error = said(_ASSESSMENT).removeprefix(_ASSESSMENT)
            else:
                job.state = "failed"
                # a refinement prints why it wrote nothing as a result, not as an error
                problem = problem or (said(_NOTHING_WRITTEN) if job.kind == "refine" else "")
                job.error = problem or f"The command ended with code {code}; its last words are below."
                # the same input fails again, unless there is a checkpoint to continue from
                kept = job.plan.folder is not None and (job.plan.folder / "checkpoint.npz").is_file()
                job.hopeless = code == _CODE_OF_INPUT and not kept


def _progress(job: _StudioJob, text: str) -> bool:
    """Take a line of progress from a command's output.

    job: whose stages are changed.
    text: the line, JSON with stage, title, done and total.
    Returns: False where it is no such line.
    """
    try:
        value = parse_json(text)
        name, title, done, total = value["stage"], value["title"], int(value["done"]), int(value["total"])
    except (ValueError, KeyError, TypeError):
        return False
    seconds = time.monotonic() - job.starts.setdefault(name, time.monotonic())
    per_s = done / seconds if seconds > 0.2 and done else None
    left_s = (total - done) / per_s if per_s and done < total else None
    unit = "frames" if name in COUNTED_IN_FRAMES else ""
    figures = {"seconds": round(seconds, 2), "per_s": per_s, "left_s": left_s, "unit": unit}
    job.stages[name] = {"name": name, "title": title, "done": done, "total": total, **figures}
    return True


def read_jobs(catalog: Catalog) -> list[_StudioJob]:
    """Load the jobs of earlier servers; unreadable ones are left out."""
    path, found = catalog.root / NAME, list[_StudioJob]()
    if not path.is_file() or not catalog.contains(path):
        return found
    with contextlib.suppress(HyposeError, TypeError):
        for record in read_json(path, "a list of jobs"):
            with contextlib.suppress(KeyError, TypeError, ValueError, AttributeError):
                found.append(_StudioJob.of(record))
    return found


def write_jobs(catalog: Catalog, jobs: Sequence[_StudioJob]) -> None:
    """Save the list of jobs. Nothing is written where the folder is read-only, or no job was ever started."""
    path = catalog.root / NAME
    records = [{"job": j.shown(), "request": j.request, "resumable": j.plan.resumable and not j.hopeless} for j in jobs]
    with contextlib.suppress(OSError, HyposeError):
        if not path.is_symlink() and (records or path.exists()):
            write_text(path, json.dumps(json_values(records)))
