"""The live engine: the person in the pictures is tracked, judged and reported, always at the newest instant."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import CameraRig
from hypose.compute.warming import TRACKING_KERNELS, warm_up
from hypose.errors import InputError
from hypose.evidence.frame import Frame
from hypose.evidence.prefetch import make_ahead
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
from hypose.pipeline.live.live_people import STATE_LOST, STATE_TRACKING, LivePeople, LivePose
from hypose.pipeline.live.live_search import STATE_EMPTY, STATE_SEARCHING, LivePersonOptions
from hypose.pipeline.live.processes import punctual
from hypose.pipeline.settings import SETTINGS

EMPTY_ROOM = "empty room"
"""What `LiveEngine.phase` is while the room is learnt; then it is that of `LivePeople`."""


@dataclass(frozen=True)
class LiveTrackingOptions:
    """eyes: how cameras are looked at; person: see `LivePersonOptions`; people: as many are followed at most; measure:
    body and cameras' offsets are found in the background; pictures: listeners want them."""

    eyes: CaptureOptions = field(default_factory=CaptureOptions)
    person: LivePersonOptions = LivePersonOptions()
    people: int = 1
    measure: bool = True
    pictures: bool = False


@dataclass(frozen=True)
class LiveStatus:
    """How it goes. phase; words: sentences on the cause or the next step; cameras; poses: given so far,
    per_second: lately; skipped: share of the instants not processed, since a person was first followed;
    latency ms (p50, p99): from the last picture's arrival to the pose; stages ms: median time of masks (decoding
    included), tracking, reporting and judging; offsets s: of the cameras; fitted: people's bodies are their own."""

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
    """An instant: what the cameras showed, the frame that was tracked, and the pose of all people who are followed."""

    sight: CaptureResult
    frame: Frame
    poses: tuple[LivePose, ...]


class Listener(Protocol):
    """Receives the results; called by the engine's thread, so it must return at once."""

    def seen(self, seen: LiveResult, /) -> None:
        """An instant, and the poses in it."""
        ...

    def status(self, status: LiveStatus, /) -> None:
        """Every second."""
        ...


