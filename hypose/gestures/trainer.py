"""A session with a forest: every frame goes through the state machine, teaches, and moves the threshold.

What a screen or a command line drives; it draws and writes nothing itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hypose.compute.forests import Depth
from hypose.gestures.forest import GrowingForest
from hypose.gestures.localise import Found, localise
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


@dataclass(frozen=True)
class _Snapshot:
    arrays: tuple
    random: dict
    strength: dict[int, float]


class Trainer:
    """Teaches one gesture; the forest before the last segment is kept, so that the segment can be taken back."""

    def __init__(self, learner: Learner, settings: SessionSettings | None = None) -> None:
        self.learner, self.settings = learner, settings or SessionSettings()
        self.session = Session()
        self._before: _Snapshot | None = None
        self._segment = 0

    @property
    def threshold(self) -> float | None:
        """The automatic threshold (cm^2); None until gesture and movement have been seen."""
        return self.session.threshold(self.settings)

    def frame(
        self, time: float, depth: Depth, lens: Lens, box: tuple[float, float], commands: Sequence[Command] = ()
    ) -> Feedback:
        """Take a frame (h, w) uint16 mm of a time (s); box: the pixel where the gesture is asked for."""
        self.session, instruction = step(self.session, self.settings, time, commands)
        if instruction.restart and self._before is not None:
            self._restore(self._before)
        learner, taught, found = self.learner, None, None
        if instruction.learn is not None:
            if instruction.segment != self._segment:
                self._segment, self._before = instruction.segment, self._snapshot()
            if instruction.learn == "gesture":
                taught = learner.show(depth, lens, 1, *box)
            else:
                taught = learner.reject(depth, lens)
            if taught is not None:
                found = taught.maxima[0]
                self.session = observe(self.session, self.settings, found.score)
        elif instruction.phase == "test":
            found = localise(depth, lens, [learner.forest], learner.settings.look, learner.scratch)[0]
        return Feedback(instruction, box, taught, found, self.threshold)

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
