"""Tracks one recording: frames -> subject -> start -> tracker -> Motion, with progress, checkpoints and resume."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.motion import Modes, Motion
from hypose.errors import EvidenceError, HyposeError, InputError
from hypose.evidence.cues import OwnEvidence
from hypose.evidence.frame import Frame, Keypoints
from hypose.geometry import Array
from hypose.inference.layer import Recipe
from hypose.io.motions.results import ResultsFolder, provenance_identity, save_modes, save_motion
from hypose.io.recordings.frames import FrameSettings, FrameStream
from hypose.io.recordings.recording import Recording
from hypose.pipeline.assessment import Assessment, assess, not_shown, other_people_note
from hypose.pipeline.backward_pass import backward_pass, backward_pass_notes
from hypose.pipeline.first_frame import (
    SUBJECT,
    SubjectOptions,
    TrackedSubject,
    find_subject,
    keep_subject,
    kept_subject,
)
from hypose.pipeline.frame_anomalies import against_the_clip, with_anomalies, with_repeated_points
from hypose.pipeline.input_checks import check_inputs, of_measured, places_refuted, sentences
from hypose.pipeline.left_right import correct_left_right, left_right_notes, retrack_start, start_notes
from hypose.pipeline.moved_sensors import PlacedSource, Places, moved_sensors
from hypose.pipeline.one_camera import (
    against_the_picture,
    depth_note,
    doubt_of_depth,
    image_deviation,
    one_view,
    picture_options,
    subject_in_picture,
    tracked_frames,
)
from hypose.pipeline.options import TrackOptions
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.subject_from_motion import height_sentence, measured_height
from hypose.pipeline.track_loop import (
    FrameList,
    FrameSource,
    Keep,
    StageProgress,
    Tracked,
    track_frames,
    tracked_before,
)
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
from hypose.tracking.smooth_motion import Clip, Smoothed
from hypose.tracking.tracker import FrameEstimate, Tracker, TrackerSettings, modes_of, motion_of

MODES = "modes.npz"


def frames_wanted(recording: Recording, options: TrackOptions) -> FrameSettings | None:
    """How the frames of a recording are read for a run, None: as is usual; an InputError when a recipe that looks at
    the picture of one camera cannot have what it is to look at."""
    if options.of_picture:
        return picture_options(recording, options.start, options.looks_at)
    if options.looks_at == "keypoints":  # they need no image, so nothing is decoded
        return FrameSettings(silhouettes=None)
    if options.looks_at == "silhouettes" and "colours" in options.preset.likes and options.own.get("colours"):
        return FrameSettings(silhouettes=recording.silhouettes, colours=True)
    return None


def check_views(recording: Recording, of_picture: bool = False) -> None:
    """An InputError when nothing can be done with that number of cameras: two or more, or the picture of one."""
    if of_picture:
        view = one_view(recording, None).views[0]
        if view.depth is not None:
            raise InputError(f"{view.name} is a depth camera, and this recipe looks at pictures; leave --recipe out.")
    elif len(recording.views) == 1 and recording.views[0].depth is None:
        name = recording.views[0].name
        raise InputError(
            f"{recording.name} has one camera, {name}, and this needs two or more; track one with --recipe monocular "
            f"--camera {name}, or add the others as [[view]] in recording.toml."
        )


@dataclass(frozen=True)
class TrackResult:
    """motion; the subject's body; complete: every frame was tracked; notes for the report; modes: the poses that each
    frame allows, where the recipe tells them. one_by_one (T, D): the poses as each frame was tracked, audit (T, J, A):
    what spoke for and against each joint (hypose.tracking.joint_features), None where that was not kept; faults:
    sentences on what was found wrong before tracking, or with the clip as a whole; looks: on what makes the whole clip
    worth a look; remarks: on who else is there; places: of depth cameras that stand elsewhere than the source says;
    unsure: of the `Subject`."""

    motion: Motion
    body: Body
    complete: bool
    notes: tuple[str, ...]
    modes: Modes | None = None
    one_by_one: Array | None = None
    audit: NDArray[np.float32] | None = None
    faults: tuple[str, ...] = ()
    looks: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    places: tuple[Places, ...] = ()
    unsure: Array | None = None

    @property
    def assessment(self) -> Assessment:
        """Whether the motion is to be trusted, in words."""
        return replace(assess(self.motion, self.faults, self.looks), remarks=self.remarks)


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
    """Tracks the frames of a source.

    body: the subject's own, of which only the start is looked for (default: the human template, fitted); subject: a
    known subject and start, which skips both. method: a recipe of the caller's own instead of the options'; own:
    evidence in addition to that of the frames. find_places: depth cameras that turn out to stand elsewhere than the
    source says are put right, and everything is tracked again. With `results` a checkpoint is
    written every `checkpoint_every` frames (later every twentieth of the frames so far), and motion.npz at the end or
    when interrupted. `record` is the provenance; its identity must match for `resume`."""
    report = progress or (lambda stage, done, total: None)
    total = len(source)
    if total == 0:
        raise InputError("The recording has no frame to track; check the frame range and the videos.")
    key = provenance_identity(record or {})
    report("look", 0, 1)
    looked = () if options.of_picture else check_inputs(source, options.looks_at, options.height, frame_rate)
    faults, noticed = sentences(looked), sentences(looked, fault=False)
    more = 0 if places_refuted(looked) else getattr(source, "others", 0)  # of one person wrong cameras make two
    others = (other_people_note(more, "key points", "--people all"),) if more else ()
    report("look", 1, 1)
    given = subject is not None
    if subject is None:
        try:
            subject = subject_of(source, frame_rate, options, body, results if resume else None, key, report)
        except HyposeError as error:
            masks = options.looks_at == "silhouettes" and isinstance(error, EvidenceError)
            guessed = getattr(source, "guessed_rooms", "") if masks else ""
            why = [*([guessed] if guessed else []), *faults]  # masks of no person speak against cameras, too
            if not why:
                raise
            raise type(error)(f"{' '.join(why)} That may be why: {error}") from error
    keep = None
    if results is not None:  # before the motion, so that the kept part of an interrupted run can be looked at
        keep_subject(subject, results, key)
        keep = Keep(results.checkpoint, key, options.checkpoint_every)
    tracker = tracker_of(subject, options, frame_rate, method, own)
    if options.whole_clip and method is None:
        solved, audit = track_keypoints(source, frame_rate, subject, report, own, sure_start=options.sure_start)
        motion = replace(solved.motion, provenance=record or {})
        points = [source.frame(i).keypoints for i in range(total)]
        motion, doubts = with_repeated_points(motion, points)
        notes = (*subject.notes, *solved.notes, *doubts)
        motion = _doubted(motion, subject, solved.one_by_one, audit, solved.covariance, points=points)
        result = TrackResult(motion, subject.body, True, notes)
        wrong, looks = against_the_clip(audit, motion.n_views, evidence_of(audit))
        never = [n for n, gone in zip(subject.body.skeleton.joint_names, not_in_set(audit), strict=True) if gone]
        others = (*others, *([not_shown(never)] if never else []))
        said = {"faults": (*faults, *wrong), "looks": (*noticed, *looks), "remarks": others}
        return _written(replace(result, one_by_one=solved.one_by_one, audit=audit, **said), results)
    before = tracked_before(results.checkpoint, key) if resume and results is not None else None
    begin = tracker.start(subject.start if subject.rivals is None else subject.rivals)
    done = track_frames(source, tracker, begin, subject, keep=keep, before=before, progress=report)
    if done.error is not None and results is not None:
        with contextlib.suppress(HyposeError):  # the first error is the one to tell
            _written(_tracked(subject, done.estimates, frame_rate, record), results)
        raise type(done.error)(
            f"{done.error} The {len(done.estimates)} frames before are kept in {results.path}; see --resume."
        ) from done.error
    places: tuple[Places, ...] = ()
    try:
        if find_places and done.complete and not options.of_picture:
            poses, costs = np.stack([e.pose for e in done.estimates]), np.array([e.cost for e in done.estimates])
            places, moved = moved_sensors(source, subject.body, poses, 1 - costs, frame_rate)
            if places:
                source, noticed = PlacedSource(source, places), (*noticed, *moved)
                if places[0].since == 0 and not given:  # the body was found before cameras that stood elsewhere
                    subject = subject_of(source, frame_rate, options, body, None, key, report)
                tracker = tracker_of(subject, options, frame_rate, method, own)
                begin = tracker.start(subject.start if subject.rivals is None else subject.rivals)
                done = track_frames(source, tracker, begin, subject, progress=report)
        measured = not given and subject.keypoints is None and options.height is None and body is None
        if measured and not options.of_picture:
            of_height = of_measured(subject.body.stature)
            faults, noticed = (*faults, *sentences(of_height)), (*noticed, *sentences(of_height, fault=False))
        asked = options.height if body is None else body.stature
        if asked is not None and not given and subject.keypoints is None and method is None and done.complete:
            wrong, doubted = _of_height(source, subject, done, asked, options)
            faults, noticed = (*faults, *wrong), (*noticed, *doubted)
        found = finish(source, subject, tracker, done, options, results, record, report, faults, noticed)
        return replace(found, places=places, remarks=others)
    except KeyboardInterrupt:
        return _written(_tracked(subject, done.estimates, frame_rate, record), results)


def _of_height(
    source: FrameSource, subject: TrackedSubject, done: Tracked, asked: float, options: TrackOptions
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What makes a motion not to be trusted, or worth a look, when masks or depth tell another height than `asked`."""
    if options.of_picture or options.looks_at == "keypoints":
        return (), ()
    poses, iou = np.stack([e.pose for e in done.estimates]), 1 - np.array([e.cost for e in done.estimates])
    reported = measured_height(source.frame, subject.body, poses, iou)
    off = 0.0 if reported is None else abs(reported / asked - 1)
    if reported is None or off <= SETTINGS.subject_height_doubt:
        return (), ()
    sentence = (height_sentence(reported, asked),)
    return (sentence, ()) if off > SETTINGS.subject_height_wrong else ((), sentence)


