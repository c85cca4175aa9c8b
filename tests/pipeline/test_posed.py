import numpy as np
import pytest

from hypose.errors import InputError
from hypose.fusion.fuse import fuse_clip
from hypose.pipeline.sensor_skeletons import SENSOR_JOINT_NAMES, pose_fused
from tests.fusion.people import moving_person, seen


def fused_points(rng, frames):
    still = (np.eye(3)[None], np.zeros((1, 3)))  # one sensor that reports in the world
    return fuse_clip(seen(moving_person(frames), still, rng, noise=0.003))


@pytest.mark.slow
def test_the_body_follows_the_fused_limbs_and_keeps_its_bones(rng):
    fused = fused_points(rng, 20).motion
    body, motion = pose_fused(fused)
    assert motion.poses.shape == (20, 36)
    judged = np.isfinite(motion.error_probability).all(0)  # the spine and the clavicles are seen by no sensor
    assert judged[motion.skeleton.joint("left_wrist")]
    assert not judged[motion.skeleton.joint("spine")]
    limbs = [n for n in SENSOR_JOINT_NAMES if any(x in n for x in ("elbow", "wrist", "knee", "ankle"))]
    for name in limbs:
        own = name.replace("wrist", "hand").replace("ankle", "foot")
        there = fused.joints[:, fused.skeleton.joint(own)]
        assert np.linalg.norm(motion.joints[:, motion.skeleton.joint(name)] - there, axis=-1).mean() < 0.03
    elbow, wrist = (motion.skeleton.joint(n) for n in ("left_elbow", "left_wrist"))
    assert np.ptp(np.linalg.norm(motion.joints[:, elbow] - motion.joints[:, wrist], axis=-1)) < 1e-9
    assert body.segment_lengths()["left_forearm"] == pytest.approx(0.284, abs=0.03)


def test_too_few_joints_are_refused(rng):
    fused = fused_points(rng, 3).motion
    fused.joints[:, 3:] = np.nan
    with pytest.raises(InputError, match="No frame of the fused motion has 8 joints"):
        pose_fused(fused)
