"""Entities, their prior and sizes measured on meshes, against shapes whose sizes are known on paper."""

import numpy as np
import pytest
import trimesh

from hypose.body.anthropometry import (
    SHAPE_FACTOR_NAMES,
    SHAPE_FACTORS,
    body_of,
    cross_section,
    dressed,
    entity,
    girth_at,
    prior_covariance,
    sizes_of,
)
from hypose.body.default_body import human


@pytest.fixture(scope="module")
def body():
    return human()


def one(name, value):
    x = np.zeros(len(SHAPE_FACTORS))
    x[entity(name)] = value
    return x


def test_girth_of_a_cylinder():
    mesh = trimesh.creation.cylinder(radius=0.1, height=1.0, sections=128)
    found = girth_at(mesh.vertices, mesh.faces, np.zeros(3), np.array([0.0, 0, 1]))
    assert found == pytest.approx(2 * np.pi * 0.1, rel=1e-3)
    tilted = girth_at(mesh.vertices, mesh.faces, np.zeros(3), np.array([0.0, np.sin(0.5), np.cos(0.5)]))
    a, b = 0.1 / np.cos(0.5), 0.1  # an ellipse; Ramanujan's formula
    h = ((a - b) / (a + b)) ** 2
    assert tilted == pytest.approx(np.pi * (a + b) * (1 + 3 * h / (10 + np.sqrt(4 - 3 * h))), rel=2e-3)


def test_section_takes_the_loop_around_the_bone():
    near = trimesh.creation.cylinder(radius=0.05, height=1.0, sections=64)
    far = trimesh.creation.cylinder(radius=0.2, height=1.0, sections=64)
    far.apply_translation([0.6, 0, 0])
    vertices = np.concatenate([near.vertices, far.vertices])
    faces = np.concatenate([near.faces, far.faces + len(near.vertices)])
    loops = cross_section(vertices, faces, np.zeros(3), np.array([0.0, 0, 1]))
    assert len(loops) == 2
    z = np.array([0.0, 0, 1])
    assert girth_at(vertices, faces, np.zeros(3), z) == pytest.approx(0.1 * np.pi, rel=5e-3)
    assert girth_at(vertices, faces, np.array([0.6, 0, 0]), z) == pytest.approx(0.4 * np.pi, rel=5e-3)


def test_every_entity_moves_its_own_size_by_its_factor(body):
    base = sizes_of(body)
    lengths = {
        "torso length": "torso",
        "upper arm length": "upper arm",
        "forearm length": "forearm",
        "thigh length": "thigh",
        "shank length": "shank",
        "shoulder width": "shoulder width",
        "hip width": "hip width",
    }
    for name, segment in lengths.items():
        changed = sizes_of(body_of(body, one(name, 0.1))).lengths
        for other, value in changed.items():
            wanted = base.lengths[other] * (np.exp(0.1) if other == segment else 1.0)
            # the torso's bones are not quite upright; its depth stays
            assert value == pytest.approx(wanted, rel=4e-3), (name, other)
    for name, site in {"thigh girth": "thigh", "shank girth": "shank", "upper arm girth": "upper arm"}.items():
        changed = sizes_of(body_of(body, one(name, 0.1))).girths
        assert changed[site] == pytest.approx(base.girths[site] * np.exp(0.1), rel=0.01)
        assert changed["waist"] == pytest.approx(base.girths["waist"], rel=5e-3)
    wide = sizes_of(body_of(body, one("waist width", 0.1))).girths["waist"]
    deep = sizes_of(body_of(body, one("waist depth", 0.1))).girths["waist"]
    assert base.girths["waist"] * 1.02 < deep < wide < base.girths["waist"] * 1.1


def test_clothes_lie_where_clothes_are(body):
    thick = dressed(body.fine, 0.01)
    moved = np.linalg.norm(thick.vertices - body.fine.vertices, axis=1)
    names = np.array(body.skeleton.joint_names)[body.fine.main_joint]
    assert moved[(names == "chest") | (names == "left_knee")].min() > 0.005
    assert moved[names == "left_wrist"].mean() < 0.002
    assert np.ptp(thick.vertices[:, 2]) == pytest.approx(body.stature, abs=0.005)
    base, over = sizes_of(body).girths, sizes_of(body_of(body, one("clothing", 0.1))).girths
    assert over["waist"] - base["waist"] == pytest.approx(2 * np.pi * 0.01, rel=0.15)
    bare = sizes_of(body_of(body, one("clothing", 0.1), clothed=False)).girths
    assert bare == pytest.approx(base, rel=1e-6)


def test_prior_is_a_distribution_with_the_sds_it_names():
    covariance = prior_covariance()
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [e.sd for e in SHAPE_FACTORS])
    assert np.linalg.eigvalsh(covariance).min() > 0
    # girths go together, lengths do not
    assert covariance[entity("waist width"), entity("thigh girth")] > 0
    assert covariance[entity("thigh length"), entity("waist width")] == 0
    assert len(set(SHAPE_FACTOR_NAMES)) == len(SHAPE_FACTOR_NAMES)
