"""Scoring a limb over the rest of the body, which is drawn once."""

import numpy as np
import pytest

from hypose.compute.scorer import silhouette_xor
from tests import reference
from tests.capsule_person import random_pose, ring
from tests.compute.conftest import prepared_masks

BOXES = np.array([[40, 133, 60, 200], [3, 190, 100, 101], [0, 200, 0, 90]])


@pytest.fixture(scope="module")
def rig():
    return ring(3, f=210.0, size=(200, 230))


def limb_poses(body, rng, joints, n=37):
    """n poses that differ in the limb only, and which joints move."""
    moving = np.isin(np.arange(len(body.skeleton.joint_names)), [body.skeleton.joint(j) for j in joints])
    poses = np.repeat(random_pose(body, rng)[None], n, 0)
    own = moving[body.skeleton.tree.joint_of_dof]
    poses[:, own] = np.stack([random_pose(body, rng) for _ in range(n)])[:, own]
    return poses, moving


def score(body, poses, prepared, **options):
    return silhouette_xor(poses, body.skeleton.tree, body.coarse.arrays, prepared, **options)


def defined(body, poses, prepared, moving, boxes=None):
    whole = np.where(moving[body.skeleton.tree.joint_of_dof], poses, poses[-1:])
    return reference.silhouette_xor(whole, body.skeleton.tree, body.coarse.arrays, prepared, boxes)


@pytest.mark.parametrize("boxes", [None, BOXES])
@pytest.mark.parametrize(
    "joints", [("left_shoulder", "left_elbow"), ("right_hip", "right_knee"), ("right_elbow",), ("pelvis",)]
)
def test_a_limb_over_the_standing_rest_counts_as_the_whole_body(body, rig, rng, joints, boxes):
    poses, moving = limb_poses(body, rng, joints)
    prepared = prepared_masks(body, rig, random_pose(body, rng))
    fast = score(body, poses, prepared, boxes=boxes, moving=moving)
    assert np.abs(fast - score(body, poses, prepared, boxes=boxes)).max() <= 2
    slow = defined(body, poses, prepared, boxes=boxes, moving=moving)
    assert np.abs(fast - slow).max() <= 2
    assert len(np.unique(slow[:, :, 1])) > 10 or boxes is not None


def test_what_does_not_move_stands_as_in_the_last_pose(body, rig, rng):
    poses, moving = limb_poses(body, rng, ("left_shoulder", "left_elbow"))
    prepared = prepared_masks(body, rig, poses[0])
    wanted = score(body, poses, prepared, moving=moving)
    mixed = poses.copy()
    other = ~moving[body.skeleton.tree.joint_of_dof]
    mixed[:-1, other] = random_pose(body, rng)[other]
    np.testing.assert_array_equal(score(body, mixed, prepared, moving=moving), wanted)
    assert np.abs(defined(body, mixed, prepared, moving=moving) - wanted).max() <= 2


def test_same_counts_for_any_number_of_threads_and_unusable_views_stay_zero(body, rig, rng):
    poses, moving = limb_poses(body, rng, ("left_hip", "left_knee"), 70)
    whole = prepared_masks(body, rig, poses[0])
    prepared = whole._replace(usable=np.array([True, False, True]))
    one = score(body, poses, prepared, moving=moving, threads=1)
    np.testing.assert_array_equal(score(body, poses, prepared, moving=moving, threads=3), one)
    assert not one[:, 1].any()
    assert score(body, poses[:0], prepared, moving=moving).shape == (0, 3, 3)
