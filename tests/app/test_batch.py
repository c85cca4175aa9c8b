"""`hypose batch`: sweeps read and refused, tasks that know what is finished, workers that are killed."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from benchmarks.robustness.programs import workers_of
from benchmarks.robustness.small_recordings import small_scene, write_masks
from hypose.app.sweeps import cluster
from hypose.app.sweeps.batch_table import COLUMNS, rows_of, write_table
from hypose.app.sweeps.batch_worker import finished, run_task
from hypose.app.sweeps.cluster import Place, run_batch
from hypose.app.sweeps.sweep import Refused, plan, read_sweep
from hypose.errors import InputError
from hypose.io.motions.results import load_motion
from tests.conftest import HANG_S


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Two recordings of 60 and 6 frames; read only."""
    folder = tmp_path_factory.mktemp("study")
    for name, seed, frames in (("long", 1, 60), ("short", 2, 6)):
        write_masks(small_scene(seed, frames), folder / name)
    return folder


def sweep_file(study, out, text=""):
    path = out / "sweep.toml"
    path.write_text(f'recordings = ["{study}/*"]\nresults = "{out}/out"\n{text}')
    return path


# ---- reading and planning --------------------------------------------------------------------------------------


def test_lists_in_a_set_are_combined(study, tmp_path):
    text = (
        '[settings]\nstart = "hull"\n[[set]]\nname = "a"\nseed = [0, 1]\nrecipe = ["sir", "hpf"]\n[[set]]\nname = "b"'
    )
    sweep = read_sweep(sweep_file(study, tmp_path, text))
    assert [s["name"] for s in sweep.sets] == [
        *("a-seed-0-recipe-sir", "a-seed-0-recipe-hpf", "a-seed-1-recipe-sir", "a-seed-1-recipe-hpf", "b")
    ]
    assert all(s["start"] == "hull" for s in sweep.sets)
    tasks, refused = plan(sweep)
    assert len({t.key for t in tasks}) == len(tasks) == 10 and not refused


def test_the_key_follows_settings_and_content(study, tmp_path):
    def key(text="", folder=study):
        return plan(read_sweep(sweep_file(folder, tmp_path, text)))[0][0].key

    first = key()
    assert key() == first
    assert key('[[set]]\nname = "other name"') == first  # a name changes no result
    assert key("[settings]\nseed = 5") != first
    copy = shutil.copytree(study / "long", tmp_path / "study" / "long").parent
    assert key(folder=copy) == first
    masks = sorted((copy / "long").rglob("*.png"))
    shutil.copy(masks[1], masks[0])
    assert key(folder=copy) != first


@pytest.mark.parametrize(
    ("text", "fragment"),
    [
        ('recording = "x"', "did you mean recordings?"),
        ("recordings = []", "there are no recordings"),
        ('recordings = ["nothing/*"]', "no recording matches 'nothing/*'"),
        ('recordings = ["x"]\nretries = -1', "0 to 20"),
        ('recordings = ["x"]\nformats = ["fbx"]', "no export format 'fbx'"),
        ('recordings = ["x"]\n[settings]\nparticles = 5', "the key particles is unknown"),
        ('recordings = ["x"]\n[settings]\nseed = "one"', "seed must be a whole number"),
        ('recordings = ["x"]\n[[set]]\nname = "a"\n[[set]]\nname = "a"', "two sets are named a"),
        ('recordings = ["x"', "is not valid TOML"),
    ],
)
def test_sweeps_that_cannot_be(tmp_path, text, fragment):
    path = tmp_path / "sweep.toml"
    path.write_text(text)
    with pytest.raises(InputError, match="sweep.toml") as caught:
        read_sweep(path)
    assert fragment in str(caught.value)