def subject_of(
    source: FrameSource,
    frame_rate: float,
    options: TrackOptions,
    body: Body | None,
    results: ResultsFolder | None,
    key: Mapping[str, Any],
    progress: StageProgress,
) -> TrackedSubject:
    """The subject that the run of this identity (`key`) kept in `results`, or else found in the frames."""
    progress("subject", 0, 1)
    subject = None if results is None else kept_subject(results, key)
    if subject is None and options.of_picture:
        about = {"start": options.start, "evidence": options.looks_at, "body": body, "height": options.height}
        subject = subject_in_picture(source, frame_rate, **about, floor=options.own.get("floor"))
    if subject is None:
        known = body is not None
        wanted = SubjectOptions(options.start, options.height, options.girths, body, frame_rate, options.seed, known)
        subject = find_subject(source.frame, len(source), wanted)
    progress("subject", 1, 1)
    return subject


def finish(
    source: FrameSource,
    subject: TrackedSubject,
    tracker: Tracker,
    done: Tracked,
    options: TrackOptions,
    results: ResultsFolder | None,
    record: Mapping[str, Any] | None,
    progress: StageProgress,
    faults: tuple[str, ...] = (),
    noticed: tuple[str, ...] = (),
    shared: bool = False,
) -> TrackResult:
    """The motion of what was tracked, stretches with exchanged sides or lost arms corrected, smoothed, judged and
    written. faults, noticed: what the first look found; shared: others are in the masks, who make starts unsure."""
    estimates, notes, recipe = done.estimates, subject.notes, tracker.recipe

    def seen(frames: range) -> Iterator[Frame]:
        return tracked_frames(source, frames, recipe.needs, subject)

    if done.complete:
        progress("sides", 0, 1)
        estimates, exchanged = correct_left_right(
            tracker, estimates, seen, sure_start=options.sure_start, memory=done.state.memory
        )
        notes = (*notes, *left_right_notes(exchanged))
        if shared and not options.sure_start:
            estimates, retracked = retrack_start(tracker, estimates, seen, memory=done.state.memory)
            notes = (*notes, *start_notes(retracked))
        progress("sides", 1, 1)
        if options.smooth and recipe.smooth is not None:
            estimates, moved = backward_pass(
                tracker, estimates, seen, memory=done.state.memory, progress=partial(progress, "both ways")
            )
            notes = (*notes, *backward_pass_notes(moved))
            progress("both ways", len(estimates), len(estimates))
    tracked = _tracked(subject, estimates, tracker.settings.frame_rate, record)
    motion = tracked.motion
    if options.smooth and recipe.smooth is not None and done.complete:
        clip = Clip(tracker, motion, estimates, done.state, seen, partial(progress, "smooth"))
        motion, said = recipe.smooth(clip)
        notes = (*notes, *said)
    motion, doubts = with_anomalies(motion, [e.seen for e in estimates])
    notes = (*notes, *doubts, *tracked.notes[len(subject.notes) :])
    if tracked.modes is not None:  # one camera: its modes say what else may be
        assert motion.poses is not None
        deviation = image_deviation(subject.body, motion.poses, seen(range(len(motion))))
        low_confidence = deviation > SETTINGS.picture_deviation_frame
        motion = replace(
            motion,
            low_confidence=low_confidence if motion.low_confidence is None else motion.low_confidence | low_confidence,
        )
        said = (*faults, *against_the_picture(deviation)), (*noticed, doubt_of_depth(tracked.modes))
        out = replace(tracked, motion=motion, complete=done.complete, notes=notes, faults=said[0], looks=said[1])
        return _written(out, results)
    own, audit = np.stack([e.pose for e in estimates]), np.stack([e.audit for e in estimates])
    information = np.stack([e.uncertainty.information for e in estimates])
    covariance = pose_covariance(unpacked(information, subject.body.skeleton.dof))
    depth = source.frame(0).depth is not None
    points = None if options.looks_at == "silhouettes" else keypoints_in_memory(source)
    motion = _doubted(motion, subject, own, audit, covariance, "depth" if depth else None, points)
    wrong, looks = against_the_clip(audit, motion.n_views, evidence_of(audit))
    said = (*faults, *wrong), (*noticed, *looks)
    out = TrackResult(motion, subject.body, done.complete, notes, None, own, audit, *said, unsure=subject.unsure)
    return _written(out, results)


