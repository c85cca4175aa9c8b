"""A tracking job of several people: one folder of results for each, and overlay, C3D, GLB and an index with all."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

import numpy as np

from hypose.app.commands.console import ProgressCall, ignore
from hypose.app.jobs.job import (
    ASSESSMENT_FILE,
    Outcome,
    TrackJob,
    check_job,
    compile_before,
    export_all,
    record_of,
    remove_stale,
)
from hypose.app.reports.overlay import OverlayRows, PictureRows, colour_of, write_overlay, write_people_overlay
from hypose.app.reports.report import report_pictures
from hypose.app.reports.summary import CONTENT_POLICY, page
from hypose.app.studio.view_bundle import Rivals, ViewResult, pictured
from hypose.calibration.findings import REVIEW, Finding
from hypose.errors import InputError
from hypose.io.files import check_writable
from hypose.io.motions.c3d import write_c3d
from hypose.io.motions.gltf import write_people_glb
from hypose.io.motions.results import ResultsFolder, save_body
from hypose.io.recordings.frames import FrameStream
from hypose.pipeline.assessment import UNTRUSTED, Assessment
from hypose.pipeline.frame_anomalies import in_words
from hypose.pipeline.one_of_several import chosen_people, keypoint_people, people_frames, wanted_of
from hypose.pipeline.people_run import PeopleRun
from hypose.pipeline.track_options import check_views
from hypose.pipeline.tracked_people import TrackedPerson, Wanted, said_of_places
from hypose.tracking.contacts import runs
from hypose.tracking.recipes import citation_of

PEOPLE = "people.json"


def run_people(job: TrackJob, people: str, progress: ProgressCall = ignore) -> Outcome:
    """Track several people, export, draw and report; as `run_job` for one. The outcome is that of the first person,
    with all people's files and the worst assessment."""
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
        found = PeopleRun(
            source,
            recording.frame_rate,
            options,
            count,
            wanted,
            results,
            record,
            job.command.resume,
            progress,
            keypoint_people(recording, source.rig) if options.looks_at != "silhouettes" else None,
        )()
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
    said = (*notes, *(f"{p.name}: {n}" for p in shown for n in p.result.notes))
    return Outcome(first.result.motion, first.result.body, found.complete, tuple(files), said, None, assessment)


def _no_such_person(name: str, wanted: Sequence[Wanted], people: Sequence[TrackedPerson]) -> str:
    """That the one who was asked for is not there, and who is."""
    one = next(w for w in wanted if w.name == name)
    return (
        f"{one.not_found}; the results are those of {', '.join(p.name for p in people)} instead: "
        "correct place and time of the [[person]] in recording.toml"
    )


def worst_assessment(people: Sequence[TrackedPerson]) -> Assessment:
    """Of several people: the worst word, and what each assessment says."""
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


def _written(one: TrackedPerson, results: ResultsFolder) -> list[Path]:
    """What of one person there is before anything is drawn."""
    save_body(one.result.body, results.file("body.npz"))
    results.write_json("provenance.json", one.result.motion.provenance)
    results.write_json(ASSESSMENT_FILE, {**one.assessment.with_joints(one.result.motion), "there": _there(one)})
    return [results.file(n) for n in ("motion.npz", "body.npz", "provenance.json", ASSESSMENT_FILE)]


def _there(one: TrackedPerson) -> list[list[int]]:
    return [[r.start, r.stop] for r in runs(one.present)]


