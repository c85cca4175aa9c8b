"""`hypose export`, `report`, `explain`, `gait`, `compare`, `play` and `cite`: use results."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from hypose.app.commands.console import Stages, counted, each, print_note, print_notes, say, stopping
from hypose.errors import HyposeError, InputError
from hypose.options import MOST_FRAMES, MotionPath, Option, OutFolder, Threads, TrackedPath

if TYPE_CHECKING:
    from pythonosc.osc_message import OscMessage

    from hypose.body.body import Body
    from hypose.body.motion import Motion
    from hypose.pipeline.gait import Gait


def export(
    results: TrackedPath,
    formats: Annotated[str, Option("Motion files to write; also osim, rrd.")] = "trc,c3d,bvh,glb,csv,mot",
    out: OutFolder = None,
) -> None:
    """Write motion files (TRC, C3D, BVH, GLB, CSV, MOT; OpenSim, Rerun) from a tracked motion."""
    from hypose.app.jobs.job import split_names
    from hypose.io.files import claimed
    from hypose.io.motions.export import export_motion
    from hypose.io.motions.results import load_result_body

    motion, body = load_result_body(results)
    tell_untrusted(results)
    target = out or (results if results.is_dir() else results.parent)
    names = split_names(formats)
    with claimed(target), Stages() as progress:
        written = [p for name in each(progress, "export", names) for p in export_motion(motion, body, target, (name,))]
    for path in written:
        say(str(path))


def report(
    results: MotionPath,
    out: Annotated[Path | None, Option("File to write. [default: report.html in the results folder]")] = None,
    threads: Threads = None,
) -> None:
    """Write the report of a result again: one file that needs no other files."""
    from hypose.app.reports.report import write_report
    from hypose.app.studio.view_bundle import find_recording, load_view
    from hypose.io.files import check_writable

    folder = results if results.is_dir() else results.parent
    target = out or folder / "report.html"
    if target.is_dir():
        raise InputError(f"{target} is a folder; name the file to write, for example {target / 'report.html'}.")
    recording = None
    if results.exists():
        check_writable(target.parent)
        with contextlib.suppress(HyposeError):  # the report says why it has no pictures
            recording = find_recording(folder)
    shown = load_view(results, recording)
    with Stages() as progress:
        progress("report", 0, 1)
        written = write_report(target, shown, recording)
        progress("report", 1, 1)
    print_notes(shown.notes)
    say(f"Report: {written}")


def explain(
    results: TrackedPath,
    joint: Annotated[str, Option("Name of the joint, for example left_wrist.")],
    frame: Annotated[int, Option("Number of the frame in the recording.", 0, MOST_FRAMES)],
) -> None:
    """Explain where a joint of a frame comes from: its evidence, the passes that moved it, where else it may be."""
    from hypose.app.jobs.explain import explain_joint

    for line in explain_joint(results, joint, frame):
        say(line)


def gait(
    results: TrackedPath,
    out: OutFolder = None,
) -> None:
    """Write strikes, steps, cadence and speed (CSV, C3D with events), and joint angles over the gait cycle."""
    from hypose.io.files import claimed
    from hypose.io.motions.results import load_result_body
    from hypose.pipeline.gait import gait_of

    motion, body = load_result_body(results)
    source = results if results.is_dir() else results.parent
    tell_untrusted(results)
    found = gait_of(motion, body)
    with claimed(out or source):
        written = _write_gait(out or source, motion, found)
    strikes = sum(e.kind == "strike" for e in found.events)
    off = counted(len(found.events) - strikes, "time")
    say(f"{counted(strikes, 'foot strike')}, {off} a foot left the ground, {counted(len(found.steps), 'step')}")
    for f in found.figures:
        say(f"{f.name.replace('_', ' ')}: {f.mean:.3f} {f.unit} ({f.low:.3f} to {f.high:.3f} with 90 %), n = {f.n}")
    if not found.steps:
        say("Nobody walks two steps in this motion, as far as the feet show.")
    for path in written:
        say(str(path))


def _write_gait(folder: Path, motion: Motion, gait: Gait) -> list[Path]:
    """Write the gait: events.csv, steps.csv, gait.csv and gait.c3d (joint centres with the events), and with a whole
    stride cycles.csv and cycles.svg (joint angles over the cycle).

    motion: of which the gait is.
    Returns: paths of the files.
    """
    import numpy as np

    from hypose.app.reports.charts import cycle_chart
    from hypose.io.files import write_text
    from hypose.io.motions.marker_files import joint_residuals, write_c3d
    from hypose.pipeline.gait import PERCENT, angle_cycles

    start = float(motion.times[0])
    events = [
        (e.time, e.sd, e.side, e.kind, *e.place.tolist(), round((e.time - start) * motion.frame_rate))
        for e in gait.events
    ]
    steps = [
        (s.time, s.side, s.duration, s.duration_sd, s.length, s.length_sd, s.width, s.width_sd, s.double_support)
        for s in gait.steps
    ]
    figures = [(f.name, f.unit, f.mean, f.sd, f.low, f.high, f.n) for f in gait.figures]
    paths = [folder / n for n in ("events.csv", "steps.csv", "gait.csv", "gait.c3d")]
    _table(paths[0], "time_s,sd_s,side,event,x_m,y_m,z_m,frame", events)
    columns = "time_s,side,duration_s,duration_sd_s,length_m,length_sd_m,width_m,width_sd_m,double_support_s"
    _table(paths[1], columns, steps)
    _table(paths[2], "name,unit,mean,sd,low_90,high_90,n", figures)
    marks = [
        (e.time - start, e.side.capitalize(), {"strike": "Foot Strike", "off": "Foot Off"}[e.kind]) for e in gait.events
    ]
    names, residuals = motion.skeleton.joint_names, joint_residuals(motion)
    write_c3d(paths[3], names, motion.joints, motion.frame_rate, residuals, marks)
    cycles = angle_cycles(gait.events, motion)
    if not cycles:
        return paths
    paths += [folder / "cycles.csv", folder / "cycles.svg"]
    header = [f"{c.name}_{what}" for c in cycles for what in ("mean_deg", "sd_deg", "uncertainty_deg")]
    table = np.degrees([curve for c in cycles for curve in (c.mean, c.sd, c.uncertainty)]).T
    _table(
        paths[-2],
        ",".join(["percent", *header]),
        [(f"{p:g}", *row) for p, row in zip(PERCENT, table.tolist(), strict=True)],
    )
    write_text(paths[-1], cycle_chart(cycles))
    return paths


def _table(path: Path, header: str, rows: Sequence[Sequence[object]]) -> None:
    from hypose.io.files import write_text

    def cell(value: object) -> str:
        return str(value) if not isinstance(value, float) else f"{value:.5f}" if math.isfinite(value) else ""

    write_text(path, "\n".join([header, *(",".join(map(cell, row)) for row in rows)]) + "\n")


def play(
    results: MotionPath,
    vmc: Annotated[str, Option("HOST:PORT that the program listens on.")] = "127.0.0.1:39539",
    speed: Annotated[float, Option("How many times as fast as it was.", 0.01, 100)] = 1.0,
    loop: Annotated[bool, Option("Over and over, until Ctrl-C.")] = False,
) -> None:
    """Send a tracked motion to an avatar (VMC protocol): VSeeFace, Warudo, Unity, Unreal, Blender. See docs/live.md."""
    from hypose.app.live.osc import OscTarget
    from hypose.io.motions.results import load_result, load_result_body
    from hypose.pipeline.sensor_skeletons import pose_fused

    motion = load_result(results)
    if motion.poses is None:  # of depth sensors
        body, motion = pose_fused(motion)
    else:
        motion, body = load_result_body(results)
    tell_untrusted(results)
    with stopping(), contextlib.closing(OscTarget(vmc, "--vmc")) as target:
        say(
            f"{counted(len(motion), 'frame')} at {motion.frame_rate:g} Hz to {vmc}"
            + (", until Ctrl-C." if loop else ".")
        )
        play_motion(motion, body, target.send, speed, loop)


def play_motion(
    motion: Motion,
    body: Body,
    send: Callable[[list[OscMessage]], None],
    speed: float = 1.0,
    loop: bool = False,
    wait: Callable[[float], None] = time.sleep,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Send a motion with poses to an avatar at its own pace.

    Late frames are skipped; lost frames repeat the last pose and are marked.
    body: body of the motion.
    send: sends the messages of a frame.
    speed: factor of the pace.
    loop: repeat until interrupted.
    wait, clock: replaced in tests.
    Raises: InputError where no frame has a pose.
    """
    import numpy as np

    from hypose.app.live.vmc import vmc_messages

    if motion.poses is None or not (good := np.isfinite(motion.poses).all(1)).any():
        raise InputError("The motion has no poses, which an avatar needs; play a result of hypose track.")
    held = np.maximum.accumulate(np.where(good, np.arange(len(motion)), int(good.argmax())))
    tracked = good & ~motion.lost.astype(bool)
    due = (motion.times - motion.times[0]) / speed
    length = float(due[-1]) + 1 / (motion.frame_rate * speed)
    begin, n = clock(), 0
    while loop or n < len(motion):
        late = clock() - begin - (n // len(motion)) * length
        k = n % len(motion)
        n += 1
        if late < due[k]:
            wait(float(due[k]) - late)
        elif k + 1 < len(motion) and late > due[k + 1]:
            continue
        send(vmc_messages(body, motion.poses[held[k]], clock() - begin, bool(tracked[k])))


def cite(
    method: Annotated[
        str, Option("A results folder, or a recipe or method by name; a wrong one lists them.", argument=True)
    ] = "default",
    bibtex: Annotated[bool, Option("As BibTeX.")] = False,
) -> None:
    """Print the papers behind the method that gave a result."""
    from hypose.app.jobs.cite import formatted_papers, papers_of

    say(formatted_papers(papers_of(method), bibtex))


def tell_untrusted(results: Path) -> None:
    """Print a warning line if the assessment of a result (a folder, or its motion.npz) says that it is not to be
    trusted.

    Nothing is printed where the assessment is missing or unreadable.
    """
    from hypose.pipeline.assessment import UNTRUSTED, load_assessment

    folder = results if results.is_dir() else results.parent
    if (kept := load_assessment(folder)) is not None and kept.word == UNTRUSTED:
        print_note(f"note: {folder}: {kept.sentence}")
