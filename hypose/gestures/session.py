"""Training session as a pure state machine: instructions to the person, frames to learn, the threshold.

The phases are: do the gesture, hold it (positive), release, anything else (negative); they are repeated and followed by
a test. `advance` takes the time and the commands since the last call, and returns the next state and an instruction.
Drawing, learning and recording belong to the caller, so that a session can be replayed exactly.
Source: Alcoverro 2014, section 3.4, Fig. 3.10.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from hypose.errors import InputError

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
    """Settings of a training session. Raises InputError where one is outside its range.

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

    def __post_init__(self) -> None:
        times = (self.do_gesture_s, self.positive_s, self.release_s, self.negative_s)
        if min(times) < 0 or max(times) > 600 or not 1 <= self.rounds <= 1000:
            raise InputError("A session's phases last 0 to 600 s each, and it has 1 to 1000 rounds.")
        if not (0 < self.sigma <= 1 and 0 <= self.rho <= 1):
            raise InputError(f"sigma is {self.sigma} and rho {self.rho}; both must be between 0 and 1.")

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
    """What to do in one frame.

    phase: of the session.
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
    settings: of the session.
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
    """Add the forest's maximum in a frame (cm^2) to the moving average of the current phase (th+ or th-)."""
    if session.paused is not None or session.phase not in ("positive", "negative"):
        return session
    name = "high" if session.phase == "positive" else "low"
    old = getattr(session, name)
    new = maximum if old is None else settings.sigma * maximum + (1 - settings.sigma) * old
    return replace(session, high=new) if name == "high" else replace(session, low=new)


def _follow(s: Session, settings: SessionSettings, time: float) -> Session:
    """Enter the phase after this one; after the negatives another round, or the test after the last round."""
    if s.phase != "negative":
        return _enter(s, _AFTER[s.phase], time)
    if s.round + 1 >= settings.rounds:
        return _enter(s, "test", time)
    return replace(_enter(s, "do_gesture", time), round=s.round + 1)


def _enter(s: Session, phase: Phase, time: float) -> Session:
    if phase in ("positive", "negative"):
        return replace(s, phase=phase, entered=time, segment=s.segment + 1, before=(s.high, s.low))
    return replace(s, phase=phase, entered=time)
