import itertools

import numpy as np
import pytest
from scipy.stats import ncx2

from hypose.body.motion import sd_per_axis
from hypose.compute import fusion
from hypose.fusion import fit as trust
from hypose.fusion import joints as jt
from hypose.fusion.fuse import fuse_clip
from tests.depth_sensors import REST
from tests.fusion.people import moving_person, seen, sensor_poses

LENGTHS = np.linalg.norm(REST[jt.SKELETON_BONES[:, 0]] - REST[jt.SKELETON_BONES[:, 1]], axis=-1)
LEFT = np.array([1.0, 0.0, 0.0])  # the person at rest faces -y
FRONT, LEFT_SIDE, RIGHT_SIDE, BACK = ([0, -2.5, 1.2], [2.5, 0, 1.2], [-2.5, 0, 1.2], [0, 2.5, 1.2])
ARMS = {"left": [jt.LEFT_ELBOW, jt.LEFT_HAND], "right": [jt.RIGHT_ELBOW, jt.RIGHT_HAND]}


def open_at(positions, eyes, states=2, joints=REST, lengths=LENGTHS, variance=0.0):
    positions = np.asarray(positions, dtype=float)
    states = np.full(positions.shape[:2], states, np.uint8)
    return trust.remaining_uncertainty(
        positions, states, np.array(eyes, dtype=float), LEFT, lengths, joints, np.full(15, variance)
    )


def test_the_arm_that_the_body_hides_is_likely_guessed():
    for eye, hidden, near in ((RIGHT_SIDE, "left", "right"), (LEFT_SIDE, "right", "left")):
        systematic, wrong = open_at([REST], [eye], lengths=np.zeros(18))
        assert (wrong[ARMS[hidden]] > 0.5).all() and (wrong[ARMS[near]] < 0.1).all()
        assert (np.sqrt(systematic[ARMS[hidden]]) > 0.08).all()
    behind = open_at([REST], [BACK], lengths=np.zeros(18))[1]
    assert (behind[sum(ARMS.values(), [])] > 0.4).all() and behind[jt.TORSO] < 0.1
    # one sensor sees what the other one guesses elsewhere
    guessed = REST.copy()
    guessed[ARMS["left"]] += [0.0, -0.2, 0.0]
    assert (open_at([REST, guessed], [FRONT, RIGHT_SIDE])[1][ARMS["left"]] < 0.2).all()
    # from one side nothing tells which of two is right
    assert open_at([REST, guessed], [FRONT, FRONT])[1][jt.LEFT_HAND] > 0.3


def test_the_kernel_sums_over_who_is_right(rng):
    """Against the sum over all sets of sensors that are right, of which the first one says where the joint is."""
    weights, own, guess, jitter = np.array([[0.9], [0.6], [0.3]]), np.array([0.03]), 0.1, 0.01
    alike = np.zeros((3, 3))
    points = rng.normal(0, 0.08, (3, 1, 3))
    points[1:] += [[[0.6, 0, 0]], [[0, 1.2, 0]]]  # far apart, so that only one can be right
    x, variance = points[0] + 0.03, np.array([0.015**2])
    systematic, wrong = np.empty(1), np.empty(1)
    apart, order = ((points[:, None] - points) ** 2).sum(-1), np.arange(3)[:, None]
    fusion.judge_claims(points - x, apart, alike, weights, order, variance, own, guess, jitter, 0.1, systematic, wrong)

    def density(k, i, v):
        return np.exp(-((points[k, 0] - points[i, 0]) ** 2).sum() / (2 * v)) / v**1.5

    total, second, beyond = 0.0, 0.0, 0.0
    for right in itertools.product([True, False], repeat=3):
        first = right.index(True) if any(right) else None
        anchor = 0 if first is None else first
        p = np.prod(np.where(right, weights[:, 0], 1 - weights[:, 0]))
        for k in set(range(3)) - {anchor}:
            v = own[0] ** 2 + 2 * jitter**2 if right[k] else own[0] ** 2 + guess**2 * (2 if first is None else 1)
            p *= density(k, anchor, v)
        off = 0.0 if first is None else ((points[first, 0] - x[0]) ** 2).sum()
        v = guess**2 if first is None else own[0] ** 2
        total += p
        second += p * (v + off / 3)
        beyond += p * ncx2.sf(0.1**2 / (v + variance[0]), 3, off / (v + variance[0]))
    assert systematic[0] == pytest.approx(second / total, rel=1e-6)
    assert wrong[0] == pytest.approx(beyond / total, rel=1e-6)


@pytest.mark.parametrize("method", ["fit", "swarm"])
def test_a_motion_says_what_is_open(rng, method):
    frames = seen(moving_person(40), sensor_poses(rng, 3), rng, noise=0.01)
    motion = fuse_clip(frames, method).motion
    assert (motion.joint_sd[5:] > 0.02).all()
    part = sd_per_axis(motion.systematic_covariance) / motion.joint_sd
    assert (part > 0.5).all() and (part < 1).all()
    assert motion.error_probability.shape == motion.joints.shape[:2] and (motion.error_probability >= 0).all()
    np.testing.assert_array_equal(motion.low_confidence_joints, motion.error_probability > trust.DOUBTFUL_P)
