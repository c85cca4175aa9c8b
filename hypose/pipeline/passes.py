"""Passes of a run over one person's clip, from its frames to a motion that has been judged.

`PASSES` lists them in the order in which they run. Each pass takes the clip (`ClipState`) as the pass before left it
and returns a changed copy. `run_pass` records in the clip's trace which joints a pass moved, by how much and why.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.motion import Modes, Motion
from hypose.calibration.findings import INVALID, REVIEW, Finding
from hypose.errors import EvidenceError, HyposeError
from hypose.evidence.cues import OwnEvidence
from hypose.evidence.frame import Frame, Keypoints
from hypose.evidence.prefetch import look_ahead
from hypose.geometry import Array
from hypose.inference.layer import Recipe
from hypose.io.motions.results import ResultsFolder, provenance_identity, save_modes, save_motion
from hypose.io.recordings.frames import FrameStream
from hypose.pipeline import backward_pass as backwards
from hypose.pipeline import input_checks, left_right
from hypose.pipeline.assessment import not_shown, other_people_note
from hypose.pipeline.first_frame import SubjectOptions, TrackedSubject, keep_subject, kept_subject
from hypose.pipeline.first_frame import find_subject as subject_in_frames
from hypose.pipeline.frame_anomalies import against_the_clip, with_anomalies, with_repeated_points
from hypose.pipeline.moved_sensors import PlacedSource, Places, moved_sensors
from hypose.pipeline.one_camera import (
    against_the_picture,
    depth_note,
    doubt_of_depth,
    image_deviation,
    subject_in_picture,
    tracked_frames,
)
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.subject_from_motion import height_sentence, measured_height
from hypose.pipeline.trace import Change, list_changes, with_trace
from hypose.pipeline.track_loop import Followed, FrameList, FrameSource, StageProgress, TrackingSession
from hypose.pipeline.track_options import TrackOptions
from hypose.tracking.arm_hypotheses import SEARCH_ROLES
from hypose.tracking.covariance_calibration import (
    beyond_usual,
    pose_covariance,
    systematic_covariance,
    with_fitted_angles,
    with_fitted_joints,
)
from hypose.tracking.error_model import as_mixture, evidence_of, judged, needs_review, not_in_set
from hypose.tracking.joint_features import audit_frame
from hypose.tracking.keypoint_clip import track_keypoint_clip
from hypose.tracking.keypoint_evidence import keypoint_model
from hypose.tracking.pose_covariance import unpacked
from hypose.tracking.recipes import recipe
from hypose.tracking.several import Member
from hypose.tracking.smoothing import Clip, Smoothed
from hypose.tracking.tracker import (
    RECOVERED,
    FrameEstimate,
    Tracker,
    TrackerSettings,
    TrackerState,
    modes_of,
    motion_of,
)

MODES = "modes.npz"
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Tracked:
    """Result of tracking frame by frame.

    estimates: of the frames that are done.
    state: state of the tracker after the last of them.
    complete: every frame was tracked.
    """

    estimates: list[FrameEstimate]
    state: TrackerState
    complete: bool = True


@dataclass(frozen=True)
class ClipState:
    """State of one person's clip between two passes.

    source: frames of the clip.
    frame_rate: Hz.
    options: options of the run, as the user chose them.
    body: the subject's own body; None: a body is fitted.
    method: recipe that replaces the recipe of the options.
    own: evidence in addition to that of the frames.
    results: folder for results and checkpoints; None: nothing is written.
    record: provenance of the motion.
    resume: continue from a checkpoint.
    find_places: look for depth cameras that stand elsewhere than the source says.
    shared_masks: the masks also show other people.
    progress: called with stage, done, total.
    subject, tracker: None before `find_person`.
    given: the caller gave the subject and its start pose.
    tracked: estimates of the frames; None before `track_clip`, and where all frames are solved together instead.
    motion: None before `to_motion`, or before `track_clip` where all frames are solved together.
    one_by_one: (T, D) poses as each frame was tracked, before smoothing.
    audit: (T, J, A) features of the error model.
    covariance: (T, D, D) covariances of the poses.
    modes: alternative poses that one camera allows.
    notes: sentences for the user.
    findings: reasons to distrust or review the motion, and remarks.
    places: corrected places of depth cameras.
    trace: changes that the passes made so far.
    """

    source: FrameSource
    frame_rate: float
    options: TrackOptions
    body: Body | None = None
    method: Recipe | None = None
    own: Sequence[OwnEvidence] = ()
    results: ResultsFolder | None = None
    record: Mapping[str, Any] = field(default_factory=dict)
    resume: bool = False
    find_places: bool = True
    shared_masks: bool = False
    progress: StageProgress = lambda stage, done, total: None
    subject: TrackedSubject | None = None
    tracker: Tracker | None = None
    given: bool = False
    tracked: Tracked | None = None
    motion: Motion | None = None
    one_by_one: Array | None = None
    audit: NDArray[np.float32] | None = None
    covariance: Array | None = None
    modes: Modes | None = None
    notes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    places: tuple[Places, ...] = ()
    trace: tuple[Change, ...] = ()

    @property
    def who(self) -> TrackedSubject:
        """The subject; only after `find_person` has run."""
        assert self.subject is not None
        return self.subject

    @property
    def with_tracker(self) -> Tracker:
        """The tracker; only after `find_person` has run."""
        assert self.tracker is not None
        return self.tracker

    @property
    def complete(self) -> bool:
        """Whether every frame was tracked."""
        return self.tracked is None or self.tracked.complete

    @property
    def smooths(self) -> bool:
        """Whether all frames are solved together after tracking."""
        return self.options.smooth and self.with_tracker.recipe.smooth is not None and self.complete

    @property
    def joints(self) -> Array | None:
        """(T, J, 3) m: the current joint positions; None before tracking."""
        if self.motion is not None:
            return self.motion.joints
        if self.tracked is None or not self.tracked.estimates:
            return None
        return self.who.body.joints(np.stack([e.pose for e in self.tracked.estimates]))

    def frames(self, numbers: range) -> Iterator[Frame]:
        """Read the frames with these numbers once more, forwards or backwards."""
        return tracked_frames(self.source, numbers, self.with_tracker.recipe.needs, self.who)

    def with_findings(self, *found: Finding) -> ClipState:
        """Return the clip with more findings."""
        return replace(self, findings=(*self.findings, *found))


Pass = Callable[[ClipState], ClipState]


def run_pass(step: Pass, clip: ClipState) -> ClipState:
    """Run one pass, and record in the trace which joints it moved.

    Only passes that have a row in `REASONS` move joints; nothing is recorded for the others.
    """
    reason, begin = REASONS.get(step.__name__), time.perf_counter()
    before = None if reason is None else clip.joints
    after = step(clip)
    now = None if reason is None else after.joints
    if reason is not None and before is not None and now is not None and len(before) == len(now):
        names, moved = after.who.body.skeleton.joint_names, np.linalg.norm(now - before, axis=-1)
        after = replace(after, trace=(*after.trace, *list_changes(step.__name__, names, moved, reason)))
    _LOG.debug("%s: %.2f s", step.__name__, time.perf_counter() - begin)
    for change in after.trace[len(clip.trace) :]:
        _LOG.debug("%s moved %s by %.3f m in frames %s", change.stage, change.joint, change.moved, change.frames)
    for finding in after.findings[len(clip.findings) :]:
        _LOG.debug("%s found %s: %s", step.__name__, finding.kind, finding.text)
    return after


# ---- before tracking ---------------------------------------------------------------------------------------


def check_evidence(clip: ClipState) -> ClipState:
    """Check masks, key points and cameras against each other before tracking, and add the findings."""
    options = clip.options
    clip.progress("look", 0, 1)
    found = ()
    if not options.of_picture:
        found = input_checks.check_inputs(clip.source, options.looks_at, options.height, clip.frame_rate)
    # wrong cameras can make one person look like two
    more = 0 if input_checks.places_refuted(found) else getattr(clip.source, "others", 0)
    others = (other_people_note(more, "key points", "--people all"),) if more else ()
    clip.progress("look", 1, 1)
    return clip.with_findings(*found, *others)


def find_person(clip: ClipState) -> ClipState:
    """Find the person's body and start pose, unless the caller gave them, and build the tracker.

    Raises: HyposeError where no person is found; where the checks found faults, the message names them as a possible
        cause.
    """
    if clip.subject is None:
        try:
            clip = replace(clip, subject=_subject(clip, clip.results if clip.resume else None))
        except HyposeError as error:
            masks = clip.options.looks_at == "silhouettes" and isinstance(error, EvidenceError)
            guessed = getattr(clip.source, "guessed_rooms", "") if masks else ""
            why = [
                *([guessed] if guessed else []),
                *input_checks.sentences(clip.findings),
            ]  # wrong cameras may also be why the masks show no person
            if not why:
                raise
            raise type(error)(f"{' '.join(why)} That may be why: {error}") from error
    if clip.results is not None:  # before the motion, so that the result of an interrupted run can be viewed
        keep_subject(clip.who, clip.results, provenance_identity(clip.record))
    return replace(clip, notes=(*clip.notes, *clip.who.notes), tracker=_tracker(clip))


def _subject(clip: ClipState, results: ResultsFolder | None) -> TrackedSubject:
    """Load the subject that an interrupted run saved in `results`, or find it in the frames."""
    o, body = clip.options, clip.body
    clip.progress("subject", 0, 1)
    subject = None if results is None else kept_subject(results, provenance_identity(clip.record))
    if subject is None and o.of_picture:
        about = {"start": o.start, "evidence": o.looks_at, "body": body, "height": o.height}
        subject = subject_in_picture(clip.source, clip.frame_rate, **about, floor=o.own.get("floor"))
    if subject is None:
        wanted = SubjectOptions(o.start, o.height, o.girths, body, clip.frame_rate, o.seed, body is not None)
        subject = subject_in_frames(clip.source.frame, len(clip.source), wanted)
    clip.progress("subject", 1, 1)
    return subject


def _tracker(clip: ClipState) -> Tracker:
    return tracker_of(clip.who, clip.options, clip.frame_rate, clip.method, clip.own)


def tracker_of(
    subject: TrackedSubject,
    options: TrackOptions,
    frame_rate: float,
    method: Recipe | None = None,
    own: Sequence[OwnEvidence] = (),
) -> Tracker:
    """Build the tracker of a run.

    method: recipe that replaces the recipe of the options.
    own: evidence in addition to that of the frames.
    """
    about = {"frame_rate": frame_rate, "particles": options.particles, "refine": options.refine}
    made = method or recipe(options.recipe, subject.body, **about, **options.own)
    settings = TrackerSettings(evidence=options.looks_at, seed=options.seed, frame_rate=frame_rate)
    return Tracker(subject.body, made, settings, subject.keypoints, own)


# ---- tracking ----------------------------------------------------------------------------------------------


def track_clip(clip: ClipState) -> ClipState:
    """Track the frames one after the other; solve them together where the clip has key points only.

    Raises: HyposeError where a frame fails; the frames before it are written to the results folder first.
    """
    if clip.options.whole_clip and clip.method is None:
        return _solve_keypoints(clip)
    return _track(clip, None if clip.results is None else clip.results.checkpoint)


def _track(clip: ClipState, checkpoint: Path | None = None) -> ClipState:
    """Track frame by frame from the subject's start pose.

    checkpoint: file of the state, from which an interrupted run continues; None: nothing is written.
    """
    tracker, subject, source = clip.with_tracker, clip.who, clip.source
    begin = tracker.start(subject.start if subject.rivals is None else subject.rivals)
    one = Followed("", subject, Member(tracker, begin))
    about = {"identity": provenance_identity(clip.record), "every": clip.options.checkpoint_every}
    session = TrackingSession([one], True, clip.frame_rate, checkpoint, **about)
    if clip.resume and checkpoint is not None:
        session.load(checkpoint, lambda name: one)
    rest = range(session.done, len(source))
    last = source.frame(rest.start - 1) if rest and rest.start else None
    with contextlib.closing(look_ahead(tracked_frames(source, rest, tracker.recipe.needs, subject))) as frames:
        error = session.track(frames, last, len(source), clip.progress)
    clip = replace(
        clip, tracked=Tracked(one.estimates, one.member.state, session.done == len(source) and not session.stopped)
    )
    if error is not None and clip.results is not None:
        with contextlib.suppress(HyposeError):  # the first error is the one to report
            keep_motion(to_motion(clip))
        raise type(error)(
            f"{error} The {session.done} frames before are kept in {clip.results.path}; see --resume."
        ) from error
    return clip


def _solve_keypoints(clip: ClipState) -> ClipState:
    """Solve all frames of a clip of key points together."""
    subject, options = clip.who, clip.options
    solved, audit = track_keypoints(
        clip.source, clip.frame_rate, subject, clip.progress, clip.own, sure_start=options.sure_start
    )
    points = [clip.source.frame(i).keypoints for i in range(len(clip.source))]
    motion, doubts = with_repeated_points(replace(solved.motion, provenance=clip.record), points)
    never = [n for n, gone in zip(subject.body.skeleton.joint_names, not_in_set(audit), strict=True) if gone]
    apart = np.linalg.norm(motion.joints - subject.body.joints(solved.one_by_one), axis=-1)
    return replace(
        clip,
        motion=motion,
        one_by_one=solved.one_by_one,
        audit=audit,
        covariance=solved.covariance,
        notes=(*clip.notes, *solved.notes, *doubts),
        findings=(*clip.findings, *([not_shown(never)] if never else [])),
        trace=(*clip.trace, *list_changes("smooth", subject.body.skeleton.joint_names, apart, REASONS["smooth"])),
    )


def track_keypoints(
    source: FrameSource,
    frame_rate: float,
    subject: TrackedSubject,
    progress: StageProgress,
    own: Sequence[OwnEvidence] = (),
    *,
    sure_start: bool = False,
) -> tuple[Smoothed, NDArray[np.float32]]:
    """Solve the key points of all frames together (hypose.tracking.keypoint_clip); masks are not used.

    own: evidence in addition to that of the frames.
    sure_start: the start pose has left and right the right way round.
    Returns: the solved motion, and the features of the error model (T, J, A).
    Raises: EvidenceError where no frame has key points.
    """
    frames = [replace(source.frame(i), silhouettes=None) for i in range(len(source))]
    seen = [f.keypoints for f in frames]
    named = next((k.names for k in seen if k is not None), None)
    if named is None:
        raise EvidenceError("No frame carries key points; choose an evidence that the recording has.")
    model = subject.keypoints or keypoint_model(subject.body, named)
    solved = track_keypoint_clip(
        *(subject.body, model, seen, subject.start, frame_rate),
        progress=lambda done, all_: progress("track", done, all_),
        sure_start=sure_start,
        others=[[term for one in own if (term := one.rows(subject.body, f)) is not None] for f in frames],
    )
    assert solved.motion.poses is not None
    audits = [audit_frame(subject.body, q, f, model) for q, f in zip(solved.motion.poses, frames, strict=True)]
    return solved, np.stack(audits)


def place_sensors(clip: ClipState) -> ClipState:
    """Correct the places of depth cameras that stand elsewhere than the source says, and track all frames again."""
    done = clip.tracked
    if not clip.find_places or done is None or not done.complete or clip.options.of_picture:
        return clip
    poses, costs = np.stack([e.pose for e in done.estimates]), np.array([e.cost for e in done.estimates])
    places, moved = moved_sensors(clip.source, clip.who.body, poses, 1 - costs, clip.frame_rate)
    if not places:
        return clip
    clip = replace(clip, source=PlacedSource(clip.source, places), places=places, findings=(*clip.findings, *moved))
    if places[0].since == 0 and not clip.given:  # the body was fitted with wrong camera places
        clip = replace(clip, subject=_subject(clip, None))
        clip = replace(clip, notes=clip.who.notes, tracker=_tracker(clip))
    return _track(clip)


def check_height(clip: ClipState) -> ClipState:
    """Check whether the body's height is plausible, and compare a given height or body with the height that masks or
    depth show; add the findings.
    """
    subject, o = clip.who, clip.options
    if o.of_picture or clip.given or clip.tracked is None or subject.keypoints is not None:
        return clip
    estimates = clip.tracked.estimates
    if o.height is None and clip.body is None:
        clip = clip.with_findings(*input_checks.of_measured(subject.body.stature))
    asked = o.height if clip.body is None else clip.body.stature
    if asked is None or clip.method is not None or not clip.complete or o.looks_at == "keypoints":
        return clip
    poses, iou = np.stack([e.pose for e in estimates]), 1 - np.array([e.cost for e in estimates])
    reported = measured_height(clip.source.frame, subject.body, poses, iou)
    off = 0.0 if reported is None else abs(reported / asked - 1)
    if reported is None or off <= SETTINGS.subject_height_doubt:
        return clip
    severity = INVALID if off > SETTINGS.subject_height_wrong else REVIEW
    return clip.with_findings(Finding("height", (), height_sentence(reported, asked), size=off, severity=severity))


# ---- after tracking ----------------------------------------------------------------------------------------


def trace_searches(clip: ClipState) -> ClipState:
    """Record where a frame's search put joints elsewhere than the solve from the predicted pose."""
    estimates = () if clip.tracked is None else clip.tracked.estimates
    if not estimates or any(not len(e.moved) for e in estimates):
        return clip
    names, moved = clip.who.body.skeleton.joint_names, np.stack([e.moved for e in estimates]).astype(np.float64)
    origins = np.array([e.origin for e in estimates])
    found = [list_changes("track_clip", names, moved, why, origins == o) for o, why in SEARCHES.items()]
    return replace(clip, trace=(*clip.trace, *(change for each in found for change in each)))


