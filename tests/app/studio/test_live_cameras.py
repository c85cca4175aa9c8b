"""Live cameras in the studio: the engine of `hypose live` behind a WebSocket, and the page that shows it."""

import base64
import contextlib
import json
import socket
import threading
import time
from functools import partial
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from hypose.app.live import pose_outputs
from hypose.app.studio import live_topics
from hypose.errors import InputError
from hypose.io.recordings.frames import working_rig
from hypose.io.recordings.recording import load_recording
from hypose.pipeline.live.capture import CaptureOptions
from hypose.pipeline.live.engine import LiveStatus
from hypose.synthetic.write_recording import write_scene
from tests.app.studio.browser import WEB, go
from tests.app.studio.conftest import serving, until
from tests.conftest import HANG_S
from tests.live_scenes import Clock, Stage, in_step, slow_walk

RATE = 8.0


@pytest.fixture(scope="module")
def stage():
    """Four small cameras, and a person before them as long as they are looked at."""
    stage = Stage(slow_walk(), RATE, 8)
    stage.begin = 0.0
    return stage


@pytest.fixture(scope="module")
def served_live(tmp_path_factory):
    """A studio whose folder holds a recording by the cameras of the stage."""
    root = tmp_path_factory.mktemp("live")
    write_scene(slow_walk(), root / "walk", background_frames=12)
    with serving(root) as client:
        yield client


@pytest.fixture
def followed(monkeypatch, stage):
    """What the studio starts looks at the stage, never faster than in truth."""
    monkeypatch.setattr(stage, "clock", Clock())
    in_step(monkeypatch, stage, [live_topics, pose_outputs], 0.5 / RATE)


def walk_of(client):
    """The id of the recording `walk`."""
    return next(r["id"] for r in client.get("/api/state")["recordings"] if r["path"] == "walk")


def test_a_person_is_followed_recorded_and_shown(served_live, followed):
    client = served_live
    with client.socket("/ws/cameras") as socket:
        hello = until(socket, "hello")
        assert hello["running"] is False and len(hello["joints"]) == len(hello["parents"]) == 19
        socket.send(json.dumps({"t": "start", "recording": walk_of(client), "record": True}))
        running = until(socket, "hello")["running"]
        assert running["cameras"] == ["cam1", "cam2", "cam3", "cam4"] and running["played"]
        frame = until(socket, "frame")
        person = frame["people"][0]
        assert len(person["joints"]) == 19 and person["cameras"] and person["latency_ms"] > 0
        status = until(socket, "status", lambda m: m["poses"] > 0)
        assert status["phase"] == "following" and not any(c["trouble"] for c in status["cameras"])
        pictures = until(socket, "pictures", lambda m: all(c["jpeg"] for c in m["cameras"]))["cameras"]
        shown = cv2.imdecode(np.frombuffer(base64.b64decode(pictures[0]["jpeg"]), np.uint8), cv2.IMREAD_COLOR)
        assert shown is not None and shown.shape[1] == 320
        socket.send(json.dumps({"t": "start", "recording": walk_of(client)}))
        assert "running already" in until(socket, "error")["error"]
        socket.send('{"t": "stop"}')
        assert until(socket, "said")["text"] == "Recorded as live/cameras."
        until(socket, "hello", lambda m: m["running"] is False)
    assert (client.studio.catalog.root / "live" / "cameras" / "recording.toml").is_file()


@pytest.mark.parametrize(
    "more, why",
    [
        ({"t": "room"}, "learnt while the cameras run"),
        ({"t": "dance"}, "start or stop"),
        ({"recording": "nothing"}, "There is no recording"),
        ({"sources": {"cam1": "/etc/passwd"}}, "give the number of a camera of this computer"),
        ({"sources": {"cam9": "0", "cam1": "0"}}, "There is no camera cam9"),
        ({"sources": {"cam1": "http://127.0.0.1:9/"}}, "two cameras or more"),
    ],
)
def test_what_cannot_be_started_is_said(served_live, more, why):
    with served_live.socket("/ws/cameras") as socket:
        socket.send(json.dumps({"t": "start", "recording": walk_of(served_live), **more}))
        assert why in until(socket, "error")["error"]


