"""A port of this computer on which programs and pages listen by WebSocket, in a thread of its own."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from websockets.asyncio.server import Server, ServerConnection, serve

from hypose.app.live.outbox import ORIGINS, Outbox, Post, Queue
from hypose.app.live.secrets_and_logs import fold_logs
from hypose.errors import InputError

T = TypeVar("T")
MOST = 16


class SocketListeners:
    """Listens on ws://127.0.0.1:PORT (0: any free one), to programs and to pages of this computer. What is posted goes
    to the listeners of a path; hello: what those of a path get first, None: there is no such path. A listener that is
    too slow loses the oldest of `waiting` posts. An InputError when the port cannot be used."""

    def __init__(
        self, port: int, waiting: int, hello: Callable[[str], Post | None] = lambda path: "", most: int = MOST
    ) -> None:
        if not 0 <= port < 65536:
            raise InputError(f"--ws {port} is no port; give 0 (any free one) to 65535.")
        self._outbox = Outbox()
        self._waiting, self._hello, self._most = waiting, hello, most
        self._loop = asyncio.new_event_loop()
        fold_logs()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        try:
            self._server = self._in_loop(self._open(port))
        except OSError as error:
            self._end_loop()
            raise InputError(
                f"Port {port} cannot be used ({refusal(error)}); choose another with --ws, 0 takes any free one."
            ) from None

    @property
    def dropped(self) -> int:
        """What slow listeners have lost."""
        return self._outbox.dropped

    @property
    def port(self) -> int:
        """The port that is listened on."""
        return int(next(iter(self._server.sockets)).getsockname()[1])

    def wanted(self, path: str) -> bool:
        """Whether anybody listens there."""
        return self._outbox.wanted(path)

    def post(self, what: Post, path: str | None = None) -> None:
        """To all, or to those of a path."""
        self._loop.call_soon_threadsafe(self._outbox.post, what, path)

    def close(self) -> None:
        """Stop listening, after what was posted."""
        self._loop.call_soon_threadsafe(self._outbox.post, None)
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
            origins=ORIGINS,
            compression=None,
            max_size=1 << 16,
            open_timeout=5,
            close_timeout=1,
        )

    async def _close(self) -> None:
        for _ in range(100):  # listeners take what waits for them, if they take anything
            if not self._outbox:
                break
            await asyncio.sleep(0.02)
        self._server.close()
        await self._server.wait_closed()

    async def _listen(self, connection: ServerConnection) -> None:
        path = connection.request.path.partition("?")[0] if connection.request is not None else "/"
        hello = self._hello(path)
        if len(self._outbox) >= self._most or hello is None:
            full = hello is not None
            await connection.close(1013 if full else 1008, "too many listeners" if full else "there is no such path")
            return
        queue: Queue = asyncio.Queue(self._waiting)
        if hello:
            queue.put_nowait(hello)
        await self._outbox.serve(connection, queue, path)


def refusal(error: OSError | OverflowError) -> str:
    """Why a port cannot be listened on, in the system's words alone."""
    number = getattr(error, "errno", None)
    return (str(error) if number is None else os.strerror(number)).lower()
