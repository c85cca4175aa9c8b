"""2D key points as evidence of a tracked body: where they sit on it, how far they are to be trusted, and what a
detector gets wrong (left for right, another person)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.evidence.frame import Keypoints
from hypose.evidence.keypoints import landmark_of, triangulate_keypoints
from hypose.evidence.terms import KeypointTerm
from hypose.geometry import Array

MIN_CONFIDENCE = 0.3
"""Points of less confidence are left out, as in the solver."""
STRANGER_M = 0.35
"""A view whose points lie further than this from the expected ones (median) shows another person."""
SWAPPED_M = 0.15
"""Left and right are taken for exchanged when the points lie further than this from the expected ones as they are
named, and at most half as far when exchanged."""
_FAR_M = 0.5
# what a detector exchanges together, the whole limb first, then its outer parts and single joints; the face is another
# matter
_CHAINS = (
    ("shoulder", "elbow", "wrist"),
    ("hip", "knee", "ankle", "big_toe", "small_toe", "heel"),
    ("elbow", "wrist"),
    ("knee", "ankle", "big_toe", "small_toe", "heel"),
    ("ankle", "big_toe", "small_toe", "heel"),
    ("elbow",),
    ("wrist",),
    ("knee",),
    ("ankle",),
)


@dataclass(frozen=True)
class KeypointModel:
    """Where named key points sit on a body: joint (K,), offset (K, 3) m in that joint's frame, known (K,). sd (K,) m:
    noise of a detection at the body's distance, per axis, at confidence 1; None: not measured. view (C,): by how much
    the noise of each view is larger (`hypose.tracking.view_noise`); None: all are alike. cue_weight (C, K): the
    share of each point's weight that is left in solves with masks (`hypose.tracking.cue_weights`); None: all."""

    names: tuple[str, ...]
    joint: NDArray[np.int64]
    offset: Array
    known: NDArray[np.bool_]
    sd: Array | None = None
    view: Array | None = None
    cue_weight: Array | None = None

    def positions(self, body: Body, poses: Array) -> Array:
        """(..., K, 3) m: the points in the world at poses (..., D)."""
        rotations, centres = body.skeleton.forward(poses)
        turned = np.einsum("...kab,kb->...ka", rotations[..., self.joint, :, :], self.offset)
        return centres[..., self.joint, :] + turned

    def worse(self, views: int) -> Array:
        """(C,) >= 1: `view`, for so many views; 1 where it is not known, or of other views."""
        return self.view if self.view is not None and len(self.view) == views else np.ones(views)


def keypoint_model(body: Body, names: tuple[str, ...]) -> KeypointModel:
    """The key points on a body by its joints and landmarks."""
    joint, offset, known = landmark_of(names, body)
    return KeypointModel(tuple(names), joint, offset, known)


def keypoint_term(
    keypoints: Keypoints,
    body: Body,
    model: KeypointModel | None = None,
    prediction: Array | None = None,
    scale_px: float = 8.0,
) -> KeypointTerm | None:
    """The key points of one frame as rows of the solver, None when none of them is known and confident.

    model: where the points sit (default: where the body's landmarks say). prediction (D,): the expected pose, by which
    views that show another person are left out, exchanged sides put right (`checked`), and the model's noise in metres
    becomes pixels; without it the points are taken as they are. scale_px: noise in pixels of the key points' rig where
    the model's is not measured.
    """
    model = model or keypoint_model(body, keypoints.names)
    known = model.known
    points = np.nan_to_num(keypoints.points)
    points[~(points[..., 2] > MIN_CONFIDENCE)] = 0.0
    if prediction is not None:
        expected = model.positions(body, prediction)
        size = pixels_per_metre(keypoints, prediction[:3])
        uv = np.stack([camera.project_pinhole(expected) for camera in keypoints.rig])
        points = check_sides_and_views(points, uv, model.names, size, known)
        points[..., 2] /= model.worse(len(size))[:, None] ** 2
        if model.sd is not None:
            sd_px = model.sd * size[:, None]
            scale_px = float(np.median(sd_px[:, known]))
            points[..., 2] *= (scale_px / sd_px) ** 2
    points = points[:, known]
    if not (points[..., 2] > 0).any():
        return None
    return KeypointTerm(
        np.ascontiguousarray(points),
        keypoints.rig.projections,
        model.joint[known],
        model.offset[known],
        scale_px,
        min_confidence=0.0,
    )


