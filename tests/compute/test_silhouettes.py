"""Silhouette XOR by contour differences against the plain rasterizer; signed distances and outlines of masks."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from hypose.compute.arrays import prepare_masks
from hypose.compute.mask_distance import signed_distance
from hypose.compute.rows import outline_points
from hypose.compute.scorer import silhouette_xor
from tests import reference
from tests.capsule_person import look_at, random_pose, ring

SIZE = (96, 128)


@pytest.fixture(scope="module")
def rig():
    return ring(3, f=110.0, size=SIZE)


def masks_at(body, pose, rig):
    v = body.skin(pose)
    return np.stack([reference.rasterize(v, body.coarse.faces, c.projection, c.size) for c in rig])


def both(body, poses, prepared, **options):
    tree, mesh = body.skeleton.tree, body.coarse.arrays
    return reference.silhouette_xor(poses, tree, mesh, prepared, **options), silhouette_xor(
        poses, tree, mesh, prepared, **options
    )


@pytest.fixture
def scene(body, rig, rng):
    poses = np.stack([random_pose(body, rng) for _ in range(12)])
    prepared = prepare_masks(masks_at(body, poses[0], rig), np.ones(3, bool), rig.sizes, rig.projections)
    return poses, prepared


def test_counts_are_those_of_the_rasterizer(body, scene):
    slow, fast = both(body, scene[0][:6], scene[1])
    assert np.abs(slow - fast).max() <= 2
    np.testing.assert_array_equal(fast[0, :, 0], 0)  # its own masks
    np.testing.assert_array_equal(fast[..., 0], fast[..., 1] + scene[1].areas - 2 * fast[..., 2])


def test_bodies_across_the_image_border(body, scene):
    poses = np.repeat(scene[0][:1], 9, 0)
    poses[:, :3] += [
        [0, 0, 0],
        [0.8, 0, 0],
        [-0.8, 0, 0],
        [0, 0, 0.9],
        [0, 0, -0.9],
        [0, 0.9, 0],
        [0, -0.9, 0.7],
        [0, 0, 9],
        [0, 0, -9],
    ]
    slow, fast = both(body, poses, scene[1])
    assert np.abs(slow - fast).max() <= 2
    np.testing.assert_array_equal(fast[-2:, :, 1:], 0)
    np.testing.assert_array_equal(fast[-2:, :, 0], np.broadcast_to(scene[1].areas, (2, 3)))


@pytest.mark.parametrize("distance", [0.5, 0.25, 0.1, 0.0, -0.3, -3.0])
def test_bodies_through_and_behind_the_camera_plane(body, rng, distance):
    """The camera looks at the body from so near that parts lie behind it, or from inside."""
    pose = random_pose(body, rng)
    m, k = look_at(np.array([distance, 0.05, 1.0]), np.array([distance - 1.0, 0.0, 1.0]), 60.0, SIZE)
    projection = (k @ m[:3])[None]
    mask = np.zeros((1, SIZE[1], SIZE[0]), np.uint8)
    mask[0, 30:90, 20:50] = 1
    prepared = prepare_masks(mask, [True], [SIZE], projection)
    slow, fast = both(body, pose[None], prepared)
    # cut edges come as close as 0.05 m, where float32 moves a pixel more
    assert np.abs(slow - fast).max() <= 4
    if distance < -2:
        assert fast[0, 0, 1] == 0


def test_views_of_different_size_and_unusable_views(body, scene, rig):
    poses, prepared = scene
    masks = np.zeros((3, 140, 130), np.uint8)
    masks[:, : SIZE[1], : SIZE[0]] = prepared.masks
    padded = prepare_masks(masks, [True, False, True], rig.sizes, rig.projections)
    tree, mesh = body.skeleton.tree, body.coarse.arrays
    whole = silhouette_xor(poses, tree, mesh, prepared)
    some = silhouette_xor(poses, tree, mesh, padded)
    np.testing.assert_array_equal(some[:, [0, 2]], whole[:, [0, 2]])
    np.testing.assert_array_equal(some[:, 1], 0)


def test_signed_distance_and_outline_of_a_disc():
    y, x = np.mgrid[:90, :120]
    radius = np.hypot(x - 60, y - 44)
    mask = (radius < 25).astype(np.uint8)
    sdf = signed_distance(mask)
    exact = np.where(mask, 0.5 - distance_transform_edt(mask), distance_transform_edt(1 - mask) - 0.5)
    near = np.abs(exact) < 30
    assert np.abs(sdf - exact)[near].max() < 0.7  # chamfer distance: 2 %
    assert (np.sign(sdf) == np.where(mask, -1, 1)).all()
    points, n = outline_points(sdf, (120, 90), 64)
    assert n >= 64
    r = np.hypot(points[:, 0] - 60, points[:, 1] - 44)
    assert np.abs(r - 24.9).max() < 0.8
    assert abs(r.mean() - 24.9) < 0.15


def test_outlines_cut_by_the_image_border_are_left_out():
    mask = np.zeros((60, 80), np.uint8)
    mask[20:40, :50] = 1
    points, n = outline_points(signed_distance(mask), (80, 60), 500)
    assert 0 < n < 500
    assert points[:, 0].min() >= 2.5
    np.testing.assert_array_equal(points[n : 2 * n], points[: len(points[n : 2 * n])])


def test_distance_of_empty_and_full_masks_is_finite():
    empty, full = (signed_distance(np.full((40, 50), value, np.uint8)) for value in (0, 1))
    assert np.isfinite(empty).all() and (empty > 50).all() and np.isfinite(full).all() and (full < -50).all()
    points, n = outline_points(empty, (50, 40), 8)
    assert n == 0 and (points < -1e5).all()
