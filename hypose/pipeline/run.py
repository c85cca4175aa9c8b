"""Track one recording: run the passes on a clip, with progress, checkpoints and resume."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.joint_angles import is_length, joint_angles
from hypose.body.motion import Modes, Motion
from hypose.calibration.findings import Finding
from hypose.errors import HyposeError, InputError, extra
from hypose.evidence.cues import OwnEvidence
from hypose.evidence.frame import Frame
from hypose.geometry import Array, runs
from hypose.inference.layer import Recipe
from hypose.io.files import read_json
from hypose.io.motions.results import ResultsFolder, load_result_body, save_body, save_motion
from hypose.pipeline.assessment import ASSESSMENT_FILE, Assessment, assess, later, trace_of, with_trace
from hypose.pipeline.moved_sensors import Places
from hypose.pipeline.passes import (
    AFTER_TRACKING,
    UNTIL_TRACKED,
    ClipState,
    clips_of_people,
    keep_interrupted,
    run_pass,
)
from hypose.pipeline.people import PeopleFinder
from hypose.pipeline.subject import TrackedSubject
from hypose.pipeline.track_loop import FrameSource, StageProgress, TrackedPerson, tracker_of
from hypose.pipeline.track_management import (
    KeypointPeople,
    KnownPerson,
    names_at_places,
    per_frame,
    said_of_places,
    untracked_note,
)
from hypose.pipeline.track_options import TrackOptions


@dataclass(frozen=True)
class TrackResult:
    """Result of tracking one person.

    motion: the motion.
    body: the subject's body.
    complete: every frame was tracked.
    notes: sentences for the report.
    modes: alternative poses of each frame, where the recipe provides them.
    one_by_one: (T, D) poses as each frame was tracked, before smoothing; None where not kept.
    audit: (T, J, A) features of the error model (hypose.tracking.joint_features); None where not kept.
    findings: reasons to distrust or review the motion, and remarks.
    places: corrected places of depth cameras.
    unsure: (2, J) probability that a joint is elsewhere at the start, from the subject (`TrackedSubject`); None: not
        known.
    judged: assessment of a result that was loaded from files; None: the assessment is computed from motion and
        findings.
    name: name of the person; empty where one person was tracked.
    present: (T,) frames in which the person is there; in the others the motion is filled and marked as lost. None: the
        person is there in all frames.
    """

    motion: Motion
    body: Body
    complete: bool
    notes: tuple[str, ...]
    modes: Modes | None = None
    one_by_one: Array | None = None
    audit: NDArray[np.float32] | None = None
    findings: tuple[Finding, ...] = ()
    places: tuple[Places, ...] = ()
    unsure: Array | None = None
    judged: Assessment | None = None
    name: str = ""
    present: NDArray[np.bool_] | None = None

    @property
    def there(self) -> NDArray[np.bool_]:
        """(T,) frames in which the person is there."""
        return np.ones(len(self.motion), dtype=np.bool_) if self.present is None else self.present

    @property
    def assessment(self) -> Assessment:
        """Assessment of the motion: good, to be reviewed, or not to be trusted, with reasons.

        Only frames in which the person is there are assessed.
        """
        if self.judged is not None:
            return self.judged
        at = np.flatnonzero(self.there)
        if len(at) in (0, len(self.motion)):
            return assess(self.motion, self.findings)
        found = assess(replace(self.motion, **per_frame(self.motion, at)), self.findings)
        marked = np.zeros(len(self.motion), dtype=np.bool_)
        for frames in found.frames:
            marked[at[frames.start : frames.stop]] = True
        return replace(found, frames=tuple(runs(marked)))

    @property
    def angles(self) -> dict[str, Array]:
        """Joint angles (T,) by OpenSim's names: degrees; metres for positions of the pelvis."""
        assert self.motion.poses is not None
        names, values = joint_angles(self.motion.skeleton, self.motion.poses)
        return {n: v if is_length(n) else np.degrees(v) for n, v in zip(names, values.T, strict=True)}

    def to_dataframe(self) -> Any:  # noqa: ANN401 (a pandas.DataFrame)
        """Make a pandas.DataFrame with one row per frame.

        Columns: time (s), lost, extrapolated, the joint angles, and of each joint x, y, z, sd (m) and p (probability of
            an error of more than 100 mm).
        Raises: InputError where pandas is not installed.
        """
        m, pandas = self.motion, extra("pandas", "A data frame", "pandas")
        columns = {"time": m.times, "lost": m.lost, "extrapolated": m.extrapolated, **self.angles}
        for j, name in enumerate(m.skeleton.joint_names):
            columns |= {f"{name}_{axis}": m.joints[:, j, k] for k, axis in enumerate("xyz")}
            columns[f"{name}_sd"] = m.joint_sd[:, j]
            if m.error_probability is not None:
                columns[f"{name}_p"] = m.error_probability[:, j]
        return pandas.DataFrame(columns)

    def save(self, folder: str | Path) -> None:
        """Write motion.npz, body.npz, provenance.json and assessment.json, which `load_result` reads.

        folder: is made where it does not exist.
        """
        results = ResultsFolder(Path(folder))
        save_motion(self.motion, results.motion)
        save_body(self.body, results.file("body.npz"))
        results.write_json("provenance.json", self.motion.provenance)
        results.write_json(ASSESSMENT_FILE, self.assessment.with_joints(self.motion))

    @staticmethod
    def of(clip: ClipState) -> TrackResult:
        """Make the result from a clip after all passes have run."""
        assert clip.motion is not None
        return TrackResult(
            clip.motion,
            clip.who.body,
            clip.complete,
            clip.notes,
            clip.modes,
            clip.one_by_one,
            clip.audit,
            clip.findings,
            clip.places,
            clip.who.unsure,
            name=clip.person.name,
            present=np.array(clip.person.present, dtype=np.bool_) if clip.person.name else None,
        )


