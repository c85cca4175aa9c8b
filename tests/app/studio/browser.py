"""What the browser tests need of the machine, and how a path of web/tests is gone."""

import importlib.util
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest

from tests import missing

ROOT = Path(__file__).resolve().parents[3]
WEB = ROOT / "web"
PATHS = sorted((WEB / "tests").glob("*.path.mjs"))


def build():
    """hatch_build.py as a module."""
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def chromium():
    """The browser; a skip that says so when there is none."""
    for path in ("/usr/lib/chromium/chromium", shutil.which("chromium"), shutil.which("google-chrome")):
        if path and Path(path).exists():
            return path
    missing.skip("the studio's page", "install Chromium (Debian, Ubuntu: apt install chromium)")


def go(path, address, folder, pictures, timeout=1800):
    """Go a path of web/tests; what the browser said is in the failure. Its pictures are kept in the folder that the
    variable HYPOSE_PICTURES names, where there is one."""
    program, builder = chromium(), build()
    if not (WEB / "node_modules" / "playwright-core").is_dir():
        missing.skip("the studio's page", "python hatch_build.py --tests, with a network")
    node, _ = builder.find_node()
    environment = {**os.environ, "STUDIO": address, "FOLDER": str(folder), "CHROMIUM": program}
    pictures = environment["PICTURES"] = os.environ.get("HYPOSE_PICTURES", str(pictures))
    with tempfile.TemporaryDirectory() as home:  # where Chromium keeps what it keeps, crash reports for one
        environment["HOME"] = home
        command = [node, str(path)]
        done = subprocess.run(command, cwd=WEB, env=environment, capture_output=True, text=True, timeout=timeout)
    if done.returncode:
        pytest.fail(f"{path.name} (pictures in {pictures}):\n{done.stdout[-4000:]}\n{done.stderr[-6000:]}", False)
    return done.stdout
