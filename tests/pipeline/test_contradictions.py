"""What speaks against a clip from beginning to end is said, and of a clip that is right nothing is."""

import numpy as np
import pytest

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
    return against_the_clip(what, np.full(FRAMES, views), "silhouettes")


def test_nothing_is_said_of_a_clip_that_is_right():
    assert said(audit(0.7 * SETTINGS.contradiction_look_apart_m, 4 * 0.7 * SETTINGS.contradiction_look_more_m2)) == (
        (),
        (),
    )
    assert said(np.full((FRAMES, JOINTS, len(AUDITED)), np.nan)) == ((), ())


def test_views_that_contradict_each_other_are_told():
    wrong, look = said(audit(apart=1.1 * SETTINGS.contradiction_look_apart_m))
    assert not wrong and "contradict each other by 7 mm" in look[0]
    wrong, look = said(audit(apart=2 * SETTINGS.contradiction_wrong_apart_m))
    assert not look and "contradict each other by 30 mm" in wrong[0] and "hypose check" in wrong[0]


@pytest.mark.parametrize("views", [3, 8])
def test_masks_that_show_more_than_the_body_are_told_whatever_the_number_of_views(views):
    assert said(audit(bare=0.7 * views * SETTINGS.contradiction_look_more_m2), views) == ((), ())
    wrong, look = said(audit(bare=1.5 * views * SETTINGS.contradiction_look_more_m2), views)
    assert not wrong and "chair" in look[0]


def test_views_apart_and_masks_that_show_more_are_together_not_to_be_trusted():
    wrong, look = said(audit(1.1 * SETTINGS.contradiction_look_apart_m, 1.5 * 4 * SETTINGS.contradiction_look_more_m2))
    assert not look and "contradict" in wrong[0] and "chair" in wrong[1]
