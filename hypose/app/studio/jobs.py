"""Jobs: commands in processes of their own, one at a time; their progress, their end, stopping and going on.

They belong to the served folder, not to a page. A job that is stopped, or whose server ends, keeps what it has
computed, as the command line does, and `resume` goes on, with the next server too.
"""

from __future__ import annotations

import os
import secrets
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from hypose.app.commands.console import JSON_PROGRESS
from hypose.app.studio.answers import NotNow
from hypose.app.studio.catalog import Catalog, NotFound
from hypose.app.studio.job_kinds import Plan, plan, settled
from hypose.app.studio.job_list import read_jobs, write_jobs
from hypose.app.studio.job_record import ENDED, Job, Stage
from hypose.json_text import parse_json
from hypose.pipeline.verdict import EXIT_UNTRUSTED

_KEPT_JOBS, _MOST_WAITING = 100, 20
_CODE_OF_INPUT = 2
"""What a command ends with when its input cannot be used."""
_VERDICT = "Verdict: "
_NOTHING_WRITTEN = "nothing is written"
"""Part of what `check --refine` says when it has found no calibration to recommend."""
_KILL_S = 20.0
"""After this a process that was asked to end is ended."""


class Jobs:
    """All jobs of a server, and those of servers before it; listeners are called with a job whenever it has changed,
    from any thread."""

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog
        self._lock, self._keeping = threading.Condition(), threading.Lock()
        self._jobs = {j.id: j for j in read_jobs(catalog)}
        self._listeners: list[Callable[[Job], None]] = []
        self._closed = False
        self._worker = threading.Thread(target=self._work, name="jobs", daemon=True)
        self._worker.start()

    def listen(self, listener: Callable[[Job], None]) -> Callable[[], None]:
        """Returns the call that ends it."""
        with self._lock:
            self._listeners.append(listener)

        def stop() -> None:
            with self._lock:
                self._listeners.remove(listener)

        return stop

    def every(self) -> list[Job]:
        """The newest first."""
        with self._lock:
            return sorted(self._jobs.values(), key=lambda j: -j.created)

    def find(self, id: str) -> Job:
        """A job by its id; NotFound when there is none."""
        with self._lock:
            if id not in self._jobs:
                raise NotFound(f"There is no job {id[:40]!r}.")
            return self._jobs[id]

    def start(self, kind: str, request: Mapping[str, Any]) -> Job:
        """Queue a job; an InputError when its options cannot be."""
        request = settled(kind, request, self._catalog)
        return self._queue(kind, plan(kind, request, self._catalog), request.get("options") or {})

    def resume(self, id: str) -> Job:
        """Go on with a job that was stopped or failed, as a new job."""
        old = self.find(id)
        if not old.shown()["resumable"]:
            raise NotNow(f"The job {old.plan.title!r} is {old.state} and cannot be resumed; start it again.")
        arguments = old.plan.arguments if "--resume" in old.plan.arguments else (*old.plan.arguments, "--resume")
        return self._queue(old.kind, replace(old.plan, arguments=arguments), old.options)

    def cancel(self, id: str) -> Job:
        """Stop a job with its work kept."""
        job = self.find(id)
        with self._lock:
            if job.state == "queued":
                job.state, job.ended = "cancelled", time.time()
            elif job.state == "running":
                self._stop(job)
            else:
                raise NotNow(f"The job {job.plan.title!r} is {job.state} already.")
        self._changed(job)
        return job

    def needs(self, id: str) -> bool:
        """Whether a job that is not over works on the recording or result of this id."""
        with self._lock:
            return any(id in (j.plan.recording, j.plan.result) for j in self._jobs.values() if j.state not in ENDED)

    def close(self) -> None:
        """Stop what runs, and wait for it."""
        with self._lock:
            self._closed = True
            for job in self._jobs.values():
                if job.state == "queued":
                    job.state = "cancelled"
                elif job.state == "running":
                    self._stop(job)
            self._lock.notify_all()
        self._worker.join(_KILL_S + 5)
        self._keep()

    def _queue(self, kind: str, made: Plan, options: Mapping[str, Any]) -> Job:
        job = Job(secrets.token_hex(6), kind, made, options, time.time())
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

    def _stop(self, job: Job) -> None:
        """Ask the process to end, as Ctrl-C does; the lock is held."""
        if job.process is None or job.stopping:
            job.stopping = True
            return
        job.stopping = True
        job.process.terminate()
        timer = threading.Timer(_KILL_S, job.process.kill)
        timer.daemon = True
        timer.start()

    def _changed(self, job: Job) -> None:
        """A job is in another state: kept on disk, and told."""
        self._keep()
        self._tell(job)

    def _keep(self) -> None:
        with self._keeping:
            write_jobs(self._catalog, self.every())

    def _tell(self, job: Job) -> None:
        with self._lock:
            listeners = list(self._listeners)
        for listener in listeners:
            listener(job)

    # ---- the thread that runs them ----

    def _work(self) -> None:
        while True:
            with self._lock:
                self._lock.wait_for(lambda: self._closed or self._next() is not None)
                job = self._next()
                if job is None:
                    return
                job.state, job.began = "running", time.time()
            self._changed(job)
            self._run(job)
            self._changed(job)

    def _next(self) -> Job | None:
        waiting = [j for j in self._jobs.values() if j.state == "queued"]
        return min(waiting, key=lambda j: j.created, default=None)

    def _run(self, job: Job) -> None:
        try:
            process = subprocess.Popen(
                # no module of the served folder is to be imported, nor settings of a library read there
                [sys.executable, "-P", "-m", "hypose.app", *job.plan.arguments],
                cwd=Path(__file__).parent,
                env={**os.environ, JSON_PROGRESS: "1", "PYTHONUNBUFFERED": "1", "COLUMNS": "160"},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                encoding="utf-8",
                errors="replace",
                start_new_session=True,  # Ctrl-C ends the server, which then ends its jobs in order
            )
        except OSError as error:
            self._end(job, f"The job could not be started ({error.strerror}).", 1)
            return
        with self._lock:
            job.process = process
            if job.stopping:
                process.terminate()
        assert process.stdout is not None and process.stderr is not None
        out = threading.Thread(target=self._read_lines, args=(job, process.stdout), daemon=True)
        out.start()
        problem = self._read_progress(job, process.stderr)
        code = process.wait()
        out.join(5)
        self._end(job, problem, code)

    def _end(self, job: Job, problem: str | None, code: int) -> None:
        with self._lock:
            job.ended, job.process = time.time(), None
            if job.stopping:
                job.state = "cancelled"
            elif code == 0 or (job.kind == "check" and code == 1 and problem is None and job.stages):
                job.state = "done"  # a check that found something wrong has done its work
            elif code == EXIT_UNTRUSTED and problem is None:
                job.state = "done"  # all of it was tracked; what is to be thought of it is for who looks at it
                job.error = next((t for t in reversed(job.lines) if t.startswith(_VERDICT)), "").removeprefix(_VERDICT)
            else:
                job.state = "failed"
                job.error = (
                    problem or _last_word(job) or f"The command ended with code {code}; its last words are below."
                )
                # the same input is the same error again, unless there is something behind it to go on from
                kept = job.plan.folder is not None and (job.plan.folder / "checkpoint.npz").is_file()
                job.hopeless = code == _CODE_OF_INPUT and not kept

    def _read_lines(self, job: Job, stream: Any) -> None:
        for line in stream:
            with self._lock:
                job.lines.append(line.rstrip()[:500])

    def _read_progress(self, job: Job, stream: Any) -> str | None:
        """Progress and notes of a process until it ends; the sentence of its error."""
        problem = None
        for line in stream:
            text = line.rstrip()
            with self._lock:
                if text.startswith('{"stage"') and self._progress(job, text):
                    pass
                elif text.startswith("error: "):
                    problem = text.removeprefix("error: ")[:2000]
                elif text:
                    job.lines.append(text[:500])
            self._tell(job)
        return problem

    @staticmethod
    def _progress(job: Job, text: str) -> bool:
        try:
            value = parse_json(text)
            name, title, done, total = value["stage"], value["title"], int(value["done"]), int(value["total"])
        except (ValueError, KeyError, TypeError):
            return False
        now = time.monotonic()
        stage = job.stages.setdefault(name, Stage(title, now))
        stage.done, stage.total, stage.seconds = done, total, now - stage.began
        return True


def _last_word(job: Job) -> str:
    """Why a refinement wrote nothing: it says so as its result, not as an error."""
    return next((t for t in reversed(job.lines) if job.kind == "refine" and _NOTHING_WRITTEN in t), "")
