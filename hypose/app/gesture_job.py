"""What `hypose gesture` does: sessions, learning from recordings, watching for events, judging a model."""

from __future__ import annotations

import queue
import sys
import threading
import time as clock
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hypose.app.gesture_sources import Source
from hypose.errors import InputError
from hypose.evaluation.gesture_metrics import average_precision
from hypose.gestures.events import Event, EventSettings, EventState, step
from hypose.gestures.forest import Forest, ForestSettings, GrowingForest
from hypose.gestures.localise import Found, LocaliseSettings, Scratch, localise
from hypose.gestures.model import GestureModel
from hypose.gestures.offline import OfflineSettings, collect, train
from hypose.gestures.online import Learner
from hypose.gestures.session import Command, SessionSettings
from hypose.gestures.trainer import Feedback, Trainer
from hypose.pipeline.gesture_files import GestureRecording, SessionWriter, load_model

Say = Callable[[str], None]
KEYS: dict[str, Command] = {
    "n": "next",
    "u": "undo",
    "p": "pause",
    "c": "continue",
    "a": "again",
    "t": "test",
}


def typed_commands() -> Callable[[], list[Command]]:
    """Commands typed as letters (n, u, p, c, a, t and Enter) since the last call; none when there is no terminal."""
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    if sys.stdin is not None and sys.stdin.isatty():

        def listen() -> None:
            for line in sys.stdin:
                lines.put(line)

        threading.Thread(target=listen, daemon=True).start()

    def since() -> list[Command]:
        out = []
        while not lines.empty():
            out += [KEYS[c] for c in lines.get().strip().lower() if c in KEYS]
        return out

    return since


def new_learner(seed: int) -> Learner:
    """A learner with the usual settings."""
    return Learner.new(np.random.default_rng(seed), ForestSettings())


def growing_model(path: Path, gesture: str) -> GestureModel:
    """The model of a gesture, to go on teaching it; InputError when it is finished or another gesture's."""
    model = load_model(path)
    if model.learner is None:
        raise InputError(f"{path} is a finished forest (trained offline); only a growing one can be resumed.")
    if model.names != (gesture,):
        raise InputError(f"{path} is of {', '.join(model.names)}, not of {gesture}; give the model of that gesture.")
    return model


def run_session(
    source: Source,
    gesture: str,
    learner: Learner,
    settings: SessionSettings,
    *,
    record: Path | None,
    commands: Callable[[], list[Command]] = list,
    say: Say,
    model: GestureModel | None = None,
) -> GestureModel:
    """An interactive session until its test begins or the source ends; the model it leaves. Everything is recorded."""
    trainer = Trainer(learner, settings)
    writer = None
    if record is not None:
        writer = SessionWriter(record, [gesture], source.lens, source.size, {"rounds": settings.rounds})
    middle = (source.size[0] / 2, 0.45 * source.size[1])
    shown, phase, taught, seconds = "", "do_gesture", 0, 0.0
    try:
        while trainer.session.phase != "test":
            taken = source.take(phase)
            if taken is None:
                break
            given = commands()
            before = trainer.session
            box = taken.box or middle
            began = clock.perf_counter()
            f = trainer.frame(taken.time, taken.depth, source.lens, box, given)
            seconds += clock.perf_counter() - began
            taught += f.taught is not None
            phase = f.instruction.phase
            if writer is not None:
                learned = f.instruction.learn is not None
                writer.add(
                    taken.time,
                    taken.depth,
                    phase if learned or phase not in ("positive", "negative") else "free",
                    f.instruction.segment,
                    1 if f.instruction.learn == "gesture" else 0,
                    box,
                )
                for c in given:
                    undone = trainer.session.undone[len(before.undone) :] if c == "undo" else ()
                    writer.act(taken.time, c, str(undone[0]) if undone else "")
            text = f"round {trainer.session.round + 1}/{settings.rounds}: {f.instruction.prompt}"
            if text != shown:
                say(text + _detail(f))
                shown = text
    finally:
        if writer is not None:
            writer.close()
        source.close()
    if not taught:
        raise InputError(f"Nothing was learned from {source.name}; keep the gesture in the box while it is asked for.")
    entry = {"session": source.name, "frames_learned": taught, "computing_s": round(seconds, 3)}
    history = (*(model.history if model is not None else ()), entry)
    threshold = trainer.final_threshold()
    return GestureModel((gesture,), trainer.learner.forest, (threshold,), LocaliseSettings(), trainer.learner, history)


def _detail(f: Feedback) -> str:
    if f.instruction.phase == "test" or f.threshold is None:
        return ""
    return f" (threshold {f.threshold:.2f} cm²)"


