"""What the servers have in common: secrets are compared safely, and strangers fill no log."""

from __future__ import annotations

import hmac
import logging
import math
import re
import time
from collections.abc import Callable
from typing import Any
from urllib.parse import parse_qs

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
