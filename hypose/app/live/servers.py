"""Functions that all servers share: compare secrets safely, keep strangers' errors out of the log, and serve listeners
without waiting for slow ones.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
import math
import os
import re
import secrets
import threading
from collections.abc import Callable, Coroutine
from contextlib import suppress
from http import HTTPStatus
from typing import Any, TypeVar
from urllib.parse import parse_qs

from websockets.asyncio.server import Server, ServerConnection, broadcast, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from hypose.errors import InputError

_LOGGERS = ("asyncio", "uvicorn.error", "websockets.server")
_FOREIGN = (
    "Invalid ",
    "Unsupported upgrade",
    "opening handshake failed",
    "socket.accept()",
    "socket.send() raised",
    "unexpected internal",
)
"""Beginnings of log messages about what a client has sent, not about this program. websockets logs the last one when
frames come with a request that it refuses.
"""


LOOPBACK = frozenset({"127.0.0.1", "localhost", "::1"})
"""Addresses that only this computer reaches."""


def token_for(host: str, token: str | None = None) -> str:
    """Return the secret that clients must show to a server on this host: the given one, a new one where other computers
    can connect, else "".
    """
    return token or ("" if host in LOOPBACK else secrets.token_urlsafe(16))


def same_secret(shown: str, secret: str) -> bool:
    """Compare a received text with the secret, in a time that does not depend on the text.

    Why: the time would reveal how many first letters are right.
    """
    return hmac.compare_digest(shown.encode("utf-8", "surrogatepass"), secret.encode("utf-8", "surrogatepass"))


def shows_secret(query: str, authorization: str, secret: str) -> bool:
    """Test whether a request contains the secret.

    query: query of the address, with the token as ?token=.
    authorization: value of the header, with the token as Bearer.
    """
    shown = parse_qs(query).get("token", [""])[0]
    return any(same_secret(t, secret) for t in (shown, authorization.removeprefix("Bearer ")))


def _own(record: logging.LogRecord) -> bool:
    return not record.getMessage().startswith(_FOREIGN)


def quiet_logs() -> None:
    """Filter log messages of the server libraries about what clients send."""
    for name in _LOGGERS:
        logging.getLogger(name).addFilter(_own)  # a filter that is there already is not added twice


_ORIGINS = [None, re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d{1,5})?")]
"""Allowed origins: programs, and pages of this computer. Why: a foreign page must not use a port without the user's
knowledge.
"""


_MOST_UNSENT = 1 << 16
"""Bytes that wait for a slow listener, which misses items until there are fewer."""


class SocketServer:
    """WebSocket server of one event loop, whose clients listen to posted items, or send lines. A listener that is too
    slow misses items.

    hello: first item for every listener; "": none.
    path: path that listeners request.
    clients: most connections at a time.
    take: function that receives each line that a client sends to the path /in, and returns why the line is ignored,
        or None where it is used; None instead of a function: no lines are accepted.
    token: secret that clients must show; "": none, and pages of other computers are refused.

    Attributes:
    listeners: connections of the listeners.
    dropped: number of items that listeners missed.
    """

    def __init__(
        self,
        hello: str = "",
        path: str = "/",
        *,
        clients: int = 16,
        take: Callable[[str | bytes], str | None] | None = None,
        token: str = "",
    ) -> None:
        self._hello, self._clients, self._take, self._token = hello, clients, take, token
        self._paths = {path} if take is None else {path, "/in"}
        self.dropped, self.listeners = 0, set[ServerConnection]()
        self._server: Server | None = None

    async def start(self, host: str, port: int) -> int:
        """Open a port (0: any free one) and return its number; OSError or OverflowError where it cannot be opened."""
        self._server = await serve(
            self._client,
            host,
            port,
            process_request=self._admit,
            origins=None if self._token else _ORIGINS,
            compression=None,
            max_size=1 << 16,
            max_queue=16,
            open_timeout=5,
            close_timeout=1,
        )
        return int(next(iter(self._server.sockets)).getsockname()[1])

    async def stop(self) -> None:
        """Send what still waits, and close all connections."""
        if self._server is not None:
            self._server.close()
            with suppress(TimeoutError):
                await asyncio.wait_for(self._server.wait_closed(), 3)

    def post(self, what: str) -> None:
        """Send an item to all listeners that are not too slow."""
        slow = {c for c in self.listeners if c.transport.get_write_buffer_size() > _MOST_UNSENT}
        self.dropped += len(slow)
        broadcast(self.listeners - slow, what)

    def _admit(self, connection: ServerConnection, request: Request) -> Response | None:
        """Refuse a request with another path, too many connections or a wrong token; None: it is accepted."""
        path, _, query = request.path.partition("?")
        if path not in self._paths:
            return connection.respond(HTTPStatus.NOT_FOUND, "there is no such path\n")
        if len(connection.server.connections) >= self._clients:
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "too many connections\n")
        bearer = " ".join(request.headers.get_all("Authorization"))
        if self._token and not shows_secret(query, bearer, self._token):
            return connection.respond(HTTPStatus.UNAUTHORIZED, "the token is missing or wrong\n")
        return None

    async def _client(self, connection: ServerConnection) -> None:
        path = connection.request.path.partition("?")[0] if connection.request is not None else ""
        with suppress(ConnectionClosed):
            if path == "/in" and self._take:
                await self._receive(connection, self._take)
            else:
                if self._hello:
                    broadcast([connection], self._hello)
                self.listeners.add(connection)  # after the first item nothing is missed
                await connection.wait_closed()
        self.listeners.discard(connection)

    async def _receive(self, connection: ServerConnection, take: Callable[[str | bytes], str | None]) -> None:
        """Take the lines of a sender, and answer at most once a second why lines are ignored."""
        reported, loop = -math.inf, asyncio.get_running_loop()
        async for message in connection:
            reasons = [r for line in message.splitlines() if line.strip() and (r := take(line))]
            if reasons and loop.time() - reported > 1:
                reported = loop.time()
                await connection.send(json.dumps({"type": "error", "reason": reasons[0], "lines": len(reasons)}))


_T = TypeVar("_T")


class SocketListeners:
    """WebSocket server on ws://127.0.0.1:PORT in a thread of its own, for listeners of this computer.

    port: 0: any free one.
    hello, path: as for `SocketServer`.
    Raises: InputError where the port cannot be used.

    Attributes:
    port: number of the port.
    server: the server, which belongs to the thread.
    """

    def __init__(self, port: int, hello: str = "", path: str = "/") -> None:
        self._loop = asyncio.new_event_loop()
        self.server: SocketServer = SocketServer(hello, path)
        quiet_logs()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        try:
            self.port: int = self._in_loop(self.server.start("127.0.0.1", port))
        except OSError as error:
            self._end_loop()
            raise InputError(
                f"Port {port} cannot be used ({listen_error(error)}); choose another with --ws, 0 takes any free one."
            ) from None

    def post(self, what: str) -> None:
        """Send an item to all listeners."""
        self._loop.call_soon_threadsafe(self.server.post, what)

    def close(self) -> None:
        """Send the items that still wait, and stop the server."""
        self._in_loop(self.server.stop())
        self._end_loop()

    def _in_loop(self, work: Coroutine[Any, Any, _T]) -> _T:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result()

    def _end_loop(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


def listen_error(error: OSError | OverflowError) -> str:
    """Return why a port cannot be opened, in the system's words."""
    number = getattr(error, "errno", None)
    return (str(error) if number is None else os.strerror(number)).lower()
