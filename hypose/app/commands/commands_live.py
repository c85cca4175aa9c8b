"""`hypose live`: track people live from cameras; `hypose gesture`: learn still gestures in depth pictures and watch for
them; `hypose view`: open the studio.
"""

from __future__ import annotations

import contextlib
import math
import re
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from click.exceptions import Exit

from hypose.app.commands.console import Stages, counted, ended_by_signals, print_note, print_notes, say, stopping
from hypose.app.options import LiveCommand
from hypose.errors import InputError
from hypose.options import MOST_FRAMES, ListenHost, Option, Seed, Threads, named_values

if TYPE_CHECKING:
    from hypose.pipeline.live.engine import LiveResult, LiveStatus
    from hypose.pipeline.live.recorder import LiveRecorder

_SINCE = re.compile(r" for \d+ s$")
"""Part of a sentence that counts seconds, which is ignored when sentences are compared."""
_REPORT_S = 10.0


def live(c: LiveCommand) -> None:
    """Track people live until Ctrl-C, the end of the videos or the given time (`hypose live`)."""
    ended = threading.Event()
    with ended_by_signals(ended):  # an interrupt between two imports can be lost
        from hypose.app.jobs.job import compile_before
        from hypose.app.live.pose_outputs import PoseOutputs
        from hypose.pipeline.live.capture import CaptureOptions
        from hypose.pipeline.live.engine import LiveEngine, LiveTrackingOptions
        from hypose.pipeline.live.live_rig import live_rig
        from hypose.pipeline.live.live_search import LivePersonOptions
        from hypose.pipeline.live.recorder import LiveRecorder
        from hypose.pipeline.subject_from_motion import load_subject
        from hypose.pipeline.track_options import TrackOptions
    if ended.is_set():
        raise Exit(130)

    cameras = live_rig(c.rig, named_values("--source", c.source, "CAMERA=WHERE, for example --source cam1=0"), c.rate)
    print_notes(cameras.notes)
    person = LivePersonOptions(
        TrackOptions(seed=c.seed), c.height or cameras.height, None if c.subject is None else load_subject(c.subject)
    )
    network = c.people if _finds_people(c.detector, cameras.roomless) else 0
    views = tuple(replace(v, background=None) for v in cameras.views) if network else cameras.views
    capture = CaptureOptions(cameras.rate, c.countdown, cameras.silhouettes, network=network)
    names = tuple(v.name for v in cameras.views)
    with Stages() as progress:  # the first time it takes a while, and Ctrl-C ends it
        compile_before(progress)
    recorder = None
    with contextlib.ExitStack() as closing:
        closing.enter_context(ended_by_signals(ended))
        if c.record is not None:
            recorder = LiveRecorder(c.record, cameras.rig, cameras.views, cameras.silhouettes, person.height)
            closing.callback(recorder.close)
        outputs = PoseOutputs(names, cameras.rate, ws=c.ws, udp=c.udp, osc=c.osc, vmc=c.vmc, clock=time.monotonic)
        closing.callback(outputs.close)
        listeners = [outputs, _StatusReporter(recorder), *([] if recorder is None else [recorder])]
        options = LiveTrackingOptions(capture, person, c.people, pictures=recorder is not None)
        engine = LiveEngine(cameras.rig, views, options, listeners, ended)
        closing.callback(engine.stop)
        engine.start()
        if outputs.listeners is not None:
            say(f"Poses out:  ws://127.0.0.1:{outputs.listeners.port}/out")
        for name, target in (("udp", c.udp), ("osc", c.osc), ("vmc", c.vmc)):
            if target is not None:
                say(f"Poses out:  {name} {target}")
        say("Stop with Ctrl-C.")
        until = time.monotonic() + c.seconds if c.seconds else math.inf
        while not ended.is_set() and not engine.ended.is_set() and time.monotonic() < until:
            ended.wait(0.1)
        status, interrupted = engine.status(), ended.is_set()
        engine.stop()
        if recorder is not None:  # a second stop request does not lose the recording
            kept = recorder.close()
            without = f", without {recorder.left_out} instants" if recorder.left_out else ""
            nothing = "Nothing was recorded: there were no pictures of two cameras."
            say(f"Recorded: {c.record}{without}" if kept else nothing)
    if (
        engine.failed is not None and not interrupted
    ):  # an interrupt may stop the other processes first, which is no failure
        raise engine.failed
    say(f"{counted(status.poses, 'pose')}. {_summary(status)}")


def _finds_people(wanted: bool | None, roomless: bool) -> bool:
    """Decide whether the detector finds people.

    wanted: option --detector; None: as the recording needs it.
    roomless: the empty room is not known.
    Returns: True where it is wanted, or where the empty room is not known and the detector is installed.
    Raises: InputError where it is wanted and not installed.
    """
    from hypose.io.keypoints.detectors import open_network

    if wanted is False or not (wanted or roomless):
        return False
    try:
        open_network()
    except InputError as error:
        if wanted:
            raise
        print_note(f"note: the empty room is guessed from the videos. {error}")
        return False
    print_note("note: the detector finds people; no empty room is needed.")
    return True


