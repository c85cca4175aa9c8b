"""Which poses of a limb are no worse than the one that it is in, without drawing all of them."""

import numpy as np
import pytest

from hypose.compute.arrays import prepare_masks
from hypose.compute.scorer import limb_energies, silhouette_xor
from tests.capsule_person import random_pose, ring
from tests.compute.conftest import prepared_masks

ARM = ("left_shoulder", "left_elbow")


def scene(body, rng, views=3, joints=ARM, spread=0.4, n=150):
    """Poses of a limb about the first one, near which the masks are, and which joints move."""
    s, rig = body.skeleton, ring(views, f=210.0, size=(200, 230))
    moving = np.isin(np.arange(len(s.joint_names)), [s.joint(j) for j in joints])
    poses = np.repeat(random_pose(body, rng)[None], n, 0)
    own = np.flatnonzero(moving[s.tree.joint_of_dof])
    poses[1:, own] += spread * rng.standard_normal((n - 1, len(own)))
    seen = poses[0].copy()
    seen[own] += 0.15
    return poses, moving, prepared_masks(body, rig, seen)


def energies(body, poses, moving, prepared, **options):
    return limb_energies(poses, body.skeleton.tree, body.coarse.arrays, prepared, moving, **options)


def all_energies(body, poses, moving, prepared):
    counts = silhouette_xor(poses, body.skeleton.tree, body.coarse.arrays, prepared, moving=moving)
    use = prepared.usable
    return (counts[:, use, 0] / prepared.norm[use]).sum(1)


@pytest.mark.parametrize(("slack", "more"), [(1.0, 0.0), (1.0, -0.01), (1.04, 0.02), (100.0, 0.0)])
@pytest.mark.parametrize("joints", [ARM, ("right_hip", "right_knee"), ("pelvis",)])
def test_poses_have_the_energy_of_the_scorer_or_are_worse_than_the_limit(body, rng, joints, slack, more):
    poses, moving, prepared = scene(body, rng, joints=joints)
    found = energies(body, poses, moving, prepared, slack=slack, more=more)
    known = all_energies(body, poses, moving, prepared)
    computed = np.isfinite(found)
    np.testing.assert_array_equal(found[computed], known[computed])
    assert (known[~computed] > slack * known[0] + more).all()
    assert computed.all() if slack == 100 else (~computed).sum() > 20
    assert found.argmin() == known.argmin()


def test_pixels_that_say_nothing_bound_nothing(body, rng):
    poses, moving, prepared = scene(body, rng)
    ignored = np.zeros_like(prepared.masks)
    ignored[:, :, 95:125] = 1
    masked = prepare_masks(prepared.masks, prepared.usable, prepared.sizes, prepared.projections, ignored)
    found, known = energies(body, poses, moving, masked), all_energies(body, poses, moving, masked)
    told = np.isfinite(found)
    np.testing.assert_array_equal(found[told], known[told])
    assert (known[~told] > known[0]).all() and (~told).any()
