import numpy as np
import pytest
from scipy.optimize import least_squares

from benchmarks.depth_sensors import baselines
from hypose.compute import fusion
from hypose.fusion import joints as jt
from hypose.fusion.fit import adapt_lengths, clip_lengths, fit_step, start_fit, unswap
from hypose.fusion.fuse import FUSION_METHODS, common_positions, fuse_clip
from tests.fusion.people import moving_person, seen, sensor_poses

TRUE_LENGTHS = np.linalg.norm(np.diff(moving_person(2)[0][jt.SKELETON_BONES], axis=1)[:, 0], axis=-1)

UNKNOWN = np.full((3, 3), np.nan)
"""where sensors stand that report in a common frame"""


def solve(points, weights, predicted, prior, lengths, bone_weight, data, scale, iterations=30):
    given = points, weights, predicted, prior, jt.SKELETON_BONES, lengths, bone_weight, data, scale, 1.0, iterations
    return fusion.fit_frame(*given)


def test_the_kernel_finds_the_minimum_of_its_cost_and_the_covariance_of_its_matrix(rng):
    truth = moving_person(5)[4]
    points = truth + rng.normal(0, 0.02, (3, 15, 3))
    weights = rng.uniform(0.3, 1, (3, 15)) * (rng.random((3, 15)) > 0.2)
    predicted, prior = truth + rng.normal(0, 0.02, (15, 3)), rng.uniform(500, 2000, 15)
    bone_weight = rng.uniform(3000, 15000, 18)
    x, share, variance = solve(points, weights, predicted, prior, TRUE_LENGTHS, bone_weight, 2500.0, 1e4)

    def residuals(flat):  # plain squares: the robust scale is endless
        y = flat.reshape(15, 3)
        d = np.linalg.norm(y[jt.SKELETON_BONES[:, 0]] - y[jt.SKELETON_BONES[:, 1]], axis=1)
        return np.concatenate(
            [
                (np.sqrt(weights * 2500)[..., None] * (points - y)).ravel(),
                np.sqrt(bone_weight) * (d - TRUE_LENGTHS),
                (np.sqrt(prior)[:, None] * (y - predicted)).ravel(),
            ]
        )

    best = least_squares(residuals, predicted.ravel(), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert np.abs(x - best.x.reshape(15, 3)).max() < 1e-6
    covariance = np.linalg.inv(best.jac.T @ best.jac)
    np.testing.assert_allclose(variance, np.diag(covariance).reshape(15, 3).mean(1), rtol=1e-4)
    np.testing.assert_allclose(share, weights / np.maximum(weights.sum(0), 1e-12), atol=1e-6)


def test_noise_goes_down_and_bones_keep_their_length(rng):
    truth, poses = moving_person(150), sensor_poses(rng, 3)
    frames = seen(truth, poses, rng, noise=0.02)
    fused = fuse_clip(frames, "fit")
    joints = common_positions(fused.motion)
    target = truth @ poses[0][0].T + poses[1][0]
    error = np.linalg.norm(joints - target, axis=-1)[10:]
    mean = np.linalg.norm(baselines.fuse_baseline(frames, "weighted_mean") - target, axis=-1)[10:]
    assert error.mean() < 0.85 * mean.mean()
    sd = [np.std(np.linalg.norm(joints[10:, a] - joints[10:, b], axis=-1)) for a, b in jt.SKELETON_BONES.tolist()]
    assert max(sd) < 0.008
    assert fused.shares.sum(-1) == pytest.approx(np.ones((150, 15)))
    np.testing.assert_allclose(fused.lengths, TRUE_LENGTHS, atol=0.012)


def test_a_joint_comes_back_from_a_sensor_that_was_wrong_for_long(rng):
    truth = moving_person(90)
    state = start_fit(TRUE_LENGTHS)
    for t in range(90):
        world = np.stack([truth[t]] * 3) + rng.normal(0, 0.005, (3, 15, 3))
        if t < 60:
            world[1:, jt.LEFT_HAND] = truth[t, jt.RIGHT_HAND]
        state, found = fit_step(state, world, np.full((3, 15), 2, np.uint8), t / 30, UNKNOWN)
    assert np.linalg.norm(found.joints[jt.LEFT_HAND] - truth[-1, jt.LEFT_HAND]) < 0.02
    assert np.all(found.shares[jt.LEFT_HAND] > 0.2)


def test_exchanged_sides_are_exchanged_back(rng):
    truth = moving_person(60)
    world = np.stack([truth] * 3, 1) + rng.normal(0, 0.005, (60, 3, 15, 3))
    world[10:40, 2] = world[10:40, 2][:, jt.MIRROR]
    state = start_fit(TRUE_LENGTHS)
    for t in range(60):
        states = np.full((3, 15), 2, np.uint8)
        state, found = fit_step(state, world[t], states, t / 30, UNKNOWN)
        assert np.linalg.norm(found.joints - truth[t], axis=-1).max() < 0.05
    before = world[20].copy()
    unswap(world[20], states, state.side)
    np.testing.assert_array_equal(world[20], before)  # inputs are not mutated


def test_lengths_are_learned_causally_and_one_bad_episode_does_not_move_them(rng):
    truth = moving_person(400)
    lengths, samples = np.zeros(18), np.zeros(18)
    for t in range(400):
        world = truth[t] + rng.normal(0, 0.01, (2, 15, 3))
        if 300 <= t < 330:
            world[0, jt.LEFT_HAND] += 0.4
        lengths, samples, _ = adapt_lengths(world, np.full((2, 15), 2, np.uint8), lengths, samples)
    np.testing.assert_allclose(lengths, TRUE_LENGTHS, atol=0.008)
    assert samples.tolist() == [800] * 18
    clip = truth[:, None] + rng.normal(0, 0.005, (400, 2, 15, 3))
    np.testing.assert_allclose(clip_lengths(clip, np.full((400, 2, 15), 2)), TRUE_LENGTHS, atol=0.002)


def test_missing_joints_are_held_by_their_bones_and_their_sd_grows(rng):
    truth = moving_person(60)
    state = start_fit(TRUE_LENGTHS)
    sd = []
    for t in range(60):
        world = np.stack([truth[t]] * 2)
        if t >= 30:
            world[:, jt.LEFT_HAND] = np.nan
        state, found = fit_step(state, world, np.full((2, 15), 2, np.uint8), t / 30, UNKNOWN[:2])
        sd.append(found.variance[jt.LEFT_HAND] ** 0.5)
        forearm = np.linalg.norm(found.joints[jt.LEFT_HAND] - found.joints[jt.LEFT_ELBOW])
        assert forearm == pytest.approx(TRUE_LENGTHS[3], abs=0.02)
    assert sd[45] > 3 * sd[20]
    assert np.all(found.shares[jt.LEFT_HAND] == 0)


@pytest.mark.parametrize("method", FUSION_METHODS)
def test_the_same_seed_gives_the_same_result_and_another_one_another_swarm(method, rng):
    frames = seen(moving_person(20), sensor_poses(rng, 3), rng, noise=0.02)
    a, b, c = (fuse_clip(frames, method, seed=s).motion.joints for s in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert np.isfinite(a).all()
    assert np.array_equal(a, c) == (method == "fit")
