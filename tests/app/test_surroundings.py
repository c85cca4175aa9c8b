"""Closed streams end in a sentence with code 2, and no code of the folder that a process is started in is run."""

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


def run(*arguments, behind=""):
    """A command of its own with redirections of the shell."""
    line = f"exec {' '.join([*HYPOSE, *arguments])}{behind}"
    return subprocess.run(["sh", "-c", line], capture_output=True, text=True, timeout=300)


@pytest.mark.parametrize("arguments", [("--version",), ("check", "{tiny}")])
def test_a_closed_output_is_one_that_cannot_be_written(tiny, arguments):
    done = run(*(a.format(tiny=tiny) for a in arguments), behind=" >&-")
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("error: The output cannot be written (bad file descriptor);")


def test_closed_errors_and_input_change_no_code(tmp_path):
    assert run("check", str(tmp_path / "none"), behind=" 2>&- <&-").returncode == 2
    assert run("--version", behind=" 2>&- <&-").returncode == 0


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
