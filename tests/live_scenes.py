"""A person who walks in front of small cameras, as live tracking is given it; an executor that works when asked; and
a clock for all of the live pipeline, which passes when the pipeline has taken what the cameras showed."""

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import numpy as np
import pytest

from benchmarks.synthetic.virtual_cameras import there_and_back
from hypose.errors import InputError
from hypose.evidence.frame import Frame
from hypose.evidence.silhouettes import make_silhouettes
from hypose.io.videos import video
from hypose.io.videos.video import CameraImage, StreamEnded
from hypose.pipeline.live import capture, engine, feeds
from hypose.pipeline.live.capture import Capture, CaptureRequest, CaptureResult
from hypose.pipeline.live.engine import LiveEngine, LiveResult
from hypose.pipeline.live.live_people import STATE_SEARCHING, LivePeople, LivePersonOptions, LivePose
from hypose.pipeline.settings import SETTINGS
from hypose.synthetic.scenes import Scene, camera_rig, make_scene
from tests.conftest import HANG_S

RATE = 25.0


class Beside(Executor):
    """What is submitted is done by `work`, so that a test says when."""

    def __init__(self) -> None:
        self.waiting: list[tuple[Future[Any], Callable[[], Any]]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.waiting.append((future, lambda: fn(*args, **kwargs)))
        return future

    def work(self) -> None:
        """All that waits."""
        done, self.waiting = self.waiting, []
        for future, call in done:
            try:
                future.set_result(call())
            except Exception as error:
                future.set_exception(error)


def nobody(frame: Frame) -> Frame:
    """The frame without anybody in it."""
    s = frame.silhouettes
    assert s is not None
    return replace(frame, silhouettes=make_silhouettes([np.zeros(c.size[::-1], np.uint8) for c in s.rig], s.rig))


def at(frame: Frame, time: float, index: int | None = None) -> Frame:
    """The frame at another time."""
    return replace(frame, time=time, index=frame.index if index is None else index)


def people_for(frames: list[Frame], executor: Executor, most: int = 1, **options: Any) -> LivePeople:
    """Those who will be followed in the frames; nothing is measured."""
    assert frames[0].silhouettes is not None
    return LivePeople(frames[0].silhouettes.rig, RATE, LivePersonOptions(**options), executor, None, most)


def follow(people: LivePeople, frames: Iterable[Frame], executor: Beside) -> list[LivePose]:
    """The poses; what has to be searched is searched between two frames."""
    poses = []
    for frame in frames:
        tracked = people.step(frame)
        for one in tracked:
            poses.append(one.pose())
            one.judge()
        if not tracked and people.phase == STATE_SEARCHING:
            executor.work()
    return poses


def seen(frame: Frame, pose: LivePose | None, missing: tuple[int, ...] = (), grey: int = 90) -> LiveResult:
    """The frame as the engine tells it, with pictures of one grey; missing: cameras that showed nothing."""
    s = frame.silhouettes
    assert s is not None
    views, jpegs = [], []
    for c, camera in enumerate(s.rig):
        w, h = camera.size
        gone = c in missing
        views.append(None if gone else (np.packbits(s.masks[c, :h, :w], axis=1), None))
        picture = np.full((h, w, 3), grey, np.uint8)
        jpegs.append(None if gone else cv2.imencode(".jpg", picture)[1].tobytes())
    captured = CaptureResult((), 1, (), False, frame.time, frame.time + 0.01, tuple(views), tuple(jpegs))
    return LiveResult(captured, frame, () if pose is None else (pose,))


# ---- the whole pipeline, whose clock waits for it -------------------------------------------------------------------


class Clock:
    """Stands in place of the module `time`: it stands still until `advance`, and what sleeps wakes when its time has
    come."""

    perf_counter = staticmethod(time.perf_counter)

    def __init__(self) -> None:
        self._now, self._ended = 1000.0, False
        self._until: dict[threading.Thread, float] = {}
        self._passes = threading.Condition()

    def monotonic(self) -> float:
        return self._now

    def sleep(self, seconds: float) -> None:
        with self._passes:
            until = self._until[threading.current_thread()] = self._now + seconds - 1e-6
            self._passes.wait_for(lambda: self._ended or self._now >= until)

    def asleep(self, thread: threading.Thread) -> bool:
        with self._passes:
            return self._until.get(thread, 0.0) > self._now

    def advance(self, seconds: float) -> None:
        with self._passes:
            self._now += seconds
            self._passes.notify_all()

    def end(self) -> None:
        """Nothing sleeps any more."""
        with self._passes:
            self._ended = True
            self._passes.notify_all()


def slow_walk() -> Scene:
    """3 s at 8 Hz by four cameras of 160 x 120 px, slow enough to be played forwards and backwards."""
    cameras = camera_rig("humaneva-4").scaled(0.25)
    return make_scene("walk", "neutral", cameras, seconds=3.0, frame_rate=8.0, seed=1, speed=0.3)


class Stage:
    """Cameras that show pictures of the empty room, and from `begin` (s) on a clip, over and over, forwards and
    backwards. gone: of a camera the span (s) in which it is unplugged."""

    def __init__(self, scene: Scene, rate: float, empty: int) -> None:
        names, self._rate, self._count = scene.given_rig.names, rate, len(scene)
        self._clips = {n: list(scene.rgb_frames(c)) for c, n in enumerate(names)}
        self._room = {n: list(scene.background_frames(c, empty)) for c, n in enumerate(names)}
        self.begin = np.inf
        self.gone: dict[str, tuple[float, float]] = {}
        self.clock = Clock()

    def shown(self, at: float) -> int:
        """The frame of the scene that is shown."""
        return int(there_and_back(round((at - self.begin) * self._rate), self._count))

    def open(self, name: str) -> "StageCamera":
        if self.away(name):
            raise InputError(f"Camera {name} cannot be opened.")
        return StageCamera(self, name)

    def away(self, name: str) -> bool:
        begin, end = self.gone.get(name, (np.inf, np.inf))
        return begin <= self.clock.monotonic() < end

    def picture(self, name: str, number: int) -> np.ndarray:
        now = self.clock.monotonic()
        room = self._room[name]
        return room[number % len(room)] if now < self.begin else self._clips[name][self.shown(now)]


class StageCamera:
    """One camera of a stage as the pipeline opens it."""

    live = True

    def __init__(self, stage: Stage, name: str) -> None:
        self._stage, self._name = stage, name

    def read(self) -> CameraImage:
        clock, rate = self._stage.clock, self._stage._rate
        number = int(clock.monotonic() * rate + 1.001)
        clock.sleep(number / rate - clock.monotonic())
        if self._stage.away(self._name):
            raise StreamEnded(f"Camera {self._name} was unplugged.")
        return CameraImage(number / rate, None, self._stage.picture(self._name, number))

    def close(self) -> None:
        pass


class CaptureInStep:
    """In place of `CaptureProcess`: in this process, and half a picture's time passes with each answer, when all that
    was begun is done: searches, and what the cameras are about to show. Then looking at it takes a millisecond. pause
    s: of the true clock, for what listens."""

    def __init__(self, clock: Clock, searches: Sequence[Future[Any]], pause: float, *given: Any) -> None:
        self._clock, self._searches, self._pause = clock, searches, pause
        *more, self._stop = given
        self._capture, self._half = Capture(*more), 0.5 / more[2].rate

    def ask(self, request: CaptureRequest) -> None:
        self._request = request

    def answer(self) -> CaptureResult | None:
        wait(self._searches)
        self._clock.advance(self._half)
        while not self._stop.wait(self._pause) and not all(map(self._has_come, self._capture._feeds)):
            time.sleep(0.001)
        captured = self._capture.look(self._request, 0.0)
        self._clock.advance(1e-3)
        self._capture.keep_up()
        over = self._capture.ended and not np.isfinite(captured.time)
        return None if over or self._stop.is_set() else captured

    def _has_come(self, feed: feeds.CameraFeed) -> bool:
        return self._clock.asleep(feed._thread) or bool(feed.status().trouble)

    def close(self) -> None:
        self._clock.end()
        self._capture.close()


def in_step(
    monkeypatch: pytest.MonkeyPatch, stage: Stage | None = None, others: Sequence[Any] = (), pause: float = 0.0
) -> Callable[..., CaptureInStep]:
    """Every `LiveEngine` that is made from now on goes by a clock that waits for it, as do other modules; with a stage
    its cameras are opened whatever their addresses. Returns what makes its capture, of what `CaptureProcess` takes."""
    clock, searches = stage.clock if stage else Clock(), list[Future[Any]]()

    class Pool(ThreadPoolExecutor):
        def submit(self, *given: Any, **named: Any) -> Future[Any]:
            searches.append(super().submit(*given, **named))
            return searches[-1]

    for module in (video, capture, engine, feeds, *others):
        monkeypatch.setattr(module, "time", clock)
    monkeypatch.setattr(engine, "ThreadPoolExecutor", Pool)
    monkeypatch.setattr(engine, "CaptureProcess", made := partial(CaptureInStep, clock, searches, pause))
    monkeypatch.setattr(feeds, "SETTINGS", replace(SETTINGS, feeds_again_s=0.01, feeds_longest_s=0.02))
    if stage:
        monkeypatch.setattr(capture, "_opener", lambda view, *_: lambda: stage.open(view.name))
    return made


def until(met: Callable[[], bool], engine: LiveEngine) -> None:
    end = time.monotonic() + HANG_S
    while not met():
        assert engine.failed is None and time.monotonic() < end, (engine.failed, engine.status())
        time.sleep(0.02)
