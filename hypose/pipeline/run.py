"""Track one recording: run the passes on a clip, with progress, checkpoints and resume."""

from __future__ import annotations

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
from hypose.errors import InputError, extra
from hypose.evidence.cues import OwnEvidence
from hypose.geometry import Array
from hypose.inference.layer import Recipe
from hypose.io.files import read_json
from hypose.io.motions.results import ResultsFolder, load_result_body, save_body, save_motion
from hypose.pipeline.assessment import ASSESSMENT_FILE, Assessment, assess
from hypose.pipeline.first_frame import TrackedSubject, forget_run
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
    judged: assessment of a result that was loaded; None: it is made of motion and findings.
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

    @property
    def assessment(self) -> Assessment:
        """Assessment of the motion: good, to be reviewed, or not to be trusted, with reasons."""
        return self.judged or assess(self.motion, self.findings)

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
    if len(source) == 0:
        raise InputError("The recording has no frame to track; check the frame range and the videos.")
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
        subject=subject,
        given=subject is not None,
    )
    out = run_passes(clip, PASSES)
    if out.complete and results is not None:
        forget_run(results)
    return out


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
