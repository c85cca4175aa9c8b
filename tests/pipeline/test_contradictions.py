"""What speaks against a clip from beginning to end is said, and of a clip that is right nothing is."""

import numpy as np
import pytest

from hypose.calibration.findings import INVALID, REVIEW
from hypose.pipeline.frame_anomalies import against_the_clip
from hypose.pipeline.settings import SETTINGS
from hypose.tracking.covariance_calibration import apart_factors
from hypose.tracking.joint_features import AUDITED

FRAMES, JOINTS = 30, 19


def audit(apart=0.0, bare=0.0):
    out = np.zeros((FRAMES, JOINTS, len(AUDITED)), np.float32)
    out[..., AUDITED.index("apart")] = np.hypot(apart_factors("silhouettes")[0], apart)
    out[..., AUDITED.index("bare")] = bare
    return out


def said(what, views=4):
    found = against_the_clip(what, np.full(FRAMES, views), "silhouettes")
    return {(f.kind, f.severity): f.text for f in found}


def test_nothing_is_said_of_a_clip_that_is_right():
    assert said(audit(0.7 * SETTINGS.contradiction_look_apart_m, 4 * 0.7 * SETTINGS.contradiction_look_more_m2)) == {}
    assert said(np.full((FRAMES, JOINTS, len(AUDITED)), np.nan)) == {}


def test_views_that_contradict_each_other_are_told():
    found = said(audit(apart=1.1 * SETTINGS.contradiction_look_apart_m))
    assert list(found) == [("views disagree", REVIEW)] and "by 7 mm" in found["views disagree", REVIEW]
    found = said(audit(apart=2 * SETTINGS.contradiction_wrong_apart_m))
    assert list(found) == [("views disagree", INVALID)] and "by 30 mm" in found["views disagree", INVALID]


@pytest.mark.parametrize("views", [3, 8])
def test_masks_that_show_more_than_the_body_are_told_whatever_the_number_of_views(views):
    assert said(audit(bare=0.7 * views * SETTINGS.contradiction_look_more_m2), views) == {}
    assert list(said(audit(bare=1.5 * views * SETTINGS.contradiction_look_more_m2), views)) == [
        ("larger masks", REVIEW)
    ]


def test_views_apart_and_masks_that_show_more_are_together_not_to_be_trusted():
    found = said(audit(1.1 * SETTINGS.contradiction_look_apart_m, 1.5 * 4 * SETTINGS.contradiction_look_more_m2))
    assert list(found) == [("views disagree", INVALID), ("larger masks", INVALID)]
