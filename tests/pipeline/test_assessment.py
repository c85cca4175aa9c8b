"""The assessment in words: good, look at frames, not to be trusted, and what is kept of it."""

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.body.motion import Motion, isotropic
from hypose.calibration.findings import REVIEW, Finding
from hypose.pipeline.assessment import GOOD, LOOK, UNTRUSTED, Assessment, assess

BODY = human()


def motion(p=None, lost=0, frames=50, low_confidence=0.2):
    joints = BODY.joints(np.zeros((frames, BODY.skeleton.dof)))
    p = np.zeros(joints.shape[:2], np.float32) if p is None else p
    gone = np.arange(frames) < lost
    flagged = p > low_confidence
    return Motion(
        *(BODY.skeleton, np.arange(frames) / 25, joints, None, isotropic(np.full(joints.shape[:2], 0.01))),
        *(gone, np.zeros(frames, bool), np.full(frames, 4), np.full(frames, 0.1), {}),
        *(flagged.any(1), p, flagged),
    )


def probabilities(joints=(), rows=slice(None), value=0.6):
    p = np.full((50, len(BODY.skeleton.joint_names)), 0.001, np.float32)
    for name in joints:
        p[rows, BODY.skeleton.joint(name)] = value
    return p


BODY_WRONG = [n for n in BODY.skeleton.joint_names if n.endswith(("knee", "ankle", "wrist", "elbow", "hip"))]
APART = (Finding("views disagree", (), "the views contradict each other by 11 mm", severity=REVIEW),)


@pytest.mark.parametrize(
    ("p", "lost", "before", "word", "kinds", "named"),
    [
        (probabilities(), 0, (), GOOD, [], "Good"),
        (probabilities(["right_wrist"], slice(10, 20)), 0, (), LOOK, ["low confidence"], "right wrist"),
        (probabilities(["head"]), 0, (), LOOK, ["low confidence"], "head"),
        (probabilities(BODY_WRONG), 0, (), UNTRUSTED, ["wrong joints"], "knee"),
        (probabilities(["left_wrist"]), 0, (), UNTRUSTED, ["wrong limb"], "left wrist"),
        (probabilities(), 25, (), UNTRUSTED, ["lost"], "not found in 50 %"),
        (probabilities(), 0, APART, LOOK, ["views disagree"], "11 mm"),
        (probabilities(["left_wrist"], slice(0, 40), 0.25), 0, APART, UNTRUSTED, None, "left wrist"),
        (probabilities(["left_wrist"], slice(0, 40), 0.25), 0, (), LOOK, None, ""),
        (probabilities(["left_wrist"], slice(0, 20), 0.25), 0, APART, LOOK, None, ""),
    ],
)
def test_a_clip_is_good_or_worth_a_look_or_not_to_be_trusted(p, lost, before, word, kinds, named):
    found = assess(motion(p, lost), before)
    assert found.word == word and named in found.sentence
    assert kinds is None or [f.kind for f in found.findings] == kinds


def test_what_was_found_before_tracking_decides():
    mirrored = Finding("mirrored", ("cam1",), "cam1: its images are mirrored", "mirror them back")
    found = assess(motion(probabilities()), (mirrored,))
    assert found.word == UNTRUSTED and "mirrored" in found.sentence


def test_a_verdict_comes_back_from_its_document():
    m = motion(probabilities(["right_wrist"], slice(10, 20)))
    found = assess(m)
    assert found.frames == (range(10, 20),) and "frames 10-19" in found.sentence
    assert Assessment.of_document(found.document()) == found
    assert found.document(m)["low_confidence"] == {"right_wrist": [[10, 20]]}
