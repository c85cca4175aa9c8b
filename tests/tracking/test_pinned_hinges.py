"""A limb that is turned the wrong way round, its hinge at the limit, is found again; what is straight stays so."""

import dataclasses

import numpy as np
import pytest

from hypose.evidence.frame import Keypoints
from hypose.evidence.keypoints import BODY_25B
from hypose.fitting import SolveSettings, fit_pose
from hypose.geometry import so3_exp, so3_log
from hypose.tracking.costs import keypoint_cost
from hypose.tracking.keypoint_evidence import keypoint_model, keypoint_term
from hypose.tracking.pinned_hinges import unpinned
from hypose.tracking.refinement import anatomical_prior

QUICK = SolveSettings(iterations=6, coarse_iterations=0)


def farthest(body, estimated, true):
    """m: of all joints."""
    return float(np.linalg.norm(body.joints(estimated) - body.joints(true), axis=-1).max())


def term_of(body, pose, rig):
    model = dataclasses.replace(keypoint_model(body, BODY_25B), sd=np.full(len(BODY_25B), 0.03))
    uv = np.stack([c.project_pinhole(model.positions(body, pose)) for c in rig])
    confidence = np.where(model.known, 0.9, 0.0) * np.ones(uv.shape[:2])
    seen = Keypoints(np.concatenate([uv, confidence[..., None]], -1), BODY_25B, rig)
    term = keypoint_term(seen, body, model, pose)
    assert term is not None
    return term


def wrong_way(body, pose, root, hinge):
    """The limb turned by half about itself, and its hinge at the limit."""
    s, out = body.skeleton, pose.copy()
    own, (bend,) = s.dofs_of(root), s.dofs_of(hinge)
    along = s.rest_offsets[s.joint(hinge)]
    out[own] = so3_log(so3_exp(pose[own]) @ so3_exp(np.pi * along / np.linalg.norm(along)))
    out[bend] = s.lower[bend]
    return s.clamp(out)


@pytest.mark.parametrize(("root", "hinge"), [("right_shoulder", "right_elbow"), ("left_shoulder", "left_elbow")])
def test_an_arm_that_is_turned_the_wrong_way_is_found(body, standing, small_rig, root, hinge):
    truth = standing.copy()
    (bend,) = body.skeleton.dofs_of(hinge)
    truth[bend] = body.skeleton.lower[bend] + np.radians(70)
    term, prior = term_of(body, truth, small_rig), (anatomical_prior(body.skeleton, keypoints=True),)
    stuck = fit_pose(body, wrong_way(body, truth, root, hinge), keypoints=term, priors=prior, options=QUICK).pose
    assert farthest(body, stuck, truth) > 0.06
    found = unpinned(body, stuck, term, prior, QUICK)
    assert farthest(body, found, truth) < 0.02
    assert keypoint_cost(body, found[None], term)[0] < keypoint_cost(body, stuck[None], term)[0] - 1


def test_limbs_that_are_straight_stay_as_they_are(body, standing, small_rig):
    straight = standing.copy()
    for hinge in ("left_elbow", "right_elbow", "left_knee", "right_knee"):
        (bend,) = body.skeleton.dofs_of(hinge)
        straight[bend] = body.skeleton.lower[bend]
    term, prior = term_of(body, straight, small_rig), (anatomical_prior(body.skeleton, keypoints=True),)
    pose = fit_pose(body, straight, keypoints=term, priors=prior, options=QUICK).pose
    assert farthest(body, unpinned(body, pose, term, prior, QUICK), straight) < 0.02


def test_a_limb_that_is_bent_is_not_looked_at(body, standing, small_rig):
    bent = standing.copy()
    for hinge in ("left_elbow", "right_elbow", "left_knee", "right_knee"):
        (bend,) = body.skeleton.dofs_of(hinge)
        bent[bend] = body.skeleton.lower[bend] + 0.5
    term, prior = term_of(body, bent, small_rig), (anatomical_prior(body.skeleton, keypoints=True),)
    assert unpinned(body, bent, term, prior, QUICK) is bent
