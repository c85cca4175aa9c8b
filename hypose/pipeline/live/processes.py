"""Threads and processes of live tracking: switch threads quickly, and never outlive the parent process."""

from __future__ import annotations

import contextlib
import gc
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from multiprocessing.process import BaseProcess

from hypose.pipeline.settings import SETTINGS


@contextlib.contextmanager
def punctual() -> Iterator[None]:
    """Switch threads often and keep loaded objects out of garbage collection, inside the context."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(SETTINGS.processes_switch_s)
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)


@contextlib.contextmanager
def deaf_to_ctrl_c() -> Iterator[None]:
    """Start processes inside the context without the signal of Ctrl-C, from their first moment on. Why: a terminal
    sends it to all processes, and one that is still importing would print a traceback.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def belong_to_parent() -> None:
    """Ignore Ctrl-C in a started process, and end it when its parent ends, in whatever way."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent,), name="parent", daemon=True).start()


def _end_after(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)