def correct_sides(clip: ClipState) -> ClipState:
    """Find stretches in which left and right were exchanged or the body was lost, and track them again."""
    done = clip.tracked
    if done is None or not done.complete:
        return clip
    clip.progress("sides", 0, 1)
    estimates, exchanged = left_right.correct_left_right(
        clip.with_tracker,
        done.estimates,
        clip.frames,
        sure_start=clip.options.sure_start,
        memory=done.state.memory,
    )
    clip.progress("sides", 1, 1)
    notes = (*clip.notes, *left_right.left_right_notes(exchanged))
    return replace(clip, tracked=replace(done, estimates=estimates), notes=notes)


def correct_beginning(clip: ClipState) -> ClipState:
    """Track the first frames backwards from a frame in which the person was found, where the masks also show others."""
    done = clip.tracked
    if done is None or not done.complete or not clip.shared_masks or clip.options.sure_start:
        return clip
    estimates, retracked = left_right.retrack_start(
        clip.with_tracker, done.estimates, clip.frames, memory=done.state.memory
    )
    notes = (*clip.notes, *left_right.start_notes(retracked))
    return replace(clip, tracked=replace(done, estimates=estimates), notes=notes)


def track_backwards(clip: ClipState) -> ClipState:
    """Track arms backwards in time from the frames in which they jumped."""
    done = clip.tracked
    if done is None or not clip.smooths:
        return clip
    estimates, moved = backwards.backward_pass(
        clip.with_tracker,
        done.estimates,
        clip.frames,
        memory=done.state.memory,
        progress=partial(clip.progress, "both ways"),
    )
    clip.progress("both ways", len(estimates), len(estimates))
    notes = (*clip.notes, *backwards.backward_pass_notes(moved))
    return replace(clip, tracked=replace(done, estimates=estimates), notes=notes)


