"""`hypose fuse`: the skeletons of several depth sensors into one, recorded or live."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from click.exceptions import Exit

from hypose.app.commands.commands_track import (
    print_assessments,
    report_outcome,
    run_shown,
    set_threads,
    split_names,
    stopping,
)
from hypose.app.commands.console import Stages, print_note, say
from hypose.errors import InputError
from hypose.options import Option, Seed, Threads

if TYPE_CHECKING:
    from hypose.app.jobs.fuse_job import FuseOutcome

_RECORDED, _LIVE = "Recorded", "Live"


def fuse(
    recording: Annotated[
        Path | None,
        Option("Folder with session.json, a .csv, .skeleton or .jsonl file; nothing with --live.", argument=True),
    ] = None,
    method: Annotated[
        str,
        Option("fit, swarm, published, published-window.", group=_RECORDED),
    ] = "fit",
    out: Annotated[
        Path | None,
        Option("Results folder. [default: results/fuse-METHOD beside it]", group=_RECORDED),
    ] = None,
    formats: Annotated[str, Option("Motion files to write.", group=_RECORDED)] = "trc,c3d,csv",
    reference: Annotated[
        str | None,
        Option("Sensor that the others are registered to. [default: the first]", group=_RECORDED),
    ] = None,
    up: Annotated[
        str,
        Option("What is up: the person on average, or the sensor's y axis.", group=_RECORDED),
    ] = "person",
    diagnose: Annotated[
        bool,
        Option("Add the swarm's choice of sensors to sensors.csv.", group=_RECORDED, flag="--diagnose"),
    ] = False,
    cameras: Annotated[
        Path | None,
        Option("Recording of depth or colour cameras that saw the same; all is then solved together.", group=_RECORDED),
    ] = None,
    seed: Seed = 0,
    rate: Annotated[
        float | None, Option("Frames per second of the result. [default: the sensor's; live: 30]", 1, 1000)
    ] = None,
    live: Annotated[
        bool,
        Option("Take skeletons from the network and send the fused ones.", group=_LIVE, flag="--live"),
    ] = False,
    udp: Annotated[int | None, Option("UDP port for skeletons. [default: 9870]", 0, 65535, group=_LIVE)] = None,
    ws: Annotated[
        int | None,
        Option("WebSocket port: /in takes skeletons, /out sends. [default: 9871]", 0, 65535, group=_LIVE),
    ] = None,
    osc: Annotated[str | None, Option("HOST:PORT to send OSC to.", group=_LIVE)] = None,
    host: Annotated[
        str, Option("Address to listen on; others than this computer need the token.", group=_LIVE)
    ] = "127.0.0.1",
    token: Annotated[
        str | None,
        Option("What senders must show. [default: none on this computer, else made]", group=_LIVE),
    ] = None,
    wait: Annotated[float, Option("Milliseconds that a frame waits for late sensors.", 0, 10_000, group=_LIVE)] = 5.0,
    record: Annotated[Path | None, Option("New folder to record the skeletons to.", group=_LIVE)] = None,
    threads: Threads = None,
) -> None:
    """Fuse the skeletons of several depth sensors, and what cameras saw besides: one skeleton per person with its
    uncertainty. See docs/fusion.md, docs/live.md.

    It ends with an assessment: good, worth a look, or not to be trusted, and why; the last with exit code 3.
    """
    set_threads(threads)
    if live:
        if recording is not None:
            raise InputError("--live takes no recording; leave one of the two out.")
        import asyncio

        from hypose.app.live.live_server import FusionServerOptions, run_live
        from hypose.fusion.align import AlignSettings
        from hypose.fusion.live import LiveSettings

        if udp is None and ws is None:
            udp, ws = 9870, 9871
        settings = LiveSettings(AlignSettings(rate=30.0 if rate is None else rate, wait=wait / 1000))
        options = FusionServerOptions(host=host, udp=udp, ws=ws, osc=osc, token=token, record=record, settings=settings)
        asyncio.run(run_live(options, say, print_note))
        return
    if recording is None:
        raise InputError("There is nothing to fuse; give a recording of skeletons, or --live.")
    from hypose.app.jobs.fuse_job import FuseJob, run_fuse
    from hypose.app.reports.summary import require_found
    from hypose.io.file_names import file_name
    from hypose.io.files import claimed
    from hypose.io.motions.results import ResultsFolder
    from hypose.io.sensors.skeleton_files import read_skeletons

    loaded = read_skeletons(recording)
    if cameras is not None:
        if method != "fit" or diagnose or reference is not None or rate is not None:
            raise InputError(
                "With --cameras everything is one solve at the cameras' rate; leave --method, --reference, --rate "
                "and --diagnose out."
            )
        from hypose.app.jobs.job import TrackJob
        from hypose.io.recordings.recording import load_recording
        from hypose.pipeline.track_options import TrackOptions

        filmed = load_recording(cameras)
        results = ResultsFolder(out) if out is not None else ResultsFolder.of(filmed.folder, "fuse-cameras")
        about = {"formats": split_names(formats), "run": {"threads": threads}, "skeletons": loaded}
        job = TrackJob(filmed, TrackOptions(seed=seed), results, **about)
        report_outcome(job, run_shown(job, []))
        return
    folder = recording if recording.is_dir() else recording.parent
    name = f"fuse-{method}" if recording.is_dir() else f"{file_name(loaded.name)}-fuse-{method}"
    results = ResultsFolder(out) if out is not None else ResultsFolder.of(folder, name)
    fusing = FuseJob(
        loaded,
        results,
        method=method,
        rate=rate,
        reference=reference,
        formats=split_names(formats),
        up=up,
        diagnose=diagnose,
        seed=seed,
        run={"threads": threads},
    )
    nothing = "Stopped before anything was fused, so nothing was kept. Start again with the same command."
    with stopping(nothing), claimed(results.path), Stages() as progress:
        outcome = run_fuse(fusing, progress)
    _closing(outcome, loaded.name, len(loaded.streams), results.path)
    if not outcome.complete:
        raise Exit(130)
    if all(p.motion.lost.all() for p in outcome.people):
        require_found(outcome.people[0].motion, loaded.name, results.path)
    names = [f"person-{n + 1}" if len(outcome.people) > 1 else "" for n in range(len(outcome.people))]
    print_assessments({name: p.assessment for name, p in zip(names, outcome.people, strict=True)})


def _closing(outcome: FuseOutcome, name: str, sensors: int, folder: Path) -> None:
    import numpy as np

    for text in outcome.notes:
        print_note(f"note: {text}")
    if not outcome.complete:
        kept = [str(f) for p in outcome.people for f in p.files]
        say(f"Stopped. Kept: {', '.join(kept) if kept else 'nothing'}. Start again with the same command.")
        return
    for n, p in enumerate(outcome.people):
        m = p.motion
        who = f"{name}, person {n + 1}" if len(outcome.people) > 1 else name
        parts = [
            f"{len(m)} frames of {sensors} sensors at {m.frame_rate:g} Hz",
            f"{int(m.lost.sum())} lost",
            f"{float(m.n_views.mean()):.1f} sensors on average",
        ]
        if np.isfinite(m.joint_sd).any():
            parts.append(f"median joint sd {1000 * float(np.nanmedian(m.joint_sd)):.1f} mm")
        say(f"{who}: " + ", ".join(parts))
    say(f"Results: {folder}")