class LiveEngine:
    """`start`, then it runs until `stop`, or until all files are over or something fails (`ended`, `failed`). stop: it
    also ends when this is set from outside, even while it starts."""

    def __init__(
        self,
        rig: CameraRig,
        views: Sequence[LiveView],
        options: LiveTrackingOptions | None = None,
        listeners: Sequence[Listener] = (),
        stop: threading.Event | None = None,
    ) -> None:
        if len(views) < least_cameras(views):
            raise InputError(
                f"Live tracking needs two cameras or more, or one depth camera, and {len(views)} is given."
            )
        if any_depth(views) and (options or LiveTrackingOptions()).people > 1:
            raise InputError("Depth cameras follow one person; leave --people out.")
        self.options, self.views, self.rig = options or LiveTrackingOptions(), tuple(views), rig
        if self.options.people > 1:
            eyes = replace(self.options.eyes, silhouettes=self.options.eyes.silhouettes.of_all_people)
            self.options = replace(self.options, eyes=eyes)
        self.small = live_working_rig(rig, views)
        self.listeners = list(listeners)
        self.ended = threading.Event()
        self.failed: BaseException | None = None
        self._eyes: CaptureProcess | None = None
        self._executor = ThreadPoolExecutor(
            min(self.options.people, SETTINGS.engine_searches), thread_name_prefix="start"
        )
        self._work = BackgroundWork() if self.options.measure else None
        self._people = self._new_people()
        self._areas: deque[NDArray[np.int64]] = deque(maxlen=SETTINGS.engine_history)
        self._frames = self._poses = 0
        self._since: tuple[int, int] | None = None
        self._latency: deque[float] = deque(maxlen=SETTINGS.engine_latencies)
        self._given: deque[float] = deque(maxlen=SETTINGS.engine_latencies)
        self._stages: dict[str, deque[float]] = {k: deque(maxlen=120) for k in ("masks", "track", "tell", "judge")}
        self._reported = -np.inf
        self._sight: CaptureResult | None = None
        self._learn, self._learning = False, False
        self._poses_now: tuple[LivePose, ...] = ()
        self._offsets: tuple[float, ...] | None = None
        self._late: tuple[float, ...] = (0.0,) * len(views)
        self._stop = stop or threading.Event()
        self._until_stop = contextlib.ExitStack()
        self._thread = threading.Thread(target=self._run, name="live", daemon=True)

    def _new_people(self) -> LivePeople:
        s = self.options
        return LivePeople(self.small, s.eyes.rate, s.person, self._executor, self._work, s.people)

    def start(self) -> None:
        """Open the cameras and begin; an InputError when one cannot be opened."""
        parts = (*TRACKING_KERNELS, *(("depth",) if any_depth(self.views) else ()))
        warm_up(*parts, load=False)  # the other process finds the compiled kernels
        warm = self._executor.submit(warm_up, *parts)
        self._eyes = CaptureProcess(self.rig, self.views, self.options.eyes, self._stop)
        if self._stop.is_set():
            self._eyes.close()
            return
        warm.result()
        self._until_stop.enter_context(punctual())
        self._thread.start()

    def stop(self) -> None:
        """End; nothing is reported afterwards."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(15)
        self._until_stop.close()
        if self._eyes is not None:
            self._eyes.close()
        self._executor.shutdown(wait=False, cancel_futures=True)
        if self._work is not None:
            self._work.close()

    def learn_room(self) -> None:
        """Learn the empty room again, after the countdown."""
        self._learn = True

    @property
    def phase(self) -> str:
        """Name the phase."""
        return EMPTY_ROOM if self._learning else self._people.phase

    def _run(self) -> None:
        eyes = self._eyes
        assert eyes is not None
        try:
            eyes.ask(self._question())
            while not self._stop.is_set() and (sight := eyes.answer()) is not None:
                if self._learning and not sight.room:  # it is known now, and who was followed stands in another one
                    self._people, self._poses_now = self._new_people(), ()
                self._sight, self._learning = sight, sight.room
                eyes.ask(self._question())
                if np.isfinite(sight.time):
                    self._one(sight)
                self._tell()
        except BaseException as error:  # passed on to the caller
            self.failed = error
        finally:
            self.ended.set()

    def _question(self) -> CaptureRequest:
        phase = self._people.phase
        bodies = tuple(
            (p.body.skin(p.motion.poses[0]), p.body.coarse.faces)
            for p in self._poses_now
            if phase == STATE_TRACKING and p.motion.poses is not None
        )
        # a search has the processor: more often than it looks nothing is made
        pause = 0.5 / SETTINGS.search_slowly_hz if phase in (STATE_EMPTY, STATE_SEARCHING) else 0.0
        room, self._learn = self._learn, False
        offsets, self._offsets = self._offsets, None
        return CaptureRequest(
            pause, bodies, phase in (STATE_TRACKING, STATE_LOST), self.options.pictures, room, offsets
        )

    def _one(self, sight: CaptureResult) -> None:
        frame = self._frame(sight)
        begin = time.perf_counter()
        stepped = self._people.step(frame)
        tracked = time.perf_counter()
        self._poses_now = tuple(s.reported() for s in stepped)
        seen = LiveResult(sight, frame, self._poses_now)
        for listener in self.listeners:
            listener.seen(seen)
        if stepped:
            now, reported = time.monotonic(), time.perf_counter()
            self._since = self._since or (sight.instants, self._frames)
            self._poses += 1
            self._latency.append(now - sight.arrival)
            self._given.append(now)
            for one in stepped:
                one.look()
            looked = time.perf_counter()
            spent = {
                "masks": sight.made,
                "track": tracked - begin,
                "tell": reported - tracked,
                "judge": looked - reported,
            }
            for name, seconds in spent.items():
                self._stages[name].append(seconds)
        self._take_offsets()

    def _frame(self, sight: CaptureResult) -> Frame:
        shapes = [c.size for c in self.small]
        masks = [
            None if v is None else np.unpackbits(v[0], axis=1, count=w)
            for v, (w, _) in zip(sight.views, shapes, strict=True)
        ]
        areas = np.array([0 if m is None else int(np.count_nonzero(m)) for m in masks])
        history = np.stack(self._areas, 1) if self._areas else np.zeros((len(masks), 0), np.int64)
        if self._people.phase not in (STATE_TRACKING, STATE_LOST) or self.options.people > 1:
            history = history[:, :0]  # who comes into view changes the area, and nothing has collapsed
            self._areas.clear()
        elif self._frames % 5 == 0:
            self._areas.append(areas)
        why = flag_collapsed(areas, history, self.small.names, self._frames)
        reasons = ["no picture" if m is None else w for m, w in zip(masks, why, strict=True)]
        silhouettes = make_silhouettes(masks, self.small, reasons)
        outlines = [None if v is None else v[1] for v in sight.views]
        make_ahead(silhouettes, lambda: outlines)
        depth = depth_of(silhouettes, sight.depths) if any_depth(self.views) else None
        frame = Frame(sight.time, self._frames, silhouettes, depth=depth)
        self._frames += 1
        return frame

    def _take_offsets(self) -> None:
        """Take over what the person's motion tells of the cameras' times, once."""
        found = self._people.offsets
        if found is not None and found.any():
            # in addition to those that were known already
            self._offsets = self._late = tuple((np.array(self._late) + found).tolist())
            self._people.offsets = np.zeros(len(found))
            self._people.measure_again()

    # ---- how it goes -------------------------------------------------------------------------------------------------

    def _tell(self) -> None:
        now = time.monotonic()
        if now - self._reported >= 1.0:
            self._reported = now
            status = self.status()
            for listener in self.listeners:
                listener.status(status)

    def status(self) -> LiveStatus:
        """See `LiveStatus`."""
        sight, now = self._sight, time.monotonic()
        cameras = () if sight is None else sight.cameras
        given = np.array(self._given)  # at once: the engine's thread goes on
        latency = np.array(self._latency or [np.nan]) * 1e3
        skipped = 0.0
        if self._since is not None and sight is not None and sight.instants > self._since[0]:
            skipped = max(0.0, 1 - (self._frames - self._since[1]) / (sight.instants - self._since[0]))
        return LiveStatus(
            self.phase,
            (*_words(cameras, least_cameras(self.views)), *(() if sight is None else sight.words)),
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
        if c.received > 100 and c.loss > SETTINGS.engine_misses[0]:  # in steps: what changes is said again
            share = max(m for m in SETTINGS.engine_misses if c.loss > m)
            out.append(f"{c.name} loses more than {100 * share:.0f} % of its pictures.")
    return out