class Engine:
    """Shows two instants with nobody in them. failing: then it fails; else it runs, and takes a while to stop."""

    def __init__(self, failing, rig, views, capture, person, *, people, listeners, stop):
        self.listeners, self.failed, self._failing = listeners, None, failing
        self.ended, self._shapes = threading.Event(), [c.size for c in working_rig(rig)]

    def start(self):
        for time_s in (0.1, 0.2):
            views = [(np.zeros((h, -(-w // 8)), np.uint8), None) for w, h in self._shapes]
            captured = SimpleNamespace(views=views, jpegs=[None] * len(views), arrival=0.0, empty=())
            for listener in self.listeners:
                listener.seen(SimpleNamespace(captured=captured, frame=SimpleNamespace(time=time_s), poses=()))
        if self._failing:
            self.failed = InputError("The process that looks at the cameras has ended; start again.")
            self.ended.set()

    def stop(self):
        for _ in range(0 if self._failing else 20):
            for listener in self.listeners:
                listener.status(LiveStatus("no_person", (), (), 0, 0.0, 0.0, (np.nan, np.nan), {}, (), False))
            time.sleep(0.05)
        self.ended.set()


@pytest.mark.parametrize("failing", [True, False])
def test_what_was_recorded_is_kept_whatever_ends_it(served_live, monkeypatch, failing):
    """The cameras' process, or a page that says stop and is closed at once."""
    monkeypatch.setattr(pose_outputs, "LiveEngine", partial(Engine, failing))
    host = served_live.studio.cameras
    with served_live.socket("/ws/cameras") as ws:
        ws.send(json.dumps({"t": "start", "recording": walk_of(served_live), "record": True}))
        running = until(ws, "hello", lambda m: m["running"])["running"]
        if failing:
            said = until(ws, "said")["text"]
            assert said.startswith("It ended: The process") and said.endswith(f"Recorded as {running['record']}.")
        else:
            ws.send('{"t": "stop"}')
    folder = served_live.studio.catalog.root / running["record"]
    end = time.monotonic() + HANG_S
    while _listening(running["ws"]) or not (folder / "recording.toml").exists():
        assert time.monotonic() < end
        time.sleep(0.05)
    assert load_recording(folder).n_frames == 2 and host.hello()["running"] is False


def _listening(port):
    with contextlib.closing(socket.socket()) as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def test_nothing_is_recorded_outside_of_the_served_folder(own_studio, tmp_path):
    """Neither of cameras nor of depth sensors."""
    (tmp_path / "elsewhere").mkdir()
    (own_studio.studio.catalog.root / "live").symlink_to(tmp_path / "elsewhere")
    recording = walk_of(own_studio)
    for path, more in (("/ws/cameras", {"recording": recording}), ("/ws/fuse", {"udp": 0, "ws": 0})):
        with own_studio.socket(path) as ws:
            ws.send(json.dumps({"t": "start", "record": True, **more}))
            while (message := json.loads(ws.recv(HANG_S)))["t"] != "error":
                assert not message.get("running")
            assert "leads out of the served folder" in message["error"]
    assert not list((tmp_path / "elsewhere").iterdir())


def test_the_page_follows_a_person(served_live, page, followed, tmp_path, monkeypatch):
    # so long that the page shows it, however busy the computer is
    monkeypatch.setattr(
        live_topics, "CaptureOptions", lambda rate, _, masks, **more: CaptureOptions(rate, 600.0, masks, **more)
    )
    go(WEB / "tests" / "live_cameras.walk.mjs", served_live.address, served_live.studio.catalog.root, tmp_path)
