import numpy as np
import pytest

from hypose.compute.zbuffer import interpolate, rasterize
from hypose.synthetic.scenes import camera_rig
from tests import reference


def test_interpolation_is_perspective_correct():
    """A slanted floor-like triangle: interpolated world points project back to the pixels they were drawn at."""
    camera = camera_rig("ring-1")[0]
    v = np.array([[-1.0, -1.0, 0.0], [1.2, -0.9, 0.1], [0.1, 1.5, 1.2]])
    z = v @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
    f = np.array([[0, 1, 2]], np.int32)
    depth, face = rasterize(camera.project_pinhole(v), z, f, camera.size, cull=False)
    drawn = face >= 0
    assert drawn.sum() > 5000
    points = interpolate(face, camera.project_pinhole(v), z, f, v).astype(float)
    rows, columns = np.nonzero(drawn)
    assert np.abs(camera.project_pinhole(points) - np.stack([columns, rows], 1)).max() < 0.01
    assert np.abs(points @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3] - depth[drawn]).max() < 1e-4


@pytest.mark.parametrize("cull", [True, False])
def test_the_nearest_faces_are_those_of_the_definition(cull, rng):
    uv, z = rng.uniform(-10, [90, 70], (60, 2)), rng.uniform(0.02, 3, 60)
    faces = rng.integers(0, 60, (40, 3)).astype(np.int32)
    depth, face = rasterize(uv, z, faces, (80, 60), cull=cull)
    nearest, number = reference.nearest_faces(uv, z, faces, (80, 60), cull=cull)
    np.testing.assert_array_equal(face, number)
    np.testing.assert_allclose(1 / depth, nearest, atol=1e-5)
    assert (number >= 0).mean() > 0.5
