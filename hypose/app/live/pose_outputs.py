"""Run live tracking, and send its poses to other programs: WebSocket and UDP (JSON), OSC, VMC
(docs/cameras-live.md).
"""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hypose.app.live.osc import OscTarget, osc_bundles, people_osc, vmc_messages
from hypose.app.live.servers import SocketListeners
from hypose.body.default_body import JOINT_NAMES
from hypose.errors import InputError
from hypose.io.motions.results import json_values
from hypose.pipeline.live.capture import CaptureOptions
from hypose.pipeline.live.engine import Listener, LiveEngine, LiveResult, LiveStatus
from hypose.pipeline.live.live_people import LivePersonOptions, LivePose
from hypose.pipeline.live.live_rig import LiveRig
from hypose.pipeline.live.recorder import LiveRecorder

_UPPER = np.triu_indices(3)


def pose_json(pose: LivePose, latency: float, cameras: tuple[str, ...]) -> str:
    """Encode one pose as a line of JSON.

    latency: time since the arrival of the last picture, s.
    cameras: names of the cameras.
    """
    m = pose.motion
    assert m.error_probability is not None and m.low_confidence_joints is not None
    names = np.array(m.skeleton.joint_names)
    value = {
        "type": "pose",
        "n": pose.frame,
        "time": round(pose.time, 6),
        "latency_ms": round(1e3 * latency, 2),
        "id": pose.person,
        "lost": pose.lost,
        "cameras": [c for c, seen in zip(cameras, pose.views, strict=True) if seen],
        "joints": pose.joints.round(5).tolist(),
        "sd": m.joint_sd[0].astype(np.float64).round(5).tolist(),
        "covariance": [[float(f"{v:.3g}") for v in row] for row in m.joint_covariance[0][:, *_UPPER].tolist()],
        "wrong": m.error_probability[0].astype(np.float64).round(3).tolist(),
        "low_confidence": names[m.low_confidence_joints[0]].tolist(),
    }
    return json.dumps(value, separators=(",", ":"))


class PoseOutputs(Listener):
    """Listener of the live engine that sends poses to other programs.

    cameras: names of the cameras.
    rate: rate of the poses, Hz, for the first message to each listener.
    ws: port on this computer, with /out for JSON.
    udp, osc, vmc: HOST:PORT of the receivers of JSON lines, OSC and VMC; None: not sent.
    clock: time (s) on which the arrival of pictures is measured.
    Raises: InputError where a port or address cannot be used.
    """

    def __init__(
        self,
        cameras: tuple[str, ...],
        rate: float,
        *,
        ws: int | None = None,
        udp: str | None = None,
        osc: str | None = None,
        vmc: str | None = None,
        clock: Callable[[], float],
    ) -> None:
        self._cameras, self._clock = cameras, clock
        hello = {"type": "hello", "version": 1, "joints": JOINT_NAMES, "cameras": cameras, "rate": rate}
        self._outs: list[tuple[OscTarget, Callable[[Sequence[LivePose], float], list[bytes]]]] = []
        self._begin: float | None = None
        self.listeners: SocketListeners | None = None
        try:
            for address, option, made in ((udp, "--udp", self._lines), (osc, "--osc", _osc), (vmc, "--vmc", self._vmc)):
                if address is not None:
                    self._outs.append((OscTarget(address, option), made))
            self.listeners = None if ws is None else SocketListeners(ws, json.dumps(hello), "/out")
        except InputError:
            self.close()
            raise

    def _lines(self, poses: Sequence[LivePose], latency: float) -> list[bytes]:
        """Encode each pose as a line of JSON; latency: from the arrival of the last picture, s."""
        return [pose_json(pose, latency, self._cameras).encode() + b"\n" for pose in poses]

    def _vmc(self, poses: Sequence[LivePose], latency: float) -> list[bytes]:
        """Encode the pose of the first person for an avatar; VMC has no place for the latency."""
        pose = poses[0]
        self._begin = pose.time if self._begin is None else self._begin
        assert pose.motion.poses is not None
        return osc_bundles(vmc_messages(pose.body, pose.motion.poses[0], pose.time - self._begin, not pose.lost))

    def seen(self, seen: LiveResult) -> None:
        """Send the poses of an instant to all outputs."""
        if not seen.poses:
            return
        latency = self._clock() - seen.captured.arrival
        for target, made in self._outs:
            for datagram in made(seen.poses, latency):
                target.put(datagram)
        if self.listeners is not None and self.listeners.server.listeners:
            for pose in seen.poses:
                self.listeners.post(pose_json(pose, latency, self._cameras))

    def status(self, status: LiveStatus) -> None:
        """Send the state of the run to WebSocket listeners."""
        if self.listeners is not None:
            self.listeners.post(status_json(status))

    def close(self) -> None:
        """Close all outputs."""
        for target, _ in self._outs:
            target.close()
        if self.listeners is not None:
            self.listeners.close()


