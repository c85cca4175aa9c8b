"""Tracks one recording: frames -> subject -> start -> tracker -> Motion, with progress, checkpoints and resume."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.errors import HyposeError, InputError
from hypose.geometry import Array
from hypose.inference.layer import Recipe
from hypose.io.motions.results import ResultsFolder, save_motion
from hypose.io.recordings.provenance import identity
from hypose.pipeline.colour_detections import tracked_frames
from hypose.pipeline.doubts import with_doubts
from hypose.pipeline.first_frame import Subject, SubjectOptions, find_subject
from hypose.pipeline.first_look import first_look, sentences
from hypose.pipeline.kept_findings import SUBJECT, keep_subject, kept_subject
from hypose.pipeline.keypoint_track import track_keypoints
from hypose.pipeline.mend_sides import mend_sides, sides_notes
from hypose.pipeline.track_loop import FrameSource, Keep, Progress, Tracked, track_frames, tracked_before
from hypose.pipeline.verdict import Verdict, verdict_of
from hypose.tracking.doubt import evidence_of, judged
from hypose.tracking.fitted_spread import pose_covariance, with_fitted_angles, with_fitted_joints
from hypose.tracking.frame_evidence import OwnEvidence
from hypose.tracking.pose_covariance import unpacked
from hypose.tracking.recipes import RECIPES, recipe
from hypose.tracking.smooth_motion import smooth_motion
from hypose.tracking.tracker import FrameEstimate, Tracker, TrackerSettings, motion_of


@dataclass(frozen=True)
class TrackOptions:
    """What a user chooses. recipe: a preset's name; refine: contour refinement after a published recipe; evidence:
    'silhouettes', 'keypoints' or 'both'; start, height, girths: see SubjectOptions; subject: the file of a given body;
    smooth: solve all frames together at the end, if the recipe does; checkpoint_every: frames; sure_start: a person
    says that the start is the right way round."""

    recipe: str = "default"
    refine: bool = False
    evidence: str = "silhouettes"
    seed: int = 0
    start: str = "auto"
    height: float | None = None
    girths: bool = True
    subject: str | None = None
    smooth: bool = True
    checkpoint_every: int = 25
    sure_start: bool = False

    def __post_init__(self) -> None:
        if self.evidence not in ("silhouettes", "keypoints", "both"):
            raise InputError(f"There is no evidence {self.evidence!r}; choose silhouettes, keypoints or both.")
        preset = RECIPES.get(self.recipe)
        if preset is not None and self.evidence == "keypoints" and not preset.whole_clip:
            raise InputError(f"The recipe {self.recipe!r} needs silhouettes; choose the evidence silhouettes or both.")

    @property
    def whole_clip(self) -> bool:
        """All frames are solved on their key points together, instead of one after the other and then together."""
        preset = RECIPES.get(self.recipe)
        return self.evidence == "keypoints" and self.smooth and preset is not None and preset.whole_clip

    def settings(self) -> dict[str, Any]:
        """The choices that decide the result."""
        return {k: v for k, v in asdict(self).items() if k not in ("checkpoint_every", "sure_start")}


@dataclass(frozen=True)
class TrackResult:
    """motion; the subject's body; complete: every frame was tracked; notes for the report. one_by_one (T, D): the poses
    as each frame was tracked, audit (T, J, A): what spoke for and against each joint (hypose.tracking.audit), None
    where that was not kept; faults: sentences on what was found wrong before tracking."""

    motion: Motion
    body: Body
    complete: bool
    notes: tuple[str, ...]
    one_by_one: Array | None = None
    audit: NDArray[np.float32] | None = None
    faults: tuple[str, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """Whether the motion is to be trusted, in words."""
        return verdict_of(self.motion, self.faults)


def track_source(
    source: FrameSource,
    frame_rate: float,
    options: TrackOptions,
    *,
    body: Body | None = None,
    subject: Subject | None = None,
    results: ResultsFolder | None = None,
    record: Mapping[str, Any] | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    method: Recipe | None = None,
    own: Sequence[OwnEvidence] = (),
) -> TrackResult:
    """Tracks the frames of a source.

    body: the subject's own, of which only the start is looked for (default: the human template, fitted); subject: a
    known subject and start, which skips both. method: a recipe of the caller's own instead of the options'; own:
    evidence beside that of the frames. With `results` a checkpoint is written every `checkpoint_every` frames (later
    every twentieth of what is done), and motion.npz at the end or when interrupted. `record` is the provenance; its
    identity must match for `resume`.
    """
    report = progress or (lambda stage, done, total: None)
    total = len(source)
    if total == 0:
        raise InputError("The recording has no frame to track; check the frame range and the videos.")
    key = identity(record or {})
    report("look", 0, 1)
    faults = sentences(first_look(source, options.evidence, options.height))
    report("look", 1, 1)
    if subject is None:
        try:
            subject = subject_of(source, frame_rate, options, body, results if resume else None, key, report)
        except HyposeError as error:
            if not faults:
                raise
            raise type(error)(f"{' '.join(faults)} That may be why: {error}") from error
    keep = None
    if results is not None:  # before the motion, so that what is kept of an interrupted run can be looked at
        keep_subject(subject, results, key)
        keep = Keep(results.checkpoint, key, options.checkpoint_every)
    tracker = tracker_of(subject, options, frame_rate, method, own)
    if options.whole_clip and method is None and not own:
        solved, audit = track_keypoints(source, frame_rate, subject, report)
        motion = replace(solved.motion, provenance=record or {})
        notes = (*subject.notes, *solved.notes)
        motion = _doubted(motion, subject.body, solved.one_by_one, audit, solved.covariance)
        result = TrackResult(motion, subject.body, True, notes)
        return _written(replace(result, one_by_one=solved.one_by_one, audit=audit, faults=faults), results)
    before = tracked_before(results.checkpoint, key, total) if resume and results is not None else None
    begin = tracker.start(subject.start)
    done = track_frames(source, range(total), tracker, begin, subject, keep=keep, before=before, progress=report)
    if done.error is not None and results is not None:
        with contextlib.suppress(HyposeError):  # the first error is the one to tell
            save_motion(_motion(subject, done.estimates, frame_rate, record), results.motion)
        raise type(done.error)(
            f"{done.error} The {len(done.estimates)} frames before are kept in {results.path}; see --resume."
        ) from done.error
    return finish(source, subject, tracker, done, options, results, record, report, faults)


def subject_of(
    source: FrameSource,
    frame_rate: float,
    options: TrackOptions,
    body: Body | None,
    results: ResultsFolder | None,
    key: Mapping[str, Any],
    progress: Progress,
) -> Subject:
    """The subject that the run of this identity (`key`) kept in `results`, or else found in the frames."""
    progress("subject", 0, 1)
    subject = None if results is None else kept_subject(results, key)
    if subject is None:
        known = body is not None
        wanted = SubjectOptions(options.start, options.height, options.girths, body, frame_rate, options.seed, known)
        subject = find_subject(source.frame, len(source), wanted)
    progress("subject", 1, 1)
    return subject


def finish(
    source: FrameSource,
    subject: Subject,
    tracker: Tracker,
    done: Tracked,
    options: TrackOptions,
    results: ResultsFolder | None,
    record: Mapping[str, Any] | None,
    progress: Progress,
    faults: tuple[str, ...] = (),
) -> TrackResult:
    """The motion of what was tracked, stretches with exchanged sides mended, smoothed, judged and written."""
    estimates, notes, recipe = done.estimates, subject.notes, tracker.recipe
    if done.complete:
        progress("sides", 0, 1)
        estimates, exchanged = mend_sides(
            tracker,
            estimates,
            lambda frames: tracked_frames(source, frames, recipe.needs, subject),
            sure_start=options.sure_start,
        )
        notes = (*notes, *sides_notes(exchanged))
        progress("sides", 1, 1)
    motion = _motion(subject, estimates, tracker.settings.frame_rate, record)
    if options.smooth and recipe.smooth and done.complete:
        progress("smooth", 0, 1)
        smoothed = smooth_motion(subject.body, motion, np.stack([e.uncertainty.information for e in estimates]))
        motion, notes = smoothed.motion, (*notes, *smoothed.notes)
        progress("smooth", 1, 1)
    motion, doubts = with_doubts(motion, [e.seen for e in estimates])
    own, audit = np.stack([e.pose for e in estimates]), np.stack([e.audit for e in estimates])
    information = np.stack([e.uncertainty.information for e in estimates])
    covariance = pose_covariance(unpacked(information, subject.body.skeleton.dof))
    motion = _doubted(motion, subject.body, own, audit, covariance)
    return _written(TrackResult(motion, subject.body, done.complete, (*notes, *doubts), own, audit, faults), results)


def _doubted(motion: Motion, body: Body, one_by_one: Array, audit: NDArray[np.float32], covariance: Array) -> Motion:
    """The motion with the probability that a joint is wrong, what is doubtful for that, and standard deviations that
    hold; covariance (T, D, D) of the poses."""
    evidence = evidence_of(audit)
    p, joints = judged(motion, body.joints(one_by_one), audit)  # by what the curvature says
    motion = with_fitted_angles(with_fitted_joints(motion, evidence), covariance, evidence)
    frames = joints.any(1) if motion.doubtful is None else motion.doubtful | joints.any(1)
    return replace(motion, p_wrong=p, doubtful_joints=joints, doubtful=frames)


def _written(result: TrackResult, results: ResultsFolder | None) -> TrackResult:
    """The result, its motion written; when it is complete nothing else of the run is left."""
    if results is not None:
        save_motion(result.motion, results.motion)
        if result.complete:
            for left in (results.file(SUBJECT), results.checkpoint):
                left.unlink(missing_ok=True)
    return result


def _motion(
    subject: Subject, estimates: Sequence[FrameEstimate], frame_rate: float, record: Mapping[str, Any] | None
) -> Motion:
    """The motion of the finished frames; time 0 is the first tracked frame."""
    return motion_of(subject.body, np.arange(len(estimates)) / frame_rate, estimates, record or {})


def tracker_of(
    subject: Subject,
    options: TrackOptions,
    frame_rate: float,
    method: Recipe | None = None,
    own: Sequence[OwnEvidence] = (),
) -> Tracker:
    """The tracker of a run; method, own: as for `track_source`."""
    made = method or recipe(options.recipe, subject.body, frame_rate=frame_rate, refine=options.refine)
    settings = TrackerSettings(evidence=options.evidence, seed=options.seed, frame_rate=frame_rate)
    return Tracker(subject.body, made, settings, subject.keypoints, own)
