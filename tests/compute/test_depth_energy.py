"""Energy of depth maps against its definition by the renderer of the truth."""

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.compute.depth_costs import SeenDepth, depth_energy, limb_depth_energy, standing_depth
from hypose.tracking.start_search import known_pose
from tests.depth_pictures import drawn, sensors

BODY = human()
MOST = 0.15


@pytest.fixture(scope="module")
def case():
    pose = known_pose(BODY, "standing")
    pose[:3] = 0.0, 0.0, 0.95
    rig = sensors(2)
    maps, person = drawn(BODY, pose, rig)
    seen = SeenDepth(
        np.where(person > 0, maps, 0).astype(np.float32),
        rig.sizes,
        rig.projections,
        person.sum((1, 2)).astype(np.int64),
    )
    return pose, rig, seen


def defined(pose, rig, seen):
    maps, person = drawn(BODY, pose, rig)
    both = (person > 0) & (seen.maps > 0)
    off = np.where(both, np.minimum(np.abs(maps - seen.maps), MOST), 0).sum((1, 2)) / MOST
    return off / np.maximum(seen.counts, 1)


def some_poses(pose, rng, count=6):
    return np.stack([BODY.skeleton.clamp(pose + 0.12 * rng.normal(size=len(pose))) for _ in range(count)])


def energy(poses, seen, **more):
    return depth_energy(poses, BODY.skeleton.tree, BODY.coarse.arrays, seen, MOST, **more)


def test_the_energy_is_what_the_renderer_says(case, rng):
    pose, rig, seen = case
    poses = some_poses(pose, rng)
    found = energy(poses, seen)
    expected = np.stack([defined(q, rig, seen) for q in poses])
    assert np.abs(found - expected).max() < 0.02
    assert energy(pose[None], seen).max() < 0.01 < found.min()


def test_the_same_alone_among_others_and_for_any_number_of_threads(case, rng):
    pose, _, seen = case
    poses = some_poses(pose, rng, 40)
    together = energy(poses, seen, threads=2)
    assert np.array_equal(together, energy(poses, seen, threads=1))
    assert np.array_equal(together[3:4], energy(poses[3:4], seen))


def limb(*names):
    s = BODY.skeleton
    return np.isin(np.arange(len(s.joint_names)), [s.joint(name) for name in names])


def limb_energy(poses, seen, moving, **more):
    given = BODY.skeleton.tree, BODY.coarse.arrays, seen, MOST
    return limb_depth_energy(poses, *given, standing_depth(poses[-1], *given, moving), **more)


def test_a_limb_that_moves_alone_costs_as_the_whole_body(case, rng):
    pose, _, seen = case
    moving = limb("left_shoulder", "left_elbow")
    poses = some_poses(pose, rng, 12)
    poses = np.where(moving[BODY.skeleton.tree.joint_of_dof], poses, poses[-1:])
    found = limb_energy(poses, seen, moving, threads=2)
    assert np.abs(found - energy(poses, seen)).max() < 1e-5
    assert np.array_equal(found, limb_energy(poses, seen, moving, threads=1))
