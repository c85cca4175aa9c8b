"""How good a forest is while it is taught: on frames that are kept from it, and on movement before it is learned."""

from __future__ import annotations

import threading
from typing import Any, NamedTuple

import numpy as np

from hypose.compute import DepthImage
from hypose.gestures.depth_pictures import DepthLens, surface_depth
from hypose.gestures.events import (
    RADIUS_M,
    EventSettings,
    EventState,
    average_precision,
    detect_events,
    precision_recall,
)
from hypose.gestures.forest import Forest
from hypose.gestures.localise import Localisation, Scratch, localise

_KEPT = 40
"""Frames of each kind that are kept; every frame has the same chance."""
_WINDOW_S = 60.0
"""s of movement over which false alarms are counted."""
_POINTS = 100
"""At most so many points of a curve are told."""


class _Seen(NamedTuple):
    """score, error (m; inf where the gesture is not done) and whether it is done."""

    score: float
    error: float
    shown: bool


class HeldBack:
    """Frames that are kept from a forest; judged in a thread of its own, so that the session does not wait."""

    def __init__(self, lens: DepthLens) -> None:
        self._lens, self._keep = lens, np.random.default_rng(0)
        # by whether the gesture is done: depth, its pixel (None: it is not done), segment
        self._frames: dict[bool, list[tuple[DepthImage, tuple[float, float] | None, int]]] = {True: [], False: []}
        self._count = {True: 0, False: 0}
        self._tested: list[_Seen] = []
        self._busy: threading.Thread | None = None
        self._result: dict[str, Any] | None = None

    def keep(self, depth: DepthImage, at: tuple[float, float] | None, segment: int) -> None:
        """A frame of a learning segment that is not learned; at: pixel of the gesture, None for other movement."""
        kept, shown = self._frames[at is not None], at is not None
        self._count[shown] += 1
        if len(kept) < _KEPT:
            kept.append((depth, at, segment))
        elif (place := int(self._keep.integers(self._count[shown]))) < _KEPT:
            kept[place] = depth, at, segment

    def test(self, depth: DepthImage, at: tuple[float, float] | None, found: Localisation) -> None:
        """A frame of the test whose truth is known."""
        self._tested.append(_judged(depth, self._lens, at, found))

    def drop(self, undone: tuple[int, ...]) -> None:
        """Forget the frames of segments that were taken back."""
        self._frames = {shown: [k for k in kept if k[2] not in undone] for shown, kept in self._frames.items()}

    def begin(self, forest: Forest) -> None:
        """Look at the kept frames again with the forest as it is now, unless that is still going on."""
        if self._busy is None or not self._busy.is_alive():
            frames = [*self._frames[True], *self._frames[False]]
            self._busy = threading.Thread(target=self._look, args=(forest, frames), daemon=True)
            self._busy.start()

    def _look(self, forest: Forest, frames: list[tuple[DepthImage, tuple[float, float] | None, int]]) -> None:
        scratch = Scratch()
        found = [(d, at, localise(d, self._lens, [forest], None, scratch)[0]) for d, at, _ in frames]
        self._result = _curve([_judged(d, self._lens, at, f) for d, at, f in found]) | {"on": "held-back"}

    def result(self, threshold: float | None) -> dict[str, Any] | None:
        """The newest judgement once, None when there is none that is new: of the test when it has both kinds of frame,
        else of the kept frames."""
        new, self._result = self._result, None
        if {s.shown for s in self._tested} == {True, False}:
            new = _curve(self._tested) | {"on": "test"}
        return None if new is None else new | {"at": _at(new, threshold)}


def _judged(depth: DepthImage, lens: DepthLens, at: tuple[float, float] | None, found: Localisation) -> _Seen:
    z = None if at is None else surface_depth(depth, *at)
    if at is None or z is None:
        return _Seen(found.score, np.inf, at is not None)
    return _Seen(found.score, float(np.hypot(found.x - at[0], found.y - at[1])) * z / 1000 / lens.fx, True)


def _curve(seen: list[_Seen]) -> dict[str, Any]:
    scores, correct = np.array([s.score for s in seen]), np.array([s.error for s in seen]) <= RADIUS_M
    positives = sum(s.shown for s in seen)
    out: dict[str, Any] = {"frames": len(seen), "positives": positives, "ap": None}
    if not positives or positives == len(seen):
        return out | {"precision": [], "recall": [], "scores": []}
    precision, recall = precision_recall(scores, correct, positives)
    ranked = scores[np.lexsort((correct, -scores))]
    ranked = ranked[ranked > 0]
    pick = np.unique(np.linspace(0, len(ranked) - 1, min(_POINTS, len(ranked))).astype(int))
    return out | {
        "ap": average_precision(scores, correct, positives),
        "precision": precision[pick].round(4).tolist(),
        "recall": recall[pick].round(4).tolist(),
        "scores": ranked[pick].round(3).tolist(),
    }


def _at(curve: dict[str, Any], threshold: float | None) -> dict[str, float] | None:
    """Precision and recall of the scores from the threshold on."""
    if threshold is None or not curve["scores"]:
        return None
    passed = [k for k, s in enumerate(curve["scores"]) if s >= threshold]
    if not passed:
        return {"precision": 1.0, "recall": 0.0}
    return {"precision": curve["precision"][passed[-1]], "recall": curve["recall"][passed[-1]]}


class FalseAlarms:
    """Events in movement that the forest has not learned yet, over the last minute of it."""

    def __init__(self) -> None:
        self._state, self._clock = EventState(), 0.0
        self._last: float | None = None
        self._starts: list[float] = []

    def see(self, time: float, found: Localisation, threshold: float | None, hold_s: float) -> None:
        """A frame of other movement, looked at before it is learned."""
        if self._last is not None and 0 < time - self._last < 1:
            self._clock += time - self._last
        elif self._last is not None:  # another segment: what went on has ended meanwhile
            self._state = EventState()
        self._last = time
        if threshold is None or threshold <= 0:
            return
        settings = [EventSettings(threshold, hold_s=hold_s)] * found.gesture
        self._state, events = detect_events(self._state, [found], self._clock, settings)
        self._starts += [self._clock for e in events if e.kind == "start"]

    def told(self) -> dict[str, float | None]:
        """false_per_min and tested_s."""
        seconds = min(self._clock, _WINDOW_S)
        recent = sum(t > self._clock - _WINDOW_S for t in self._starts)
        return {"false_per_min": recent * 60 / seconds if seconds > 5 else None, "tested_s": round(seconds, 1)}
