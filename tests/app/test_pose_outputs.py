"""Poses as programs get them: JSON, bytes, UDP lines, OSC, avatars; nobody waits for anybody."""

import json
import re
import runpy
import socket
import threading
import time
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from benchmarks.robustness.small_recordings import small_scene
from hypose.app.live.pose_outputs import PoseOutputs, pose_json
from hypose.body.default_body import JOINT_NAMES
from hypose.errors import InputError
from hypose.pipeline.live.engine import LiveStatus
from hypose.pipeline.live.feeds import FeedStatus
from tests.conftest import HANG_S, ROOT
from tests.live_scenes import Beside, follow, people_for, seen
from tests.osc_packets import parse_osc, udp_sink

CAMERAS = ("cam1", "cam2", "cam3", "cam4")
J = len(JOINT_NAMES)


@pytest.fixture(scope="module")
def followed():
    """(frame, pose) of a second of walking."""
    frames, beside = list(small_scene(1, 40).mask_frames()), Beside()
    poses = follow(people_for(frames, beside), frames, beside)
    assert len(poses) > 15
    return [(frames[p.frame], p) for p in poses]


def outputs(**options):
    return PoseOutputs(CAMERAS, 25.0, clock=lambda: 5.0, **options)


def reported(out, followed):
    for frame, pose in followed:
        out.seen(seen(frame, pose))


def no_constants(name):
    raise AssertionError(f"{name} is no JSON")


def read(text):
    return json.loads(text, parse_constant=no_constants)


# ---- what a pose is ----


def test_a_pose_in_json(followed):
    _, pose = followed[-1]
    pose = replace(pose, views=np.array([True, False, True, True]))
    value = read(pose_json(pose, 0.0123, CAMERAS))
    assert value["type"] == "pose" and value["n"] == pose.frame and value["id"] == 1 and value["lost"] is False
    assert value["latency_ms"] == pytest.approx(12.3) and value["time"] == pytest.approx(pose.time)
    assert value["cameras"] == ["cam1", "cam3", "cam4"]
    assert value["joints"] == pytest.approx(pose.joints, abs=1e-5) and np.shape(value["joints"]) == (J, 3)
    assert len(value["sd"]) == len(value["wrong"]) == J
    covariance = np.asarray(value["covariance"])[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]  # from xx, xy, xz, yy, yz, zz
    assert covariance == pytest.approx(pose.motion.joint_covariance[0], rel=0.01, abs=1e-7)
    assert all(0 < s < 1 for s in value["sd"]) and all(0 <= w <= 1 for w in value["wrong"])
    assert set(value["low_confidence"]) <= set(JOINT_NAMES)


STATUS = LiveStatus(
    "following",
    ("cam2 is missing: it sends no pictures",),
    (FeedStatus("cam1", 100, 2, 29.97, 0, "", False), FeedStatus("cam2", 10, 0, 0.0, 1, "it sends no pictures", False)),
    90,
    29.5,
    0.02,
    (31.2, float("nan")),
    {"masks": 12.34, "track": float("nan")},
    (0.0, 0.04),
    True,
)


# ---- by WebSocket ----


@pytest.fixture
def out():
    """Outputs to a WebSocket on a free port."""
    with closing(outputs(ws=0)) as out:
        yield out


def test_json_by_websocket(followed, out):
    with connect(f"ws://127.0.0.1:{out.listeners.port}/out?x=1") as text:
        hello = {"type": "hello", "version": 1, "joints": list(JOINT_NAMES), "cameras": list(CAMERAS), "rate": 25.0}
        assert read(text.recv(HANG_S)) == hello
        for frame, pose in followed:
            out.seen(seen(frame, pose))
            value = read(text.recv(HANG_S))
            assert value["n"] == pose.frame
            assert value["latency_ms"] == pytest.approx(1e3 * (5.0 - frame.time - 0.01), abs=0.01)
        out.status(STATUS)
        assert read(text.recv(HANG_S))["type"] == "status"
        out.seen(seen(followed[0][0], None))  # without a person nothing is sent
        with pytest.raises(TimeoutError):
            text.recv(0.05)


