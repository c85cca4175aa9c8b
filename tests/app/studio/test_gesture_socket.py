"""A gesture taught over the wire to the simulated person: what a closed page loses, resuming, and how good it gets."""

import json
import shutil
import struct

import cv2
import numpy as np
import pytest

from hypose.app.studio.http import IN_FLIGHT
from hypose.pipeline.gesture_files import load_model, read_recording
from tests.app.studio.conftest import serving
from tests.conftest import HANG_S

SHORT = {"do_gesture": 0.4, "positive": 0.8, "release": 0.2, "negative": 0.8}


class Page:
    """A page that trains; answers pictures unless told not to."""

    def __init__(self, socket, answers=True):
        self.socket, self.answers = socket, answers
        self.pictures, self.steps, self.others = [], [], []
        self.hello = self.until("hello")

    def send(self, **message):
        self.socket.send(json.dumps(message))

    def until(self, kind, **wanted):
        """The next message of a kind with these values."""
        while True:
            message = self.socket.recv(HANG_S)
            if isinstance(message, bytes):
                seq = struct.unpack_from("<I", message, 4)[0]
                self.pictures.append(message)
                if self.answers:
                    self.send(t="ack", seq=seq)
                continue
            value = json.loads(message)
            (self.steps if value["t"] == "step" else self.others).append(value)
            if value["t"] == "error" and kind != "error":
                raise AssertionError(value["error"])
            if value["t"] == kind and all(value.get(k) == v for k, v in wanted.items()):
                return value


def start(page, **more):
    asked = {"t": "start", "mode": "train", "gesture": "tee", "source": "simulated:0", "rounds": 2, "seconds": SHORT}
    page.send(**{**asked, "fast": True, **more})
    return page.until("hello")["session"]


def model_of(client, name="tee"):
    return next(m for m in client.get("/api/state")["models"] if m["path"] == f"gestures/{name}.npz")


@pytest.fixture
def root(tmp_path):
    (tmp_path / "root").mkdir()
    return tmp_path / "root"


@pytest.mark.slow
def test_a_closed_page_loses_nothing_and_resuming_grows_the_same_forest(root):
    with serving(root) as client:
        with client.socket("/ws/gesture") as socket:
            page = Page(socket)
            assert page.hello["session"] is None
            assert start(page)["gestures"] == ["tee"]
            with client.socket("/ws/gesture") as second:
                assert Page(second).hello["session"]["source"] == "simulated:0"  # another page sees the same
            page.until("step", phase="negative")
        # the page is gone in the middle of a round
        with client.socket("/ws/gesture") as socket:
            page = Page(socket)
            if page.hello["session"] is not None:
                page.send(t="command", command="continue")
                page.until("step", phase="test")
                page.send(t="stop")
                page.until("ended")
        session, model = client.studio.catalog.items("session", fresh=True)[0], model_of(client)
        recording = read_recording(session.path)
        assert {f.phase for f in recording.frames} >= {"do_gesture", "positive", "negative"}
        assert model["gesture"] == "tee"
        before = load_model(root / model["path"])
        with client.socket("/ws/gesture") as socket:
            page = Page(socket)
            assert start(page, resume=model["id"], rounds=1)["resume"] == model["id"]
            page.until("step", phase="test")
            page.send(t="stop")
            page.until("ended")
        shown = f"/api/models/{model_of(client)['id']}/thumbnail.jpg"
        status, headers, data = client.ask(shown)
        assert status == 200 and headers["content-type"] == "image/jpeg"
        assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).shape == (96, 96, 3)
        for session in client.studio.catalog.items("session", fresh=True):
            shutil.rmtree(session.path)
        assert client.ask(shown)[0] == 204
        assert client.ask("/api/models/0123456789ab/thumbnail.jpg")[0] == 404
        after = load_model(root / model_of(client)["path"])
        assert len(client.get("/api/state")["models"]) == 1 and len(after.history) > len(before.history)
        # what had grown is still there: tests of nodes that were split stay as they were
        old, new = before.learner.forest.arrays, after.learner.forest.arrays
        np.testing.assert_array_equal(new.test[:, : old.test.shape[1]][old.left >= 0], old.test[old.left >= 0])
        assert new.seen.sum() > old.seen.sum()


@pytest.mark.slow
def test_pictures_wait_for_nobody_and_states_are_never_dropped(root):
    with serving(root) as client, client.socket("/ws/gesture") as socket:
        page = Page(socket, answers=False)
        start(page)
        page.until("step", phase="test")
        assert len(page.pictures) == IN_FLIGHT
        numbers = [s["seq"] for s in page.steps]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers))) and len(numbers) > 20
        kind, stream, _, seq, time = struct.unpack_from("<BBHId", page.pictures[0])
        assert (kind, stream) == (1, 0) and page.pictures[0][16:18] == b"\xff\xd8" and time >= 0
        page.send(t="ack", seq=seq)
        page.send(t="stop")
        page.until("ended")


def test_a_session_that_cannot_be_is_refused_in_a_sentence(root):
    with serving(root) as client, client.socket("/ws/gesture") as socket:
        page = Page(socket)
        for change in (
            {"gesture": "../x"},
            {"gesture": "dance"},
            {"source": "/etc/passwd"},
            {"source": "simulated:99"},
            {"source": "session:0123456789ab"},
            {"resume": "0123456789ab"},
            {"rounds": 10**9},
            {"seconds": {"positive": -1}},
            {"mode": "run", "models": []},
            {"mode": "dance"},
            {"source": None},
            {"gesture": " "},
            {"rounds": 0},
            {"seconds": {"positive": "x"}},
            {"seed": -1},
        ):
            page.send(**{"t": "start", "mode": "train", "gesture": "tee", "source": "simulated:0", **change})
            assert page.until("error")["error"].endswith(".")
        assert list(root.rglob("*.npz")) == []
