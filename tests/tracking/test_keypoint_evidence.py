"""Key points: exchanged sides, somebody else's points, offsets and noise measured on the clip."""

import dataclasses

import numpy as np
import pytest

from hypose.errors import EvidenceError
from hypose.evidence.frame import Frame, Keypoints
from hypose.evidence.keypoints import BODY_25B
from hypose.tracking.frame_evidence import check_sides_and_views, keypoint_model, pixels_per_metre, prepare
from hypose.tracking.keypoint_offsets import calibrate_keypoints

LEGS = ("hip", "knee", "ankle")
WHOLE_LEGS = (*LEGS, "big_toe", "small_toe", "heel")


@pytest.fixture
def model(body):
    return keypoint_model(body, BODY_25B)


@pytest.fixture
def walking(body, standing, rng):
    """Poses (12, D): standing, with limbs and trunk moved."""
    noise = rng.normal(size=(12, body.skeleton.dof)) * 0.25
    noise[:, :6] *= 0.3
    return body.skeleton.clamp(standing + noise)


def seen_by(rig, model, body, pose, rng=None, noise_px=0.0):
    points = model.positions(body, pose)
    uv = np.stack([camera.project_pinhole(points) for camera in rig])
    if noise_px:
        uv = uv + noise_px * rng.normal(size=uv.shape)
    confidence = np.where(model.known, 0.9, 0.0) * np.ones(uv.shape[:2])
    return Keypoints(np.concatenate([uv, confidence[..., None]], -1), model.names, rig)


def with_points(keypoints, points):
    return Keypoints(points, keypoints.names, keypoints.rig)


def exchanged(keypoints, view, parts):
    """Left and right of the parts exchanged in one view."""
    points = keypoints.points.copy()
    for part in parts:
        a, b = (keypoints.names.index(f"{side}_{part}") for side in ("left", "right"))
        points[view, [a, b]] = points[view, [b, a]]
    return with_points(keypoints, points)


@pytest.mark.parametrize("parts", [WHOLE_LEGS, LEGS, ("knee",), ("ankle",)])
def test_exchanged_legs_are_put_right(body, model, standing, small_rig, parts):
    given = seen_by(small_rig, model, body, standing)
    expected = given.points[..., :2] + 2.0
    size = pixels_per_metre(given, standing[:3])
    wrong = exchanged(given, 1, parts)
    assert not np.allclose(wrong.points, given.points)
    # hips lie nearer together than the threshold: the outer parts decide
    right = check_sides_and_views(wrong.points, expected, model.names, size)
    ankles = [BODY_25B.index(f"{side}_{part}") for part in ("knee", "ankle") for side in ("left", "right")]
    np.testing.assert_allclose(right[1, ankles], given.points[1, ankles])
    np.testing.assert_allclose(right[[0, 2, 3]], given.points[[0, 2, 3]])


def test_somebody_else_is_left_out_but_only_where_others_agree(body, model, standing, small_rig):
    given = seen_by(small_rig, model, body, standing)
    size = pixels_per_metre(given, standing[:3])
    expected = given.points[..., :2].copy()
    points = given.points.copy()
    points[2, :, 0] += 1.5 * size[2]
    out = check_sides_and_views(points, expected, model.names, size)
    assert (out[2, :, 2] == 0).all()
    np.testing.assert_array_equal(out[[0, 1, 3]], points[[0, 1, 3]])
    everywhere = given.points.copy()
    everywhere[..., 0] += 1.5 * size[:, None]  # the person jumped, or the expectation is wrong
    assert (check_sides_and_views(everywhere, expected, model.names, size)[..., 2] == everywhere[..., 2]).all()


def test_offsets_and_noise_are_found(body, model, walking, small_rig, rng):
    shift = np.zeros_like(model.offset)
    shift[BODY_25B.index("left_ankle")] = [0.02, 0.0, 0.0]
    shift[BODY_25B.index("nose")] = [0.0, -0.03, 0.04]
    true = dataclasses.replace(model, offset=model.offset + shift)
    frames = [seen_by(small_rig, true, body, q, rng, 0.3) for q in walking]
    found = calibrate_keypoints(body, model, frames)
    assert np.linalg.norm(found.offset - true.offset, axis=1)[model.known].max() < 0.02
    nose = BODY_25B.index("nose")
    assert np.linalg.norm(found.offset[nose] - true.offset[nose]) < 0.5 * np.linalg.norm(shift[nose])
    assert found.sd is not None
    rough = [seen_by(small_rig, true, body, q, rng, 3.0) for q in walking]
    noisy = calibrate_keypoints(body, model, rough)
    assert noisy.sd is not None and np.median(noisy.sd) > 2 * np.median(found.sd)


def test_no_frame_with_points_is_said(body, model, small_rig):
    nothing = Keypoints(np.zeros((len(small_rig), len(BODY_25B), 3)), BODY_25B, small_rig)
    with pytest.raises(EvidenceError, match="6 triangulated key points"):
        calibrate_keypoints(body, model, [nothing])


def test_another_set_of_points_is_refused(body, model, standing, small_rig):
    frame = Frame(0.0, 3, keypoints=seen_by(small_rig, model, body, standing))
    other = keypoint_model(body, BODY_25B[:10])
    with pytest.raises(EvidenceError, match="Frame 3 has other key points"):
        prepare(frame, body, standing, use_silhouettes=False, use_keypoints=True, keypoints_on_body=other)