def test_the_receiver_of_the_documentation(followed, tmp_path, capsys):
    out = outputs(ws=0)
    text = (ROOT / "docs" / "cameras-live.md").read_text(encoding="utf-8")
    program = next(p for p in text.split("```python\n")[1:] if "/out" in p).split("```")[0]
    (tmp_path / "receiver.py").write_text(program.replace("9872", str(out.listeners.port)))
    receiver = threading.Thread(target=runpy.run_path, args=(tmp_path / "receiver.py",))
    receiver.start()
    while not out.listeners.server.listeners:
        assert receiver.is_alive()
        time.sleep(0.01)
    reported(out, followed[:5])
    out.close()
    receiver.join(HANG_S)
    numbers = re.findall(r"^(\d+) 1 \[", capsys.readouterr().out, re.MULTILINE)
    assert numbers == [str(pose.frame) for _, pose in followed[:5]]


@pytest.mark.parametrize("path", ["/", "/in", "/out/x", "/Out"])
def test_other_paths_are_refused(out, path):
    with pytest.raises(InvalidStatus, match="404"):
        connect(f"ws://127.0.0.1:{out.listeners.port}{path}")


def test_who_does_not_read_costs_the_others_no_pose(followed, out):
    ask = "GET /out HTTP/1.1\r\nHost: x\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
    address, outbox = ("127.0.0.1", out.listeners.port), out.listeners.server
    with socket.create_connection(address) as silent, connect(f"ws://127.0.0.1:{address[1]}/out") as reading:
        silent.sendall(f"{ask}Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode())
        assert silent.recv(12) == b"HTTP/1.1 101"
        reading.recv(HANG_S)
        for _ in range(150):  # what the system keeps for a listener that does not read is full
            out.listeners.post("x" * 100_000)
            assert len(reading.recv(HANG_S)) == 100_000
        assert (dropped := outbox.dropped) > 50
        for frame, pose in followed:
            out.seen(seen(frame, pose))
            assert read(reading.recv(HANG_S))["n"] == pose.frame
        assert outbox.dropped == dropped + len(followed)


def test_a_taken_port_and_bad_targets_are_one_sentence_and_nothing_stays_open(followed):
    out = outputs(ws=0)
    port = out.listeners.port
    with pytest.raises(InputError, match=f"Port {port} cannot be used .*; choose another with --ws"):
        outputs(ws=port, udp="127.0.0.1:9")
    out.close()
    outputs(ws=port).close()
    for option in ("udp", "osc", "vmc"):
        for address in ("nowhere", "127.0.0.1", "127.0.0.1:", "127.0.0.1:0", "127.0.0.1:70000", ":9000", "no.such.:1"):
            with pytest.raises(InputError, match=f"--{option} .* cannot be reached; give HOST:PORT"):
                outputs(**{option: address})


# ---- by UDP ----


def received(followed, option):
    packets = []
    with udp_sink(packets) as address, closing(outputs(**{option: address})) as out:
        reported(out, followed)
    return packets


def test_a_line_per_pose_by_udp(followed):
    packets = received(followed, "udp")
    assert len(packets) == len(followed) and all(p.endswith(b"\n") and p.count(b"\n") == 1 for p in packets)
    assert [read(p)["n"] for p in packets] == [pose.frame for _, pose in followed]


def test_osc(followed):
    found = [m for p in received(followed, "osc") for m in parse_osc(p)]
    heads = [v for a, v in found if a == "/hypose/frame"]
    assert [v[0] for v in heads] == [pose.frame for _, pose in followed]
    assert [v[1] for v in heads] == [pose.time for _, pose in followed] and all(v[3] == 1 for v in heads)
    for k, name in enumerate(JOINT_NAMES):
        rows = np.array([v for a, v in found if a == f"/hypose/person/1/{name}"])
        assert rows[:, :3] == pytest.approx(np.array([pose.joints[k] for _, pose in followed]), abs=1e-5)
        assert (rows[:, 3] > 0).all()
