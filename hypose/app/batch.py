"""Track many recordings, each with options of its own, by Dask's workers, and write one table of results.

Order of use: `read_table` or `wanted`, `ordered_tasks`, `run_batch`; the command writes the rows.

The key of a task is the hash of everything that decides its motion: options, versions, and the content of its inputs.
Its results are in a folder with that key in its name. The figures are in task.json there, which is written last: a task
with that file is finished. A worker that dies leaves the tracker's checkpoint, from which the next one continues.
"""

from __future__ import annotations

import contextlib
import csv
import hashlib
import os
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hypose.app.commands.console import ProgressCall, Stages, each, ignore
from hypose.app.jobs.job import TrackJob, compile_before, job_of, record_of, run_job, split_names
from hypose.app.options import TrackCommand, recorded_options
from hypose.app.reports.report_parts import require_found, summarize
from hypose.errors import HyposeError, InputError, extra
from hypose.io.files import file_name, read_json, text_lines
from hypose.io.motions.results import provenance_identity, to_json, write_json
from hypose.io.recordings.pose2sim import is_project
from hypose.options import THREAD_VARIABLES, declared
from hypose.pipeline.comparison import compare_with_truth

if TYPE_CHECKING:
    from distributed import Client, Future

COLUMNS = (
    *("recording", "name", "state", "frames", "lost", "extrapolated", "low_confidence", "assessment", "iou"),
    *("worst_iou", "sd_mm", "error_mm", "track_s", "key", "results", "message"),
)
"""Columns of results.csv; empty where unknown."""
RETRIES = 2
"""Number of times a task is tried again after its worker died."""
_TOPIC = "hypose-batch"
_POLL_S = 0.5
_STOP_S = 60.0  # a frame and a checkpoint take far less
_PATIENCE = "300s"  # a worker of a busy machine takes long to start, the first time and again
_COLUMNS_OF_TRACK = {
    d.flag.removeprefix("--").removeprefix("no-"): d
    for d in declared(TrackCommand)
    if d.name not in ("recording", "people", "out", "resume", "formats", "overlay", "report", "yes", "threads")
}
"""Columns of a table of recordings besides `recording` and `name`: options of `hypose track` that decide a motion."""


@dataclass(frozen=True)
class Task:
    """One recording to be tracked with some options.

    command: recording and options.
    name: name of the options, as the table gives it.
    key, recording, frames, results: filled in when the task is planned (`ordered_tasks`): key of the task (the
        module describes it), name of the recording, number of its frames, folder of the results.
    """

    command: TrackCommand
    name: str = "default"
    key: str = ""
    recording: str = ""
    frames: int = 0
    results: Path = Path()

    @property
    def job(self) -> TrackJob:
        """The tracking job, which continues where an earlier one stopped. A truth.npz in the recording's folder is
        compared with the motion.
        """
        recorded_options(self.command.recording)  # a fault in them refuses this task
        job = job_of(replace(self.command, out=self.results, resume=True, report=True))
        truth = job.recording.folder / "truth.npz"
        compared = partial(compare_with_truth, truth, first=job.recording.frames.start)
        return replace(job, truth=compared) if truth.is_file() else job

    @property
    def written(self) -> dict[str, Any]:
        """Options of the files that are written in addition to the motion, as task.json holds them."""
        return {"formats": list(split_names(self.command.formats)), "overlay": self.command.overlay}


# ---- tasks ---------------------------------------------------------------------------------------------------


