"""Track one recording: run the passes on a clip, with progress, checkpoints and resume."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
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
from hypose.geometry import Array, runs
from hypose.io.motions.results import ResultsFolder, load_result_body, save_body, save_motion
from hypose.pipeline.assessment import ASSESSMENT_FILE, Assessment, assess, load_assessment
from hypose.pipeline.passes import (
    AFTER_TRACKING,
    UNTIL_TRACKED,
    ClipState,
    Pass,
    clips_of_people,
    keep_interrupted,
    run_pass,
)
from hypose.pipeline.sources import Places
from hypose.pipeline.track_management import (
    per_frame,
)


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
    def spans(self) -> list[list[int]]:
        """Rows [first, one after the last] of the motion in which the person is there."""
        return [[r.start, r.stop] for r in runs(self.there)]

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

        The assessment of one of several people also has the rows in which the person is there (`spans`).

        folder: is made where it does not exist.
        """
        results = ResultsFolder(Path(folder))
        save_motion(self.motion, results.motion)
        save_body(self.body, results.file("body.npz"))
        results.write_json("provenance.json", self.motion.provenance)
        there = {"there": self.spans} if self.name else {}
        results.write_json(ASSESSMENT_FILE, {**self.assessment.document(self.motion), **there})


@dataclass(frozen=True)
class PeopleResult:
    """Results of several people.

    people: in the order in which they were found.
    complete: all frames were tracked.
    notes: for the report.
    others: number of people in addition to those requested.
    findings: reasons to distrust the places of depth cameras.
    absent: sentence that the one person who was asked for by name is not among them; empty where there is none.
    """

    people: tuple[TrackResult, ...]
    complete: bool
    notes: tuple[str, ...] = ()
    others: int = 0
    findings: tuple[Finding, ...] = ()
    absent: str = ""


def load_tracked(folder: str | Path) -> TrackResult:
    """Load a result from its folder, as `hypose track` or `TrackResult.save` wrote it.

    Raises: InputError where files are missing or damaged.
    """
    motion, body = load_result_body(Path(folder))
    judged = load_assessment(Path(folder))
    if judged is None:
        path = Path(folder) / ASSESSMENT_FILE
        raise InputError(f"{path} is missing or is not an assessment of hypose; track the recording again.")
    return TrackResult(motion, body, True, (), judged=judged, findings=judged.findings)


def run_clip(
    clip: ClipState, together: Sequence[Pass] = UNTIL_TRACKED, alone: Sequence[Pass] = AFTER_TRACKING
) -> tuple[ClipState, list[TrackResult]]:
    """Run all passes: find and track the people of a clip together, then finish the clip of each.

    A KeyboardInterrupt after the first tracked frame keeps and writes what was tracked; before it, it is raised.
    together: passes of all people.
    alone: passes of each person, after tracking.
    Returns: the clip after tracking, and the results of the people who are asked for.
    Raises: InputError where the source has no frames; the error that ended tracking after some frames, when these have
        been written.
    """
    if len(clip.source) == 0:
        raise InputError("The recording has no frame to track; check the frame range and the videos.")
    try:
        for step in together:
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
        done.append(finish(replace(own, complete=own.complete and all(p.complete for p in done)), alone))
    if clip.error is not None and results is not None:
        kept = f"The {len(clip.estimates)} frames before are kept in {results.path}; see --resume."
        raise type(clip.error)(f"{clip.error} {kept}") from clip.error
    if results is not None and all(p.complete for p in done):
        results.checkpoint.unlink(missing_ok=True)
    return clip, done


def finish(clip: ClipState, alone: Sequence[Pass] = AFTER_TRACKING) -> TrackResult:
    """Correct, smooth, judge and write a clip of one person that has been tracked."""
    try:
        for step in alone:
            clip = run_pass(step, clip)
    except KeyboardInterrupt:
        if not clip.estimates:
            raise
        clip = keep_interrupted(clip)
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
