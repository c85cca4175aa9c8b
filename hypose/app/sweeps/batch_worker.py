"""What a worker of `hypose batch` does with one task. Nothing in it knows of Dask.

A task leaves its figures in task.json, written after everything else: where it lies, the task is done. A worker that
dies leaves the tracker's checkpoint, and the next one goes on from there.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from hypose.app.sweeps.sweep import Task
from hypose.errors import HyposeError, InputError
from hypose.io.files import read_json

Report = Callable[[Mapping[str, Any]], None]
"""Takes {"key", "chunk", "stage", "done", "total"}, at most about once a second."""
_REPORT_S = 1.0


def finished(task: Task) -> dict[str, Any] | None:
    """The figures of a task that is done: same key, same files to write, motion present."""
    try:
        found = read_json(task.record, "the record of a task")
    except InputError:
        return None
    wanted = (task.key, list(task.formats), task.overlay)
    same = isinstance(found, dict) and (found.get("key"), found.get("formats"), found.get("overlay")) == wanted
    return found if same and (task.record.parent / "motion.npz").is_file() else None


def run_task(task: Task, stop: Path, report: Report) -> dict[str, Any]:
    """Figures of the finished task, or its state and why. `stop`: a file whose appearance ends the work in order.

    An input that cannot be used gives state "failed", as a second attempt would; any other exception is the caller's.
    """
    from hypose.app.jobs.job import run_job
    from hypose.app.reports.summary import require_found, summarize
    from hypose.app.sweeps.sweep import job_of

    known = finished(task)
    if known is not None:
        return known
    if stop.exists():
        return {"key": task.key, "state": "stopped", "message": "not begun"}
    seconds: dict[str, float] = {}
    watch = _Watch(task, None, stop, report, seconds)
    try:
        job = job_of(task)
        outcome = run_job(job, watch, seconds)
    except HyposeError as error:
        return {"key": task.key, "state": "failed", "message": str(error)}
    except KeyboardInterrupt:
        return {"key": task.key, "state": "stopped", "message": "stopped; what was tracked is kept"}
    if not outcome.complete:
        kept = f"{len(outcome.motion)} of {task.frames} frames are kept"
        return {"key": task.key, "state": "stopped", "message": kept}
    try:
        require_found(outcome.motion, task.recording, job.results.path)
    except HyposeError as error:
        return {"key": task.key, "state": "failed", "message": str(error)}
    s = summarize(outcome.motion)
    figures = {
        "key": task.key,
        "state": "done",
        "recording": task.recording,
        "set": task.set_name,
        "settings": dict(task.settings),
        "formats": list(task.formats),
        "overlay": task.overlay,
        "frames": s.frames,
        "lost": s.lost,
        "extrapolated": s.extrapolated,
        "doubtful": None if outcome.motion.doubtful is None else int(outcome.motion.doubtful.sum()),
        "verdict": None if outcome.verdict is None else outcome.verdict.word,
        "iou": _known(s.iou),
        "worst_iou": _known(s.worst_iou),
        "sd_mm": _known(s.sd_mm),
        "error_mm": outcome.truth.mean_mm if outcome.truth is not None else None,
        "track_s": seconds.get("track"),
        "notes": list(outcome.notes),
        "message": "",
    }
    job.results.write_json("task.json", figures)
    return figures


def run_chunk(task: Task, chunk: int | None, stop: Path, report: Report) -> dict[str, Any]:
    """Work on one chunk of a task, or (None) on what all chunks need: the subject and the backgrounds. What comes of it
    lies in the task's folder. State "done", or as for `run_task`."""
    from hypose import compute
    from hypose.app.jobs.job import backgrounds_file, chunk_run, open_frames, record_of
    from hypose.app.sweeps.sweep import job_of
    from hypose.io.motions.results import identity
    from hypose.pipeline.kept_findings import keep_backgrounds

    out = {"key": task.key, "state": "done"}
    if finished(task) is not None:
        return out
    if stop.exists():
        return {**out, "state": "stopped", "message": "not begun"}
    watch = _Watch(task, chunk, stop, report, {})
    try:
        job = job_of(task)
        assert job.chunk_s is not None
        record = record_of(job)
        compute.warm_up(load=False)
        with open_frames(job, record) as source:
            run = chunk_run(job, job.options, source, record, job.chunk_s)
            if chunk is None:
                keep_backgrounds(source.backgrounds, backgrounds_file(job), identity(record))
                run.subject(watch)
            elif not run.chunk(chunk, watch).complete:
                return {**out, "state": "stopped", "message": "stopped; what was tracked is kept"}
    except HyposeError as error:
        return {**out, "state": "failed", "message": str(error)}
    except KeyboardInterrupt:
        return {**out, "state": "stopped", "message": "stopped; what was tracked is kept"}
    return out


def _known(value: float) -> float | None:
    return value if value == value else None


class _Watch:
    """A progress that reports once a second, notes how long stages take, and stops the job when the file appears."""

    def __init__(self, task: Task, chunk: int | None, stop: Path, report: Report, seconds: dict[str, float]) -> None:
        self._task, self._chunk, self._stop, self._report, self._seconds = task, chunk, stop, report, seconds
        self._began: dict[str, float] = {}
        self._last = float("-inf")

    def __call__(self, stage: str, done: int, total: int) -> None:
        now = time.monotonic()
        self._seconds[stage] = now - self._began.setdefault(stage, now)
        if now - self._last < _REPORT_S and done < total:
            return
        self._last = now
        self._report({"key": self._task.key, "chunk": self._chunk, "stage": stage, "done": done, "total": total})
        if self._stop.exists():
            raise KeyboardInterrupt
