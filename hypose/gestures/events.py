"""Turn the scores of gestures into events: a gesture starts once after it was held, and ends once after it was
released. Average precision of detections is computed here too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hypose.geometry import Array
from hypose.gestures.localise import Localisation


@dataclass(frozen=True)
class EventSettings:
    """Settings of the events of one gesture.

    threshold: score (cm^2) from which the gesture counts as shown.
    release: share of the threshold below which it counts as released (hysteresis).
    hold_s: s for which it must be shown to start.
    let_go_s: s for which it must be released to end.
    refractory_s: s after the end in which the same gesture does not start.
    """

    threshold: float
    release: float = 0.6
    hold_s: float = 0.15
    let_go_s: float = 0.15
    refractory_s: float = 0.5


@dataclass(frozen=True)
class Event(Localisation):
    """Start or end of a gesture, and its place in that frame.

    kind: "start" or "end".
    time: s.
    """

    kind: Literal["start", "end"]
    time: float


@dataclass(frozen=True)
class _Watch:
    on: bool = False
    since: float | None = None  # when it last crossed towards the other state
    ended: float = -np.inf


@dataclass(frozen=True)
class EventState:
    """State of the event detection between two frames: how long each gesture has been shown or released."""

    watches: Mapping[int, _Watch] = field(default_factory=dict)


def detect_events(
    state: EventState, found: Sequence[Localisation], time: float, settings: Sequence[EventSettings]
) -> tuple[EventState, list[Event]]:
    """Find the gestures that start or end in one frame.

    state: progress of the gestures before the frame.
    found: the best place of every gesture in the frame.
    time: s of the frame.
    settings: settings of each gesture, in the order of their numbers.
    Returns: the new progress, and the events of the frame.
    """
    watches, events = dict(state.watches), []
    for f in found:
        s = settings[f.gesture - 1]
        w = watches.get(f.gesture, _Watch())
        if w.on:
            crossing, needed = f.score < s.release * s.threshold, s.let_go_s
        else:
            crossing, needed = f.score >= s.threshold and time - w.ended >= s.refractory_s, s.hold_s
        since = time if w.since is None else w.since
        if crossing and time - since >= needed - 1e-9:
            events.append(Event(**vars(f), kind="end" if w.on else "start", time=time))
            w = _Watch(not w.on, None, time if w.on else w.ended)
        else:
            w = replace(w, since=since if crossing else None)
        watches[f.gesture] = w
    return EventState(watches), events


RADIUS_M = 0.05
"""m, largest distance of a correct localisation from the true point, in the picture plane at the gesture's depth."""


def precision_recall(scores: Array, correct: NDArray[np.bool_], positives: int) -> tuple[Array, Array]:
    """Compute precision and recall after each detection, best score first.

    scores: (N,); a score of 0 is no detection.
    correct: (N,) whether each detection is correct; among equal scores the wrong ones come first.
    positives: number of true gestures.
    Returns: precision and recall, one value per detection.
    """
    order = np.lexsort((correct, -scores))
    order = order[scores[order] > 0]
    hits = np.cumsum(correct[order])
    return hits / np.arange(1, len(order) + 1), hits / max(positives, 1)


def average_precision(scores: Array, correct: NDArray[np.bool_], positives: int) -> float:
    """Compute the average precision: the mean precision at each correct detection, where missed gestures count 0.

    scores: (N,) scores of the detections; a score of 0 is no detection.
    correct: (N,) whether each detection is correct; among equal scores the wrong ones come first.
    positives: number of true gestures.
    Returns: 0 to 1.
    """
    precision, recall = precision_recall(scores, correct, positives)
    return float((precision * np.diff(recall, prepend=0.0)).sum())