def _doubted(
    motion: Motion,
    subject: TrackedSubject,
    one_by_one: Array,
    audit: NDArray[np.float32],
    covariance: Array,
    known: str | None = None,
    points: Sequence[Keypoints | None] | None = None,
) -> Motion:
    """The motion with the probability that a joint is wrong, the joints that are doubtful for that, and standard
    deviations that hold, of doubtful joints too; covariance (T, D, D) of the poses; known: what the evidence was,
    where the audit does not tell; points: the key points of its frames, None where there are none in memory."""
    evidence = known or evidence_of(audit)
    if points is not None and subject.keypoints is not None and any(k is not None for k in points):
        assert motion.poses is not None
        lasting = systematic_covariance(subject.body, subject.keypoints, points, motion.poses, motion.frame_rate)
        motion = replace(motion, systematic_covariance=lasting.astype(np.float32))
    # by what the curvature says
    p, joints = judged(motion, subject.body.joints(one_by_one), audit, subject.unsure, known)
    beyond = beyond_usual(audit, evidence)
    motion = with_fitted_angles(with_fitted_joints(motion, evidence, beyond), covariance, evidence, beyond)
    look = needs_review(p, joints, evidence)
    frames = look if motion.low_confidence is None else motion.low_confidence | look
    reported = replace(motion, error_probability=p, low_confidence_joints=joints, low_confidence=frames)
    return reported if evidence == "depth" else as_mixture(reported)  # regions from depth include other places


