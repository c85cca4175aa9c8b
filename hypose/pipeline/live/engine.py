"""Live engine: track the person in the pictures at the newest instant, estimate errors, and report the results."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import CameraRig
from hypose.compute.warming import TRACKING_KERNELS, warm_up
from hypose.errors import InputError
from hypose.evidence.frame import Frame
from hypose.evidence.silhouettes import flag_collapsed, make_silhouettes
from hypose.pipeline.live.background_models import depth_of
from hypose.pipeline.live.background_work import BackgroundWork
from hypose.pipeline.live.capture import (
    CaptureOptions,
    CaptureProcess,
    CaptureRequest,
    CaptureResult,
    LiveView,
    any_depth,
    least_cameras,
    live_working_rig,
)
from hypose.pipeline.live.feeds import FeedStatus
from hypose.pipeline.live.live_people import (
    STATE_EMPTY,
    STATE_LOST,
    STATE_SEARCHING,
    STATE_TRACKING,
    LivePeople,
    LivePersonOptions,
    LivePose,
)
from hypose.pipeline.live.processes import punctual
from hypose.pipeline.settings import SETTINGS

EMPTY_ROOM = "empty room"
"""Value of `LiveEngine.phase` while the empty room is learned; afterwards it is that of `LivePeople`."""


@dataclass(frozen=True)
class LiveStatus:
    """State of a live run.

    phase: EMPTY_ROOM while the background is learned, else the phase of searching or tracking people.
    words: sentences on the cause of a problem or the next step.
    cameras: status of each camera.
    poses: number of instants with poses so far.
    per_second: recent rate of poses, Hz.
    skipped: share of instants that were not processed since a person was first tracked.
    latency: p50 and p99 of the time from the last picture's arrival to the pose, ms.
    stages: median times of masks (with decoding), tracking, reporting and judging, ms.
    offsets: delays of the cameras, s.
    fitted: every tracked person has a body of their own.
    """

    phase: str
    words: tuple[str, ...]
    cameras: tuple[FeedStatus, ...]
    poses: int
    per_second: float
    skipped: float
    latency: tuple[float, float]
    stages: Mapping[str, float]
    offsets: tuple[float, ...]
    fitted: bool


@dataclass(frozen=True)
class LiveResult:
    """Result of one instant.

    captured: what the cameras showed.
    frame: the frame that was tracked.
    poses: one per tracked person.
    """

    captured: CaptureResult
    frame: Frame
    poses: tuple[LivePose, ...]


class Listener:
    """Receiver of live results. The engine's thread calls it, so it must return at once."""

    def seen(self, seen: LiveResult, /) -> None:
        """Receive an instant and the poses in it."""

    def status(self, status: LiveStatus, /) -> None:
        """Receive the state of the run; called every second."""


