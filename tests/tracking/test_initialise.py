"""Starting: known poses, from 3D points, from the hull, again after a loss."""

import numpy as np
import pytest

from hypose.errors import EvidenceError
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.start_search import recover, start_from_keypoints, starts_in_frame
from tests.tracking.measures import joint_error


@pytest.mark.parametrize("heading", [0.0, 1.5, 3.1, -2.4])
def test_start_from_points_finds_any_heading(body, standing, heading):
    true = standing.copy()
    true[3:6] = [0, 0, heading]
    true[body.skeleton.dofs_of("left_elbow")] += 0.8
    true[body.skeleton.dofs_of("right_knee")] += 0.6
    joint = np.array([3, 6, 7, 8, 10, 11, 12, 13, 14, 15, 16, 17, 18])
    points = body.joints(true)[joint]
    points[2] = np.nan
    fit = start_from_keypoints(body, points, joint, np.zeros((len(joint), 3)))
    seen = np.linalg.norm(body.joints(fit.pose) - body.joints(true), axis=1)[np.delete(joint, 2)]
    assert seen.mean() < 0.02


def test_too_few_points_say_so(body):
    points = np.full((13, 3), np.nan)
    points[:4] = 0.0
    with pytest.raises(EvidenceError, match="Only 4 of 13"):
        start_from_keypoints(body, points, np.arange(13), np.zeros((13, 3)))


def test_start_from_hull_finds_place_and_heading(body, standing, frame_of):
    true = standing.copy()
    true[:2] = [0.25, -0.2]
    prepared = prepare(frame_of(body, true), body, np.zeros_like(true))
    fit = starts_in_frame(body, prepared, body.stature)[0]
    assert joint_error(body, fit.pose, true) < 0.04


def test_recover_brings_back_a_lost_body(body, standing, frame_of):
    prepared = prepare(frame_of(body, standing), body, standing)
    lost = standing.copy()
    lost[:2] += [0.8, -0.6]
    lost[5] += 1.2
    found = recover(lost, lost, prepared)
    assert prepared.silhouettes.energy(body, found[None])[0] < 0.25 * prepared.silhouettes.energy(body, lost[None])[0]
    assert joint_error(body, found, standing) < 0.06
