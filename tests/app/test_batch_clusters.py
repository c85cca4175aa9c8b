"""`hypose batch` in chunks and on clusters: a running scheduler, SLURM's job script, a worker that dies in a chunk."""

import importlib.util
import os
import signal
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.robustness.programs import workers_of
from benchmarks.robustness.small_recordings import small_scene, write_masks
from hypose.app.sweeps.batch_worker import run_chunk, run_task
from hypose.app.sweeps.cluster import Place, run_batch, slurm_cluster
from hypose.app.sweeps.sweep import is_recording, plan, read_sweep, sweep_of
from hypose.body.ready_bodies import human
from hypose.errors import InputError
from hypose.io.motions.results import save_body
from tests import missing
from tests.conftest import HANG_S, ROOT


@pytest.fixture(scope="module")
def long(tmp_path_factory):
    """130 frames, said to be 5 per second: two chunks of 13 s."""
    folder = write_masks(small_scene(5, 130), tmp_path_factory.mktemp("long") / "walk")
    toml = folder / "recording.toml"
    text = toml.read_text()
    assert "frame_rate = 25" in text
    toml.write_text(
        text.replace("frame_rate = 25.0", "frame_rate = 5.0").replace("frame_rate = 25\n", "frame_rate = 5\n")
    )
    save_body(human(), folder / "subject" / "body.npz")
    return folder


def tasks_of(folder, out, chunk_s):
    sets = ({"name": "s", "subject": str(folder / "subject")},)
    return plan(replace(sweep_of(folder), sets=sets, results=out, formats=("trc",), chunk_s=chunk_s))


def silent(message):
    pass


def test_only_what_is_longer_is_split_and_has_another_key(long, tmp_path):
    (whole,), _ = tasks_of(long, tmp_path, None)
    (same,), _ = tasks_of(long, tmp_path, 60.0)
    (split,), _ = tasks_of(long, tmp_path, 13.0)
    assert (whole.chunks, same.chunks, split.chunks) == (0, 0, 2)
    assert whole.key == same.key != split.key
    _, refused = tasks_of(long, tmp_path, 3.0)
    assert "at least 10 s" in refused[0].reason


def test_a_recording_needs_no_sweep_file(hypose, long, tmp_path):
    assert is_recording(long) and is_recording(long / "recording.toml") and not is_recording(tmp_path)
    code, out, _ = hypose("batch", long, "--chunk", "13", "--dry-run", "--out", tmp_path / "out")
    assert code == 0 and "1 tasks: 0 finished, 1 to do" in out
    sweep = tmp_path / "sweep.toml"
    sweep.write_text(f'recordings = ["{long}"]\nchunk_s = 13')
    assert read_sweep(sweep).chunk_s == 13
    sweep.write_text(f'recordings = ["{long}"]\nchunk_s = "13"')
    with pytest.raises(InputError, match="chunk_s must be a number"):
        read_sweep(sweep)


def test_a_chunk_is_stopped_in_order(long, tmp_path):
    (task,), _ = tasks_of(long, tmp_path, 13.0)
    stop = tmp_path / "stop"
    stop.touch()
    assert run_chunk(task, 0, stop, silent)["state"] == "stopped"
    assert not Path(task.results).exists()


@pytest.mark.slow
def test_a_running_scheduler(long, tmp_path):
    from distributed import LocalCluster

    (task,), _ = tasks_of(long, tmp_path, None)
    task = replace(task, settings={**task.settings, "frames": "0:3"}, frames=3)
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp://", host="127.0.0.1", dashboard_address=None
    ) as cluster:
        figures = run_batch([task], Place(scheduler=cluster.scheduler_address), tmp_path)
    assert figures[task.key]["state"] == "done" and figures[task.key]["frames"] == 3


def slurm_or_skip():
    if importlib.util.find_spec("dask_jobqueue") is None:  # imported here it would leave a file in the home
        missing.skip("batches on SLURM", "pip install 'hypose[slurm]'")


