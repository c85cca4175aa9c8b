"""Track one recording: run the passes on a clip, with progress, checkpoints and resume."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.motion import Modes, Motion
from hypose.calibration.findings import Finding
from hypose.errors import InputError
from hypose.evidence.cues import OwnEvidence
from hypose.geometry import Array
from hypose.inference.layer import Recipe
from hypose.io.motions.results import ResultsFolder
from hypose.pipeline.assessment import Assessment, assess
from hypose.pipeline.first_frame import TrackedSubject
from hypose.pipeline.moved_sensors import Places
from hypose.pipeline.passes import AFTER_TRACKING, PASSES, ClipState, Pass, keep_motion, run_pass, to_motion
from hypose.pipeline.track_loop import FrameSource, StageProgress
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
    unsure: that of the subject (`TrackedSubject`).
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

    @property
    def assessment(self) -> Assessment:
        """Assessment of the motion: good, to be reviewed, or not to be trusted, with reasons."""
        return assess(self.motion, self.findings)

    @staticmethod
    def of(clip: ClipState) -> TrackResult:
        """Make the result of a clip whose passes have run."""
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
        )


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
    if len(source) == 0:
        raise InputError("The recording has no frame to track; check the frame range and the videos.")
    chosen = {"body": body, "method": method, "own": own, "find_places": find_places}
    kept = {"results": results, "record": record or {}, "resume": resume}
    report = progress or (lambda stage, done, total: None)
    given = subject is not None
    clip = ClipState(source, frame_rate, options, **chosen, **kept, progress=report, subject=subject, given=given)
    return run_passes(clip, PASSES)


def finish(clip: ClipState) -> TrackResult:
    """Correct, smooth, judge and write a clip that has been tracked."""
    return run_passes(clip, AFTER_TRACKING)


def run_passes(clip: ClipState, passes: Sequence[Pass]) -> TrackResult:
    """Run passes one after the other and make the result.

    A KeyboardInterrupt after the first tracked frame keeps and writes what was tracked; before it, it is raised.
    """
    try:
        for step in passes:
            clip = run_pass(step, clip)
    except KeyboardInterrupt:
        if clip.tracked is None:
            raise
        tracked = replace(clip.tracked, complete=False)
        clip = keep_motion(to_motion(replace(clip, tracked=tracked, findings=())))
    return TrackResult.of(clip)
