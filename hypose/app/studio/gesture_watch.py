"""A session that watches for gestures that were taught: one frame in, what the page shows of it out."""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from hypose.app.jobs.gesture_job import finished, thresholds
from hypose.app.live.gesture_sources import Taken
from hypose.app.studio.gesture_controls import Controls
from hypose.app.studio.gesture_feed import Feed
from hypose.app.studio.gesture_train import Shown, event_message, position, rounded
from hypose.gestures.events import EventSettings, EventState, step
from hypose.gestures.localise import LocaliseSettings, Scratch, densities, settle
from hypose.gestures.model import GestureModel
from hypose.gestures.session import Command

_MEMORY = 0.8
"""Share of the new frame in the density, as `hypose gesture run` has it."""


class Watching:
    """Looks for the gestures of all models; nothing is learned or written."""

    told: dict[str, Any] = {"rounds": 0, "seconds": {}}
    folder = None
    asks = "free"

    def __init__(self, feed: Feed, models: Sequence[GestureModel]) -> None:
        self.feed = feed
        self.names = [n for m in models for n in m.names]
        self._forests, self._limits = finished(models), thresholds(models, None)
        self._look = LocaliseSettings(memory=_MEMORY)
        self._scratch, self._state, self._pause = Scratch(), EventState(), False

    @property
    def paused(self) -> bool:
        """Nothing goes on until the page says so."""
        return self._pause

    def frame(self, taken: Taken, controls: Controls, commands: Sequence[Command], fresh: bool) -> Shown:
        """Take a picture; fresh False: it was taken before, and only the commands are new."""
        for c in commands:
            self._pause = c == "pause" if c in ("pause", "continue") else self._pause
        lens = self.feed.source.lens
        began = clock.perf_counter()
        maps = densities(taken.depth, lens, self._forests, self._look, self._scratch)
        found = settle(maps, taken.depth, lens, self._look if fresh else replace(self._look, memory=1.0), self._scratch)
        spent = clock.perf_counter() - began
        limits = [controls.threshold or t for t in self._limits]
        events = []
        if fresh:
            settings = [EventSettings(t, hold_s=controls.hold_s) for t in limits]
            self._state, events = step(self._state, found, taken.time, settings)
        best = max(found, key=lambda f: f.score / limits[f.gesture - 1])
        limit = limits[best.gesture - 1]
        message = {
            "t": "step",
            "time": round(taken.time, 3),
            "phase": "test",
            "prompt": "Paused" if self._pause else "Watching",
            "left_s": None,
            "round": 0,
            "paused": self._pause,
            "box": None,
            "cross": [round(best.x, 1), round(best.y, 1)] if best.score > 0 else None,
            "position": position(best),
            "learned": None,
            "mined": [],
            "score": round(best.score, 3),
            "high": None,
            "low": None,
            "threshold": rounded(limit),
            "manual": controls.threshold is not None,
            "detected": best.score >= limit,
            "counts": {"gesture": 0, "negative": 0, "pixels": [], "nodes": 0, "segments": 0},
            "found": [
                {
                    "gesture": self.names[f.gesture - 1],
                    "score": round(f.score, 3),
                    "x": round(f.x, 1),
                    "y": round(f.y, 1),
                    "threshold": rounded(t),
                }
                for f, t in zip(found, limits, strict=True)
            ],
            "events": [event_message(e, self.names) for e in events],
            "ms": {"look": round(1e3 * spent, 2)},
        }
        return Shown(message, maps[best.gesture - 1][0] if controls.map else None)

    def judged(self, time: float, controls: Controls) -> dict[str, Any] | None:
        """Nothing is judged while watching."""
        return None

    def save(self, controls: Controls) -> Path | None:
        """There is nothing to save."""
        return None

    def close(self) -> None:
        """Nothing to close."""