def test_the_job_script_of_slurm():
    slurm_or_skip()
    given = {"queue": "long", "memory": "6GB", "job_script_prologue": ["module load python"]}
    # the scheduler of this test listens on the loopback address only
    with slurm_cluster({**given, "scheduler_options": {"host": "127.0.0.1"}}, {"NUMBA_NUM_THREADS": "1"}) as cluster:
        script = cluster.job_script()
    for line in ("#SBATCH -p long", "#SBATCH -t 04:00:00", "export NUMBA_NUM_THREADS=1", "module load python"):
        assert line in script.splitlines()
    assert "--mem=6G" in script and "--cpus-per-task=1" in script and "--nthreads 1" in script


@pytest.mark.slow
def test_jobs_of_slurm_do_the_work(hypose, tmp_path, monkeypatch):
    slurm_or_skip()
    for name, text in {
        "sbatch": 'for job; do :; done; bash "$job" > /dev/null 2>&1 & echo "Submitted batch job $!"',
        "scancel": 'kill "$@"',
    }.items():  # stand in for SLURM: a job begins at once, on this computer
        (tmp_path / name).write_text(f"#!/bin/bash\n{text}\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    for seed in (0, 1):
        write_masks(small_scene(seed, 6), tmp_path / "study" / f"r{seed}")
    save_body(human(), tmp_path / "subject" / "body.npz")
    (tmp_path / "sweep.toml").write_text(
        'recordings = ["study/*"]\n[settings]\nsubject = "subject"\n[slurm]\n'
        f'memory = "2GB"\nlocal_directory = "{tmp_path}"\nscheduler_options = {{ host = "127.0.0.1" }}\n'
    )
    code, out, err = hypose("batch", tmp_path / "sweep.toml", "--slurm", "--workers", "2", "--threads", "1")
    assert code == 0 and "2 of 2 done" in out, err


def test_the_snakefile_calls_what_exists(hypose):
    text = (ROOT / "examples/cluster/Snakefile").read_text()
    _, said, _ = hypose("track", "--help")
    options = {w for line in text.splitlines() if "--" in line and not line.startswith("#") for w in line.split()}
    wanted = {w.strip("\"'") for w in options if w.startswith("--") or w.startswith('"--')}
    assert wanted >= {"--recipe", "--threads", "--resume"} and all(w in said for w in wanted)


@pytest.mark.slow
def test_a_dead_worker_costs_one_chunk(long, tmp_path):
    (serial,), _ = tasks_of(long, tmp_path / "serial", 13.0)
    assert run_task(serial, tmp_path / "no stop", silent)["state"] == "done"
    expected = (Path(serial.results) / "motion.npz").read_bytes()

    (task,), _ = tasks_of(long, tmp_path / "killed", 13.0)
    chunks = Path(task.results) / "chunks"
    killed, finished = [], set()

    def kill_in_the_second_chunk():
        """Whichever chunk is begun second; the file of the first is watched."""
        deadline, first = time.monotonic() + HANG_S, None
        while time.monotonic() < deadline and not (Path(task.results) / "motion.npz").exists():
            begun = sorted(chunks.glob("0*.npz"), key=lambda p: p.stat().st_mtime_ns)
            if len(begun) == 2 and not killed:
                first = begun[0]
                for pid in workers_of(os.getpid()):
                    os.kill(pid, signal.SIGKILL)
                    killed.append(pid)
            if first is not None and first.exists():
                finished.add(first.stat().st_mtime_ns)
            time.sleep(0.02)

    killer = threading.Thread(target=kill_in_the_second_chunk)
    killer.start()
    figures = run_batch([task], Place(workers=1, threads=1), tmp_path / "killed")
    killer.join()
    assert killed and figures[task.key]["state"] == "done" and figures[task.key]["attempts"] >= 2
    assert len(finished) == 1  # the finished chunk was not touched
    assert (Path(task.results) / "motion.npz").read_bytes() == expected
    assert not chunks.exists()
