"""Processes beside live tracking: Ctrl-C is not theirs, and they end with whoever started them."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hypose.pipeline.live.processes import deaf_to_ctrl_c
from tests.conftest import HANG_S

SLEEPS = "import time; print('here', flush=True); time.sleep(60)"
PARENT = """
import threading, time
from hypose.pipeline.live.background_work import BackgroundWork

if __name__ == "__main__":
    work = BackgroundWork()
    threading.Thread(target=work._elsewhere, args=(time.sleep, 60), daemon=True).start()
    while work._process is None:
        time.sleep(0.01)
    print(work._process.pid, flush=True)
    time.sleep(60)
"""


@pytest.fixture
def hears_ctrl_c():
    """Whoever begins the tests in the background of a shell makes them deaf, which their children would inherit."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.skipif(sys.platform == "win32", reason="NOT tested: signals of a console; run it on Linux")
@pytest.mark.parametrize("deaf", [True, False])
@pytest.mark.usefixtures("hears_ctrl_c")
def test_a_process_that_was_started_does_not_hear_ctrl_c_from_its_first_moment_on(deaf):
    def begun():
        return subprocess.Popen([sys.executable, "-c", SLEEPS], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)

    if deaf:
        with deaf_to_ctrl_c():
            process = begun()
    else:
        process = begun()
    with process:
        try:
            assert process.stdout is not None and process.stdout.readline() == b"here\n"
            process.send_signal(signal.SIGINT)
            if deaf:  # else it ends by itself
                time.sleep(0.2)
                process.terminate()
            process.wait(HANG_S)
        finally:
            process.kill()
    assert (process.returncode == -signal.SIGTERM) == deaf


def ended(number):
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="NOT tested: processes without /proc; run it on Linux")
def test_what_was_started_does_not_outlive_who_was_killed(tmp_path):
    (tmp_path / "parent.py").write_text(PARENT)
    with subprocess.Popen([sys.executable, str(tmp_path / "parent.py")], stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            child = int(process.stdout.readline())
            assert not ended(child)
        finally:
            process.kill()
    end = time.monotonic() + HANG_S
    while not ended(child):
        assert time.monotonic() < end
        time.sleep(0.05)
