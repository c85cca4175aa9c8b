"""Refinement of cameras from key points and from silhouettes of the moving person."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.calibration.refine_body import adjust_with_body
from hypose.calibration.refine_points import (
    adjust,
    changes,
    gauge,
    point_residual,
    transform_rig,
)
from hypose.cameras.camera import CameraRig
from hypose.compute.parts import covered
from hypose.errors import EvidenceError
from hypose.evidence.silhouettes import make_silhouettes
from hypose.evidence.terms import contour_term
from hypose.geometry import se3, so3_exp
from hypose.synthetic.scenes import camera_rig as named_rig
from hypose.tracking.start_search import known_pose


def turned(rig, c, degrees, move):
    cameras = list(rig)
    camera = rig[c]
    r = so3_exp(np.radians(degrees)) @ camera.camera_from_world[:3, :3]
    cameras[c] = replace(camera, camera_from_world=se3(r, -r @ (camera.position + move)))
    return CameraRig(tuple(cameras))


def noisy_points(rig, rng, n=400, sd=1.0):
    x = rng.normal(0, [0.5, 0.5, 0.5], (n, 3)) + [0, 0, 1]
    uv = np.stack([c.project_pinhole(x) for c in rig]) + rng.normal(0, sd, (len(rig), n, 2))
    return x, uv, np.full((len(rig), n), 0.8)


def test_key_points_bring_a_turned_camera_back_to_the_noise(rng):
    true = named_rig("humaneva-4").pinhole()
    _, uv, w = noisy_points(true, rng)
    uv[0, :20] += 80  # wild detections
    off = turned(true, 2, [1.0, -2.0, 0.5], [0.05, -0.03, 0.02])
    found = adjust(off, uv, w)
    floor = np.nanmedian(point_residual(true, uv, w))
    assert np.nanmedian(point_residual(off, uv, w)) > 4 * floor
    assert np.nanmedian(point_residual(found.rig, uv, w)) < 1.1 * floor
    assert np.nanmedian(point_residual(found.rig, uv, w, left_out=True)) < 1.15 * np.nanmedian(
        point_residual(true, uv, w, left_out=True)
    )
    back = transform_rig(found.rig, gauge(found.rig, off, found.points))
    change = changes(off, back, found.points[:50])
    assert change[2].turn_deg > 1.5 and max(change[k].turn_deg for k in (0, 1, 3)) < 0.5


def test_a_focal_length_is_found_when_asked_for(rng):
    true = named_rig("ring-5").pinhole()
    _, uv, w = noisy_points(true, rng, 800, 0.3)
    wrong = list(true)
    k = true[1].K.copy()
    k[:2, :2] *= 1.02
    wrong[1] = replace(true[1], K=k)
    found = adjust(CameraRig(tuple(wrong)), uv, w, focal=True)
    ratio = found.rig[1].K[0, 0] / found.rig[0].K[0, 0]
    assert ratio == pytest.approx(1.0, abs=0.008)


def test_too_few_points_are_told(rng):
    true = named_rig("humaneva-4").pinhole()
    _, uv, w = noisy_points(true, rng, 30)
    with pytest.raises(EvidenceError, match="Only 30 key points"):
        adjust(true, uv, w)


def silhouettes_of(body, poses, rig):
    out = []
    for v in body.skin(poses):
        masks = []
        for c in rig:
            z = v @ c.camera_from_world[2, :3] + c.camera_from_world[2, 3]
            masks.append(covered(c.project_pinhole(v), z, body.coarse.faces, c.size[::-1]).astype(np.uint8))
        out.append(make_silhouettes(masks, rig))
    return out


def poses_of(body, rng, n):
    base = np.stack([known_pose(body, name) for name in ("t", "standing", "hands-up", "a")])[np.arange(n) % 4]
    poses = base + rng.normal(0, 0.12, base.shape)
    poses[:, :3] = rng.normal(0, [0.3, 0.3, 0.02], (n, 3)) + [0, 0, 0.95]
    poses[:, 3:6] = np.stack([np.zeros(n), np.zeros(n), rng.uniform(-3, 3, n)], 1)
    return body.skeleton.clamp(poses)


def test_silhouettes_alone_bring_a_turned_camera_back(rng):
    body = human()
    true = named_rig("humaneva-4").pinhole().scaled(0.4)
    poses = poses_of(body, rng, 6)
    masks = silhouettes_of(body, poses, true)
    off = turned(true, 1, [1.0, 1.5, 0.0], [0.03, 0, 0.02])
    start = body.skeleton.clamp(poses + rng.normal(size=poses.shape) * np.r_[[0.02] * 3, [0.05] * 33])
    found = adjust_with_body(body, off, start, [[contour_term(s)] for s in masks])
    person = body.joints(poses).reshape(-1, 3)
    back = transform_rig(found.rig, gauge(found.rig, true, body.joints(found.poses).reshape(-1, 3)))
    before, after = (np.median([c.image_px for c in changes(true, r, person)]) for r in (off, back))
    worst_before, worst_after = (np.max([c.image_px for c in changes(true, r, person)]) for r in (off, back))
    assert worst_after < 0.35 * worst_before and after < 1.5, (before, after, worst_before, worst_after)


def test_no_evidence_is_told():
    body = human()
    rig = named_rig("humaneva-4").pinhole()
    with pytest.raises(EvidenceError, match="No frame has silhouettes"):
        adjust_with_body(body, rig, np.zeros((1, body.skeleton.dof)), [[]])
