"""Assess a finished motion: good, some frames to be reviewed, or not to be trusted, with reasons.

A result also keeps the trace of its clip: which pass moved which joint in which frames, by how much and why.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing

from hypose.body.motion import Motion
from hypose.calibration.findings import INFO, INVALID, REVIEW, Finding
from hypose.errors import InputError
from hypose.geometry import Array, runs
from hypose.io.files import read_json
from hypose.pipeline.frame_anomalies import in_words
from hypose.pipeline.settings import SETTINGS
from hypose.tracking.error_model import AROUND_S, LOOK_P

# ---- trace ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Change:
    """Frames in which one pass moved one joint.

    stage: name of the pass.
    joint: name of the joint.
    frames: frames of the clip, counted from 0.
    moved: largest displacement in these frames, m.
    reason: why the pass moved it.
    """

    stage: str
    joint: str
    frames: range
    moved: float
    reason: str

    def document(self) -> dict[str, Any]:
        """Return the change as JSON values; lengths in millimetres."""
        frames = [self.frames.start, self.frames.stop]
        moved = round(1e3 * self.moved)
        return {"pass": self.stage, "joint": self.joint, "frames": frames, "moved_mm": moved, "reason": self.reason}


def list_changes(
    stage: str, names: Sequence[str], moved: Array, reason: str, at: NDArray[np.bool_] | None = None
) -> tuple[Change, ...]:
    """List the runs of frames in which a pass moved joints by more than SETTINGS.trace_least_m.

    stage: name of the pass.
    names: names of the J joints.
    moved: (T, J) displacements, m.
    reason: why the pass moved them.
    at: (T,) frames to consider; None: all.
    """
    large = np.asarray(moved) > SETTINGS.trace_least_m
    large = large if at is None else large & at[:, None]
    closed = np.asarray(binary_closing(np.pad(large, ((2, 2), (0, 0))), np.ones((3, 1))), dtype=bool)[2:-2]
    found = [(name, j, r) for j, name in enumerate(names) for r in runs(closed[:, j])]
    return tuple(Change(stage, name, r, float(moved[r.start : r.stop, j].max()), reason) for name, j, r in found)


def trace_of(motion: Motion) -> tuple[Change, ...]:
    """Read the trace from a motion's provenance; empty where none was recorded."""
    kept: Iterable[Mapping[str, Any]] = motion.provenance.get("trace", ())
    return tuple(
        Change(str(c["pass"]), str(c["joint"]), range(*c["frames"]), float(c["moved_mm"]) / 1e3, str(c["reason"]))
        for c in kept
    )


def with_trace(motion: Motion, trace: Iterable[Change]) -> Motion:
    """Return the motion with this trace in its provenance, in place of the trace before."""
    return replace(motion, provenance={**motion.provenance, "trace": [change.document() for change in trace]})


def later(trace: Iterable[Change], frames: int) -> tuple[Change, ...]:
    """Add `frames` to all frame numbers of a trace."""
    return tuple(replace(c, frames=range(c.frames.start + frames, c.frames.stop + frames)) for c in trace)


# ---- assessment -----------------------------------------------------------------------------------------------------


GOOD, LOOK, UNTRUSTED = "good", "look", "not to be trusted"
ASSESSMENT_FILE = "assessment.json"
EXIT_UNTRUSTED = 3
"""Exit code of a command whose result is not to be trusted."""
LIMB_S = 2 * AROUND_S
"""Least time (s) for which a limb must be doubtful to make a clip untrusted. Why: a joint is judged with neighbouring
frames, so a few bad frames make all of a shorter clip doubtful; these are only to be reviewed.
"""
_ALONE = ("neck", "head")
"""Joints on which no other joint depends: without key points of the head, the rest of the body can still be good."""


