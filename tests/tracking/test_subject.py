"""The subject's body from key points and silhouettes, on bodies whose true shape is known."""

import numpy as np
import pytest

from hypose.body.body import Shape, deform
from hypose.errors import EvidenceError
from hypose.evidence.keypoints import keypoint_names
from hypose.pipeline.subject import with_outlines
from hypose.tracking.frame_evidence import keypoint_model
from hypose.tracking.start_search import scaled_to_height
from hypose.tracking.subject import KeypointSubject, subject_from_keypoints


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
    points = model.positions(true, body.skeleton.clamp(poses))
    points[:, ~model.known] = np.nan
    points += rng.normal(0, 0.004, points.shape)
    points[2, 4] = np.nan
    fitted = subject_from_keypoints(body, points, names)
    want, got = true.segment_lengths(), fitted.body.segment_lengths()
    for segment in ("upper_arm", "forearm", "thigh", "shank"):
        assert got[f"left_{segment}"] == pytest.approx(want[f"left_{segment}"], abs=0.008)
    assert np.nanmedian(fitted.residual) < 0.015


def test_an_arm_whose_wrist_is_taken_for_the_other_does_not_stretch_both(body, standing, rng):
    names = keypoint_names("BODY_25")
    model = keypoint_model(body, names)
    poses = np.repeat(standing[None], 12, 0)
    poses[:, 6:] += rng.normal(0, 0.25, (12, poses.shape[1] - 6))
    points = model.positions(body, body.skeleton.clamp(poses))
    points[:, ~model.known] = np.nan
    points[:, names.index("left_wrist")] = points[:, names.index("right_wrist")]
    fitted = subject_from_keypoints(body, points, names)
    want, got = body.segment_lengths(), fitted.body.segment_lengths()
    for side in ("left", "right"):
        assert got[f"{side}_forearm"] == pytest.approx(want[f"{side}_forearm"], abs=0.02)


def test_missing_limb_is_named(body):
    names = keypoint_names("BODY_25")
    points = np.zeros((3, len(names), 3))
    points[:, [names.index(n) for n in names if "ankle" in n.lower()]] = np.nan
    with pytest.raises(EvidenceError, match="shank"):
        subject_from_keypoints(body, points, names)


@pytest.fixture(scope="module")
def different(body, standing):
    """Three poses: standing, an arm lifted, a step with bent elbows; turned."""
    poses = np.repeat(standing[None], 3, 0)
    d = body.skeleton.dofs_of
    poses[1, d("left_shoulder")[1]] -= 0.6
    poses[2, [d("left_hip")[0], d("right_elbow")[0], d("left_elbow")[0]]] -= 0.5
    poses[:, 5] += [0.0, 0.8, 1.6]
    return body.skeleton.clamp(poses)


def _as_fitted(body, poses, residual):
    names = keypoint_names("BODY_25")
    return KeypointSubject(body, keypoint_model(body, names), poses, np.full((len(poses), len(names)), residual))


def test_outlines_tell_the_girths_beside_the_bones(body, different, frame_of):
    wide = {j: 1.15 for j in ("left_hip", "right_hip", "left_knee", "right_knee")}
    true = deform(body, Shape(girth={**wide, **{j: (1.12, 1.12, 1.0) for j in ("pelvis", "spine", "chest")}}))
    frames = [frame_of(true, p, i) for i, p in enumerate(different)]
    fitted, note = with_outlines(_as_fitted(body, different, 0.01), frames)
    assert fitted.coarse.volume == pytest.approx(true.coarse.volume, rel=0.06)
    assert fitted.coarse.volume > 1.05 * body.coarse.volume
    for segment, length in body.segment_lengths().items():
        assert fitted.segment_lengths()[segment] == pytest.approx(length, rel=0.03), segment
    assert "3 poses" in note


def test_masks_of_somebody_else_change_no_body(body, different, frame_of):
    elsewhere = different.copy()
    elsewhere[:, :2] += 1.5
    frames = [frame_of(body, p, i) for i, p in enumerate(elsewhere)]
    assert with_outlines(_as_fitted(body, different, 0.01), frames) is None
