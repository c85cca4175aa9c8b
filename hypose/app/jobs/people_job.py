"""Run a tracking job of several people: a folder of results for each, and overlay, C3D, GLB and an index of all."""

from __future__ import annotations

import html
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

import click
import numpy as np
from click.exceptions import Exit

from hypose.app.commands.console import ProgressCall, Stages, ignore, print_notes, say, stopping
from hypose.app.jobs.job import (
    ASSESSMENT_FILE,
    Outcome,
    TrackJob,
    check_job,
    compile_before,
    export_and_report,
    record_of,
    remove_stale,
    run_job,
)
from hypose.app.reports.overlay import colour_of, write_people_overlay
from hypose.app.reports.summary import CONTENT_POLICY, page, require_found, summarize
from hypose.calibration.findings import REVIEW, Finding
from hypose.errors import InputError
from hypose.io.files import check_writable, claimed
from hypose.io.motions.c3d import joint_residuals, write_c3d
from hypose.io.motions.gltf import write_people_glb
from hypose.io.motions.results import ResultsFolder, load_motion, save_body
from hypose.io.recordings.frames import FrameStream
from hypose.pipeline.assessment import EXIT_UNTRUSTED, UNTRUSTED, Assessment
from hypose.pipeline.frame_anomalies import in_words
from hypose.pipeline.person_paths import Wanted, said_of_places
from hypose.pipeline.recorded_frames import check_views, people_frames
from hypose.pipeline.run import TrackResult, track_people
from hypose.pipeline.track import chosen_people, keypoint_people, wanted_of
from hypose.tracking.contacts import runs

PEOPLE = "people.json"


def track_shown(job: TrackJob) -> None:
    """Run a job with progress and print its outcome; after an interruption, print what was kept and how to continue,
    and exit with code 130.
    """
    with stopping(lambda: _kept(job)), claimed(job.results.path), Stages() as progress:
        if job.command.people is not None:
            outcome = run_people(job, job.command.people, progress)
        else:
            outcome = run_job(job, progress, progress.seconds)
        if not outcome.complete:
            raise KeyboardInterrupt
    _report_outcome(job, outcome, progress.seconds)


def _kept(job: TrackJob) -> str:
    """Return the sentence on what an interrupted run has kept, and how to continue."""
    results, total = job.results, len(job.recording.frames)
    again = [a for a in click.get_current_context().find_root().obj or [] if a != "--resume"]
    command = f"hypose {shlex.join([*again, '--resume'])}" if again[:1] == ["track"] else "the same command"
    several = job.command.people is not None
    motions = sorted(results.path.glob("*/motion.npz")) if several else [results.motion]
    motions, where = [m for m in motions if m.exists()], results.path if several else results.motion
    if results.checkpoint.exists():
        if not motions:
            return (
                "Stopped before the first frame was tracked. Kept: body and start of the person, in "
                f"{results.checkpoint}. Go on with: {command}"
            )
        done = f"{len(load_motion(motions[0]))} of {total} frames"
        return f"Stopped. Kept: {done} in {where}, and the state of the tracker. Go on with: {command}"
    if several and motions:
        return f"Stopped. The motions that were complete are in {where}. Go on with: {command}"
    if motions:
        return f"Stopped. The motion is complete in {results.motion}. Write the other files with: {command}"
    return f"Stopped before the first frame was tracked, so nothing was kept. Start again with: {command}"


def _report_outcome(job: TrackJob, outcome: Outcome, seconds: Mapping[str, float]) -> None:
    """Print the closing lines of a job, and exit with code 3 where its result is not to be trusted.

    seconds: time per stage.
    Raises: EvidenceError where the person was found in no frame.
    """
    s = summarize(outcome.motion)
    print_notes(outcome.notes)
    views, reported = len(job.recording.rig), int(outcome.motion.n_views.max(initial=0))
    of = f"{reported} of {views}" if 0 < reported < views else f"{views}"  # largest number of views used in a frame
    parts = [f"{s.frames} frames in {of} views", f"{s.lost} lost", f"{s.extrapolated} extrapolated"]
    if s.iou == s.iou:
        parts.append(f"mean IoU {s.iou:.3f}")
    if s.sd_mm == s.sd_mm:
        parts.append(f"median joint sd {s.sd_mm:.1f} mm")
    if seconds.get("track"):
        parts.append(f"{s.frames / seconds['track']:.1f} frames/s")
    say(f"{job.recording.name}: " + ", ".join(parts))
    if outcome.truth is not None:
        say(f"Mean joint error: {outcome.truth.mean_mm:.1f} mm over {len(outcome.truth.names)} joints", "bold")
    say(f"Results: {job.results.path}")
    if job.command.report:
        say(f"Report:  {job.results.file('report.html')}")
    require_found(outcome.motion, job.recording.name, job.results.path)
    if outcome.assessment is not None:
        print_assessments({"": outcome.assessment})


