"""From scores to events: a gesture starts once, when it has been held, and ends once, when it has been let go."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hypose.errors import InputError
from hypose.geometry import Array
from hypose.gestures.localise import Localisation


@dataclass(frozen=True)
class EventSettings:
    """Event settings.

    threshold: score (cm^2) from which a gesture counts.
    release: share of it below which it is let go (hysteresis).
    hold_s: how long it must be held to start, let_go_s: to end.
    refractory_s: rest after the end in which the same gesture does not start.
    """

    threshold: float
    release: float = 0.6
    hold_s: float = 0.15
    let_go_s: float = 0.15
    refractory_s: float = 0.5

    def __post_init__(self) -> None:
        if not (
            self.threshold > 0 and 0 < self.release <= 1 and min(self.hold_s, self.let_go_s, self.refractory_s) >= 0
        ):
            raise InputError(
                f"A threshold of {self.threshold} with release {self.release}, hold {self.hold_s} s, let go "
                f"{self.let_go_s} s and rest {self.refractory_s} s is not possible; the threshold must be positive, "
                "the release 0 to 1, times not negative."
            )


@dataclass(frozen=True)
class Event:
    """A gesture (number) started or ended at a time (s) at pixel (x, y), position (3,) m in the camera's frame."""

    kind: Literal["start", "end"]
    gesture: int
    time: float
    x: float
    y: float
    position: NDArray[np.float64] | None
    score: float


@dataclass(frozen=True)
class _Watch:
    on: bool = False
    since: float | None = None  # when it last crossed towards the other state
    ended: float = -np.inf


@dataclass(frozen=True)
class EventState:
    """Progress of every gesture."""

    watches: Mapping[int, _Watch] = field(default_factory=dict)

    def active(self) -> list[int]:
        """Gestures that have started and not ended."""
        return [g for g, w in self.watches.items() if w.on]


def detect_events(
    state: EventState, found: Sequence[Localisation], time: float, settings: Sequence[EventSettings]
) -> tuple[EventState, list[Event]]:
    """Return the next state and what happened in the frame of this time (s); settings in the order of the gestures."""
    watches, events = dict(state.watches), []
    for f in found:
        s = settings[f.gesture - 1]
        w = watches.get(f.gesture, _Watch())
        if w.on:
            crossing, needed = f.score < s.release * s.threshold, s.let_go_s
        else:
            crossing, needed = f.score >= s.threshold and time - w.ended >= s.refractory_s, s.hold_s
        if not crossing:
            w = replace(w, since=None)
        else:
            since = time if w.since is None else w.since
            if time - since >= needed - 1e-9:
                kind: Literal["start", "end"] = "end" if w.on else "start"
                events.append(Event(kind, f.gesture, time, f.x, f.y, f.position, f.score))
                w = _Watch(not w.on, None, time if w.on else w.ended)
            else:
                w = replace(w, since=since)
        watches[f.gesture] = w
    return EventState(watches), events


RADIUS_M = 0.05
"""Of a correct localization that does not depend on the distance, in the picture plane at the gesture's depth."""


def precision_recall(scores: Array, correct: NDArray[np.bool_], positives: int) -> tuple[Array, Array]:
    """Precision and recall after each detection, best score first; equal scores put the wrong ones first; a score of 0
    is no detection."""
    order = np.lexsort((correct, -scores))
    order = order[scores[order] > 0]
    hits = np.cumsum(correct[order])
    return hits / np.arange(1, len(order) + 1), hits / max(positives, 1)


def average_precision(scores: Array, correct: NDArray[np.bool_], positives: int) -> float:
    """Return mean precision at each correct detection, missed ones counting 0."""
    precision, recall = precision_recall(scores, correct, positives)
    return float((precision * np.diff(recall, prepend=0.0)).sum())
