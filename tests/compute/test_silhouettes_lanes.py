"""The block-wise scorer: parts, boxes, partial blocks, and every case in which a pose is drawn face by face."""

import numpy as np
import pytest
from scipy.stats import spearmanr

from hypose.body.default_body import human
from hypose.compute import lane_mesh
from hypose.compute.arrays import MeshArrays, prepare_masks
from hypose.compute.scorer import silhouette_xor
from hypose.errors import InputError
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


def test_crossings_of_parts_add_up_to_those_of_the_whole(body, scene, rig, rng):
    """Exactly: every pixel's difference is the sum of the parts' differences, whatever the parts."""
    from hypose.compute import scorer as kernels

    poses = scene[0][: kernels.LANES]
    homogeneous = body.skin(poses) @ rig[0].projection[:, :3].T + rig[0].projection[:, 3]
    uv = np.float32(homogeneous[..., :2] / homogeneous[..., 2:])

    def differences(faces):
        mesh = lane_mesh.prepare_lanes(body.coarse.arrays, body.skeleton.tree, faces)
        used = np.unique(body.coarse.faces if faces is None else body.coarse.faces[faces])
        u, v = (np.ascontiguousarray(uv[:, used, k].T) for k in (0, 1))
        lanes = kernels.LANES
        window = np.repeat(np.float32([[8], [30], [0], [150], [170]]), lanes, 1)
        origin = np.repeat(np.int64([[8, 30, 150, 170]]), lanes, 0)
        lists, ends = np.zeros((2 * lanes, 4096), np.int32), np.zeros(2 * lanes, np.int64)
        front, union = np.zeros(len(mesh.faces) + 1, np.uint16), np.zeros(len(mesh.edges) + 1, np.int32)
        edge, columns = np.zeros((4, lanes), np.float32), np.zeros(lanes, np.int32)
        every = np.uint32(0xFFFF)
        full = kernels.list_crossings(mesh, u, v, every, window, origin, front, union, edge, columns, lists, ends)
        assert full == 0
        out = np.zeros((lanes, 171 * int(kernels.row_stride(150))), np.int64)
        for k in range(lanes):
            np.add.at(out[k], lists[2 * k, : ends[2 * k]], 1)
            np.add.at(out[k], lists[2 * k + 1, : ends[2 * k + 1]], -1)
        return out

    owner = rng.integers(0, 4, len(body.coarse.faces))
    whole = differences(None)
    assert np.abs(whole).sum() > 3000
    np.testing.assert_array_equal(sum(differences(owner == k) for k in range(4)), whole)


def test_no_faces_and_all_faces(body, scene):
    poses, prepared = scene
    f = len(body.coarse.faces)
    none = score(body, poses, prepared, faces=np.zeros(f, bool))
    np.testing.assert_array_equal(none[..., 1:], 0)
    np.testing.assert_array_equal(none[..., 0], np.broadcast_to(prepared.areas, none.shape[:2]))
    np.testing.assert_array_equal(score(body, poses, prepared, faces=np.ones(f, bool)), score(body, poses, prepared))
    with pytest.raises(InputError, match="truth value per face"):
        score(body, poses, prepared, faces=[True])


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


def test_the_coarse_mesh_ranks_poses_as_the_fine_one():
    """500 poses 2 degrees and 1 cm around a standing pose; `./run bench speed --case scorer` measures more (0.999)."""
    body, rng = human(), np.random.default_rng(3)
    rig = ring(4, f=640.0, size=(640, 480))
    pose = body.skeleton.rest_pose()
    pose[2] = 0.95
    v = body.skin(pose, body.fine)
    masks = np.stack([reference.rasterize(v, body.fine.faces, c.projection, c.size) for c in rig])
    prepared = prepare_masks(masks, np.ones(4, bool), rig.sizes, rig.projections)
    sd = np.where(np.arange(body.skeleton.dof) < 3, 0.01, np.deg2rad(2))
    poses = body.skeleton.clamp(pose + rng.standard_normal((300, body.skeleton.dof)) * sd)
    energies = [score(body, poses, prepared, m.arrays)[..., 0].sum(1) for m in (body.coarse, body.fine)]
    assert spearmanr(*energies).statistic > 0.995
