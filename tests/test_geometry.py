"""Rotations and rigid motions: round trips, derivatives, averages, Procrustes."""

import numpy as np
import pytest

from hypose.geometry import (
    nearest_branch,
    procrustes,
    rotation_between,
    se3,
    skew,
    so3_exp,
    so3_left_jacobian,
    so3_log,
)


def directions(rng, n=200):
    d = rng.normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 1e-5, 9.9e-5, 1.1e-4, 1e-3, 0.5, 2.0, 3.0, np.pi - 1e-3])
def test_log_inverts_exp(angle, rng):
    r = angle * directions(rng)
    np.testing.assert_allclose(so3_log(so3_exp(r)), r, atol=1e-11)


@pytest.mark.parametrize("gap", [1e-4, 1e-10, 0.0])
def test_log_near_half_a_turn_gives_the_same_rotation(gap, rng):
    r = (np.pi - gap) * directions(rng)
    m = so3_exp(r)
    back = so3_log(m)
    np.testing.assert_allclose(so3_exp(back), m, atol=1e-11)
    assert np.linalg.norm(back, axis=1).max() <= np.pi + 1e-9


def test_exp_is_a_rotation_and_agrees_with_the_series(rng):
    r = rng.normal(size=(50, 3))
    m = so3_exp(r)
    np.testing.assert_allclose(m @ np.swapaxes(m, 1, 2), np.broadcast_to(np.eye(3), m.shape), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(m), 1, atol=1e-14)
    series, term = np.eye(3) * np.ones((50, 1, 1)), np.eye(3) * np.ones((50, 1, 1))
    for k in range(1, 40):
        term = term @ skew(r) / k
        series = series + term
    np.testing.assert_allclose(m, series, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 5e-4, 2e-3, 0.7, 2.5, 3.3, 5.0])
def test_left_jacobian_by_finite_differences(angle, rng):
    for r in angle * directions(rng, 5):
        step = 1e-6
        numeric = np.stack(
            [so3_log(so3_exp(r + step * e) @ so3_exp(r - step * e).T) / (2 * step) for e in np.eye(3)],
            1,
        )
        np.testing.assert_allclose(so3_left_jacobian(r), numeric, atol=2e-9)


def test_nearest_branch_is_the_same_rotation_and_nearest(rng):
    reference = rng.normal(size=(100, 3)) * 2
    r = so3_log(so3_exp(rng.normal(size=(100, 3)) * 2))
    b = nearest_branch(r, reference)
    np.testing.assert_allclose(so3_exp(b), so3_exp(r), atol=1e-12)
    assert (np.linalg.norm(b - reference, axis=1) <= np.linalg.norm(r - reference, axis=1) + 1e-12).all()


def test_rotation_between(rng):
    for a, b in rng.normal(size=(20, 2, 3)):
        r = rotation_between(a, b)
        np.testing.assert_allclose(r @ a / np.linalg.norm(a), b / np.linalg.norm(b), atol=1e-12)
    a = np.array([0.3, -1, 2.0])
    r = rotation_between(a, -a)
    np.testing.assert_allclose(r @ a, -a, atol=1e-12)
    assert np.linalg.det(r) == pytest.approx(1)


def test_procrustes_recovers_motion_and_scale(rng):
    a = rng.normal(size=(10, 3))
    r, t = so3_exp(rng.normal(size=3) * 2), rng.normal(size=3)
    m, k = procrustes(a, 1.7 * a @ r.T + t, scale=True)
    np.testing.assert_allclose(m, se3(1.7 * r, t), atol=1e-12)
    assert k == pytest.approx(1.7)


def test_procrustes_is_never_a_reflection(rng):
    for mirror, count in ((1, 3), (-1, 8)):
        a = rng.normal(size=(50, count, 3))
        for one in a:
            m, _ = procrustes(one, one * [1, 1, mirror] + 0.5)
            assert np.linalg.det(m[:3, :3]) == pytest.approx(1)
