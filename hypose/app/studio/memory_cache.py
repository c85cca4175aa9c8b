"""What the studio keeps because it is dear to make: bounded in bytes, not in number, and let go when nobody asks."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field
from typing import Generic, TypeVar

IDLE_S = 300.0
"""s after which what nobody has asked for is let go."""
V = TypeVar("V")


@dataclass
class _Entry(Generic[V]):
    """value: None until it is made, under the entry's own lock: who wants another one does not wait for it."""

    value: V | None = None
    users: int = 0
    used: float = 0.0
    making: threading.Lock = field(default_factory=threading.Lock)


class Kept(Generic[V]):
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
            if entry is None:
                self._make_room()
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
                if entry.value is None and self._entries.get(key) is entry and not entry.users:
                    del self._entries[key]  # it could not be made
                self.tidy()

    def tidy(self) -> None:
        """Let go of what is too much, and of what has not been used for long."""
        with self._lock:
            total = sum(map(self._weight, self._entries.values()))
            latest = next(reversed(self._entries), None)
            for key, entry in [(k, e) for k, e in self._entries.items() if not e.users]:
                too_much = total > self._most and (key != latest or not self._one_more)
                if too_much or self._clock() - entry.used >= self._idle_s:
                    total -= self._release(key)
            if self._entries and (self._timer is None or not self._timer.is_alive()):
                self._timer = threading.Timer(self._idle_s, self._tidy_later)
                self._timer.daemon = True
                self._timer.start()

    def _make_room(self) -> None:
        """For a value that is as large as the largest: while it is made, not more is to be there than afterwards."""
        weights = [self._weight(e) for e in self._entries.values()]
        total = sum(weights) + max(weights, default=0)
        for key in [k for k, e in self._entries.items() if not e.users]:
            if total > self._most:
                total -= self._release(key)

    def _weight(self, entry: _Entry[V]) -> int:
        return 0 if entry.value is None else self._weigh(entry.value)

    def _release(self, key: Hashable) -> int:
        """Let go of the value of a key; the bytes that it had."""
        entry = self._entries.pop(key)
        weight = self._weight(entry)
        if entry.value is not None:
            self._let_go(entry.value)
        return weight

    def drop(self) -> None:
        """Let go of what is not in use."""
        with self._lock:
            for key in [k for k, e in self._entries.items() if not e.users]:
                self._release(key)

    def close(self) -> None:
        """Let go of everything."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()
            for key in list(self._entries):
                self._release(key)

    def _tidy_later(self) -> None:
        with self._lock:
            self._timer = None
            self.tidy()