def with_masks(term: KeypointTerm, model: KeypointModel) -> KeypointTerm:
    """The term of a frame's key points as solves weigh it when there are masks as well."""
    if model.cue_weight is None or len(model.cue_weight) != len(term.points):
        return term
    points = term.points.copy()
    points[..., 2] *= model.cue_weight[:, model.known]
    return replace(term, points=points)


def shows_another_person(keypoints: Keypoints, body: Body, model: KeypointModel, expected: Array, reach: float) -> bool:
    """Whether the person seen stands further than `reach` (m) from the expected pose (D,): no person gets there so
    fast.

    Where two views agree with the expectation the others are `checked`'s matter. Judged by the median over the
    triangulated points, or, of fewer than four, by the view with the larger median; False when nothing is seen."""
    points, expected_points = np.nan_to_num(keypoints.points), model.positions(body, expected)
    uv = np.stack([camera.project_pinhole(expected_points) for camera in keypoints.rig])
    seen = (points[..., 2] > MIN_CONFIDENCE) & model.known & np.isfinite(uv).all(-1)
    size = pixels_per_metre(keypoints, expected[:3])
    distance = np.linalg.norm(points[..., :2] - uv, axis=-1) / size[:, None]
    middle = [float(np.median(d[s])) for d, s in zip(distance, seen, strict=True) if s.sum() >= 4]
    if sum(m <= STRANGER_M for m in middle) >= 2:
        return False
    away = np.linalg.norm(triangulate_keypoints([keypoints])[0][0] - expected_points, axis=-1)[model.known]
    if np.isfinite(away).sum() >= 4:
        return float(np.nanmedian(away)) > reach
    return max(middle, default=0.0) > reach


def pixels_per_metre(keypoints: Keypoints, position_world: Array) -> Array:
    """(C,) px: how large a metre is in every view at a place (3,) in the world; at least 1."""
    sizes = []
    for camera in keypoints.rig:
        depth = camera.camera_from_world[2, :3] @ position_world + camera.camera_from_world[2, 3]
        sizes.append(float(camera.K[0, 0]) / max(float(depth), 0.1))
    return np.maximum(np.array(sizes), 1.0)


def check_sides_and_views(
    points: Array,
    expected: Array,
    names: tuple[str, ...],
    size: Array,
    known: NDArray[np.bool_] | None = None,
) -> Array:
    """Key points (C, K, 3) with views of another person left out (confidence 0) and exchanged sides put right.

    expected (C, K, 2) px: where the points should be about; size (C,): pixels per metre; known (K,): points that the
    body has. A view is left out only when two others agree with the expectation: where none does it is the expectation
    that is wrong.
    """
    out = points.copy()
    seen = (out[..., 2] > 0) & np.isfinite(expected).all(-1)
    if known is not None:
        seen &= known
    distance = np.where(seen, np.linalg.norm(out[..., :2] - expected, axis=-1) / size[:, None], np.nan)
    middle = np.array([np.median(d[s]) if s.sum() >= 4 else np.nan for d, s in zip(distance, seen, strict=True)])
    strangers = middle > STRANGER_M
    if (middle <= STRANGER_M).sum() >= 2:
        out[strangers, :, 2] = 0.0
    column = {name: k for k, name in enumerate(names)}
    far = np.nan_to_num(distance) > SWAPPED_M
    for view in np.flatnonzero(~strangers & far.any(1)):
        for chain in _CHAINS:
            pairs = [
                (column[f"left_{part}"], column[f"right_{part}"])
                for part in chain
                if f"left_{part}" in column and f"right_{part}" in column
            ]
            if far[view, list(sum(pairs, ()))].any():  # the mean can only be as far if one of them is
                _exchange(out[view], expected[view], pairs, float(size[view]))
    return out


def _exchange(points: Array, expected: Array, pairs: list[tuple[int, int]], size: float) -> None:
    """Exchanges the points (K, 3) of the pairs in place when that is clearly nearer to the expected (K, 2)."""
    left, right = np.array([p[0] for p in pairs], dtype=int), np.array([p[1] for p in pairs], dtype=int)

    def gap(a: NDArray[np.int64], b: NDArray[np.int64]) -> Array:
        d = np.linalg.norm(points[a, :2] - expected[b], axis=-1) / size
        return np.minimum(d, _FAR_M)[(points[a, 2] > 0) & np.isfinite(d)]

    given = np.concatenate([gap(left, left), gap(right, right)])
    turned = np.concatenate([gap(left, right), gap(right, left)])
    if len(given) and given.mean() > SWAPPED_M and turned.mean() < 0.5 * given.mean():
        points[np.concatenate([left, right])] = points[np.concatenate([right, left])]
