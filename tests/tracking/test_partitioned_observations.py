"""Partitions of the observations: boxes around limbs, the cost inside them, and the presets built on it."""

import numpy as np
import pytest

from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.partitioned_observations import (
    PartitionedXor,
    boxes_in_views,
    partitioned_energy,
)
from hypose.tracking.published_recipes import HPF_LAYERS, hpf_apo, hpf_apo_plus, layer_regions
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


def test_parts_of_later_layers_are_not_drawn(body, standing, frame_of):
    regions = layer_regions(body, bounding=False)
    assert len(regions) == len(HPF_LAYERS) + 1
    counts = [int(faces.sum()) for _, faces in regions]
    assert all(a < b for a, b in zip(counts[:-2], counts[1:-1], strict=True))
    assert counts[-1] == len(body.coarse.faces)
    frame = prepare(frame_of(body, standing), body, standing)
    h = Hypotheses.uniform(np.repeat(standing[None], 3, 0))
    bent = h.values.copy()
    bent[1, body.skeleton.dofs_of("right_elbow")] += 0.6  # not drawn while the upper arm is searched
    region, faces = regions[4]
    drawn = PartitionedXor(body, region)(Hypotheses.uniform(bent), frame)
    upper_arm = PartitionedXor(body, region, faces)(Hypotheses.uniform(bent), frame)
    # what is left is the skin about the elbow, which follows both bones
    assert abs(upper_arm[1] - upper_arm[0]) < 0.35 * abs(drawn[1] - drawn[0])


def test_the_whole_box_gives_the_plain_cost_on_another_scale(body, standing, frame_of):
    """Eq. 2.15 with Omega = everything is eq. 2.14 with the image's pixels in place of the silhouette's."""
    frame = prepare(frame_of(body, standing), body, standing)
    assert frame.frame.silhouettes is not None
    sizes = frame.frame.silhouettes.rig.sizes
    boxes = np.stack([0 * sizes[:, 0], sizes[:, 0], 0 * sizes[:, 1], sizes[:, 1]], 1)
    moved = standing[None].copy()
    moved[0, 0] += 0.05
    per_view = partitioned_energy(body, moved, frame, boxes)[0] * sizes.prod(1).mean()
    plain = frame.silhouettes.energy(body, moved)[0] * frame.silhouettes.masks.areas.mean()
    assert per_view == pytest.approx(plain, rel=0.1)


@pytest.mark.parametrize("make", [hpf_apo, hpf_apo_plus])
def test_a_moving_arm_is_followed(body, standing, frame_of, make):
    poses = np.repeat(standing[None], 4, 0)
    poses[:, body.skeleton.dofs_of("left_elbow")] += np.arange(4)[:, None] * 0.12
    poses[:, 0] += 0.015 * np.arange(4)
    tracker = Tracker(body, make(body, 150), TrackerSettings(seed=1))
    state, estimate = tracker.start(standing), None
    for n, pose in enumerate(poses):
        state, estimate = tracker.step(state, frame_of(body, pose, n))
    assert estimate is not None
    assert joint_error(body, estimate.pose, poses[-1]) < 0.03
    assert not estimate.lost
