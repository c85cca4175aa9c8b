"""Asteriadis et al. 2013, equation by equation, with the misprints and gaps found on the way."""

from dataclasses import fields, replace

import numpy as np
import pytest

from benchmarks.depth_sensors.sensor_choice import Choice, cases
from benchmarks.synthetic.treadmill import treadmill_recording
from hypose.evidence.frame import SensorJoints
from hypose.fusion import joints as jt
from hypose.fusion.fuse import common_positions, fuse_clip
from hypose.fusion.register import register, triangle_transform
from hypose.fusion.swarm import (
    HIGH,
    LOW,
    MEDIUM,
    PUBLISHED,
    PUBLISHED_RULES,
    NoiseRules,
    SwarmFrame,
    SwarmSettings,
    confidence_step,
    depth_error,
    energy,
    merged_wheel,
    normalised,
    ride,
    start_confidence,
    start_swarm,
    swarm_step,
    unnatural,
)
from hypose.geometry import so3_exp, transform
from hypose.inference.hypotheses import Hypotheses


def random_rotation(rng):
    return so3_exp(rng.normal(0, 2, 3))


def test_equations_2_to_4_register_1000_random_triangles_exactly_and_never_reflect(rng):
    worst, smallest = 0.0, 1.0
    for _ in range(1000):
        moving = rng.normal(0, 0.3, (3, 3))
        r, t = random_rotation(rng), rng.normal(0, 2, 3)
        reference = moving @ r.T + t
        found = triangle_transform(reference, moving)
        worst = max(worst, np.abs(transform(found, moving) - reference).max(), np.abs(found[:3, :3] - r).max())
        smallest = min(smallest, np.linalg.det(found[:3, :3]))
    assert worst < 1e-9
    assert smallest > 0.999999


def test_equation_3_as_printed_is_the_inverse_and_without_guard_a_reflection_half_of_the_time(rng):
    reflected, inverse = 0, 0
    for _ in range(400):
        moving = rng.normal(0, 0.3, (3, 3))
        r = random_rotation(rng)
        reference = moving @ r.T
        h = (reference - reference.mean(0)).T @ (moving - moving.mean(0))
        u, _, vt = np.linalg.svd(h)
        printed = vt.T @ u.T
        reflected += np.linalg.det(printed) < 0
        # with the guard the printed formula is the rotation from the reference to the moving skeleton
        guarded = vt.T @ np.diag([1, 1, np.linalg.det(printed)]) @ u.T
        inverse += np.abs(guarded - r.T).max() < 1e-9
    assert 0.4 < reflected / 400 < 0.6
    assert inverse == 400


def test_published_registers_every_frame_by_its_triangle_alone(rng):
    # a sensor that stands elsewhere in every frame: only the frame's own triangle tells where
    truth = rng.normal(0, 0.3, (15, 3)) + [0, 0, 2.5]
    frames, moved = [], None
    for t in range(12):
        r, shift = random_rotation(rng), rng.normal(0, 1, 3)
        moved = truth @ r.T + shift
        if t == 7:
            moved[jt.TORSO] = np.nan  # no triangle: the transform of frame 6, which is wrong by now
        both = np.stack([truth, moved])
        state = np.where(np.isfinite(both[..., 0]), 2, 0).astype(np.uint8)
        frames.append(SensorJoints(both, state, np.full(2, t / 30), jt.COMMON, ("a", "b")))
    settings = replace(PUBLISHED, radius_m=1e-6, restart_every=0)
    clip = fuse_clip(frames, "published", swarm=settings)
    # the candidates of both sensors ride on the same place, but for frame 7
    spread = np.linalg.norm(common_positions(clip.motion) - truth, axis=-1).max(1)
    assert (np.delete(spread, 7) < 1e-4).all() and spread[7] > 0.01
    last = triangle_transform(truth[list(jt.TRIANGLE)], frames[-1].positions[1, list(jt.TRIANGLE)])
    np.testing.assert_allclose(clip.registration.common_from_sensor[1], last, atol=1e-9)
    window = fuse_clip(frames, "published-window", register(np.stack([f.positions for f in frames])), swarm=settings)
    assert np.nanmean(np.linalg.norm(window.motion.joints[0] - clip.motion.joints[0], axis=-1)) > 0.01


