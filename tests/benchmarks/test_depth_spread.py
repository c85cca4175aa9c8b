"""The fit of the spread of depth: what is said of errors that are known."""

import numpy as np
import pytest

from benchmarks.depth_sensors.depth_spread import DepthClip, held
from hypose.body.joint_angles import ANGLE_NAMES
from hypose.body.ready_bodies import JOINT_NAMES
from hypose.tracking.fitted_spread import kind_of


@pytest.mark.parametrize("factor, least, most", [(1.0, 0.88, 0.92), (0.5, 0.0, 0.6), (3.0, 0.99, 1.0)])
def test_regions_hold_what_they_say_when_errors_are_as_wide(rng, factor, least, most):
    frames, joints, angles = 400, len(JOINT_NAMES), len(ANGLE_NAMES)
    away = 0.02 * rng.standard_normal((frames, joints, 3))
    around = np.broadcast_to(0.02**2 * np.eye(3), (frames, joints, 3, 3))
    off = 0.1 * rng.standard_normal((frames, angles))
    clip = DepthClip("one", 0, away, around, off, np.full((frames, angles), 0.1), np.zeros((frames, joints)))
    pairs = {
        "joints": {kind_of(n): (factor, 0.0) for n in JOINT_NAMES},
        "angles": {kind_of(n): (factor, 0.0) for n in ANGLE_NAMES},
    }
    in_joints, in_angles = held([clip], pairs)
    assert least <= in_joints <= most
    assert least <= in_angles <= max(most, 0.62)
