"""`hypose gesture`: run sessions, learn from recordings, watch for events, evaluate a model."""

from __future__ import annotations

import contextlib
import json
import queue
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pythonosc.osc_message import OscMessage

from hypose.app.commands.console import Stages, print_note, say, stopping
from hypose.app.live.gesture_sources import GestureSource, open_source
from hypose.app.live.osc import OscTarget, osc_message
from hypose.app.live.servers import SocketListeners
from hypose.compute.forest_votes import ScanPlan
from hypose.errors import EvidenceError, InputError
from hypose.gestures.depth_pictures import surface_depth
from hypose.gestures.events import Event, EventSettings, EventState, average_precision, detect_events
from hypose.gestures.forest import Forest
from hypose.gestures.localise import Localisation, LocaliseSettings, Scratch, localise
from hypose.gestures.model import GestureModel, check_gesture_name
from hypose.gestures.online import Learner
from hypose.gestures.trainer import Command, Feedback, SessionSettings, Trainer
from hypose.io.files import check_writable
from hypose.options import MOST_FRAMES, Option, Seed
from hypose.pipeline.gesture_files import (
    GestureRecording,
    SessionWriter,
    content_of,
    load_model,
    read_recording,
    save_model,
)

_Say = Callable[[str], None]
KEYS: dict[str, Command] = {
    "n": "next",
    "u": "undo",
    "p": "pause",
    "c": "continue",
    "a": "again",
    "t": "test",
}


def typed_commands() -> Callable[[], list[Command]]:
    """Return a function that gives the commands typed as letters (n, u, p, c, a, t and Enter) since its last call; none
    without a terminal.
    """
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
    """Make a learner with the usual settings."""
    return Learner.new(np.random.default_rng(seed))


def growing_model(path: Path, gesture: str) -> GestureModel:
    """Load the model of a gesture to train it further.

    Raises: InputError where it is of another gesture.
    """
    model = load_model(path)
    if model.name != gesture:
        raise InputError(f"{path} is of {model.name}, not of {gesture}; give the model of that gesture.")
    return model


def replaced_model(path: Path, gesture: str, say: _Say) -> None:
    """Tell the user, before anything is learned, that an existing model file will be replaced; nothing where it does
    not exist.

    Raises: InputError where the file is of another gesture, or no model.
    """
    try:
        old = load_model(path)
    except InputError:
        raise InputError(f"{path} is there already, and no model that can be read; give another file.") from None
    if old.name != gesture:
        raise InputError(f"{path} is the model of {old.name}, not of {gesture}; give another file.")
    how = f"to go on with it, stop and add --resume {path}"
    say(f"note: {path} holds a model of {gesture} already, which will be replaced; {how}.")


def run_session(
    source: GestureSource,
    gesture: str,
    learner: Learner,
    settings: SessionSettings,
    *,
    record: Path | None,
    commands: Callable[[], list[Command]] = list,
    say: _Say,
    model: GestureModel | None = None,
) -> GestureModel:
    """Run an interactive session until its test begins or the source ends, and train a forest on it.

    source: depth pictures; closed at the end.
    gesture: name of the gesture.
    learner: forest that is trained.
    settings: lengths and number of the phases.
    record: new folder for the recording; None: nothing is recorded.
    commands: gives the commands since the last call.
    say: prints a sentence.
    model: older model whose history is continued.
    Returns: the trained model; its threshold is None where gesture and other movement were not both seen.
    Raises: InputError where nothing was learned.
    """
    trainer = Trainer(learner, settings)
    asked = learned = taught = 0
    for f in follow_session(source, gesture, trainer, record=record, commands=commands, say=say):
        wanted, used = f.instruction.learn == "gesture", f.taught is not None
        asked, learned, taught = asked + wanted, learned + (wanted and used), taught + used
    where = _range(learner.settings.look.plan)
    if not learned and (asked or not learner.strength):  # a forest of the gesture may learn other movement only
        raise InputError(
            f"Nothing was learned from {source.name}: {asked} frames asked for the gesture, and none had depth {where} "
            "in the box; come nearer, and keep the gesture in the box."
        )
    if 2 * learned < asked:
        say(f"Only {learned} of {asked} frames of the gesture had depth {where} in the box.")
    entry = {"session": source.name, "frames_learned": taught}
    if record is not None:
        entry["content"] = content_of(record)
    return _model(gesture, trainer, model, [entry])


