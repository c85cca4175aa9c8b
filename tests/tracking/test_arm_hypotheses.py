"""Arms that were lost are looked up and carried along until frames have decided."""

import numpy as np
import pytest

from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.published_recipes import LIMB_LAYERS
from hypose.tracking.recipes import default
from hypose.tracking.refinement import RIVAL, SOLVED, uncertainty_of_pose
from hypose.tracking.tracker import (
    Tracker,
    TrackerSettings,
    TrackerState,
    estimates_from_arrays,
    estimates_to_arrays,
    motion_of,
)

FACING = (1, 3)
"""the views that are taken away: the two that are left look at each other, and see nearly the same outline"""
LEFT, RIGHT = dict(LIMB_LAYERS)["left_arm"], dict(LIMB_LAYERS)["right_arm"]


@pytest.fixture(scope="module")
def raised(body, standing):
    """The left arm held out to the side and bent, in plain sight."""
    pose = standing.copy()
    s = body.skeleton
    pose[s.dofs_of("left_shoulder")] += [-1.3, 0.0, 0.3]
    pose[s.dofs_of("left_elbow")[0]] += 0.9
    return s.clamp(pose)


def wrist_error(body, pose, truth, side="left"):
    k = body.skeleton.joint(f"{side}_wrist")
    return float(np.linalg.norm(body.joints(pose)[k] - body.joints(truth)[k]))


def follow(tracker, state, poses, frame_of, dead=()):
    for t, pose in enumerate(poses):
        state, _ = tracker.step(state, frame_of(tracker.body, pose, t, dead))
    return state


@pytest.mark.parametrize("seed", range(3))
def test_a_lost_arm_in_plain_sight_returns(body, standing, raised, frame_of, seed):
    """Tracking begins with an arm that hangs while the person's is held out; a sixth of the usual particles."""
    tracker = Tracker(body, default(body, particles=32), TrackerSettings(seed=seed))
    state = follow(tracker, tracker.start(standing), [raised] * 4, frame_of)
    assert wrist_error(body, state.pose, raised) < 0.05
    assert wrist_error(body, state.pose, raised, "right") < 0.05


@pytest.fixture(scope="module")
def hidden(body, standing):
    """An arm that bends in front of the trunk: seen by too few, it can be several arms."""
    poses = np.repeat(standing[None], 8, 0)
    s = body.skeleton
    for t in range(8):
        poses[t, s.dofs_of("left_elbow")[0]] += 0.25 * t
        poses[t, s.dofs_of("left_shoulder")] += np.array([0.0, 0.1, 0.1]) * t
    return s.clamp(poses)


def test_rivals_live_on_and_a_saved_state_goes_on_with_the_same_bytes(body, hidden, frame_of):
    tracker = Tracker(body, default(body, particles=32))
    middle, begin = tracker.start(hidden[0]), 0
    while begin < 2 or (begin < 7 and middle.hypotheses.count == 1):
        middle, _ = tracker.step(middle, frame_of(body, hidden[begin], begin, FACING))
        begin += 1
    assert middle.hypotheses.count > 1 and middle.hypotheses.has(RIVAL).sum() == middle.hypotheses.count - 1
    saved = TrackerState.from_arrays({k: np.copy(v) for k, v in middle.to_arrays().items()})
    ends_at = [middle, saved]
    for n, state in enumerate(ends_at):
        for t in range(begin, 8):
            state, _ = tracker.step(state, frame_of(body, hidden[t], t, FACING))
        ends_at[n] = state
    for name, values in ends_at[0].to_arrays().items():
        assert values.tobytes() == ends_at[1].to_arrays()[name].tobytes(), name


def test_the_covariance_is_that_of_the_mixture(body, standing, raised, frame_of):
    frame = prepare(frame_of(body, standing), body, standing)
    alone = Hypotheses(standing[None], np.zeros(1)).marked(SOLVED, [0])
    two = Hypotheses(np.stack([standing, raised]), np.log([0.8, 0.2])).marked(SOLVED, [0]).marked(RIVAL, [1])
    before, after = (uncertainty_of_pose(standing, h, frame) for h in (alone, two))
    apart = body.joints(raised) - body.joints(standing)
    wanted = before.joint_covariance + 0.2 * np.einsum("ja,jb->jab", apart, apart)
    np.testing.assert_allclose(after.joint_covariance, wanted, atol=1e-6)
    wrist, knee = (body.skeleton.joint(name) for name in ("left_wrist", "left_knee"))
    assert np.trace(after.joint_covariance[wrist]) > 5 * np.trace(before.joint_covariance[wrist])
    np.testing.assert_allclose(after.joint_covariance[knee], before.joint_covariance[knee], atol=1e-9)


def test_a_motion_has_the_rivals_of_its_frames(body, hidden, frame_of):
    tracker = Tracker(body, default(body, particles=32))
    state, estimates, living = tracker.start(hidden[0]), [], []
    for t, pose in enumerate(hidden[:6]):
        state, estimate = tracker.step(state, frame_of(body, pose, t, (0, 1, 2, 3) if t == 3 else FACING))
        estimates.append(estimate)
        living.append(0 if t == 3 else state.hypotheses.count - 1)
    estimates = estimates_from_arrays(estimates_to_arrays(estimates))
    motion = motion_of(body, np.arange(6) / 25, estimates)
    assert motion.rivals.shape == (6, 2, body.skeleton.dof) and max(living) > 0
    np.testing.assert_array_equal(np.isfinite(motion.rivals).all(-1).sum(-1), living)
    np.testing.assert_array_equal((motion.rival_weights > 0).sum(-1), living)
    assert (motion.rival_weights.sum(-1) < 2 / 3 + 1e-6).all()  # no rival has more than the pose
    arm = np.isin(np.arange(body.skeleton.dof), body.skeleton.dofs_of(*LEFT, *RIGHT))
    t = int(np.argmax(living))
    apart = np.abs(motion.rivals[t, 0] - motion.poses[t])
    assert apart[arm].max() > 2 * apart[~arm].max()
    alone = Tracker(body, default(body, particles=32, rivals=1))
    _, estimate = alone.step(alone.start(hidden[0]), frame_of(body, hidden[0]))
    assert motion_of(body, np.zeros(1), [estimate]).rivals is None