def to_motion(clip: ClipState) -> ClipState:
    """Make the motion from the estimates; time 0 is the first tracked frame."""
    done = clip.tracked
    if done is None:
        return clip
    times = np.arange(len(done.estimates)) / clip.frame_rate
    motion = motion_of(clip.who.body, times, done.estimates, clip.record)
    return replace(clip, motion=motion, modes=modes_of(done.estimates))


def smooth(clip: ClipState) -> ClipState:
    """Solve all frames together; feet that stand are held still on the floor."""
    done, motion, recipe = clip.tracked, clip.motion, clip.with_tracker.recipe
    if done is None or motion is None or recipe.smooth is None or not clip.smooths:
        return clip
    progress = partial(clip.progress, "smooth")
    motion, said = recipe.smooth(Clip(clip.with_tracker, motion, done.estimates, done.state, clip.frames, progress))
    return replace(clip, motion=motion, notes=(*clip.notes, *said))


def mark_anomalies(clip: ClipState) -> ClipState:
    """Mark frames of low confidence: pictures that repeat or jump, and views that disagree with the others."""
    if clip.tracked is None or clip.motion is None:
        return clip
    motion, said = with_anomalies(clip.motion, [e.seen for e in clip.tracked.estimates])
    depth = () if clip.modes is None else (depth_note(motion, clip.modes),)
    return replace(clip, motion=motion, notes=(*clip.notes, *said, *depth))