def _model(gesture: str, trainer: Trainer, old: GestureModel | None, entries: Sequence[dict[str, Any]]) -> GestureModel:
    """Make the model of a trained forest.

    gesture: its name.
    trainer: holds the forest and gives the threshold.
    old: model that was trained further; None: a new one.
    entries: what was learned this time, for the history of the model.
    """
    history = (*(() if old is None else old.history), *entries)
    return GestureModel(gesture, trainer.learner, trainer.final_threshold(), history)


def _range(plan: ScanPlan) -> str:
    return f"between {plan.near_mm / 1000:g} and {plan.far_mm / 1000:g} m"


def follow_session(
    source: GestureSource,
    gesture: str,
    trainer: Trainer,
    *,
    record: Path | None,
    commands: Callable[[], list[Command]],
    say: _Say,
) -> Iterator[Feedback]:
    """Lead through a session, and yield the feedback on each frame until its test begins or the source ends.

    source: depth pictures; closed at the end.
    gesture: name of the gesture.
    trainer: runs the phases, and trains its forest.
    record: new folder for the recording; None: nothing is recorded.
    commands: gives the commands since the last call.
    say: prints a sentence.
    """
    writer, rounds = None, trainer.settings.rounds
    if record is not None:
        writer = SessionWriter(record, [gesture], source.lens, source.size, {"rounds": rounds})
    box, shown, phase = (source.size[0] / 2, 0.45 * source.size[1]), "", "do_gesture"
    try:
        while trainer.session.phase != "test" and (taken := source.take(phase)) is not None:
            given, before, box = commands(), trainer.session, taken.box or box
            f = trainer.frame(taken.time, taken.depth, source.lens, box, given)
            now, session = f.instruction, trainer.session
            phase = now.phase
            if writer is not None:
                paused = now.learn is None and phase in ("positive", "negative")
                kept, is_gesture = "free" if paused else phase, int(now.learn == "gesture")
                writer.add(taken.time, taken.depth, kept, now.segment, is_gesture, box)
                for c in given:
                    undone = session.undone[len(before.undone) :] if c == "undo" else ()
                    writer.act(taken.time, c, str(undone[0]) if undone else "")
            text = f"round {session.round + 1}/{rounds}: {now.prompt}"
            if text != shown:
                known = phase != "test" and f.threshold is not None
                say(text + (f" (threshold {in_cm2(f.threshold)})" if known else ""))
                shown = text
            yield f
    finally:
        if writer is not None:
            writer.close()
        source.close()


def in_cm2(threshold: float | None) -> str:
    """Format a threshold with three significant digits, since small gestures score less than 0.1 cm²."""
    return "not known yet" if threshold is None else f"{threshold:.3g} cm²"


def learn_recordings(
    recordings: Sequence[GestureRecording],
    gesture: str,
    learner: Learner,
    passes: int,
    say: _Say,
    old: GestureModel | None = None,
) -> GestureModel:
    """Train a forest with recorded sessions in the order of time, as the live session would.

    gesture: name of the gesture, which the recordings must have.
    learner: forest that is trained.
    passes: number of times all recordings are learned.
    say: prints a sentence.
    old: model that is trained further.
    Returns: the trained model.
    Raises: InputError where the recordings have no usable frame of the gesture.
    """
    trainer, seen, asked, shown = Trainer(learner), 0, 0, 0
    for k in range(passes):
        for r in recordings:
            number = r.number(gesture)
            for f in r.learned():
                shows = f.phase == "positive" and f.gesture == number
                taught = trainer.learn("gesture" if shows else "negative", r.picture(f), r.lens, (f.x, f.y)) is not None
                seen, asked, shown = seen + taught, asked + shows, shown + (taught and shows)
        say(f"pass {k + 1} of {passes}: {seen} frames learned")
    if not shown and (asked or not learner.strength):
        raise InputError(_NOTHING.format(gesture=gesture, where=_range(learner.settings.look.plan)))
    entries = [{"recording": r.folder.name, "passes": passes, "content": r.content} for r in recordings]
    return _model(gesture, trainer, old, entries)


