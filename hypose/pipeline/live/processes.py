"""Threads and processes of live tracking: switch threads quickly, and never outlive the parent process."""

from __future__ import annotations

import contextlib
import gc
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from hypose.pipeline.settings import SETTINGS


@contextlib.contextmanager
def punctual() -> Iterator[None]:
    """Inside the context, switch between Python threads more often, and keep loaded objects out of garbage
    collection, so that live results are not delayed.
    """
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


def start_process(target: Callable[..., None], *arguments: Any) -> tuple[BaseProcess, Connection]:
    """Start target(connection, *arguments) in a process of its own, without the signal of Ctrl-C.

    Returns: the process, and our end of the connection.
    """
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=target, args=(there, *arguments), daemon=True)
    with deaf_to_ctrl_c():
        process.start()
    there.close()  # so that a thread that sends or waits notices the end of the process
    return process, here


def belong_to_parent() -> None:
    """Make the current (started) process ignore Ctrl-C, and end when its parent process ends for any reason."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent,), name="parent", daemon=True).start()


def _end_after(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)