def judge_joints(clip: ClipState) -> ClipState:
    """Estimate the errors of the joints, and add findings on the clip as a whole.

    The motion gets the error probability and covariance of each joint, the sd of the angles, and its frames of low
    confidence; of one camera, whose uncertainty is in its modes, the frames of low confidence alone. Without a motion
    nothing is done.
    """
    if clip.motion is None:
        return clip
    if clip.modes is not None:
        return _assess_picture(clip)
    if clip.audit is None or clip.covariance is None or clip.one_by_one is None:
        assert clip.tracked is not None
        estimates = clip.tracked.estimates
        information = np.stack([e.uncertainty.information for e in estimates])
        clip = replace(
            clip,
            one_by_one=np.stack([e.pose for e in estimates]),
            audit=np.stack([e.audit for e in estimates]),
            covariance=pose_covariance(unpacked(information, clip.who.body.skeleton.dof)),
        )
        depth = clip.source.frame(0).depth is not None
        points = None if clip.options.looks_at == "silhouettes" else keypoints_in_memory(clip.source)
    else:
        depth, points = False, [clip.source.frame(i).keypoints for i in range(len(clip.source))]
    assert clip.audit is not None
    # of an interrupted run, the key points of its frames
    motion = _with_errors(clip, "depth" if depth else None, points and points[: len(clip.audit)])
    found = against_the_clip(clip.audit, motion.n_views, evidence_of(clip.audit))
    return replace(clip, motion=motion).with_findings(*found)


