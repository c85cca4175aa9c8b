"""How the servers let connections in: strangers who say nothing keep nobody out, and fill no log.

A connection is *silent* while no request on it is being answered: before its first request is complete, between
requests, or for ever. Silent ones end after some seconds, and when there are too many the one that has been silent
longest makes room for who comes. So somebody who asks at once is served, whatever others hold open; and the process
never runs out of file descriptors, at which asyncio would write a traceback per waiting connection.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import logging
import math
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qs

SILENT_S = 20.0
_MOST = 128
_FOLD_S, _KINDS = 60.0, 100
_LOGGERS = ("asyncio", "uvicorn.error", "websockets.server")
_NUMBER = re.compile(r"0x[0-9a-f]+|[0-9]+")
FOREIGN = (
    "Invalid ",
    "Unsupported upgrade",
    "opening handshake failed",
    "socket.accept()",
    "socket.send() raised",
    "unexpected internal",
)
"""How complaints begin that are about what somebody has sent, not about this program. websockets says the last one when
frames come with a request that it refuses."""


def same_secret(shown: str, secret: str) -> bool:
    """Whether a text from outside, which may hold anything, is the secret; in a time that tells nothing."""
    return hmac.compare_digest(shown.encode("utf-8", "surrogatepass"), secret.encode("utf-8", "surrogatepass"))


def shows_secret(query: str, authorization: str, secret: str) -> bool:
    """Whether a request's query (?token=) or Authorization header (Bearer) shows the secret."""
    shown = parse_qs(query).get("token", [""])[0]
    return any(same_secret(t, secret) for t in (shown, authorization.removeprefix("Bearer ")))


@dataclass(eq=False)
class _Guest:
    """busy: requests that are being answered; unsent: bytes that waited for the other side when looked at last."""

    transport: asyncio.Transport
    busy: int = 0
    unsent: int = 0
    timer: asyncio.TimerHandle | None = None

    @property
    def gone(self) -> bool:
        """Whether the socket is closed (a transport that still sends what is left is not)."""
        return self.transport.get_extra_info("socket").fileno() < 0

    def leave(self) -> None:
        """End it now."""
        if self.timer is not None:
            self.timer.cancel()
        if not self.gone:  # a transport that has ended while it still had something to send knows no loop any more
            self.transport.abort()


class Door:
    """The connections of one server; used in its loop only. most: how many may be open (fewer where the system allows
    this process few files); silent_s: how long one may be silent, and how long one may take nothing of what is sent.
    backlog: for the server; asyncio accepts so many at once, before any of them is looked at here."""

    def __init__(self, most: int = _MOST, silent_s: float = SILENT_S) -> None:
        self._most, self._silent_s = min(most, _files() // 4), silent_s
        self.backlog = min(_MOST, _files() // 4)
        self._guests: dict[Any, _Guest] = {}  # by address; who has been silent longest comes first

    def letting_in(self, make: Callable[..., asyncio.Protocol]) -> Callable[..., asyncio.Protocol]:
        """A factory of the same protocols, whose connections come through this door."""

        def made(*arguments: Any, **named: Any) -> asyncio.Protocol:
            protocol = make(*arguments, **named)
            usual = protocol.connection_made

            def connection_made(transport: asyncio.BaseTransport) -> None:
                usual(transport)
                assert isinstance(transport, asyncio.Transport)
                self._came(transport)

            protocol.connection_made = connection_made
            return protocol

        return made

    @contextlib.contextmanager
    def answering(self, address: Any, known: bool) -> Iterator[None]:
        """A request that has come from an address (host, port) is answered. known: by somebody who may use the server:
        the connection is not silent meanwhile. After it, it is silent anew."""
        guest = self._guests.get(tuple(address or ())[:2])
        if guest is None:
            yield
            return
        guest.busy += known
        try:
            yield
        finally:
            guest.busy -= known
            self._silent(guest)

    def __len__(self) -> int:
        """Connections that are open."""
        return sum(not g.gone for g in self._guests.values())

    def _came(self, transport: asyncio.Transport) -> None:
        self._guests = {k: g for k, g in self._guests.items() if not g.gone}
        if len(self._guests) >= self._most:
            longest = next((k for k, g in self._guests.items() if not g.busy), None)
            if longest is None:
                transport.abort()
                return
            self._guests.pop(longest).leave()
        guest = _Guest(transport)
        self._guests[tuple(transport.get_extra_info("peername") or (id(transport),))[:2]] = guest
        self._look_later(guest)

    def _silent(self, guest: _Guest) -> None:
        key = next((k for k, g in self._guests.items() if g is guest), None)
        if key is not None and not guest.gone:
            self._guests[key] = self._guests.pop(key)
            self._look_later(guest)

    def _look_later(self, guest: _Guest) -> None:
        if guest.timer is not None:
            guest.timer.cancel()
        guest.timer = asyncio.get_running_loop().call_later(self._silent_s, self._look, guest)

    def _look(self, guest: _Guest) -> None:
        unsent = 0 if guest.gone else guest.transport.get_write_buffer_size()
        taken, guest.unsent = unsent != guest.unsent, unsent
        # who has something to take must take some of it, who has not must be waiting for an answer
        if guest.gone or not (taken if unsent else guest.busy):
            guest.leave()
        else:
            self._look_later(guest)


def _files() -> int:
    """Files that this process may have open at a time."""
    try:
        import resource
    except ImportError:  # Windows
        return 512
    soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return 1 << 16 if soft == resource.RLIM_INFINITY else max(64, soft)


class Folded(logging.Filter):
    """Lets one line of a kind through per minute and says how many more there were; what is about a stranger's bytes
    comes without the library's traceback."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._kinds: dict[tuple[Any, ...], tuple[float, int]] = {}  # when it was let through, how many were not since

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record is let through."""
        text, error = record.getMessage(), record.exc_info[1] if record.exc_info else None
        kind = (record.name, record.levelno, _NUMBER.sub("#", text.split("\n")[0][:200]), type(error))
        now = self._clock()
        at, more = self._kinds.get(kind, (-math.inf, 0))
        if now - at < _FOLD_S:
            self._kinds[kind] = (at, more + 1)
            return False
        if len(self._kinds) >= _KINDS:
            self._kinds.clear()
        self._kinds[kind] = (now, 0)
        if text.startswith(FOREIGN):
            text = text.split("\n")[0] + (f" ({type(error).__name__}: {error})"[:200] if error is not None else "")
            record.exc_info = record.exc_text = None
        record.msg, record.args = text + (f" ({more} more like it)" if more else ""), ()
        return True


folded = Folded()


def fold_logs() -> None:
    """From now on the libraries that the servers use say the same thing once a minute."""
    for name in _LOGGERS:
        logging.getLogger(name).addFilter(folded)  # once: a filter that is there already is not added
