"""Python's own delays: a thread that computes keeps the interpreter, and a collection of garbage stops everybody."""

from __future__ import annotations

import contextlib
import gc
import sys
from collections.abc import Iterator

_SWITCH_S = 0.0005
"""s that who takes or sends pictures waits at most for who computes; Python's own 5 ms are a share of a frame's time"""


@contextlib.contextmanager
def punctual() -> Iterator[None]:
    """Meanwhile threads take turns often, and what is loaded now is never looked through for garbage."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_S)
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)
