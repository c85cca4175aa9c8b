"""Two simulated depth cameras played at their pace: how late the live engine's poses are."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from hypose.errors import EvidenceError
from hypose.pipeline.live.capture import CaptureOptions
from hypose.pipeline.live.engine import LiveEngine, LiveResult, LiveStatus, LiveTrackingOptions
from hypose.pipeline.live.live_rig import live_rig
from hypose.pipeline.live.live_search import LivePersonOptions
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.write_recording import walking_scene, write_depth_scene

_RATE = 25.0


class _Late:
    """A listener that notes how late each pose is, s."""

    def __init__(self) -> None:
        self.late: list[float] = []

    def seen(self, seen: LiveResult) -> None:
        """See `Listener`."""
        if seen.poses:
            self.late.append(time.monotonic() - seen.sight.arrival)

    def status(self, status: LiveStatus) -> None:
        """See `Listener`."""


def live_depth(seed: int, quick: bool) -> dict[str, Any]:
    """latency_p50_ms, latency_p99_ms of somebody who walks; an EvidenceError when nobody was found."""
    seconds = 15.0 if quick else 40.0
    scene = walking_scene("walk", "", "depth-2", seconds=seconds, frame_rate=_RATE, seed=seed)
    listener = _Late()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "depth"
        write_depth_scene(scene, folder)
        found = live_rig(folder, {})
        person = LivePersonOptions(TrackOptions(seed=seed), None, None)
        eyes = CaptureOptions(found.rate, 0.0, found.silhouettes)
        engine = LiveEngine(found.rig, found.views, LiveTrackingOptions(eyes, person), [listener])
        try:
            engine.start()
            engine.ended.wait(seconds + 10)
        finally:
            engine.stop()
    if engine.failed is not None:
        raise engine.failed
    if len(listener.late) < 2 * _RATE:
        raise EvidenceError("Nobody was followed long enough to tell how late poses are.")
    p50, p99 = np.percentile(listener.late, [50, 99]) * 1e3
    return {"latency_p50_ms": float(p50), "latency_p99_ms": float(p99)}