@dataclass(frozen=True)
class PeopleResult:
    """Results of several people.

    people: in the order in which they were found.
    complete: all frames were tracked.
    notes: for the report.
    others: number of people in addition to those requested.
    findings: reasons to distrust the places of depth cameras.
    """

    people: tuple[TrackResult, ...]
    complete: bool
    notes: tuple[str, ...] = ()
    others: int = 0
    findings: tuple[Finding, ...] = ()


def load_tracked(folder: str | Path) -> TrackResult:
    """Load a result from its folder, as `hypose track` or `TrackResult.save` wrote it.

    Raises: InputError where files are missing or damaged.
    """
    motion, body = load_result_body(Path(folder))
    path = Path(folder) / ASSESSMENT_FILE
    try:
        judged = Assessment.of_document(read_json(path, "an assessment"))
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{path} is not an assessment of hypose; track the recording again.") from None
    return TrackResult(motion, body, True, (), judged=judged, findings=judged.findings)


def track_source(
    source: FrameSource,
    frame_rate: float,
    options: TrackOptions,
    *,
    body: Body | None = None,
    subject: TrackedSubject | None = None,
    results: ResultsFolder | None = None,
    record: Mapping[str, Any] | None = None,
    resume: bool = False,
    progress: StageProgress | None = None,
    method: Recipe | None = None,
    own: Sequence[OwnEvidence] = (),
    find_places: bool = True,
) -> TrackResult:
    """Track one person in the frames of a source.

    frame_rate: Hz.
    body: the subject's own body, for which only the start pose is searched; None: the human template, fitted.
    subject: known body and start pose; nothing is searched.
    results: folder for motion.npz, which is written at the end or when interrupted, and for a checkpoint, which is
        written every `checkpoint_every` frames, later after each twentieth of the frames so far.
    record: provenance of the motion; to resume a run its identity must match.
    resume: continue from the checkpoint in `results`.
    progress: called with stage, done, total.
    method: recipe of your own that replaces that of the options.
    own: evidence in addition to that of the frames.
    find_places: correct depth cameras that stand elsewhere than the source says.
    Raises: InputError where the source has no frames.
    """
    clip = ClipState(
        source,
        frame_rate,
        options,
        body=body,
        method=method,
        own=own,
        results=results,
        record=record or {},
        resume=resume,
        find_places=find_places,
        progress=progress or (lambda stage, done, total: None),
        given=subject is not None,
    )
    if subject is not None:
        tracker = tracker_of(subject, options, frame_rate, method, own)
        clip = replace(clip, people=(TrackedPerson.at_start("", subject, tracker),))
    return _run(clip)[1][0]