def print_assessments(assessments: Mapping[str, Assessment]) -> None:
    """Print the assessments by people's names ("" for a single person); exit with code 3 where one is not to be
    trusted.
    """
    for name, assessment in assessments.items():
        say(f"Assessment{' on ' if name else ''}{name}: {assessment.sentence}", "bold")
    if any(assessment.word == UNTRUSTED for assessment in assessments.values()):
        raise Exit(EXIT_UNTRUSTED)


def run_people(job: TrackJob, people: str, progress: ProgressCall = ignore) -> Outcome:
    """Track several people, export, draw and report, like `run_job` for one.

    people: option of --people.
    Returns: the outcome of the first person, with the files of all people and the worst assessment.
    """
    recording, options, results = job.recording, job.options, job.results
    check_job(job)
    check_views(recording)
    if options.subject is not None:
        raise InputError(
            "--subject is one person's body; name the bodies of several people in recording.toml, as "
            "body = ... in their [[person]]."
        )
    wanted = wanted_of(recording)
    count, only = chosen_people(people, wanted)
    check_writable(results.path)
    record = record_of(job)
    record = {**record, "settings": {**record["settings"], "people": people}}
    compile_before(progress)
    with people_frames(recording, options, progress) as source:
        points = keypoint_people(recording, source.rig) if options.looks_at != "silhouettes" else None
        about = {"count": count, "wanted": wanted, "points": points, "results": results, "record": record}
        found = track_people(
            source, recording.frame_rate, options, resume=job.command.resume, progress=progress, **about
        )
        shown = [p for p in found.people if only is None or p.name == only]
        absent = "" if shown else _no_such_person(str(only), wanted, found.people)
        for why in said_of_places([w for w in wanted if w.name == only], len(found.people) + found.others):
            absent = f"who of several people is {only} is not known: {why}"
        shown = shown or list(found.people)
        notes = [*recording.notes, *source.notes, *found.notes]
        files: list[Path] = []
        for one in shown:
            files += _written(one, ResultsFolder(results.path / one.name))
        if found.complete:
            for one in shown:
                files += _one_report(job, one, source, files, progress)
            top = _together(job, shown, source, notes, progress)
            files += top
            remove_stale(results, [*top])
    first = shown[0]
    assessment = Assessment(UNTRUSTED, (Finding("absent", (), absent),)) if absent else worst_assessment(shown)
    results.write_json(ASSESSMENT_FILE, assessment.document())
    said = (*notes, *(f"{p.name}: {n}" for p in shown for n in p.notes))
    return Outcome(first.motion, first.body, found.complete, tuple(files), said, None, assessment)


def _no_such_person(name: str, wanted: Sequence[Wanted], people: Sequence[TrackResult]) -> str:
    """Return the sentence that the requested person was not found, and who was.

    name: of the requested person, one of `wanted`.
    people: those who were found.
    """
    one = next(w for w in wanted if w.name == name)
    return (
        f"{one.not_found}; the results are those of {', '.join(p.name for p in people)} instead: "
        "correct place and time of the [[person]] in recording.toml"
    )


def worst_assessment(people: Sequence[TrackResult]) -> Assessment:
    """Combine the assessments of several people: the worst word, with the sentences and frames of those who have it."""
    assessments = {p.name: p.assessment for p in people}
    order = ("good", "look", UNTRUSTED)
    word = max((v.word for v in assessments.values()), key=order.index)
    found = [
        Finding("person", (), f"{name}: {v.sentence}", severity=REVIEW)
        for name, v in assessments.items()
        if v.word == word and v.because
    ]
    frames = tuple(r for v in assessments.values() if v.word == word for r in v.frames)
    return Assessment(word, tuple(found), () if word == UNTRUSTED else frames)


def _written(one: TrackResult, results: ResultsFolder) -> list[Path]:
    """Write body, provenance and assessment of one person; the motion is there already.

    results: folder of the person.
    Returns: paths of these files and of the motion.
    """
    save_body(one.body, results.file("body.npz"))
    results.write_json("provenance.json", one.motion.provenance)
    results.write_json(ASSESSMENT_FILE, {**one.assessment.with_joints(one.motion), "there": _there(one)})
    return [results.file(n) for n in ("motion.npz", "body.npz", "provenance.json", ASSESSMENT_FILE)]