class LiveEngine:
    """Live tracking. After `start` it runs until `stop`, the end of all files (`ended`) or an error (`failed`).

    rig, views: calibrated cameras, and how each is opened, in the same order.
    capture: options of capture.
    person: recipe and seed of tracking, and prior knowledge of the person.
    people: most people that are tracked.
    measure: whether bodies are fitted, and the time offsets of the cameras estimated, while tracking runs.
    listeners: receivers of the results.
    stop: event from outside that ends it too, also while it starts.
    Raises: InputError where the number of cameras does not suit.
    """

    def __init__(
        self,
        rig: CameraRig,
        views: Sequence[LiveView],
        capture: CaptureOptions | None = None,
        person: LivePersonOptions | None = None,
        *,
        people: int = 1,
        measure: bool = True,
        listeners: Sequence[Listener] = (),
        stop: threading.Event | None = None,
    ) -> None:
        if len(views) < least_cameras(views):
            raise InputError(
                f"Live tracking needs two cameras or more, or one depth camera, and {len(views)} is given."
            )
        if any_depth(views) and people > 1:
            raise InputError("Depth cameras follow one person; leave --people out.")
        self._options, self._person = capture or CaptureOptions(), person or LivePersonOptions()
        self._most = people
        if people > 1:
            self._options = replace(self._options, silhouettes=self._options.silhouettes.of_all_people)
        self.views, self.rig = tuple(views), rig
        self.small: CameraRig = live_working_rig(rig, views)
        self.listeners: list[Listener] = list(listeners)
        self.ended: threading.Event = threading.Event()
        self.failed: BaseException | None = None
        self._capture: CaptureProcess | None = None
        self._executor = ThreadPoolExecutor(min(people, 2), thread_name_prefix="start")
        self._work = BackgroundWork() if measure else None
        self._people = self._new_people()
        self._areas: deque[NDArray[np.int64]] = deque(maxlen=SETTINGS.engine_history)
        self._frames = self._poses = 0
        self._since: tuple[int, int] | None = None
        self._latency: deque[float] = deque(maxlen=SETTINGS.engine_latencies)
        self._given: deque[float] = deque(maxlen=SETTINGS.engine_latencies)
        self._stages: dict[str, deque[float]] = {k: deque(maxlen=120) for k in ("masks", "track", "tell", "judge")}
        self._reported = -np.inf
        self._captured: CaptureResult | None = None
        self._learn, self._learning = False, False
        self._poses_now: tuple[LivePose, ...] = ()
        self._offsets: tuple[float, ...] | None = None
        self._late: tuple[float, ...] = (0.0,) * len(views)
        self._stop = stop or threading.Event()
        self._until_stop = contextlib.ExitStack()
        self._thread = threading.Thread(target=self._run, name="live", daemon=True)

    def _new_people(self) -> LivePeople:
        return LivePeople(self.small, self._options.rate, self._person, self._executor, self._work, self._most)

    def start(self) -> None:
        """Open the cameras and begin.

        Raises: InputError where a camera cannot be opened.
        """
        parts = (*TRACKING_KERNELS, *(("depth",) if any_depth(self.views) else ()))
        warm_up(*parts, load=False)  # the other process finds the compiled kernels
        warm = self._executor.submit(warm_up, *parts)
        self._capture = CaptureProcess(self.rig, self.views, self._options, self._stop)
        if self._stop.is_set():
            self._capture.close()
            return
        warm.result()
        self._until_stop.enter_context(punctual())
        self._thread.start()

    def stop(self) -> None:
        """End the run; listeners receive nothing afterwards."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(15)
        self._until_stop.close()
        if self._capture is not None:
            self._capture.close()
        self._executor.shutdown(wait=False, cancel_futures=True)
        if self._work is not None:
            self._work.close()

    def learn_background(self) -> None:
        """Learn the empty room again, after the countdown."""
        self._learn = True

    @property
    def phase(self) -> str:
        """Phase of the run: EMPTY_ROOM, or the phase of `LivePeople`."""
        return EMPTY_ROOM if self._learning else self._people.phase

    def _run(self) -> None:
        capture = self._capture
        assert capture is not None
        try:
            capture.ask(self._request())
            while not self._stop.is_set() and (captured := capture.answer()) is not None:
                if (
                    self._learning and not captured.learning
                ):  # the background is known now; people tracked before have to be found again
                    self._people, self._poses_now = self._new_people(), ()
                self._captured, self._learning = captured, captured.learning
                capture.ask(self._request())
                if np.isfinite(captured.time):
                    self._one(captured)
                self._report()
        except BaseException as error:  # passed on to the caller
            self.failed = error
        finally:
            self.ended.set()

    def _request(self) -> CaptureRequest:
        phase = self._people.phase
        bodies = tuple(
            (p.body.skin(p.motion.poses[0]), p.body.coarse.faces)
            for p in self._poses_now
            if phase == STATE_TRACKING and p.motion.poses is not None
        )
        # leave the processor to a search: make no more instants than it uses
        pause = 0.5 / SETTINGS.people_fit_hz if phase in (STATE_EMPTY, STATE_SEARCHING) else 0.0
        learn, self._learn = self._learn, False
        offsets, self._offsets = self._offsets, None
        return CaptureRequest(
            pause, bodies, phase in (STATE_TRACKING, STATE_LOST), self._options.pictures, learn, offsets
        )

    def _one(self, captured: CaptureResult) -> None:
        frame = self._frame(captured)
        begin = time.perf_counter()
        people = self._people.step(frame)
        tracked = time.perf_counter()
        self._poses_now = tuple(p.pose() for p in people)
        seen = LiveResult(captured, frame, self._poses_now)
        for listener in self.listeners:
            listener.seen(seen)
        if people:
            now, reported = time.monotonic(), time.perf_counter()
            self._since = self._since or (captured.instants, self._frames)
            self._poses += 1
            self._latency.append(now - captured.arrival)
            self._given.append(now)
            for p in people:
                p.judge()
            looked = time.perf_counter()
            spent = {
                "masks": captured.made,
                "track": tracked - begin,
                "tell": reported - tracked,
                "judge": looked - reported,
            }
            for name, seconds in spent.items():
                self._stages[name].append(seconds)
        self._take_offsets()

    def _frame(self, captured: CaptureResult) -> Frame:
        shapes = [c.size for c in self.small]
        masks = [
            None if v is None else np.unpackbits(v[0], axis=1, count=w)
            for v, (w, _) in zip(captured.views, shapes, strict=True)
        ]
        areas = np.array([0 if m is None else int(np.count_nonzero(m)) for m in masks])
        history = np.stack(self._areas, 1) if self._areas else np.zeros((len(masks), 0), np.int64)
        if self._people.phase not in (STATE_TRACKING, STATE_LOST) or self._most > 1:
            history = history[:, :0]  # people who come into view change the area: that is no collapsed mask
            self._areas.clear()
        elif self._frames % 5 == 0:
            self._areas.append(areas)
        why = flag_collapsed(areas, history, self.small.names, self._frames)
        reasons = ["no picture" if m is None else w for m, w in zip(masks, why, strict=True)]
        silhouettes = make_silhouettes(masks, self.small, reasons)
        outlines = [None if v is None else v[1] for v in captured.views]
        silhouettes.announce_outlines(lambda: outlines)
        depth = depth_of(silhouettes, captured.depths) if any_depth(self.views) else None
        frame = Frame(captured.time, self._frames, silhouettes, depth=depth)
        self._frames += 1
        return frame

    def _take_offsets(self) -> None:
        """Apply the camera offsets that were found from the person's motion, once."""
        found = self._people.offsets
        if found is not None and found.any():
            # in addition to the offsets applied before
            self._offsets = self._late = tuple((np.array(self._late) + found).tolist())
            self._people.offsets = np.zeros(len(found))
            self._people.measure_again()

    # ---- state of the run --------------------------------------------------------------------------------------------

    def _report(self) -> None:
        now = time.monotonic()
        if now - self._reported >= 1.0:
            self._reported = now
            status = self.status()
            for listener in self.listeners:
                listener.status(status)

    def status(self) -> LiveStatus:
        """Return the state of the run: phase, cameras, rate, latency."""
        captured, now = self._captured, time.monotonic()
        cameras = () if captured is None else captured.cameras
        given = np.array(self._given)  # a copy, since the engine's thread continues
        latency = np.array(self._latency or [np.nan]) * 1e3
        skipped = 0.0
        if self._since is not None and captured is not None and captured.instants > self._since[0]:
            skipped = max(0.0, 1 - (self._frames - self._since[1]) / (captured.instants - self._since[0]))
        return LiveStatus(
            self.phase,
            (*_words(cameras, least_cameras(self.views)), *(() if captured is None else captured.words)),
            cameras,
            self._poses,
            float((now - given < 2.0).sum()) / 2.0,
            skipped,
            (float(np.percentile(latency, 50)), float(np.percentile(latency, 99))),
            {k: float(1e3 * np.median(v)) if v else float("nan") for k, v in self._stages.items()},
            self._late,
            self._people.fitted,
        )


def _words(cameras: Sequence[FeedStatus], least: int) -> list[str]:
    out = [f"{c.name} {'has ended' if c.ended else 'is missing'}: {c.trouble}" for c in cameras if c.trouble]
    if sum(not c.trouble for c in cameras) < least <= len(cameras):
        some = "Fewer than two cameras show" if least > 1 else "No camera shows"
        out.append(f"{some} anything, so nobody can be followed.")
    for c in cameras:
        if (
            c.received > 100 and c.loss > SETTINGS.engine_misses[0]
        ):  # in steps, so that the sentence is repeated only when the share changes
            share = max(m for m in SETTINGS.engine_misses if c.loss > m)
            out.append(f"{c.name} loses more than {100 * share:.0f} % of its pictures.")
    return out
