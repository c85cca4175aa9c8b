"""A session with a forest: every frame goes through the state machine, teaches, and moves the threshold.

What a screen or a command line drives; it draws and writes nothing itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hypose.compute.forests import DepthImage
from hypose.gestures.depth_pictures import DepthLens
from hypose.gestures.forest import GrowingForest
from hypose.gestures.localise import Localisation, LocaliseSettings, localise
from hypose.gestures.online import Learner, Taught
from hypose.gestures.session import Command, Instruction, Session, SessionSettings, advance, update_maximum


@dataclass(frozen=True)
class Feedback:
    """What to show for a frame: the instruction; the box (x, y) px; what was learned (None: nothing); the forest's
    maximum; the threshold so far (cm^2)."""

    instruction: Instruction
    box: tuple[float, float]
    taught: Taught | None
    found: Localisation | None
    threshold: float | None


def balanced(gestures: Sequence[float], others: Sequence[float]) -> float:
    """Return a threshold (cm^2) 0.3 of the way, on a logarithmic scale, from what every tenth frame of other movement
    reaches to what the gesture usually (median) scores.

    What every tenth frame reaches is read off an exponential tail above the median of the others' scores: all frames
    have a say in it, where the strongest one alone is chance. At least a tenth of the usual score, because movement
    that never scored says nothing about movement to come.
    """
    usual, middle = float(np.median(gestures)), float(np.median(others))
    above = [v - middle for v in others if v > middle]
    level = middle + (float(np.mean(above)) * np.log(0.5 * _ONE_IN) if above else 0.0)
    return float(max(level, _LEAST_THRESHOLD * usual) ** (1 - _TOWARDS) * usual**_TOWARDS)


_ONE_IN, _TOWARDS, _LEAST_THRESHOLD = 10, 0.3, 0.1  # chosen on people of whom no figure is reported
_KEPT = 16
"""Frames that show the gesture that are kept to find the threshold in the end."""


@dataclass(frozen=True)
class _Snapshot:
    arrays: tuple[NDArray[Any], ...]
    random: Mapping[str, Any]
    strength: dict[int, float]
    kept: list[tuple[DepthImage, DepthLens]]
    movement: list[float]
    shown: int
    keep: Mapping[str, Any]


class Trainer:
    """Teaches one gesture; the forest before the last segment is kept, so that the segment can be taken back."""

    def __init__(self, learner: Learner, settings: SessionSettings | None = None) -> None:
        self.learner, self.settings = learner, settings or SessionSettings()
        self.session = Session()
        self._before: _Snapshot | None = None
        self._segment = 0
        # frames that show the gesture; every one has the same chance of being kept; drawn apart from the learned pixels
        self._keep, self._shown = np.random.default_rng(0), 0
        self._kept: list[tuple[DepthImage, DepthLens]] = []
        self._movement: list[float] = []  # what the forest scored in frames of other movement before it learned them

    @property
    def threshold(self) -> float | None:
        """Return the automatic threshold (cm^2); None until gesture and movement have been seen."""
        return self.session.threshold(self.settings)

    def frame(
        self,
        time: float,
        depth: DepthImage,
        lens: DepthLens,
        box: tuple[float, float],
        commands: Sequence[Command] = (),
        *,
        learn: bool = True,
    ) -> Feedback:
        """Take a frame (h, w) uint16 mm of a time (s); box: the pixel where the gesture is asked for; learn False: the
        frame is kept from the forest (to judge it by, or because it was shown before)."""
        self.session, instruction = advance(self.session, self.settings, time, commands)
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
        depth: DepthImage,
        lens: DepthLens,
        at: tuple[float, float],
        *,
        mine: bool = True,
    ) -> Taught | None:
        """Learn a frame outside the state machine's order (from a recording): the forest, the moving averages and what
        the threshold is found from change as in a live session. None when no usable surface is at the pixel `at`."""
        learner, shows = self.learner, kind == "gesture"
        look = learner.settings.look
        # as hard negatives do, before it is learned
        found = None if mine else localise(depth, lens, [learner.forest], look, learner.scratch)[0]
        taught = learner.show(depth, lens, 1, *at, mine=mine) if shows else learner.reject(depth, lens, mine=mine)
        if taught is not None:
            score = (found or taught.maxima[0]).score
            session = replace(self.session, phase="positive" if shows else "negative")
            self.session = update_maximum(session, self.settings, score)
            if shows:
                self._remember(depth, lens)
            else:
                self._movement.append(score)
        return taught

    def final_threshold(self, look: LocaliseSettings | None = None) -> float | None:
        """The threshold (cm^2) of the forest as it is now (`balanced`): the gesture's scores in the kept frames, and
        those of movement before it was learned, since what was learned scores less than what comes new.

        Deviation: the published moving averages follow a forest that goes on changing, and what a gesture scores in the
        end differs; they are shown while training and used when one kind has not been seen."""
        if not self._kept or not self._movement:
            return self.threshold
        forest = self.learner.forest.freeze()
        scores = [localise(depth, lens, [forest], look)[0].score for depth, lens in self._kept]
        return balanced(scores, self._movement) or None

    def _remember(self, depth: DepthImage, lens: DepthLens) -> None:
        self._shown += 1
        if len(self._kept) < _KEPT:
            self._kept.append((depth, lens))
        elif (place := int(self._keep.integers(self._shown))) < _KEPT:
            self._kept[place] = depth, lens

    def _snapshot(self) -> _Snapshot:
        a = self.learner
        arrays = tuple(x.copy() for x in a.forest.arrays)
        keep = self._keep.bit_generator.state
        kept, movement = self._kept.copy(), self._movement.copy()
        return _Snapshot(arrays, a.rng.bit_generator.state, dict(a.strength), kept, movement, self._shown, keep)

    def _restore(self, s: _Snapshot) -> None:
        forest = self.learner.forest
        arrays = type(forest.arrays)(*(x.copy() for x in s.arrays))
        self.learner.forest = GrowingForest(forest.settings, arrays)
        self.learner.rng.bit_generator.state = s.random
        self.learner.strength = dict(s.strength)
        self._kept, self._movement, self._shown = s.kept.copy(), s.movement.copy(), s.shown
        self._keep.bit_generator.state = s.keep