def test_section_2_5_the_joint_is_the_average_of_the_candidates_that_the_wheel_leaves(rng):
    positions, noise = rng.normal(0, 0.02, (3, 15, 3)), np.full((3, 15), 0.5)
    state, found = swarm_step(start_swarm(3), positions, noise, 0.0, PUBLISHED, 4)
    h = state.candidates
    copies = np.rint(np.exp(h.log_weights) * PUBLISHED.count)
    plain = (copies[..., None] * h.values).sum(1) / copies.sum(1)[:, None]
    np.testing.assert_allclose(found.joints, plain, atol=1e-9)
    _, before = swarm_step(start_swarm(3), positions, noise, 0.0, replace(PUBLISHED, weighted=True), 4)
    assert 1e-5 < np.abs(before.joints - found.joints).max() < 0.01  # the wheel's own noise


def test_equation_5_inverse_fluidity_of_a_stream_equals_its_definition(rng):
    positions = np.cumsum(rng.normal(0, 0.02, (23, 2, 15, 3)), axis=0)
    times = np.cumsum(rng.uniform(0.02, 0.05, (23, 2)), axis=0)  # ds/dt: clocks of their own, uneven
    state, memory = np.full((2, 15), 2, np.uint8), start_confidence(2, 5)
    speeds, activations = [np.zeros((2, 15))], []
    for t in range(1, 23):
        speeds.append(np.linalg.norm(positions[t] - positions[t - 1], axis=-1) / (times[t] - times[t - 1])[:, None])
    for t in range(23):
        memory, raw = confidence_step(memory, positions[t], state, (), times[t], False)
        activations.append(sum(speeds[max(0, t - 4) : t + 1]))
        expected = np.sqrt(np.mean((activations[-5:] - np.mean(activations[-5:], axis=0)) ** 2, axis=0))
        np.testing.assert_allclose(raw[0], expected, atol=1e-9)


def test_depth_error_is_the_difference_along_z_and_a_hole_reads_as_the_whole_distance():
    z, depth = np.full((2, 15), 2.5), np.full((2, 15), 2.4)
    depth[1, 4] = 0.0
    published, _ = depth_error(z, depth, np.zeros((2, 15)), False)
    assert published[0, 0] == pytest.approx(0.1)
    assert published[1, 4] == pytest.approx(2.5)
    held = np.full((2, 15), 0.07)
    cured, _ = depth_error(z, depth, held, True)
    assert cured[1, 4] == pytest.approx(0.07)
    assert cured[0, 4] == pytest.approx(abs(0.1 - 0.042))


def test_equation_6_a_right_angle_is_natural_a_straight_limb_is_not_and_other_joints_have_no_angle():
    p = np.zeros((15, 3))
    p[jt.LEFT_SHOULDER], p[jt.LEFT_ELBOW], p[jt.LEFT_HAND] = (0, 0, 0.3), (0, 0, 0), (0.3, 0, 0)
    p[jt.RIGHT_SHOULDER], p[jt.RIGHT_ELBOW], p[jt.RIGHT_HAND] = (1, 0, 0.3), (1, 0, 0), (1, 0, -0.3)
    a = unnatural(p)
    assert a[jt.LEFT_ELBOW] == pytest.approx(0, abs=1e-12)
    assert a[jt.RIGHT_ELBOW] == pytest.approx(1 - np.exp(-0.5 * 9))
    assert np.all(np.delete(a, [3, 6, 10, 13]) == 0)


def test_section_2_4_inputs_are_divided_by_their_maximum_over_the_sensors():
    raw = np.zeros((3, 2, 15))
    raw[0, :, 4] = 0.02, 0.08
    n = normalised(raw, False)
    assert n[0, :, 4].tolist() == [0.25, 1.0]
    assert np.all(n[1:] == 0)
    raw[1, :, 4] = 0.01, 0.02
    assert normalised(raw, False)[1, :, 4].tolist() == [0.5, 1.0]
    floored = normalised(raw, True)
    assert floored[1, 1, 4] == pytest.approx(0.02 / 0.15)


