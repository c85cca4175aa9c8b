"""Forward kinematics and its derivatives against independent routes; poses as a manifold."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from hypose.compute.kinematics import forward_kinematics, skin
from hypose.geometry import skew, so3_exp, transform
from tests import reference
from tests.capsule_person import capsule_person, random_pose


@pytest.fixture(scope="module")
def body():
    return capsule_person(0.08)


@pytest.fixture
def poses(body, rng):
    return np.stack([random_pose(body, rng, 0.6) + np.r_[rng.normal(size=3), np.zeros(33)] for _ in range(6)])


def exponential(twist):
    """Rigid motion (4, 4) of a twist (6,) = (rotation, velocity), by SciPy's matrix exponential."""
    m = np.zeros((4, 4))
    m[:3, :3], m[:3, 3] = skew(twist[:3]), twist[3:]
    return expm(m)


def test_kernels_are_the_reference(body, poses):
    tree, mesh = body.skeleton.tree, body.coarse.arrays
    r0, p0 = reference.forward_kinematics(poses, tree)
    v0 = reference.skin(r0, p0, tree, mesh)
    r1, p1 = forward_kinematics(poses, tree)
    np.testing.assert_allclose(r1, r0, atol=1e-12)
    np.testing.assert_allclose(p1, p0, atol=1e-12)
    np.testing.assert_allclose(skin(r1, p1, tree, mesh), v0, atol=1e-12)


def test_forward_is_the_product_of_twist_exponentials(body, poses):
    """Alcoverro 2014, eq. 2.11: x = prod_d exp(xi_d q_d) x_rest, in joint order, along the chain."""
    s = body.skeleton
    twists = np.zeros(
        (s.dof, 6)
    )  # (w, v) of each degree of freedom at rest; v = -w x p for a turn about a line through p
    twists[3:, :3] = s.axes[3:]
    twists[3:, 3:] = -np.cross(s.axes[3:], s.rest_joints[s.joint_of_dof[3:]])
    for q in poses:
        rotations, centres = s.forward(q)
        for j in range(len(s.joint_names)):
            chain, a = [], j
            while a >= 0:
                chain.append(a)
                a = int(s.parents[a])
            m = np.eye(4)
            for a in reversed(chain):
                dofs = np.flatnonzero(s.joint_of_dof == a)
                if a == 0:
                    m[:3, 3] = q[:3]
                    dofs = dofs[3:]
                if s.ball[a]:  # one exponential of the summed twist: they share the joint's centre
                    m = m @ exponential(q[dofs] @ twists[dofs])
                else:
                    for d in dofs:
                        m = m @ exponential(q[d] * twists[d])
            np.testing.assert_allclose(transform(m, s.rest_joints[j : j + 1])[0], centres[j], atol=1e-12)
            np.testing.assert_allclose(m[:3, :3], rotations[j], atol=1e-12)


def test_jacobian_by_finite_differences(body, poses, rng):
    s, h = body.skeleton, 1e-6
    offset = rng.normal(size=3) * 0.1
    for q in poses[:3]:
        for joint in (0, 4, 8, 12, 15):

            def point(q, joint=joint):
                r, p = s.forward(q)
                return p[joint] + r[joint] @ offset

            analytic = s.jacobian(q, joint, point(q)[None])[0]
            numeric = np.stack([(point(q + h * e) - point(q - h * e)) / (2 * h) for e in np.eye(s.dof)], 1)
            np.testing.assert_allclose(analytic, numeric, atol=1e-8)


def test_balls_are_unwound_where_the_limits_allow(body):
    s = body.skeleton
    shoulder, root = s.dofs_of("left_shoulder"), slice(3, 6)
    pose = s.rest_pose()
    pose[shoulder] = 2.2, -2.2, 1.8  # 206 degrees
    pose[root] = 0.0, 0.0, 4.0
    found = s.unwound(pose)
    assert np.linalg.norm(found[shoulder]) < np.pi
    np.testing.assert_allclose(so3_exp(found[shoulder]), so3_exp(pose[shoulder]), atol=1e-12)
    np.testing.assert_allclose(found[root], pose[root])  # the root has no limits to run into
    np.testing.assert_allclose(s.unwound(found, pose), pose, atol=1e-12)
    held = replace(s, upper=np.where(np.isin(np.arange(s.dof), shoulder), 2.5, s.upper))
    held = replace(held, lower=np.where(np.isin(np.arange(s.dof), shoulder), -0.3, s.lower))
    np.testing.assert_allclose(held.unwound(pose), pose)  # the other way is none that the joint goes
