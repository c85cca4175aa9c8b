"""How a run ends, in words: good, look at some frames, or not to be trusted, and why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.motion import Motion
from hypose.pipeline.frame_anomalies import in_words
from hypose.pipeline.settings import SETTINGS
from hypose.tracking.contacts import runs
from hypose.tracking.error_features import AROUND_S
from hypose.tracking.error_model import LOOK_P

GOOD, LOOK, UNTRUSTED = "good", "look", "not to be trusted"
EXIT_UNTRUSTED = 3
"""The exit code of a command whose result is not to be trusted."""
LIMB_S = 2 * AROUND_S
"""s that a limb must be doubtful for it: a joint is judged by neighbouring frames, so that a few bad frames make
all of a shorter clip doubtful; they are worth a look"""
_ALONE = ("neck", "head")
"""joints on which no other depends: key points without a head leave the rest to be looked at"""


@dataclass(frozen=True)
class Assessment:
    """word: GOOD, LOOK or UNTRUSTED; because: sentences; frames: to look at, of a good result those of low confidence;
    remarks: sentences on what else is there."""

    word: str
    because: tuple[str, ...] = ()
    frames: tuple[range, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """In one paragraph."""
        return " ".join((self._judgement, *self.remarks))

    @property
    def _judgement(self) -> str:
        if self.word == UNTRUSTED:
            return "Not to be trusted, because: " + " ".join(_ended(b) for b in self.because)
        if self.word == LOOK:
            return f"Look at {in_words(self.frames)}: " + " ".join(_ended(b) for b in self.because)
        if self.frames:
            return f"Good but for {in_words(self.frames)}: " + " ".join(_ended(b) for b in self.because)
        return "Good: nothing in the evidence speaks against it."

    def document(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "assessment": self.word,
            "because": list(self.because),
            "frames": [[r.start, r.stop] for r in self.frames],
            "sentence": self.sentence,
            **({"remarks": list(self.remarks)} if self.remarks else {}),
        }

    def with_joints(self, motion: Motion) -> dict[str, Any]:
        """`document`, and the frames in which each joint is doubtful."""
        joints = motion.low_confidence_joints
        names = motion.skeleton.joint_names
        found = {} if joints is None else {n: runs(joints[:, j]) for j, n in enumerate(names) if joints[:, j].any()}
        return {**self.document(), "low_confidence": {n: [[r.start, r.stop] for r in f] for n, f in found.items()}}

    @staticmethod
    def of_document(kept: Mapping[str, Any]) -> Assessment:
        """What `document` gave."""
        frames = tuple(range(int(a), int(b)) for a, b in kept["frames"])
        remarks = tuple(str(b) for b in kept.get("remarks", ()))
        return Assessment(str(kept["assessment"]), tuple(str(b) for b in kept["because"]), frames, remarks)


def not_shown(joints: Sequence[str]) -> str:
    """A sentence on joints that the set of key points has no point of."""
    which = ", ".join(j.replace("_", " ") for j in joints)
    return f"Note: the key points have none for {which}; where these are follows from the rest of the body."


def other_people_note(more: int, where: str, command: str) -> str:
    """A sentence on so many other people in the masks, or the key points, and the command that tracks them."""
    who = "another person is" if more == 1 else f"{more} other people are"
    return f"Note: {who} in the {where} and left out; {command} tracks everybody."


def assess(
    motion: Motion,
    faults: Sequence[str] = (),
    looks: Sequence[str] = (),
    cure: str | None = None,
    most_lost: float = SETTINGS.verdict_lost_share,
) -> Assessment:
    """Assess a motion as good, to be reviewed, or not to be trusted.

    faults: reasons why the whole motion is not to be trusted, sentences
    looks: reasons to review the whole motion, sentences
    cure: next step when too many joints are likely wrong
    most_lost: share of frames without the person above which the motion is not to be trusted
    """
    because = list(faults)
    gone = motion.lost | motion.extrapolated
    if gone.mean() > most_lost:
        because.append(f"the person was not found in {100 * gone.mean():.0f} % of the frames")
    low_confidence = motion.low_confidence_joints
    if low_confidence is not None and motion.error_probability is not None and (~gone).any():
        because += _too_doubtful(
            motion, low_confidence, ~gone, 0.0 if looks else SETTINGS.verdict_limb_p, cure or _cure(motion)
        )
    if because:
        return Assessment(UNTRUSTED, (*because, *looks))
    frames = np.zeros(len(motion), dtype=bool) if motion.low_confidence is None else motion.low_confidence.astype(bool)
    least = max(2, round(SETTINGS.verdict_few_s * motion.frame_rate))
    found = runs(frames)
    stretches = tuple(r for r in found if len(r) >= least and _worth_a_look(motion, low_confidence, r))
    if frames.mean() > SETTINGS.verdict_limb_share:
        stretches = tuple(found)
    if stretches:
        return Assessment(LOOK, (*looks, _what(motion, low_confidence, stretches)), stretches)
    if looks:
        return Assessment(LOOK, tuple(looks), (range(len(motion)),))
    return Assessment(GOOD, (_what(motion, low_confidence, found),), tuple(found)) if found else Assessment(GOOD)


def _worth_a_look(motion: Motion, low_confidence: NDArray[np.bool_] | None, stretch: range) -> bool:
    """Is more than a joint that is a little likelier wrong than others seen in a stretch of doubtful frames?"""
    at = np.array(stretch)
    if low_confidence is None or motion.error_probability is None or not low_confidence[at].any(1).all():
        return True
    return float(np.where(low_confidence[at], motion.error_probability[at], 0.0).sum(1).mean()) >= LOOK_P


def _too_doubtful(
    motion: Motion, low_confidence: NDArray[np.bool_], seen: NDArray[np.bool_], least: float, cure: str
) -> list[str]:
    """Sentences on joints that are too doubtful in the frames in which the person is seen; least: how likely a limb
    must be wrong for it; cure: of `assess`."""
    assert motion.error_probability is not None
    names = motion.skeleton.joint_names
    share, often = float(motion.error_probability[seen].mean()), low_confidence[seen].mean(0)
    if share > SETTINGS.verdict_wrong_share:
        worst = [names[j].replace("_", " ") for j in np.argsort(-often)[:4] if often[j] > 0.2]
        what = f", above all {', '.join(worst)}" if worst else ""
        return [f"the evidence speaks against the body in {100 * share:.0f} % of the joints{what}: {cure}"]
    likely = np.where(low_confidence, motion.error_probability, 0.0)[seen].sum(0) / np.maximum(
        low_confidence[seen].sum(0), 1
    )
    lasting = low_confidence[seen].sum(0) >= LIMB_S * motion.frame_rate
    found = np.flatnonzero((often > SETTINGS.verdict_limb_share) & lasting & (likely >= least))
    bad = np.array([j for j in found if names[j] not in _ALONE], dtype=np.int64)
    if len(bad):
        which = ", ".join(names[j].replace("_", " ") for j in bad)
        return [f"{which} cannot be told from the evidence in {100 * often[bad].max():.0f} % of the frames"]
    return []


def _cure(motion: Motion) -> str:
    """What to do when too many joints before cameras are likely wrong; without masks a motion has no cost."""
    points = bool(np.isnan(motion.cost).all())
    more, other = ("a background for masks", "key points") if points else ("key points", "masks")
    return f"compare the overlay with the images, and give {more}, --start with the first pose, or other {other}"


def _what(motion: Motion, low_confidence: NDArray[np.bool_] | None, stretches: Sequence[range]) -> str:
    at = np.concatenate([np.arange(r.start, r.stop) for r in stretches])
    often = np.zeros(len(motion.skeleton.joint_names)) if low_confidence is None else low_confidence[at].mean(0)
    which = [motion.skeleton.joint_names[j].replace("_", " ") for j in np.argsort(-often)[:4] if often[j] > 0.2]
    return f"{', '.join(which)} may be wrong there" if which else "see the notes for what was seen there"


def _ended(text: str) -> str:
    return text if text.endswith((".", ":")) else f"{text}."
