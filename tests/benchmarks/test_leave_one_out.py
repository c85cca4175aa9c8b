"""Leaving a camera out, and Pose2Sim's method from key points to points."""

import numpy as np
import pytest

from benchmarks.multiview.pose2sim_method import pose2sim_points
from hypose.synthetic.scenes import camera_rig

RIG = camera_rig("ring-4").pinhole()


@pytest.fixture
def path():
    """(90, 2, 3): two points on slow curves, m."""
    t = np.arange(90) / 60
    a = np.stack([0.3 * np.sin(t), 0.2 * np.cos(t), 1 + 0.1 * t], 1)
    return np.stack([a, a + [0.0, 0.0, 0.4]], 1)


def detected(points):
    """(T, C, K, 3) as seen by RIG with confidence 0.9."""
    uv = np.stack([c.project_pinhole(points) for c in RIG], 1)
    return np.concatenate([uv, np.full((*uv.shape[:-1], 1), 0.9)], -1)


def test_a_view_that_is_far_off_is_taken_away(path):
    seen = detected(path)
    seen[30:40, 1, 0, :2] += 200.0
    np.testing.assert_allclose(pose2sim_points(RIG, seen, 60.0), path, atol=2e-3)
