"""Run a training session with a forest: every frame goes through the state machine, is learned, and updates the
threshold.

Screens and command lines call it; it draws and writes nothing itself.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from hypose.compute.forests import DepthImage
from hypose.gestures.depth_pictures import DepthLens
from hypose.gestures.localise import Localisation, LocaliseSettings, localise
from hypose.gestures.online import Learner, Taught
from hypose.gestures.session import Command, Instruction, Session, SessionSettings, advance, update_maximum


@dataclass(frozen=True)
class Feedback:
    """What to show for one frame.

    instruction: of the session.
    box: (x, y) px, where the gesture is to be shown.
    taught: what was learned; None: nothing.
    found: best place of the gesture in the frame; None where it was not searched.
    threshold: current threshold, cm^2; None before it is known.
    """

    instruction: Instruction
    box: tuple[float, float]
    taught: Taught | None
    found: Localisation | None
    threshold: float | None


def balanced(gestures: Sequence[float], others: Sequence[float]) -> float:
    """Compute a threshold between the scores of the gesture and those of other movement, 0.3 of the way on a
    logarithmic scale.

    gestures: scores in frames that show the gesture, cm^2; their median is the upper end.
    others: scores in frames of other movement, cm^2; the level that every tenth frame exceeds is the lower end.
    Returns: cm^2.

    The lower end is read off an exponential tail above the median, so that all frames contribute to it; the strongest
    frame alone would be chance. It is at least a tenth of the upper end, because movement that never scored gives no
    information about later movement.
    """
    usual, middle = float(np.median(gestures)), float(np.median(others))
    above = [v - middle for v in others if v > middle]
    level = middle + (float(np.mean(above)) * np.log(0.5 * _ONE_IN) if above else 0.0)
    return float(max(level, _LEAST_THRESHOLD * usual) ** (1 - _TOWARDS) * usual**_TOWARDS)


_ONE_IN, _TOWARDS, _LEAST_THRESHOLD = 10, 0.3, 0.1  # chosen on people for whom no results are reported
_KEPT = 16
"""Number of frames with the gesture that are kept to compute the final threshold."""


class Trainer:
    """Trainer of one gesture. It keeps the forest before the last segment, so that the segment can be undone."""

    def __init__(self, learner: Learner, settings: SessionSettings | None = None) -> None:
        self.learner, self.settings = learner, settings or SessionSettings()
        self.session = Session()
        self._before: tuple[Any, ...] | None = None
        self._segment = 0
        # frames that show the gesture, each kept with the same probability; the generator is not that of the pixels
        self._keep, self._shown = np.random.default_rng(0), 0
        self._kept: list[tuple[DepthImage, DepthLens]] = []
        self._movement: list[float] = []  # what the forest scored in frames of other movement before it learned them

    @property
    def threshold(self) -> float | None:
        """Threshold from the moving averages (cm^2); None until both gesture and other movement were seen."""
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
        """Process one frame of the session.

        time: s.
        depth: (h, w) uint16 mm, 0 = hole.
        lens: of the depth camera.
        box: (x, y) px, where the gesture is to be shown.
        commands: of the person since the last frame.
        learn: False: the forest does not learn the frame (to test the forest on it, or because it was learned before).
        Returns: what to show.
        """
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
        """Learn a frame outside the order of the session, such as one of a recording.

        kind: whether the frame shows the gesture or other movement.
        depth: (h, w) uint16 mm, 0 = hole.
        lens: of the depth camera.
        at: (x, y) px of the gesture.
        mine: whether to learn hard negatives.
        Returns: what was learned; None where no usable depth is at the pixel. Forest, moving averages and the data of
            the threshold change as in a live session.
        """
        learner, shows = self.learner, kind == "gesture"
        look = learner.settings.look
        # the score is that before the frame is learned, as with hard negatives
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
        """Compute the threshold (cm^2) of the forest as it is now (`balanced`).

        look: settings of the localisation.

        It compares the scores of the gesture in the kept frames with those of other movement before it was learned,
        because learned frames score less than new ones.
        Deviation: the published moving averages follow a forest that still changes, so that they differ from what a
        gesture scores in the end. They are shown while training, and used where one kind of frame was not seen.
        """
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

    def _snapshot(self) -> tuple[Any, ...]:
        """Copy what a segment changes: the learner and the data of the threshold."""
        a = self.learner
        changing = copy.deepcopy((a.forest, a.rng, a.strength, self._keep))
        return changing, self._kept.copy(), self._movement.copy(), self._shown  # pictures do not change

    def _restore(self, saved: tuple[Any, ...]) -> None:
        changing, kept, movement, self._shown = saved
        a = self.learner
        a.forest, a.rng, a.strength, self._keep = copy.deepcopy(changing)
        self._kept, self._movement = kept.copy(), movement.copy()
