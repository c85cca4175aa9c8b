"""Sides exchanged: which of the two the silhouettes prefer."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.evidence.keypoints import BODY_25
from hypose.tracking.frame_evidence import keypoint_model, prepare
from hypose.tracking.left_right import limbs_exchanged, look_for_exchange
from tests.tracking.test_keypoint_evidence import exchanged, seen_by


def striding(body, standing):
    """A step with a bent knee and a raised forearm: neither can be had from behind."""
    s, pose = body.skeleton, standing.copy()
    pose[s.dofs_of("left_hip")[0]] -= 0.5
    pose[s.dofs_of("right_knee")[0]] += 0.9
    pose[s.dofs_of("left_elbow")[0]] += 1.2
    return pose


def facing(body, pose):
    """(2,) the horizontal direction of the trunk's front."""
    rotations, _ = body.skeleton.forward(pose[None])
    ahead = -rotations[0, 0, :2, 1]
    return ahead / np.linalg.norm(ahead)


@pytest.mark.parametrize("heading", [0.0, 0.8, 2.5])
def test_silhouettes_prefer_the_body_the_right_way_round(body, standing, frame_of, heading):
    pose = striding(body, standing)
    pose[5] += heading
    frame = prepare(frame_of(body, pose, 0), body, pose)
    gain, turned = look_for_exchange(pose, frame)
    assert gain < -0.01
    back, found = look_for_exchange(turned, frame)
    assert back > 0.01
    assert facing(body, found) @ facing(body, pose) > 0.9


def test_beside_key_points_arms_are_tried_as_well(body, standing, frame_of):
    s, pose = body.skeleton, standing.copy()
    pose[s.dofs_of("left_shoulder")[0]] -= 1.0  # one arm forwards, the other bent aside
    pose[s.dofs_of("right_elbow")[0]] += 1.4
    pose = s.clamp(pose)
    frame = frame_of(body, pose, 0)
    model = keypoint_model(body, BODY_25)
    # called by the other side's names in all views
    points = exchanged(seen_by(frame.silhouettes.rig, model, body, pose), slice(None), ("shoulder", "elbow", "wrist"))
    frame = replace(frame, keypoints=points)
    wrists = [s.joint("left_wrist"), s.joint("right_wrist")]
    wrong = limbs_exchanged(body, pose, "arms")
    there, crossed = body.joints(np.stack([pose, wrong]))[:, wrists]
    assert np.linalg.norm(crossed - there, axis=-1).min() > 0.15
    prepared = prepare(frame, body, wrong, use_keypoints=True, keypoints_on_body=model)
    gain, found = look_for_exchange(wrong, prepared)
    assert gain > 0.01
    assert np.linalg.norm(body.joints(found[None])[0, wrists] - there, axis=-1).max() < 0.06
    prepared = prepare(frame, body, pose, use_keypoints=True, keypoints_on_body=model)
    assert look_for_exchange(pose, prepared)[0] < 0.0
