"""What lasts in key points' residuals is measured as such, whatever noise there is beside it."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.evidence.frame import Keypoints
from hypose.evidence.keypoints import BODY_25
from hypose.tracking.covariance_calibration import lasting_residuals
from hypose.tracking.frame_evidence import keypoint_model, pixels_per_metre

RATE, FRAMES = 25.0, 60


@pytest.fixture(scope="module")
def model(body):
    found = keypoint_model(body, BODY_25)
    return replace(found, sd=np.full(len(BODY_25), 0.1))  # all residuals here weigh in full


@pytest.fixture(scope="module")
def poses(body, standing):
    out = np.repeat(standing[None], FRAMES, 0)
    out[:, body.skeleton.dofs_of("left_shoulder")[0]] += 0.5 * np.sin(np.arange(FRAMES) / 8)
    return body.skeleton.clamp(out)


def seen(body, model, poses, rig, noise_m=0.0, off_m=None):
    """Key points with white noise, and off (C, 2) all along, in metres at the body."""
    rng = np.random.default_rng(5)
    out = []
    for q in poses:
        uv = np.stack([camera.project_pinhole(model.positions(body, q)) for camera in rig])
        points = np.concatenate([uv, np.where(model.known, 0.9, 0.0)[None, :, None].repeat(len(rig), 0)], -1)
        k = Keypoints(points, BODY_25, rig)
        size = pixels_per_metre(k, q[:3])[:, None, None]
        points[..., :2] += size * noise_m * rng.normal(size=uv.shape)
        if off_m is not None:
            points[..., :2] += size * off_m[:, None]
        out.append(replace(k, points=points))
    return out


def test_what_one_view_is_off_all_along_is_found_under_noise(body, model, poses, small_rig):
    off = np.zeros((len(small_rig), 2))
    off[1] = (0.03, 0.04)
    found, used = lasting_residuals(body, model, seen(body, model, poses, small_rig, 0.02, off), poses, RATE)
    known = used[0].any(0)
    per_axis = 0.05**2 / 2 / ((2 * len(small_rig) - 3) / (2 * len(small_rig)))
    assert found[1, known].mean() == pytest.approx(per_axis, rel=0.15)
    assert found[[0, 2, 3]][:, known].max() < 0.05 * per_axis