@dataclass(frozen=True)
class Assessment:
    """Assessment of a result.

    word: GOOD, LOOK or UNTRUSTED.
    findings: reasons for it, and remarks.
    frames: ranges of rows of the motion to review; for a good result, the ranges of rows of low confidence.
    """

    word: str
    findings: tuple[Finding, ...] = ()
    frames: tuple[range, ...] = ()

    @property
    def because(self) -> tuple[str, ...]:
        """Sentences with the reasons: first those that make the result invalid, then those to be reviewed."""
        return (*sentences(self.findings, INVALID), *sentences(self.findings, REVIEW))

    @property
    def sentence(self) -> str:
        """The assessment as one paragraph."""
        return " ".join((self._judgement, *sentences(self.findings, INFO)))

    @property
    def _judgement(self) -> str:
        because = " ".join(self.because)
        if self.word == UNTRUSTED:
            return f"Not to be trusted, because: {because}"
        if self.word == LOOK:
            return f"Look at {in_words(self.frames)}: {because}"
        if self.frames:
            return f"Good but for {in_words(self.frames)}: {because}"
        return "Good: nothing in the evidence speaks against it."

    def document(self, motion: Motion | None = None) -> dict[str, Any]:
        """Convert the assessment to JSON values, as in assessment.json.

        motion: the motion that was assessed, to add the frames of low confidence of each joint.
        Returns: table with "assessment" (the word), "because" (sentences), "frames" (pairs: first row, row after the
            last), "sentence", and "findings" (tables); with a motion also "low_confidence": for each joint that has
            such frames, pairs like those of "frames".
        """
        kept = {
            "assessment": self.word,
            "because": list(self.because),
            "frames": [[r.start, r.stop] for r in self.frames],
            "sentence": self.sentence,
            "findings": [f.document() for f in self.findings],
        }
        if motion is None:
            return kept
        low = np.zeros((0, 0), np.bool_) if motion.low_confidence_joints is None else motion.low_confidence_joints.T
        spans = [[[r.start, r.stop] for r in runs(of_joint)] for of_joint in low]
        names = zip(motion.skeleton.joint_names, spans, strict=False)
        return kept | {"low_confidence": {name: rows for name, rows in names if rows}}

    @staticmethod
    def of_document(kept: Mapping[str, Any]) -> Assessment:
        """Restore the assessment from the JSON values that `document` returned."""
        frames = tuple(range(int(a), int(b)) for a, b in kept["frames"])
        return Assessment(str(kept["assessment"]), tuple(map(Finding.of_document, kept["findings"])), frames)


def load_assessment(folder: Path) -> Assessment | None:
    """Load assessment.json of a results folder; None where it is missing or damaged."""
    try:
        return Assessment.of_document(read_json(folder / ASSESSMENT_FILE, "an assessment"))
    except (InputError, ValueError, KeyError, TypeError):
        return None


def not_shown(joints: Sequence[str]) -> Finding:
    """Make the remark that names the joints for which the key-point set has no point.

    joints: names of these joints.
    """
    which = ", ".join(j.replace("_", " ") for j in joints)
    text = f"Note: the key points have none for {which}; where these are follows from the rest of the body"
    return Finding("not shown", (), text, severity=INFO)


def other_people_note(more: int, where: str, command: str) -> tuple[Finding, ...]:
    """Make the finding that counts the other people in the masks or key points.

    more: number of other people; 0: there is no finding.
    where: evidence that shows them, "masks" or "key points".
    command: option of the command that tracks all people.
    """
    who = "another person is" if more == 1 else f"{more} other people are"
    text = f"Note: {who} in the {where} and left out; {command} tracks everybody"
    return (Finding("other people", (), text, size=more, severity=INFO),) if more else ()


def assess(
    motion: Motion,
    findings: Sequence[Finding] = (),
    cure: str | None = None,
    most_lost: float = SETTINGS.verdict_lost_share,
) -> Assessment:
    """Assess a motion as good, to be reviewed, or not to be trusted.

    findings: findings about the whole motion, from the checks before tracking and from the passes.
    cure: next step for the user where too many joints are likely wrong; None: a general one.
    most_lost: share of frames without the person above which the motion is not to be trusted.
    Returns: UNTRUSTED where the person is lost too often, too many joints or a limb are likely wrong, or a finding is
        INVALID; LOOK where a finding is to be reviewed or doubtful frames last long enough; GOOD otherwise.
    """
    found, gone = list(findings), motion.lost | motion.extrapolated
    looks = any(f.severity == REVIEW for f in findings)
    if gone.mean() > most_lost:
        text = f"the person was not found in {100 * gone.mean():.0f} % of the frames"
        found.append(Finding("lost", (), text, size=float(gone.mean())))
    low_confidence = motion.low_confidence_joints
    if low_confidence is not None and motion.error_probability is not None and (~gone).any():
        least = 0.0 if looks else SETTINGS.verdict_limb_p
        found += _unreliable_joints(motion, low_confidence, ~gone, least, cure or _cure(motion))
    if any(f.severity == INVALID for f in found):
        return Assessment(UNTRUSTED, tuple(found))
    frames = np.zeros(len(motion), dtype=bool) if motion.low_confidence is None else motion.low_confidence.astype(bool)
    least = max(2, round(SETTINGS.verdict_few_s * motion.frame_rate))
    marked = tuple(runs(frames))
    stretches = tuple(r for r in marked if len(r) >= least and _worth_a_look(motion, low_confidence, r))
    if frames.mean() > 0.5:
        stretches = marked
    if looks and not stretches:
        return Assessment(LOOK, tuple(found), (range(len(motion)),))
    if shown := stretches or marked:
        found.append(_what(motion, low_confidence, shown))
    return Assessment(LOOK if stretches else GOOD, tuple(found), shown)


