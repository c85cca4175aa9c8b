"""Systematic error of joints found from key points: what more frames, and more such views, would not average away.

A detector's errors last. Those that differ between views, and those of a wrong calibration, stay in the residuals of
single views over the whole clip, where they are measured. Those that all views share (where the detector puts the joint
of this person) leave no residual: they are taken to be in proportion to what the views show.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hypose.body.body import Body
from hypose.evidence.frame import Keypoints
from hypose.evidence.keypoints import BLAZEPOSE_33
from hypose.geometry import Array
from hypose.tracking.audit import columns_of_joints
from hypose.tracking.keypoint_evidence import MIN_CONFIDENCE, KeypointModel, checked, pixels_per_metre

LASTING_S = 0.5
"""s from which on two residuals of one point in one view share only what lasts: errors of detections are correlated
over a few tenths of a second."""
SHARED = 2.0
"""Standard deviation of the error that all views share, per axis, in those of a usual view's lasting residuals. Chosen
on the Shelf recording (Belagiannis et al. 2014), people who are annotated in most frames: 90 % regions hold .48 to .49
of the annotations with 2, .15 to .17 with nothing; annotations by hand err by 20 mm themselves."""
MOST_SHARED_M = 0.03
"""m per axis: detectors' hips and knees lie 30 to 50 mm from the joints' centres (Needham et al. 2021, doi
10.1038/s41598-021-00212-x); residuals that would make more of it are a calibration's."""
_USUAL_SD = 0.03  # m, of points whose noise was not measured
_LOOSE = 0.1
_FRAMES = 500  # at once


def lasting_residuals(
    body: Body, model: KeypointModel, keypoints: Sequence[Keypoints | None], poses: Array, frame_rate: float
) -> tuple[Array, Array]:
    """Variances (C, K) m^2 per axis of what lasts in the residuals of each view and key point (0: too few residuals),
    and the weights (T, C, K) that points have in the solve (0: not used), 1 at most.

    poses (T, D): the solved clip. Residuals count by their weights in the solve, 1 / (1 + (r / 2 sd)^2). The weighted
    mean product of those LASTING_S or more apart is the power of what lasts, whatever noise there is; views and points
    are taken to have independent factors."""
    first = next(k for k in keypoints if k is not None)
    residual = np.zeros((len(poses), len(first.rig), len(model.names), 2))
    weights, scale = np.zeros(residual.shape[:3]), 2 * (_USUAL_SD if model.sd is None else model.sd)
    places = model.positions(body, poses)
    for t, seen in enumerate(keypoints):
        if seen is None:
            continue
        points = np.nan_to_num(seen.on_their_sides)
        points[~(points[..., 2] > MIN_CONFIDENCE)] = 0.0
        size = pixels_per_metre(seen, poses[t, :3])
        uv = np.stack([camera.project_pinhole(places[t]) for camera in seen.rig])
        points = checked(points, uv, model.names, size, model.known, sides=seen.really is None)
        used = (points[..., 2] > 0) & model.known & np.isfinite(uv).all(-1)
        away = np.where(used[..., None], points[..., :2] - uv, 0.0) / size[:, None, None]
        weights[t] = used / (1 + (away**2).sum(-1) / scale**2)
        residual[t] = weights[t][..., None] * away
    apart = max(1, min(round(LASTING_S * frame_rate), len(poses) // 2))

    def later(values: Array) -> Array:
        """Sums over frames that are `apart` frames or more later."""
        total = np.zeros_like(values)
        total[:-apart] = values[apart:][::-1].cumsum(0)[::-1]
        return total

    pairs = (weights * later(weights)).sum(0)
    power = 0.5 * (residual * later(residual)).sum((0, 3))
    views = (weights > 0).any(0).sum(0)
    left = np.maximum(2 * views - 3, 1) / np.maximum(2 * views, 1)  # share of the errors that a fit leaves as residual
    power = np.where(pairs > 0, power / np.maximum(pairs, 1e-9), 0.0) / left
    of_view, of_point = np.maximum(power.sum(1), 0.0), np.maximum(power.sum(0), 0.0)
    # where noise alone is left, parts of both signs cancel, and no sum of them is a divisor
    whole = max(float(power.sum()), float(of_view.sum()), float(of_point.sum()), 1e-12)
    return np.outer(of_view, of_point) / whole, weights


def systematic_covariance(
    body: Body, model: KeypointModel, keypoints: Sequence[Keypoints | None], poses: Array, frame_rate: float
) -> Array:
    """(T, J, 3, 3) m^2: systematic error of the joints of a clip solved on its key points, of which less is left where
    BlazePose's, which are seldom right to the centimetre, weigh less beside masks.

    That of single views goes through the triangulation of the views that see the point in the frame, weighted as the
    solve weighs them; the shared one (SHARED) is the same in all directions. Joints without a key point of their own
    get the mean of all."""
    lasting, weights = lasting_residuals(body, model, keypoints, poses, frame_rate)
    first = next(k for k in keypoints if k is not None)
    usual = weights.sum(0) / np.maximum((weights > 0).sum(0), 1) * model.worse(len(first.rig))[:, None] ** -2.0
    centres = np.stack([camera.position for camera in first.rig])
    shared = np.minimum(SHARED**2 * np.median(lasting, 0), MOST_SHARED_M**2)
    beside = model.beside if model.names == BLAZEPOSE_33 else None
    said = np.ones(len(model.names)) if beside is None else beside.max(0)
    own = columns_of_joints(tuple(body.skeleton.joint_names), model.names)
    some = (own >= 0) & model.known[own]
    out = np.zeros((len(poses), len(own), 3, 3))
    for begin in range(0, len(poses), _FRAMES):
        part = slice(begin, begin + _FRAMES)
        away = model.positions(body, poses[part])[:, None] - centres[:, None]
        away /= np.linalg.norm(away, axis=-1, keepdims=True)
        across = (weights[part, ..., None, None] > 0) * (np.eye(3) - away[..., None] * away[..., None, :])
        normal = np.einsum("ck,tckab->tkab", usual, across) + _LOOSE * np.eye(3)
        inside = np.einsum("ck,tckab->tkab", usual**2 * lasting, across)
        back = np.linalg.inv(normal)
        points = said[:, None, None] * (back @ inside @ back + (shared[:, None, None] * np.eye(3)))
        mean = points[:, model.known].mean(1)
        for j in range(len(own)):
            out[part, j] = points[:, own[j, some[j]]].mean(1) if some[j].any() else mean
    return out