def read_table(path: Path, **more: Any) -> list[Task]:  # noqa: ANN401 (of different types)
    """Read a CSV table of recordings, one task per row.

    path: table with the columns recording, name and those of `_COLUMNS_OF_TRACK`; paths in it are relative to its
        folder.
    more: options of `TrackCommand` that all rows share.
    Returns: tasks; `ordered_tasks` plans them.
    Raises: InputError names the line and the allowed values.
    """
    # a single carriage return in a line would end the row
    lines = [line.replace("\r", " ") for line in text_lines(path, "a table of recordings")]
    reader = csv.DictReader(lines, restkey="more", restval="")
    unknown = set(reader.fieldnames or ()) - {"recording", "name", *_COLUMNS_OF_TRACK}
    if unknown or "recording" not in (reader.fieldnames or ()):
        wrong = f"there is no column {min(unknown)!r}" if unknown else "the column 'recording' is missing"
        raise InputError(f"{path}: {wrong}; the columns are recording, name, {', '.join(_COLUMNS_OF_TRACK)}.")
    tasks = []
    for row in reader:
        where = f"{path}, line {reader.line_num}"
        if "more" in row or not row["recording"].strip():
            raise InputError(f"{where}: the row must name a recording and have as many cells as the first line.")
        given = {name: text for name in _COLUMNS_OF_TRACK if (text := (row.get(name) or "").strip())}
        try:
            options = {_COLUMNS_OF_TRACK[name].name: _COLUMNS_OF_TRACK[name].parse(v) for name, v in given.items()}
            for name in options.keys() & {"subject", "calibration"}:
                options[name] = type(options[name])(path.parent / Path(options[name]).expanduser())
            recording = path.parent / Path(row["recording"].strip()).expanduser()
            command = _command(recording, more | options)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        tasks.append(Task(command, (row.get("name") or "").strip() or "default"))
    if not tasks:
        raise InputError(f"{path} names no recording; write one in each line below the first.")
    return tasks


def _command(recording: Path, options: Mapping[str, Any]) -> TrackCommand:
    """Join the options that a recording keeps with those of the table or the command line, which come first.

    A recording whose options cannot be read keeps none here; planning its task names the fault, and refuses it alone.
    """
    kept: dict[str, Any] = {}
    with contextlib.suppress(InputError):
        kept = recorded_options(recording)
    return TrackCommand(recording=recording, **{**kept, **options})


def wanted(given: Sequence[Path], **more: Any) -> list[Task]:  # noqa: ANN401 (of different types)
    """List the tasks of a command line: the rows of a table, or the recordings among some paths.

    given: one table (.csv), or paths; those that are no recording are left out, because wildcards name other files too.
    more: options of `TrackCommand` that all tasks share.
    Raises: InputError where there is no recording.
    """
    if given[0].suffix.lower() == ".csv":
        return read_table(given[0], **more)
    folders = [p for p in given if (p / "recording.toml").is_file() or is_project(p)]
    if not folders:
        raise InputError(
            f"{given[0]} is neither a table (.csv) nor the folder of a recording; for all recordings in a folder give "
            f"{given[0]}/*, see docs/batch.md."
        )
    return [Task(_command(p, more)) for p in folders]


def ordered_tasks(
    drafts: Sequence[Task], results: Path, progress: ProgressCall = ignore
) -> tuple[list[Task], list[dict[str, Any]]]:
    """Plan tasks: read their recordings, and compute their keys and folders.

    results: folder of all results.
    Returns: the planned tasks in their order, and a row of the table of results for each task that cannot be tracked.
        Two recordings with the same content and name, tracked with the same options, are one task.
    """
    tasks: dict[str, Task] = {}
    refused: list[dict[str, Any]] = []
    for task in each(progress, "plan", drafts):
        try:
            job = task.job
            name = job.recording.name
            # which recording it is decides where the results lie, so it is a part of the key
            decisive = to_json({"recording": name, **provenance_identity(record_of(job))})
            key = hashlib.sha256(decisive.encode()).hexdigest()[:16]
            folder = results / file_name(name) / f"{file_name(task.name)}-{key[:8]}"
            tasks[key] = replace(task, key=key, recording=name, frames=len(job.recording.frames), results=folder)
        except HyposeError as error:
            who = {"recording": task.command.recording.name, "name": task.name}
            refused.append({**who, "state": "failed", "message": str(error)})
    return list(tasks.values()), refused


def finished_metrics(task: Task) -> dict[str, Any] | None:
    """Read the figures of a finished task.

    Returns: content of task.json; None where the task is not finished: the file or the motion is missing, or the
        file is of another key or other wanted files.
    """
    try:
        found = read_json(task.results / "task.json", "the record of a task")
    except InputError:
        return None
    same = isinstance(found, dict) and {"key": task.key, **task.written}.items() <= found.items()
    return found if same and (task.results / "motion.npz").is_file() else None


# ---- in a worker ---------------------------------------------------------------------------------------------