def _there(one: TrackResult) -> list[list[int]]:
    """List the rows [first, one after the last] of the motion in which a person is present."""
    return [[r.start, r.stop] for r in runs(one.there)]


def _one_report(
    job: TrackJob, one: TrackResult, source: FrameStream, written: Sequence[Path], progress: ProgressCall
) -> list[Path]:
    """Write motion files and report of one person, and delete files of earlier runs; return the paths.

    source: frames of the recording with all people.
    written: files that exist already, of all people.
    """
    results = ResultsFolder(job.results.path / one.name)
    own = replace(job, results=results, command=replace(job.command, overlay=False))
    about = {"title": f"{job.recording.name}: {one.name}", "notes": one.notes, "assessment": one.assessment}
    before = [p for p in written if p.parent == results.path]
    files = export_and_report(own, one, source, before, progress, **about)
    remove_stale(results, [*before, *files])
    return files


def _together(
    job: TrackJob, people: Sequence[TrackResult], source: FrameStream, notes: Sequence[str], progress: ProgressCall
) -> list[Path]:
    """Write overlay, C3D, GLB, people.json and index page of all people; return their paths.

    source: frames of the recording with all people.
    notes: for people.json and the page.
    """
    results, files = job.results, list[Path]()
    if job.command.overlay:
        path = results.file("overlay.mp4")
        write_people_overlay(path, job.recording, source, people, progress)
        files.append(path)
    if "c3d" in job.formats:
        files.append(write_people_c3d(results.file("motion.c3d"), people))
    if "glb" in job.formats:
        path = results.file("motion.glb")
        write_people_glb(path, [(p.name, p.motion, p.body) for p in people])
        files.append(path)
    about = [
        {"name": p.name, "folder": p.name, "assessment": p.assessment.word, "there": _there(p)}
        | {"stature": p.body.stature}
        for p in people
    ]
    files.append(results.write_json(PEOPLE, {"people": about, "notes": list(notes)}))
    if job.command.report:
        files.append(results.write_text("report.html", _index(job, people, notes)))
    files.append(results.file(ASSESSMENT_FILE))
    return files


def write_people_c3d(path: Path, people: Sequence[TrackResult]) -> Path:
    """Write the joint centres of all people as one C3D with subjects; return its path.

    Points are named NAME:JOINT. The residual of a point is its standard deviation (mm), 0 where it was not measured;
    points of absent people are marked as not seen.
    """
    subjects = [p.name.replace(" ", "-").replace(":", "-") for p in people]
    names = [f"{s}:{j}" for s, p in zip(subjects, people, strict=True) for j in p.motion.skeleton.joint_names]
    points = [np.where(p.there[:, None, None], p.motion.joints, np.nan) for p in people]
    residuals = np.concatenate([joint_residuals(p.motion) for p in people], 1)
    rate = people[0].motion.frame_rate
    write_c3d(path, names, np.concatenate(points, 1), rate, residuals, subjects=subjects)
    return path


def _index(job: TrackJob, people: Sequence[TrackResult], notes: Sequence[str]) -> str:
    """Build the page with links to the reports of all people.

    notes: sentences at the end of the page.
    """
    rows = []
    for k, p in enumerate(people):
        b, g, r = colour_of(k)
        there = in_words(runs(p.there)) if not p.there.all() else "all frames"
        cells = (
            f'<span style="color:rgb({r},{g},{b})">&#9632;</span>',
            f'<a href="{html.escape(quote(p.name), quote=True)}/report.html">{html.escape(p.name)}</a>',
            f"{p.body.stature:.2f} m",
            html.escape(there),
            html.escape(p.assessment.sentence),
        )
        rows.append("<tr>" + "".join(f"<td>{c}</td>" for c in cells) + "</tr>")
    film = '<p><video src="overlay.mp4" controls></video></p>' if job.command.overlay else ""
    said = "".join(f"<li>{html.escape(n)}</li>" for n in notes)
    heads = "".join(f"<th>{h}</th>" for h in ("", "person", "height", "there", "assessment"))
    body = f"<h1>{html.escape(job.recording.name)}</h1><table><tr>{heads}</tr>{''.join(rows)}</table>"
    return page(job.recording.name, f"{body}{film}<ul>{said}</ul>", policy=f"{CONTENT_POLICY}; media-src 'self'")
