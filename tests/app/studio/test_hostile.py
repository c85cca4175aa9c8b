"""What somebody else's program may send to the studio: it is answered with a sentence, and no log grows."""

import contextlib
import json
import logging
import socket
from urllib.parse import quote

import pytest
from websockets.exceptions import ConnectionClosed

from tests.app.studio.conftest import serving
from tests.conftest import HANG_S

LOGGERS = ("asyncio", "uvicorn.error", "websockets.server")


@pytest.fixture
def log():
    """The lines that the servers' libraries write."""
    lines = []

    class Keep(logging.Handler):
        def emit(self, record):
            lines.append(self.format(record))

    keep = Keep()
    for name in LOGGERS:
        logging.getLogger(name).addHandler(keep)
    yield lines
    for name in LOGGERS:
        logging.getLogger(name).removeHandler(keep)


def raw(port, data):
    """What the server answers to these bytes until it ends the connection or has said a whole head."""
    with socket.create_connection(("127.0.0.1", port), timeout=HANG_S) as s:
        s.sendall(data)
        got = b""
        while b"\r\n\r\n" not in got and (more := s.recv(65536)):
            got += more
    return got


def test_only_so_many_connections_are_open(served, monkeypatch):
    monkeypatch.setattr("hypose.app.studio.server.MOST_CONNECTIONS", 20)
    with serving(served) as client, contextlib.ExitStack() as held:
        with client.socket("/ws/jobs") as ws:
            assert json.loads(ws.recv(HANG_S))["t"] == "jobs"
            for n in range(18):
                s = held.enter_context(socket.create_connection(("127.0.0.1", client.port), timeout=HANG_S))
                s.sendall((b"", b"GET / HTT")[n % 2])
                if n < 15:
                    assert client.ask("/api/state")[0] == 200
            held.enter_context(socket.create_connection(("127.0.0.1", client.port), timeout=HANG_S))
            assert client.ask("/api/state")[0] == 503
            assert ws.ping().wait(HANG_S)  # the page stays
            held.close()
            while client.ask("/api/state")[0] != 200:
                pass


def test_requests_that_are_none_are_answered_and_logged_once(studio, log):
    head = f"Host: 127.0.0.1:{studio.port}\r\nConnection: close\r\n\r\n".encode()
    for target in (
        b"//[/in",
        b"/static/%00",
        b"/%ff%fe",
        b"/api/results/%00/view",
        b"/api/jobs/\\",
        b"*",
        b"http://[/",
    ):
        status = int(raw(studio.port, b"GET " + target + b" HTTP/1.1\r\n" + head).split()[1])
        assert 400 <= status < 500 or (status == 200 and target == b"*"), (target, status)
    for data in (b"\x16\x03\x01\x02\x00\r\n\r\n", b"GET\r\n\r\n", b"A" * 70_000 + b"\r\n\r\n") * 20:
        assert raw(studio.port, data).startswith(b"HTTP/1.1 400") or data.startswith(b"A")
    assert not any("Traceback" in line for line in log) and len(log) <= 3


@pytest.mark.parametrize(
    "settings",
    [
        *('{"close_px": 100000}', '{"open_px": 99999}', '{"hole_px": 99999999999999999999}', '{"min_sd": 1e308}'),
        *('{"threshold": NaN}', '{"threshold": 1e308}', '{"shadow_chroma": 1e308}', '{"keep_gap": 1e999}'),
        *('{"shadow_range": [0.1, 1e308]}', '{"threshold": 1e200}', '{"min_sd": 1e300}', '{"keep_gap": 1e308}'),
        *('{"close_px": ' + "9" * 5000 + "}", "[" * 5000, '{"width": 99999999999}'),
    ],
)
def test_a_mask_setting_out_of_all_bounds_is_a_sentence(studio, settings):
    answer = studio.get(
        f"/api/recordings/{studio.recording}/image/cam1/0.jpg?mask=edge&settings={quote(settings)}", status=400
    )
    assert answer["error"].endswith(".") and len(answer["error"]) < 400