def dask_setup(worker: object) -> None:
    """Make a worker process ignore Ctrl-C; Dask calls this function in each local worker.

    Why: Ctrl-C reaches all processes of a terminal, and workers must not end before they have saved their work.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _remote(task: Task, stop: Path) -> dict[str, Any]:
    from distributed import get_worker

    worker = get_worker()
    return run_task(task, stop, lambda done: worker.log_event(_TOPIC, {"key": task.key, "done": done}))


def run_task(task: Task, stop: Path, report: Callable[[int], None]) -> dict[str, Any]:
    """Track the recording of a task, and write its figures to task.json.

    task: planned task.
    stop: path of a file; when it appears, the work stops and what was tracked is kept.
    report: receives the number of frames that are done.
    Returns: the figures of the finished task, with state "done"; or state "stopped" or "failed" with a message. An
        input that cannot be used fails, because a second attempt would fail too.
    Raises: other exceptions of tracking.
    """
    if (known := finished_metrics(task)) is not None:
        return known
    stages = Stages(quiet=True)

    def watch(stage: str, done: int, total: int) -> None:
        stages(stage, done, total)
        if stage == "track":
            report(done)
        if stop.exists():
            raise KeyboardInterrupt

    try:
        watch("begin", 0, 1)
        job = task.job
        outcome = run_job(job, watch, stages.seconds)
        if not outcome.complete:
            return _stopped(f"{len(outcome.motion)} of {task.frames} frames are kept")
        require_found(outcome.motion, task.recording, task.results)
    except HyposeError as error:
        return {"state": "failed", "message": str(error)}
    except KeyboardInterrupt:
        return _stopped("stopped; what was tracked is kept")
    s, low_confidence = summarize(outcome.motion), outcome.motion.low_confidence
    options = {n: (getattr(task.command, d.name), d.default) for n, d in _COLUMNS_OF_TRACK.items()}
    figures = {
        **{"key": task.key, "state": "done", "recording": task.recording, "name": task.name},
        "options": {n: str(value) for n, (value, usual) in options.items() if value != usual},
        **task.written,
        **{"frames": s.frames, "lost": s.lost, "extrapolated": s.extrapolated},
        "low_confidence": None if low_confidence is None else int(low_confidence.sum()),
        "assessment": outcome.assessment.word,
        **{n: None if np.isnan(v := getattr(s, n)) else v for n in ("iou", "worst_iou", "sd_mm")},
        "error_mm": None if outcome.truth is None else outcome.truth.mean_mm,
        "track_s": stages.seconds.get("track"),
        "notes": list(outcome.notes),
    }
    write_json(job.results / "task.json", figures)
    return figures


def _stopped(why: str) -> dict[str, Any]:
    return {"state": "stopped", "message": why}


# ---- Dask ----------------------------------------------------------------------------------------------------


def run_batch(
    tasks: Sequence[Task],
    results: Path,
    progress: ProgressCall = ignore,
    *,
    workers: int = 1,
    threads: int | None = None,
    scheduler: str | None = None,
) -> list[dict[str, Any]]:
    """Track the recordings of all tasks by worker processes.

    tasks: planned tasks; finished ones are not tracked again.
    results: folder of all results, which is there.
    workers: number of processes on this computer.
    threads: threads of each worker; None: the cores are shared among the workers.
    scheduler: address of a running Dask scheduler, used instead of own processes.
    Returns: a row of the table for every task, in state "done", "failed" or "stopped"; the column before is True
        where the task had been finished earlier. After a KeyboardInterrupt, tasks that run save their work and are
        "stopped"; a second KeyboardInterrupt returns at once, with checkpoints kept.
    Raises: InputError where the workers cannot be started.
    """
    out = {task.key: {**known, "before": True} for task in tasks if (known := finished_metrics(task)) is not None}
    left = [t for t in tasks if t.key not in out]
    if left:
        stop = results.absolute() / f".stop-{os.getpid()}-{time.time_ns()}"
        if scheduler is None:
            compile_before(progress)  # once, and not by every worker at the same time
        try:
            with _client(workers, threads, scheduler) as client:
                frames: dict[str, int] = {}
                client.subscribe_topic(_TOPIC, lambda event: frames.update({event[1]["key"]: event[1]["done"]}))
                futures = {client.submit(_remote, t, stop, key=f"track-{t.key}", retries=RETRIES): t for t in left}
                _collect(futures, frames, out, progress, stop)
        finally:
            with contextlib.suppress(OSError):
                stop.unlink(missing_ok=True)
    return [
        {
            **out.get(task.key, _stopped("stopped")),
            "recording": task.recording,
            "name": task.name,
            "key": task.key,
            "results": Path(os.path.relpath(task.results, results)).as_posix(),
        }
        for task in tasks
    ]


def _collect(
    futures: Mapping[Future, Task],
    frames: Mapping[str, int],
    out: dict[str, dict[str, Any]],
    progress: ProgressCall,
    stop: Path,
) -> None:
    """Collect the results of running tasks; on Ctrl-C ask the tasks to stop, and wait until they have saved their work.

    futures: tasks by Dask's futures.
    frames: number of tracked frames by the key of a task; others write to it.
    out: receives the figures by key.
    stop: file that asks the tasks to stop.
    """
    from distributed import wait

    pending, total = set(futures), sum(t.frames for t in futures.values())
    deadline = float("inf")
    while pending and time.monotonic() < deadline:
        try:
            with contextlib.suppress(TimeoutError):
                wait(list(pending), timeout=_POLL_S, return_when="FIRST_COMPLETED")
            for future in [f for f in pending if f.done()]:
                out[futures[future].key] = _result(future)
                pending.discard(future)
            counts = (t.frames if f not in pending else frames.get(t.key, 0) for f, t in futures.items())
            progress("track", sum(counts), total)
            progress("recordings", len(futures) - len(pending), len(futures))
        except KeyboardInterrupt:
            if deadline < float("inf"):
                break
            deadline = time.monotonic() + _STOP_S
            stop.touch()


def _result(future: Future) -> dict[str, Any]:
    """Return the figures of a finished future, or state "failed" and why."""
    from distributed.scheduler import KilledWorker

    try:
        return dict(future.result())
    except KilledWorker:
        reason = "its worker died every time (out of memory?); what was tracked is kept, run the batch again"
    except Exception as error:  # of any kind that a task can end with
        reason = f"this should not have happened ({type(error).__name__}: {error}); please report it"
    return {"state": "failed", "message": reason}


require_dask = partial(extra, needed_by="hypose batch", name="cluster", package="dask")


@contextlib.contextmanager
def _client(workers: int, threads: int | None, scheduler: str | None) -> Iterator[Client]:
    """Connect to a running scheduler, or start worker processes that end with the context and listen to this computer
    only.

    workers, threads, scheduler: as for `run_batch`.
    Raises: InputError where they cannot be started or reached.
    """
    config, distributed = require_dask("dask.config"), require_dask("distributed")
    each = threads or max(1, (os.cpu_count() or 1) // workers)
    with contextlib.ExitStack() as stack:
        # by itself Dask makes a folder among the temporary ones, and leaves it there
        scratch = stack.enter_context(tempfile.TemporaryDirectory(prefix="hypose-batch-", ignore_cleanup_errors=True))
        settings = {
            "temporary-directory": scratch,
            "distributed.scheduler.allowed-failures": RETRIES,
            # no task waits at a worker: a death counts against the task that ran, and costs that one only
            "distributed.scheduler.worker-saturation": 1.0,
            "distributed.nanny.pre-spawn-environ": {name: str(each) for name in THREAD_VARIABLES},
            "distributed.comm.timeouts.connect": _PATIENCE,
            "distributed.deploy.lost-worker-timeout": _PATIENCE,
        }
        stack.enter_context(config.set(settings))
        try:
            if scheduler is None:
                scheduler = stack.enter_context(
                    distributed.LocalCluster(
                        n_workers=workers,
                        threads_per_worker=1,  # tracking threads by itself, by numba
                        host="127.0.0.1",
                        dashboard_address=None,
                        memory_limit=0,  # how much is free is known to the system only
                        silence_logs=50,
                        preload=[__name__],  # for dask_setup
                    )
                )
            client = stack.enter_context(distributed.Client(scheduler, timeout="15s"))
        except (RuntimeError, OSError, ValueError) as error:
            text = str(error).rstrip(".").lower()
            raise InputError(
                f"The worker processes cannot be started ({text}); look whether the disk is full and temporary files "
                "(TMPDIR) can be written, and run the same command again."
                if not isinstance(scheduler, str)
                else f"No Dask scheduler answers at {scheduler} ({text}); start one with dask scheduler, and give the "
                "address that it prints, tcp://HOST:8786."
            ) from error
        yield client