def test_a_bad_recording_does_not_stop_the_others(study, tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text(f'recordings = ["{study}/short", "nowhere"]')
    tasks, refused = plan(read_sweep(path))
    assert [t.recording for t in tasks] == ["short"]
    assert refused[0].recording == "nowhere" and "does not exist" in refused[0].reason


def test_bad_options_end_in_a_sentence(hypose, study, tmp_path):
    path = sweep_file(study, tmp_path)
    assert hypose("batch", tmp_path / "none.toml")[0] == 2
    code, _, err = hypose("batch", path, "--workers", "0")
    assert code == 2 and "give 1 to 1024" in err
    code, _, err = hypose("batch", path, "--scheduler", "tcp://127.0.0.1:1", "--slurm")
    assert code == 2 and "exclude each other" in err


def test_a_dry_run_counts_and_touches_nothing(hypose, study, tmp_path):
    code, out, _ = hypose("batch", sweep_file(study, tmp_path), "--dry-run")
    assert code == 0 and "2 tasks: 0 finished, 2 to do" in out
    assert not (tmp_path / "out").exists()


def test_a_dry_run_with_recordings_that_cannot_be_tracked_ends_as_the_batch_would(hypose, study, tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text(f'recordings = ["nowhere"]\nresults = "{tmp_path}/out"')
    code, out, _ = hypose("batch", path, "--dry-run")
    assert code == 1 and "1 refused" in out and "nowhere, " in out


# ---- the table -------------------------------------------------------------------------------------------------


def test_the_table_has_every_task_and_no_formula(study, tmp_path):
    tasks, _ = plan(read_sweep(sweep_file(study, tmp_path)))
    figures = {tasks[0].key: {"state": "done", "frames": 60, "iou": 0.9123456789, "sd_mm": 8.0, "attempts": 1}}
    refused = [Refused("=cmd()", "<b>", "it is <i>broken</i>")]
    table, page = write_table(rows_of(tasks, refused, figures, tmp_path), tmp_path)
    with table.open() as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS and len(rows) == 3
    assert rows[0]["iou"] == "0.912346" and rows[0]["recording"] == "long"
    assert rows[2]["recording"] == "'=cmd()"
    assert "<i>broken" not in page.read_text() and "<svg" in page.read_text()


# ---- running ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_task_is_stopped_in_order_and_goes_on(study, tmp_path):
    tasks, _ = plan(read_sweep(sweep_file(study, tmp_path, 'formats = ["trc"]')))
    task, stop = tasks[0], tmp_path / "stop"

    def stop_soon(message):
        if message["stage"] == "track" and message["done"] > 0:
            stop.touch()

    assert run_task(task, stop, stop_soon)["state"] == "stopped"
    assert finished(task) is None
    assert run_task(task, stop, stop_soon)["message"] == "not begun"
    stop.unlink()
    done = run_task(task, stop, lambda message: None)
    assert done["state"] == "done" and done["frames"] == 60
    assert finished(task) == json.loads(task.record.read_text()) == done


@pytest.mark.slow
def test_killed_workers_change_no_byte(study, tmp_path):
    serial = plan(read_sweep(sweep_file(study, tmp_path, "[settings]\nseed = [0, 1]")))[0]
    for task in serial:
        assert run_task(task, tmp_path / "no stop", lambda message: None)["state"] == "done"
    expected = {t.key: (load_bytes(t), t) for t in serial}
    os.rename(tmp_path / "out", tmp_path / "serial")

    tasks, _ = plan(read_sweep(sweep_file(study, tmp_path, "[settings]\nseed = [0, 1]")))
    killed = []

    def kill_one():
        """The first worker process that is at work on a long task and has a checkpoint."""
        deadline = time.monotonic() + HANG_S
        while time.monotonic() < deadline and not killed:
            if any(tmp_path.glob("out/long/*/checkpoint.npz")):
                for pid in workers_of(os.getpid()):
                    os.kill(pid, signal.SIGKILL)
                    killed.append(pid)
                    break
            time.sleep(0.05)

    killer = threading.Thread(target=kill_one)
    killer.start()
    figures = run_batch(tasks, Place(workers=1, threads=1), tmp_path / "out")
    killer.join()
    assert killed
    assert {f["state"] for f in figures.values()} == {"done"}
    assert max(f["attempts"] for f in figures.values()) == 2
    for task in tasks:
        assert load_bytes(task) == expected[task.key][0]
    again = run_batch(tasks, Place(workers=1, threads=1), tmp_path / "out")
    assert all(f["attempts"] == 0 for f in again.values())  # nothing was done twice
    assert np.isfinite(load_motion(f"{tasks[0].results}/motion.npz").joints).all()


@pytest.mark.slow
def test_a_worker_that_the_cluster_gives_up_is_replaced(study, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "_GONE", "0s")  # as if it took too long to start again
    monkeypatch.setattr(cluster, "_KEEP_UP_S", 1.0)
    tasks, _ = plan(read_sweep(sweep_file(study, tmp_path)))
    first = set()

    def kill_first():
        deadline = time.monotonic() + HANG_S
        while time.monotonic() < deadline and not any(tmp_path.glob("out/long/*/checkpoint.npz")):
            time.sleep(0.05)
        for pid in workers_of(os.getpid()):
            os.kill(pid, signal.SIGKILL)
            first.add(pid)

    killer = threading.Thread(target=kill_first)
    killer.start()
    figures = run_batch(tasks, Place(workers=1, threads=1), tmp_path / "out")
    killer.join()
    assert first and {f["state"] for f in figures.values()} == {"done"}


@pytest.mark.slow
def test_ctrl_c_keeps_what_was_tracked(study, tmp_path):
    path = sweep_file(study, tmp_path)
    command = [sys.executable, "-m", "hypose.app", "batch", str(path), "--workers", "1"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, process_group=0)
    deadline = time.monotonic() + HANG_S
    while not any(tmp_path.glob("out/long/*/checkpoint.npz")):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: the workers get it too
    said, _ = process.communicate(timeout=HANG_S)
    assert process.returncode == 130 and "Go on with the same command" in said
    with (tmp_path / "out" / "results.csv").open() as file:
        rows = {r["recording"]: r for r in csv.DictReader(file)}
    assert rows["long"]["state"] == "stopped" and "frames are kept" in rows["long"]["message"]
    assert any(tmp_path.glob("out/long/*/checkpoint.npz"))


def load_bytes(task):
    with open(f"{task.results}/motion.npz", "rb") as file:
        return file.read()
