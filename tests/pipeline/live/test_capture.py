"""The capture: pictures of the right shape become masks, and whoever ends them is not kept waiting."""

import contextlib
import os
import socket
import threading
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest

from hypose.evidence.background import from_frames
from hypose.evidence.pose_network import CROP, PoseNetwork
from hypose.pipeline.live.capture import CaptureOptions, CaptureProcess, CaptureRequest, LiveView
from hypose.pipeline.settings import SETTINGS
from hypose.synthetic.scenes import camera_rig
from tests.conftest import HANG_S
from tests.live_scenes import in_step

RATE = 20.0


@pytest.fixture(scope="module")
def cameras():
    """Two of 160 x 120 px."""
    return camera_rig("humaneva-4").scaled(0.25).select(["cam1", "cam2"])


def folder(path, size, rng, count=60):
    """Pictures of noise, which no JPEG makes small."""
    path.mkdir()
    first = path / "0000.jpg"
    data = cv2.imencode(".jpg", rng.integers(0, 255, (size[1], size[0], 3), dtype=np.uint8))[1].tobytes()
    first.write_bytes(data)
    for n in range(1, count):
        os.link(first, path / f"{n:04d}.jpg")
    return str(path)


def room(camera):
    w, h = camera.size
    return from_frames([np.full((h, w, 3), 100 + n, np.uint8) for n in range(3)])


@pytest.fixture
def begun(monkeypatch):
    """begun(cameras, views, options): capture whose clock waits for them."""
    made = in_step(monkeypatch)
    with contextlib.ExitStack() as closing:

        def begin(*given):
            capture = made(*given, threading.Event())
            closing.callback(capture.close)
            return capture

        yield begin


def looked(capture, met):
    """The first result of which that is so."""
    while True:
        capture.ask(CaptureRequest())
        captured = capture.answer()
        assert captured is not None, "the film is over"
        if met(captured):
            return captured


@pytest.mark.parametrize(
    "size, why",
    [
        ((120, 160), "cam2 shows pictures of 120 x 160 px and is calibrated for 160 x 120 px; turn it back."),
        (
            (160, 90),
            "cam2 shows pictures of 160 x 90 px and is calibrated for 160 x 120 px; set it to pictures of that",
        ),
    ],
)
def test_pictures_of_another_shape_are_not_used_and_named(begun, cameras, tmp_path, rng, size, why):
    sizes, known = {"cam1": (160, 120), "cam2": size}, dict(zip(cameras.names, map(room, cameras), strict=True))
    places = {name: folder(tmp_path / name, sizes[name], rng) for name in cameras.names}

    def views(stretched=False):
        return [LiveView(n, places[n], background=known[n], stretched=stretched) for n in cameras.names]

    capture = begun(cameras, views(), CaptureOptions(RATE))
    captured = looked(capture, lambda s: np.isfinite(s.time))
    assert captured.views[0] is not None and captured.views[1] is None
    assert len(captured.words) == 1 and captured.words[0].startswith(why)
    capture = begun(cameras, views(stretched=True), CaptureOptions(RATE))
    captured = looked(capture, lambda s: np.isfinite(s.time))
    assert None not in captured.views and not captured.words


def test_eyes_that_nobody_listens_to_any_more_end_by_themselves(cameras, tmp_path, rng, monkeypatch):
    """What they are about to say is more than waits in a pipe."""
    monkeypatch.setattr("hypose.pipeline.live.capture.SETTINGS", replace(SETTINGS, capture_closing_s=HANG_S))
    views = [LiveView(c.name, folder(tmp_path / c.name, (1600, 1200), rng, 4000), background=room(c)) for c in cameras]
    capture = CaptureProcess(cameras, views, CaptureOptions(RATE))
    while True:
        capture.ask(CaptureRequest(pictures=True))
        captured = capture.answer()
        assert captured is not None
        if np.isfinite(captured.time):
            break
    assert sum(len(jpeg) for jpeg in captured.jpegs) > 1 << 20
    capture.ask(CaptureRequest(pictures=True))
    time.sleep(0.5)
    capture.close()
    assert capture._process.exitcode == 0


def test_nobody_waits_for_cameras_that_are_being_opened_when_it_is_to_stop(cameras):
    stop = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as silent:
        views = [LiveView(n, f"http://127.0.0.1:{silent.getsockname()[1]}/{n}") for n in cameras.names]
        held = []
        asked = threading.Thread(target=lambda: (held.append(silent.accept()), stop.set()), daemon=True)
        asked.start()
        capture = CaptureProcess(cameras, views, CaptureOptions(RATE), stop)  # and it is no error
        capture.close()
        held[0][0].close()
    assert not capture._process.is_alive()


def test_where_a_network_finds_people_no_empty_room_is_learnt(begun, cameras, tmp_path, rng, monkeypatch):
    scores, points = np.full(2254, -9.0, np.float32), np.full((39, 5), CROP / 2, np.float32)
    scores[1100], points[34, 1] = 9, CROP / 4
    boxes, mask = np.zeros((2254, 12), np.float32), np.full((CROP, CROP), 9, np.float32)
    boxes[:, 7] = -60
    network = PoseNetwork(lambda _: (boxes, scores), lambda _: (points, 0.9, mask), {})
    monkeypatch.setattr("hypose.pipeline.live.capture.open_network", lambda: network)
    views = [LiveView(c.name, folder(tmp_path / c.name, (160, 120), rng)) for c in cameras]
    captured = looked(begun(cameras, views, CaptureOptions(RATE, network=1)), lambda s: np.isfinite(s.time))
    assert not captured.learning and not captured.words
    assert all(view is not None and view[0].any() and view[1] is not None for view in captured.views)
