"""Live topics of the studio: the fusion of `hypose fuse --live`, and the cameras of `hypose live`."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import shutil
import time
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from starlette.concurrency import run_in_threadpool

from hypose.app.live import simulated_sensors
from hypose.app.live.live_server import LiveServer
from hypose.app.live.pose_outputs import TrackingRun, pose_json, status_json
from hypose.app.reports.result_pictures import jpeg
from hypose.app.studio.catalog import Catalog
from hypose.app.studio.http import Message, NotNow, Topic, request_number, text, whole
from hypose.body.default_body import human
from hypose.errors import InputError
from hypose.fusion.joints import COMMON, PARENT
from hypose.io.files import free_path, natural_key
from hypose.io.videos.video import is_device
from hypose.pipeline.live.capture import CaptureOptions
from hypose.pipeline.live.engine import LiveResult, LiveStatus
from hypose.pipeline.live.live_people import LivePersonOptions
from hypose.pipeline.live.live_rig import LiveRig, live_rig
from hypose.pipeline.settings import SETTINGS

_FOLDER = "live"
"""Folder for recordings in the served folder."""
PICTURES_S = 0.25
"""Time between two pictures of the cameras on the page, s."""
_WIDTH, _QUALITY = 320, 70
_TINT = np.array([90, 200, 255], np.float32)
_STREAMS = ("http://", "https://", "rtsp://")


def recording_folder(catalog: Catalog, folder: str, name: str) -> Path:
    """Return a new folder for a recording.

    catalog: catalog of the served folder.
    folder: folder in the served one in which it lies.
    name: wanted name, to which a number is added where it is taken.
    Raises: InputError where `folder` is a link that leads out of the served folder.
    """
    if not catalog.contains(catalog.root / folder):
        raise InputError(f"{folder} is a link that leads out of the served folder; remove it first.")
    return free_path(catalog.root / folder, name)


def _target(message: Message, kind: str, port: int) -> str | None:
    """Read the address HOST:PORT to send to.

    message: message of the page.
    kind: its key of the address.
    port: example for the message where the address is no text.
    Returns: None where none is given.
    """
    if message.get(kind) in (None, ""):
        return None
    return text(message[kind], "address to send to", 100, f"give HOST:PORT, for example 127.0.0.1:{port}").strip()


def _reported(path: Path | None) -> str | None:
    return None if path is None else f"{path.parent.name}/{path.name}"


class LiveTopic(Topic):
    """Base class of the topic of a live run, of which there is at most one per server, and which continues without a
    page. hello()["running"] is False, or describes the run.
    """

    joints: Mapping[str, Any] = {}
    """Names and parents of the joints, for pages."""

    def __init__(self, catalog: Catalog) -> None:
        super().__init__()
        self._catalog = catalog
        self._changing = asyncio.Lock()  # of two pages that start at the same time the second one is refused
        self._running: Message | None = None
        self._parts = contextlib.AsyncExitStack()  # ends the parts of the run, the last one first
        self._words: list[str] = []  # sentences for the pages on how the run ended

    def hello(self) -> Message:
        """Return the state, and names and parents of the joints."""
        return {"t": "hello", "running": self._running or False, **self.joints}

    async def heard(self, message: dict[str, Any]) -> None:
        """Handle a message of a page: start or stop the live run."""
        if message["t"] == "stop":
            return await self.stop()
        if message["t"] != "start":
            raise InputError(f"There is nothing to {message['t'][:20]!r} here; start or stop.")
        async with self._changing:
            if self._running is not None:
                raise NotNow("It is running already; stop it first.")
            self._words = []
            async with contextlib.AsyncExitStack() as parts:  # undo the beginning where a later part fails
                self._running = await self._start(message, parts)
                self._parts = parts.pop_all()
        self.post(self.hello())

    async def stop(self, why: str = "") -> None:
        """Stop the live run and inform the pages.

        why: sentence for the pages, where the run itself gives none.
        """
        async with self._changing:
            running, self._running = self._running, None
            await self._parts.aclose()
        if running is not None and (said := " ".join(self._words) or why):
            self.post({"t": "said", "text": said})
        self.post(self.hello())

    async def _start(self, message: Message, parts: contextlib.AsyncExitStack) -> Message:
        """Start as a page requests.

        parts: gets what ends each part that was started.
        Returns: description of the run.
        Raises: InputError names the value that is not possible.
        """
        raise NotImplementedError


class FuseTopic(LiveTopic):
    """Topic of the live fusion of skeletons from several depth sensors."""

    name = "fuse"
    joints = {"joints": COMMON, "parents": PARENT.tolist()}

    async def _start(self, message: Message, parts: contextlib.AsyncExitStack) -> Message:
        """Open the ports on this computer, and the recording where wanted; `simulated`: number of simulated sensors
        that send to it.
        """
        udp, ws = (whole(message.get(k, 0), f"the {k} port", 0, 65535) for k in ("udp", "ws"))
        osc, seen = _target(message, "osc", 9000), None
        if made_up := message.get("simulated") or 0:
            whole(made_up, "the number of simulated sensors", 2, simulated_sensors.MAX_SIMULATED)
            seen = await run_in_threadpool(simulated_sensors.simulated_sensors, made_up, np.random.default_rng(0))
        record = recording_folder(self._catalog, _FOLDER, "live") if message.get("record") is True else None
        server = LiveServer(udp=udp, ws=ws, osc=osc, record=record)
        try:
            await server.start()
        except InputError:
            if record is not None:
                shutil.rmtree(record, ignore_errors=True)  # nothing was recorded there
            raise
        parts.push_async_callback(self._end, server)
        server.listeners.append(self._tell)
        if seen is not None:
            sending = asyncio.ensure_future(simulated_sensors.send(seen, server.take, np.random.default_rng(1)))
            parts.callback(sending.cancel)
        running = {"udp": server.udp_port, "ws": server.ws_port, "simulated": seen is not None, "osc": osc}
        return running | {"record": _reported(record)}

    def _tell(self, line: str) -> None:
        """Forward a message of the fusion server to the pages."""
        self.post(_as_topic(line), key=line.partition(",")[0])

    async def _end(self, server: LiveServer) -> None:
        """Close the ports and complete the recording."""
        await server.stop()
        if (record := _reported(server.record)) is not None:
            self._words.append(server.unrecorded or f"Recorded as {record}.")


def _as_topic(line: str) -> str:
    """Return a line of JSON of the live outputs as a message to pages."""
    return line.replace('"type":', '"t":', 1)


class CameraTopic(LiveTopic):
    """Topic of live tracking with calibrated cameras, with small pictures and masks."""

    name = "cameras"

    def __init__(self, catalog: Catalog) -> None:
        super().__init__(catalog)
        skeleton = human().skeleton
        self.joints = {"joints": skeleton.joint_names, "parents": [int(p) for p in skeleton.parents]}
        self._run: TrackingRun | None = None
        self._watching: asyncio.Task[None] | None = None

    def hello(self) -> Message:
        """Return the state, the joints, and the cameras of this computer."""
        return {**super().hello(), "devices": list_devices()}

    async def heard(self, message: dict[str, Any]) -> None:
        """Handle a message of a page: start or stop the live run, or learn the empty room again ("room")."""
        if message["t"] != "room":
            return await super().heard(message)
        if self._running is None or self._run is None:
            raise NotNow("The empty room is learnt while the cameras run; start them.")
        self._run.engine.learn_background()

    async def _start(self, message: Message, parts: contextlib.AsyncExitStack) -> Message:
        """Start live tracking. The message has these fields:

        recording: id of a recording with calibrated cameras.
        sources: addresses by camera name; empty: its videos are played, again and again unless they are recorded.
        countdown: time before the empty room is learned, s.
        people: most people that are tracked.
        record, osc, vmc: as for the fusion.
        """
        recording = self._catalog.find("recording", message.get("recording"))
        sources = _sources(message.get("sources") or {})
        countdown = request_number(message.get("countdown", 5), "the countdown", 0, 600)
        people = whole(message.get("people", 1), "the number of people", 1, SETTINGS.engine_most_people)
        osc, vmc = _target(message, "osc", 9000), _target(message, "vmc", 39539)
        recorded = message.get("record") is True
        cameras = await run_in_threadpool(live_rig, recording.path, sources, None, not recorded)
        record = recording_folder(self._catalog, _FOLDER, "cameras") if recorded else None
        pictures = _Pictures(self, cameras)
        parts.callback(pictures.close)
        capture = CaptureOptions(cameras.rate, countdown, cameras.silhouettes, pictures=True)
        person, outputs = LivePersonOptions(height=cameras.height), {"ws": 0, "osc": osc, "vmc": vmc}
        about = {"listeners": [pictures], "record": record, **outputs}
        run = self._run = await run_in_threadpool(partial(TrackingRun, cameras, capture, person, people, **about))
        parts.push_async_callback(self._end, run, _reported(record))
        self._watching = asyncio.ensure_future(self._watch(run))
        port = run.outputs.listeners.port if run.outputs.listeners is not None else 0
        running = {"recording": recording.id, "cameras": run.cameras, "ws": port, "osc": osc, "vmc": vmc}
        places = [np.linalg.inv(c.camera_from_world).round(4).tolist() for c in cameras.rig]
        return running | {"record": _reported(record), "played": not sources, "places": places}

    async def _watch(self, run: TrackingRun) -> None:
        """Stop the run when all files are over or it has failed, and report that, and a failed recorder."""
        reported = False
        while not run.engine.ended.is_set():
            await asyncio.sleep(0.2)
            if run.recorder is not None and run.recorder.failed and not reported:
                reported = True
                self.post({"t": "said", "text": run.recorder.failed})
        if self._running is not None and self._run is run:
            await self.stop("All videos are over.")

    async def _end(self, run: TrackingRun, record: str | None) -> None:
        """Stop a run; note why it failed, and what was recorded."""
        said = ""
        try:
            said = await run_in_threadpool(run.close, record)
        except InputError as error:
            said = str(error)
        if run.engine.failed is not None:
            self._words.append(f"It ended: {str(run.engine.failed).rstrip('.')}.")
        self._words += [said] * bool(said)


def list_devices() -> list[dict[str, Any]]:
    """List the cameras of this computer by number and name; none where the system has no such list (only Linux has)."""
    found = []
    for device in sorted(Path("/sys/class/video4linux").glob("video*"), key=lambda p: natural_key(p.name)):
        with contextlib.suppress(OSError, ValueError):
            if int((device / "index").read_text()) == 0:  # others of the same camera give no pictures
                found.append({"number": int(device.name[5:]), "name": (device / "name").read_text().strip()})
    return found


def _sources(value: Any) -> dict[str, str]:
    """Read the addresses of cameras: devices and streams only, since a page must not open files."""
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


class _Pictures:
    """Listener of the engine that sends pages all poses, the status, and small pictures now and then."""

    def __init__(self, topic: Topic, cameras: LiveRig) -> None:
        self._topic = topic
        self._cameras = tuple(v.name for v in cameras.views)
        self._drawn = -np.inf
        self._drawing, self._pool = Future[None](), ThreadPoolExecutor(1, "pictures")
        self._drawing.set_result(None)

    def seen(self, seen: LiveResult) -> None:
        """Send the poses of an instant, and let pictures be drawn where they are due."""
        now = time.monotonic()
        people = [json.loads(pose_json(pose, now - seen.captured.arrival, self._cameras)) for pose in seen.poses]
        if people:
            self._topic.post({"t": "frame", "people": people}, key="frame")
        if now - self._drawn >= PICTURES_S and self._drawing.done() and self._topic.pages:
            self._drawn, self._drawing = now, self._pool.submit(self._draw, seen)

    def status(self, status: LiveStatus) -> None:
        """Send the state of the run."""
        self._topic.post(_as_topic(status_json(status)), key="status")

    def close(self) -> None:
        """Stop drawing pictures."""
        self._pool.shutdown()

    def _draw(self, seen: LiveResult) -> None:
        """Send pictures of an instant."""
        views = zip(self._cameras, seen.captured.jpegs, seen.captured.views, strict=True)
        pictures = [{"name": n, "jpeg": _picture(j, None if v is None else v[0])} for n, j, v in views]
        self._topic.post({"t": "pictures", "cameras": pictures}, key="pictures")


def _picture(taken: bytes | None, bits: np.ndarray | None) -> str | None:
    """Encode a small picture with the mask as a tint, base64.

    taken: the picture as captured, a JPEG, or None.
    bits: mask (h, w / 8), eight pixels per byte, or None.
    Returns: None without a picture.
    """
    if taken is None:
        return None
    image = np.asarray(cv2.imdecode(np.frombuffer(taken, np.uint8), cv2.IMREAD_COLOR))
    size = _WIDTH, max(1, round(_WIDTH * image.shape[0] / image.shape[1]))
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    if bits is not None:
        mask = np.unpackbits(bits, axis=1)
        inside = cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST) > 0
        small[inside] = (0.55 * small[inside] + 0.45 * _TINT).astype(np.uint8)
    return base64.b64encode(jpeg(small, _WIDTH, _QUALITY)).decode()
