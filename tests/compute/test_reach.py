"""Limbs as points against masks and the standing rest of the body."""

import numpy as np
import pytest

from hypose.compute import lane_mesh, reach
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
        mask = (prepared.masks[k, v, u] != 0) | reference.ignored_pixels(prepared)[k, v, u]
        drawn = (rest.bits[k, v, u >> 3] >> (u & 7).astype(np.uint8)) & 1 > 0
        out += (seen * w * np.where(mask, np.where(drawn, 0.0, -1.0), 1.0)).sum(1)
    return out


def test_the_rest_is_the_body_without_the_limb(body, rig, rng):
    pose = random_pose(body, rng)
    prepared = prepared_masks(body, rig, random_pose(body, rng), (True, False, True))
    fast = standing(body, pose, prepared)
    parts = lane_mesh.moving_parts(body.coarse.arrays, body.skeleton.tree, moving(body))
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
