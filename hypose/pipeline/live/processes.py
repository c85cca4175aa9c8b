"""Threads and processes of live tracking: punctual ones, and ones that never outlive the process that started them."""

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
    """Meanwhile threads take turns often, and all that is loaded now is never looked through for garbage."""
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
    """Processes that are started meanwhile do not hear Ctrl-C, which a terminal sends to all of its processes, from
    their first moment on: while they are still importing, nothing else keeps a traceback from the terminal."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def belong_to_parent() -> None:
    """In a process that was started: Ctrl-C is left to the parent process, and this one ends with the parent, however
    that ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent,), name="parent", daemon=True).start()


def _end_after(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)
