"""Capture for live tracking: read cameras, choose instants and make masks, in a process of its own so that tracking has
the Python interpreter to itself.

An instant is a time of which all present cameras have sent the nearest picture. `Capture.look` gives the newest instant
not processed yet; nothing queues up, so a slow tracker skips instants instead of falling behind. `CaptureProcess` runs
it in another process; while the caller works on one result, the next is prepared.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import CameraRig
from hypose.compute.warming import warm_up
from hypose.errors import HyposeError, InputError
from hypose.evidence.background import BackgroundModel
from hypose.evidence.depth_background import DepthBackground
from hypose.evidence.outlines import ViewOutline
from hypose.evidence.people import BodyShape
from hypose.evidence.silhouettes import SilhouetteSettings
from hypose.geometry import Array, Mask
from hypose.io.keypoints.detectors import open_network
from hypose.io.recordings.frames import working_rig
from hypose.io.sensors.depth import DEPTH_PNG, open_depth_camera
from hypose.io.videos.video import CameraImage, CameraSource, open_camera
from hypose.pipeline.live.background_models import DepthViewBackground, NetworkBackground, ViewBackground
from hypose.pipeline.live.feeds import CameraFeed, FeedStatus, newest_instant
from hypose.pipeline.live.processes import belong_to_parent, punctual, start_process
from hypose.pipeline.settings import SETTINGS


@dataclass(frozen=True)
class LiveView:
    """One camera of a live run.

    name: name of the camera.
    address: device number, URL, video or folder of pictures, as `open_camera` takes it.
    shift: (x, y) offset that is added to positions in the stored pictures, px of the calibrated size.
    background: background model of the empty room, where known.
    stretched: accept pictures of another shape than calibrated.
    depth: it is a depth camera (`open_depth_camera`).
    depth_background: background of a depth camera, where known.
    loop_s: period after which a video begins again, s; None: it ends.
    """

    name: str
    address: str
    shift: tuple[float, float] = (0.0, 0.0)
    background: BackgroundModel | None = None
    stretched: bool = False
    depth: bool = False
    depth_background: DepthBackground | None = None
    loop_s: float | None = None


@dataclass(frozen=True)
class CaptureOptions:
    """Options of capture.

    rate: rate of the cameras, Hz; requested from devices, and assumed for files without a rate.
    countdown: before the empty room is learned, s.
    silhouettes: how masks are made.
    network: most people that a network finds where the background is not known; 0: the background is learned.
    pictures: whether the results for listeners contain the pictures.
    """

    rate: float = 30.0
    countdown: float = 5.0
    silhouettes: SilhouetteSettings = field(default_factory=SilhouetteSettings)
    network: int = 0
    pictures: bool = False


@dataclass(frozen=True)
class CaptureRequest:
    """Request for one capture result.

    pause: time from the last instant to the next wanted one, s.
    bodies: vertices (V, 3) m and faces (F, 3) of the tracked people; empty: their places are not known.
    following: whether a person is being tracked.
    pictures: pictures are wanted too.
    learn: learn the empty room again.
    offsets: (C,) delays of the cameras, s; None: unchanged.
    """

    pause: float = 0.0
    bodies: tuple[tuple[Array, NDArray[np.int32]], ...] = ()
    following: bool = False
    pictures: bool = False
    learn: bool = False
    offsets: tuple[float, ...] | None = None


@dataclass(frozen=True)
class CaptureResult:
    """Masks and pictures of one instant from all cameras, with the state of the cameras; without an instant yet,
    only the state (time is NaN).

    time: on the common clock, s.
    arrival: time of arrival of its last picture, on this computer's clock, s.
    views: per camera, packed mask (h, ceil(w / 8)) and its outline (None: empty mask); None for a camera without a
        picture.
    jpegs: pictures as they were stored, where wanted.
    cameras: status of each camera.
    instants: number of instants so far.
    words: sentences on the next step or the cause of a failure.
    learning: the empty room is being learned.
    made: time spent on the masks, s.
    depths: (h, w) mm of each depth camera.
    empty: depth maps of the empty room as PNG, per camera, after the room was learned.
    """

    cameras: tuple[FeedStatus, ...]
    instants: int
    words: tuple[str, ...]
    learning: bool = False
    time: float = float("nan")
    arrival: float = float("nan")
    views: tuple[tuple[NDArray[np.uint8], ViewOutline | None] | None, ...] = ()
    jpegs: tuple[bytes | None, ...] = ()
    made: float = 0.0
    depths: tuple[NDArray[np.uint16] | None, ...] = ()
    empty: tuple[tuple[bytes, ...], ...] = ()


class Capture:
    """Cameras of a live run with their masks. Call `look` repeatedly, `keep_up` after each result was sent, and `close`
    at the end.

    Raises: InputError where a camera cannot be opened.
    """

    def __init__(self, rig: CameraRig, views: Sequence[LiveView], options: CaptureOptions) -> None:
        self._views, self._options, self.small = tuple(views), options, live_working_rig(rig, views)
        self._sizes, self._wrong = tuple(c.size for c in rig), [""] * len(views)
        self._arrived = threading.Condition()
        network = replace(open_network(), people=options.network) if options.network else None
        begin = time.monotonic() + 0.3
        self._feeds = [
            CameraFeed(v.name, _opener(v, c.size, options.rate, begin), self._arrived)
            for v, c in zip(views, rig, strict=True)
        ]
        shapes = zip(views, rig, self.small, strict=True)
        self._backgrounds = [
            DepthViewBackground(c, small, v.shift, v.depth_background)
            if v.depth
            else NetworkBackground(c, small, v.shift, network)
            if v.background is None and network is not None
            else ViewBackground(c, small, v.shift, options.silhouettes, v.background)
            for v, c, small in shapes
        ]
        self._least = least_cameras(views)
        self._pool = ThreadPoolExecutor(2, thread_name_prefix="masks")
        self._last, self._instants = -np.inf, 0
        self._learn_from: float | None = None
        self._pictures: list[list[NDArray[Any]]] = [[] for _ in views]
        self._moved: tuple[str, ...] = ()
        self._empty: tuple[list[NDArray[Any]], ...] = ()
        self._to_follow: list[tuple[ViewBackground, int, NDArray[Any], float, CaptureRequest]] = []
        try:
            for feed in self._feeds:
                feed.start()
        except InputError:
            for feed in self._feeds:
                feed.stop()
            raise
        if any(b.background is None for b in self._backgrounds):
            self._start_learning()

    def close(self) -> None:
        """Release the cameras."""
        for feed in self._feeds:
            feed.end()
        for feed in self._feeds:
            feed.stop()
        self._pool.shutdown(cancel_futures=True)

    @property
    def ended(self) -> bool:
        """Whether all cameras are files that are over."""
        return all(f.status().ended for f in self._feeds)

    def look(self, request: CaptureRequest, wait: float = 0.1) -> CaptureResult:
        """Make the masks of the newest instant, with pictures and depth where requested; after `wait` seconds without
        an instant, return the state of the cameras only.
        """
        if request.learn:
            self._start_learning()
        if request.offsets is not None:
            with self._arrived:
                for feed, late in zip(self._feeds, request.offsets, strict=True):
                    feed.offset, feed.ahead = late, max(request.offsets) - late
        until = time.monotonic() + wait
        while (found := self._newest(request.pause, until)) is None:
            if time.monotonic() >= until:
                return self._result()
        at, shots = found
        self._count(at)
        self._last = at
        if self._learn_from is not None:
            self._learn(shots)
            return self._result()
        begin = time.perf_counter()
        tasks = [
            None if shot is None else self._pool.submit(self._view, c, shot, at, request)
            for c, shot in enumerate(shots)
        ]
        views = tuple(None if task is None else task.result() for task in tasks)
        made = time.perf_counter() - begin
        jpegs = tuple(None if shot is None or not request.pictures else stored(shot.picture) for shot in shots)
        arrival = max(s.arrival for s in shots if s is not None)
        depths = tuple(
            b.seen if isinstance(b, DepthViewBackground) and v is not None else None
            for b, v in zip(self._backgrounds, views, strict=True)
        )
        empty: tuple[tuple[bytes, ...], ...] = ()
        if request.pictures:
            empty, self._empty = tuple(tuple(filter(None, map(stored, maps))) for maps in self._empty), ()
        about = {"time": at, "arrival": arrival, "views": views, "jpegs": jpegs, "made": made}
        return self._result(**about, depths=depths, empty=empty)

    def keep_up(self) -> None:
        """Update the backgrounds to slow changes of the scene, such as light, from the pictures of the last results."""
        for background, view, image, at, request in self._to_follow:
            background.follow(image, at, self._covered(view, request.bodies) if request.bodies else None)
        self._to_follow = []

    def _result(self, **shown: Any) -> CaptureResult:
        """Make the result of an instant; without `shown`, its fields, it holds the state of the cameras only."""
        cameras, learning = tuple(f.status() for f in self._feeds), self._learn_from is not None
        return CaptureResult(cameras, self._instants, self._words(), learning, **shown)

    def _newest(self, pause: float, until: float) -> tuple[float, list[CameraImage | None]] | None:
        with self._arrived:
            now = time.monotonic()
            reported = [feed.delivered() for feed in self._feeds]
            instant, wait = newest_instant([d for d, _ in reported], self._last + pause, now, self._least)
            if instant is None:
                self._arrived.wait(max(min(wait, until) - now, 0.0005))
                return None
            pairs = zip(reported, instant.shots, strict=True)
            return instant.time, [None if k is None else shots[k] for (_, shots), k in pairs]

    def _count(self, at: float) -> None:
        """Count the instants that have passed since the last one that was returned."""
        periods = [1 / s.rate for s in (f.status() for f in self._feeds) if s.rate > 0]
        known = periods and np.isfinite(self._last)
        self._instants += max(1, round((at - self._last) / float(np.median(periods)))) if known else 1

    def _view(
        self, view: int, shot: CameraImage, at: float, request: CaptureRequest
    ) -> tuple[NDArray[np.uint8], ViewOutline | None] | None:
        background, image = self._backgrounds[view], self._picture(view, shot)
        if image is None:
            return None
        mask, outline = background.mask(image)
        turn = int(at * len(self._backgrounds)) % len(self._backgrounds) == view  # not all views in one instant
        wanted = turn and (request.bodies or not request.following)
        if wanted and isinstance(background, ViewBackground) and background.due(at):
            self._to_follow.append((background, view, image, at, request))
        return np.packbits(mask, axis=1), outline

    def _picture(self, view: int, shot: CameraImage) -> NDArray[Any] | None:
        """Get the picture of a view; None where it is of another shape than calibrated (a turned telephone, a wide
        picture of a camera calibrated with a narrow one).
        """
        image, (cw, ch), name = shot.picture, self._sizes[view], self._views[view].name
        h, w = image.shape[:2]
        wrong = not self._views[view].stretched and abs(w * ch - h * cw) > SETTINGS.capture_other_shape * h * cw
        turned = abs(w * cw - h * ch) <= SETTINGS.capture_other_shape * h * ch
        self._wrong[view] = (
            f"{name} shows pictures of {w} x {h} px and is calibrated for {cw} x {ch} px; "
            + ("turn it back." if turned else "set it to pictures of that shape, or calibrate it as it is.")
            if wrong
            else ""
        )
        return None if wrong else image

    def _covered(self, view: int, bodies: Sequence[tuple[Array, NDArray[np.int32]]]) -> Mask:
        """Draw the mask of the bodies in a view."""
        out = np.zeros(self.small[view].size[::-1], np.uint8)
        for vertices, faces in bodies:
            shape = BodyShape(vertices, faces, self.small)
            y0, y1, x0, x1 = shape.boxes[view]
            out[y0:y1, x0:x1] |= shape.drawn(view)
        return out

    # ---- the empty room ----------------------------------------------------------------------------------------------

    def _start_learning(self) -> None:
        self._learn_from = time.monotonic() + self._options.countdown
        self._pictures = [[] for _ in self._views]

    def _learn(self, shots: Sequence[CameraImage | None]) -> None:
        assert self._learn_from is not None
        passed = time.monotonic() - self._learn_from
        if passed < 0:
            return
        for view, (kept, shot) in enumerate(zip(self._pictures, shots, strict=True)):
            if (
                shot is not None
                and len(kept) <= min(passed / SETTINGS.capture_empty_s, 1.0) * SETTINGS.capture_empty_pictures
            ):
                image = self._picture(view, shot)
                if image is not None:
                    kept.append(image)
        if passed < SETTINGS.capture_empty_s or any(len(k) < 3 for k in self._pictures):
            return
        moved = []
        for view, background, images in zip(self._views, self._backgrounds, self._pictures, strict=True):
            background.learn(images)
            if background.moved:
                moved.append(
                    f"{view.name} saw something move while the empty room was learnt; leave its view, and learn it "
                    "again."
                )
        depth = zip(self._views, self._pictures, strict=True)
        self._empty = tuple(images if view.depth else [] for view, images in depth) if any_depth(self._views) else ()
        self._moved, self._learn_from, self._pictures = tuple(moved), None, [[] for _ in self._views]

    def _words(self) -> tuple[str, ...]:
        out = [*self._moved, *filter(None, self._wrong)]
        if self._learn_from is not None:
            left = self._learn_from - time.monotonic()
            out.append(f"Leave the cameras' view: {left:.0f} s." if left > 0 else "Learning the empty room.")
        return tuple(out)


def live_working_rig(rig: CameraRig, views: Sequence[LiveView]) -> CameraRig:
    """Return the cameras at the working size."""
    return working_rig(rig, depth=[v.depth for v in views])


def least_cameras(views: Sequence[LiveView]) -> int:
    """Return the least number of cameras that can track a person: one where there is a depth camera, else two."""
    return 1 if any_depth(views) else 2


def any_depth(views: Sequence[LiveView]) -> bool:
    """Return whether one of the views is a depth camera."""
    return any(v.depth for v in views)


def stored(image: NDArray[Any]) -> bytes | None:
    """Encode a picture as JPEG, or a depth map (H, W) m as 16-bit PNG in millimetres; None where that fails."""
    if image.ndim == 2:
        ok, data = cv2.imencode(".png", np.minimum(image * 1000 + 0.5, 65535).astype(np.uint16), DEPTH_PNG)
    else:
        ok, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, SETTINGS.capture_quality])
    return data.tobytes() if ok else None


def _opener(view: LiveView, size: tuple[int, int], rate: float, begin: float) -> Callable[[], CameraSource]:
    if view.depth:
        return lambda: open_depth_camera(view.address, rate, begin)
    return lambda: open_camera(view.address, rate, size, begin, view.loop_s)


# ---- in a process of their own -------------------------------------------------------------------------------------


class CaptureProcess:
    """Cameras with their masks in another process: call `ask` to send a request, and `answer` to receive its result;
    between the two the caller can do other work.

    stop: event; once it is set, no call waits any more, also while cameras are being opened, and only `close` may be
        called.
    Raises: InputError where a camera cannot be opened.
    """

    def __init__(
        self, rig: CameraRig, views: Sequence[LiveView], options: CaptureOptions, stop: threading.Event | None = None
    ) -> None:
        self._stop, self._closing_s = stop or threading.Event(), 0.0
        self._process, self._pipe = start_process(_run, rig, tuple(views), options)
        if self.answer(math.inf) is not None:  # opening a camera has a time limit of its own
            self._closing_s = SETTINGS.capture_closing_s

    def ask(self, request: CaptureRequest) -> None:
        """Send a request."""
        with contextlib.suppress(OSError):  # `answer` reports it
            self._pipe.send(request)

    def answer(self, wait: float = 10.0) -> CaptureResult | None:
        """Receive the result of the last request; None where all files have been read to their end, or `stop` is
        set.

        wait: longest time of waiting, s.
        """
        waited = 0.0
        try:
            while waited < wait:  # counted, not by the clock: a process that was stopped and goes on has not waited
                if self._pipe.poll(SETTINGS.capture_look_s):
                    found = self._pipe.recv()
                    if isinstance(found, HyposeError):
                        raise found
                    return found
                if self._stop.is_set():
                    return None
                waited += SETTINGS.capture_look_s
            what = f"has not answered for {wait:.0f} s"
        except (EOFError, OSError):
            what = "has ended"
        raise InputError(f"The process that looks at the cameras {what}; start again.")

    def close(self) -> None:
        """End the process."""
        self._pipe.close()  # the process may be sending a large result that nothing receives any more
        self._process.join(self._closing_s)
        if self._process.is_alive():  # a camera that does not answer blocks the process
            self._process.kill()
            self._process.join(1)


def _run(pipe: Connection, rig: CameraRig, views: tuple[LiveView, ...], options: CaptureOptions) -> None:
    belong_to_parent()
    warm_up("outlines", "pictures")  # compile now, so that the first pictures are not late
    with contextlib.suppress(EOFError, OSError):  # the asking process is gone
        try:
            capture = Capture(rig, views, options)
        except HyposeError as error:
            pipe.send(error)
            return
        with contextlib.closing(capture), punctual():
            pipe.send(True)
            while True:
                captured = capture.look(pipe.recv())
                over = capture.ended and not np.isfinite(captured.time)
                pipe.send(None if over else captured)
                capture.keep_up()
