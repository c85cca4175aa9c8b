"""The latency of the live path, measured through real sockets on this computer."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
import time

import numpy as np
from websockets.asyncio.client import connect

from hypose.app.live_server import LiveOptions, LiveServer
from hypose.evaluation.sensors import builtin_joints, ring_sensors
from hypose.fusion.align import AlignSettings
from hypose.fusion.joints import COMMON
from hypose.fusion.live import LiveSettings
from hypose.geometry import Array, transform
from hypose.io.skeleton_lines import SkeletonLine, format_line


def measure_live_latency(seconds: float = 10.0, sensors: int = 3, rate: float = 30.0, people: int = 1) -> Array:
    """(N,) ms from the instant that a frame describes to when a WebSocket listener has it, sensors sending by UDP.

    Sensors are not in step and have their own clocks; the first second is left out, while they are registered. It
    includes the wait for late sensors (`AlignSettings.wait`, 5 ms).
    """
    return asyncio.run(_measure(seconds, sensors, rate, people))


async def _measure(seconds: float, sensors: int, rate: float, people: int) -> Array:
    server = LiveServer(LiveOptions(udp=0, ws=0, settings=LiveSettings(AlignSettings(rate=rate))))
    await server.start()
    lines = _lines(seconds, sensors, rate, people)
    stop = threading.Event()
    sender = threading.Thread(target=_send, args=(lines, server.udp_port, stop), daemon=True)
    out: list[tuple[int, float]] = []
    loop = asyncio.get_running_loop()
    try:
        async with connect(f"ws://127.0.0.1:{server.ws_port}/out", compression=None) as listener:
            sender.start()
            end = loop.time() + seconds + 0.2
            while (left := end - loop.time()) > 0:
                try:
                    value = json.loads(await asyncio.wait_for(listener.recv(), left))
                except TimeoutError:
                    break
                if value["type"] == "frame" and value["n"] >= rate:
                    out.append((value["n"], loop.time() - value["time"]))
    finally:
        stop.set()
        await server.stop()
        await asyncio.to_thread(sender.join, 2)
    return np.array([1000 * latency for _, latency in out])


def _lines(seconds: float, sensors: int, rate: float, people: int) -> list[tuple[float, bytes]]:
    """(when to send, line) in order: walking persons two metres apart, seen from a ring."""
    rng = np.random.default_rng(0)
    walk = builtin_joints("walk", min(seconds, 10.0), rng)
    cameras = ring_sensors(np.linspace(-60, 60, sensors) if sensors > 1 else [0.0], distance=3.5)
    out = []
    for k, camera in enumerate(cameras):
        phase = rng.uniform(0, 1 / rate)
        for n in range(int(seconds * rate)):
            t = phase + n / rate
            for p in range(people):
                place = np.array([(p % 3 - 1) * 2.0, (p // 3) * 2.0, 0.0]) if people > 1 else np.zeros(3)
                joints = walk[(round(t * 30) + 17 * p) % len(walk)] + place + rng.normal(size=(15, 3)) * 0.007
                state = np.full(15, 2, dtype=np.uint8)
                line = SkeletonLine(f"s{k}", 100.0 * k + t, p, COMMON, transform(camera, joints), state)
                out.append((t, format_line(line).encode()))
    return sorted(out, key=lambda x: x[0])


def _send(lines: list[tuple[float, bytes]], port: int, stop: threading.Event) -> None:
    begin = time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        for when, line in lines:
            left = begin + when - time.monotonic()
            if left > 0 and stop.wait(left):
                return
            s.sendto(line, ("127.0.0.1", port))
