"""Cache for values that take long to make, limited in bytes; unused values are released after some time."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field
from typing import Generic, TypeVar

IDLE_S = 300.0
"""Time without use after which a value is released, s."""
V = TypeVar("V")


@dataclass
class _Entry(Generic[V]):
    """Entry of the cache.

    value: None until it is made.
    users: number of users at present.
    used: time of the last use.
    making: lock while the value is made, so that users of other entries do not wait.
    """

    value: V | None = None
    users: int = 0
    used: float = 0.0
    making: threading.Lock = field(default_factory=threading.Lock)


class LruCache(Generic[V]):
    """Bounded least-recently-used cache for several threads.

    most: bytes of all values together; the least recently used are released beyond it, but never one in use, nor the
        last used one, however large it is.
    weigh: gives the bytes of a value.
    let_go: releases a value.
    idle_s: time without use after which a value is released anyway, s.
    clock: gives the time, s.
    """

    def __init__(
        self,
        most: int,
        weigh: Callable[[V], int],
        let_go: Callable[[V], None] = lambda value: None,
        idle_s: float = IDLE_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._most, self._weigh, self._let_go, self._idle_s, self._clock = most, weigh, let_go, idle_s, clock
        self._lock = threading.RLock()
        self._entries: OrderedDict[Hashable, _Entry[V]] = OrderedDict()
        self._timer: threading.Timer | None = None

    @contextlib.contextmanager
    def use(self, key: Hashable, make: Callable[[], V]) -> Iterator[V]:
        """Return the value of a key, made by `make` where it is missing; it stays in the cache while the block runs."""
        with self._lock:
            entry = self._entries.get(key)
            if entry is None:  # make room before, for a value as large as the largest
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
        """Release values beyond the limit and values not used for long."""
        with self._lock:
            self._shrink(self._most, next(reversed(self._entries), None))
            if self._entries and (self._timer is None or not self._timer.is_alive()):
                self._timer = threading.Timer(self._idle_s, self._tidy_later)
                self._timer.daemon = True
                self._timer.start()

    def _tidy_later(self) -> None:
        with self._lock:
            self._timer = None
            self.tidy()

    def _shrink(self, most: int, stays: Hashable = None) -> None:
        """Release idle values, and others until at most so many bytes are kept; the key `stays` is not released."""
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
        """Release all values that are not in use."""
        with self._lock:
            for key in [k for k, e in self._entries.items() if not e.users]:
                self._release(key)
