"""Somebody who walks in front of small cameras, as live tracking is given it; an executor that works when told to."""

from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from hypose.evidence.frame import Frame
from hypose.evidence.silhouettes import make_silhouettes
from hypose.pipeline.live.engine import Seen
from hypose.pipeline.live.eyes import Sight
from hypose.pipeline.live.live_people import LivePeople
from hypose.pipeline.live.live_person import LivePose
from hypose.pipeline.live.live_search import LOOKING, LivePersonOptions

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


def people_for(frames: list[Frame], beside: Executor, most: int = 1, **options: Any) -> LivePeople:
    """Those who will be followed in the frames; nothing is measured."""
    assert frames[0].silhouettes is not None
    return LivePeople(frames[0].silhouettes.rig, RATE, LivePersonOptions(**options), beside, None, most)


def follow(people: LivePeople, frames: Iterable[Frame], beside: Beside) -> list[LivePose]:
    """The poses; what has to be searched is searched between two frames."""
    poses = []
    for frame in frames:
        stepped = people.step(frame)
        for one in stepped:
            poses.append(one.told())
            one.look()
        if not stepped and people.phase == LOOKING:
            beside.work()
    return poses


def seen(frame: Frame, pose: LivePose | None, missing: tuple[int, ...] = (), grey: int = 90) -> Seen:
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
    sight = Sight(frame.time, frame.time + 0.01, tuple(views), tuple(jpegs), (), 1, (), False)
    return Seen(sight, frame, () if pose is None else (pose,))