@pytest.mark.parametrize(
    "body",
    [
        '{"views": [{"camera": "cam1", "points": [{"joint": "neck", "x": 1e999, "y": 1}]}], "frame": 0}',
        '{"views": [{"camera": ["cam1"], "points": []}], "frame": 0}',
        '{"views": [{"camera": "cam1", "points": [[]]}], "frame": 0}',
        '{"views": [], "frame": 1e999}',
        '{"frame": ' + "9" * 400 + "}",
        '{"views": [{"camera": "cam1", "points": [{"joint": "\\ud800", "x": 1, "y": 1}]}], "frame": 0}',
        '{"height": NaN, "frame": 0, "views": ' + "[" * 30 + "]" * 30 + "}",
        '{"a": ' * 900 + "1" + "}" * 900,
        '{"start": [1e999], "frame": 0}',
    ],
)
def test_a_body_that_means_nothing_is_a_sentence(studio, body):
    body = f'{{"recording": "{studio.recording}", ' + body[1:] if not body.startswith('{"a"') else body
    got, _, answer = studio.ask("/api/fit-clicks", data=body.encode())
    assert got == 400 and json.loads(answer)["error"].endswith(".")


@pytest.mark.parametrize("path", ["/ws/gesture", "/ws/fuse", "/ws/cameras", "/ws/jobs"])
def test_any_frame_is_answered_or_ends_the_connection(studio, log, path):
    with studio.socket(path) as ws:
        ws.recv(HANG_S)
        for said in (
            b"\x00\xff",
            '{"t": "ack", "seq": [1]}' if "gesture" in path else '{"t": "start", "udp": [1]}',
            '{"t": "start", "mode": "train", "source": "simulated:\u00b2", "gesture": "tee", "udp": -1}',
            '{"t": "start", "mode": ["train"], "udp": 1e999}',
            '{"t": "\\ud800"}',
            '{"t": "box", "x": ' + "[" * 500 + "]" * 500 + "}",
        ):
            ws.send(said)
            answer = json.loads(ws.recv(HANG_S))
            assert answer["t"] == "error" and answer["error"].endswith("."), answer
        ws.send([b"\x00", b"", b"\xff"])
        ws.send(["half", " of ", "it"])
    with studio.socket(path) as ws:
        ws.recv(HANG_S)
        with pytest.raises(ConnectionClosed) as closed:
            ws.send(b"\xff\xfe", text=True)
            while True:
                ws.recv(HANG_S)
        assert closed.value.rcvd.code == 1007
    assert not any("Traceback" in line for line in log)


@pytest.mark.parametrize("path", ["/ws/gesture", "/ws/fuse", "/ws/cameras", "/ws/jobs"])
def test_answers_to_a_page_that_has_broken_the_rules_go_nowhere(studio, log, path):
    for _ in range(5):
        with studio.socket(path) as ws:
            ws.recv(HANG_S)
            # sentences are on their way when the server ends the connection for a frame that is none
            ws.protocol.writes.extend(b"\x81\x81\0\0\0\0{" for _ in range(30))
            ws.protocol.writes.append(b"\xff\xff")
            with pytest.raises(ConnectionClosed):
                ws.send("{}")
                while True:
                    ws.recv(HANG_S)
    for _ in range(20):
        assert studio.ask("/api/click-joints")[0] == 200
    assert log == []


def test_two_pages_that_start_the_fusion_at_once_start_one(own_studio):
    with own_studio.socket("/ws/fuse") as one, own_studio.socket("/ws/fuse") as other:
        for ws in (one, other):
            ws.recv(HANG_S)
        for ws in (one, other):
            ws.send('{"t": "start", "udp": 0, "ws": 0}')
        heard = [json.loads(ws.recv(HANG_S)) for ws in (one, other) for _ in range(1)]
        assert sum(m["t"] == "error" for m in heard) <= 1
        running = own_studio.studio.fusion.hello()["running"]
        assert running and all(m["running"] == running for m in heard if m["t"] == "hello" and m["running"])
        one.send('{"t": "stop"}')
        while json.loads(one.recv(HANG_S)).get("running") is not False:
            pass
