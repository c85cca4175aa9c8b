"""`hypose live`: track people live from cameras; `hypose view`: open the studio."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from click.exceptions import Exit

from hypose.app.commands.console import Stages, counted, ended_by_signals, print_note, print_notes, say
from hypose.app.options import LiveCommand
from hypose.errors import InputError
from hypose.options import ListenHost, Option, Threads, named_values

if TYPE_CHECKING:
    from hypose.pipeline.live.engine import LiveResult, LiveStatus

_REPORT_S = 10.0


def live(c: LiveCommand) -> None:
    """Track people live until Ctrl-C, the end of the videos or the given time (`hypose live`)."""
    ended = threading.Event()
    with ended_by_signals(ended):  # an interrupt between two imports can be lost
        from hypose.app.jobs.job import compile_before
        from hypose.app.live.pose_outputs import TrackingRun
        from hypose.pipeline.live.capture import CaptureOptions
        from hypose.pipeline.live.live_people import LivePersonOptions
        from hypose.pipeline.live.live_rig import live_rig
        from hypose.pipeline.subject import load_subject
        from hypose.pipeline.track_options import TrackOptions
    if ended.is_set():
        raise Exit(130)

    cameras = live_rig(c.rig, named_values("--source", c.source, "CAMERA=WHERE, for example --source cam1=0"), c.rate)
    print_notes(cameras.notes)
    person = LivePersonOptions(
        TrackOptions(seed=c.seed), c.height or cameras.height, None if c.subject is None else load_subject(c.subject)
    )
    network = c.people if _finds_people(c.detector, cameras.no_background) else 0
    if network:
        cameras = replace(cameras, views=tuple(replace(v, background=None) for v in cameras.views))
    capture = CaptureOptions(cameras.rate, c.countdown, cameras.silhouettes, network=network)
    with Stages() as progress:  # the first time it takes a while, and Ctrl-C ends it
        compile_before(progress)
    targets = {"udp": c.udp, "osc": c.osc, "vmc": c.vmc}
    about = {"listeners": [_StatusReporter()], "record": c.record, "stop": ended, "ws": c.ws, **targets}
    with ended_by_signals(ended):
        run = TrackingRun(cameras, capture, person, c.people, **about)
        engine, recorder, lost = run.engine, run.recorder, False
        try:
            if run.outputs.listeners is not None:
                say(f"Poses out:  ws://127.0.0.1:{run.outputs.listeners.port}/out")
            for name, target in targets.items():
                if target is not None:
                    say(f"Poses out:  {name} {target}")
            say("Stop with Ctrl-C.")
            until = time.monotonic() + c.seconds if c.seconds else math.inf
            while not ended.is_set() and not engine.ended.is_set() and time.monotonic() < until:
                ended.wait(0.1)
                if recorder is not None and recorder.failed and not lost:
                    lost = True
                    print_note(recorder.failed)
            status, interrupted = engine.status(), ended.is_set()
        finally:
            said = run.close(str(c.record))  # a second stop request does not lose the recording
    if said:
        say(said)
    if engine.failed is not None and not interrupted:  # an interrupt may stop the other processes first
        raise engine.failed
    say(f"{counted(status.poses, 'pose')}. {_summary(status)}")


def _finds_people(wanted: bool | None, no_background: bool) -> bool:
    """Decide whether the detector finds people.

    wanted: option --detector; None: as the recording needs it.
    no_background: the empty room is not known.
    Returns: True where it is wanted, or where the empty room is not known and the detector is installed.
    Raises: InputError where it is wanted and not installed.
    """
    from hypose.io.keypoints.detectors import open_network

    if wanted is False or not (wanted or no_background):
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
    """Listener that prints changes at once, and a summary now and then."""

    def __init__(self) -> None:
        self._phase, self._words, self._at = "", (), -math.inf

    def seen(self, seen: LiveResult) -> None:
        """Ignore the poses."""

    def status(self, status: LiveStatus) -> None:
        """Print what has changed."""
        if status.phase != self._phase:
            print_note(status.phase.replace("_", " ").capitalize() + ".")
        for text in status.words:
            if text not in self._words:
                print_note(text)
        self._phase, self._words = status.phase, status.words
        if time.monotonic() - self._at >= _REPORT_S and status.poses:
            self._at = time.monotonic()
            print_note(_summary(status))


def _summary(status: LiveStatus) -> str:
    p50, p99 = status.latency
    late = "" if math.isnan(p50) else f", latency {p50:.0f} ms (p99 {p99:.0f} ms)"
    return f"{status.per_second:.1f} poses/s{late}, {100 * status.skipped:.0f} % of the instants skipped."


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
