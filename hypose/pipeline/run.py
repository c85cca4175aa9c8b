"""Tracks one recording: the passes of a run, with progress, checkpoints and resume."""

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
    """motion; the subject's body; complete: every frame was tracked; notes for the report; modes: the poses that each
    frame allows, where the recipe tells them. one_by_one (T, D): the poses as each frame was tracked, audit (T, J, A):
    what spoke for and against each joint (hypose.tracking.joint_features), None where that was not kept; faults:
    sentences on what was found wrong before tracking, or with the clip as a whole; looks: on what makes the whole clip
    worth a look; remarks: on who else is there; places: of depth cameras that stand elsewhere than the source says;
    unsure: of the `Subject`"""

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
        """Whether the motion is to be trusted, in words."""
        return assess(self.motion, self.findings)

    @staticmethod
    def of(clip: ClipState) -> TrackResult:
        """Make the result of a clip that has run through its passes."""
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

    body: the subject's own body, whose start alone is searched for (None: the human template, fitted)
    subject: known body and start, which skips both searches
    results: a checkpoint is written there every `checkpoint_every` frames (later every twentieth of the frames so far),
        and motion.npz at the end or when interrupted
    record: the provenance; its identity must match for `resume`
    method: recipe of the caller's own instead of the options'
    own: evidence in addition to that of the frames
    find_places: depth cameras that turn out to stand elsewhere than the source says are put right
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
    """Run passes one after the other; an interruption after the first tracked frame keeps what was tracked."""
    try:
        for step in passes:
            clip = run_pass(step, clip)
    except KeyboardInterrupt:
        if clip.tracked is None:
            raise
        tracked = replace(clip.tracked, complete=False)
        clip = keep_motion(to_motion(replace(clip, tracked=tracked, findings=())))
    return TrackResult.of(clip)
