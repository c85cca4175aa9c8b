"""The subject's body from key points and silhouettes, on bodies whose true shape is known."""

import numpy as np
import pytest

from hypose.body.body import Shape, deform
from hypose.errors import EvidenceError
from hypose.evidence.keypoints import keypoint_names
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.keypoint_evidence import keypoint_model
from hypose.tracking.subject import fit_girths, scaled_to_height, subject_from_keypoints


def test_height_scales_everything(body):
    tall = scaled_to_height(body, 1.95)
    assert tall.stature == pytest.approx(1.95, abs=1e-6)
    k = tall.stature / body.stature
    for name, length in body.segment_lengths().items():
        assert tall.segment_lengths()[name] == pytest.approx(k * length)


@pytest.mark.parametrize("height", [0.2, 170.0])
def test_absurd_height_is_refused(body, height):
    with pytest.raises(EvidenceError, match="metres"):
        scaled_to_height(body, height)


def test_lengths_from_keypoints_of_another_body(body, standing, rng):
    shape = Shape(
        1.06,
        {
            "left_shoulder": 1.08,
            "right_shoulder": 1.08,
            "left_knee": 0.93,
            "right_knee": 0.93,
            "left_elbow": 1.1,
            "right_elbow": 1.1,
        },
    )
    true = deform(body, shape)
    names = keypoint_names("BODY_25")
    model = keypoint_model(true, names)
    poses = np.repeat(standing[None], 8, 0)
    poses[:, 6:] += rng.normal(0, 0.12, (8, poses.shape[1] - 6))
    poses = body.skeleton.clamp(poses)
    rotations, centres = true.skeleton.forward(poses)
    points = centres[:, model.joint] + np.einsum("tkab,kb->tka", rotations[:, model.joint], model.offset)
    points[:, ~model.known] = np.nan
    points += rng.normal(0, 0.004, points.shape)
    points[2, 4] = np.nan
    fitted = subject_from_keypoints(body, points, names)
    want, got = true.segment_lengths(), fitted.body.segment_lengths()
    for segment in ("upper_arm", "forearm", "thigh", "shank"):
        assert got[f"left_{segment}"] == pytest.approx(want[f"left_{segment}"], abs=0.008)
    assert np.nanmedian(fitted.residual) < 0.015


def test_missing_limb_is_named(body):
    names = keypoint_names("BODY_25")
    points = np.zeros((3, len(names), 3))
    points[:, [names.index(n) for n in names if "ankle" in n.lower()]] = np.nan
    with pytest.raises(EvidenceError, match="shank"):
        subject_from_keypoints(body, points, names)


def test_girths_recover_a_wider_body(body, standing, frame_of):
    wide = {j: 1.15 for j in ("left_hip", "right_hip", "left_knee", "right_knee")}
    true = deform(body, Shape(girth={**wide, **{j: (1.12, 1.12, 1.0) for j in ("pelvis", "spine", "chest")}}))
    lifted = standing.copy()
    lifted[body.skeleton.dofs_of("left_shoulder")[1]] -= 0.5
    poses = np.stack([standing, lifted])
    frames = [prepare(frame_of(true, p, i), body, p) for i, p in enumerate(poses)]
    fitted, _, before, after = fit_girths(body, poses, frames)
    assert after < 0.6 * before
    assert fitted.coarse.volume == pytest.approx(true.coarse.volume, rel=0.06)
