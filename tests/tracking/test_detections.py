"""Detections in the search: inverse kinematics on an end, the share that adapts, the cost that knows the ends."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.evidence.frame import Detections
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.kernels import stay
from hypose.tracking.detection_kernels import (
    END_NAMES,
    DetectionCost,
    DetectorDriven,
    ends_of,
    found_ends,
    pose_limb,
)
from hypose.tracking.frame_evidence import SilhouetteXor, prepare
from hypose.tracking.recipes import recipe
from hypose.tracking.tracker import Tracker, TrackerSettings

HAND, ANKLE = END_NAMES.index("left_hand"), END_NAMES.index("right_ankle")


def with_detections(frame_of, body, pose, points, names=None, index=0):
    part = [-1] * len(points) if names is None else [END_NAMES.index(n) for n in names]
    found = Detections(np.asarray(points), np.ones(len(points)), np.array(part, dtype=np.int32))
    return replace(frame_of(body, pose, index), detections=found)


@pytest.mark.parametrize("end", [HAND, ANKLE])
def test_a_limb_reaches_what_another_pose_of_it_reached(body, standing, end):
    """Targets made by random poses of the same limb are reached exactly; only that limb moves."""
    s, ends = body.skeleton, ends_of(body)
    joints = ("left_shoulder", "left_elbow") if end == HAND else ("right_hip", "right_knee")
    ball, hinge = map(s.dofs_of, joints)
    rng = np.random.default_rng(3)
    wanted = np.repeat(standing[None], 100, 0)
    wanted[:, ball] += rng.normal(0, 0.3, (100, 3))
    wanted[:, hinge] += rng.uniform(0.1, 0.5, (100, 1))
    targets = ends.positions(body, wanted)[:, end]
    start = np.repeat(standing[None], 100, 0)
    posed = pose_limb(body, ends, end, start, targets, rng.normal(0, 0.2, 100))
    assert np.linalg.norm(ends.positions(body, posed)[:, end] - targets, axis=1).max() < 1e-6
    moved = set(np.flatnonzero(np.abs(posed - start).max(0) > 1e-12))
    assert moved <= {*ball, *hinge}
    assert (posed >= s.lower - 1e-12).all() and (posed <= s.upper + 1e-12).all()


def test_unnamed_detections_go_to_the_nearest_ends_within_limits(body, standing, frame_of):
    ends = ends_of(body)
    now = ends.positions(body, standing[None])[0]
    points = [now[1] + [0.05, 0, 0.02], now[0] + [0, 0.1, 0], now[2] + [0, 0, 1.0]]
    frame = prepare(with_detections(frame_of, body, standing, points), body, standing)
    found = found_ends(body, ends, frame)
    assert set(found) == {0, 1}  # what is a metre above the head is nobody's
    assert np.allclose(found[0], points[1]) and np.allclose(found[1], points[0])


def driven(body, end, **settings):
    own = np.zeros(body.skeleton.dof)
    own[:12] = body.skeleton.step_sigma(25.0)[:12]
    return DetectorDriven(body, ends_of(body), stay, (end,), own, "left", **settings)


@pytest.mark.parametrize("survivors, expected", [(1.0, 0.75), (0.6, 0.65), (0.4, 0.35), (0.0, 0.25)])
def test_the_share_follows_survival_and_keeps_a_quarter_of_each_kind(body, standing, frame_of, survivors, expected):
    ends = ends_of(body)
    target = ends.positions(body, standing[None])[0, HAND] + [0.05, -0.1, 0.1]
    frame = prepare(with_detections(frame_of, body, standing, [target]), body, standing)
    kernel = driven(body, HAND)
    n = 400
    h = Hypotheses.uniform(np.repeat(standing[None], n, 0)).marked(kernel.sorted, np.ones(n, bool))
    h = h.marked(kernel.posed, np.arange(n) < survivors * n)
    moved = kernel(h, frame, np.random.default_rng(1))
    assert moved.has(kernel.posed).mean() == pytest.approx(expected, abs=1e-9)


def test_the_refinement_cost_adds_the_mean_distance_to_the_nearest_end(body, standing, frame_of):
    """Alcoverro 2014, eqs. 2.20 and 2.21."""
    ends = ends_of(body)
    now = ends.positions(body, standing[None])[0]
    points = [now[0] + [0.03, 0, 0], now[2] + [0, 0.05, 0]]
    frame = prepare(with_detections(frame_of, body, standing, points), body, standing)
    plain = SilhouetteXor()
    h = Hypotheses.uniform(standing[None])
    cost = DetectionCost(body, ends, plain, 4.0)(h, frame)
    assert cost[0] == pytest.approx(plain(h, frame)[0] + 4.0 * (0.03 + 0.05) / 2, abs=1e-9)
    nothing = prepare(frame_of(body, standing), body, standing)
    assert (DetectionCost(body, ends, plain, 4.0)(h, nothing) == 0).all()


@pytest.mark.parametrize("name, layers", [("dd-hpf", 7), ("dd-hpf+", 8), ("dd-hpf+5", 6)])
def test_a_jumping_arm_is_found_again_by_its_detection(body, standing, frame_of, name, layers):
    """A forearm that turns by 70 degrees in one frame is out of reach of the diffusion."""
    made = recipe(name, body)
    assert (len(made.layers) - 1, made.particles) == (layers, 500)  # the first moves between frames
    raised = standing.copy()
    raised[body.skeleton.dofs_of("left_elbow")] += 1.2
    ends = ends_of(body)
    tracker = Tracker(body, recipe(name, body, particles=300), TrackerSettings(seed=2))
    state, estimate = tracker.start(standing), None
    for n, pose in enumerate([standing, raised, raised, raised]):
        hands = ends.positions(body, pose[None])[0, :3]
        frame = with_detections(frame_of, body, pose, hands, ("left_hand", "right_hand", "head"), n)
        state, estimate = tracker.step(state, frame)
    assert estimate is not None
    hand = ends.positions(body, estimate.pose[None])[0, HAND]
    assert np.linalg.norm(hand - ends.positions(body, raised[None])[0, HAND]) < 0.06
