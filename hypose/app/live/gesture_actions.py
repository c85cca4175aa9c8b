"""What gestures set off on this computer: key presses, commands. Each only when it is asked for."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from hypose.app.jobs.gesture_job import Watched
from hypose.errors import InputError, extra

MOST_COMMANDS = 8
"""That run at a time; what a gesture would set off beyond them is left out."""


class Keyboard(Protocol):
    """What presses keys."""

    def press(self, key: Any, /) -> None:
        """Down."""
        ...

    def release(self, key: Any, /) -> None:
        """Up."""
        ...


class KeysOut:
    """Holds a key down while its gesture is on; keys: by the number of the gesture."""

    def __init__(self, keyboard: Keyboard, keys: Mapping[int, Any]) -> None:
        self._keyboard, self._keys, self._down = keyboard, dict(keys), set[int]()

    def send(self, watched: Watched) -> None:
        """One frame."""
        for e in watched.events:
            if e.gesture in self._keys:
                self._set(e.gesture, e.kind == "start")

    def _set(self, gesture: int, down: bool) -> None:
        (self._down.add if down else self._down.discard)(gesture)
        (self._keyboard.press if down else self._keyboard.release)(self._keys[gesture])

    def close(self) -> None:
        """Let go of all keys."""
        for gesture in sorted(self._down):
            self._set(gesture, False)


def keys_of(texts: Sequence[str], names: Sequence[str]) -> dict[int, str]:
    """Key names by the number of the gesture, from texts "NAME=KEY"."""
    out = {}
    for text in texts:
        name, _, key = text.partition("=")
        if name not in names or not key:
            raise InputError(f"--key {text} is not understood; give GESTURE=KEY with a gesture of {', '.join(names)}.")
        out[names.index(name) + 1] = key
    return out


def open_keys(keys: Mapping[int, str]) -> KeysOut:
    """Keys of this computer's keyboard: single characters, or names such as space, enter, page_down, left, f5."""
    library = extra("pynput.keyboard", "--key", "keys", or_else="use --command or --osc")
    special = library.Key
    for key in keys.values():
        if len(key) > 1 and not hasattr(special, key):
            known = ", ".join(k.name for k in special)
            raise InputError(f"There is no key {key!r}; give one character or one of {known}.")
    return KeysOut(library.Controller(), {g: k if len(k) == 1 else getattr(special, k) for g, k in keys.items()})


class CommandOut:
    """Runs a command when a gesture starts, {gesture} in it replaced by its name; with {event} in it, at ends too
    (start, end). No shell reads it; it is not waited for."""

    def __init__(self, text: str, names: Sequence[str]) -> None:
        try:
            self._words = shlex.split(text, posix=os.name != "nt")
        except ValueError as error:
            raise InputError(f"--command {text!r} cannot be read ({error}); close its quotes.") from None
        if not self._words or shutil.which(self._words[0]) is None:
            raise InputError(f"--command {text!r}: there is no such program; give one that runs in this terminal.")
        self._names, self._ends = list(names), "{event}" in text
        self._running: list[subprocess.Popen[bytes]] = []

    def send(self, watched: Watched) -> None:
        """One frame."""
        self._running = [p for p in self._running if p.poll() is None]
        for e in watched.events:
            if (e.kind == "start" or self._ends) and len(self._running) < MOST_COMMANDS:
                name = self._names[e.gesture - 1]
                words = [w.replace("{gesture}", name).replace("{event}", e.kind) for w in self._words]
                self._running.append(subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL))

    def close(self) -> None:
        """What still runs goes on by itself."""