def _osc(poses: Sequence[LivePose], latency: float) -> list[bytes]:
    """Encode the poses of a frame as OSC bundles; latency: from the arrival of the last picture, s."""
    people = [(p.person, poses[0].motion.skeleton.joint_names, p.joints, p.motion.joint_sd[0]) for p in poses]
    return osc_bundles(people_osc(poses[0].frame, poses[0].time, latency, people, sum(not p.lost for p in poses)))


def status_json(status: LiveStatus) -> str:
    """Encode the state of the run as a line of JSON."""
    cameras = [
        {
            "name": c.name,
            "rate": round(c.rate, 1),
            "received": c.received,
            "lost": c.lost,
            "returns": c.returns,
            "trouble": c.trouble,
            "offset_ms": round(1e3 * late, 1),
        }
        for c, late in zip(status.cameras, status.offsets or (0.0,) * len(status.cameras), strict=False)
    ]
    value = {
        "type": "status",
        "phase": status.phase,
        "words": status.words,
        "cameras": cameras,
        "poses": status.poses,
        "per_second": round(status.per_second, 1),
        "skipped": round(status.skipped, 3),
        "latency_ms": [round(v, 1) for v in status.latency],
        "stages_ms": {k: round(v, 1) for k, v in status.stages.items()},
        "fitted": status.fitted,
    }
    return json.dumps(json_values(value), separators=(",", ":"))


class TrackingRun:
    """Live tracking with the cameras of a rig, its outputs and its recording, from the start until `close`.

    capture, person, people: options of the engine.
    listeners: further receivers of the results.
    record: new folder for a recording; None: nothing is recorded.
    stop: event from outside that ends the tracking, also while it starts.
    outputs: addresses of `PoseOutputs`.
    Raises: InputError where an address, the folder or a camera cannot be used; nothing stays open then.
    """

    def __init__(
        self,
        cameras: LiveRig,
        capture: CaptureOptions,
        person: LivePersonOptions,
        people: int,
        *,
        listeners: Sequence[Any] = (),
        record: Path | None = None,
        stop: threading.Event | None = None,
        **outputs: Any,  # noqa: ANN401 (of different types)
    ) -> None:
        self.cameras: tuple[str, ...] = tuple(v.name for v in cameras.views)
        self.recorder: LiveRecorder | None = None
        with contextlib.ExitStack() as parts:
            self.outputs: PoseOutputs = PoseOutputs(self.cameras, cameras.rate, clock=time.monotonic, **outputs)
            parts.callback(self.outputs.close)
            listeners = [self.outputs, *listeners]
            if record is not None:
                self.recorder = LiveRecorder(record, cameras.rig, cameras.views, cameras.silhouettes, person.height)
                parts.callback(self.recorder.close)
                listeners.append(self.recorder)
            capture = replace(capture, pictures=capture.pictures or record is not None)
            about = {"people": people, "listeners": listeners, "stop": stop}
            self.engine: LiveEngine = LiveEngine(cameras.rig, cameras.views, capture, person, **about)
            parts.callback(self.engine.stop)
            self.engine.start()
            parts.pop_all()

    def close(self, record: str | None) -> str:
        """Stop the tracking and complete the recording; return a sentence on the recording, "" where there is none.

        record: name of the recording for the sentence.
        Raises: InputError where the recording was removed meanwhile.
        """
        self.engine.stop()
        try:
            kept = self.recorder is not None and self.recorder.close()
        finally:
            self.outputs.close()
        if self.recorder is None:
            return ""
        without = f", without {self.recorder.left_out} instants" if self.recorder.left_out else ""
        nothing = "Nothing was recorded: no instant was seen by two cameras after the empty room was known."
        return f"Recorded as {record}{without}." if kept else nothing
