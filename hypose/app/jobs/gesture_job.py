"""`hypose gesture`: run sessions, learn from recordings, watch for events, evaluate a model."""

from __future__ import annotations

import contextlib
import itertools
import json
import queue
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from pythonosc.osc_message import OscMessage

from hypose.app.commands.console import Stages, print_note, say, stopping
from hypose.app.live.gestures import (
    Teaching,
    Watched,
    Watching,
    event_value,
    growing_model,
    learner_of,
    open_source,
    trained_model,
)
from hypose.app.live.osc import OscTarget, osc_message
from hypose.app.live.servers import SocketListeners
from hypose.compute.forest_votes import ScanPlan
from hypose.errors import EvidenceError, InputError
from hypose.gestures.depth_pictures import surface_depth
from hypose.gestures.events import average_precision
from hypose.gestures.localise import Scratch, localise
from hypose.gestures.model import GestureModel, check_gesture_name
from hypose.gestures.trainer import Command, SessionSettings, Trainer
from hypose.io.files import check_writable
from hypose.options import MOST_FRAMES, Option, Seed
from hypose.pipeline.gesture_files import GestureRecording, content_of, load_model, read_recording, save_model

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


def run_session(
    session: Teaching, commands: Callable[[], list[Command]] = list, say: _Say = print_note
) -> GestureModel:
    """Run a session that teaches a gesture until its test begins or the source ends; close it and its source.

    commands: gives the commands since the last call.
    say: prints a sentence.
    Returns: the trained model; its threshold is None where gesture and other movement were not both seen.
    Raises: InputError where nothing was learned.
    """
    shown, source, trainer = "", session.source, session.trainer
    rounds = trainer.settings.rounds
    try:
        while session.phase != "test" and (taken := source.take(session.phase)) is not None:
            f = session.frame(taken, commands(), taken.box)
            text = f"round {trainer.session.round + 1}/{rounds}: {f.instruction.prompt}"
            if text != shown:
                known = session.phase != "test" and f.threshold is not None
                say(text + (f" (threshold {in_cm2(f.threshold)})" if known else ""))
                shown = text
    finally:
        session.close()
        source.close()
    asked, learned, where = session.asked, session.learned("gesture"), _range(trainer.learner.settings.look.plan)
    if not learned and (asked or not trainer.learner.strength):  # a forest of the gesture may learn other movement only
        raise InputError(
            f"Nothing was learned from {source.name}: {asked} frames asked for the gesture, and none had depth {where} "
            "in the box; come nearer, and keep the gesture in the box."
        )
    if 2 * learned < asked:
        say(f"Only {learned} of {asked} frames of the gesture had depth {where} in the box.")
    return session.model()


def _range(plan: ScanPlan) -> str:
    return f"between {plan.near_mm / 1000:g} and {plan.far_mm / 1000:g} m"


def in_cm2(threshold: float | None) -> str:
    """Format a threshold with three significant digits, since small gestures score less than 0.1 cm²."""
    return "not known yet" if threshold is None else f"{threshold:.3g} cm²"


def learn_recordings(
    recordings: Sequence[GestureRecording], gesture: str, passes: int, old: GestureModel | None, seed: int
) -> GestureModel:
    """Train a forest with recorded sessions in the order of time, as the live session would.

    gesture: name of the gesture, which the recordings must have.
    passes: number of times all recordings are learned.
    old: model that is trained further; None: a new forest, with the random numbers of `seed`.
    Returns: the trained model.
    Raises: InputError where the recordings have no usable frame of the gesture.
    """
    trainer, seen, asked, shown = Trainer(learner_of(old, seed)), 0, 0, 0
    for k in range(passes):
        for e in itertools.chain.from_iterable(r.examples(gesture) for r in recordings):
            kind = "gesture" if e.gesture else "negative"
            taught = trainer.learn(kind, e.depth, e.lens, (e.x, e.y)) is not None
            seen, asked, shown = seen + taught, asked + e.gesture, shown + (taught and e.gesture)
        print_note(f"pass {k + 1} of {passes}: {seen} frames learned")
    if not shown and (asked or not trainer.learner.strength):
        raise InputError(_NOTHING.format(gesture=gesture, where=_range(trainer.learner.settings.look.plan)))
    entries = [{"recording": r.folder.name, "passes": passes, "content": content_of(r.folder)} for r in recordings]
    return trained_model(gesture, trainer, trainer.final_threshold(), old, entries)


_NOTHING = (
    "The recordings hold no frame of {gesture!r} with depth {where} at the marked place; record a session of it with "
    "`hypose gesture train --record`."
)