def _written(result: TrackResult, results: ResultsFolder | None) -> TrackResult:
    """The result, its motion written; when it is complete nothing else of the run is left."""
    if results is not None:
        save_motion(result.motion, results.motion)
        if result.modes is not None:
            save_modes(result.modes, results.file(MODES))
        if result.complete:
            for left in (results.file(SUBJECT), results.checkpoint):
                left.unlink(missing_ok=True)
    return result


def _tracked(
    subject: TrackedSubject, estimates: Sequence[FrameEstimate], frame_rate: float, record: Mapping[str, Any] | None
) -> TrackResult:
    """What the finished frames give as they are, not complete; time 0 is the first tracked frame."""
    motion = motion_of(subject.body, np.arange(len(estimates)) / frame_rate, estimates, record or {})
    modes = modes_of(estimates)
    notes = subject.notes if modes is None else (*subject.notes, depth_note(motion, modes))
    return TrackResult(motion, subject.body, False, notes, modes)


def tracker_of(
    subject: TrackedSubject,
    options: TrackOptions,
    frame_rate: float,
    method: Recipe | None = None,
    own: Sequence[OwnEvidence] = (),
) -> Tracker:
    """The tracker of a run; method, own: as for `track_source`."""
    about = {"frame_rate": frame_rate, "particles": options.particles, "refine": options.refine}
    made = method or recipe(options.recipe, subject.body, **about, **options.own)
    settings = TrackerSettings(evidence=options.looks_at, seed=options.seed, frame_rate=frame_rate)
    return Tracker(subject.body, made, settings, subject.keypoints, own)


def track_keypoints(
    source: FrameSource,
    frame_rate: float,
    subject: TrackedSubject,
    progress: StageProgress,
    own: Sequence[OwnEvidence] = (),
    *,
    sure_start: bool = False,
) -> tuple[Smoothed, NDArray[np.float32]]:
    """The motion of the frames of a source (hypose.tracking.keypoint_clip), and their audits (T, J, A);
    sure_start: the start is the right way round. An EvidenceError when they have no key points."""
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


def keypoints_in_memory(source: FrameSource) -> Sequence[Keypoints | None] | None:
    """The key points of a source's frames, None of a source that does not hold them in memory."""
    if isinstance(source, FrameStream):
        return source.keypoints
    return [f.keypoints for f in source.frames] if isinstance(source, FrameList) else None