_NOTHING = (
    "The recordings hold no frame of {gesture!r} with depth {where} at the marked place; record a session of it with "
    "`hypose gesture train --record`."
)


@dataclass(frozen=True)
class Watched:
    """Result of the search for gestures in one frame.

    time: s.
    found: best place of each gesture.
    events: gestures that start or end in this frame.
    """

    time: float
    found: list[Localisation]
    events: list[Event]


_EMPTY = 30
"""Frames in a row without usable depth that are reported."""


def watch(
    source: GestureSource,
    models: Sequence[GestureModel],
    settings: LocaliseSettings,
    limits: Sequence[EventSettings],
    say: _Say = lambda text: None,
) -> Iterator[Watched]:
    """Localise the gestures of all models in every frame of a source, and yield the result of each frame.

    source: depth pictures; closed at the end.
    settings: settings of the localisation.
    limits: settings of the events, per gesture.
    say: prints a sentence when no depth is near enough.
    Raises: EvidenceError at the end of a source without usable depth.
    """
    forests, plan, empty, near = loaded_forests(models), settings.plan, 0, False
    scratch, state = Scratch(), EventState()
    try:
        while (taken := source.take("free")) is not None:
            some = taken.depth[::8, ::8]
            empty = 0 if ((some >= plan.near_mm) & (some <= plan.far_mm)).any() else empty + 1
            near = near or not empty
            if empty == _EMPTY:
                say(f"{source.name}: {_EMPTY} frames have no depth {_range(plan)}, where gestures are looked for.")
            found = localise(taken.depth, source.lens, forests, settings, scratch)
            state, events = detect_events(state, found, taken.time, limits)
            yield Watched(taken.time, found, events)
        if not near:
            raise EvidenceError(
                f"{source.name}: no frame has depth {_range(plan)}, where gestures are looked for; come nearer, or see "
                "whether its depth is in millimetres."
            )
    finally:
        source.close()


def loaded_forests(models: Sequence[GestureModel]) -> list[Forest]:
    """Return the forests of the models.

    Raises: InputError where two models are of the same gesture.
    """
    names = [m.name for m in models]
    if len(set(names)) < len(names):
        raise InputError(f"Two models are for the same gesture ({', '.join(names)}); give one of each.")
    return [m.learner.forest.freeze() for m in models]


def thresholds(models: Sequence[GestureModel], given: float | None) -> list[float]:
    """Return the threshold of every gesture, cm^2.

    given: threshold that replaces those of all models; None: each model's own threshold is used.
    Raises: InputError names the gesture that has none.
    """
    out = [m.threshold if given is None else given for m in models]
    for m, value in zip(models, out, strict=True):
        if value is None or value <= 0:
            raise InputError(
                f"The model of {m.name!r} has no threshold yet: its session ended before gesture and movement were "
                "seen; train on, or give --threshold."
            )
    return [float(value) for value in out if value is not None]


def evaluate_model(model: GestureModel, recording: GestureRecording) -> dict[str, float]:
    """Evaluate a model of one gesture on the labelled frames of a recording.

    Returns: numbers of frames and of frames with the gesture (positives); average precision with the place within 10 px
        (ap_10px) and 5 cm (ap_5cm); where the model has a threshold: threshold_cm2, and the shares of the gesture's
        frames that are found within 5 cm (found_share) and of other frames above the threshold (false_share).
    Raises: InputError where the recording has no usable frames.
    """
    number, forest = recording.number(model.name), model.learner.forest.freeze()
    scratch, plan, rows, measured = Scratch(), ScanPlan(), [], 0
    for f in recording.learned():
        depth, shows = recording.picture(f), f.phase == "positive" and f.gesture == number
        found = localise(depth, recording.lens, [forest], None, scratch)[0]
        off = float(np.hypot(found.x - f.x, found.y - f.y)) if shows else np.inf
        surface = surface_depth(depth, f.x, f.y) if shows else None
        measured += surface is not None and plan.near_mm <= surface <= plan.far_mm
        z = found.position[2] if found.position is not None else np.inf
        rows.append((found.score, off, off * z / recording.lens.fx if shows else np.inf))
    if not rows:
        raise InputError(f"{recording.folder} has no labelled frames; record a session with prompts.")
    s, e, m = np.array(rows).T
    shown = np.isfinite(e)
    if shown.any() and not measured:
        raise InputError(_NOTHING.format(gesture=model.name, where=_range(plan)))
    out = {
        "frames": float(len(s)),
        "positives": float(shown.sum()),
        "ap_10px": average_precision(s, e <= 10, int(shown.sum())),
        "ap_5cm": average_precision(s, m <= 0.05, int(shown.sum())),
    }
    t = model.threshold
    if t is not None:
        out["threshold_cm2"] = t
        out["found_share"] = float(((s >= t) & (m <= 0.05))[shown].mean()) if shown.any() else 0.0
        out["false_share"] = float((s >= t)[~shown].mean()) if (~shown).any() else 0.0
    return out


