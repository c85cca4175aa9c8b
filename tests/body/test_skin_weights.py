"""Heat weights: a partition of unity, smooth, without bleeding; visibility against its definition; coarse meshes."""

import numpy as np
import pytest

from hypose.body.body import Body, Mesh, enclosed_volume
from hypose.body.default_body import JOINT_NAMES, human
from hypose.body.skin_weights import (
    body_bones,
    carried_weights,
    coarse_mesh,
    decimated,
    heat_weights,
    influences,
    is_closed,
    vertex_normals,
)
from hypose.errors import InputError
from hypose.tracking.start_search import known_pose

LEFT_LEG, RIGHT_LEG = [13, 14, 15], [16, 17, 18]
LEFT_ARM, RIGHT_ARM = [6, 7, 8], [10, 11, 12]


def weights_of(body: Body, mesh: Mesh) -> np.ndarray:
    return heat_weights(mesh.vertices, mesh.faces, body_bones(body), 19)


@pytest.fixture(scope="module")
def rigged() -> tuple[Body, np.ndarray]:
    body = human()
    return body, weights_of(body, body.fine)


def test_weights_are_a_partition_of_unity(rigged):
    _, w = rigged
    np.testing.assert_allclose(w.sum(1), 1, atol=1e-12)
    assert w.min() >= 0
    index, value = influences(w)
    assert index.shape == value.shape == (len(w), 4)
    np.testing.assert_allclose(value.sum(1), 1, atol=1e-12)
    assert (np.diff(value, axis=1) <= 0).all()
    assert (index[value == 0] == 0).all()
    assert ((value == 0) | (value >= 0.01)).all()
    lost = 1 - np.sort(w, axis=1)[:, -4:].sum(1)
    assert lost.mean() < 0.02


def test_no_bleeding_between_thighs_or_arm_and_torso(rigged):
    body, w = rigged
    v, joints = body.fine.vertices, body.skeleton.rest_joints
    crotch = v[np.abs(v[:, 0]) < 0.02, 2].min()
    for depth, most in ((0.05, 0.05), (0.10, 0.02), (0.25, 1e-3)):
        below = v[:, 2] < crotch - depth
        for side, other in ((1, RIGHT_LEG), (-1, LEFT_LEG)):
            assert w[np.ix_(below & (side * v[:, 0] > 0), other)].sum(1).max() < most
    own = body.fine.dense_weights(19)
    for arm, shoulder in ((LEFT_ARM, 6), (RIGHT_ARM, 10)):
        torso = own[:, [0, 1, 2]].sum(1) > 0.95
        distance = np.linalg.norm(v - joints[shoulder], axis=1)
        # nearer lie the folds of the armpit, which do move with the arm
        for metres, most in ((0.20, 0.07), (0.25, 0.035)):
            assert w[np.ix_(torso & (distance > metres), arm)].sum(1).max() < most
        assert w[np.ix_((own[:, arm].sum(1) > 0.99) & (distance > 0.2), [0, 1, 2, 13, 14, 16, 17])].sum(1).max() < 0.01


def test_a_hand_beside_a_thigh_keeps_off_it():
    body = human()
    pose = known_pose(body, "standing")
    pose[body.skeleton.dofs_of("left_shoulder")[1]] += 0.02
    v = body.skin(pose, body.fine)
    own = body.fine.dense_weights(19)
    hand, thigh = own[:, 8] > 0.95, own[:, 13] > 0.95
    assert np.linalg.norm(v[hand][:, None] - v[thigh], axis=2).min() < 0.01
    w = heat_weights(v, body.fine.faces, body_bones(body, pose), 19)
    assert w[hand][:, [0, 13, 16]].sum(1).max() < 0.05
    assert w[thigh][:, LEFT_ARM].sum(1).max() < 0.05


def test_vertices_without_face_are_refused():
    mesh = human().coarse
    v = np.concatenate([mesh.vertices, [[0, 0, 5.0]]])
    with pytest.raises(InputError, match=f"1 of the mesh's {len(v)} vertices belong to no face"):
        heat_weights(v, mesh.faces, body_bones(human()), 19)


def test_coarse_mesh_keeps_closed_volume_and_height(rng):
    fine = human().fine
    noisy = fine.vertices + 0.002 * rng.standard_normal(fine.vertices.shape)
    for vertices in (fine.vertices, noisy):
        v, f = coarse_mesh(vertices, fine.faces)
        assert 450 <= len(v) <= 600
        assert is_closed(f)
        assert enclosed_volume(v, f) == pytest.approx(enclosed_volume(vertices, fine.faces), rel=1e-4)
        assert np.ptp(v[:, 2]) == pytest.approx(1.70, abs=0.015)
        assert len(v) - len(f) * 3 // 2 + len(f) == 2
    same, faces = decimated(fine.vertices, fine.faces, 10_000)
    np.testing.assert_array_equal(same, fine.vertices)
    np.testing.assert_array_equal(faces, fine.faces)


def test_carried_weights_are_those_of_the_surface():
    body = human()
    mesh, own = body.fine, body.fine.dense_weights(19)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    carried = carried_weights(mesh.vertices, normals, mesh.vertices, mesh.faces, own)
    np.testing.assert_allclose(carried.sum(1), 1, atol=1e-6)
    assert np.abs(carried - own).sum(1).mean() < 0.06
    assert carried[mesh.vertices[:, 0] > 0.1][:, JOINT_NAMES.index("right_hip")].max() < 0.01
