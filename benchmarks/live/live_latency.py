"""The latency of the live path, measured through real sockets on this computer."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import socket
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from websockets.asyncio.client import connect

from benchmarks.synthetic.virtual_cameras import there_and_back
from hypose.app.live.simulated_sensors import builtin_joints, ring_sensors
from hypose.evidence.frame import SensorReport
from hypose.fusion.joints import COMMON
from hypose.geometry import Array, transform
from hypose.io.sensors.skeleton_streams import format_line


@dataclass(frozen=True)
class LatencyRun:
    """latency (N,) ms from the instant that a frame describes to when a WebSocket listener has it; missing: numbers of
    frames that never came; late_timers (M,) ms by which this machine woke a sleeping process too late meanwhile: what
    no program can undercut; people: most persons in one frame; returns: times that a sensor came back."""

    latency: Array
    missing: int
    late_timers: Array
    people: int
    returns: int


def measure_live_latency(
    seconds: float = 10.0,
    sensors: int = 3,
    rate: float = 30.0,
    people: int = 1,
    dead: tuple[float, float] | None = None,
) -> LatencyRun:
    """Runs `hypose fuse --live` as a process of its own; sensors send by UDP, a listener takes the frames by WebSocket.

    Sensors are not in step and have their own clocks; the first second is left out of the latency, while they are
    registered. dead: from when to when (s) the second sensor sends nothing. The latency includes the wait for late
    sensors (`AlignSettings.wait`, 5 ms).
    """
    return asyncio.run(_measure(seconds, sensors, rate, people, dead))


async def _measure(
    seconds: float, sensors: int, rate: float, people: int, dead: tuple[float, float] | None
) -> LatencyRun:
    lines = _lines(seconds, sensors, rate, people, dead)
    options = ("--udp", "0", "--ws", "0", "--rate", f"{rate:g}")
    server = await asyncio.create_subprocess_exec(
        *(sys.executable, "-P", "-u", "-m", "hypose.app", "fuse", "--live", *options),
        cwd=Path(__file__).parent,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
    )
    stop = threading.Event()
    arrived: dict[int, float] = {}
    most = returns = 0
    try:
        udp, out = await asyncio.wait_for(_ports(server), 120)
        sender = threading.Thread(target=_send, args=(lines, udp, stop), daemon=True)
        loop = asyncio.get_running_loop()
        async with connect(out, compression=None) as listener:
            sender.start()
            sleeping = asyncio.ensure_future(_late_timers(seconds))
            end = loop.time() + seconds + 0.2
            while (left := end - loop.time()) > 0:
                try:
                    text = await asyncio.wait_for(listener.recv(), left)
                except TimeoutError:
                    break
                now = loop.time()  # of the same monotonic clock as the server's
                value = json.loads(text)
                if value["type"] == "frame":
                    arrived[value["n"]] = now - value["time"]
                    most = max(most, len(value["people"]))
                elif value["type"] == "status":
                    returns = sum(s["returns"] for s in value["sensors"])
        late = await sleeping
        await asyncio.to_thread(sender.join, 2)
    finally:
        stop.set()
        with contextlib.suppress(ProcessLookupError):
            server.terminate()
        await server.wait()
    numbers = sorted(arrived)
    missing = numbers[-1] - numbers[0] + 1 - len(numbers) if numbers else 0
    latency = np.array([1000 * arrived[n] for n in numbers if n >= rate])
    return LatencyRun(latency, missing, late, most, returns)


async def _ports(server: asyncio.subprocess.Process) -> tuple[int, str]:
    """UDP port and address of /out, as the server prints them."""
    assert server.stdout is not None
    udp = 0
    while text := (await server.stdout.readline()).decode():
        if found := re.search(r"udp \S+:(\d+)", text):
            udp = int(found[1])
        if found := re.search(r"(ws://\S+/out)", text):
            return udp, found[1]
    raise RuntimeError("the live server ended before it opened its ports")


async def _late_timers(seconds: float) -> Array:
    loop = asyncio.get_running_loop()
    out, end = [], loop.time() + seconds
    while (now := loop.time()) < end:
        await asyncio.sleep(0.01)
        out.append(1000 * (loop.time() - now - 0.01))
    return np.array(out)


def _lines(
    seconds: float, sensors: int, rate: float, people: int, dead: tuple[float, float] | None = None
) -> list[tuple[float, bytes]]:
    """(when to send, line) in order: walking persons two metres apart, seen from a ring."""
    rng = np.random.default_rng(0)
    walk = builtin_joints("walk", min(seconds, 10.0), rng)
    cameras = ring_sensors(np.linspace(-60, 60, sensors) if sensors > 1 else [0.0], distance=3.5)
    out = []
    for k, camera in enumerate(cameras):
        phase = rng.uniform(0, 1 / rate)
        for n in range(int(seconds * rate)):
            t = phase + n / rate
            if k == 1 and dead is not None and dead[0] <= t < dead[1]:
                continue
            for p in range(people):
                place = np.array([(p % 3 - 1) * 2.0, (p // 3) * 2.0, 0.0]) if people > 1 else np.zeros(3)
                joints = (
                    walk[there_and_back(round(t * 30) + 17 * p, len(walk))] + place + rng.normal(size=(15, 3)) * 0.007
                )
                state = np.full(15, 2, dtype=np.uint8)
                line = SensorReport(f"s{k}", 100.0 * k + t, p, COMMON, transform(camera, joints), state)
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
