"""What is told live, for whoever listens: everybody gets what is posted, nobody is waited for."""

from __future__ import annotations

import asyncio
import re
from contextlib import suppress

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

Post = str | bytes
Queue = asyncio.Queue[Post | None]
ORIGINS = [None, re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d{1,5})?")]
"""Programs, and pages of this computer: a page of somebody else must not talk to a port behind the user's back."""


def put_newest(queue: asyncio.Queue, what: object) -> bool:
    """Put something into a queue, where it is full instead of the oldest; whether it was."""
    full = queue.full()
    if full:
        queue.get_nowait()
    queue.put_nowait(what)
    return full


class Outbox:
    """Queues of listeners; a listener that is too slow loses the oldest of what waits. Used in one event loop. dropped:
    what was lost so."""

    def __init__(self) -> None:
        self.dropped = 0
        self._queues = dict[asyncio.Queue, str]()

    def __len__(self) -> int:
        """How many listen."""
        return len(self._queues)

    def wanted(self, path: str) -> bool:
        """Whether anybody listens there."""
        return path in self._queues.values()

    def join(self, queue: asyncio.Queue, path: str = "") -> None:
        """From now on the queue gets what is posted."""
        self._queues[queue] = path

    def leave(self, queue: asyncio.Queue) -> None:
        """No more of it."""
        self._queues.pop(queue, None)

    def post(self, what: Post | None, path: str | None = None) -> None:
        """To all, or to those of a path; None: there is nothing more."""
        for queue, own in self._queues.items():
            if path is None or own == path:
                self.dropped += put_newest(queue, what)

    async def serve(self, connection: ServerConnection, queue: Queue, path: str = "") -> None:
        """Send what waits in the queue and what is posted, until there is nothing more or the listener is gone."""
        self.join(queue, path)
        reading = asyncio.ensure_future(_until_gone(connection, queue))
        try:
            with suppress(ConnectionClosed):
                while (what := await queue.get()) is not None:
                    await connection.send(what)
        finally:
            self.leave(queue)
            reading.cancel()


async def _until_gone(connection: ServerConnection, queue: Queue) -> None:
    """Listeners have nothing to say; reading notices when they leave, also while there is nothing to send."""
    with suppress(ConnectionClosed):
        async for _ in connection:
            pass
    put_newest(queue, None)
