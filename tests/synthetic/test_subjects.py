import numpy as np
import pytest

from hypose.body.skin_weights import vertex_normals
from hypose.geometry import so3_exp
from hypose.synthetic.subjects import dress


def test_one_turned_elbow_moves_only_the_forearm_and_hand(person):
    r = np.tile(np.eye(3), (19, 1, 1))
    for j in (7, 8):
        r[j] = so3_exp([-1.2, 0, 0])
    moved = np.linalg.norm(person.skin(r, np.zeros(3)) - person.vertices, axis=1)
    assert moved[person.dense_weights(19)[:, [7, 8]].sum(1) == 0].max() < 1e-9
    assert moved[person.main_joint == 8].min() > 0.05
    joints = person.place_joints(r, np.zeros(3))
    assert np.linalg.norm(joints[8] - joints[7]) == pytest.approx(np.linalg.norm(person.joints[8] - person.joints[7]))


def test_clothing_goes_outward_at_most_as_thick_as_asked_and_not_on_naked_parts(person):
    dressed = dress(person, 0.03, np.random.default_rng(0))
    step = dressed.vertices - person.vertices
    size = np.linalg.norm(step, axis=1)
    assert size.max() <= 0.03 + 1e-12
    covered = person.cloth_weight == 1
    assert size[covered].min() >= 0.3 * 0.03 - 1e-12 and 0.01 < size[covered].mean() < 0.03
    assert size[person.cloth_weight == 0].max() == 0
    normals = vertex_normals(person.vertices, person.faces)
    assert ((step * normals).sum(1)[covered] > 0).mean() > 0.99
    assert np.array_equal(dressed.joints, person.joints)
