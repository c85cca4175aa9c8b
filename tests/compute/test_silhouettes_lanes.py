"""The block-wise scorer: parts, boxes, partial blocks, and every case in which a pose is drawn face by face."""

import numpy as np
import pytest

from hypose.compute.arrays import MeshArrays, prepare_masks
from hypose.compute.scorer import silhouette_xor
from tests import reference
from tests.capsule_person import random_pose, ring
from tests.compute.conftest import prepared_masks

SIZE = (200, 230)
BOXES = np.array([[40, 133, 60, 200], [3, 190, 100, 101], [0, 200, 0, 90]])
UPPER = [0, 1, 2, 3, 4, 5, 6, 9, 10]


@pytest.fixture(scope="module")
def rig():
    return ring(3, f=210.0, size=SIZE)


@pytest.fixture
def scene(body, rig, rng):
    poses = np.stack([random_pose(body, rng) for _ in range(37)])
    return poses, prepared_masks(body, rig, poses[0])


def upper_faces(body):
    return np.isin(body.coarse.main_joint[body.coarse.faces[:, 0]], UPPER)


def score(body, poses, prepared, mesh=None, **options):
    return silhouette_xor(poses, body.skeleton.tree, mesh or body.coarse.arrays, prepared, **options)


def defined(body, poses, prepared, mesh=None, **options):
    return reference.silhouette_xor(poses, body.skeleton.tree, mesh or body.coarse.arrays, prepared, **options)


@pytest.mark.parametrize("boxes", [None, BOXES])
@pytest.mark.parametrize("parts", [False, True])
def test_every_mode_counts_what_the_rasterizer_counts(body, scene, boxes, parts):
    options = {"boxes": boxes, "faces": upper_faces(body) if parts else None}
    fast = score(body, scene[0], scene[1], **options)
    slow = defined(body, scene[0], scene[1], **options)
    assert np.abs(fast - slow).max() <= 2
    assert slow[:, 0, 1].min() > 300


@pytest.mark.parametrize("options", [{}, {"boxes": BOXES}, {"faces": True}])
def test_a_pose_counts_the_same_alone_and_in_any_place_of_a_block(body, scene, options):
    options = {**options, "faces": upper_faces(body)} if "faces" in options else options
    poses, prepared = scene
    together = score(body, poses, prepared, **options)
    alone = np.concatenate([score(body, q[None], prepared, **options) for q in poses])
    np.testing.assert_array_equal(together, alone)
    np.testing.assert_array_equal(score(body, poses[::-1], prepared, threads=3, **options)[::-1], together)
    assert score(body, poses[:0], prepared, **options).shape == (0, 3, 3)


def test_kept_plans_do_not_keep_vertices(body, scene):
    """Topology and weights are remembered between calls; a reshaped body must still be seen."""
    poses, prepared = scene
    arrays = body.coarse.arrays
    larger = arrays._replace(vertices=np.float32(1.1) * arrays.vertices)
    before = score(body, poses, prepared, arrays)
    assert (score(body, poses, prepared, larger)[:, 0, 1] > before[:, 0, 1]).all()
    np.testing.assert_array_equal(score(body, poses, prepared, arrays), before)


def copies(body, n, spread):
    """n copies of the coarse mesh in one, scaled by 1 to 1 + spread."""
    m = body.coarse.arrays
    shift = np.repeat(np.arange(n), 1)[:, None, None]
    return MeshArrays(
        np.concatenate([m.vertices * np.float32(1 + spread * k / n) for k in range(n)]),
        (m.faces + len(m.vertices) * shift).reshape(-1, 3).astype(np.int32),
        (m.edges + np.array([len(m.vertices)] * 2 + [len(m.faces)] * 2) * shift).reshape(-1, 4).astype(np.int32),
        np.tile(m.skin_index, (n, 1)),
        np.tile(m.skin_weight, (n, 1)),
        np.tile(m.skin_count, n),
    )


def test_lists_that_are_full_are_drawn_again(body, rng):
    """A narrow image and 12 bodies: more crossings than the lists hold."""
    rig = ring(1, f=300.0, size=(16, 400))
    pose = random_pose(body, rng)
    prepared = prepare_masks(np.ones((1, 400, 16), np.uint8), [True], rig.sizes, rig.projections)
    many = score(body, pose[None], prepared, copies(body, 12, 0.0))
    one = score(body, pose[None], prepared)
    assert one[0, 0, 1] > 1000
    assert np.abs(many - one).max() <= 2


def test_poses_near_the_camera_do_not_disturb_their_block(body, scene, rig):
    poses, prepared = scene
    mixed = poses.copy()
    mixed[::5, :2] += rig[0].position[:2]
    together, before = score(body, mixed, prepared), score(body, poses, prepared)
    slow = defined(body, mixed[::5], prepared)
    assert np.abs(together[::5] - slow).max() <= 8  # cut edges as near as 0.05 m fill the image
    rest = np.arange(len(poses)) % 5 > 0
    np.testing.assert_array_equal(together[rest], before[rest])


@pytest.mark.parametrize(
    "joints", [("left_shoulder", "left_elbow"), ("right_hip", "right_knee"), ("right_elbow",), ("pelvis",)]
)
def test_a_limb_over_the_standing_rest_counts_as_the_whole_body(body, scene, rng, joints):
    mixed, prepared = scene
    moving = np.isin(np.arange(len(body.skeleton.joint_names)), [body.skeleton.joint(j) for j in joints])
    poses = np.where(moving[body.skeleton.tree.joint_of_dof], mixed, mixed[-1:])
    fast = score(body, mixed, prepared, moving=moving)  # what does not move stands as in the last pose
    assert np.abs(fast - score(body, poses, prepared)).max() <= 2
    assert np.abs(fast - defined(body, poses, prepared)).max() <= 2
    np.testing.assert_array_equal(score(body, mixed, prepared, moving=moving, threads=3), fast)
