"""Live cameras as they are followed: the engine of `hypose live` inside the studio, with small pictures and masks."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from starlette.concurrency import run_in_threadpool

from hypose.app.live.pose_outputs import PoseOutputs, pose_json, status_json
from hypose.app.live.servers import Outbox
from hypose.app.studio.answers import NotNow
from hypose.app.studio.asked import number, text, whole
from hypose.app.studio.catalog import Catalog
from hypose.app.studio.live_socket import recording_folder, target
from hypose.body.ready_bodies import human
from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.io.videos.camera_sources import Shot, is_device
from hypose.pipeline.live.engine import MOST_PEOPLE, LiveEngine, LiveOptions, LiveStatus, Seen
from hypose.pipeline.live.eyes import EyesOptions
from hypose.pipeline.live.live_rig import LiveRig, live_rig
from hypose.pipeline.live.live_search import LivePersonOptions
from hypose.pipeline.live.recorder import LiveRecorder

PICTURES_S = 0.25
"""s between two pictures of the cameras on the page"""
_WIDTH, _QUALITY = 320, 70
_TINT = np.array([90, 200, 255], np.float32)
_STREAMS = ("http://", "https://", "rtsp://")


class CameraHost:
    """See `LiveHost`: one engine per server. folder: where recordings go."""

    def __init__(self, catalog: Catalog, folder: Path) -> None:
        self._catalog, self._folder = catalog, folder
        self._engine: LiveEngine | None = None
        self._outputs: PoseOutputs | None = None
        self._recorder: LiveRecorder | None = None
        self._page: _Page | None = None
        self._told: dict[str, Any] = {}
        self.acts: Mapping[str, Callable[[], None]] = {"room": self._learn_room}
        self._changing = asyncio.Lock()
        self._watching: asyncio.Task[None] | None = None

    def hello(self) -> dict[str, Any]:
        """See `LiveHost`."""
        s = human().skeleton
        running = False if self._engine is None else self._told
        return {"t": "hello", "running": running, "joints": s.joint_names, "parents": [int(p) for p in s.parents]}

    async def start(self, message: dict[str, Any]) -> None:
        """recording: id of one with calibrated cameras; sources: where each camera is, by name, empty: its videos are
        played; countdown s; people: at most so many; record, osc, vmc as for the fusion."""
        recording = self._catalog.find("recording", text(message.get("recording"), "recording", 200, "choose one"))
        sources = _sources(message.get("sources") or {})
        countdown = number(message.get("countdown", 5), "the countdown", 0, 600)
        rate = number(message["rate"], "the rate", 1, 240) if message.get("rate") else None
        ws = whole(message.get("ws", 0), "the ws port", 0, 65535)
        people = whole(message.get("people", 1), "the number of people", 1, MOST_PEOPLE)
        osc, vmc = (target(message.get(k), port) for k, port in (("osc", 9000), ("vmc", 39539)))
        async with self._changing:
            if self._engine is not None:
                raise NotNow("Live tracking is running already; stop it first.")
            loop = asyncio.get_running_loop()
            cameras = await run_in_threadpool(live_rig, recording.path, sources, rate)
            names = tuple(v.name for v in cameras.views)
            record = recording_folder(self._folder, "cameras") if message.get("record") is True else None
            recorder = None
            async with contextlib.AsyncExitStack() as undone:  # what was begun, when the rest cannot be
                outputs = PoseOutputs(names, cameras.rate, ws=ws, osc=osc, vmc=vmc, clock=time.monotonic)
                undone.push_async_callback(run_in_threadpool, outputs.close)
                if record is not None:
                    recorder = LiveRecorder(record, cameras.rig, cameras.views, cameras.silhouettes, cameras.height)
                    undone.push_async_callback(run_in_threadpool, recorder.close)
                page = _Page(loop, names, cameras.rig)
                undone.callback(page.close)
                engine = _engine(cameras, countdown, people, [outputs, page, *([recorder] if recorder else [])])
                undone.push_async_callback(run_in_threadpool, engine.stop)
                await run_in_threadpool(engine.start)
                undone.pop_all()
            self._watching = asyncio.ensure_future(self._watch(engine, page))
            self._engine, self._outputs, self._recorder, self._page = engine, outputs, recorder, page
            port = outputs.listeners.port if outputs.listeners is not None else 0
            shown = None if record is None else f"{record.parent.name}/{record.name}"
            played = not sources
            self._told = {
                "recording": recording.id, "cameras": names, "ws": port, "osc": osc, "vmc": vmc, "record": shown,
                "played": played,
            }  # fmt: skip

    def _learn_room(self) -> None:
        if self._engine is None:
            raise NotNow("The empty room is learnt while the cameras run; start them.")
        self._engine.learn_room()

    async def _watch(self, engine: LiveEngine, page: _Page) -> None:
        """Files are over, or something has failed: it ends, and that is said."""
        recorder, told = self._recorder, False
        while not engine.ended.is_set():
            await asyncio.sleep(0.2)
            if recorder is not None and recorder.failed and not told:
                told = True
                page.tell({"t": "said", "text": recorder.failed})
        if self._engine is engine:
            said = await self.stop()
            page.tell({"t": "said", "text": said or "All videos are over."})
            page.tell(self.hello())

    async def stop(self) -> str | None:
        """See `LiveHost`."""
        async with self._changing:
            engine, self._engine = self._engine, None
            if engine is None:
                return None
            await run_in_threadpool(engine.stop)
            assert self._outputs is not None and self._page is not None
            await run_in_threadpool(self._outputs.close)
            self._page.close()
            recorder, self._recorder = self._recorder, None
            said = [] if engine.failed is None else [f"It ended: {str(engine.failed).rstrip('.')}."]
            if recorder is not None:
                said.append(await run_in_threadpool(_recorded, recorder))
            return " ".join(said) or None

    def listen(self, queue: asyncio.Queue[str]) -> None:
        """See `LiveHost`."""
        if self._page is not None and self._engine is not None:
            self._page.outbox.join(queue)

    def unlisten(self, queue: asyncio.Queue[str]) -> None:
        """See `LiveHost`."""
        if self._page is not None:
            self._page.outbox.leave(queue)


def _recorded(recorder: LiveRecorder) -> str:
    """End a recording; what is to be said."""
    try:
        if not recorder.close():
            return "Nothing was recorded: no instant was seen after the empty room was known."
    except InputError as error:
        return str(error)
    without = f", without {recorder.left_out} instants" if recorder.left_out else ""
    return f"Recorded as {recorder.folder.parent.name}/{recorder.folder.name}{without}."


def _engine(cameras: LiveRig, countdown: float, people: int, listeners: list[Any]) -> LiveEngine:
    eyes = EyesOptions(cameras.rate, countdown, cameras.silhouettes)
    options = LiveOptions(eyes, LivePersonOptions(height=cameras.height), people, pictures=True)
    return LiveEngine(cameras.rig, cameras.views, options, listeners)


def _sources(value: Any) -> dict[str, str]:
    """Devices and streams: a page opens no files."""
    if not isinstance(value, dict):
        raise InputError("The cameras' places are no object; give the place of each by its name.")
    out = {str(k): text(v, f"place of camera {k}", 500, "give its number or address").strip() for k, v in value.items()}
    for name, where in out.items():
        if not is_device(where) and not where.lower().startswith(_STREAMS):
            raise InputError(
                f"Camera {name} cannot be at {where!r}; give the number of a camera of this computer, or an address "
                f"that begins with {', '.join(_STREAMS)}."
            )
    return out


class _Page:
    """A listener of the engine that tells pages: every pose, how it goes, and now and then small pictures."""

    def __init__(self, loop: asyncio.AbstractEventLoop, cameras: tuple[str, ...], rig: CameraRig) -> None:
        self.outbox = Outbox()
        self._loop, self._cameras = loop, cameras
        self._places = [np.linalg.inv(c.camera_from_world).round(4).tolist() for c in rig]
        self._newest: Seen | None = None
        self._drawn = -np.inf
        self._wake, self._ended = threading.Event(), False
        self._thread = threading.Thread(target=self._draw, name="pictures", daemon=True)
        self._thread.start()

    def seen(self, seen: Seen) -> None:
        """See `Listener`."""
        now, people = time.monotonic(), []
        for pose in seen.poses:
            person = json.loads(pose_json(pose, now - seen.sight.arrival, self._cameras))
            people.append(person | {"seen": not pose.lost, "sensors": person["cameras"]})
        if people:
            first = people[0]
            frame = {"t": "frame", "n": first["n"], "time": first["time"], "latency_ms": first["latency_ms"]}
            self._post({**frame, "people": people})
        if now - self._drawn >= PICTURES_S:
            self._drawn, self._newest = now, seen
            self._wake.set()

    def status(self, status: LiveStatus) -> None:
        """See `Listener`."""
        told: dict[str, Any] = json.loads(status_json(status))
        del told["type"]
        alive = {c.name: not c.trouble for c in status.cameras}
        for camera, place in zip(told["cameras"], self._places, strict=False):
            camera |= {"alive": alive[camera["name"]], "registered": True, "residual": None, "place": place}
        self._post({**told, "t": "status", "sensors": told.pop("cameras")})

    def close(self) -> None:
        """No more pictures."""
        self._ended = True
        self._wake.set()
        self._thread.join(5)

    def _post(self, message: dict[str, Any] | str) -> None:
        self._loop.call_soon_threadsafe(self.tell, message)

    def tell(self, message: dict[str, Any] | str) -> None:
        """A message to all pages; in the server's loop."""
        self.outbox.post(message if isinstance(message, str) else json.dumps(message))

    def _draw(self) -> None:
        while not self._ended:
            self._wake.wait()
            self._wake.clear()
            seen = self._newest
            if seen is not None and self.outbox:
                views = zip(self._cameras, seen.sight.jpegs, seen.sight.views, strict=True)
                pictures = [{"name": n, "jpeg": _picture(j, None if v is None else v[0])} for n, j, v in views]
                self._post({"t": "pictures", "cameras": pictures})


def _picture(jpeg: bytes | None, bits: np.ndarray | None) -> str | None:
    """A small picture with the mask as a tint, base64; None without a picture."""
    if jpeg is None:
        return None
    image = Shot(0.0, None, jpeg).picture((_WIDTH, 1))
    if image is None:
        return None
    size = _WIDTH, max(1, round(_WIDTH * image.shape[0] / image.shape[1]))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    if bits is not None:
        mask = np.unpackbits(bits, axis=1)
        inside = cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST) > 0
        small[inside] = (0.55 * small[inside] + 0.45 * _TINT).astype(np.uint8)
    ok, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return base64.b64encode(data.tobytes()).decode() if ok else None
