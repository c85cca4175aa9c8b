"""What gestures set off on this computer: commands."""

import sys

import pytest

from hypose.app.jobs import gesture_job as actions
from hypose.app.jobs.gesture_job import Watched
from hypose.errors import InputError
from hypose.gestures.events import Event
from hypose.gestures.localise import Localisation
from tests.conftest import HANG_S

NAMES = ["tee", "ok"]


def frame(*scores, events=()):
    found = [Localisation(k, 1.0, 2.0, s, None) for k, s in enumerate(scores, 1)]
    return Watched(0.5, found, [Event(kind, g, 0.5, 1.0, 2.0, None, 9.0) for kind, g in events])


def run(tmp_path, words, *frames):
    """Lines that a command wrote which appends its arguments to a file."""
    script, log = tmp_path / "note.py", tmp_path / "log.txt"
    script.write_text(f"import sys; open({str(log)!r}, 'a').write(' '.join(sys.argv[1:]) + '\\n')")
    out = actions.CommandOut(f"'{sys.executable}' '{script}' {words}", NAMES)
    for f in frames:
        out.send(f)
        for p in out._running:
            assert p.wait(HANG_S) == 0
    out.close()
    return log.read_text().split("\n")[:-1]


def test_a_command_runs_at_starts_and_at_ends_when_it_names_the_event(tmp_path):
    frames = [frame(9.0, 0.0, events=[("start", 1)]), frame(0.0, 9.0, events=[("end", 1)])]
    assert run(tmp_path, "{gesture}", *frames) == ["tee"]
    (tmp_path / "log.txt").unlink()
    assert run(tmp_path, "{gesture}={event}", *frames) == ["tee=start", "tee=end"]


def test_commands_that_cannot_run_are_refused():
    with pytest.raises(InputError, match="no such program"):
        actions.CommandOut("no-such-program-here {gesture}", NAMES)
    with pytest.raises(InputError, match="quotes"):
        actions.CommandOut("echo 'x", NAMES)
    with pytest.raises(InputError, match="no such program"):
        actions.CommandOut("", NAMES)
