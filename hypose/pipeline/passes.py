"""Passes of a run over a clip, from its frames to motions that have been judged.

`UNTIL_TRACKED` and `AFTER_TRACKING` list them in the order in which they run; `hypose.pipeline.track` adds those that
check the cameras of a recording, and replaces some where there is only one camera. Each pass takes the clip
(`ClipState`) as the pass before left it and returns a changed copy. The passes up to tracking handle one or more people
together; then `clips_of_people` makes a clip of each person, through which the passes `AFTER_TRACKING` run. `run_pass`
records in the clip's trace which joints a pass moved, by how much and why.
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
from hypose.calibration.findings import Finding
from hypose.errors import EvidenceError, HyposeError
from hypose.evidence.cues import OwnEvidence
from hypose.evidence.frame import Frame, Keypoints
from hypose.evidence.prefetch import look_ahead
from hypose.geometry import Array, runs
from hypose.inference.layer import Memory, Recipe
from hypose.io.motions.results import provenance_identity, save_body, save_modes, save_motion
from hypose.pipeline.assessment import Change, list_changes, not_shown, sentences, with_trace
from hypose.pipeline.frame_anomalies import against_the_clip, in_words, with_anomalies, with_repeated_points
from hypose.pipeline.people import PeopleFinder
from hypose.pipeline.retracking import backward_pass, correct_left_right, retrack_start
from hypose.pipeline.sources import FrameSource, Places, tracked_frames
from hypose.pipeline.subject import SubjectOptions, TrackedSubject, find_subject
from hypose.pipeline.track_loop import PeopleManager, StageProgress, TrackedPerson, TrackingSession, tracker_of
from hypose.pipeline.track_options import TrackOptions
from hypose.tracking.arm_hypotheses import SEARCH_ROLES
from hypose.tracking.covariance_calibration import (
    angle_variance,
    beyond_usual,
    pose_covariance,
    systematic_covariance,
    with_angle_variance,
    with_fitted_joints,
)
from hypose.tracking.error_model import (
    as_mixture,
    evidence_of,
    judged,
    needs_review,
    not_in_set,
)
from hypose.tracking.frame_evidence import keypoint_model
from hypose.tracking.joint_features import audit_frame
from hypose.tracking.keypoint_clip import track_keypoint_clip
from hypose.tracking.refinement import unpacked
from hypose.tracking.smoothing import Clip
from hypose.tracking.tracker import (
    RECOVERED,
    FrameEstimate,
    Tracker,
    modes_of,
    motion_of,
)

MODES = "modes.npz"
_LOG = logging.getLogger(__name__)


def find_alone(clip: ClipState) -> TrackedSubject:
    """Find the body and start pose of the one person of a clip from masks and key points of several cameras."""
    o = clip.options
    wanted = SubjectOptions(o.start, o.height, None, o.girths, clip.body, clip.frame_rate, o.seed)
    return find_subject(clip.source.frame, len(clip.source), wanted)


@dataclass(frozen=True)
class ClipState:
    """State of a clip between two passes.

    source: frames of the clip.
    frame_rate: Hz.
    options: options of the run, as the user chose them.
    body: the subject's own body; None: a body is fitted.
    method: recipe that replaces the recipe of the options.
    own: evidence in addition to that of the frames.
    results: folder for results and checkpoints; None: nothing is written.
    folders: each person has a folder of their own in `results`.
    record: provenance of the motion.
    resume: continue from a checkpoint.
    find: finds body and start pose where the clip is of one person.
    finder: finds several people; None: the clip is of one person.
    shared_masks: the masks also show other people.
    progress: called with stage, done, total.
    people: state of each person after the frames that are tracked; empty before `find_people`. In the passes
        `AFTER_TRACKING` the clip is of one person.
    given: whether the caller gave the subject and its start pose, so that no search is needed.
    candidates: possible people who are not tracked at the end, see `TrackingSession`.
    complete: every frame was tracked.
    error: what ended tracking after some frames.
    motion: None before `to_motion` or `solve_keypoints`.
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
    results: Path | None = None
    folders: bool = False
    record: Mapping[str, Any] = field(default_factory=dict)
    resume: bool = False
    find: Callable[[ClipState], TrackedSubject] = find_alone
    finder: PeopleFinder | None = None
    shared_masks: bool = False
    progress: StageProgress = lambda stage, done, total: None
    people: tuple[TrackedPerson, ...] = ()
    given: bool = False
    candidates: Sequence[Array] = ()
    complete: bool = True
    error: HyposeError | None = None
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
    def person(self) -> TrackedPerson:
        """State of the one person, or of the first of several; only after `find_people` has run."""
        return self.people[0]

    @property
    def who(self) -> TrackedSubject:
        """Body and start pose of the person, or of the first of several; only after `find_people` has run."""
        return self.person.subject

    @property
    def tracker(self) -> Tracker:
        """The tracker; only after `find_people` has run."""
        return self.person.member.tracker

    @property
    def estimates(self) -> Sequence[FrameEstimate]:
        """Estimates of the frames; empty before `track_clip`, and where all frames are solved together instead."""
        return self.people[0].estimates if self.people else ()

    @property
    def memory(self) -> Memory:
        """Arrays by name that the recipe has learned about the person."""
        return self.person.member.state.memory

    @property
    def smooths(self) -> bool:
        """Whether all frames are solved together after tracking."""
        return self.options.smooth and self.tracker.recipe.smooth is not None and self.complete

    @property
    def joints(self) -> Array | None:
        """Joint positions (T, J, 3), m, world, after the passes that have run; None before tracking."""
        if self.motion is not None:
            return self.motion.joints
        if not self.estimates:
            return None
        return self.who.body.joints(np.stack([e.pose for e in self.estimates]))

    def tracker_for(self, subject: TrackedSubject) -> Tracker:
        """Build the tracker of a person of the clip."""
        return tracker_of(subject, self.options, self.frame_rate, self.method, self.own)

    def at_start(self, subject: TrackedSubject) -> TrackedPerson:
        """Make the state before the first frame of the one person of the clip."""
        return TrackedPerson.at_start("", subject, self.tracker_for(subject))

    def frames(self, numbers: range) -> Iterator[Frame]:
        """Read the frames with these numbers once more, forwards or backwards."""
        return tracked_frames(self.source, numbers, self.tracker.recipe.needs, self.who.body, self.who.start)

    def with_estimates(self, estimates: Sequence[FrameEstimate], notes: Sequence[str]) -> ClipState:
        """Return the clip with other estimates of its one person, and more notes."""
        person = replace(self.person, estimates=list(estimates))
        return replace(self, people=(person,), notes=(*self.notes, *notes))

    def with_findings(self, *found: Finding) -> ClipState:
        """Return the clip with more findings."""
        return replace(self, findings=(*self.findings, *found))


