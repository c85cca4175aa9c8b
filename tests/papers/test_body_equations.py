"""Alcoverro 2014, sections 2.3 to 2.5: the body, its shape, and what is weighed, against plain numpy."""

import itertools

import numpy as np
import pytest
from scipy.linalg import expm

from benchmarks.papers.layered_anthropometry import BETAS, TABLE_2_2, SizePrior, sizes_2_1
from hypose.body.anthropometry import SHAPE_FACTORS, TABLE_2_1, body_of, entity
from hypose.body.body import Shape, deform
from hypose.body.default_body import human
from hypose.cameras.camera import CameraRig
from hypose.compute.parts import covered
from hypose.evidence.body_parts import assign_ends
from hypose.evidence.frame import Frame
from hypose.evidence.silhouettes import make_silhouettes
from hypose.inference.hypotheses import Hypotheses
from hypose.synthetic.scenes import camera_rig
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.partitioned_observations import PartitionedXor, chain_region
from hypose.tracking.start_search import known_pose


@pytest.fixture(scope="module")
def body():
    return human()


def twist(axis, point):
    """4 x 4 matrix of the twist that turns about an axis (3,), of any length, through a point (3,)."""
    hat = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    out = np.zeros((4, 4))
    out[:3, :3], out[:3, 3] = hat, -hat @ point
    return out


def transforms(skeleton, pose):
    """(J, 4, 4) world from the model at rest: products of exponentials along every chain, eq. 2.11."""
    s, out = skeleton, []
    for j, parent in enumerate(s.parents):
        here = s.rest_joints[j]
        m = np.eye(4) if parent < 0 else out[parent]
        turning = [d for d in np.flatnonzero(s.joint_of_dof == j) if d >= 3]
        if parent < 0:
            m = m.copy()
            m[:3, 3] = pose[:3]
        if s.ball[j]:
            m = m @ expm(twist(pose[turning], here))
        else:
            for d in turning:
                m = m @ expm(pose[d] * twist(s.axes[d], here))
        out.append(m)
    return np.array(out)


def test_equations_2_11_and_2_12_skinning_blends_products_of_exponentials(body, rng):
    s, mesh = body.skeleton, body.coarse
    weights = np.zeros((len(mesh.vertices), len(s.joint_names)))
    np.add.at(weights, (np.arange(len(weights))[:, None], mesh.skin_index), mesh.skin_weight)
    np.testing.assert_allclose(weights.sum(1), 1.0, atol=1e-6)
    assert (weights > 0).sum(1).max() <= 4
    homogeneous = np.column_stack([mesh.vertices, np.ones(len(weights))])
    for _ in range(3):
        pose = s.clamp(s.rest_pose() + rng.normal(0, 0.4, s.dof))
        moved = np.einsum("jab,vb->vja", transforms(s, pose), homogeneous)[..., :3]
        np.testing.assert_allclose(body.skin(pose), (weights[..., None] * moved).sum(1), atol=1e-5)


def test_section_2_3_2_radial_deformation_is_that_of_the_closest_point_within_the_bone(body):
    # beta = 0.3 moves a vertex by 0.3 of its way from the closest point of the bone; past the bone's ends from its axis
    s, mesh = body.skeleton, body.fine
    j, end = s.joint("left_elbow"), s.joint("left_wrist")
    start, bone = s.rest_joints[j], s.rest_joints[end] - s.rest_joints[j]
    alone = np.flatnonzero(mesh.dense_weights(len(s.joint_names))[:, j] > 1 - 1e-9)
    vertices = mesh.vertices[alone].astype(np.float64)
    along = (vertices - start) @ bone / (bone @ bone)
    moved = deform(body, Shape(girth={"left_elbow": 1.3})).fine.vertices[alone]
    away = vertices - (start + along[:, None] * bone)
    np.testing.assert_allclose(moved - vertices, 0.3 * away, atol=1e-6)
    closest = start + np.clip(along, 0, 1)[:, None] * bone
    printed = vertices + 0.3 * (vertices - closest)
    within = (along >= 0) & (along <= 1)
    assert within.sum() > 20
    np.testing.assert_allclose(moved[within], printed[within], atol=1e-6)


def test_section_2_3_2_scale_deformation_carries_the_children_and_stretches_the_skin(body):
    s, mesh = body.skeleton, body.fine
    j, end = s.joint("left_knee"), s.joint("left_ankle")
    start, bone = s.rest_joints[j], s.rest_joints[end] - s.rest_joints[j]
    longer = deform(body, Shape(length={"left_knee": 1.2}))
    below = [end, *(k for k, p in enumerate(s.parents) if p == end)]
    others = [k for k in range(len(s.joint_names)) if k not in below]
    gain = longer.skeleton.rest_joints - s.rest_joints
    np.testing.assert_allclose(gain[below], np.repeat(0.2 * bone[None], len(below), 0), atol=1e-12)  # S' - S = 0.2 S
    np.testing.assert_allclose(gain[others], 0, atol=1e-12)
    alone = np.flatnonzero(mesh.dense_weights(len(s.joint_names))[:, j] > 1 - 1e-9)
    vertices = mesh.vertices[alone].astype(np.float64)
    along = (vertices - start) @ bone / (bone @ bone)
    np.testing.assert_allclose(longer.fine.vertices[alone] - vertices, 0.2 * along[:, None] * bone, atol=1e-6)


PRINTED_2_1 = {  # cm: mean, variance
    "shoulder height": (140.0, 17.0),
    "head": (25.0, 5.0),
    "clavicles": (35.0, 7.0),
    "arms": (55.5, 10.0),
    "upper arms": (25.5, 4.0),
    "lower arms": (30.5, 10.0),
    "legs": (90.5, 17.0),
    "torso": (52.0, 8.0),
}