class _StatusReporter:
    """Listener that prints changes at once, a summary now and then, and the failure of a recording."""

    def __init__(self, recorder: LiveRecorder | None) -> None:
        self._phase, self._words, self._at = "", (), -math.inf
        self._recorder = recorder

    def seen(self, seen: LiveResult) -> None:
        """Ignore the poses."""

    def status(self, status: LiveStatus) -> None:
        """Print what has changed."""
        if status.phase != self._phase:
            print_note(status.phase.replace("_", " ").capitalize() + ".")
        failed = () if self._recorder is None or not self._recorder.failed else (self._recorder.failed,)
        words = (*status.words, *failed)
        known = {_SINCE.sub("", text) for text in self._words}
        for text in words:
            if _SINCE.sub("", text) not in known:
                print_note(text)
        self._phase, self._words = status.phase, words
        if time.monotonic() - self._at >= _REPORT_S and status.poses:
            self._at = time.monotonic()
            print_note(_summary(status))


def _summary(status: LiveStatus) -> str:
    p50, p99 = status.latency
    late = "" if math.isnan(p50) else f", latency {p50:.0f} ms (p99 {p99:.0f} ms)"
    return f"{status.per_second:.1f} poses/s{late}, {100 * status.skipped:.0f} % of the instants skipped."


# ---- gestures -----------------------------------------------------------------------------------------------------


GESTURE_COMMANDS = {
    "Commands": {
        "record": ("commands_live:record", "Record a session with its prompts, to train from later."),
        "train": ("commands_live:gesture_train", "Teach a gesture, live or from recorded sessions."),
        "run": ("commands_live:gesture_run", "Watch for gestures: events as JSON lines, OSC, WebSocket."),
        "eval": ("commands_live:gesture_evaluate", "Judge a model on a recorded session."),
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
    frames: _Frames = 0,
    seed: Seed = 0,
) -> None:
    """Watch for gestures without a screen: events as JSON lines on stdout, and to the outputs that the options name."""
    from hypose.app.jobs import gesture_job
    from hypose.app.live.gesture_sources import open_source
    from hypose.app.live.osc import OscTarget
    from hypose.app.live.servers import SocketListeners
    from hypose.gestures.events import EventSettings
    from hypose.gestures.localise import LocaliseSettings
    from hypose.pipeline.gesture_files import load_model

    loaded = [load_model(m) for m in models]
    least = gesture_job.thresholds(loaded, threshold)
    limits = [EventSettings(t, hold_s=hold, refractory_s=rest) for t in least]
    names, settings = [m.name for m in loaded], LocaliseSettings(adaptation_rate=adaptation_rate)
    with stopping(), contextlib.ExitStack() as opened:
        target = None if osc is None else opened.enter_context(contextlib.closing(OscTarget(osc)))
        listeners = None
        if ws is not None:
            listeners = opened.enter_context(contextlib.closing(SocketListeners(ws, gesture_job.WAITING)))
        pictures = open_source(source, names[0], seed)
        for k, watched in enumerate(gesture_job.watch(pictures, loaded, settings, limits, print_note), 1):
            for event in watched.events:
                print(gesture_job.event_line(event, names), flush=True)
            if target is not None:
                target.send(gesture_job.gesture_osc(watched, names, least))
            if listeners is not None:
                for line in gesture_job.gesture_lines(watched, names):
                    listeners.post(line)
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


# ---- studio -------------------------------------------------------------------------------------------------------


_NETWORK = "Network"


def view(
    what: Annotated[Path, Option("Results folder, recording, or a folder that holds such.", argument=True)] = Path(),
    port: Annotated[int, Option("Port to listen on; 0 takes any free one.", 0, 65535, group=_NETWORK)] = 8765,
    host: ListenHost = "127.0.0.1",
    token: Annotated[
        str | None,
        Option("What pages must show. [default: none on this computer, else made]", group=_NETWORK),
    ] = None,
    no_browser: Annotated[bool, Option("Do not open the page.")] = False,
    threads: Threads = None,
) -> None:
    """Open the studio: results in 3D with their pictures, corrections by clicks, gestures, new recordings."""
    from hypose.app.studio.server import NOT_BUILT, STATIC_FOLDER, run_server

    if not what.exists():
        raise InputError(f"{what} does not exist; give a results folder, a recording, or a folder that holds such.")
    if not (STATIC_FOLDER / "index.html").is_file():
        raise InputError(NOT_BUILT)
    root, shown = _place(what)

    def ready(address: str) -> None:
        page = address + (f"#/{shown}" if shown else "")
        say(f"Studio: {page}")
        print_note(f"Shows {root}. Stop with Ctrl-C.")
        if not no_browser:
            import webbrowser

            webbrowser.open(page)

    run_server(root, host, port, token, ready)


def _place(what: Path) -> tuple[Path, str]:
    """Return the folder to serve, and the page that shows `what` in it."""
    from hypose.app.studio.catalog import Catalog, is_recording, recording_above

    folder = (what if what.is_dir() else what.parent).resolve()
    if (folder / "motion.npz").is_file():
        root = recording_above(folder) or folder
        return root, f"view/{Catalog(root).id_of('result', folder)}"
    if is_recording(folder):
        catalog = Catalog(folder)
        results = catalog.items("result")
        if results:  # the newest one of several
            return folder, f"view/{results[0].id}"
        return folder, f"setup/{catalog.id_of('recording', folder)}"
    return folder, ""
