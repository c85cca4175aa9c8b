"""A recipe is the whole method: what is published contains nothing that is not printed, what solves says so."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.errors import InputError
from hypose.evidence.terms import PointTerm
from hypose.inference.annealing import SmoothedWeight
from hypose.inference.kernels import GaussianDiffusion
from hypose.inference.layer import Layer, Recipe
from hypose.inference.resampling import systematic
from hypose.tracking import refinement
from hypose.tracking.frame_evidence import SilhouetteXor
from hypose.tracking.recipes import recipe
from hypose.tracking.refinement import pose_mean
from hypose.tracking.tracker import Tracker, TrackerSettings
from tests.tracking.measures import joint_error

PUBLISHED = ("sir", "apf", "partitioned", "hpf", "hpf-apo", "dd-hpf", "dd-hpf+", "dd-hpf+5")
SOLVING = ("default", "hpf+", "dd-hpf+rivals")


@pytest.mark.parametrize("name", PUBLISHED)
def test_what_is_published_never_solves_and_never_recovers(body, standing, frame_of, name, monkeypatch):
    def solve(*args, **kwargs):
        raise AssertionError("a published filter has no contour solve")

    monkeypatch.setattr(refinement, "fit_poses", solve)
    made = recipe(name, body, particles=20)
    assert made.recover is None and made.uncertainty is None and made.smooth is None
    tracker = Tracker(body, made)
    jumped = standing.copy()
    jumped[:2] += [-0.7, 0.5]
    state = tracker.start(standing)
    for t, pose in enumerate([standing, jumped, jumped]):
        state, estimate = tracker.step(state, frame_of(body, pose, t))
    assert np.linalg.norm(estimate.pose[:2] - jumped[:2]) > 0.3 and np.isnan(estimate.exchanged)


@pytest.mark.parametrize("name", SOLVING)
def test_what_solves_mends_a_start_that_is_off(body, standing, frame_of, name):
    made = recipe(name, body, particles=16)
    off = standing.copy()
    off[:2] += 0.06
    tracker = Tracker(body, made)
    _, estimate = tracker.step(tracker.start(off), frame_of(body, standing))
    assert joint_error(body, estimate.pose, standing) < 0.012
    assert made.recover is not None and made.smooth is not None and made.predict(np.ones(2), 1).tolist() == [0.8**2] * 2


def test_a_recipe_is_refused_the_evidence_that_it_needs(body):
    with pytest.raises(InputError, match="'hpf' needs silhouettes"):
        Tracker(body, recipe("hpf", body), TrackerSettings(evidence="keypoints"))
    with pytest.raises(ValueError, match="at least one particle"):
        replace(recipe("hpf", body), particles=0)


def own_recipe(body, particles=150):
    s = body.skeleton
    layer = Layer(
        GaussianDiffusion(0.5 * s.sigma, s.lower, s.upper),
        SmoothedWeight(SilhouetteXor(), survival=0.2),
        systematic,
    )
    return Recipe("mine", [layer] * 4, particles, needs=("silhouettes",), estimate=pose_mean(s))


class Wrist:
    """Where the left wrist is, in every frame."""

    def __init__(self, body, poses, scale_m=0.02):
        self.joint, self.scale_m = body.skeleton.joint("left_wrist"), scale_m
        self.places = body.joints(np.asarray(poses))[:, self.joint]

    def rows(self, body, frame):
        place = self.places[frame.index]
        return PointTerm(place[None], np.ones(1), np.array([self.joint]), np.zeros((1, 3)), self.scale_m)

    def energy(self, body, poses, frame):
        return 2.0 * np.linalg.norm(body.joints(poses)[:, self.joint] - self.places[frame.index], axis=1)


@pytest.mark.parametrize(
    "make", [own_recipe, lambda body: recipe("default", body, particles=16)], ids=["own", "default"]
)
def test_evidence_of_ones_own_finds_an_arm_that_no_mask_shows(body, standing, frame_of, make):
    """One view from the front: a forearm that points at the camera has nearly the outline of one that hangs."""
    raised = standing.copy()
    raised[body.skeleton.dofs_of("left_elbow")] += 1.3
    errors = []
    for own in ((), (Wrist(body, [raised] * 3),)):
        tracker = Tracker(body, make(body), own=own)
        state = tracker.start(standing)
        for t in range(3):
            state, estimate = tracker.step(state, frame_of(body, raised, t, dead=(1, 2, 3)))
        wrist = body.skeleton.joint("left_wrist")
        errors.append(np.linalg.norm(body.joints(estimate.pose)[wrist] - body.joints(raised)[wrist]))
    assert errors[1] < 0.6 * errors[0]
