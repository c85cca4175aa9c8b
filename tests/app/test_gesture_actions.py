"""What gestures set off on this computer: MIDI, keys, commands, with doubles for the sound system and the keyboard."""

import sys
import types

import pytest

from hypose.app.jobs.gesture_job import Watched
from hypose.app.live import gesture_actions as actions
from hypose.errors import InputError
from hypose.gestures.events import Event
from hypose.gestures.localise import Found
from tests.conftest import HANG_S

NAMES = ["tee", "ok"]


def frame(*scores, events=()):
    found = [Found(k, 1.0, 2.0, s, None) for k, s in enumerate(scores, 1)]
    return Watched(0.5, found, [Event(kind, g, 0.5, 1.0, 2.0, None, 9.0) for kind, g in events])


class Port:
    def __init__(self):
        self.sent, self.closed = [], False

    def send(self, data):
        self.sent.append(tuple(data))

    def close(self):
        self.closed = True


def test_midi_has_a_note_and_a_controller_per_gesture():
    port = Port()
    out = actions.MidiOut(port, [10.0, 4.0])
    out.send(frame(5.0, 0.0))
    assert port.sent == [(0xB0, 20, 64), (0xB0, 21, 0)]
    port.sent.clear()
    out.send(frame(5.0, 8.0, events=[("start", 2)]))  # unchanged controllers are not sent again
    assert port.sent == [(0xB0, 21, 127), (0x90, 61, 100)]
    port.sent.clear()
    out.send(frame(5.0, 8.0, events=[("end", 2), ("start", 1)]))
    assert port.sent == [(0x80, 61, 0), (0x90, 60, 100)]
    port.sent.clear()
    out.close()  # what still sounds is ended
    assert port.sent == [(0x80, 60, 0)] and port.closed


@pytest.fixture
def mido(monkeypatch):
    """A double of mido with two ports."""
    opened = []

    class Message:
        @staticmethod
        def from_bytes(data):
            return data

    def open_output(name, virtual=False):
        opened.append((name, virtual, Port()))
        return opened[-1][2]

    module = types.SimpleNamespace(
        Message=Message, open_output=open_output, get_output_names=lambda: ["Synth 1", "Synth 2", "Drums"]
    )
    monkeypatch.setitem(sys.modules, "mido", module)
    return module, opened


def test_midi_ports_are_found_by_a_part_of_their_name(mido):
    _, opened = mido
    actions.open_midi("drum").send(bytes([0x90, 60, 100]))
    assert opened[0][:2] == ("Drums", False) and opened[0][2].sent == [(0x90, 60, 100)]
    actions.open_midi("virtual").close()
    assert opened[1][:2] == ("hypose", True) and opened[1][2].closed
    with pytest.raises(InputError, match="several ports; there are Synth 1, Synth 2"):
        actions.open_midi("synth")
    with pytest.raises(InputError, match="no port; there are Synth 1, Synth 2, Drums"):
        actions.open_midi("piano")


def test_a_computer_without_midi_is_named(mido, monkeypatch):
    module, _ = mido

    def fail():
        raise SystemError("no sequencer")

    module.get_output_names = fail
    with pytest.raises(InputError, match=r"no sequencer.*--osc"):
        actions.open_midi("piano")
    module.get_output_names = list
    with pytest.raises(InputError, match="there are none"):
        actions.open_midi("piano")
    monkeypatch.setitem(sys.modules, "mido", None)
    with pytest.raises(InputError, match=r"hypose\[midi\]"):
        actions.open_midi("piano")


class Keyboard:
    pressed = []

    def press(self, key):
        self.pressed.append(("down", key))

    def release(self, key):
        self.pressed.append(("up", key))


def test_a_key_is_held_while_its_gesture_is_on(monkeypatch):
    space = types.SimpleNamespace(name="space")

    class Key:
        def __init__(self):
            self.space = space

        def __iter__(self):
            return iter([space])

    monkeypatch.setitem(sys.modules, "pynput", types.ModuleType("pynput"))
    monkeypatch.setitem(sys.modules, "pynput.keyboard", types.SimpleNamespace(Key=Key(), Controller=Keyboard))
    Keyboard.pressed = []
    out = actions.open_keys(actions.keys_of(["ok=space"], NAMES))
    out.send(frame(1.0, 9.0, events=[("start", 1), ("start", 2)]))
    out.send(frame(1.0, 9.0))
    assert Keyboard.pressed == [("down", space)]
    out.send(frame(1.0, 1.0, events=[("end", 2), ("start", 2)]))
    out.close()
    assert [k for k, _ in Keyboard.pressed] == ["down", "up", "down", "up"]
    with pytest.raises(InputError, match="no key 'warp'"):
        actions.open_keys({1: "warp"})


@pytest.mark.parametrize("text", ["wave=space", "tee", "tee="])
def test_keys_of_unknown_gestures_are_refused(text):
    with pytest.raises(InputError, match="tee, ok"):
        actions.keys_of([text], NAMES)


def test_without_a_keyboard_library_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pynput", None)
    monkeypatch.delitem(sys.modules, "pynput.keyboard", raising=False)
    with pytest.raises(InputError, match=r"pynput"):
        actions.open_keys({1: "a"})


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
