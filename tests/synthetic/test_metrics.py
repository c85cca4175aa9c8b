import numpy as np
import pytest

from hypose.body.default_body import JOINT_NAMES
from hypose.errors import InputError
from hypose.synthetic.metrics import (
    EVALUATED,
    EVALUATED_JOINTS,
    coverage,
    definition_offsets,
    joint_errors,
    with_offsets,
)
from hypose.synthetic.motions import act
from tests.tailed import tailed


def test_fifteen_joints():
    assert len(EVALUATED_JOINTS) == 15 == len(set(EVALUATED_JOINTS))
    assert [JOINT_NAMES[j] for j in EVALUATED] == list(EVALUATED_JOINTS)


def test_errors_by_hand():
    truth = np.zeros((4, 19, 3))
    estimated = np.zeros((4, 19, 3))
    estimated[:, :, 0] = np.array([0.01, 0.03, 0.05, 0.15])[:, None]  # frame means 10, 30, 50, 150 mm
    e = joint_errors(estimated, truth)
    assert e.mean == pytest.approx(0.06)
    assert e.sd == pytest.approx(np.std([0.01, 0.03, 0.05, 0.15]))
    assert e.median == pytest.approx(0.04)
    assert e.lost_share == 0.25


def test_one_lost_hand_shows_in_p95_and_unlisted_joints_do_not_count():
    truth, estimated = np.zeros((10, 19, 3)), np.zeros((10, 19, 3))
    estimated[:, JOINT_NAMES.index("left_wrist"), 1] = 0.3
    estimated[:, JOINT_NAMES.index("spine"), 1] = 9.0
    e = joint_errors(estimated, truth)
    assert e.mean == pytest.approx(0.3 / 15) and e.median == 0
    assert e.p95 == pytest.approx(0.3)


def test_missing_frames_are_left_out():
    truth, estimated = np.zeros((3, 19, 3)), np.full((3, 19, 3), 0.0)
    estimated[:, :, 2] = 0.02
    truth[1] = np.nan
    assert joint_errors(estimated, truth).mean == pytest.approx(0.02)


def test_fixed_offsets_are_removed_in_the_segments_frames(person):
    p = act("box", person, 2.0, 25.0, np.random.default_rng(0))
    found = np.random.default_rng(1).normal(0, 0.02, (19, 3))
    truth = with_offsets(p.joints, p.rotations, found)
    assert joint_errors(p.joints, truth, found, p.rotations).mean < 1e-12
    assert joint_errors(p.joints, truth).mean > 0.01
    with pytest.raises(InputError, match="rotations"):
        joint_errors(p.joints, truth, found)


def test_definition_offsets_know_scale_and_place_but_no_subject(person):
    moved = person.joints * 1.1 + [0.1, 0.2, -0.3]
    assert np.allclose(definition_offsets(person.joints, moved, 1.7, 1.87), 0, atol=1e-12)
    other = person.joints.copy()
    k = JOINT_NAMES.index("neck")
    other[k, 2] += 0.034
    found = definition_offsets(person.joints, other, 1.7, 1.7)
    assert found[k, 2] == pytest.approx(0.02 * 14 / 15)
    assert np.abs(found[:, :2]).max() < 1e-12


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
