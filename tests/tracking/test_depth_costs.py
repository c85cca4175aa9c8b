"""What depth maps cost poses in a search, and what silhouettes' doubts are worth where depth cameras see."""

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.evidence.cues import MEASURED
from hypose.tracking.arm_hypotheses import LookedUp, rival_arms
from hypose.tracking.arm_workspace import ArmReach, in_practice
from hypose.tracking.frame_evidence import frame_energy, limb_energy, prepare
from hypose.tracking.start_search import known_pose
from tests.depth_pictures import frame_of, sensors

BODY = human()


@pytest.fixture(scope="module")
def frame():
    pose = known_pose(BODY, "standing")
    pose[:3] = 0.0, 0.0, 0.95
    return prepare(frame_of(BODY, pose, sensors(1)), BODY, pose)


def test_of_many_arms_those_that_may_win_are_measured_and_the_best_is_the_best_of_all(frame, rng):
    s = BODY.skeleton
    moving = np.isin(np.arange(len(s.joint_names)), [s.joint("left_shoulder"), s.joint("left_elbow")])
    own = moving[s.tree.joint_of_dof]
    here = s.clamp(frame.prediction + 0.3 * own * rng.normal(size=s.dof))
    poses = np.stack([here] + [s.clamp(here + 0.4 * own * rng.normal(size=s.dof)) for _ in range(150)])
    found = limb_energy(poses, frame, moving)
    whole = frame_energy(poses, frame)
    known = np.isfinite(found)
    assert known[0] and 1 < known.sum() <= MEASURED
    assert found[known] == pytest.approx(whole[known], abs=1e-5)
    assert found.argmin() == whole.argmin()


def test_an_arm_that_is_seen_where_it_is_is_looked_for_nowhere_else(frame, monkeypatch):
    s = BODY.skeleton
    arm = ArmReach(BODY, ("left_clavicle", "left_shoulder", "left_elbow"), *in_practice(s))

    def is_seen(pose):
        return frame.depth.shows_arm(BODY, frame.depth.standing(BODY, pose, arm.moving), s.joint("left_shoulder"))

    other = frame.prediction.copy()
    other[s.dofs_of("left_shoulder")] -= (0, 1.2, 0)
    assert is_seen(frame.prediction) and not is_seen(other)
    assert len(rival_arms(arm, other, frame, LookedUp()))
    monkeypatch.setattr("hypose.tracking.arm_hypotheses.limb_energy", None)
    assert rival_arms(arm, frame.prediction, frame, LookedUp()) == []