_EMPTY = 30
"""Frames in a row without usable depth that are reported."""


def watch(session: Watching, say: _Say = print_note) -> Iterator[Watched]:
    """Yield the result of a session that watches for gestures for every picture of its source, which is closed at the
    end.

    say: prints a sentence when no depth is near enough.
    Raises: EvidenceError at the end of a source without usable depth.
    """
    source, plan, empty, near = session.source, session.settings.plan, 0, False
    try:
        while (taken := source.take("free")) is not None:
            some = taken.depth[::8, ::8]
            empty = 0 if ((some >= plan.near_mm) & (some <= plan.far_mm)).any() else empty + 1
            near = near or not empty
            if empty == _EMPTY:
                say(f"{source.name}: {_EMPTY} frames have no depth {_range(plan)}, where gestures are looked for.")
            yield session.frame(taken)
        if not near:
            raise EvidenceError(
                f"{source.name}: no frame has depth {_range(plan)}, where gestures are looked for; come nearer, or see "
                "whether its depth is in millimetres."
            )
    finally:
        source.close()


def evaluate_model(model: GestureModel, recording: GestureRecording) -> dict[str, float]:
    """Evaluate a model of one gesture on the labelled frames of a recording.

    Returns: numbers of frames and of frames with the gesture (positives); average precision with the place within 10 px
        (ap_10px) and 5 cm (ap_5cm); where the model has a threshold: threshold_cm2, and the shares of the gesture's
        frames that are found within 5 cm (found_share) and of other frames above the threshold (false_share).
    Raises: InputError where the recording has no usable frames.
    """
    scratch, plan, forest, rows, measured = Scratch(), ScanPlan(), model.learner.forest.freeze(), [], 0
    for e in recording.examples(model.name):
        found = localise(e.depth, e.lens, [forest], None, scratch)[0]
        off = float(np.hypot(found.x - e.x, found.y - e.y)) if e.gesture else np.inf
        surface = surface_depth(e.depth, e.x, e.y) if e.gesture else None
        measured += surface is not None and plan.near_mm <= surface <= plan.far_mm
        z = found.position[2] if found.position is not None else np.inf
        rows.append((found.score, off, off * z / e.lens.fx if e.gesture else np.inf))
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
    return [frame, *(json.dumps(event_value(e, names)) for e in watched.events)]


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
        growing_model(out, gesture)  # refuses to replace the model of another gesture, or a file that is no model
        how = f"to go on with it, stop and add --resume {out}"
        print_note(f"note: {out} holds a model of {gesture} already, which will be replaced; {how}.")
    if recording:
        model = learn_recordings([read_recording(r) for r in recording], gesture, passes, old, seed)
    else:
        settings, opened = SessionSettings(rounds=rounds), open_source(source, gesture, seed)
        session = Teaching(opened, gesture, settings, old=old, seed=seed, record=record_to)
        print_note(_LETTERS)
        model = run_session(session, typed_commands())
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
    how = {"adaptation_rate": adaptation_rate, "hold_s": hold, "rest_s": rest}
    with stopping(), contextlib.ExitStack() as opened:
        target = None if osc is None else opened.enter_context(contextlib.closing(OscTarget(osc)))
        listeners = None
        if ws is not None:
            listeners = opened.enter_context(contextlib.closing(SocketListeners(ws)))
        session = Watching(open_source(source, loaded[0].name, seed), loaded, threshold, **how)
        names, limits = session.names, [limit.threshold for limit in session.limits]
        for k, watched in enumerate(watch(session), 1):
            scores, *events = gesture_lines(watched, names)
            for line in events:
                print(line, flush=True)
            if target is not None:
                target.send(gesture_osc(watched, names, limits))
            if listeners is not None:
                for line in (scores, *events):
                    listeners.post(line)
            if frames and k >= frames:
                break


def gesture_evaluate(
    model: Annotated[Path, Option("Model file.", argument=True)],
    recording: Annotated[Path, Option("Recorded session that was not learned.", argument=True)],
) -> None:
    """Evaluate a model on a recorded session: average precision, and hits and false alarms at its threshold."""
    loaded, session = load_model(model), read_recording(recording)
    if loaded.learned(content_of(recording)):
        print_note(
            f"note: {model} has learned from {recording}: the figures say how well it remembers that, and not how well "
            "it finds the gesture elsewhere; give a session that was not learned."
        )
    with Stages() as progress:
        progress("check", 0, 1)
        values = evaluate_model(loaded, session)
        progress("check", 1, 1)
    print(json.dumps({k: round(v, 4) for k, v in values.items()}, indent=2))