def track_people(
    source: FrameSource,
    frame_rate: float,
    options: TrackOptions,
    *,
    count: int | None = None,
    wanted: Sequence[KnownPerson] = (),
    points: KeypointPeople | None = None,
    folders: bool = True,
    **kept: Any,
) -> PeopleResult:
    """Track several people in the frames of a source.

    frame_rate: Hz.
    count: most results; None: all people. Those beyond are tracked too, since they hide the others.
    wanted: prior knowledge of some of them.
    points: key points sorted by person, for the evidence 'keypoints' and 'both'.
    folders: each person has a folder of their own in the results folder; else the motion of the one person who is asked
        for is written into it.
    kept: results (folder for files), record (provenance), resume (continue from the checkpoint) and progress
        (function of stage, done, total), the same as those of `track_source`.
    Raises: InputError where the evidence cannot separate people; EvidenceError where no person is found.
    """
    kept = {"progress": lambda stage, done, total: None} | {k: v for k, v in kept.items() if v is not None}
    if options.of_picture:
        raise InputError("One camera alone cannot tell several people apart; leave out --people, or add cameras.")
    if options.looks_at == "keypoints":
        return _by_keypoints(source, frame_rate, options, count, wanted, points, kept)
    if options.looks_at == "both" and points is None:
        raise InputError("The evidence 'both' needs key points, and this recording has none; use silhouettes.")
    used = points if options.looks_at == "both" else None
    finder = PeopleFinder(source, frame_rate, options, count, wanted, used)
    clip, done = _run(ClipState(source, frame_rate, options, finder=finder, folders=folders, **kept))
    complete, names = all(p.complete for p in done), [p.name for p in clip.people]
    said = *_who_is_there(done, frame_rate), *untracked_note(clip.candidates)
    said += tuple(w.not_found for w in wanted if w.name not in names)
    said += said_of_places(wanted, len(names))
    return PeopleResult(tuple(done), complete, said, len(names) - len(done), clip.findings)


def _by_keypoints(
    source: FrameSource,
    frame_rate: float,
    options: TrackOptions,
    count: int | None,
    wanted: Sequence[KnownPerson],
    points: KeypointPeople | None,
    kept: dict[str, Any],
) -> PeopleResult:
    """Track people by key points alone, each as if they were alone, since key points are sorted by person."""
    if points is None or not points.tracks:
        raise InputError(
            "The evidence 'keypoints' needs key points of people on whom two cameras or more agree; check them "
            "with `hypose check`, or use silhouettes."
        )
    total, done, tracks = len(source), list[TrackResult](), points.lasting(len(source))
    where, ranks = [points.tracks[k] for k in tracks], {w.name: k for k, w in enumerate(wanted)}
    names = names_at_places(wanted, len(where), lambda k, t: where[k].place(t)[:2], frame_rate)
    ranked = sorted(range(len(tracks)), key=lambda k: ranks.get(names[k], len(ranks)))
    results = kept.pop("results", None)
    for k in ranked[:count]:
        known = next((w for w in wanted if w.name == names[k]), KnownPerson(names[k]))
        frames = PointFrames(source, points, tracks[k])
        own, folder = replace(options, height=known.height or options.height), None
        if results is not None:
            folder = ResultsFolder(results.path / names[k])
        out = track_source(frames, frame_rate, own, body=known.body, results=folder, **kept)
        present = np.zeros(total, dtype=np.bool_)
        present[frames.first : frames.first + len(out.motion)] = True
        out = replace(out, motion=padded(out.motion, frames.first, total), name=names[k], present=present)
        if folder is not None:
            save_motion(out.motion, folder.motion)
        done.append(out)
        if not out.complete:
            break
    said = *_who_is_there(done, frame_rate), *said_of_places(wanted, len(tracks))
    return PeopleResult(tuple(done), all(p.complete for p in done), said, len(tracks) - len(done))