# ---- outputs -------------------------------------------------------------------------------------------------------


WAITING = 256
"""Most texts that wait for a slow listener."""


def event_line(event: Event, names: Sequence[str]) -> str:
    """Encode an event as one line of JSON.

    names: names of the gestures, by their number minus 1.
    """
    value = {
        "event": event.kind,
        "gesture": names[event.gesture - 1],
        "time": round(event.time, 4),
        "x": round(event.x, 1),
        "y": round(event.y, 1),
        "position": None if event.position is None else [round(float(v), 4) for v in event.position],
        "score": round(event.score, 3),
    }
    return json.dumps(value)


def gesture_osc(watched: Watched, names: Sequence[str], limits: Sequence[float]) -> list[OscMessage]:
    """Build the OSC messages of one frame: /gesture/NAME score x y z, /gesture/NAME/start and /end with the score, and
    Wekinator's /wek/outputs (each gesture's score over its threshold, at most 1).

    watched: result of the frame; scores in cm^2, places in m (0 where they are not known).
    names: names of the gestures, by their number minus 1.
    limits: thresholds of the gestures, cm^2.
    """
    messages = []
    for f in watched.found:
        p = (0.0, 0.0, 0.0) if f.position is None else tuple(float(v) for v in f.position)
        messages.append(osc_message(f"/gesture/{names[f.gesture - 1]}", float(f.score), *p))
    for e in watched.events:
        messages.append(osc_message(f"/gesture/{names[e.gesture - 1]}/{e.kind}", float(e.score)))
    shares = [min(1.0, f.score / limit) for f, limit in zip(watched.found, limits, strict=True)]
    return [*messages, osc_message("/wek/outputs", *shares)]


def gesture_lines(watched: Watched, names: Sequence[str]) -> list[str]:
    """Encode one frame as lines of JSON: {"time", "scores": {name: cm^2}}, and every event as on stdout.

    watched: result of the frame.
    names: names of the gestures, by their number minus 1.
    """
    scores = {names[f.gesture - 1]: round(f.score, 3) for f in watched.found}
    frame = json.dumps({"time": round(watched.time, 4), "scores": scores})
    return [frame, *(event_line(e, names) for e in watched.events)]


# ---- commands ------------------------------------------------------------------------------------------------------


SourceOption = Annotated[
    str,
    Option("realsense, FILE.bag, .db3 or .mkv (Azure), the folder of a session, or simulated[:PERSON]."),
]
_LETTERS = "Commands (letter and Enter): n next, u undo, p pause, c continue, a again, t end with the test"


