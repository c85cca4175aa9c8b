"""Values that take long to make, kept for a while: bounded in bytes, and let go when no one asks for them."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field
from typing import Generic, TypeVar

IDLE_S = 300.0
"""s after which what no one has asked for is let go."""
V = TypeVar("V")


@dataclass
class _Entry(Generic[V]):
    """value: None until it is made, under the entry's own lock: who wants another one does not wait for it."""

    value: V | None = None
    users: int = 0
    used: float = 0.0
    making: threading.Lock = field(default_factory=threading.Lock)


class LruCache(Generic[V]):
    """Values by key, for several threads. most: bytes of all together, as weigh(value) tells them; beyond, those that
    were not used for longest are let go, but never one that is being used. let_go(value) releases it; idle_s: after
    this time without use it is called anyway; one_more: the one used last stays, however large it is."""

    def __init__(
        self,
        most: int,
        weigh: Callable[[V], int],
        let_go: Callable[[V], None] = lambda value: None,
        idle_s: float = IDLE_S,
        clock: Callable[[], float] = time.monotonic,
        one_more: bool = False,
    ) -> None:
        self._one_more = one_more
        self._most, self._weigh, self._let_go, self._idle_s, self._clock = most, weigh, let_go, idle_s, clock
        self._lock = threading.RLock()
        self._entries: OrderedDict[Hashable, _Entry[V]] = OrderedDict()
        self._timer: threading.Timer | None = None

    @contextlib.contextmanager
    def use(self, key: Hashable, make: Callable[[], V]) -> Iterator[V]:
        """The value of a key, made when it is not there; it stays while the block runs."""
        with self._lock:
            entry = self._entries.get(key)
            if entry is None:  # while it is made, as large as the largest, not more is to be there than afterwards
                self._shrink(self._most - max(map(self._weight, self._entries.values()), default=0))
                entry = self._entries[key] = _Entry()
            entry.users += 1
            self._entries.move_to_end(key)
        try:
            with entry.making:
                value = entry.value = make() if entry.value is None else entry.value
            yield value
        finally:
            with self._lock:
                entry.users -= 1
                entry.used = self._clock()
                if entry.value is None and not entry.users:  # it could not be made
                    self._entries.pop(key, None)
                self.tidy()

    @property
    def held(self) -> int:
        """Bytes of all values."""
        with self._lock:
            return sum(map(self._weight, self._entries.values()))

    def tidy(self) -> None:
        """Drop values beyond the limit and values not used for long."""
        with self._lock:
            self._shrink(self._most, next(reversed(self._entries), None) if self._one_more else None)
            if self._entries and (self._timer is None or not self._timer.is_alive()):
                self._timer = threading.Timer(self._idle_s, self._tidy_later)
                self._timer.daemon = True
                self._timer.start()

    def _tidy_later(self) -> None:
        with self._lock:
            self._timer = None
            self.tidy()

    def _shrink(self, most: int, stays: Hashable = None) -> None:
        """Drop values until at most so many bytes are kept, and idle ones."""
        total = self.held
        for key, entry in [(k, e) for k, e in self._entries.items() if not e.users]:
            if (total > most and key != stays) or self._clock() - entry.used >= self._idle_s:
                total -= self._weight(entry)
                self._release(key)

    def _weight(self, entry: _Entry[V]) -> int:
        return 0 if entry.value is None else self._weigh(entry.value)

    def _release(self, key: Hashable) -> None:
        value = self._entries.pop(key).value
        if value is not None:
            self._let_go(value)

    def drop(self) -> None:
        """Let go of all that is not in use."""
        with self._lock:
            for key in [k for k, e in self._entries.items() if not e.users]:
                self._release(key)
