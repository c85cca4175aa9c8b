"""What all tests share: real recordings when they are there, a seeded source of randomness, and the rules of a run:
nothing is left behind, and what was not tested is said at the end."""

import contextlib
import os
import signal
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from scripts.bootstrap import LAST_TEST_FILE, contained
from tests import missing

# Before anything of hypose is imported, so that a bare `pytest` keeps its caches where `make test` keeps them.
for name, place in contained({}).items():
    if name != "TMPDIR":
        os.environ.setdefault(name, place)

# A script that starts the tests in the background lets them ignore Ctrl-C, and with them every program they start.
signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).resolve().parent.parent
LAST_TEST = Path(LAST_TEST_FILE)
SHARED_DATA = ROOT.parent / "shared" / "data"
HANG_S = 1500.0
"""s after which a test ends that waits for what never comes; none is judged by it, however busy the computer is"""

# Caches, builds and environments of the checkout: made and used by what runs the tests, not by the tests.
OF_THE_TOOLS = {".git", ".venv", ".cache", "__pycache__", "node_modules", "static"}
# A person may add these to the checkout while the tests run; no test has a reason to.
SOURCES = (".py", ".pyi", ".md", ".toml", ".ts", ".mjs", ".html", ".css", ".swp", "~")


@pytest.fixture(scope="session")
def shared_data(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """shared_data(name): path of one of the real recordings, or of the like of it that tests/stand_ins.py makes; where
    there is neither the test is skipped, aloud."""
    made: dict[str, Path] = {}

    def find(name: str) -> Path:
        if (SHARED_DATA / name).exists():
            return SHARED_DATA / name
        from tests import stand_ins

        if name not in stand_ins.MAKERS:
            missing.skip(f"real recordings ({name.split('/')[0]})", "put them into ../shared/data beside the checkout")
        if name not in made:
            folder = tmp_path_factory.mktemp("stand-in") / name
            folder.mkdir(parents=True)
            stand_ins.MAKERS[name](folder)
            made[name] = folder
        return made[name]

    return find


@pytest.fixture
def rng() -> np.random.Generator:
    """A fresh generator with the same seed for every test, so that no test depends on which ran before it."""
    return np.random.default_rng(20240607)


# ---- nothing is left behind ----


def files_below(folder: Path) -> set[str]:
    """Paths, relative to the folder, of all files below it and of empty folders, without those of the tools."""
    found = set()
    for place, folders, names in os.walk(folder):
        inside = os.path.relpath(place, folder)
        if not (folders or names):
            found.add(inside)
        folders[:] = [name for name in folders if name not in OF_THE_TOOLS]
        found |= {os.path.normpath(os.path.join(inside, name)) for name in names if not name.endswith(SOURCES)}
    return found


@pytest.fixture(scope="session", autouse=True)
def home() -> Iterator[Path | None]:
    """The tests' own, empty home, in place of the user's, whose files nobody's tests may touch; where HOME is not set
    it stays so. Caches go where they are told to by variables, which the home does not change."""
    with tempfile.TemporaryDirectory(prefix="hypose-home-") as folder, pytest.MonkeyPatch.context() as patch:
        if "HOME" not in os.environ:
            yield None
            return
        patch.setenv("HOME", folder)
        yield Path(folder)


@pytest.fixture(scope="module", autouse=True)
def nothing_is_left_behind(home: Path | None) -> Iterator[None]:
    """The tests of a module leave no file in the checkout, the home and the working folder, and stay in the folder."""
    start = Path.cwd()

    def look() -> set[str]:
        beside = {start / name for name in os.listdir(start) if name not in OF_THE_TOOLS and not name.endswith(SOURCES)}
        found = {place / name for place in (ROOT, home) if place for name in files_below(place)}
        return {str(path) for path in beside | found}

    before = look()
    yield
    moved = Path.cwd() != start
    os.chdir(start)
    assert not moved, "the tests of this module have changed the working folder"
    new = sorted(look() - before)
    assert not new, f"the tests of this module have left {', '.join(new[:10])}"


# ---- what ran last, should the process be ended ----


def pytest_runtest_logstart(nodeid: str) -> None:
    """For scripts/bootstrap.py, which tells when nobody else can."""
    with contextlib.suppress(OSError):
        LAST_TEST.write_text(nodeid, encoding="utf-8")


# ---- what was not tested ----


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> Iterator[None]:
    """The line before pytest's own last one."""
    yield
    skipped = terminalreporter.stats.get("skipped", [])
    reasons = [report.longrepr[2] for report in skipped if isinstance(report.longrepr, tuple)]
    if line := missing.closing_line(reasons):
        terminalreporter.write_line(line, yellow=True)
