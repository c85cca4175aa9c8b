"""A motion from one camera that does not lie where the picture shows the person is not to be trusted."""

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.cameras.camera import CameraRig
from hypose.evidence.frame import Frame, Keypoints
from hypose.evidence.keypoints import BODY_25
from hypose.pipeline.one_camera import against_the_picture, image_deviation
from hypose.pipeline.settings import SETTINGS
from hypose.synthetic.scenes import camera_rig
from hypose.tracking.frame_evidence import keypoint_model
from hypose.tracking.start_search import known_pose
from tests.depth_pictures import frame_of

BODY = human()
RIG = CameraRig((camera_rig("humaneva-4", distorted=False)[0],))


def poses(count=10):
    pose = known_pose(BODY, "standing")
    pose[:3] = 0, 0, 0.95
    out = np.tile(pose, (count, 1))
    out[:, 0] += 0.02 * np.arange(count)
    return out


def frames_of(poses, noise=0.0, names=BODY_25):
    model, rng = keypoint_model(BODY, names), np.random.default_rng(0)
    for t, pose in enumerate(poses):
        uv = RIG[0].project_pinhole(model.positions(BODY, pose)) + noise * rng.normal(size=(len(names), 2))
        seen = np.concatenate([uv, np.where(model.known, 0.9, 0.0)[:, None]], 1)
        yield Frame(t / 25, t, keypoints=Keypoints(seen[None], names, RIG))


def with_arms_elsewhere(poses):
    out = poses.copy()
    for side in ("left", "right"):
        shoulder = BODY.skeleton.dofs_of(f"{side}_shoulder")
        out[:, shoulder] = BODY.skeleton.upper[shoulder]
    return BODY.skeleton.clamp(out)


@pytest.mark.parametrize("noise", [0.0, 6.0])
def test_a_body_that_lies_on_its_key_points_is_not_accused(noise):
    share = image_deviation(BODY, poses(), frames_of(poses(), noise))
    assert share.max() < 0.1 and against_the_picture(share) == ()


def test_limbs_elsewhere_in_the_picture_and_another_persons_points_are_told_with_their_frames():
    wrong = poses()
    wrong[2:] = with_arms_elsewhere(wrong[2:])
    share = image_deviation(BODY, wrong, frames_of(poses()))
    assert (share[:2] == 0).all() and (share[2:] > SETTINGS.picture_deviation).all()
    (found,) = against_the_picture(share)
    assert found.fault and all(word in found.sentence for word in ("frames 2-9", "overlay", "--start"))
    share = image_deviation(BODY, poses() + np.eye(BODY.skeleton.dof)[0] * 0.8, frames_of(poses()))
    assert (share > SETTINGS.picture_deviation_frame).all() and against_the_picture(share)


def test_without_key_points_the_mask_tells():
    frames = [frame_of(BODY, pose, RIG, t) for t, pose in enumerate(poses(4))]
    assert (image_deviation(BODY, poses(4), frames) == 0).all()
    moved = poses(4)
    moved[:, 1] += 0.8
    share = image_deviation(BODY, moved, frames)
    assert (share > SETTINGS.picture_deviation_frame).all() and len(against_the_picture(share)) == 1
