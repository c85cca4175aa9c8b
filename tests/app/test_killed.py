"""What survives kill -9. Slow: real processes."""

import os
import subprocess
import sys
import time

import pytest

from hypose.io.motions.results import load_motion
from tests.app.conftest import write_tiny
from tests.conftest import HANG_S

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def longer(tmp_path_factory):
    """60 frames: checkpoints are written every 25."""
    return write_tiny(tmp_path_factory.mktemp("longer") / "walk", 2.4)


def command(recording, out, *more):
    return [
        *(sys.executable, "-m", "hypose.app", "track", str(recording), "--out", str(out)),
        *("--no-overlay", "--formats", "trc", *more),
    ]


def run(*arguments):
    environment = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    done = subprocess.run(command(*arguments), capture_output=True, text=True, env=environment, timeout=HANG_S)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def begun(longer, out):
    """A run that has written a checkpoint."""
    process = subprocess.Popen(command(longer, out), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    deadline = time.monotonic() + HANG_S
    while not (out / "checkpoint.npz").exists():
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.02)
    return process


def test_a_killed_run_resumes_to_the_same_bytes(longer, tmp_path):
    run(longer, tmp_path / "whole")
    with begun(longer, tmp_path / "killed") as process:
        process.kill()
    assert not (tmp_path / "killed" / "motion.npz").exists()
    said = run(longer, tmp_path / "killed", "--resume")
    assert "Track: 25/60" in said or "Track: 50/60" in said  # it went on, it did not start again
    whole, killed = (tmp_path / name / "motion.npz" for name in ("whole", "killed"))
    assert len(load_motion(whole)) == 60 and killed.read_bytes() == whole.read_bytes()


def test_sigterm_is_an_orderly_stop(longer, tmp_path):
    process = begun(longer, tmp_path)
    process.terminate()
    out, _ = process.communicate(timeout=HANG_S)
    assert process.returncode == 130 and "Kept: " in out and "--resume" in out
    assert 25 <= len(load_motion(tmp_path / "motion.npz")) < 60
