"""Leaving a camera out, and Pose2Sim's method from key points to points."""

import numpy as np
import pytest

from benchmarks.multiview.leave_one_out import METHODS, LeftOut, rows_of, without_view
from benchmarks.multiview.pose2sim_method import pose2sim_points
from hypose.evidence.frame import Frame, Keypoints
from hypose.evidence.silhouettes import make_silhouettes
from hypose.synthetic.rigs import rig

RIG = rig("ring-4").pinhole()


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


def test_exact_detections_give_the_points(path):
    np.testing.assert_allclose(pose2sim_points(RIG, detected(path), 60.0), path, atol=2e-3)


def test_a_view_that_is_far_off_is_taken_away(path):
    seen = detected(path)
    seen[30:40, 1, 0, :2] += 200.0
    np.testing.assert_allclose(pose2sim_points(RIG, seen, 60.0), path, atol=2e-3)


def test_short_gaps_are_bridged_and_long_ones_stay(path):
    seen = detected(path)
    seen[20:30, :, 0, 2] = 0.0
    seen[40:70, :, 1, 2] = 0.0
    found = pose2sim_points(RIG, seen, 60.0)
    np.testing.assert_allclose(found[20:30, 0], path[20:30, 0], atol=2e-2)
    assert np.isnan(found[45:65, 1]).all()


def test_a_frame_without_a_view_is_what_the_others_saw(path):
    masks = [np.zeros((c.size[1], c.size[0]), np.uint8) for c in RIG]
    for k, mask in enumerate(masks):
        mask[0, :k] = 1
    points = np.arange(4 * 2 * 3, dtype=float).reshape(4, 2, 3)
    frame = Frame(0.0, 0, make_silhouettes(masks, RIG), Keypoints(points, ("a", "b"), RIG))
    rest = without_view(frame, 1)
    assert rest.silhouettes is not None and rest.keypoints is not None
    assert rest.silhouettes.rig.names == tuple(n for k, n in enumerate(RIG.names) if k != 1)
    assert rest.silhouettes.areas.tolist() == [0, 2, 3]
    np.testing.assert_array_equal(rest.keypoints.points, points[[0, 2, 3]])


def test_rows_compare_with_pose2sim_on_the_same_samples():
    results = [
        LeftOut(name, {m: np.array([[value * (1 + k), np.nan]]) for k, m in enumerate(METHODS)})
        for name, value in (("a", 10.0), ("b", 20.0))
    ]
    rows = {r.case: r for r in rows_of(results)}
    assert rows["both/b"].value == pytest.approx(80) and rows["both/b"].ratio == pytest.approx(2)
    assert rows["triangulation"].value == pytest.approx(15) and rows["triangulation"].n == 2
