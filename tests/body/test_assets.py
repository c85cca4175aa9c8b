"""The baked bodies and the procedural one: closed, symmetric, outward, human in size, readable without pickle."""

from importlib import resources

import numpy as np
import pytest
from scipy.spatial import KDTree

from hypose.body.body import Mesh
from hypose.body.default_body import JOINT_NAMES, PARENTS

MIRROR = [
    JOINT_NAMES.index(n.replace("left_", "right_") if n.startswith("left_") else n.replace("right_", "left_"))
    for n in JOINT_NAMES
]
FLIP = np.array([-1.0, 1.0, 1.0])


def asset(name: str) -> dict[str, np.ndarray]:
    with resources.files("hypose.assets").joinpath(name).open("rb") as file:
        return dict(np.load(file, allow_pickle=False))


@pytest.fixture(scope="module")
def template() -> dict[str, np.ndarray]:
    return asset("template.npz")


@pytest.fixture(scope="module")
def subjects() -> dict[str, np.ndarray]:
    return asset("subjects.npz")


def mesh_of(data: dict[str, np.ndarray], prefix: str) -> Mesh:
    return Mesh(
        data[prefix + "vertices"].astype(np.float64),
        data[prefix + "faces"].astype(np.int32),
        data[prefix + "skin_index"].astype(np.int32),
        data[prefix + "skin_weight"].astype(np.float64),
    )


def euler_number(mesh: Mesh) -> int:
    return len(mesh.vertices) - len(mesh.edges) + len(mesh.faces)


@pytest.mark.parametrize("level", ["coarse_", "fine_"])
def test_template_mesh_is_a_closed_sphere_facing_outward(template, level):
    mesh = mesh_of(template, level)
    assert euler_number(mesh) == 2  # `edges` has already refused open and non-manifold meshes
    assert mesh.volume > 0
    assert len(np.unique(mesh.faces)) == len(mesh.vertices)
    areas = np.linalg.norm(
        np.cross(*(mesh.vertices[mesh.faces[:, k]] - mesh.vertices[mesh.faces[:, 0]] for k in (1, 2))), axis=1
    )
    assert areas.min() > 1e-8  # m^2: no degenerate face


@pytest.mark.parametrize("level", ["coarse_", "fine_"])
def test_template_mesh_is_its_own_mirror_image(template, level):
    mesh = mesh_of(template, level)
    distance, partner = KDTree(mesh.vertices).query(mesh.vertices * FLIP)
    assert distance.max() == 0
    np.testing.assert_array_equal(partner[partner], np.arange(len(partner)))
    faces = {tuple(np.roll(f, -int(np.argmin(f)))) for f in mesh.faces}
    mirrored = {tuple(np.roll(f, -int(np.argmin(f)))) for f in partner[mesh.faces][:, ::-1]}
    assert faces == mirrored
    w = mesh.dense_weights(len(JOINT_NAMES))
    np.testing.assert_allclose(w[partner][:, MIRROR], w, atol=2e-4)  # four weights are rounded to 1e-4


def test_joints_follow_the_conventions(template):
    assert tuple(template["joint_names"].tolist()) == JOINT_NAMES
    np.testing.assert_array_equal(template["parents"], PARENTS)
    joints = template["joints"]
    np.testing.assert_array_equal(joints[0], 0)
    np.testing.assert_allclose(joints[MIRROR] * FLIP, joints, atol=1e-6)
    assert (joints[[JOINT_NAMES.index(n) for n in JOINT_NAMES if n.startswith("left_")], 0] > 0).all()
    assert joints[JOINT_NAMES.index("head"), 2] > joints[JOINT_NAMES.index("neck"), 2] > 0


def test_landmarks_lie_where_their_names_say(template):
    names = template["landmark_names"].tolist()
    needed = [f"{s}_{n}" for s in ("left", "right") for n in ("eye", "ear", "big_toe", "small_toe", "heel", "hand_tip")]
    assert set(needed + ["nose", "head_top", "neck_base"]) <= set(names)
    at = template["joints"][template["landmark_joint"]] + template["landmark_offset"]
    point = dict(zip(names, at, strict=True))
    fine = template["fine_vertices"]
    for name, p in point.items():
        if name.startswith("left_"):
            np.testing.assert_allclose(point["right_" + name[5:]], p * FLIP, atol=2e-6)
            assert p[0] > 0
        if name != "neck_base":  # toe and finger tips are the ends of bones, a little below the skin
            assert np.linalg.norm(fine - p, axis=1).min() < 0.03, name
    assert point["nose"][1] < point["left_eye"][1] < point["left_ear"][1]
    assert point["left_big_toe"][1] < point["left_heel"][1]
    assert point["left_big_toe"][0] < point["left_small_toe"][0]
    floor = fine[:, 2].min()
    for name in ("sole_heel", "sole_ball", "sole_toe"):
        assert point["left_" + name][2] - floor < 0.015, name
    shoulders = template["joints"][[JOINT_NAMES.index("left_shoulder"), JOINT_NAMES.index("right_shoulder")]]
    np.testing.assert_allclose(point["neck_base"], shoulders.mean(0), atol=2e-6)


def test_subjects_are_closed_symmetric_people_of_their_stature(subjects):
    names = subjects["names"].tolist()
    assert names[0] == "neutral" and {"slim", "heavy", "broad"} <= set(names)
    assert len(names) == len(set(names)) == 24
    height = subjects["height"]
    assert height.min() < 1.55 and height.max() > 1.90
    vertices = np.cumsum(subjects["vertices_step"], axis=0) * float(subjects["vertex_scale"])
    base = {k: subjects[k] for k in ("faces", "skin_index", "skin_weight")}
    partner = KDTree(vertices[0]).query(vertices[0] * FLIP)[1]
    assert euler_number(mesh_of(base | {"vertices": vertices[0]}, "")) == 2
    body_mass_index = []
    for k, name in enumerate(names):
        mesh = mesh_of(base | {"vertices": vertices[k]}, "")
        assert np.ptp(vertices[k][:, 2]) == pytest.approx(height[k], abs=0.006), name
        np.testing.assert_allclose(vertices[k][partner] * FLIP, vertices[k], atol=2e-4)
        assert mesh.volume == pytest.approx(subjects["volume"][k], rel=1e-4)
        body_mass_index.append(1000 * mesh.volume / height[k] ** 2)
    assert min(body_mass_index) < 19 and max(body_mass_index) > 27
