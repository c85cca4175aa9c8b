"""What a process is started with (closed streams, little memory, settings of numba, modules beside the data) ends in a
sentence with code 2, and runs no code of the folder that it is started in."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

import hypose
from hypose.io.keypoints import detectors
from hypose.io.videos import video
from tests.app.studio.conftest import serving

HYPOSE = [sys.executable, "-m", "hypose.app"]
EVIL = ("numpy", "multiprocessing", "encodings", "runpy", "json", "click", "hypose", "venv", "pip", "socket")


def run(*arguments, before="", **more):
    """A command of its own behind a line of the shell."""
    line = f"{before}\nexec {' '.join([*HYPOSE, *arguments])}{more.pop('behind', '')}"
    environment = {**os.environ, **more}
    return subprocess.run(["sh", "-c", line], capture_output=True, text=True, env=environment, timeout=300)


@pytest.mark.parametrize("arguments", [("--version",), ("check", "{tiny}")])
def test_a_closed_output_is_one_that_cannot_be_written(tiny, arguments):
    done = run(*(a.format(tiny=tiny) for a in arguments), behind=" >&-")
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("error: The output cannot be written (bad file descriptor);")


def test_closed_errors_and_input_change_no_code(tmp_path):
    assert run("check", str(tmp_path / "none"), behind=" 2>&- <&-").returncode == 2
    assert run("--version", behind=" 2>&- <&-").returncode == 0


@pytest.mark.parametrize(
    ("before", "settings", "named"),
    [
        ("", {"NUMBA_NUM_THREADS": "0"}, "with NUMBA_NUM_THREADS=0;"),
        ("", {"NUMBA_DISABLE_JIT": "1"}, "with NUMBA_DISABLE_JIT=1;"),
        ("ulimit -v 200000", {}, "at most 195 MiB of memory (ulimit -v)"),
        ("ulimit -v 300000", {}, "at most 292 MiB of memory (ulimit -v)"),
        ("ulimit -v 600000", {}, "at most 585 MiB of memory (ulimit -v)"),
    ],
)
@pytest.mark.skipif(sys.platform != "linux", reason="NOT tested: limits of memory; run the tests on Linux")
def test_what_surrounds_a_failure_is_named(tiny, before, settings, named):
    done = run("check", str(tiny), before=before, **settings)
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert done.returncode == 2 and "Traceback" not in done.stderr and len(errors) == 1
    assert named in errors[0] and "should not have happened" not in errors[0] and errors[0].endswith(".")


@pytest.fixture
def evil(tmp_path):
    """A folder whose modules write a file when they are imported."""
    folder = tmp_path / "evil"
    folder.mkdir()
    for name in EVIL:
        (folder / f"{name}.py").write_text(
            f"open({str(tmp_path / 'ran')!r}, 'a').write({name!r})\nraise SystemExit(9)\n"
        )
    yield folder
    assert not (tmp_path / "ran").exists(), (tmp_path / "ran").read_text()


def test_a_job_of_the_studio_runs_no_code_of_the_served_folder(evil):
    with serving(evil) as client:
        job = client.get("/api/jobs", {"kind": "demo", "options": {"seconds": -1}}, status=201)
        while (job := client.get(f"/api/jobs/{job['id']}"))["state"] not in ("done", "failed"):
            pass
    assert "seconds" in job["error"]  # it was hypose that ran


def test_processes_of_the_command_line_import_nothing_of_the_current_folder(evil, tmp_path):
    script = tmp_path / "start" / "program.py"
    script.parent.mkdir()
    script.write_text(
        textwrap.dedent("""
        import multiprocessing, sys
        import hypose.app.__main__

        if __name__ == "__main__":
            child = multiprocessing.get_context("spawn").Process(target=print)
            child.start()
            child.join()
            sys.exit(child.exitcode)
        """)
    )
    assert subprocess.run([sys.executable, str(script)], cwd=evil, timeout=120).returncode == 0


def test_every_process_of_the_package_has_a_safe_path_and_a_folder_of_ours(evil, monkeypatch, tmp_path):
    began = []

    class Began(Exception):
        pass

    def begin(command, *rest, cwd=None, **more):
        assert cwd is not None
        began.append((list(command), Path(cwd)))
        raise Began

    monkeypatch.chdir(evil)
    monkeypatch.setattr(subprocess, "run", begin)
    monkeypatch.setattr(subprocess, "Popen", begin)
    monkeypatch.setattr(video.shutil, "which", lambda name: name)
    with pytest.raises(Began):
        detectors.fetch_models()
    with pytest.raises(Began):
        video.read_sound(Path("clip.mp4"))
    assert len(began) == 2
    for command, place in began:
        assert {"-P", "-I"} & set(command) or command[0] == "ffmpeg" and str(evil / "clip.mp4") in command
        assert place.is_relative_to(Path(hypose.__path__[0]))