def gesture_train(
    out: Annotated[Path, Option("Model file to write (.npz).", argument=True)],
    gesture: Annotated[str, Option("Name of the gesture.")],
    recording: Annotated[tuple[Path, ...], Option("Recorded session to learn from (may be repeated); else live.")] = (),
    source: SourceOption = "simulated",
    rounds: Annotated[int, Option("Rounds of gesture and other movement.", 1, 1000)] = 3,
    passes: Annotated[int, Option("Over the recordings.", 1, 100)] = 1,
    resume: Annotated[Path | None, Option("Model whose trees go on growing.")] = None,
    record_to: Annotated[Path | None, Option("New folder to record a live session to.", flag="--record")] = None,
    seed: Seed = 0,
) -> None:
    """Teach a gesture: a live session that learns while you watch, or recorded sessions again."""
    if out.suffix != ".npz":
        raise InputError(f"{out} is no name for a model; give one that ends in .npz.")
    if recording and record_to is not None:
        raise InputError("--record is for live sessions, and --recording learns from one that is there; give one.")
    check_writable(out.parent)
    check_gesture_name(gesture)
    old = growing_model(resume, gesture) if resume is not None else None
    if out.exists() and not (resume is not None and resume.exists() and out.samefile(resume)):
        replaced_model(out, gesture, print_note)
    learner = new_learner(seed) if old is None else old.learner
    if recording:
        model = learn_recordings([read_recording(r) for r in recording], gesture, learner, passes, print_note, old)
    else:
        settings, opened = SessionSettings(rounds=rounds), open_source(source, gesture, seed)
        print_note(_LETTERS)
        about = {"record": record_to, "commands": typed_commands(), "say": print_note, "model": old}
        model = run_session(opened, gesture, learner, settings, **about)
    if old is not None and model.threshold is None:  # only the gesture, or only movement, was seen this time
        model = replace(model, threshold=old.threshold)
    save_model(model, out)
    say(f"{gesture}: {int(model.learner.forest.size.sum())} nodes, threshold {in_cm2(model.threshold)}")
    say(f"Model: {out}")


def gesture_run(
    models: Annotated[tuple[Path, ...], Option("Model files, one per gesture.", argument=True)],
    source: SourceOption = "simulated",
    osc: Annotated[str | None, Option("HOST:PORT to send scores and events to by OSC.")] = None,
    ws: Annotated[int | None, Option("Port of this computer to serve them by WebSocket.", 0, 65535)] = None,
    threshold: Annotated[
        float | None, Option("cm² instead of the models' own.", 0, 1_000_000, above=True, unit="cm²")
    ] = None,
    adaptation_rate: Annotated[
        float, Option("Share of the new frame in the density (1: no temporal recursion).", 0, 1, above=True)
    ] = 0.8,
    hold: Annotated[float, Option("Seconds a gesture must be held.", 0, 3600)] = 0.15,
    rest: Annotated[float, Option("Seconds after its end in which it does not start again.", 0, 3600)] = 0.5,
    frames: Annotated[int, Option("Stop after so many frames; 0 = never.", 0, MOST_FRAMES)] = 0,
    seed: Seed = 0,
) -> None:
    """Watch for gestures without a screen: events as JSON lines on stdout, and to the outputs that the options name."""
    loaded = [load_model(m) for m in models]
    least = thresholds(loaded, threshold)
    limits = [EventSettings(t, hold_s=hold, refractory_s=rest) for t in least]
    names, settings = [m.name for m in loaded], LocaliseSettings(adaptation_rate=adaptation_rate)
    with stopping(), contextlib.ExitStack() as opened:
        target = None if osc is None else opened.enter_context(contextlib.closing(OscTarget(osc)))
        listeners = None
        if ws is not None:
            listeners = opened.enter_context(contextlib.closing(SocketListeners(ws, WAITING)))
        pictures = open_source(source, names[0], seed)
        for k, watched in enumerate(watch(pictures, loaded, settings, limits, print_note), 1):
            for event in watched.events:
                print(event_line(event, names), flush=True)
            if target is not None:
                target.send(gesture_osc(watched, names, least))
            if listeners is not None:
                for line in gesture_lines(watched, names):
                    listeners.post(line)
            if frames and k >= frames:
                break


def gesture_evaluate(
    model: Annotated[Path, Option("Model file.", argument=True)],
    recording: Annotated[Path, Option("Recorded session that was not learned.", argument=True)],
) -> None:
    """Evaluate a model on a recorded session: average precision, and hits and false alarms at its threshold."""
    loaded, session = load_model(model), read_recording(recording)
    if loaded.learned(session.content):
        print_note(
            f"note: {model} has learned from {recording}: the figures say how well it remembers that, and not how well "
            "it finds the gesture elsewhere; give a session that was not learned."
        )
    with Stages() as progress:
        progress("check", 0, 1)
        values = evaluate_model(loaded, session)
        progress("check", 1, 1)
    print(json.dumps({k: round(v, 4) for k, v in values.items()}, indent=2))