def test_table_2_1():
    assert TABLE_2_1 == PRINTED_2_1


def test_equation_2_13_is_the_product_over_the_entities_of_table_2_1(body):
    prior, base = SizePrior(body), sizes_2_1(body)
    for scale in (0.0, 0.05, -0.08):
        x = np.zeros(len(SHAPE_FACTORS) + body.skeleton.dof)
        x[entity("scale")] = scale
        p = np.prod([np.exp(-((np.exp(scale) * base[n] - m) ** 2) / (2 * v)) for n, (m, v) in PRINTED_2_1.items()])
        assert np.exp(prior(x)) == pytest.approx(p, rel=1e-9)
    # and of a shape that is no scaling, from sizes measured on its mesh
    x[:] = 0
    x[[entity("upper arm length"), entity("torso length")]] = 0.03, -0.02
    measured = sizes_2_1(body_of(body, x[: len(SHAPE_FACTORS)]))
    expected = -sum((measured[n] - m) ** 2 / (2 * v) for n, (m, v) in PRINTED_2_1.items())
    assert prior(x) == pytest.approx(expected, abs=0.35)


def test_table_2_2():
    assert BETAS == (0.1, 0.3, 0.8, 1.0, *[1.0] * 6)
    head, upper_arms = {"head", "neck length"}, {"upper arm length", "upper arm girth", "shoulder width"}
    trunk = {f"{part} {way}" for part in ("chest", "waist", "pelvis") for way in ("width", "depth")}
    printed = [  # anthropometric entities, pose; shoulder height with all others free is the global scale
        *[(head | upper_arms | {"scale"}, "*")] * 4,
        (head, "pelvis"),
        (upper_arms, "shoulder clavicle"),
        ({"forearm length", "forearm girth", "hands"}, "elbow"),
        ({"thigh length", "shank length"}, "hip"),
        ({"shank length", "shank girth", "feet"}, "knee ankle"),
        ({"torso length", "hip width", "thigh girth"} | trunk, ""),
    ]
    for (_, entities, joints), (wanted, pose) in zip(TABLE_2_2, printed, strict=True):
        assert set(entities) == wanted
        assert {j.split("_")[-1] for j in joints} == set(pose.split())


def seen_from_the_front(body, pose, small_rig: CameraRig):
    """Masks (C, h, w) of the posed body in every view."""
    vertices, masks = body.skin(pose), []
    for camera in small_rig:
        depth = vertices @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
        masks.append(covered(camera.project_pinhole(vertices), depth, body.coarse.faces, camera.size[::-1]) > 0)
    return masks


def test_equation_2_15_counts_the_difference_inside_the_box_over_the_box(body):
    small, pose = camera_rig("humaneva-4").scaled(0.375), known_pose(body, "standing")
    pose[2] -= body.skin(pose)[:, 2].min()
    observed = seen_from_the_front(body, pose, small)
    silhouettes = make_silhouettes([m.astype(np.uint8) for m in observed], small)
    frame = prepare(Frame(0.0, 0, silhouettes=silhouettes), body, pose)
    kicked = pose.copy()
    kicked[body.skeleton.dofs_of("left_knee")] += 0.5
    leg = ("left_hip", "left_knee", "left_ankle")
    found = PartitionedXor(body, chain_region(body, leg))(Hypotheses.uniform(np.stack([pose, kicked])), frame)
    # the box: centred at the mean of the layer's joints at the mean pose, of a size that the rest pose fixes
    s = body.skeleton
    index = [s.joint(n) for n in leg]
    rest = s.rest_joints[index]
    half = 0.5 * np.linalg.norm(np.diff(rest, axis=0), axis=1).sum() + 0.12 * body.stature / 1.75
    centre = body.joints(0.5 * (pose + kicked))[index].mean(0)
    corners = centre + half * np.array(list(itertools.product((-1, 1), repeat=3)))
    expected = np.zeros(2)
    for n, one in enumerate((pose, kicked)):
        for camera, model, mask in zip(small, seen_from_the_front(body, one, small), observed, strict=True):
            uv = camera.project_pinhole(corners)
            omega = np.zeros_like(mask)
            (x0, y0), (x1, y1) = np.maximum(np.floor(uv.min(0)), 0).astype(int), np.ceil(uv.max(0)).astype(int) + 1
            omega[y0:y1, x0:x1] = True
            expected[n] += ((model != mask) & omega).sum() / omega.sum()
    assert found[0] < 0.01 and expected[0] < 0.01
    assert found[1] == pytest.approx(expected[1], rel=0.03)


def test_equation_2_19_the_best_of_all_assignments(rng):
    limits = np.array([0.35, 0.35, 0.25])
    for _ in range(60):
        points, ends = rng.normal(0, 0.25, (rng.integers(1, 4), 3)), rng.normal(0, 0.25, (3, 3))
        distance = np.linalg.norm(points[:, None] - ends[None], axis=-1)
        best = (0, 0.0)  # as many as possible, then the least total distance
        for choice in itertools.product((-1, 0, 1, 2), repeat=len(points)):
            used = [c for c in choice if c >= 0]
            pairs = [(p, c) for p, c in enumerate(choice) if c >= 0]
            if len(set(used)) == len(used) and all(distance[p, c] <= limits[c] for p, c in pairs):
                best = max(best, (len(used), -sum(distance[p, c] for p, c in pairs)))
        found = [(p, int(c)) for p, c in enumerate(assign_ends(points, ends, limits)) if c >= 0]
        assert len(found) == best[0]
        assert -sum(distance[p, c] for p, c in found) == pytest.approx(best[1], abs=1e-12)