def _assess_picture(clip: ClipState) -> ClipState:
    """Judge the motion of one camera by its picture; the modes give the other possible poses."""
    motion = clip.motion
    assert motion is not None and motion.poses is not None and clip.modes is not None
    deviation = image_deviation(clip.who.body, motion.poses, clip.frames(range(len(motion))))
    low_confidence = deviation > SETTINGS.picture_deviation_frame
    before = motion.low_confidence
    motion = replace(motion, low_confidence=low_confidence if before is None else before | low_confidence)
    found = *against_the_picture(deviation), doubt_of_depth(clip.modes)
    return replace(clip, motion=motion).with_findings(*found)


def _with_errors(clip: ClipState, known: str | None, points: Sequence[Keypoints | None] | None) -> Motion:
    """Add to the motion the error probability of each joint, and standard deviations that also cover wrong joints.

    known: kind of evidence, where the audit does not show it.
    points: key points of the frames; None where they are not in memory.
    """
    motion, subject, audit, covariance = clip.motion, clip.who, clip.audit, clip.covariance
    assert motion is not None and audit is not None and covariance is not None and clip.one_by_one is not None
    evidence = known or evidence_of(audit)
    if points is not None and subject.keypoints is not None and any(k is not None for k in points):
        assert motion.poses is not None
        lasting = systematic_covariance(subject.body, subject.keypoints, points, motion.poses, motion.frame_rate)
        motion = replace(motion, systematic_covariance=lasting.astype(np.float32))
    # covariances follow from the curvature of the cost
    p, joints = judged(motion, subject.body.joints(clip.one_by_one), audit, subject.unsure, known)
    beyond = beyond_usual(audit, evidence)
    motion = with_fitted_angles(with_fitted_joints(motion, evidence, beyond), covariance, evidence, beyond)
    look = needs_review(p, joints, evidence)
    frames = look if motion.low_confidence is None else motion.low_confidence | look
    reported = replace(motion, error_probability=p, low_confidence_joints=joints, low_confidence=frames)
    return reported if evidence == "depth" else as_mixture(reported)  # regions from depth include other places


