"""How what runs live from a terminal is ended."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator


@contextlib.contextmanager
def ended_by_signals(ended: threading.Event) -> Iterator[None]:
    """Meanwhile Ctrl-C, SIGTERM and a terminal that is closed set the event, and cut nothing off."""
    hung_up = getattr(signal, "SIGHUP", None)
    numbers = [signal.SIGINT, signal.SIGTERM]
    if hung_up is not None and signal.getsignal(hung_up) != signal.SIG_IGN:  # nohup: it is to go on
        numbers.append(hung_up)
    before = {n: signal.signal(n, lambda number, frame: ended.set()) for n in numbers}
    try:
        yield
    finally:
        for n, handler in before.items():
            signal.signal(n, handler)
