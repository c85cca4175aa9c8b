"""A sweep on Dask distributed: a cluster of this computer, one that is already running, or one of SLURM.

Dask schedules, watches the workers and gives a dead one's tasks to others; the files carry the rest (what is finished,
how far a task came), so that a batch can be stopped, killed and run again, and on the machines of a lab that share a
folder. Tasks travel as plain values.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hypose import compute
from hypose.app.commands.console import ProgressCall, ignore
from hypose.app.sweeps.batch_worker import Report, finished, run_chunk, run_task
from hypose.app.sweeps.sweep import Task
from hypose.errors import InputError, extra
from hypose.io.files import check_writable

if TYPE_CHECKING:
    from distributed import Client, Future

_TOPIC = "hypose-batch"
_POLL_S = 0.5
_STOP_S = 60.0  # a frame and a checkpoint take far less
_KEEP_UP_S = 10.0
_START, _GONE = "300s", "300s"  # a worker of a busy machine takes long to start, the first time and again
_THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Place:
    """Where tasks run: workers of this computer, each a process with `threads` threads (None: the cores shared among
    them); or the address of a running scheduler; or slurm: keywords of dask_jobqueue.SLURMCluster, one job per
    worker. retries: how many deaths of a worker, and how many accidents, a task may have."""

    workers: int = 1
    threads: int | None = None
    scheduler: str | None = None
    slurm: Mapping[str, Any] | None = None
    retries: int = 2


@dataclass
class _Progress:
    """As the workers tell, of each task's pieces (a chunk, or None): frames done, and how often it was begun."""

    frames: dict[str, dict[int | None, int]] = field(default_factory=dict)
    begun: dict[str, dict[int | None, int]] = field(default_factory=dict)

    def hear(self, event: tuple[float, Mapping[str, Any]]) -> None:
        message = event[1]
        key, piece = str(message["key"]), message["chunk"]
        if message["stage"] == "begin":
            begun = self.begun.setdefault(key, {})
            begun[piece] = begun.get(piece, 0) + 1
        elif message["stage"] == "track":
            self.frames.setdefault(key, {})[piece] = int(message["done"])

    def attempts(self, key: str) -> int:
        """How often a task was begun; of one in chunks, the piece that was begun most often."""
        return max(self.begun.get(key, {}).values(), default=0)

    def tracked(self, task: Task) -> int:
        """Frames of a task that are done; those that two chunks share count once."""
        return min(task.frames, sum(self.frames.get(task.key, {}).values()))


def run_batch(
    tasks: Sequence[Task],
    place: Place,
    results: Path,
    progress: ProgressCall = ignore,
    announce: Any = lambda text: None,
) -> dict[str, dict[str, Any]]:
    """Figures of every task by its key; state "done", "failed" or "stopped", attempts counted.

    announce(text): the address of the dashboard, once. KeyboardInterrupt stops the tasks in order: each keeps what it
    has, and the call returns; a second one ends at once (checkpoints stay).
    """
    out: dict[str, dict[str, Any]] = {}
    for task in tasks:
        known = finished(task)
        if known is not None:
            out[task.key] = {**known, "attempts": 0}
    left = [t for t in tasks if t.key not in out]
    if not left:
        return out
    check_writable(results)
    stop = results / f".stop-{os.getpid()}-{time.time_ns()}"
    heard = _Progress()
    if place.scheduler is None and place.slurm is None:
        progress("compile", 0, 1)
        compute.warm_up(load=False)  # once, and not by every worker at the same time
        progress("compile", 1, 1)
    try:
        with _client(place) as client:
            announce(_dashboard(client))
            client.subscribe_topic(_TOPIC, heard.hear)
            futures = {_submit(client, t, str(stop.absolute()), place.retries): t for t in left}
            _collect(futures, heard, out, progress, stop, partial(_keep_up, client, place))
    finally:
        with contextlib.suppress(OSError):
            stop.unlink(missing_ok=True)
    return out


