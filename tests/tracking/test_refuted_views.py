"""Key points and a mask that cannot be of one person: what speaks against the expected body is left out."""

import dataclasses

import numpy as np
import pytest

from hypose.evidence.frame import Keypoints
from hypose.evidence.keypoints import BODY_25B
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.keypoint_evidence import keypoint_model
from hypose.tracking.refuted_views import without_refuted


@pytest.fixture
def model(body):
    return keypoint_model(body, BODY_25B)


@pytest.fixture
def frame(body, model, standing, frame_of, small_rig):
    uv = np.stack([c.project_pinhole(model.positions(body, standing)) for c in small_rig])
    confidence = np.where(model.known, 0.9, 0.0) * np.ones(uv.shape[:2])
    points = Keypoints(np.concatenate([uv, confidence[..., None]], -1), BODY_25B, small_rig)
    return dataclasses.replace(frame_of(body, standing), keypoints=points)


def shifted(keypoints, view, pixels):
    points = keypoints.points.copy()
    points[view, :, 0] += pixels
    return dataclasses.replace(keypoints, points=points)


def test_what_agrees_stays_as_it_is(body, model, frame, standing):
    points, masks = without_refuted(frame.keypoints, frame.silhouettes, body, model, standing)
    assert points is frame.keypoints and masks is frame.silhouettes


def test_key_points_beside_the_mask_count_nothing_where_the_body_is_in_the_mask(body, model, frame, standing):
    wrong = shifted(frame.keypoints, 2, 25.0)
    points, masks = without_refuted(wrong, frame.silhouettes, body, model, standing)
    assert (points.points[2, :, 2] == 0).all()
    np.testing.assert_array_equal(points.points[[0, 1, 3]], wrong.points[[0, 1, 3]])
    assert masks is frame.silhouettes
    term = prepare(dataclasses.replace(frame, keypoints=wrong), body, standing, use_keypoints=True).keypoints
    assert term is not None
    assert (term.points[2, :, 2] == 0).all() and (term.points[1, :, 2] > 0).any()


def test_a_mask_of_somebody_else_counts_nothing_where_the_points_are_those_of_the_body(body, model, frame, standing):
    masks = frame.silhouettes.masks.copy()
    masks[1] = np.roll(masks[1], 45, axis=1)
    wrong = dataclasses.replace(frame.silhouettes, masks=masks)
    points, found = without_refuted(frame.keypoints, wrong, body, model, standing)
    assert points is not None and (points.points[..., 2] == frame.keypoints.points[..., 2]).all()
    assert found.usable.tolist() == [True, False, True, True]
    assert "the mask is not where the key points are" in found.reasons[1]
