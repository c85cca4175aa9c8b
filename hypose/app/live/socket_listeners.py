"""Whoever listens by WebSocket on this computer: everybody gets what is posted, nobody is waited for."""

from __future__ import annotations

import asyncio
import re
import threading
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any, TypeVar

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed

from hypose.app.live.door import Door, fold_logs
from hypose.errors import InputError

T = TypeVar("T")
Post = str | bytes
MOST = 16
_LOCAL = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d{1,5})?")


class SocketListeners:
    """Listens on ws://127.0.0.1:PORT (0: any free one), to programs and to pages of this computer. What is posted goes
    to the listeners of a path; hello: what those of a path get first, None: there is no such path. A listener that is
    too slow loses the oldest of `waiting` posts. An InputError when the port cannot be used."""

    def __init__(
        self, port: int, waiting: int, hello: Callable[[str], Post | None] = lambda path: "", most: int = MOST
    ) -> None:
        if not 0 <= port < 65536:
            raise InputError(f"--ws {port} is no port; give 0 (any free one) to 65535.")
        self.dropped = 0
        self._queues = dict[asyncio.Queue[Post | None], str]()
        self._waiting, self._hello, self._most = waiting, hello, most
        self._door, self._loop = Door(), asyncio.new_event_loop()
        fold_logs()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        try:
            self._server = self._in_loop(self._open(port))
        except OSError as error:
            self._end_loop()
            raise InputError(
                f"Port {port} cannot be used ({(error.strerror or str(error)).lower()}); choose another with --ws, 0 "
                "takes any free one."
            ) from None

    @property
    def port(self) -> int:
        """The port that is listened on."""
        return int(next(iter(self._server.sockets)).getsockname()[1])

    def wanted(self, path: str) -> bool:
        """Whether anybody listens there."""
        return path in self._queues.values()

    def post(self, what: Post, path: str | None = None) -> None:
        """To all, or to those of a path."""
        self._loop.call_soon_threadsafe(self._put, what, path)

    def close(self) -> None:
        """Stop listening, after what was posted."""
        self._loop.call_soon_threadsafe(self._put, None, None)
        self._in_loop(self._close())
        self._end_loop()

    def _in_loop(self, work: Coroutine[Any, Any, T]) -> T:
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
            origins=[None, _LOCAL],
            compression=None,
            max_size=1 << 16,
            open_timeout=5,
            close_timeout=1,
            create_connection=self._door.letting_in(ServerConnection),  # type: ignore[arg-type] - as any factory
            backlog=self._door.backlog,
        )

    async def _close(self) -> None:
        for _ in range(100):  # listeners take what waits for them, if they take anything
            if not self._queues:
                break
            await asyncio.sleep(0.02)
        self._server.close()
        await self._server.wait_closed()

    async def _listen(self, connection: ServerConnection) -> None:
        path = connection.request.path.partition("?")[0] if connection.request is not None else "/"
        hello = self._hello(path)
        if len(self._queues) >= self._most or hello is None:
            full = hello is not None
            await connection.close(1013 if full else 1008, "too many listeners" if full else "there is no such path")
            return
        queue: asyncio.Queue[Post | None] = asyncio.Queue(self._waiting)
        if hello:
            queue.put_nowait(hello)
        self._queues[queue] = path
        reading = asyncio.ensure_future(_until_gone(connection, queue))
        try:
            with self._door.answering(connection.remote_address, True), suppress(ConnectionClosed):
                while (what := await queue.get()) is not None:
                    await connection.send(what)
        finally:
            del self._queues[queue]
            reading.cancel()

    def _put(self, what: Post | None, path: str | None) -> None:
        for queue, own in self._queues.items():
            if path is None or own == path:
                self.dropped += _newest(queue, what)


def _newest(queue: asyncio.Queue[Post | None], what: Post | None) -> bool:
    """Put something into a queue, where it is full instead of the oldest; whether it was."""
    full = queue.full()
    if full:
        queue.get_nowait()
    queue.put_nowait(what)
    return full


async def _until_gone(connection: ServerConnection, queue: asyncio.Queue[Post | None]) -> None:
    """Listeners have nothing to say; reading notices when they leave, also while there is nothing to send."""
    with suppress(ConnectionClosed):
        async for _ in connection:
            pass
    _newest(queue, None)
