"""`hypose fuse --live` through sockets of this computer."""

import asyncio
import json
import logging
import shutil
import signal
import socket
import subprocess
import sys

import numpy as np
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from hypose.app.live.live_server import LiveServer
from hypose.app.live.servers import quiet_logs
from hypose.errors import InputError
from hypose.evidence.frame import SensorReport
from hypose.fusion.align import AlignSettings
from hypose.fusion.joints import COMMON
from hypose.geometry import transform
from hypose.io.sensors.skeleton_files import format_line, read_skeletons
from tests.conftest import HANG_S
from tests.depth_sensors import camera, walker
from tests.osc_packets import parse_osc, udp_sink

ANGLES = (0, 60, -60)


def lines_at(t, token=""):
    for k, angle in enumerate(ANGLES):
        joints = transform(camera(angle), walker(t))
        report = SensorReport(f"s{k}", t + 100 * k, 0, COMMON, joints, np.full(15, 2, np.uint8))
        yield json.dumps(json.loads(format_line(report)) | ({"token": token} if token else {})).encode()


class Clock:
    """The server's time, set by the test: a busy machine makes a test longer, and changes nothing else."""

    def __init__(self):
        self.now = 1000.0

    def __call__(self):
        return self.now


async def until(condition):
    """`live` gives up after two minutes."""
    while not condition():
        await asyncio.sleep(0.001)