def _one_report(
    job: TrackJob, one: TrackedPerson, source: FrameStream, written: Sequence[Path], progress: ProgressCall
) -> list[Path]:
    """Motion files and report of one person."""
    own = replace(job, results=ResultsFolder(job.results.path / one.name))
    motion, body = one.result.motion, one.result.body
    files = export_all(own, motion, body, progress)
    mine = [*(p for p in written if p.parent == own.results.path), *files]
    about = ViewResult(
        title=f"{job.recording.name}: {one.name}",
        motion=motion,
        body=body,
        rig=job.recording.rig,
        image_shifts=[v.image_shift for v in job.recording.views],
        pictures=pictured(job.recording),
        notes=(f"Assessment: {one.assessment.sentence}", *one.result.notes),
        citation=citation_of(job.options.recipe, job.options.refine),
        complete=one.result.complete,
        first_frame=job.recording.frames.start,
        rivals=Rivals.of_motion(motion),
    )

    def overlay(path: Path, wanted: PictureRows) -> OverlayRows:
        return write_overlay(path, job.recording, source, motion, body, wanted, progress)

    if job.command.report:
        files += report_pictures(own.results, about, overlay, mine, (False, True), progress)
    remove_stale(own.results, [*mine, *files])
    return files


def _together(
    job: TrackJob, people: Sequence[TrackedPerson], source: FrameStream, notes: Sequence[str], progress: ProgressCall
) -> list[Path]:
    """Overlay, C3D, GLB and index with all people."""
    results, files = job.results, list[Path]()
    if job.command.overlay:
        path = results.file("overlay.mp4")
        write_people_overlay(path, job.recording, source, people, progress)
        files.append(path)
    if "c3d" in job.formats:
        files.append(write_people_c3d(results.file("motion.c3d"), people))
    if "glb" in job.formats:
        path = results.file("motion.glb")
        write_people_glb(path, [(p.name, p.result.motion, p.result.body) for p in people])
        files.append(path)
    about = [
        {
            "name": p.name,
            "folder": p.name,
            "assessment": p.assessment.word,
            "there": _there(p),
            "stature": p.result.body.stature,
        }
        for p in people
    ]
    files.append(results.write_json(PEOPLE, {"people": about, "notes": list(notes)}))
    if job.command.report:
        files.append(results.write_text("report.html", _index(job, people, notes)))
    files.append(results.file(ASSESSMENT_FILE))
    return files


def write_people_c3d(path: Path, people: Sequence[TrackedPerson]) -> Path:
    """Joint centres of all, named NAME:JOINT, as one C3D with its subjects; points of who is not there are not seen."""
    subjects = [p.name.replace(" ", "-").replace(":", "-") for p in people]
    names = [f"{s}:{j}" for s, p in zip(subjects, people, strict=True) for j in p.result.motion.skeleton.joint_names]
    points, residuals = [], []
    for p in people:
        m = p.result.motion
        points.append(np.where(p.present[:, None, None], m.joints, np.nan))
        computed = (m.lost | m.extrapolated).astype(bool)
        residuals.append(np.where(computed[:, None], 0.0, np.maximum(m.joint_sd * 1000, 1e-3)))
    rate = people[0].result.motion.frame_rate
    write_c3d(path, names, np.concatenate(points, 1), rate, np.concatenate(residuals, 1), subjects=subjects)
    return path


def _index(job: TrackJob, people: Sequence[TrackedPerson], notes: Sequence[str]) -> str:
    """A page that leads to all people's report."""
    rows = []
    for k, p in enumerate(people):
        b, g, r = colour_of(k)
        there = in_words(runs(p.present)) if not p.present.all() else "all frames"
        cells = (
            f'<span style="color:rgb({r},{g},{b})">&#9632;</span>',
            f'<a href="{html.escape(quote(p.name), quote=True)}/report.html">{html.escape(p.name)}</a>',
            f"{p.result.body.stature:.2f} m",
            html.escape(there),
            html.escape(p.assessment.sentence),
        )
        rows.append("<tr>" + "".join(f"<td>{c}</td>" for c in cells) + "</tr>")
    film = '<p><video src="overlay.mp4" controls></video></p>' if job.command.overlay else ""
    said = "".join(f"<li>{html.escape(n)}</li>" for n in notes)
    heads = "".join(f"<th>{h}</th>" for h in ("", "person", "height", "there", "assessment"))
    body = f"<h1>{html.escape(job.recording.name)}</h1><table><tr>{heads}</tr>{''.join(rows)}</table>"
    return page(job.recording.name, f"{body}{film}<ul>{said}</ul>", policy=f"{CONTENT_POLICY}; media-src 'self'")
