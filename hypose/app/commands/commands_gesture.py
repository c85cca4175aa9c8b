"""`hypose gesture`: record, train, run and evaluate detectors of still gestures in depth pictures."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from hypose.app.commands.console import Stages, print_note, say, stopping
from hypose.errors import InputError
from hypose.options import MOST_FRAMES, Option, Seed

GESTURE_COMMANDS = {
    "Commands": {
        "record": ("commands_gesture:record", "Record a session with its prompts, to train from later."),
        "train": ("commands_gesture:gesture_train", "Teach a gesture, live or from recorded sessions."),
        "run": ("commands_gesture:gesture_run", "Watch for gestures: events as JSON lines, OSC, commands."),
        "eval": ("commands_gesture:gesture_evaluate", "Judge a model on a recorded session."),
    }
}

SourceOption = Annotated[
    str,
    Option("realsense, FILE.bag, .db3 or .mkv (Azure), the folder of a session, or simulated[:PERSON]."),
]
Gesture = Annotated[str, Option("Name of the gesture.")]
Rounds = Annotated[int, Option("Rounds of gesture and other movement.", 1, 1000)]
_LETTERS = "Commands (letter and Enter): n next, u undo, p pause, c continue, a again, t end with the test"
_Frames = Annotated[int, Option("Stop after so many frames; 0 = never.", 0, MOST_FRAMES)]


def record(
    out: Annotated[Path, Option("New folder to record to.", argument=True)],
    gesture: Gesture,
    source: SourceOption = "simulated",
    rounds: Rounds = 3,
    seed: Seed = 0,
) -> None:
    """Record a session with its prompts without learning; train from it later."""
    from hypose.app.jobs.gesture_job import follow_session, new_learner, typed_commands
    from hypose.app.live.gesture_sources import open_source
    from hypose.gestures.model import check_gesture_name
    from hypose.gestures.trainer import SessionSettings, Trainer

    check_gesture_name(gesture)
    trainer, opened = Trainer(new_learner(0), SessionSettings(rounds=rounds)), open_source(source, gesture, seed)
    print_note(_LETTERS)
    about = {"record": out, "commands": typed_commands(), "say": print_note, "learn": False}
    for _ in follow_session(opened, gesture, trainer, **about):
        pass
    say(f"Recorded: {out}")


def gesture_train(
    out: Annotated[Path, Option("Model file to write (.npz).", argument=True)],
    gesture: Gesture,
    recording: Annotated[tuple[Path, ...], Option("Recorded session to learn from (may be repeated); else live.")] = (),
    source: SourceOption = "simulated",
    rounds: Rounds = 3,
    passes: Annotated[int, Option("Over the recordings.", 1, 100)] = 1,
    resume: Annotated[Path | None, Option("Model whose trees go on growing.")] = None,
    record_to: Annotated[Path | None, Option("New folder to record a live session to.", flag="--record")] = None,
    seed: Seed = 0,
) -> None:
    """Teach a gesture: a live session that learns while you watch, or recorded sessions again."""
    from hypose.app.jobs.gesture_job import (
        growing_model,
        in_cm2,
        learn_recordings,
        new_learner,
        replaced_model,
        run_session,
        typed_commands,
    )
    from hypose.app.live.gesture_sources import open_source
    from hypose.gestures.model import check_gesture_name
    from hypose.gestures.trainer import SessionSettings
    from hypose.io.files import check_writable
    from hypose.pipeline.gesture_files import read_recording, save_model

    if out.suffix != ".npz":
        raise InputError(f"{out} is no name for a model; give one that ends in .npz.")
    if recording and record_to is not None:
        raise InputError("--record is for live sessions, and --recording learns from one that is there; give one.")
    check_writable(out.parent)
    check_gesture_name(gesture)
    old = growing_model(resume, gesture) if resume is not None else None
    if out.exists() and not (resume is not None and resume.exists() and out.samefile(resume)):
        replaced_model(out, gesture, print_note)
    learner = old.learner if old is not None and old.learner is not None else new_learner(seed)
    if recording:
        loaded = [read_recording(r) for r in recording]
        model = learn_recordings(loaded, gesture, learner, passes, print_note, old)
    else:
        settings, opened = SessionSettings(rounds=rounds), open_source(source, gesture, seed)
        print_note(_LETTERS)
        about = {"record": record_to, "commands": typed_commands(), "say": print_note, "model": old}
        model = run_session(opened, gesture, learner, settings, **about)
    if old is not None and model.thresholds == (None,):  # only the gesture, or only movement, was seen this time
        model = replace(model, thresholds=old.thresholds)
    save_model(model, out)
    nodes = int(model.forest.size.sum())
    say(f"{gesture}: {nodes} nodes, threshold {in_cm2(model.thresholds[0])}")
    say(f"Model: {out}")


def gesture_run(
    models: Annotated[tuple[Path, ...], Option("Model files, one per gesture.", argument=True)],
    source: SourceOption = "simulated",
    osc: Annotated[str | None, Option("HOST:PORT to send scores and events to by OSC.")] = None,
    ws: Annotated[int | None, Option("Port of this computer to serve them by WebSocket.", 0, 65535)] = None,
    command: Annotated[
        str | None, Option("Program to run at each start, {gesture} replaced; with {event}, at ends too.")
    ] = None,
    threshold: Annotated[
        float | None, Option("cm² instead of the models' own.", 0, 1_000_000, above=True, unit="cm²")
    ] = None,
    adaptation_rate: Annotated[
        float, Option("Share of the new frame in the density (1: no temporal recursion).", 0, 1, above=True)
    ] = 0.8,
    hold: Annotated[float, Option("Seconds a gesture must be held.", 0, 3600)] = 0.15,
    rest: Annotated[float, Option("Seconds after its end in which it does not start again.", 0, 3600)] = 0.5,
    frames: _Frames = 0,
    seed: Seed = 0,
) -> None:
    """Watch for gestures without a screen: events as JSON lines on stdout, and to the outputs that the options name."""
    from hypose.app.jobs import gesture_job
    from hypose.app.live.gesture_sources import open_source
    from hypose.app.live.osc import OscTarget
    from hypose.app.live.servers import SocketListeners
    from hypose.gestures.events import EventSettings
    from hypose.pipeline.gesture_files import load_model

    loaded = [load_model(m) for m in models]
    least = gesture_job.thresholds(loaded, threshold)
    limits = [EventSettings(t, hold_s=hold, refractory_s=rest) for t in least]
    names, settings = [n for m in loaded for n in m.names], gesture_job.looking(loaded, adaptation_rate)
    with stopping(), contextlib.ExitStack() as opened:
        target = None if osc is None else opened.enter_context(contextlib.closing(OscTarget(osc)))
        listeners = None
        if ws is not None:
            listeners = opened.enter_context(contextlib.closing(SocketListeners(ws, gesture_job.WAITING)))
        begun = None if command is None else gesture_job.EventCommand(command, names)
        pictures = open_source(source, names[0], seed)
        for k, watched in enumerate(gesture_job.watch(pictures, loaded, settings, limits, print_note), 1):
            for event in watched.events:
                print(gesture_job.event_line(event, names), flush=True)
            if target is not None:
                target.send(gesture_job.gesture_osc(watched, names, least))
            if listeners is not None:
                for line in gesture_job.gesture_lines(watched, names):
                    listeners.post(line)
            if begun is not None:
                begun.run(watched)
            if frames and k >= frames:
                break


def gesture_evaluate(
    model: Annotated[Path, Option("Model file.", argument=True)],
    recording: Annotated[Path, Option("Recorded session that was not learned.", argument=True)],
) -> None:
    """Evaluate a model on a recorded session: average precision, and hits and false alarms at its threshold."""
    import json

    from hypose.app.jobs import gesture_job
    from hypose.pipeline.gesture_files import load_model, read_recording

    loaded, session = load_model(model), read_recording(recording)
    if loaded.learned(session.content):
        print_note(
            f"note: {model} has learned from {recording}: the figures say how well it remembers that, and not how well "
            "it finds the gesture elsewhere; give a session that was not learned."
        )
    with Stages() as progress:
        progress("check", 0, 1)
        values = gesture_job.evaluate_model(loaded, session)
        progress("check", 1, 1)
    print(json.dumps({k: round(v, 4) for k, v in values.items()}, indent=2))