def keypoints_in_memory(source: FrameSource) -> Sequence[Keypoints | None] | None:
    """Return the key points of a source's frames; None where the source does not hold them in memory."""
    if isinstance(source, FrameStream):
        return source.keypoints
    return [f.keypoints for f in source.frames] if isinstance(source, FrameList) else None


def keep_motion(clip: ClipState) -> ClipState:
    """Put the trace into the motion, and write it where there is a results folder."""
    assert clip.motion is not None
    clip = replace(clip, motion=with_trace(clip.motion, clip.trace))
    if clip.results is not None and clip.motion is not None:
        save_motion(clip.motion, clip.results.motion)
        if clip.modes is not None:
            save_modes(clip.modes, clip.results.file(MODES))
    return clip


BEFORE_TRACKING: tuple[Pass, ...] = (check_evidence, find_person)
TRACKING: tuple[Pass, ...] = (track_clip, place_sensors, check_height)
AFTER_TRACKING: tuple[Pass, ...] = (
    trace_searches,
    correct_sides,
    correct_beginning,
    track_backwards,
    to_motion,
    smooth,
    mark_anomalies,
    judge_joints,
    keep_motion,
)
PASSES = (*BEFORE_TRACKING, *TRACKING, *AFTER_TRACKING)
"""All passes of a clip, in the order in which they run."""

REASONS = {
    "place_sensors": "depth cameras stood elsewhere than the recording says; all frames were tracked again",
    "correct_sides": "left and right were exchanged, or the body was lost: tracked again from a better pose",
    "correct_beginning": "tracked backwards to the beginning from where the person was found",
    "track_backwards": "an arm jumped: tracked backwards in time from behind the jump",
    "smooth": "solved together with the frames around it, feet held where they stand",
}
"""Reason why a pass moves joints, by the name of the pass; passes without a row move none."""

SEARCHES = {
    **dict(
        zip(
            SEARCH_ROLES,
            (
                "the limb search found the limb elsewhere than the solve from the predicted pose",
                "the table of arm poses found the arm elsewhere in the masks",
                "the arm was taken over from a rival hypothesis",
                "a rival hypothesis of the frames before became the best one",
            ),
            strict=True,
        )
    ),
    RECOVERED: "the body was lost, and found again by a search in the masks",
}
"""Reason why the search in a frame moved joints, by the origin of the best hypothesis."""