def _submit(client: Client, task: Task, stop: str, retries: int) -> Future:
    """The task, behind its chunks if it has any, which come behind what they all need."""
    plain, key = task.plain(), task.key
    chunks: list[Future] = []
    if task.chunks:
        common = client.submit(_remote_chunk, plain, None, stop, key=f"subject-{key}", retries=retries)
        chunks = [
            client.submit(_remote_chunk, plain, n, stop, common, key=f"chunk-{key}-{n}", retries=retries)
            for n in range(task.chunks)
        ]
    return client.submit(_remote, plain, stop, *chunks, key=f"track-{key}", retries=retries)


def _remote(task: Mapping[str, Any], stop: str, *before: Mapping[str, Any]) -> dict[str, Any]:
    """Runs in a worker process; `before`: what came of the task's chunks."""
    return _unless_ended(before) or run_task(_made(task), Path(stop), _begin(task, None))


def _remote_chunk(task: Mapping[str, Any], chunk: int | None, stop: str, *before: Mapping[str, Any]) -> dict[str, Any]:
    """Runs in a worker process; `before`: what came of that which all chunks need."""
    return _unless_ended(before) or run_chunk(_made(task), chunk, Path(stop), _begin(task, chunk))


def _made(task: Mapping[str, Any]) -> Task:
    return Task(**{**task, "formats": tuple(task["formats"])})


