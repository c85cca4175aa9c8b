"""Functions that all servers share: compare secrets safely, keep strangers' errors out of the log, and serve listeners
without waiting for slow ones.
"""

from __future__ import annotations

import asyncio
import hmac
import logging
import os
import re
import threading
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any, TypeVar
from urllib.parse import parse_qs

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed

from hypose.errors import InputError

_LOGGERS = ("asyncio", "uvicorn.error", "websockets.server")
FOREIGN = (
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


def same_secret(shown: str, secret: str) -> bool:
    """Compare a received text with the secret, in a time that does not depend on the text.

    Why: the time would reveal how many first letters are right.
    """
    return hmac.compare_digest(shown.encode("utf-8", "surrogatepass"), secret.encode("utf-8", "surrogatepass"))


def shows_secret(query: str, authorization: str, secret: str) -> bool:
    """Test whether a request contains the secret.

    query: of the address, with the token as ?token=.
    authorization: value of the header, with the token as Bearer.
    """
    shown = parse_qs(query).get("token", [""])[0]
    return any(same_secret(t, secret) for t in (shown, authorization.removeprefix("Bearer ")))


def _own(record: logging.LogRecord) -> bool:
    return not record.getMessage().startswith(FOREIGN)


def quiet_logs() -> None:
    """Filter log messages of the server libraries about what clients send."""
    for name in _LOGGERS:
        logging.getLogger(name).addFilter(_own)  # a filter that is there already is not added twice


Post = str | bytes
Queue = asyncio.Queue[Post | None]
ORIGINS = [None, re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d{1,5})?")]
"""Allowed origins: programs, and pages of this computer. Why: a foreign page must not use a port without the user's
knowledge.
"""


def put_newest(queue: asyncio.Queue, what: object) -> bool:
    """Put an item into a queue, in place of the oldest one where the queue is full; return whether it was full."""
    full = queue.full()
    if full:
        queue.get_nowait()
    queue.put_nowait(what)
    return full


class Outbox:
    """Queues of listeners; a listener that is too slow loses its oldest items. Used in one event loop.

    queues: of the listeners.
    dropped: number of lost items.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self.queues = set[asyncio.Queue]()

    def post(self, what: Post | None) -> None:
        """Send an item to all listeners; None marks the end."""
        for queue in self.queues:
            self.dropped += put_newest(queue, what)

    async def serve(self, connection: ServerConnection, queue: Queue) -> None:
        """Send queued and new items to a connection until the end mark, or until the listener leaves.

        queue: of this listener; it receives items from now on.
        """
        self.queues.add(queue)
        reading = asyncio.ensure_future(_until_gone(connection, queue))
        try:
            with suppress(ConnectionClosed):
                while (what := await queue.get()) is not None:
                    await connection.send(what)
        finally:
            self.queues.discard(queue)
            reading.cancel()


async def _until_gone(connection: ServerConnection, queue: Queue) -> None:
    """Read from a connection until the listener leaves, and then put the end mark into its queue.

    Why: otherwise it is noticed only when the next item is sent.
    """
    with suppress(ConnectionClosed):
        async for _ in connection:
            pass
    put_newest(queue, None)


_T = TypeVar("_T")
_MAX_PENDING = 16


class SocketListeners:
    """WebSocket server on ws://127.0.0.1:PORT (0: any free one) for programs and pages of this computer.

    Every item is sent to all listeners, whatever path they asked for.
    waiting: items kept for a slow listener, which loses the oldest ones.
    hello: gives the first item for a path; None: there is no such path.
    Raises: InputError where the port cannot be used.
    """

    def __init__(self, port: int, waiting: int, hello: Callable[[str], Post | None] = lambda path: "") -> None:
        self.outbox = Outbox()
        self._waiting, self._hello = waiting, hello
        self._loop = asyncio.new_event_loop()
        quiet_logs()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        try:
            self._server = self._in_loop(self._open(port))
        except OSError as error:
            self._end_loop()
            raise InputError(
                f"Port {port} cannot be used ({listen_error(error)}); choose another with --ws, 0 takes any free one."
            ) from None

    @property
    def port(self) -> int:
        """The port of the server."""
        return int(next(iter(self._server.sockets)).getsockname()[1])

    def post(self, what: Post) -> None:
        """Send an item to all listeners."""
        self._loop.call_soon_threadsafe(self.outbox.post, what)

    def close(self) -> None:
        """Send what was posted, and stop."""
        self._loop.call_soon_threadsafe(self.outbox.post, None)
        self._in_loop(self._close())
        self._end_loop()

    def _in_loop(self, work: Coroutine[Any, Any, _T]) -> _T:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result()

    def _end_loop(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    # ---- in the loop ----

    async def _open(self, port: int) -> Server:
        return await serve(
            self._listen,
            "127.0.0.1",
            port,
            origins=ORIGINS,
            compression=None,
            max_size=1 << 16,
            open_timeout=5,
            close_timeout=1,
        )

    async def _close(self) -> None:
        for _ in range(100):  # give listeners time to receive the queued items
            if not self.outbox.queues:
                break
            await asyncio.sleep(0.02)
        self._server.close()
        await self._server.wait_closed()

    async def _listen(self, connection: ServerConnection) -> None:
        path = connection.request.path.partition("?")[0] if connection.request is not None else "/"
        hello = self._hello(path)
        if len(self.outbox.queues) >= _MAX_PENDING or hello is None:
            full = hello is not None
            await connection.close(1013 if full else 1008, "too many listeners" if full else "there is no such path")
            return
        queue: Queue = asyncio.Queue(self._waiting)
        if hello:
            queue.put_nowait(hello)
        await self.outbox.serve(connection, queue)


def listen_error(error: OSError | OverflowError) -> str:
    """Return why a port cannot be opened, in the system's words."""
    number = getattr(error, "errno", None)
    return (str(error) if number is None else os.strerror(number)).lower()