def _worth_a_look(motion: Motion, low_confidence: NDArray[np.bool_] | None, stretch: range) -> bool:
    """Return whether doubtful frames are worth a review: the expected number of wrong joints reaches LOOK_P.

    low_confidence: (T, J); None: not known, then they are worth it.
    stretch: rows of the doubtful frames.
    """
    at = np.array(stretch)
    if low_confidence is None or motion.error_probability is None or not low_confidence[at].any(1).all():
        return True
    return float(np.where(low_confidence[at], motion.error_probability[at], 0.0).sum(1).mean()) >= LOOK_P


def _unreliable_joints(
    motion: Motion, low_confidence: NDArray[np.bool_], seen: NDArray[np.bool_], least: float, cure: str
) -> list[Finding]:
    """Make findings on joints that are likely wrong in the frames in which the person is seen.

    low_confidence: (T, J).
    seen: (T,) frames in which the person is seen.
    least: mean error probability in its doubtful frames from which a joint counts.
    cure: next step for the user where too many joints are likely wrong.
    Returns: one finding or none.
    """
    assert motion.error_probability is not None
    names = motion.skeleton.joint_names
    share, often = float(motion.error_probability[seen].mean()), low_confidence[seen].mean(0)
    if share > SETTINGS.verdict_wrong_share:
        worst = [names[j].replace("_", " ") for j in np.argsort(-often)[:4] if often[j] > 0.2]
        what = f", above all {', '.join(worst)}" if worst else ""
        text = f"the evidence speaks against the body in {100 * share:.0f} % of the joints{what}: {cure}"
        return [Finding("wrong joints", (), text, size=share)]
    likely = np.where(low_confidence, motion.error_probability, 0.0)[seen].sum(0) / np.maximum(
        low_confidence[seen].sum(0), 1
    )
    lasting = low_confidence[seen].sum(0) >= LIMB_S * motion.frame_rate
    found = np.flatnonzero((often > 0.5) & lasting & (likely >= least))
    bad = np.array([j for j in found if names[j] not in _ALONE], dtype=np.int64)
    if len(bad):
        which = ", ".join(names[j].replace("_", " ") for j in bad)
        text = f"{which} cannot be determined from the evidence in {100 * often[bad].max():.0f} % of the frames"
        return [Finding("wrong limb", (), text, size=float(often[bad].max()))]
    return []


def _cure(motion: Motion) -> str:
    """Write the next step for the user where too many joints are likely wrong.

    Why the cost: it is NaN in all frames of a motion that was tracked without masks, for which masks are advised.
    """
    points = bool(np.isnan(motion.cost).all())
    more, other = ("a background for masks", "key points") if points else ("key points", "masks")
    return f"compare the overlay with the images, and give {more}, --start with the first pose, or other {other}"


def _what(motion: Motion, low_confidence: NDArray[np.bool_] | None, stretches: Sequence[range]) -> Finding:
    """Make the finding that names the joints of low confidence in some frames.

    low_confidence: (T, J); None: not known, and no joint is named.
    stretches: rows of these frames.
    """
    at = np.concatenate([np.arange(r.start, r.stop) for r in stretches])
    often = np.zeros(len(motion.skeleton.joint_names)) if low_confidence is None else low_confidence[at].mean(0)
    which = [motion.skeleton.joint_names[j].replace("_", " ") for j in np.argsort(-often)[:4] if often[j] > 0.2]
    text = f"{', '.join(which)} may be wrong there" if which else "see the notes for what was seen there"
    return Finding("low confidence", (), text, size=len(at), severity=REVIEW)


def sentences(found: Sequence[Finding], severity: str = INVALID) -> tuple[str, ...]:
    """List the findings of one severity as sentences, each with its next step."""
    return tuple(f.sentence for f in found if f.severity == severity)