def test_rule_2_and_binds_tighter_than_or():
    rules = NoiseRules(slope=200.0)
    high, low = np.array(1.0), np.array(0.0)
    assert rules.firing(high, low, high)[1] > 0.99  # F and A
    assert rules.firing(low, high, low)[1] > 0.99  # D alone
    assert rules.firing(high, low, low)[1] < 0.01  # (D or F) and A would be the same; F alone is nothing
    assert rules.firing(low, high, low)[1] > rules.firing(low, high, low)[0]
    # and not "(D or F) and A": D high with A low still fires
    assert rules.firing(low, high, low)[1] == pytest.approx(1.0, abs=1e-6)


def test_the_five_rules_span_a_ratio_below_two_and_f_alone_says_nothing():
    low, high = PUBLISHED_RULES.noise(0, 0, 0), PUBLISHED_RULES.noise(1, 1, 1)
    assert 0.40 < low < 0.45
    assert 0.70 < high < 0.76
    assert high / low < 1.8
    assert PUBLISHED_RULES.noise(1, 0, 0) == pytest.approx(0.5, abs=0.02)
    assert PUBLISHED_RULES.membership(0.5, MEDIUM) == 1
    assert PUBLISHED_RULES.membership(0.5 + 0.3, MEDIUM) == pytest.approx(np.exp(-0.5))
    assert PUBLISHED_RULES.membership(0.25, LOW) == pytest.approx(0.5)
    assert PUBLISHED_RULES.membership(0.75, HIGH) == pytest.approx(0.5)


def swarm_frame(rng, settings, joints=3, sensors=2):
    positions = rng.normal(0, 0.05, (sensors, joints, 3))
    weights = rng.uniform(1, 3, (sensors, joints))
    return SwarmFrame(positions, np.zeros_like(positions), weights, settings)


def test_equation_7_energy_equals_its_definition_with_the_length_scale(rng):
    settings = SwarmSettings(h_m=0.05)
    frame = swarm_frame(rng, settings)
    values = rng.normal(0, 0.05, (3, 40, 3))
    h = Hypotheses.uniform(values, rng.integers(0, 2, (3, 40)))
    expected = np.zeros((3, 40))
    for j in range(3):
        for n in range(40):
            for k in range(2):
                d = np.linalg.norm(frame.positions[k, j] - values[j, n])
                expected[j, n] += frame.weights[k, j] * np.exp(-d / 0.05)
    np.testing.assert_allclose(np.exp(energy(h, frame)), expected, rtol=1e-3)  # exp(-d / h) < 0.001 counts as 0


def test_equation_8_probabilities_are_energies_over_their_sum(rng):
    settings = SwarmSettings(h_m=0.05)
    frame = swarm_frame(rng, settings)
    h = Hypotheses.uniform(rng.normal(0, 0.05, (3, 40, 3)), rng.integers(0, 2, (3, 40)))
    e = np.exp(energy(h, frame))
    p = h.reweighted(energy(h, frame)).weights
    np.testing.assert_allclose(p, e / e.sum(1, keepdims=True), rtol=1e-9)


@pytest.mark.parametrize("candidates", [40, 200])
def test_the_merged_wheel_draws_like_n_independent_spins(rng, candidates):
    shares = rng.random((1, candidates)) ** 3
    shares[0, :5] = 0
    with np.errstate(divide="ignore"):
        log_shares = np.log(shares)
    h = Hypotheses(np.arange(candidates * 3.0).reshape(1, candidates, 3), log_shares, np.zeros((1, candidates)))
    total = np.zeros(candidates)
    squares = np.zeros(candidates)
    for _ in range(400):
        drawn = merged_wheel(h, rng, 300)
        copies = np.zeros(candidates)
        used = drawn.origin[0] >= 0
        copies[(drawn.values[0, used, 0] / 3).round().astype(int)] = np.exp(drawn.log_weights[0, used]) * 300
        assert copies.sum() == pytest.approx(300)
        total += copies
        squares += copies**2
    p = shares[0] / shares.sum()
    mean, variance = total / 400, squares / 400 - (total / 400) ** 2
    error = np.sqrt(300 * p * (1 - p) / 400)
    assert np.abs(mean - 300 * p)[p > 0].max() < 4.5 * error.max()
    assert np.all(mean[p == 0] == 0)
    # multinomial, not systematic: the counts scatter as independent spins do
    assert variance.sum() == pytest.approx((300 * p * (1 - p)).sum(), rel=0.15)