Pass = Callable[[ClipState], ClipState]


def run_pass(step: Pass, clip: ClipState) -> ClipState:
    """Run one pass (a step of the run over the whole clip), and record in the trace which joints it moved.

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


def find_people(clip: ClipState) -> ClipState:
    """Find body and start pose of each person, unless the caller gave them or an interrupted run kept them.

    Raises: HyposeError where no person is found; where the checks found faults, the message names them as a possible
        cause.
    """
    session = session_of(clip)
    if clip.resume and session.checkpoint is not None and session.checkpoint.exists():
        session.load(session.checkpoint, clip.tracker_for)
    else:
        clip.progress("subject", 0, 1)
        session.people = list(clip.people or _found(clip))
        clip.progress("subject", 1, 1)
        if session.checkpoint is not None:  # what was found is kept before the first frame
            session.save(session.checkpoint)
    clip = replace(clip, people=tuple(session.people), candidates=session.candidates)
    if clip.results is not None and not clip.folders:
        save_body(clip.who.body, clip.results / "body.npz")  # an interrupted run can be viewed
    return replace(clip, notes=(*clip.notes, *clip.who.notes))


def session_of(clip: ClipState, checkpoint: bool = True) -> TrackingSession:
    """Make the session that tracks the people of a clip from where they are.

    checkpoint: keep the state in the results folder.
    """
    path = clip.results / "checkpoint.npz" if checkpoint and clip.results is not None else None
    return TrackingSession(
        list(clip.people),
        clip.frame_rate,
        clip.finder or PeopleManager(),
        path,
        provenance_identity(clip.record),
        clip.options.checkpoint_every,
        clip.progress,
        list(clip.candidates),
    )


def _found(clip: ClipState) -> tuple[TrackedPerson, ...]:
    """Find the people of a clip at its beginning."""
    try:
        if clip.finder is not None:
            return tuple(clip.finder.begin())
        return (clip.at_start(clip.find(clip)),)
    except HyposeError as error:
        masks = clip.options.looks_at == "silhouettes" and isinstance(error, EvidenceError)
        guessed = getattr(clip.source, "guessed_rooms", "") if masks else ""
        # wrong cameras may also be why the masks show no person
        why = [*([guessed] if guessed else []), *sentences(clip.findings)]
        if not why:
            raise
        raise type(error)(f"{' '.join(why)} That may be why: {error}") from error


# ---- tracking ----------------------------------------------------------------------------------------------


def track_clip(clip: ClipState, checkpoint: bool = True) -> ClipState:
    """Track the frames that are not tracked yet, one after the other.

    checkpoint: keep the state in the results folder.
    Where a frame fails, `ClipState.error` says why, and the frames before it are kept; without a results folder the
    error is raised.
    """
    session = session_of(clip, checkpoint)
    source, rest = clip.source, range(session.done, len(clip.source))
    last = source.frame(rest.start - 1) if rest and rest.start else None
    if clip.finder is None:
        frames = look_ahead(tracked_frames(source, rest, clip.tracker.recipe.needs, clip.who.body, clip.who.start))
    else:
        frames = (source.frame(t) for t in rest)
    with contextlib.closing(frames):
        error = session.track(frames, last, len(source))
    complete = session.done == len(source) and not session.stopped
    return replace(clip, people=tuple(session.people), candidates=session.candidates, complete=complete, error=error)


def solve_keypoints(clip: ClipState) -> ClipState:
    """Solve the key points of all frames together (hypose.tracking.keypoint_clip); masks are not used."""
    subject, names = clip.who, clip.who.body.skeleton.joint_names
    frames = [replace(clip.source.frame(i), silhouettes=None) for i in range(len(clip.source))]
    points = [f.keypoints for f in frames]
    named = next((k.names for k in points if k is not None), None)
    if named is None:
        raise EvidenceError("No frame carries key points; choose an evidence that the recording has.")
    model = subject.keypoints or keypoint_model(subject.body, named)
    solved = track_keypoint_clip(
        *(subject.body, model, points, subject.start, clip.frame_rate),
        progress=partial(clip.progress, "track"),
        sure_start=clip.options.sure_start,
        others=[[term for one in clip.own if (term := one.rows(subject.body, f)) is not None] for f in frames],
    )
    assert solved.motion.poses is not None
    audit = np.stack([audit_frame(subject.body, q, f, model) for q, f in zip(solved.motion.poses, frames, strict=True)])
    motion, doubts = with_repeated_points(replace(solved.motion, provenance=clip.record), points)
    never = [n for n, gone in zip(names, not_in_set(audit), strict=True) if gone]
    apart = np.linalg.norm(motion.joints - subject.body.joints(solved.one_by_one), axis=-1)
    return replace(
        clip,
        motion=motion,
        one_by_one=solved.one_by_one,
        audit=audit,
        covariance=solved.covariance,
        notes=(*clip.notes, *solved.notes, *doubts),
        findings=(*clip.findings, *([not_shown(never)] if never else [])),
        trace=(*clip.trace, *list_changes("smooth", names, apart, REASONS["smooth"])),
    )


# ---- after tracking ----------------------------------------------------------------------------------------


def clips_of_people(clip: ClipState) -> list[ClipState]:
    """Split a clip of several people into one clip per person whose result is wanted; in its frames, the pixels that
    other people cover are ignored.
    """
    if clip.finder is None:
        return [clip]
    out = list[ClipState]()
    for p in clip.finder.asked_for(clip.people):
        frames, own = clip.finder.own_clip(p, clip.people)
        shared, results = len(clip.people) > 1 and p.present[0], clip.results
        if results is not None and clip.folders:
            results = results / p.name
        about = {"source": frames, "people": (own,), "finder": None, "results": results, "notes": p.subject.notes}
        out.append(replace(clip, **about, shared_masks=shared))
    return out


def trace_searches(clip: ClipState) -> ClipState:
    """Record in the trace the frames in which the search moved joints away from the solution that starts at the
    predicted pose.
    """
    estimates = clip.estimates
    if not estimates or any(not len(e.moved) for e in estimates):
        return clip
    names, moved = clip.who.body.skeleton.joint_names, np.stack([e.moved for e in estimates]).astype(np.float64)
    origins = np.array([e.origin for e in estimates])
    found = [list_changes("track_clip", names, moved, why, origins == o) for o, why in SEARCHES.items()]
    return replace(clip, trace=(*clip.trace, *(change for each in found for change in each)))


def correct_sides(clip: ClipState) -> ClipState:
    """Find stretches in which left and right were exchanged or the body was lost, and track them again."""
    if not clip.complete:
        return clip
    clip.progress("sides", 0, 1)
    sure = clip.options.sure_start
    estimates, exchanged = correct_left_right(
        clip.tracker, clip.estimates, clip.frames, sure_start=sure, memory=clip.memory
    )
    clip.progress("sides", 1, 1)
    text = f"left and right had been exchanged in {in_words(exchanged)}, or the body lost; tracked again the right way"
    return clip.with_estimates(estimates, [text] if exchanged else [])


def correct_beginning(clip: ClipState) -> ClipState:
    """Track the first frames backwards from a frame in which the person was found, where the masks also show others."""
    if not clip.complete or not clip.shared_masks or clip.options.sure_start:
        return clip
    estimates, retracked = retrack_start(clip.tracker, clip.estimates, clip.frames, memory=clip.memory)
    text = f"the start was wrong in {in_words([retracked])}; tracked again backwards"
    return clip.with_estimates(estimates, [text] if retracked else [])


def track_backwards(clip: ClipState) -> ClipState:
    """Track arms backwards in time from the frames in which they jumped."""
    if not clip.smooths:
        return clip
    progress = partial(clip.progress, "both ways")
    estimates, moved = backward_pass(clip.tracker, clip.estimates, clip.frames, memory=clip.memory, progress=progress)
    progress(len(estimates), len(estimates))
    text = f"arms were found elsewhere in {moved} frames by tracking backwards"
    return clip.with_estimates(estimates, [text] if moved else [])


def to_motion(clip: ClipState) -> ClipState:
    """Make the motion from the estimates; time 0 is the first tracked frame."""
    estimates = clip.estimates
    times = np.arange(len(estimates)) / clip.frame_rate
    return replace(clip, motion=motion_of(clip.who.body, times, estimates, clip.record), modes=modes_of(estimates))


def smooth(clip: ClipState) -> ClipState:
    """Solve all frames together; feet that stand are held still on the floor."""
    motion, smoother = clip.motion, clip.tracker.recipe.smooth
    if motion is None or smoother is None or not clip.smooths:
        return clip
    progress, state = partial(clip.progress, "smooth"), clip.person.member.state
    motion, said = smoother(Clip(clip.tracker, motion, clip.estimates, state, clip.frames, progress))
    return replace(clip, motion=motion, notes=(*clip.notes, *said))


def mark_anomalies(clip: ClipState) -> ClipState:
    """Mark frames of low confidence: pictures that repeat or jump, and views that disagree with the others."""
    assert clip.motion is not None
    motion, said = with_anomalies(clip.motion, [e.seen for e in clip.estimates])
    return replace(clip, motion=motion, notes=(*clip.notes, *said))


def judge_joints(clip: ClipState) -> ClipState:
    """Estimate the errors of the joints, and add findings on the clip as a whole.

    The motion gets the error probability and covariance of each joint, the sd of the angles, and its frames of low
    confidence.
    """
    if clip.audit is None or clip.covariance is None or clip.one_by_one is None:
        estimates = clip.estimates
        information = np.stack([e.uncertainty.information for e in estimates])
        clip = replace(
            clip,
            one_by_one=np.stack([e.pose for e in estimates]),
            audit=np.stack([e.audit for e in estimates]),
            covariance=pose_covariance(unpacked(information, clip.who.body.skeleton.dof)),
        )
        depth = clip.source.frame(0).kind == "depth"
        silhouettes = clip.options.looks_at == "silhouettes"
        points = () if silhouettes else getattr(clip.source, "keypoints", ())  # where they are in memory
    else:
        depth, points = False, [clip.source.frame(i).keypoints for i in range(len(clip.source))]
    assert clip.motion is not None and clip.audit is not None
    # of an interrupted run, the key points of its frames
    motion = _with_errors(clip, "depth" if depth else None, points[: len(clip.audit)])
    found = against_the_clip(clip.audit, motion.n_views, evidence_of(clip.audit))
    return replace(clip, motion=motion).with_findings(*found)


def _with_errors(clip: ClipState, known: str | None, points: Sequence[Keypoints | None]) -> Motion:
    """Add to the motion the error probability of each joint, and standard deviations that also cover wrong joints.

    known: kind of evidence, where the audit does not show it.
    points: key points of the frames; empty where they are not in memory.
    """
    motion, subject, audit, covariance = clip.motion, clip.who, clip.audit, clip.covariance
    assert motion is not None and audit is not None and covariance is not None and clip.one_by_one is not None
    assert motion.poses is not None
    evidence, variance = known or evidence_of(audit), angle_variance(motion.skeleton, motion.poses, covariance)
    if subject.keypoints is not None and any(k is not None for k in points):
        weighed = subject.keypoints if evidence == "both" else replace(subject.keypoints, cue_weight=None)
        lasting = systematic_covariance(subject.body, weighed, points, motion.poses, motion.frame_rate)
        motion = replace(motion, systematic_covariance=lasting.astype(np.float32))
    # covariances follow from the curvature of the cost
    p, joints = judged(motion, subject.body.joints(clip.one_by_one), audit, subject.unsure, known)
    beyond = beyond_usual(audit, evidence)
    motion = with_angle_variance(with_fitted_joints(motion, evidence, beyond), variance, evidence, beyond)
    look = needs_review(p, joints, evidence)
    frames = look if motion.low_confidence is None else motion.low_confidence | look
    reported = replace(motion, error_probability=p, low_confidence_joints=joints, low_confidence=frames)
    return reported if evidence == "depth" else as_mixture(reported)  # regions from depth include other places


def mark_absence(clip: ClipState) -> ClipState:
    """Mark the frames in which the person is absent as lost, and the frames in which others hide the person as
    frames of low confidence.
    """
    motion, notes = clip.motion, [*clip.notes, *clip.person.said]
    assert motion is not None
    present, hidden = (np.array(x, dtype=np.bool_) for x in (clip.person.present, clip.person.hidden))
    motion = replace(motion, lost=motion.lost | ~present)
    if hidden.any():
        low_confidence = hidden if motion.low_confidence is None else motion.low_confidence | hidden
        motion = replace(motion, low_confidence=low_confidence)
        notes.append(f"others hide this person from all views but one in {in_words(runs(hidden))}")
    if not present.all():
        notes.append(f"not there in {in_words(runs(~present))}")
    return replace(clip, motion=motion, notes=tuple(notes))


def keep_motion(clip: ClipState) -> ClipState:
    """Put the trace into the motion, and write it where there is a results folder."""
    assert clip.motion is not None
    motion = with_trace(clip.motion, clip.trace)
    if clip.results is not None:
        save_motion(motion, clip.results / "motion.npz")
        if clip.modes is not None:
            save_modes(clip.modes, clip.results / MODES)
    return replace(clip, motion=motion)


def keep_interrupted(clip: ClipState) -> ClipState:
    """Make the motion of an interrupted clip from the frames that were tracked, and write it."""
    return keep_motion(mark_absence(to_motion(replace(clip, complete=False, findings=()))))


UNTIL_TRACKED: tuple[Pass, ...] = (find_people, track_clip)
"""Passes of one or more people together, without those that check and correct the cameras of a recording."""
AFTER_TRACKING: tuple[Pass, ...] = (
    trace_searches,
    correct_sides,
    correct_beginning,
    track_backwards,
    to_motion,
    smooth,
    mark_anomalies,
    judge_joints,
    mark_absence,
    keep_motion,
)
SOLVED_TOGETHER: tuple[Pass, ...] = (judge_joints, keep_motion)
"""Passes of one person after `solve_keypoints`."""
REASONS = {
    "place_sensors": "depth cameras stood elsewhere than the recording says; all frames were tracked again",
    "leave_out_masks": "the masks of one camera contradicted all others: tracked again without them",
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
