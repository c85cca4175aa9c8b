"""A view whose key points are wrong as a whole is told by what it leaves of the others' triangulation."""

import dataclasses

import numpy as np
import pytest

from hypose.cameras.camera import CameraRig
from hypose.evidence.keypoints import BODY_25B, other_sides
from hypose.synthetic.scenes import camera_rig as named_rig
from hypose.tracking.frame_evidence import keypoint_model
from hypose.tracking.keypoint_offsets import LARGEST, view_factors
from tests.tracking.test_keypoint_evidence import seen_by


@pytest.fixture(scope="module")
def rig():
    return named_rig("humaneva-4").pinhole()


@pytest.fixture
def frames(body, standing, rig, rng):
    """Key points (12) of poses, 1 px off."""
    poses = body.skeleton.clamp(
        standing + 0.2 * rng.normal(size=(12, body.skeleton.dof)) * np.r_[np.zeros(6), np.ones(body.skeleton.dof - 6)]
    )
    model = keypoint_model(body, BODY_25B)
    return [seen_by(rig, model, body, q, rng, 1.0) for q in poses]


def moved(frames, view, by):
    out = []
    for k in frames:
        points = k.points.copy()
        points[view, :, :2] += by
        out.append(dataclasses.replace(k, points=points))
    return out


@pytest.mark.parametrize("view", range(4))
def test_a_shifted_view_is_found_and_no_other(frames, view):
    factors = view_factors(moved(frames, view, (40.0, -25.0)))
    assert 3 < factors[view] <= LARGEST
    assert (np.delete(factors, view) == 1).all()


@pytest.mark.parametrize("views", [range(4), range(1, 4)])
def test_a_view_whose_sides_are_exchanged_is_no_noisier(frames, views):
    column = other_sides(BODY_25B)
    exchanged = [dataclasses.replace(k, points=k.points.copy()) for k in frames]
    for k in exchanged:
        k.points[2] = k.points[2, column]
    rig = CameraRig(tuple(frames[0].rig[v] for v in views))
    given = [dataclasses.replace(k, points=k.points[list(views)], rig=rig) for k in exchanged]
    assert (view_factors(given) == 1).all()