def test_universal_sampling_gives_each_candidate_its_share_up_to_one(rng):
    shares = rng.random((4, 50)) + 0.1
    h = Hypotheses(rng.normal(size=(4, 50, 3)), np.log(shares), np.zeros((4, 50), dtype=np.int32))
    drawn = merged_wheel(h, rng, 1000, universal=True)
    assert drawn.values.shape == h.values.shape
    counts, expected = 1000 * np.exp(drawn.log_weights), 1000 * shares / shares.sum(1, keepdims=True)
    np.testing.assert_allclose(counts.sum(1), 1000)
    assert np.abs(counts - expected).max() < 1.0


def test_section_2_2_candidates_start_in_balls_of_100_mm_and_ride_with_their_sensor(rng):
    positions = rng.normal(0, 1, (3, 15, 3))
    state, noise = start_swarm(3), np.full((3, 15), 0.5)
    state, first = swarm_step(state, positions, noise, 0.0, PUBLISHED, 5)
    assert first.restarted
    h = state.candidates
    joint = np.arange(15)[:, None]
    used = h.origin >= 0
    away = np.linalg.norm(h.values - positions[np.maximum(h.origin, 0), joint], axis=-1)[used]
    assert away.max() <= 0.1 + 1e-6
    assert away.max() > 0.09
    shift = rng.normal(0, 0.1, (3, 15, 3))
    frame = SwarmFrame(positions + shift, shift, np.ones((3, 15)), PUBLISHED)
    moved = ride(h, frame, rng)
    np.testing.assert_allclose((moved.values - h.values)[used], shift[np.maximum(h.origin, 0), joint][used], atol=1e-12)


def test_section_2_6_restarts_every_t_frames_or_after_a_turn():
    positions, noise = np.zeros((2, 15, 3)), np.full((2, 15), 0.5)
    settings = SwarmSettings(count=100, restart_every=10, restart_turn=np.pi / 3)
    state, restarts = start_swarm(2), []
    for t in range(40):
        heading = 0.0 if t < 25 else 1.2
        state, found = swarm_step(state, positions, noise, heading, settings, 1)
        restarts.append(found.restarted)
    assert np.flatnonzero(restarts).tolist() == [0, 10, 20, 25, 35]


def test_table_1_counts_the_hands_whose_majority_comes_from_a_right_sensor():
    # two segments of 40 frames, three sensors; the first alone is right about the left hand, all about the right one
    recording = treadmill_recording("A", np.random.default_rng(3))
    t = 80
    visible, error = np.ones((t, 3, 15)), np.full((t, 3, 15), 0.02)
    visible[:, 1, jt.LEFT_HAND] = 0.0
    error[:, 2, jt.LEFT_HAND] = 0.3
    cut = {
        f.name: getattr(recording, f.name)[:t] for f in fields(recording) if f.name not in ("camera_from_world", "bars")
    }
    recording = replace(recording, **(cut | {"visible": visible, "error": error}))
    shares = np.full((t, 2, 3), 1 / 3)
    shares[39, 0], shares[79, 0] = (0.6, 0.2, 0.2), (0.4, 0.5, 0.1)
    restarts = np.zeros(t, bool)
    restarts[[0, 40]] = True
    found = cases(recording, Choice(shares, restarts, np.zeros((t, 2)), np.zeros((t, 2))))
    assert [c.success for c in found] == [True, False]
    assert [c.chance for c in found] == pytest.approx([1 / 3, 1 / 3])
    assert [c.majority for c in found][0] == 40
