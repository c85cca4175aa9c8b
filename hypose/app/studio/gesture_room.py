"""The one gesture session of the studio, which belongs to the server: docs/studio-protocol.md, /ws/gesture.

It runs in a thread of its own and speaks to pages through outlets, so it knows nothing of sockets: the server hands it
the messages of a page (`handle`), and puts what comes out (`Outlet`) on the wire, with acknowledgement and dropping.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol


class Outlet(Protocol):
    """A page that listens. Both are called from the session's thread and must not wait."""

    def text(self, message: Mapping[str, Any], /) -> None:
        """A JSON message of the protocol; never dropped."""
        ...

    def picture(self, message: bytes, /) -> None:
        """A binary message of the protocol; dropped when the page has not answered the last ones."""
        ...


@dataclass(frozen=True)
class Places:
    """Where files lie. gestures: folder to write sessions and models to; model, session: the path of an id (an
    InputError when there is none); identify: the id of a path."""

    gestures: Path
    model: Callable[[str], Path]
    session: Callable[[str], Path]
    identify: Callable[[Path], str]


class GestureRoom:
    """handle, join and leave may be called from any thread."""

    def __init__(self, places: Places) -> None:
        self._places = places

    def join(self, outlet: Outlet) -> None:
        """A page has come: it gets hello, and then everything."""
        raise NotImplementedError

    def leave(self, outlet: Outlet) -> None:
        """A page has gone; without any, a live session is paused after 5 s."""
        raise NotImplementedError

    def handle(self, message: Mapping[str, Any]) -> None:
        """A message of a page, except ack; an InputError is for that page."""
        raise NotImplementedError

    def close(self) -> None:
        """Stop the session with everything saved (the server ends)."""
        raise NotImplementedError
