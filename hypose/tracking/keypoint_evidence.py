"""Use 2D key points as evidence of a tracked body: their places on it, their noise, and a detector's usual errors
(left and right exchanged, another person).
"""

from __future__ import annotations

from dataclasses import dataclass

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
"""A view shows another person when its points lie further than this from the expected ones (median)."""
SWAPPED_M = 0.15
"""Left and right are exchanged when the points lie further than this from those expected by their names, and at most
half as far from those of the other side."""
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
    """Places of named key points on a body, and their noise and weights.

    names: (K) names of the points.
    joint: (K,) joint of each point; offset: (K, 3) position in the joint's frame, m; known: (K,) true for points that
        the body has.
    sd: (K,) noise of a detection at the body's distance, per axis, at confidence 1, m; None: not measured.
    view: (C,) factor on the noise of each view (`hypose.tracking.keypoint_offsets`); None: all are alike.
    cue_weight: (C, K) share of each point's weight that is kept in solves with masks (`hypose.tracking.cue_weights`);
        None: all of it.
    """

    names: tuple[str, ...]
    joint: NDArray[np.int64]
    offset: Array
    known: NDArray[np.bool_]
    sd: Array | None = None
    view: Array | None = None
    cue_weight: Array | None = None

    def positions(self, body: Body, poses: Array) -> Array:
        """Compute the world positions (..., K, 3) of the points, m, at poses (..., D)."""
        return body.skeleton.points(self.joint, self.offset, poses)

    def worse(self, views: int) -> Array:
        """Return the factors (C,) >= 1 by which the noise of each view is larger than usual; 1 where they are
        unknown, or were measured for another number of views.
        """
        return self.view if self.view is not None and len(self.view) == views else np.ones(views)


def keypoint_model(body: Body, names: tuple[str, ...]) -> KeypointModel:
    """Place key points on a body by the names of its joints and landmarks."""
    joint, offset, known = landmark_of(names, body)
    return KeypointModel(tuple(names), joint, offset, known)


def keypoint_term(
    keypoints: Keypoints,
    body: Body,
    model: KeypointModel | None = None,
    prediction: Array | None = None,
    scale_px: float = 8.0,
) -> KeypointTerm | None:
    """Build the solver's term of the key points of one frame; None when none of them is known and confident.

    keypoints: key points of one frame, in undistorted px.
    model: where the points sit (default: at the body's landmarks).
    prediction: (D,) expected pose. With it, views that show another person are left out, exchanged sides are corrected
        (`check_sides_and_views`), and the model's noise in metres becomes pixels; without it the points are used
        unchanged.
    scale_px: noise in pixels where the model's noise is not measured.
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
    """Reweight the solver term of a frame's key points, for solves that use masks as well, by the cue_weight of the
    model.
    """
    if model.cue_weight is None or len(model.cue_weight) != len(term.points):
        return term
    points = term.points.copy()
    points[..., 2] *= model.cue_weight[:, model.known]
    return term._replace(points=points)


def shows_another_person(keypoints: Keypoints, body: Body, model: KeypointModel, expected: Array, reach: float) -> bool:
    """Decide whether the detected person is another one: further from the expected pose than a person can move.

    keypoints: key points of one frame; model: where they sit on the body.
    expected: (D,) expected pose; reach: largest distance that the person can have moved, m. It is decided by the
        median distance of the triangulated points or, with fewer than four, by the view with the largest median.
        False where nothing is seen, and where two views agree with the expectation (`check_sides_and_views` then
        handles the others).
    """
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
    """Compute the size of a metre, px, in every view (C,) at a world position (3,); at least 1.

    keypoints: key points, of which the cameras are used; position_world: (3,) m.
    """
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
    """Correct key points of a frame: leave out views of another person (confidence 0), and exchange confused sides
    back.

    names: names of the K points.
    points: (C, K, 3).
    expected: (C, K, 2) expected places, px.
    size: (C,) pixels per metre.
    known: (K,) true for points that the body has.
    Returns: (C, K, 3) corrected points.
    A view is left out only where two others agree with the expectation; without them the expectation may be wrong.
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
            if far[view, list(sum(pairs, ()))].any():  # the mean is only large where one of them is
                _exchange(out[view], expected[view], pairs, float(size[view]))
    return out


def _exchange(points: Array, expected: Array, pairs: list[tuple[int, int]], size: float) -> None:
    """Exchange the points (K, 3) of the pairs in place where that is clearly nearer to the expected (K, 2)."""
    left, right = np.array([p[0] for p in pairs], dtype=int), np.array([p[1] for p in pairs], dtype=int)

    def gap(a: NDArray[np.int64], b: NDArray[np.int64]) -> Array:
        d = np.linalg.norm(points[a, :2] - expected[b], axis=-1) / size
        return np.minimum(d, _FAR_M)[(points[a, 2] > 0) & np.isfinite(d)]

    given = np.concatenate([gap(left, left), gap(right, right)])
    turned = np.concatenate([gap(left, right), gap(right, left)])
    if len(given) and given.mean() > SWAPPED_M and turned.mean() < 0.5 * given.mean():
        points[np.concatenate([left, right])] = points[np.concatenate([right, left])]
