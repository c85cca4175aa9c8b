"""Every kind of evidence, found by discovery: a new one needs an entry below, or these tests fail."""

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.evidence.cues import NO_DEPTH, NO_KEYPOINTS, NO_SILHOUETTES
from hypose.evidence.frame import Keypoints
from hypose.evidence.terms import Evidence, PointTerm
from hypose.fitting import Quadratic, SolveSettings, fit_pose
from hypose.tracking.frame_evidence import keypoint_model, prepare
from hypose.tracking.start_search import known_pose
from tests.depth_pictures import frame_of, sensors

BODY, RIG = human(), sensors(2)
S = BODY.skeleton
TRUTH = known_pose(BODY, "standing")
TRUTH[:3] = 0.02, -0.05, 0.95


class Tags:
    """Joints that say where they are."""

    def rows(self, body, frame):
        joint = np.arange(len(S.parents))
        return PointTerm(body.joints(TRUTH), np.ones(len(joint)), joint, np.zeros((len(joint), 3)), 0.02)

    def energy(self, body, poses, frame):
        return np.linalg.norm(body.joints(poses) - body.joints(TRUTH), axis=-1).mean(1)


def prepared():
    model = keypoint_model(BODY, tuple(S.joint_names))
    uv = np.stack([camera.project_pinhole(model.positions(BODY, TRUTH)) for camera in RIG])
    points = Keypoints(np.concatenate([uv, np.ones((*uv.shape[:2], 1))], -1), model.names, RIG)
    frame = frame_of(BODY, TRUTH, RIG, keypoints=points)
    return prepare(frame, BODY, TRUTH, use_keypoints=True, own=[Tags()])


FRAME = prepared()
KINDS = {type(one).__name__: one for one in FRAME.evidence}
NOTHING = (NO_SILHOUETTES, NO_KEYPOINTS, NO_DEPTH)


def test_every_kind_of_evidence_is_tested_here():
    assert set(KINDS) == {kind.__name__ for kind in Evidence.__subclasses__()}


@pytest.mark.parametrize("name", KINDS)
def test_energies_are_of_each_pose_alone(name, rng):
    poses = S.clamp(TRUTH + 0.05 * rng.normal(size=(20, S.dof)))
    before, order = poses.copy(), rng.permutation(20)
    found = KINDS[name].energy(BODY, poses)
    assert found.shape == (20,) and np.isfinite(found).all() and (found >= 0).all()
    np.testing.assert_array_equal(KINDS[name].energy(BODY, poses[order]), found[order])
    for n in (3, 4):  # one by one, and again from memory
        np.testing.assert_allclose(KINDS[name].energy(BODY, poses[n : n + 1]), found[n : n + 1], rtol=1e-9)
        np.testing.assert_allclose(KINDS[name].energy(BODY, poses[n : n + 1]), found[n : n + 1], rtol=1e-9)
    np.testing.assert_array_equal(poses, before)


@pytest.mark.parametrize("name", KINDS)
def test_a_solve_lowers_the_cost_of_its_terms(name, rng):
    start = S.clamp(TRUTH + np.r_[[0.02] * 3, [0.05] * (S.dof - 3)] * rng.normal(size=S.dof))
    weak = [Quadratic(start, np.full(S.dof, 1e-2))]
    costs = [fit_pose(BODY, start, KINDS[name].terms, priors=weak, options=SolveSettings(n, 0)).cost for n in (0, 8)]
    assert costs[1] < 0.8 * costs[0]


@pytest.mark.parametrize("nothing", NOTHING)
def test_what_a_frame_does_not_have_says_nothing(nothing):
    np.testing.assert_array_equal(nothing.energy(BODY, np.stack([TRUTH, TRUTH])), [0, 0])
    assert not nothing.seen and nothing.terms == ()
    assert not np.any(NO_KEYPOINTS.cost(BODY, TRUTH[None])) and not len(NO_SILHOUETTES.overlap(BODY, TRUTH))
