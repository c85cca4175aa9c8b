"""`hypose batch`: tables read and refused, tasks that know what is finished, workers that are killed."""

import csv
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.robustness.programs import workers_of
from benchmarks.robustness.small_recordings import small_scene, write_masks
from hypose.app.batch import ordered_tasks, read_table, run_batch, run_task
from hypose.app.options import TrackCommand
from hypose.app.reports.report_parts import write_csv
from hypose.errors import InputError
from hypose.io.motions.results import load_motion
from tests.conftest import HANG_S


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Two recordings of 200 and 6 frames; read only."""
    folder = tmp_path_factory.mktemp("study")
    for name, seed, frames in (("long", 1, 200), ("short", 2, 6)):
        write_masks(small_scene(seed, frames), folder / name)
    return folder


def table(study, out, columns="", *rows):
    """A table with the columns in addition to `recording`; rows: what is in them, of every recording."""
    path = out / "study.csv"
    lines = [f"{study / name}{more and ',' + more}" for name in ("long", "short") for more in (rows or ("",))]
    path.write_text("\n".join([f"recording{columns and ',' + columns}", *lines, ""]))
    return path


def tasks_of(path, out):
    tasks, refused = ordered_tasks(read_table(path, formats="trc,csv", overlay=False), out)
    assert not refused
    return tasks


# ---- reading and planning --------------------------------------------------------------------------------------


def test_a_row_is_a_recording_with_options(study, tmp_path):
    path = table(study, tmp_path, "name,seed,refine,height,subject", "a,3,yes,1.8,bodies/anna", ",,,,")
    given, usual = read_table(path, overlay=False)[:2]
    assert given.name == "a" and usual.name == "default"
    assert usual.command == TrackCommand(recording=study / "long", overlay=False)
    wanted = {"seed": 3, "refine": True, "height": 1.8, "subject": str(tmp_path / "bodies/anna")}
    assert given.command == replace(usual.command, **wanted)


def test_the_key_follows_options_and_content(study, tmp_path):
    def key(columns="", row="", folder=study):
        return tasks_of(table(folder, tmp_path, columns, row), tmp_path / "out")[0].key

    first = key()
    assert key() == first == key("name", "other name")  # a name changes no result
    assert key("seed", "5") != first
    copy = shutil.copytree(study, tmp_path / "study")
    assert key(folder=copy) == first
    masks = sorted((copy / "long").rglob("*.png"))
    shutil.copy(masks[1], masks[0])
    assert key(folder=copy) != first


@pytest.mark.parametrize(
    ("text", "fragment"),
    [
        ("seed\n1\n", "the column 'recording' is missing"),
        ("recording,particles\nx,5\n", "there is no column 'particles'"),
        ("recording,seed\nx,one\n", "line 2: seed cannot be 'one'"),
        ("recording,seed\nx,-1\n", "line 2: seed -1 is not possible; give 0 or more"),
        ("recording,recipe\nx,magic\n", "line 2: recipe magic is not possible"),
        ("recording,seed\nx,1,2\n", "line 2"),
        ("recording\n", "names no recording"),
        ("", "is empty"),
    ],
)
def test_tables_that_cannot_be(tmp_path, text, fragment):
    path = tmp_path / "study.csv"
    path.write_text(text)
    with pytest.raises(InputError, match="study.csv") as caught:
        read_table(path)
    assert fragment in str(caught.value)


def test_a_bad_recording_does_not_stop_the_others(hypose, study, tmp_path):
    path = tmp_path / "study.csv"
    path.write_text(f"recording\n{study}/short\nnowhere\n")
    tasks, refused = ordered_tasks(read_table(path), tmp_path / "out")
    assert [t.recording for t in tasks] == ["short"]
    assert refused[0]["recording"] == "nowhere" and "does not exist" in refused[0]["message"]
    code, out, err = hypose("batch", path, "--dry-run")  # ends as the batch would
    assert code == 1 and "1 refused" in out and "nowhere, default: " in err


def test_a_recording_keeps_options_and_wrong_ones_refuse_it_alone(study, tmp_path):
    for name, line in (("right", "seed = 7"), ("wrong", "seed = -1")):
        toml = shutil.copytree(study / "short", tmp_path / name) / "recording.toml"
        toml.write_text(toml.read_text() + f"\n[track]\n{line}\n")
    path = tmp_path / "study.csv"
    path.write_text("recording,seed\nright,\nright,3\nwrong,\n")
    tasks, refused = ordered_tasks(read_table(path), tmp_path / "out")
    assert sorted(t.command.seed for t in tasks) == [3, 7]  # the table comes first
    (one,) = refused
    assert one["recording"] == "wrong" and "wrong/recording.toml, track: seed" in one["message"]


@pytest.mark.parametrize("given", ["table", "folders"])
def test_a_dry_run_counts_and_touches_nothing(hypose, study, tmp_path, given):
    paths = [table(study, tmp_path)] if given == "table" else sorted(study.iterdir())
    code, out, _ = hypose("batch", *paths, "--dry-run", "--out", tmp_path / "out")
    assert code == 0 and "2 tasks: 0 finished, 2 to do" in out
    assert not (tmp_path / "out").exists()


def test_a_table_has_no_formula_and_empty_cells_for_the_unknown(tmp_path):
    rows = [("long", 60, 0.912345678, None), ("=cmd()", 0, float("nan"), "broken")]
    write_csv(tmp_path / "results.csv", ["recording", "frames", "iou", "message"], rows)
    lines = (tmp_path / "results.csv").read_text().splitlines()
    assert lines == ["recording,frames,iou,message", "long,60,0.91234568,", "'=cmd(),0,,broken"]


# ---- running ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_killed_workers_change_no_byte(study, tmp_path):
    path = table(study, tmp_path)
    expected = {}
    for task in tasks_of(path, tmp_path / "serial"):
        assert run_task(task, tmp_path / "no stop", lambda done: None)["state"] == "done"
        expected[task.key] = (task.results / "motion.npz").read_bytes()

    tasks = tasks_of(path, tmp_path / "out")
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
    rows = run_batch(tasks, tmp_path / "out", threads=1)
    killer.join()
    assert killed
    assert {r["state"] for r in rows} == {"done"}
    for task in tasks:
        assert (task.results / "motion.npz").read_bytes() == expected[task.key]
    again = run_batch(tasks, tmp_path / "out", threads=1)
    assert all(r["before"] for r in again)  # nothing was done twice
    assert np.isfinite(load_motion(tasks[0].results / "motion.npz").joints).all()


@pytest.mark.slow
def test_a_running_scheduler(study, tmp_path):
    from distributed import LocalCluster

    task = tasks_of(table(study, tmp_path), tmp_path / "out")[1]
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp://", host="127.0.0.1", dashboard_address=None
    ) as cluster:
        (row,) = run_batch([task], tmp_path / "out", scheduler=cluster.scheduler_address)
    assert row["state"] == "done" and row["frames"] == 6


@pytest.mark.slow
def test_ctrl_c_keeps_what_was_tracked(study, tmp_path):
    command = [sys.executable, "-m", "hypose.app", "batch", str(table(study, tmp_path)), "--workers", "1"]
    command += ["--out", str(tmp_path / "out")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, process_group=0)
    deadline, written = time.monotonic() + HANG_S, set[int]()
    while len(written) < 2:  # the first is of the start, the next of tracked frames
        assert process.poll() is None and time.monotonic() < deadline
        written |= {path.stat().st_mtime_ns for path in tmp_path.glob("out/long/*/checkpoint.npz")}
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: the workers get it too
    said, _ = process.communicate(timeout=HANG_S)
    assert process.returncode == 130 and "Go on with the same command" in said
    with (tmp_path / "out" / "results.csv").open() as file:
        rows = {r["recording"]: r for r in csv.DictReader(file)}
    assert rows["long"]["state"] == "stopped" and "frames are kept" in rows["long"]["message"]
    assert any(tmp_path.glob("out/long/*/checkpoint.npz"))
