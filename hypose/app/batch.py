"""Many recordings, each with options of its own: tracked by Dask's workers, resumed where they stopped, in one table.

The key of a task is the hash of everything that decides its motion: options, versions, and the content of its inputs.
Its results lie in a folder of that key, with the figures in task.json, written last: where that lies the task is done.
A worker that dies leaves the tracker's checkpoint, from which the next one goes on.
"""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import os
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hypose.app.commands.console import ProgressCall, Stages, each, ignore
from hypose.app.jobs.job import TrackJob, compile_before, job_of, record_of, run_job, split_names
from hypose.app.options import TrackCommand
from hypose.app.reports.summary import require_found, summarize
from hypose.errors import HyposeError, InputError, extra
from hypose.io.file_names import file_name
from hypose.io.files import check_writable, read_json, text_lines, write_text
from hypose.io.motions.results import provenance_identity, to_json
from hypose.io.recordings.pose2sim import is_project
from hypose.options import THREAD_VARIABLES, declared
from hypose.pipeline.comparison import compare_with

if TYPE_CHECKING:
    from distributed import Client, Future

COLUMNS = (
    *("recording", "name", "state", "frames", "lost", "extrapolated", "low_confidence", "assessment", "iou"),
    *("worst_iou", "sd_mm", "error_mm", "track_s", "key", "results", "message"),
)
"""Columns of results.csv; empty where unknown."""
RETRIES = 2
"""How many deaths of its worker a task may have"""
_TOPIC = "hypose-batch"
_POLL_S = 0.5
_STOP_S = 60.0  # a frame and a checkpoint take far less
_PATIENCE = "300s"  # a worker of a busy machine takes long to start, the first time and again
_FILES: Mapping[str, Any] = {"formats": "trc,csv", "overlay": False}
"""Files that are written of each recording by default."""
_COLUMNS_OF_TRACK = {
    d.flag.removeprefix("--").removeprefix("no-"): d
    for d in declared(TrackCommand)
    if d.name not in ("recording", "people", "out", "resume", "formats", "overlay", "report", "yes", "threads")
}
"""Columns of a table of recordings besides `recording` and `name`: options of `hypose track` that decide a motion."""


@dataclass(frozen=True)
class Task:
    """One recording tracked with some options. command: what to track and how; name: of the options. Once planned, key:
    see the module; recording: its name; frames: how many; results: the folder."""

    command: TrackCommand
    name: str = "default"
    key: str = ""
    recording: str = ""
    frames: int = 0
    results: Path = Path()

    @property
    def job(self) -> TrackJob:
        """The tracking job, which goes on where an earlier one stopped."""
        job = job_of(replace(self.command, out=self.results, resume=True, report=True))
        truth = job.recording.folder / "truth.npz"
        return replace(job, truth=compare_with(truth, job.recording.frames.start) if truth.is_file() else None)

    @property
    def written(self) -> dict[str, Any]:
        """Which files are written in addition to the motion."""
        return {"formats": list(split_names(self.command.formats)), "overlay": self.command.overlay}


# ---- the next step --------------------------------------------------------------------------------------


def read_table(path: Path, more: Mapping[str, Any] = _FILES) -> list[Task]:
    """The rows of a CSV table of recordings; more: what else they are tracked with. An InputError names the line and
    the allowed values."""
    reader = csv.DictReader(text_lines(path, "a table of recordings"), restkey="more", restval="")
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
            command = TrackCommand(recording=recording, **{**more, **options})
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        tasks.append(Task(command, (row.get("name") or "").strip() or "default"))
    if not tasks:
        raise InputError(f"{path} names no recording; write one in each line below the first.")
    return tasks


def wanted(given: Sequence[Path], more: Mapping[str, Any] = _FILES) -> list[Task]:
    """The rows of a table; or of paths every recording, as wildcards name other files as well, with the usual
    options."""
    if given[0].suffix.lower() == ".csv":
        return read_table(given[0], more)
    folders = [p for p in given if (p / "recording.toml").is_file() or is_project(p)]
    if not folders:
        raise InputError(
            f"{given[0]} is neither a table (.csv) nor the folder of a recording; for all recordings in a folder give "
            f"{given[0]}/*, see docs/batch.md."
        )
    return [Task(TrackCommand(recording=p, **more)) for p in folders]


def ordered_tasks(
    drafts: Sequence[Task], results: Path, progress: ProgressCall = ignore
) -> tuple[list[Task], list[dict[str, Any]]]:
    """The tasks in their order, and a row of the table for each that cannot be one. Two recordings with the same
    content and name, tracked with the same options, are one task."""
    tasks: dict[str, Task] = {}
    refused: list[dict[str, Any]] = []
    for task in each(progress, "plan", drafts):
        try:
            job = task.job
            name = job.recording.name
            # which recording it is decides where the results lie, so it is a part of the key
            who = to_json({"recording": name, **provenance_identity(record_of(job))})
            key = hashlib.sha256(who.encode()).hexdigest()[:16]
            folder = results / file_name(name) / f"{file_name(task.name)}-{key[:8]}"
            tasks[key] = replace(task, key=key, recording=name, frames=len(job.recording.frames), results=folder)
        except HyposeError as error:
            refused.append(
                {"recording": task.command.recording.name, "name": task.name, "state": "failed", "message": str(error)}
            )
    return list(tasks.values()), refused


