"""One limb at a time: the best of many poses of it is everybody's, and the start is never lost."""

import numpy as np
import pytest

from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.arm_workspace import in_practice
from hypose.tracking.frame_evidence import frame_energy, prepare
from hypose.tracking.published_recipes import LIMB_LAYERS
from hypose.tracking.recipes import LimbSearch
from hypose.tracking.refinement import COMPOSITE, SOLVED


@pytest.fixture(scope="module")
def search(body):
    s = body.skeleton
    return LimbSearch(s, dict(LIMB_LAYERS)["left_arm"], 2 * s.step_sigma(25.0), *in_practice(s), redrawn=0.25)


@pytest.fixture(scope="module")
def raised(body, standing, search):
    pose = standing.copy()
    pose[search.own] += [0.0] * (len(search.own) - 4) + [-0.3, 0.2, 0.1, 0.4]
    return body.skeleton.clamp(pose)


def at(pose, count=96):
    return Hypotheses.uniform(np.repeat(pose[None], count, 0)).marked(SOLVED, [0]).marked(COMPOSITE, [1])


def test_the_best_limb_is_everybodys_but_the_solved_ones(body, search, standing, raised, frame_of, rng):
    frame = prepare(frame_of(body, raised), body, standing)
    out = search(at(standing), frame, rng).values
    np.testing.assert_array_equal(out[0], standing)
    np.testing.assert_array_equal(out[1:], np.repeat(out[1:2], 95, 0))
    others = np.setdiff1d(np.arange(body.skeleton.dof), search.own)
    np.testing.assert_array_equal(out[1, others], standing[others])
    before, after = frame_energy(np.stack([standing, out[1]]), frame)
    assert after < 0.8 * before
