"""A session with a forest: every frame goes through the state machine, teaches, and moves the threshold.

What a screen or a command line drives; it draws and writes nothing itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hypose.compute.forests import Depth
from hypose.gestures.forest import GrowingForest
from hypose.gestures.localise import Found, LocaliseSettings, localise
from hypose.gestures.online import Learner, Taught
from hypose.gestures.pictures import Lens
from hypose.gestures.session import Command, Instruction, Session, SessionSettings, observe, step


@dataclass(frozen=True)
class Feedback:
    """What to show for a frame: the instruction; the box (x, y) px; what was learned (None: nothing); the forest's
    maximum; the threshold so far (cm^2)."""

    instruction: Instruction
    box: tuple[float, float]
    taught: Taught | None
    found: Found | None
    threshold: float | None


def half_way(gestures: Sequence[float], others: Sequence[float]) -> float:
    """Half way between the strongest of the others' scores (0 without any) and the weaker gestures (lower quartile)."""
    return 0.5 * (float(np.quantile(gestures, 0.25)) + max(others, default=0.0))


KEPT = 12
"""Frames of each kind that are kept to find the threshold in the end."""


@dataclass(frozen=True)
class _Snapshot:
    arrays: tuple[NDArray[Any], ...]
    random: Mapping[str, Any]
    strength: dict[int, float]


class Trainer:
    """Teaches one gesture; the forest before the last segment is kept, so that the segment can be taken back."""

    def __init__(self, learner: Learner, settings: SessionSettings | None = None) -> None:
        self.learner, self.settings = learner, settings or SessionSettings()
        self.session = Session()
        self._before: _Snapshot | None = None
        self._segment = 0
        # every frame has the same chance of being kept; drawn apart from what is learned, so that it changes nothing
        self._keep, self._seen = np.random.default_rng(0), {"gesture": 0, "negative": 0}
        self._kept: dict[str, list[tuple[Depth, Lens, int]]] = {"gesture": [], "negative": []}

    @property
    def threshold(self) -> float | None:
        """The automatic threshold (cm^2); None until gesture and movement have been seen."""
        return self.session.threshold(self.settings)

    def frame(
        self,
        time: float,
        depth: Depth,
        lens: Lens,
        box: tuple[float, float],
        commands: Sequence[Command] = (),
        *,
        learn: bool = True,
    ) -> Feedback:
        """Take a frame (h, w) uint16 mm of a time (s); box: the pixel where the gesture is asked for; learn False: the
        frame is kept from the forest (to judge it by, or because it was shown before)."""
        self.session, instruction = step(self.session, self.settings, time, commands)
        if instruction.restart and self._before is not None:
            self._restore(self._before)
        taught, found = None, None
        if instruction.learn is not None:
            if instruction.segment != self._segment:
                self._segment, self._before = instruction.segment, self._snapshot()
            if learn:
                taught = self.learn(instruction.learn, depth, lens, box)
                found = None if taught is None or not taught.maxima else taught.maxima[0]
        elif instruction.phase == "test":
            found = localise(depth, lens, [self.learner.forest], self.learner.settings.look, self.learner.scratch)[0]
        return Feedback(instruction, box, taught, found, self.threshold)

    def learn(
        self,
        kind: Literal["gesture", "negative"],
        depth: Depth,
        lens: Lens,
        at: tuple[float, float],
        *,
        mine: bool = True,
    ) -> Taught | None:
        """Learn a frame outside the state machine's order (from a recording): the forest, the moving averages and the
        kept frames change as in a live session. None when no usable surface is at the pixel `at`."""
        learner = self.learner
        shows = kind == "gesture"
        taught = learner.show(depth, lens, 1, *at, mine=mine) if shows else learner.reject(depth, lens, mine=mine)
        if taught is not None:
            session = replace(self.session, phase="positive" if shows else "negative")
            if taught.maxima:
                session = observe(session, self.settings, taught.maxima[0].score)
            self.session = session
            self._remember(kind, (depth, lens, session.segment))
        return taught

    def final_threshold(self, look: LocaliseSettings | None = None) -> float | None:
        """The threshold (cm^2) of the forest as it is now, from the kept frames that were not taken back (`half_way`).

        Deviation: the published moving averages follow a forest that goes on changing, and what a gesture scores in the
        end differs; they are shown while training and used when one kind has not been kept."""
        forest = self.learner.forest.freeze()
        scores = {
            kind: [localise(d, lens, [forest], look)[0].score for d, lens, s in kept if s not in self.session.undone]
            for kind, kept in self._kept.items()
        }
        if not scores["gesture"] or not scores["negative"]:
            return self.threshold
        return half_way(scores["gesture"], scores["negative"])

    def _remember(self, kind: str, frame: tuple[Depth, Lens, int]) -> None:
        kept = self._kept[kind]
        self._seen[kind] += 1
        if len(kept) < KEPT:
            kept.append(frame)
        elif (place := int(self._keep.integers(self._seen[kind]))) < KEPT:
            kept[place] = frame

    def _snapshot(self) -> _Snapshot:
        a = self.learner
        arrays = tuple(x.copy() for x in a.forest.arrays)
        return _Snapshot(arrays, a.rng.bit_generator.state, dict(a.strength))

    def _restore(self, s: _Snapshot) -> None:
        forest = self.learner.forest
        arrays = type(forest.arrays)(*(x.copy() for x in s.arrays))
        self.learner.forest = GrowingForest(forest.settings, arrays)
        self.learner.rng.bit_generator.state = s.random
        self.learner.strength = dict(s.strength)