def finished_metrics(task: Task) -> dict[str, Any] | None:
    """The figures of a task that is done: same key, same files to write, motion present."""
    try:
        found = read_json(task.results / "task.json", "the record of a task")
    except InputError:
        return None
    same = isinstance(found, dict) and {"key": task.key, **task.written}.items() <= found.items()
    return found if same and (task.results / "motion.npz").is_file() else None


def write_table(rows: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """results.csv, whole or not at all."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n", extrasaction="ignore")
    writer.writeheader()
    writer.writerows({name: _cell(row.get(name)) for name in COLUMNS} for row in rows)
    write_text(folder / "results.csv", text.getvalue())


def _cell(value: Any) -> str:
    text = "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
    # a spreadsheet would run a text that begins so
    return f"'{text}" if isinstance(value, str) and text[:1] in ("=", "+", "@", "\t") else text


# ---- in a worker ---------------------------------------------------------------------------------------------


def dask_setup(worker: object) -> None:
    """Called by Dask in each local worker process: Ctrl-C reaches all processes of a terminal, and must not end workers
    before they have kept what they have."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _remote(task: Task, stop: Path) -> dict[str, Any]:
    from distributed import get_worker

    worker = get_worker()
    return run_task(task, stop, lambda done: worker.log_event(_TOPIC, {"key": task.key, "done": done}))


def run_task(task: Task, stop: Path, report: Callable[[int], None]) -> dict[str, Any]:
    """Figures of the finished task, or its state and why. `stop`: a file whose appearance ends the work in order;
    report: takes how many frames are done.

    An input that cannot be used gives state "failed", as a second attempt would; any other exception is the caller's.
    """
    known = finished_metrics(task)
    if known is not None:
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
    figures = {
        "key": task.key,
        "state": "done",
        "recording": task.recording,
        "name": task.name,
        "options": {
            n: str(v) for n, d in _COLUMNS_OF_TRACK.items() if (v := getattr(task.command, d.name)) != d.default
        },
        **task.written,
        "frames": s.frames,
        "lost": s.lost,
        "extrapolated": s.extrapolated,
        "low_confidence": None if low_confidence is None else int(low_confidence.sum()),
        "assessment": None if outcome.assessment is None else outcome.assessment.word,
        **{n: v if v == v else None for n, v in (("iou", s.iou), ("worst_iou", s.worst_iou), ("sd_mm", s.sd_mm))},
        "error_mm": None if outcome.truth is None else outcome.truth.mean_mm,
        "track_s": stages.seconds.get("track"),
        "notes": list(outcome.notes),
    }
    job.results.write_json("task.json", figures)
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
    """A row of the table for every task, in state "done", "failed" or "stopped"; before: it had been done already.

    workers: processes of this computer, each with so many threads (None: the cores shared among them); scheduler: the
    address of a running one, instead.

    KeyboardInterrupt stops the tasks in order: each keeps what it has, and the call returns; a second one ends at once
    (checkpoints stay)."""
    out = {task.key: {**known, "before": True} for task in tasks if (known := finished_metrics(task)) is not None}
    left = [t for t in tasks if t.key not in out]
    if left:
        check_writable(results)
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
    rows = []
    for task in tasks:
        where = Path(os.path.relpath(task.results, results)).as_posix()
        who = {"recording": task.recording, "name": task.name, "key": task.key, "results": where}
        rows.append({**out.get(task.key, _stopped("stopped")), **who})
    return rows


def _collect(
    futures: Mapping[Future, Task],
    frames: Mapping[str, int],
    out: dict[str, dict[str, Any]],
    progress: ProgressCall,
    stop: Path,
) -> None:
    """Take results as they come; on Ctrl-C ask the tasks to stop and wait for what they keep."""
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
    from distributed.scheduler import KilledWorker

    error = future.exception()
    if error is None:
        return dict(future.result())
    if isinstance(error, KilledWorker):
        reason = "its worker died every time (out of memory?); what was tracked is kept, run the batch again"
    else:
        reason = f"this should not have happened ({type(error).__name__}: {error}); please report it"
    return {"state": "failed", "message": reason}


require_dask = partial(extra, needed_by="hypose batch", name="cluster", package="dask")


@contextlib.contextmanager
def _client(workers: int, threads: int | None, scheduler: str | None) -> Iterator[Client]:
    """A client of the running scheduler, or of worker processes that end with it and listen to this computer only."""
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
