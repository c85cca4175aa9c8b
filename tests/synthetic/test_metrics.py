import numpy as np
import pytest

from hypose.body.default_body import JOINT_NAMES, human
from hypose.errors import InputError
from hypose.synthetic.metrics import EVALUATED_JOINTS, coverage, joint_errors, population_offsets, with_offsets
from hypose.synthetic.motions import act
from tests.tailed import tailed


def test_errors_are_distances_of_fifteen_joints():
    truth, estimated = np.zeros((3, 19, 3)), np.zeros((3, 19, 3))
    estimated[:, JOINT_NAMES.index("left_wrist"), 1] = 0.3
    estimated[:, JOINT_NAMES.index("spine"), 1] = 9.0  # not one of them
    truth[1] = np.nan
    errors = joint_errors(estimated, truth)
    assert errors.shape == (3, 15) and np.isnan(errors[1]).all()
    assert errors[0].tolist() == [0.3 if n == "left_wrist" else 0.0 for n in EVALUATED_JOINTS]
    with pytest.raises(InputError, match="same frames"):
        joint_errors(estimated, truth[:2])


def test_fixed_offsets_are_removed_in_the_segments_frames(person):
    p = act("box", person, 2.0, 25.0, np.random.default_rng(0))
    found = np.random.default_rng(1).normal(0, 0.02, (19, 3))
    truth = with_offsets(p.joints, p.rotations, found)
    assert joint_errors(p.joints, truth, found, p.rotations).max() < 1e-12
    assert joint_errors(p.joints, truth).mean() > 0.01


def test_offsets_of_the_population_are_small_and_without_a_common_shift():
    found = population_offsets(human())[[JOINT_NAMES.index(n) for n in EVALUATED_JOINTS]]
    assert np.abs(found.mean(0)).max() < 1e-12 and 0.001 < np.linalg.norm(found, axis=1).max() < 0.01


def test_coverage_of_errors_that_are_as_said_is_the_level():
    rng = np.random.default_rng(0)
    truth = np.zeros((4000, 2, 3))
    sd = np.full((4000, 2), 0.03)
    estimated = truth + tailed(rng, truth.shape) * np.array([0.03, 0.06])[None, :, None]
    c = coverage(estimated, sd, truth)
    for level in (0.5, 0.9, 0.95):
        assert c[level][0] == pytest.approx(level, abs=0.025)
        assert c[level][1] < level - 0.1
    full = coverage(estimated, np.eye(3) * 0.03**2 * np.ones((4000, 2, 1, 1)), truth)
    assert np.allclose(full[0.9], c[0.9])
    sd[:, 1] = np.nan
    assert np.isnan(coverage(estimated, sd, truth)[0.9][1])
