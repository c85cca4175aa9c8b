"""What gestures set off on this computer: commands, only when they are asked for."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from collections.abc import Sequence

from hypose.app.jobs.gesture_job import Watched
from hypose.errors import InputError

MOST_COMMANDS = 8
"""That run at a time; what a gesture would set off beyond them is left out."""


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
        # the user's own program imports what lies beside it
        self._environment = {k: v for k, v in os.environ.items() if k != "PYTHONSAFEPATH"}
        self._running: list[subprocess.Popen[bytes]] = []

    def send(self, watched: Watched) -> None:
        """One frame."""
        self._running = [p for p in self._running if p.poll() is None]
        for e in watched.events:
            if (e.kind == "start" or self._ends) and len(self._running) < MOST_COMMANDS:
                name = self._names[e.gesture - 1]
                words = [w.replace("{gesture}", name).replace("{event}", e.kind) for w in self._words]
                nowhere = subprocess.DEVNULL
                self._running.append(subprocess.Popen(words, stdin=nowhere, stdout=nowhere, env=self._environment))

    def close(self) -> None:
        """What still runs goes on by itself."""
