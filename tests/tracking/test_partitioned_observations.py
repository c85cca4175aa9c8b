"""Partitions of the observations: boxes around limbs and the preset built on them."""

import numpy as np

from hypose.tracking.partitioned_observations import (
    boxes_in_views,
)
from hypose.tracking.published_recipes import hpf_apo
from hypose.tracking.tracker import Tracker, TrackerSettings
from tests.tracking.measures import joint_error


def test_the_box_encloses_the_projected_corners(small_rig):
    box = np.array([[-0.3, -0.2, 0.4], [0.2, 0.3, 1.1]])
    boxes = boxes_in_views(box, small_rig)
    corners = np.array([[x, y, z] for x in box[:, 0] for y in box[:, 1] for z in box[:, 2]])
    for camera, (x0, x1, y0, y1) in zip(small_rig, boxes, strict=True):
        uv = camera.project_pinhole(corners)
        inside = np.clip(uv, 0, np.array(camera.size) - 1)
        assert (inside >= [x0, y0]).all() and (inside < [x1, y1]).all()
        # and not much more than that
        assert x1 - x0 <= np.ptp(uv[:, 0]) + 3 and y1 - y0 <= np.ptp(uv[:, 1]) + 3


def test_a_moving_arm_is_followed(body, standing, frame_of):
    poses = np.repeat(standing[None], 4, 0)
    poses[:, body.skeleton.dofs_of("left_elbow")] += np.arange(4)[:, None] * 0.12
    poses[:, 0] += 0.015 * np.arange(4)
    tracker = Tracker(body, hpf_apo(body), TrackerSettings(seed=1))
    state, estimate = tracker.start(standing), None
    for n, pose in enumerate(poses):
        state, estimate = tracker.step(state, frame_of(body, pose, n))
    assert estimate is not None
    assert joint_error(body, estimate.pose, poses[-1]) < 0.04
    assert not estimate.lost
