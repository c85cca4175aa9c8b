"""Do work that takes seconds in parallel with live tracking, in a process of low priority: fit bodies, find camera
offsets.
"""

from __future__ import annotations

import contextlib
import os
import threading
import zlib
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.calibration.sync_motion import mask_tracks, silhouette_curves, solve_offsets
from hypose.errors import EvidenceError
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Frame, Silhouettes
from hypose.geometry import Array
from hypose.pipeline.live.processes import belong_to_parent, start_process
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.subject import SubjectOptions, estimate_subject

_T = TypeVar("_T")


@dataclass(frozen=True)
class KeptFrame:
    """Masks of one instant, and the depth of the person in them, compressed to save memory.

    time: s.
    shared: other people cover a part of the masks.
    bare: the frame with empty masks and depth maps.
    data: compressed masks, then ignored pixels where others cover any, then depth maps where there are any.
    """

    time: float
    shared: bool
    bare: Frame
    data: tuple[bytes, ...]

    @staticmethod
    def of(frame: Frame) -> KeptFrame:
        """Compress a frame, which must have masks."""
        masks, nothing = frame.the(Silhouettes), np.zeros((0, 0, 0), np.uint8)
        bare = Frame(frame.time, frame.index, replace(masks, masks=nothing, ignored=None, owners=None))
        arrays: list[NDArray[Any]] = [masks.masks, *([] if masks.ignored is None else [masks.ignored])]
        for depth in frame.of(Depth):
            arrays += [depth.person, np.where(depth.person > 0, depth.maps, np.float32(0))]
            bare = replace(bare, depth=replace(depth, maps=nothing.astype(np.float32), person=nothing))
        data = tuple(zlib.compress(array.tobytes(), 1) for array in arrays)
        return KeptFrame(frame.time, masks.ignored is not None, bare, data)

    def frame(self) -> Frame:
        """Restore the frame; depth outside the person is 0."""
        silhouettes, plain = self.bare.the(Silhouettes), [bytearray(zlib.decompress(data)) for data in self.data]
        width, height = silhouettes.rig.sizes.max(0).tolist()
        shape = len(silhouettes.rig), height, width
        masks, *more = [np.frombuffer(data, np.uint8).reshape(*shape, -1) for data in plain]
        ignored = more.pop(0)[..., 0] if self.shared else None
        frame = replace(self.bare, silhouettes=replace(silhouettes, masks=masks[..., 0], ignored=ignored))
        for depth in self.bare.of(Depth):
            person, maps = more
            frame = replace(frame, depth=replace(depth, person=person[..., 0], maps=maps.view(np.float32)[..., 0]))
        return frame


def fitted_body(kept: Sequence[KeptFrame], rate: float, height: float | None, seed: int) -> Body | None:
    """Fit a body to the person in the masks.

    kept: consecutive frames.
    rate: their rate, Hz.
    height: m, where known.
    seed: seed of random numbers.
    Returns: the body; None where the masks do not determine one.
    """
    frames = [replace(k.frame(), index=i) for i, k in enumerate(kept)]
    options = SubjectOptions(height=height, frame_rate=rate, seed=seed, tracked=len(frames), rate=rate)
    with contextlib.suppress(EvidenceError):
        return estimate_subject(frames.__getitem__, len(frames), options).body
    return None


def offsets_of(kept: Sequence[KeptFrame], rate: float) -> Array | None:
    """Estimate how late each camera's pictures come, from the masks of a moving person.

    kept: consecutive frames.
    rate: their rate, Hz.
    Returns: (C,) s; None where the masks do not determine it, or no camera is late.
    """
    masks = [k.frame().the(Silhouettes) for k in kept]
    tracks, rig = mask_tracks(masks), masks[0].rig
    try:
        found = solve_offsets(silhouette_curves(rig, tracks, SETTINGS.background_largest_lag_s * rate), len(rig))
    except EvidenceError:
        return None
    reported = np.isfinite(found.sd) & (found.sd < SETTINGS.background_sure)
    if found.gain < SETTINGS.background_gain or not reported.any() or np.abs(found.frames[reported]).max() < 0.5:
        return None
    return np.where(reported, found.frames, 0.0) / rate


class BackgroundWork:
    """Executor of slow work (fits of bodies, time offsets of cameras) in a process of low priority, one task after
    the other. The process runs only while there is work, since it needs as much memory as everything else.

    `body` and `offsets` return a future at once. Its result is None where the operating system ended the process
    meanwhile, for example for lack of memory; live tracking continues.

    Why a thread and a pipe instead of a pool of processes: in Python 3.11.2 the program never ends when a pool's
    process is ended while it receives masks.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="background")
        self._process: BaseProcess | None = None
        self._closed, self._changing = False, threading.Lock()

    def body(self, kept: Sequence[KeptFrame], rate: float, height: float | None, seed: int) -> Future[Body | None]:
        """Start to fit a body to the person in the masks; arguments and result are those of `fitted_body`.

        Returns: future of the body, or of None.
        """
        return self._thread.submit(self._elsewhere, fitted_body, list(kept), rate, height, seed)

    def offsets(self, kept: Sequence[KeptFrame], rate: float) -> Future[Array | None]:
        """Start to estimate how late each camera's pictures come; arguments and result are those of `offsets_of`.

        Returns: future of the offsets (C,), s, or of None.
        """
        return self._thread.submit(self._elsewhere, offsets_of, list(kept), rate)

    def close(self) -> None:
        """End the process at once, also in the middle of a fit."""
        with self._changing:
            self._closed = True
            if self._process is not None:
                self._process.terminate()
        self._thread.shutdown(wait=False)

    def _elsewhere(self, work: Callable[..., _T | None], *arguments: Any) -> _T | None:
        """Do work(*arguments) in a process, and return its result."""
        with self._changing:
            if self._closed:
                return None
            process, pipe = start_process(_work)
            self._process = process
        found = None
        with contextlib.suppress(EOFError, OSError), pipe:  # the process was ended
            pipe.send((work, arguments))
            found = pipe.recv()
        process.join()
        if isinstance(found, Exception):
            raise found
        return found


def _work(pipe: Connection) -> None:
    """Do one piece of work that the pipe brings, and send its result or its exception."""
    belong_to_parent()
    os.environ["NUMBA_NUM_THREADS"] = "1"  # live tracking needs the other cores
    cv2.setNumThreads(1)
    if hasattr(os, "SCHED_IDLE"):  # it yields at once; a process with `nice` would keep its time slice
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    elif hasattr(os, "nice"):
        os.nice(15)
    with contextlib.suppress(EOFError, OSError):  # the parent has ended
        work, arguments = pipe.recv()
        try:
            found = work(*arguments)
        except Exception as error:  # passed on to the caller
            found = error
        pipe.send(found)