def _unless_ended(before: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """The first of them that failed or was stopped, with which the task ends as well."""
    return next((dict(b) for b in before if b["state"] != "done"), None)


def _begin(task: Mapping[str, Any], chunk: int | None) -> Report:
    """Tells that a piece of work begins, and returns what tells how it goes on."""
    from distributed import get_worker

    worker = get_worker()
    worker.log_event(_TOPIC, {"key": task["key"], "chunk": chunk, "stage": "begin"})
    return lambda message: worker.log_event(_TOPIC, dict(message))


def dask_setup(worker: object) -> None:
    """Called by Dask in each local worker process: Ctrl-C reaches all processes of a terminal, and must not end workers
    before they have kept what they have."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _collect(
    futures: Mapping[Future, Task],
    heard: _Progress,
    out: dict[str, dict[str, Any]],
    progress: ProgressCall,
    stop: Path,
    keep_up: Callable[[], None],
) -> None:
    """Take results as they come, and keep the workers up; on Ctrl-C ask them to stop and wait for what they keep."""
    from distributed import wait

    pending = set(futures)
    frames = sum(t.frames for t in futures.values())
    deadline, looked = float("inf"), time.monotonic()
    while pending and time.monotonic() < deadline:
        try:
            if time.monotonic() - looked > _KEEP_UP_S:
                keep_up()
                looked = time.monotonic()
            _show(futures, pending, heard, progress, frames)
            with contextlib.suppress(TimeoutError):
                wait(list(pending), timeout=_POLL_S, return_when="FIRST_COMPLETED")
            for future in [f for f in pending if f.done()]:
                task = futures[future]
                out[task.key] = {**_result(future, task), "attempts": max(1, heard.attempts(task.key))}
                pending.discard(future)
        except KeyboardInterrupt:
            if deadline < float("inf"):
                break
            deadline = time.monotonic() + _STOP_S
            stop.touch()
    for future in pending:
        key = futures[future].key
        out[key] = {"key": key, "state": "stopped", "message": "stopped", "attempts": heard.attempts(key)}
    _show(futures, pending, heard, progress, frames)


def _show(
    futures: Mapping[Future, Task], pending: set[Future], heard: _Progress, progress: ProgressCall, frames: int
) -> None:
    complete = {t.key for f, t in futures.items() if f not in pending}
    tracked = sum(t.frames if t.key in complete else heard.tracked(t) for t in futures.values())
    progress("track", tracked, frames)
    progress("recordings", len(complete), len(futures))


def _result(future: Future, task: Task) -> dict[str, Any]:
    from distributed.scheduler import KilledWorker

    error = future.exception()
    if error is None:
        return dict(future.result())
    if isinstance(error, KilledWorker):
        reason = "its worker died every time (out of memory?); what was tracked is kept, run the batch again"
    else:
        reason = f"this should not have happened ({type(error).__name__}: {error}); please report it"
    return {"key": task.key, "state": "failed", "message": reason}


# ---- clusters ------------------------------------------------------------------------------------------------


def _keep_up(client: Client, place: Place) -> None:
    """New workers for those that the cluster has given up, as it does with a job that has run out of time."""
    if client.cluster is not None:  # one that was made here
        client.cluster.scale(place.workers)


def require_dask(slurm: bool) -> tuple[Any, Any]:
    """dask.config and distributed; an InputError names what of them, or of SLURM's part, is not installed."""
    if slurm and importlib.util.find_spec("dask_jobqueue") is None:  # which leaves a file when it is imported
        extra("dask_jobqueue", "--slurm", "slurm", "dask-jobqueue")
    return extra("dask.config", "hypose batch", "cluster", "dask"), extra(
        "distributed", "hypose batch", "cluster", "dask"
    )


@contextlib.contextmanager
def _client(place: Place) -> Iterator[Client]:
    """A client of the place's cluster; a cluster that was made here is closed with it."""
    config, distributed = require_dask(place.slurm is not None)
    threads = place.threads or max(1, (os.cpu_count() or 1) // place.workers)
    environment = {name: str(threads) for name in _THREADS}
    with (
        tempfile.TemporaryDirectory(prefix="hypose-batch-", ignore_cleanup_errors=True) as scratch,
        config.set(
            {
                # by itself Dask makes a folder among the temporary ones, and leaves it there
                "temporary-directory": scratch,
                "distributed.scheduler.allowed-failures": place.retries,
                # no task waits at a worker: a death counts against the task that ran, and costs that one only
                "distributed.scheduler.worker-saturation": 1.0,
                "distributed.nanny.pre-spawn-environ": environment,
                "distributed.comm.timeouts.connect": _START,
                "distributed.deploy.lost-worker-timeout": _GONE,
            }
        ),
    ):
        if place.scheduler is not None:
            try:
                client = distributed.Client(place.scheduler, timeout="15s")
            except (OSError, ValueError) as error:
                raise InputError(
                    f"No Dask scheduler answers at {place.scheduler} ({error}); start one with dask scheduler, and "
                    "give the address that it prints, tcp://HOST:8786."
                ) from None
            with client:
                yield client
            return
        with _cluster(place, environment) as cluster, distributed.Client(cluster) as client:
            yield client


def _cluster(place: Place, environment: Mapping[str, str]) -> Any:
    """Loopback workers of this computer, or jobs of SLURM."""
    if place.slurm is not None:
        cluster = slurm_cluster(place.slurm, environment)
        cluster.scale(place.workers)
        return cluster
    from distributed import LocalCluster

    try:
        return LocalCluster(
            n_workers=place.workers,
            threads_per_worker=1,  # tracking threads by itself, by numba
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            memory_limit=0,  # how much is free is known to the system only
            silence_logs=50,
            preload=[__name__],  # for dask_setup
        )
    except (RuntimeError, OSError) as error:
        raise InputError(
            f"The worker processes cannot be started ({str(error).rstrip('.').lower()}); look whether the disk is full "
            "and temporary files (TMPDIR) can be written, and run the same command again."
        ) from error


def slurm_cluster(keywords: Mapping[str, Any], environment: Mapping[str, str]) -> Any:
    """A dask_jobqueue.SLURMCluster with one worker of one thread per job, and no job yet."""
    import dask.config

    ensure_file = dask.config.ensure_file
    try:
        dask.config.ensure_file = lambda *_, **__: None  # to be imported is enough for it to leave a file in the home
        made = extra("dask_jobqueue", "--slurm", "slurm", "dask-jobqueue").SLURMCluster
    finally:
        dask.config.ensure_file = ensure_file
    exports = [f"export {name}={value}" for name, value in environment.items()]
    options = {"cores": 1, "processes": 1, "memory": "4GB", "walltime": "04:00:00", **keywords}
    options["job_script_prologue"] = [*exports, *options.get("job_script_prologue", [])]
    return made(**options)


def _dashboard(client: Client) -> str:
    """Where to watch: plots with bokeh (extra `dashboard`), plain pages without."""
    link = client.dashboard_link or "none"
    if importlib.util.find_spec("bokeh") is None:
        link = link.removesuffix("status") + "info/main/workers.html"
    return link
