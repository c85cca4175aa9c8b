"""Pixels that somebody else covers are no evidence: in the scorer, the outlines, the hull, the audit."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.compute.arrays import NOT_KNOWN
from hypose.compute.scorer import silhouette_xor
from hypose.errors import EvidenceError
from hypose.evidence.frame import Frame, Silhouettes
from hypose.evidence.hull import visual_hull
from hypose.evidence.people import Other, own_frame, without
from hypose.pipeline.track_loop import body_shape
from hypose.synthetic.scenes import make_scene
from tests import reference
from tests.evidence.scenes import masks_of, on_floor, ring, solid_masks


@pytest.fixture(scope="module")
def body():
    return human()


@pytest.fixture(scope="module")
def pair(body):
    """Two bodies in one rig: poses, shapes, and the union of their masks."""
    rig = make_scene("walk", rig="humaneva-4", seconds=0.1).rig.pinhole().scaled(0.5)
    poses = [on_floor(body, (x, 0)) for x in (-0.3, 0.3)]
    shapes = [body_shape(body, q, rig) for q in poses]
    return poses, shapes, masks_of(shapes, rig)


def test_the_scorer_counts_nothing_where_pixels_are_ignored(body, pair):
    poses, shapes, silhouettes = pair
    own = own_frame(Frame(0.0, 0, silhouettes), shapes[0], [Other(shapes[1])]).the(Silhouettes)
    assert own.ignored is not None
    prepared = own.prepared
    tried = np.stack([poses[0], poses[0] + 0.03, poses[1]])
    arm = np.array([name.startswith("left_") for name in body.skeleton.joint_names])
    found = silhouette_xor(tried, body.skeleton.tree, body.coarse.arrays, prepared)
    defined = reference.silhouette_xor(tried, body.skeleton.tree, body.coarse.arrays, prepared)
    assert np.abs(found - defined).max() <= 2
    # the same when one limb is searched and the rest stands
    turned = np.repeat(poses[:1], 3, 0)
    turned[:2, body.skeleton.dofs_of("left_shoulder")[0]] += (0.4, 0.9)
    by_limb = silhouette_xor(turned, body.skeleton.tree, body.coarse.arrays, prepared, moving=arm)
    whole = silhouette_xor(turned, body.skeleton.tree, body.coarse.arrays, prepared)
    assert np.abs(by_limb - whole).max() <= 2


def test_distances_that_depend_on_ignored_pixels_are_not_known(pair):
    _, shapes, silhouettes = pair
    own = own_frame(Frame(0.0, 0, silhouettes), shapes[0], [Other(shapes[1])]).the(Silhouettes)
    assert own.ignored is not None
    made = own.outlines
    for c in np.flatnonzero(own.ignored.any((1, 2))):
        assert (made.distance[c] >= NOT_KNOWN).any()
        kept = made.points[c][made.points[c][:, 0] > -1e5]
        assert 8 <= len(kept) < len(made.points[c])
        at = np.rint(kept * made.shrunk[c]).astype(int)
        assert not own.ignored[c][at[:, 1], at[:, 0]].any()


def test_pixels_of_two_known_people_are_the_nearer_ones(pair):
    _, shapes, silhouettes = pair
    depth = [[np.median(c.depths(shape.vertices)) for c in silhouettes.rig] for shape in shapes]
    drawn = np.stack([masks_of([shape], silhouettes.rig).masks for shape in shapes])
    known = replace(silhouettes, owners=drawn[0] + 2 * drawn[1])
    for k in (0, 1):
        own = own_frame(Frame(0.0, 0, known), shapes[k], [Other(shapes[1 - k])]).the(Silhouettes)
        for c in range(len(known.rig)):
            if not (drawn[0, c] & drawn[1, c]).any():
                continue
            if depth[k][c] < depth[1 - k][c]:
                assert not own.shared[c] and (own.masks[c] == drawn[k, c]).all()
            else:
                assert not own.informative[c][drawn[1 - k, c] > 0].any()
                assert own.informative[c][drawn[k, c] > drawn[1 - k, c]].all()


def test_an_ignored_pixel_is_neither_a_hole_nor_a_body_in_the_hull():
    rig = ring(5)
    points = np.random.default_rng(0).normal(0, 1, (400, 3))
    points = 0.3 * points / np.linalg.norm(points, axis=1, keepdims=True) + (0, 0, 0.9)
    s = solid_masks(rig, points)
    whole = visual_hull(s, voxel=0.04)
    hidden = np.zeros_like(s.masks)
    hidden[0] = 1
    holed = replace(s, masks=np.where(hidden > 0, 0, s.masks).astype(np.uint8), ignored=hidden)
    found = visual_hull(holed, voxel=0.04)
    assert whole.volume <= found.volume < 1.6 * whole.volume
    everything = replace(s, ignored=np.ones_like(s.masks))
    with pytest.raises(EvidenceError):
        visual_hull(everything, voxel=0.04)


def test_without_hides_everybody_else(pair):
    _, shapes, silhouettes = pair
    left = without(silhouettes, [Other(shapes[1])])
    for c, (y0, y1, x0, x1) in enumerate(shapes[1].boxes):
        assert not left.informative[c, y0:y1, x0:x1][shapes[1].drawn(c) > 0].any()
    assert without(silhouettes, []) is silhouettes
