"""The tracker: follows, reports what it does not know, recovers, and goes on from a saved state alike."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.geometry import so3_exp, so3_log
from hypose.tracking.recipes import recipe
from hypose.tracking.tracker import (
    FOUND,
    Tracker,
    TrackerSettings,
)
from tests.tracking.measures import joint_error


def moving(body, standing, n):
    """A step to the side while the left forearm lifts and the right knee bends."""
    poses = np.repeat(standing[None], n, 0)
    t = np.linspace(0, 1, n)
    poses[:, 0] += 0.25 * t
    poses[:, body.skeleton.dofs_of("left_elbow")[0]] += 1.2 * t
    poses[:, body.skeleton.dofs_of("right_knee")[0]] += 0.7 * t
    return poses


def small(body, name, particles, **options):
    return Tracker(body, recipe(name, body, particles=particles, **options))


def run(tracker, poses, frame_of, dead=lambda t: ()):
    state, estimates = tracker.start(poses[0]), []
    for t, pose in enumerate(poses):
        state, estimate = tracker.step(state, frame_of(tracker.body, pose, t, dead(t)))
        estimates.append(estimate)
    return state, estimates


@pytest.mark.parametrize("seed", range(3))
def test_default_recipe_follows_within_a_centimetre(body, standing, frame_of, seed):
    poses = moving(body, standing, 10)
    # with a third of its particles one draw in six loses an arm here
    tracker = Tracker(body, recipe("default", body), TrackerSettings(seed=seed))
    _, estimates = run(tracker, poses, frame_of)
    errors = [joint_error(body, e.pose, p) for e, p in zip(estimates, poses, strict=True)]
    assert np.mean(errors) < 0.010
    assert not any(e.lost or e.extrapolated for e in estimates)
    assert all(e.n_views == 4 for e in estimates)


@pytest.mark.parametrize("name", ["sir", "apf", "partitioned", "hpf"])
def test_published_recipes_stay_with_the_body(body, standing, frame_of, name):
    poses = moving(body, standing, 20)[:6]
    particles = 600 if name == "sir" else 80
    _, estimates = run(small(body, name, particles), poses, frame_of)
    assert np.mean([joint_error(body, e.pose, p) for e, p in zip(estimates, poses, strict=True)]) < 0.05


def test_without_evidence_it_extrapolates_with_growing_uncertainty(body, standing, frame_of):
    poses = moving(body, standing, 9)
    blind = range(4, 7)
    _, estimates = run(small(body, "default", 128), poses, frame_of, lambda t: (0, 1, 2, 3) if t in blind else ())
    assert [e.extrapolated for e in estimates] == [t in blind for t in range(9)]
    assert estimates[4].n_views == 0
    sd = [e.joint_sd.mean() for e in estimates]
    assert sd[3] < sd[4] < sd[5] < sd[6] and sd[8] < sd[6]
    assert joint_error(body, estimates[8].pose, poses[8]) < 0.02


def test_a_jump_is_noticed_and_recovered(body, standing, frame_of):
    jumped = standing.copy()
    jumped[:2] += [-0.7, 0.5]
    jumped[5] += 1.0
    poses = np.stack([standing] * 4 + [jumped] * 3)
    _, estimates = run(small(body, "default", 16), poses, frame_of)
    assert joint_error(body, estimates[-1].pose, jumped) < 0.05
    assert not estimates[-1].lost


def upside_down(body, pose):
    """The pose (D,) on its head, its middle where it was."""
    out = pose.copy()
    out[3:6] = so3_log(so3_exp(pose[3:6]) @ so3_exp([np.pi, 0.0, 0.0]))
    out[:3] += body.skin(pose).mean(0) - body.skin(out).mean(0)
    return out


@pytest.mark.parametrize("first", [0, 5], ids=["start", "later"])
def test_a_body_that_is_wrong_from_the_start_is_looked_for_whatever_is_usual(body, standing, frame_of, first):
    tracker = Tracker(body, recipe("default", body, particles=16), TrackerSettings(rival_every=0.06))
    state = replace(tracker.start(upside_down(body, standing)), frames=first, usual_iou=float("nan"))
    frames = [frame_of(body, standing, t) for t in range(7)]
    estimates = [estimate for _, estimate in tracker.follow(state, frames)]
    assert joint_error(body, estimates[-1].pose, standing) < 0.05
    found = [e.exchanged for e in estimates if e.exchanged > FOUND]
    assert len(found) == 1  # it is said, so that the frames before can be tracked again
    assert not any(e.lost for e in estimates)
