"""What is said of a clip does not depend on which way the person faces in the world."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.multiview.error_scenes import Case, scene_without_masks, without_masks
from hypose.body.joint_angles import ANGLE_NAMES
from hypose.cameras.camera import CameraRig
from hypose.geometry import se3, so3_exp
from hypose.pipeline.sources import FrameList
from hypose.pipeline.track import track_source
from hypose.pipeline.track_options import TrackOptions


def turned(frames, angle):
    """The frames with a world that is turned by an angle about the vertical: its cameras alone know."""
    back = se3(so3_exp(np.array([0, 0, -angle])), np.zeros(3))
    out = []
    for f in frames:
        k = f.keypoints
        rig = CameraRig(tuple(replace(c, camera_from_world=c.camera_from_world @ back) for c in k.rig))
        out.append(replace(f, keypoints=replace(k, rig=rig)))
    return out


@pytest.fixture(scope="module")
def clip():
    scene, frames = scene_without_masks(Case("walk", "ring-4"), 41, 1.2)
    return scene.frame_rate, without_masks(frames)


@pytest.fixture(scope="module")
def facing_along_x(clip):
    return track(clip, 0.0)


def track(clip, angle):
    rate, frames = clip
    return track_source(FrameList(turned(frames, angle), rate), rate, TrackOptions(evidence="keypoints"))


@pytest.mark.parametrize("degrees", [60, 90, 150, 330])
def test_a_turned_clip_is_judged_alike(clip, facing_along_x, degrees):
    found, plain = track(clip, np.radians(degrees)), facing_along_x
    back = so3_exp(np.array([0, 0, -np.radians(degrees)]))
    away = np.linalg.norm(found.motion.joints @ back.T - plain.motion.joints, axis=-1)
    assert away.mean() < 5e-4 and away.max() < 0.01  # the solver stops at a thousandth of a radian
    around = back @ found.motion.joint_covariance.astype(np.float64) @ back.T
    limit = 0.05 * np.trace(plain.motion.joint_covariance, axis1=2, axis2=3)[..., None, None]
    assert (np.abs(around - plain.motion.joint_covariance) <= limit).all()
    own = [not n.startswith("pelvis") for n in ANGLE_NAMES]  # those of the pelvis are about the axes of the world
    np.testing.assert_allclose(found.motion.angle_sd[:, own], plain.motion.angle_sd[:, own], rtol=0.05)
    np.testing.assert_allclose(found.motion.error_probability, plain.motion.error_probability, rtol=0.05, atol=2e-3)
    np.testing.assert_array_equal(found.motion.low_confidence_joints, plain.motion.low_confidence_joints)
    assert found.assessment.word == plain.assessment.word
