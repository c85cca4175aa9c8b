"""Projection through lenses, beside OpenCV's."""

import cv2
import numpy as np
import pytest

from hypose.cameras.camera import Camera

LENS = (-0.28, 0.09, 1e-3, -2e-3, 0.01, 0.02, -0.03, 0.004, 1e-3, 2e-3, -1e-3, 5e-4)


@pytest.mark.parametrize("count", [0, 4, 5, 8, 12])
def test_points_are_projected_as_opencv_does(count, rng):
    points = rng.normal(size=(50, 3)) + [0, 0, 4]
    points[7, 2] = -1.0
    lens = np.array(LENS[:count])
    k = np.array([[600.0, 0, 319.5], [0, 610.0, 239.5], [0, 0, 1]])
    uv = Camera("a", k, lens, np.eye(4), (640, 480)).project(points.reshape(5, 10, 3))
    zero = np.zeros(3)
    wanted = cv2.projectPoints(points[:, None], zero, zero, k, lens if count else None)[0][:, 0]
    front = points[:, 2] > 0
    assert uv.shape == (5, 10, 2) and np.isnan(uv.reshape(-1, 2)[~front]).all() and front.sum() > 40
    np.testing.assert_allclose(uv.reshape(-1, 2)[front], wanted[front], atol=1e-9)
