"""The assessment in words: good, look at frames, not to be trusted, and what is kept of it."""

import numpy as np

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


def kinds(found):
    return [f.kind for f in found.findings]


def test_nothing_against_it_is_good():
    found = assess(motion(probabilities()))
    assert found.word == GOOD and found.frames == () and found.sentence.startswith("Good")


def test_some_frames_are_to_be_looked_at_and_the_joint_is_named():
    found = assess(motion(probabilities(["right_wrist"], slice(10, 20))))
    assert found.word == LOOK and found.frames == (range(10, 20),)
    assert "frames 10-19" in found.sentence and "right wrist" in found.sentence


def test_a_body_that_the_evidence_speaks_against_is_not_to_be_trusted():
    whole = [n for n in BODY.skeleton.joint_names if n.endswith(("knee", "ankle", "wrist", "elbow", "hip"))]
    found = assess(motion(probabilities(whole)))
    assert found.word == UNTRUSTED and kinds(found) == ["wrong joints"] and "knee" in found.sentence


def test_one_limb_that_is_never_known_and_a_person_who_is_never_there():
    found = assess(motion(probabilities(["left_wrist"])))
    assert found.word == UNTRUSTED and kinds(found) == ["wrong limb"] and "left wrist" in found.sentence
    found = assess(motion(probabilities(["head"])))
    assert found.word == LOOK and kinds(found) == ["low confidence"] and "head may be wrong" in found.sentence
    found = assess(motion(probabilities(), lost=25))
    assert found.word == UNTRUSTED and kinds(found) == ["lost"] and "not found in 50 %" in found.sentence


def test_a_limb_doubtful_all_along_in_a_clip_worth_a_look_is_not_to_be_trusted():
    looks = (Finding("views disagree", (), "the views contradict each other by 11 mm", severity=REVIEW),)
    limb = motion(probabilities(["left_wrist"], slice(0, 40), 0.25))
    assert assess(limb).word == assess(motion(probabilities()), looks).word == LOOK
    found = assess(limb, looks)
    assert found.word == UNTRUSTED and "left wrist" in found.sentence and "11 mm" in found.sentence
    few = motion(probabilities(["left_wrist"], slice(0, 20), 0.25))
    assert assess(few, looks).word == LOOK


def test_what_was_found_before_tracking_decides():
    mirrored = Finding("mirrored", ("cam1",), "cam1: its images are mirrored", "mirror them back")
    found = assess(motion(probabilities()), (mirrored,))
    assert found.word == UNTRUSTED and "mirrored" in found.sentence


def test_a_verdict_comes_back_from_its_document():
    m = motion(probabilities(["right_wrist"], slice(10, 20)))
    found = assess(m)
    assert Assessment.of_document(found.document()) == found
    assert found.with_joints(m)["low_confidence"] == {"right_wrist": [[10, 20]]}
