"""Training session of one gesture: a pure state machine (`advance`), and the trainer that lets a forest learn its
frames.

The phases are: do the gesture, hold it (positive), release, anything else (negative); they are repeated and followed by
a test. `advance` takes the time and the commands since the last call, and returns the next state and an instruction, so
that a session can be replayed exactly. `Trainer.frame` advances the session by a depth picture, learns from it and
updates the threshold. Drawing and recording belong to the caller.
Source: Alcoverro 2014, section 3.4, Fig. 3.10.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from hypose.compute.forests import DepthImage
from hypose.errors import InputError
from hypose.gestures.depth_pictures import DepthLens
from hypose.gestures.localise import Localisation, localise
from hypose.gestures.online import Learner, Taught

Phase = Literal["do_gesture", "positive", "release", "negative", "test"]
Command = Literal["next", "undo", "pause", "continue", "again", "test"]
COMMANDS: tuple[Command, ...] = ("next", "undo", "pause", "continue", "again", "test")
_AFTER: dict[Phase, Phase] = {
    "do_gesture": "positive",
    "positive": "release",
    "release": "negative",
    "test": "test",
}
_PROMPTS: dict[Phase, str] = {
    "do_gesture": "Do the gesture in the box",
    "positive": "Hold it, with small variations",
    "release": "Release",
    "negative": "Do anything else",
    "test": "Test",
}


@dataclass(frozen=True)
class SessionSettings:
    """Settings of a training session.

    do_gesture_s, positive_s, release_s, negative_s: duration of each phase, s.
    rounds: number of rounds before the test.
    sigma: share of the newest frame in the moving averages of the threshold.
    rho: weight of the positive average in the threshold (0.8: few false alarms).
    """

    do_gesture_s: float = 3.0
    positive_s: float = 5.0
    release_s: float = 2.0
    negative_s: float = 8.0
    rounds: int = 10
    sigma: float = 0.9
    rho: float = 0.8

    def seconds(self, phase: Phase) -> float:
        """Return the duration of a phase in s; that of the test is infinite."""
        return float("inf") if phase == "test" else float(getattr(self, f"{phase}_s"))


@dataclass(frozen=True)
class Session:
    """State of a training session.

    phase: current phase.
    entered: time at which it began, s.
    round: number of the round, from 0.
    segment: number of the current learning segment, counted up whenever one begins.
    paused: time since which the session is paused, s; None: it is not paused.
    undone: numbers of the segments that were undone.
    high, low: moving averages th+ and th- from which the threshold is computed.
    before: high and low when the segment began, for undo.
    """

    phase: Phase = "do_gesture"
    entered: float = 0.0
    round: int = 0
    segment: int = 0
    paused: float | None = None
    undone: tuple[int, ...] = ()
    high: float | None = None
    low: float | None = None
    before: tuple[float | None, float | None] = (None, None)

    def threshold(self, settings: SessionSettings) -> float | None:
        """Compute the threshold rho th+ + (1 - rho) th- (cm^2); None before both averages are known."""
        if self.high is None or self.low is None:
            return None
        return settings.rho * self.high + (1 - settings.rho) * self.low


@dataclass(frozen=True)
class Instruction:
    """Instruction of a training session for one frame.

    phase: phase of the session.
    prompt: text to show to the person.
    left_s: time left in the phase, s; infinite in the test.
    learn: "gesture": learn the gesture in the box; "negative": learn negatives; None: learn nothing.
    segment: number of the learning segment to which the frame belongs (0 = none).
    restart: whether the forest must return to its state at the start of the last segment.
    """

    phase: Phase
    prompt: str
    left_s: float
    learn: Literal["gesture", "negative"] | None
    segment: int
    restart: bool = False


def advance(
    session: Session, settings: SessionSettings, time: float, commands: Sequence[Command] = ()
) -> tuple[Session, Instruction]:
    """Advance a session to a time, and carry out commands.

    session: state after the last frame.
    settings: settings of the session.
    time: s.
    commands: "next": go to the next phase; "undo": undo the last learning segment; "pause" and "continue"; "again":
        start another round; "test": go to the test.
    Returns: the new state and the instruction for this frame.
    Raises: InputError for an unknown command.
    """
    s, restart = session, False
    for c in commands:
        if c not in COMMANDS:
            raise InputError(f"There is no command {c!r}; the commands are {', '.join(COMMANDS)}.")
        if c == "pause" and s.paused is None:
            s = replace(s, paused=time)
        elif c == "continue" and s.paused is not None:
            s = replace(s, entered=s.entered + time - max(s.paused, s.entered), paused=None)
        elif c == "next" and s.phase != "test":
            s = _follow(s, settings, time)
        elif c == "again":
            s = _enter(s, "do_gesture", time)
        elif c == "test":
            s = _enter(s, "test", time)
        elif c == "undo" and s.segment > 0 and s.segment not in s.undone:
            high, low = s.before
            back: Phase = "release" if s.phase == "negative" else "do_gesture" if s.phase == "positive" else s.phase
            s = replace(s, undone=(*s.undone, s.segment), high=high, low=low, phase=back, entered=time)
            restart = True
    if s.paused is None:
        # a slow frame may skip a phase of no length, but never a learning phase without a frame in it
        for _ in range(4):
            if time - s.entered < settings.seconds(s.phase):
                break
            s = _follow(s, settings, s.entered + settings.seconds(s.phase))
            if s.phase in ("positive", "negative"):
                s = replace(s, entered=time)
                break
    learns: dict[str, Literal["gesture", "negative"]] = {"positive": "gesture", "negative": "negative"}
    learn = learns.get(s.phase) if s.paused is None else None
    prompt = "Paused" if s.paused is not None else _PROMPTS[s.phase]
    left = settings.seconds(s.phase) - ((time if s.paused is None else max(s.paused, s.entered)) - s.entered)
    return s, Instruction(s.phase, prompt, max(0.0, left), learn, s.segment if learn else 0, restart)


def update_maximum(session: Session, settings: SessionSettings, maximum: float) -> Session:
    """Add the forest's maximum in a frame to the moving average of the current phase (th+ or th-).

    session: state of the session; it is returned as it is outside of the learning phases and while paused.
    settings: settings of the session.
    maximum: score of the best place, cm^2.
    Returns: the new state.
    """
    if session.paused is not None or session.phase not in ("positive", "negative"):
        return session
    name = "high" if session.phase == "positive" else "low"
    old = getattr(session, name)
    new = maximum if old is None else settings.sigma * maximum + (1 - settings.sigma) * old
    return replace(session, high=new) if name == "high" else replace(session, low=new)


def _follow(s: Session, settings: SessionSettings, time: float) -> Session:
    """Enter the phase after the current one; after the negatives another round, or the test after the last round.

    s, settings: state and settings of the session.
    time: at which the phase begins, s.
    """
    if s.phase != "negative":
        return _enter(s, _AFTER[s.phase], time)
    if s.round + 1 >= settings.rounds:
        return _enter(s, "test", time)
    return replace(_enter(s, "do_gesture", time), round=s.round + 1)


def _enter(s: Session, phase: Phase, time: float) -> Session:
    """Return the state `s` with a new phase that begins at `time`, s; a learning phase begins a new segment."""
    if phase in ("positive", "negative"):
        return replace(s, phase=phase, entered=time, segment=s.segment + 1, before=(s.high, s.low))
    return replace(s, phase=phase, entered=time)


@dataclass(frozen=True)
class Feedback:
    """Result of one frame of a training session, to be shown to the person.

    instruction: instruction of the session.
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
        shows: bool | None = None,
    ) -> Feedback:
        """Process one frame of the session.

        time: s.
        depth: (h, w) uint16 mm, 0 = hole.
        lens: lens parameters of the depth camera.
        box: (x, y) px, where the gesture is to be shown.
        commands: commands of the person since the last frame.
        learn: False: the forest does not learn the frame (to test the forest on it, or because it was learned before).
        shows: whether the frame shows the gesture; the forest does not learn it where the phase asks for the other.
            None: not known.
        Returns: what to show.
        """
        self.session, instruction = advance(self.session, self.settings, time, commands)
        if instruction.restart and self._before is not None:
            self._restore(self._before)
        taught, found = None, None
        if instruction.learn is not None:
            if instruction.segment != self._segment:
                self._segment, self._before = instruction.segment, self._snapshot()
            if learn and shows in (None, instruction.learn == "gesture"):
                taught = self.learn(instruction.learn, depth, lens, box)
                found = None if taught is None else taught.found
        elif instruction.phase == "test":
            found = localise(depth, lens, [self.learner.forest], self.learner.settings.look, self.learner.scratch)[0]
        return Feedback(instruction, box, taught, found, self.threshold)

    def learn(
        self,
        kind: Literal["gesture", "negative"],
        depth: DepthImage,
        lens: DepthLens,
        at: tuple[float, float],
    ) -> Taught | None:
        """Learn a frame outside the order of the session, such as one of a recording.

        kind: whether the frame shows the gesture or other movement.
        depth: (h, w) uint16 mm, 0 = hole.
        lens: lens parameters of the depth camera.
        at: (x, y) px of the gesture.
        Returns: what was learned; None where no usable depth is at the pixel. Forest, moving averages and the data of
            the threshold change as in a live session.
        """
        learner, shows = self.learner, kind == "gesture"
        taught = learner.show(depth, lens, *at) if shows else learner.reject(depth, lens)
        if taught is not None:
            score = taught.found.score  # before the frame was learned
            session = replace(self.session, phase="positive" if shows else "negative")
            self.session = update_maximum(session, self.settings, score)
            if shows:
                self._remember(depth, lens)
            else:
                self._movement.append(score)
        return taught

    def final_threshold(self) -> float | None:
        """Compute the threshold (cm^2) of the forest as it is now (`balanced`).

        Returns: the threshold from the moving averages (or None) where one kind of frame was not seen; None where the
            computed threshold is 0.

        It compares the scores of the gesture in the kept frames with those of other movement before it was learned,
        because learned frames score less than new ones.
        Deviation: the published moving averages follow a forest that still changes, so that they differ from what a
        gesture scores in the end. They are shown while training, and used where one kind of frame was not seen.
        """
        if not self._kept or not self._movement:
            return self.threshold
        forest = self.learner.forest.freeze()
        scores = [localise(depth, lens, [forest])[0].score for depth, lens in self._kept]
        return balanced(scores, self._movement) or None

    def _remember(self, depth: DepthImage, lens: DepthLens) -> None:
        """Keep a frame that shows the gesture for the final threshold; every frame has the same chance."""
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
        """Return to what `_snapshot` copied."""
        changing, kept, movement, self._shown = saved
        a = self.learner
        a.forest, a.rng, a.strength, self._keep = copy.deepcopy(changing)
        self._kept, self._movement = kept.copy(), movement.copy()