def learn_recordings(
    recordings: Sequence[GestureRecording], gesture: str, learner: Learner, passes: int, say: Say
) -> GestureModel:
    """A forest taught with recorded sessions in the order of time, as the live session would have."""
    trainer, seen = Trainer(learner), 0
    for k in range(passes):
        for r in recordings:
            number = r.number(gesture)
            for f in r.learned():
                kind = "gesture" if f.phase == "positive" and f.gesture == number else "negative"
                seen += trainer.learn(kind, f.depth(), r.lens, (f.x, f.y)) is not None
        say(f"pass {k + 1} of {passes}: {seen} frames learned")
    if not seen:
        raise InputError("The recordings hold no frames to learn from; record a session with `hypose gesture record`.")
    history = tuple({"recording": r.folder.name, "passes": passes} for r in recordings)
    threshold = trainer.final_threshold()
    return GestureModel((gesture,), learner.forest, (threshold,), LocaliseSettings(), learner, history)


def learn_offline(recordings: Sequence[GestureRecording], gesture: str, seed: int) -> GestureModel:
    """Boosted trees from all frames at once.

    The threshold is half way between the lower quartile of the maxima where the gesture is shown and the strongest
    elsewhere, on the frames it was trained with, hence on the high side for others."""
    rng = np.random.default_rng(seed)
    every = [e for r in recordings for e in r.examples(gesture)]
    if not any(e.gesture for e in every):
        raise InputError(f"The recordings hold no frame of {gesture!r} to learn from; record a session of it.")
    forest = train(collect(every, rng, positives=20, negatives=20), rng, OfflineSettings())
    scores: tuple[list[float], list[float]] = ([], [])
    for e in every:
        scores[e.gesture].append(localise(e.depth, e.lens, [forest])[0].score)
    low, high = max(scores[0], default=0.0), float(np.quantile(scores[1], 0.25))
    history = tuple({"recording": r.folder.name, "learning": "offline boosted"} for r in recordings)
    return GestureModel((gesture,), forest, (0.5 * (low + high),), LocaliseSettings(), None, history)


@dataclass(frozen=True)
class Watched:
    """A frame that was looked at: time (s), what was found, and the events in it."""

    time: float
    found: list[Found]
    events: list[Event]


def watch(
    source: Source, models: Sequence[GestureModel], settings: LocaliseSettings, limits: Sequence[EventSettings]
) -> Iterator[Watched]:
    """Look for the gestures of all models in every frame of a source."""
    forests = finished(models)
    scratch, state = Scratch(), EventState()
    try:
        while (taken := source.take("free")) is not None:
            found = localise(taken.depth, source.lens, forests, settings, scratch)
            state, events = step(state, found, taken.time, limits)
            yield Watched(taken.time, found, events)
    finally:
        source.close()


def finished(models: Sequence[GestureModel]) -> list[Forest]:
    """The models' forests; InputError when they cannot look together."""
    if len(models) > 1 and any(len(m.names) > 1 for m in models):
        raise InputError("A model of several gestures is used alone; give one model per gesture, or that one.")
    names = [n for m in models for n in m.names]
    if len(set(names)) < len(names):
        raise InputError(f"Two models are for the same gesture ({', '.join(names)}); give one of each.")
    return [m.forest.freeze() if isinstance(m.forest, GrowingForest) else m.forest for m in models]


def thresholds(models: Sequence[GestureModel], given: float | None) -> list[float]:
    """Of every gesture; InputError names the gesture that has none."""
    out = []
    for m in models:
        for name, t in zip(m.names, m.thresholds, strict=True):
            value = given if given is not None else t
            if value is None or value <= 0:
                raise InputError(
                    f"The model of {name!r} has no threshold yet: its session ended before gesture and movement were "
                    "seen; train on, or give --threshold."
                )
            out.append(float(value))
    return out


def evaluate(model: GestureModel, recording: GestureRecording) -> dict[str, float]:
    """AP at 10 px and 5 cm, hits at the threshold, false alarms, over the labelled frames of a recording."""
    name = model.names[0]
    if len(model.names) > 1:
        raise InputError("A model of several gestures cannot be judged here; give a model of one gesture.")
    number, forest = recording.number(name), finished([model])[0]
    scratch = Scratch()
    scores, px, metres = [], [], []
    for f in recording.learned():
        depth = f.depth()
        found = localise(depth, recording.lens, [forest], model.settings, scratch)[0]
        shown = f.phase == "positive" and f.gesture == number
        error = float(np.hypot(found.x - f.x, found.y - f.y)) if shown else np.inf
        z = found.position[2] if found.position is not None else np.inf
        scores.append(found.score)
        px.append(error)
        metres.append(error * z / recording.lens.fx if shown else np.inf)
    if not scores:
        raise InputError(f"{recording.folder} has no labelled frames; record a session with prompts.")
    s, e, m = np.array(scores), np.array(px), np.array(metres)
    shown = np.isfinite(e)
    out = {
        "frames": float(len(s)),
        "positives": float(shown.sum()),
        "ap_10px": average_precision(s, e <= 10, int(shown.sum())),
        "ap_5cm": average_precision(s, m <= 0.05, int(shown.sum())),
    }
    t = model.thresholds[0]
    if t is not None:
        out["threshold_cm2"] = t
        out["found_share"] = float(((s >= t) & (m <= 0.05))[shown].mean()) if shown.any() else 0.0
        out["false_share"] = float((s >= t)[~shown].mean()) if (~shown).any() else 0.0
    return out
