"""Sixty environments times the commands: one sentence and code 2, or success; never a traceback, never another code,
never a file outside the folder that was asked for."""

import contextlib
import itertools
import os
import signal
import time
import urllib.request

import pytest

from benchmarks.robustness.circumstances import Circumstances, possible
from benchmarks.robustness.fork_server import ForkServer
from benchmarks.robustness.programs import Ended, Program
from hypose import compute
from hypose.compute.cache_place import cache_folder
from tests import missing
from tests.app.environments import COMMANDS, ENVIRONMENTS, Box, complaint, write_inputs

PATIENCE_S = 600.0
DEAR = ("demo", "subject", "batch")
QUICK_TO_START = ("export", "fuse", "export", "view")
QUICK_ONCE_STARTED = ("silhouettes", "track", "gesture", "check", "synth")
NOTHING_CAN_BE_WRITTEN = (
    *("full: files of 0 bytes", "full: files of 1 bytes", "read-only: where results go by themselves"),
    *("read-only: the results' folder", "read-only: above the results' folder"),
)


def some_cells():
    """Every environment at least once, every command at least five times; the dear ones where they end at once, and
    nothing that needs many kernels where all are compiled anew."""
    cold = [e for e, what in ENVIRONMENTS.items() if what.cold]
    young = [e for e, what in ENVIRONMENTS.items() if what.young and not what.cold]
    later = [e for e, what in ENVIRONMENTS.items() if not what.young and e not in NOTHING_CAN_BE_WRITTEN]
    cells = [(e, ("export", "view")[k % 2]) for k, e in enumerate(cold)]
    cells += zip(young, itertools.cycle(QUICK_TO_START))
    cells += itertools.product(NOTHING_CAN_BE_WRITTEN, DEAR)
    cells += zip(later, itertools.cycle(QUICK_ONCE_STARTED))
    for command in COMMANDS:
        more = (e for e in later if (e, command) not in cells)
        while sum(c == command for _, c in cells) < 5:
            cells.append((next(more), command))
    return cells


ALL = [(e, c) for e in ENVIRONMENTS for c in COMMANDS]
SOME = some_cells()


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    return write_inputs(tmp_path_factory.mktemp("inputs"))


@pytest.fixture(scope="module")
def warm():
    """The folder of the cache, with all that is compiled."""
    compute.warm_up()
    folder = cache_folder()
    if folder is None:
        missing.skip("commands in sixty environments", "a folder for the cache that can be written")
    return folder


@pytest.fixture(scope="module")
def server(warm):
    with ForkServer(warm=True) as server:
        yield server


@pytest.fixture
def box(inputs, warm, tmp_path):
    box = Box.new(tmp_path / "box", inputs, warm)
    yield box
    box.give_back()


def started(server, young, line, circumstances):
    return Program(line, circumstances) if young else server.start(line, circumstances)


def ask_once_and_stop(program, port):
    """What ends a studio: a request that is answered, and then Ctrl-C."""
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until:
        ended = program.wait(0.1)
        if ended is not None:
            return ended
        with contextlib.suppress(OSError), urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=60) as answer:
            assert answer.status == 200
            os.kill(program.pid, signal.SIGINT)
            ended = program.wait(60.0) or program.kill()
            return Ended(0 if ended.code == 130 else ended.code, ended.out, ended.err, ended.seconds)
    return program.kill()


def try_cell(environment, command, box, server):
    what, how = ENVIRONMENTS[environment], COMMANDS[command]
    what.spoil(box)
    circumstances = box.circumstances()
    for thing in (Circumstances(obeys=True), Circumstances(small_disk=circumstances.small_disk)):
        if not possible(thing):
            missing.skip("folders that may not be written, full disks", "a system that lets the tests make them")
    line = how.line(box)
    if command == "view":
        line = [*line[:-1], box.inputs]
    before = box.contents()
    program = started(server, what.young, line, circumstances)
    ended = ask_once_and_stop(program, line[2]) if command == "view" else program.wait(PATIENCE_S) or program.kill()
    assert not (wrong := complaint(how, box, ended, before)), f"{environment} x {command}: {wrong}"


def test_there_are_sixty_environments():
    assert len(ENVIRONMENTS) == 60
    assert {e for e, _ in SOME} == set(ENVIRONMENTS)
    assert all(sum(c == command for _, c in SOME) >= 5 for command in COMMANDS)


@pytest.mark.parametrize(("environment", "command"), SOME)
def test_some(environment, command, box, server):
    try_cell(environment, command, box, server)


@pytest.mark.slow
@pytest.mark.parametrize(("environment", "command"), [cell for cell in ALL if cell not in SOME])
def test_all_others(environment, command, box, server):
    try_cell(environment, command, box, server)