def _who_is_there(people: Sequence[TrackResult], frame_rate: float) -> tuple[str, ...]:
    """Return sentences on who was there, and when."""
    said = [f"{len(people)} {'people' if len(people) != 1 else 'person'}: {', '.join(p.name for p in people)}"]
    for p in people:
        at = np.flatnonzero(p.there)
        if 0 < len(at) < len(p.motion):
            said.append(f"{p.name} is there from {at[0] / frame_rate:.1f} to {(at[-1] + 1) / frame_rate:.1f} s")
    return tuple(said)


def _run(clip: ClipState) -> tuple[ClipState, list[TrackResult]]:
    """Run all passes: find and track the people of a clip together, then finish the clip of each.

    A KeyboardInterrupt after the first tracked frame keeps and writes what was tracked; before it, it is raised.
    Returns: the clip after tracking, and the results of the people who are asked for.
    Raises: InputError where the source has no frames; the error that ended tracking after some frames, when these have
        been written.
    """
    if len(clip.source) == 0:
        raise InputError("The recording has no frame to track; check the frame range and the videos.")
    try:
        for step in UNTIL_TRACKED:
            clip = run_pass(step, clip)
    except KeyboardInterrupt:
        if not clip.estimates:
            raise
        clip = replace(clip, complete=False)
    done, results = list[TrackResult](), clip.results
    for own in clips_of_people(clip):  # after an interruption the motions of the others are kept as they were tracked
        if clip.error is not None:
            with contextlib.suppress(HyposeError):  # the first error is the one to report
                keep_interrupted(own)
            continue
        done.append(finish(replace(own, complete=own.complete and all(p.complete for p in done))))
    if clip.error is not None and results is not None:
        kept = f"The {len(clip.estimates)} frames before are kept in {results.path}; see --resume."
        raise type(clip.error)(f"{clip.error} {kept}") from clip.error
    if results is not None and all(p.complete for p in done):
        results.checkpoint.unlink(missing_ok=True)
    return clip, done


def finish(clip: ClipState) -> TrackResult:
    """Correct, smooth, judge and write a clip of one person that has been tracked."""
    try:
        for step in AFTER_TRACKING:
            clip = run_pass(step, clip)
    except KeyboardInterrupt:
        if not clip.estimates:
            raise
        clip = keep_interrupted(clip)
    return TrackResult.of(clip)


class PointFrames:
    """Frames of a source in which one person's track lasts, with the key points of that person as the only evidence.

    track: number of the track in `points`.
    """

    def __init__(self, source: FrameSource, points: KeypointPeople, track: int) -> None:
        self._source, self._points, self._track = source, points, track
        self.first = points.tracks[track].first
        self._count = len(points.tracks[track])

    def __len__(self) -> int:
        return self._count

    def frame(self, index: int, /) -> Frame:
        """Return frame number index, counted from the first frame of the track."""
        t = self.first + index
        return replace(self._source.frame(t), silhouettes=None, keypoints=self._points.of(self._track, t))


def padded(motion: Motion, first: int, total: int) -> Motion:
    """Extend a motion of the frames first, first + 1, ... to `total` frames: outside, its first and last frame are
    repeated and marked as lost and extrapolated.
    """
    rows = np.clip(np.arange(total) - first, 0, len(motion) - 1)
    outside = (np.arange(total) < first) | (np.arange(total) >= first + len(motion))
    arrays = per_frame(motion, rows) | {"times": np.arange(total) / motion.frame_rate}
    out = replace(motion, **arrays)
    out = replace(out, lost=out.lost | outside, extrapolated=out.extrapolated | outside)
    return with_trace(out, later(trace_of(motion), first))
