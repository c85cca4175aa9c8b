"""Limbs as points against masks and the standing rest of the body."""

import numpy as np
import pytest

from hypose.compute import lane_mesh, reach
from hypose.compute.arrays import Standing, prepare_masks
from hypose.compute.scorer import silhouette_xor
from tests import reference
from tests.capsule_person import random_pose, ring
from tests.compute.conftest import prepared_masks

LIMB = ("left_shoulder", "left_elbow")


@pytest.fixture(scope="module")
def rig():
    return ring(3, f=210.0, size=(203, 230))


def moving(body):
    return np.isin(np.arange(len(body.skeleton.joint_names)), [body.skeleton.joint(j) for j in LIMB])


def standing(body, pose, prepared):
    return reach.standing(pose, body.skeleton.tree, body.coarse.arrays, prepared, moving(body))


def clusters(rng, n, count):
    """(n, count, 3) m: points that lie together about a joint, so that some clusters lie in the body's masks."""
    return rng.normal(0, 0.25, (n, 1, 3)) + rng.normal(0, 0.04, (n, count, 3))


def scores(p, w, r, c, prepared, rest):
    """The definition of `score_points`."""
    world = np.concatenate([p @ r.T + c, np.ones((*p.shape[:2], 1))], -1)
    out = np.zeros(len(p))
    for k in np.flatnonzero(prepared.usable):
        x = world @ prepared.projections[k].T
        front = x[..., 2] >= 0.05
        at = np.floor(x[..., :2] / np.where(front, x[..., 2], 1.0)[..., None] + 0.5)
        seen = front & (at >= 0).all(-1) & (at < prepared.sizes[k]).all(-1)
        u, v = (np.where(seen, at[..., i], 0).astype(np.int64) for i in (0, 1))
        mask = prepared.open_masks[k, v, u] != 0
        drawn = (rest.bits[k, v, u >> 3] >> (u & 7).astype(np.uint8)) & 1 > 0
        out += (seen * w * np.where(mask, np.where(drawn, 0.0, -1.0), 1.0)).sum(1)
    return out


def test_the_rest_is_the_body_without_the_limb(body, rig, rng):
    pose = random_pose(body, rng)
    prepared = prepared_masks(body, rig, random_pose(body, rng), (True, False, True))
    fast = standing(body, pose, prepared)
    parts = lane_mesh.moving_parts(body.coarse.arrays, body.skeleton.tree, moving(body), None)
    for c in np.flatnonzero(prepared.usable):
        w, h = prepared.sizes[c].tolist()
        drawn = reference.rasterize(body.skin(pose), parts.corners, prepared.projections[c], (w, h), one_sided=True)
        mine = np.unpackbits(fast.bits[c], axis=1, bitorder="little")[:h, :w] > 0
        assert (mine ^ drawn).sum() <= 2
        mask = prepared.masks[c, :h, :w] > 0
        assert np.abs(fast.counts[c] - [drawn.sum(), (drawn & mask).sum()]).max() <= 2
    assert not fast.bits[1].any() and fast.counts[0, 0] > 500
    whole = silhouette_xor(pose[None], body.skeleton.tree, body.coarse.arrays, prepared)[0]
    assert (fast.counts[[0, 2], 0] < whole[[0, 2], 1]).all()


def test_a_drawn_rest_changes_no_score_of_silhouettes(body, rig, rng):
    poses = np.repeat(random_pose(body, rng)[None], 9, 0)
    own = moving(body)[body.skeleton.tree.joint_of_dof]
    poses[:, own] = np.stack([random_pose(body, rng) for _ in range(9)])[:, own]
    prepared = prepared_masks(body, rig, random_pose(body, rng))
    args = (poses, body.skeleton.tree, body.coarse.arrays, prepared)
    rest = standing(body, poses[-1], prepared)
    before = rest.bits.copy()
    np.testing.assert_array_equal(
        silhouette_xor(*args, moving=moving(body), rest=rest),
        silhouette_xor(*args, moving=moving(body)),
    )
    np.testing.assert_array_equal(rest.bits, before)


@pytest.mark.parametrize("usable", [(True, True, True), (False, True, True)])
def test_points_are_scored_as_defined(body, rig, rng, usable):
    pose = random_pose(body, rng)
    prepared = prepared_masks(body, rig, random_pose(body, rng), usable)
    rest = standing(body, pose, prepared)
    r, p = body.skeleton.forward(pose)
    points = clusters(rng, 500, 6)
    points[:30, :3] *= 15  # outside the images, and behind the cameras
    weights = rng.random(6)
    args = (points, weights, r[1], p[1], prepared, rest)
    fast = reach.score_points(*args)
    slow = scores(*args)
    np.testing.assert_allclose(fast, slow, atol=1e-12)
    assert slow.min() < 0 < slow.max()


def test_a_point_counts_by_what_it_lies_on(body):
    """One camera, one point each: off the mask, in the mask beside the rest of the body, on the rest, and not seen."""
    rig = ring(1, f=210.0, size=(203, 230))
    mask = np.zeros((1, 230, 203), np.uint8)
    mask[0, 100:120, 80:120] = 1
    prepared = prepare_masks(mask, np.array([True]), rig.sizes, rig.projections)
    bits = np.zeros_like(prepared.bits)
    bits[0, 100:120, 12] = 255  # columns 96 to 103
    rest = Standing(bits, np.zeros((1, 2), np.int64))
    camera = rig.projections[0]
    pixels = {(90, 110): -2.0, (100, 110): 0.0, (50, 50): 2.0, (400, 110): 0.0}
    centre = -np.linalg.solve(camera[:, :3], camera[:, 3])
    points = np.stack([centre + 3 * np.linalg.solve(camera[:, :3], [u, v, 1.0]) for u, v in pixels])
    scores = reach.score_points(points[:, None], np.array([2.0]), np.eye(3), np.zeros(3), prepared, rest)
    np.testing.assert_array_equal(scores, list(pixels.values()))
    behind = centre - 3 * np.linalg.solve(camera[:, :3], [50, 50, 1.0])
    assert reach.score_points(behind[None, None], np.ones(1), np.eye(3), np.zeros(3), prepared, rest) == 0