async def feed(server, seconds, start=0.0, token=""):
    """Three sensors at 30 Hz; every frame of theirs arrives 2 ms after it was taken."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        for n in range(int(seconds * 30)):
            t = start + n / 30
            server.clock.now = 1000.0 + t + 0.002
            lines = list(lines_at(t, token))
            goal = server.received + len(lines)
            for line in lines:
                s.sendto(line, ("127.0.0.1", server.udp_port))
            await until(lambda goal=goal: server.received >= goal)
            server.clock.now = 1000.0 + t + 0.02
            server.tick()


OPTIONS = {"udp": 0, "ws": 0, "settings": AlignSettings(timeout=0.6)}


def live(play, **options):
    """Run play(server) against a live server on free ports; returns its result, the messages out and the server."""
    notes = []

    async def run():

        server = LiveServer(**{**OPTIONS, **options}, note=notes.append)
        server.clock = Clock()
        await server.start()
        out = []
        try:
            suffix = f"?token={server.token}" if server.token else ""
            async with connect(f"ws://127.0.0.1:{server.ws_port}/out{suffix}") as listener:

                async def listen():
                    async for message in listener:
                        out.append(json.loads(message))

                listening = asyncio.ensure_future(listen())
                await asyncio.wait_for(until(lambda: out), HANG_S)  # the hello: it misses nothing from here
                result = await asyncio.wait_for(play(server), HANG_S)
                assert server.sockets.dropped == 0
                await asyncio.wait_for(until(lambda: sum(m["type"] == "frame" for m in out) == server.frames), HANG_S)
                listening.cancel()
        finally:
            await server.stop()
        return result, out, server

    return *asyncio.run(run()), notes


def test_garbage_is_counted_and_told_of_once():
    async def play(server):
        rng = np.random.default_rng(3)
        await feed(server, 0.5)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
            for n in range(100):
                junk = b"x" + rng.integers(11, 256, int(rng.integers(1, 400))).astype(np.uint8).tobytes()
                good = next(lines_at(0.0))
                s.sendto(junk + b"\n" + good[: int(rng.integers(2, len(good) - 2))], ("127.0.0.1", server.udp_port))
                await until(lambda sent=2 * n + 2: server.ignored == sent)
            s.sendto(b"{" * 60000, ("127.0.0.1", server.udp_port))
            await until(lambda: server.ignored == 201)
        await feed(server, 0.5, start=0.5)

    _, out, server, notes = live(play)
    frames = [m for m in out if m["type"] == "frame"]
    assert len(notes) == 1 and notes[0].startswith("Ignored:") and notes[0].isprintable()
    assert [f["n"] for f in frames] == list(range(len(frames))) and len(frames) >= 25
    assert any(f["people"] for f in frames)


def test_lines_by_websocket_with_answers_to_bad_ones():
    async def play(server):
        async with connect(f"ws://127.0.0.1:{server.ws_port}/in") as sender:
            for n in range(20):
                server.clock.now = 1000.0 + n / 30
                await sender.send(b"\n".join(lines_at(n / 30)).decode())
                await until(lambda n=n: server.received == 3 * (n + 1))
            await sender.send("nonsense\nmore")
            return json.loads(await sender.recv())

    answer, out, server, _ = live(play)
    assert answer["type"] == "error" and answer["lines"] == 2 and "JSON" in answer["reason"]
    assert out[0]["type"] == "hello" and out[0]["joints"] == list(COMMON)
    last = [m for m in out if m["type"] == "frame" and m["people"]][-1]
    assert len(last["people"][0]["joints"]) == 15 and last["latency_ms"] < 1000


async def answer(server, path, **about):
    """The status with which a WebSocket is refused; 101 where it is taken and speaks."""
    try:
        async with connect(f"ws://127.0.0.1:{server.ws_port}{path}", **about) as taken:
            await taken.recv()
            return 101
    except InvalidStatus as refused:
        return refused.response.status_code


def test_other_paths_and_foreign_pages_are_refused():
    async def play(server):
        assert await answer(server, "/") == 404
        assert await answer(server, "/out", origin="https://example.org") == 403
        assert await answer(server, "/in", origin="http://localhost.example.org") == 403
        assert await answer(server, "/out", origin="http://localhost:8000") == 101

    live(play)


def test_the_token_is_asked_for():
    token = "a-good-token"
    odd = [b'{"sensor": "s0", "time": 1, "token": "\\ud800", "joints": null}', b"\xff\xfe" * 50, b'{"token": 1}']

    async def play(server):
        assert [await answer(server, path) for path in ("/out", "/out?token=wrong-one", "/in")] == [401] * 3
        assert await answer(server, "/out", additional_headers={"Authorization": f"Bearer {token}"}) == 101
        for n in range(60):
            server.take(odd[n % 3])
        # a token of half a character next to the right one reaches the comparison
        server.take(b'{"sensor": "a-good-token", "time": 1, "token": "\\ud800", "joints": null}')
        assert (server.ignored, server.used) == (61, 0)
        for line in lines_at(0.0, token=token):
            server.take(line)

    _, _, server, notes = live(play, token=token)
    assert server.ignored == 61 and server.used == 3 and "token" in notes[0]


def test_other_hosts_get_a_token_made():
    for host in ("0.0.0.0", "example.org"):
        assert len(LiveServer(host=host).token) >= 20
    for host in ("127.0.0.1", "localhost", "::1"):
        assert LiveServer(host=host).token == ""


def test_a_taken_port_is_named():
    async def play(server):
        with pytest.raises(InputError, match="cannot be opened .*--udp"):
            await LiveServer(udp=server.udp_port, ws=None).start()

    live(play)


def test_what_is_recorded_can_be_fused(hypose, tmp_path):
    async def play(server):
        await feed(server, 2.0)

    live(play, record=tmp_path / "rec")
    made = read_skeletons(tmp_path / "rec")
    assert [s.name for s in made.streams] == ["s0", "s1", "s2"] and not made.common_clock
    assert all(len(s.times) >= 55 for s in made.streams)


@pytest.mark.skipif(sys.platform == "win32", reason="NOT tested: an open folder that is removed; run it on Linux")
def test_the_command_does_not_end_well_when_its_recording_was_removed(tmp_path):
    command = [sys.executable, "-m", "hypose.app", "fuse", "--live", "--udp", "0", "--record", tmp_path / "rec"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        while process.stdout.readline().strip() != "Stop with Ctrl-C.":
            assert process.poll() is None
        shutil.rmtree(tmp_path / "rec")
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=HANG_S)
    assert process.returncode == 2 and "error: The recording is lost" in err and "Recorded" not in out


def test_fused_skeletons_by_osc():
    packets = []

    async def play(server):
        await feed(server, 1.0)

    with udp_sink(packets) as address:
        live(play, osc=address)
    found = [m for p in packets for m in parse_osc(p)]
    heads = [v for a, v in found if a == "/hypose/frame"]
    assert [v[0] for v in heads] == list(range(len(heads))) and len(heads) >= 25
    joints = [v for a, v in found if a == "/hypose/person/1/left_hand"]
    assert len(joints) >= 20 and len(joints[0]) == 4


@pytest.mark.parametrize("target", ["//[/in", "/in?token=%ff%00\\ud800", "/out?" + "token=x&" * 500, "/in\\", "*"])
def test_any_request_is_answered_without_a_traceback(target, caplog):
    async def play(server):
        for headers in ("", "Authorization: a\r\nAuthorization: b\r\n", "Authorization: \xff\r\n"):
            reader, writer = await asyncio.open_connection("127.0.0.1", server.ws_port)
            upgrade = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
            key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
            writer.write(f"GET {target} HTTP/1.1\r\nHost: x\r\n{upgrade}{key}{headers}\r\n".encode("latin-1"))
            status = int((await reader.readline()).split()[1])
            assert 400 <= status < 500, (target, headers, status)
            writer.close()
        reader, writer = await asyncio.open_connection("127.0.0.1", server.ws_port)
        writer.write(f"GET {target} HTTP/1.1\r\nHost: x\r\n\r\n".encode() + b"\x81\xfe\x02\x8b frames too early")
        await reader.read()  # until it is ended
        writer.close()

    live(play, token="a-good-token")
    assert "Traceback" not in caplog.text


def test_what_strangers_send_is_not_logged_and_bugs_are(caplog):
    quiet_logs()
    log = logging.getLogger("websockets.server")
    log.error("opening handshake failed", exc_info=ValueError("byte 0"))
    log.error("connection handler failed")
    assert [r.getMessage() for r in caplog.records] == ["connection handler failed"]
