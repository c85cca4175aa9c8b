"""Find limbs of a tracked clip that lie where the names of the key points put the other side's limb.

A detector exchanges left and right in single views for a while, so each view's points are renamed by where the body is
expected (`hypose.tracking.keypoint_evidence.check_sides_and_views`). Where two limbs have met, that expectation may go
on with the wrong one and then rename all views in all later frames. Most points called left are left: so the names of
all views and frames are counted together, and limbs that are apart do not change places.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.evidence.frame import Keypoints
from hypose.geometry import Array
from hypose.tracking.keypoint_evidence import MIN_CONFIDENCE, SWAPPED_M, KeypointModel, pixels_per_metre

LIMBS = {"legs": ("knee", "ankle", "big_toe", "small_toe", "heel"), "arms": ("elbow", "wrist")}
_FAR_M = 0.5  # m, larger distances are cut off
_MEETING, _APART, _APART_M = 8.0, 24.0, 0.5
"""views: cost of an exchange where two limbs touch, and the extra cost where they are _APART_M apart. Half a second in
which, by chance, one view more has the other side's names than not is worth 12, and has two ends."""


def exchanged_by_names(
    body: Body,
    model: KeypointModel,
    poses: Array,
    keypoints: Sequence[Keypoints | None],
    limb: str,
    *,
    sure_start: bool = False,
) -> tuple[NDArray[np.bool_], float]:
    """Find the frames in which two limbs are on each other's side, by the names of the key points (Viterbi search).

    model: where key points sit on the body; keypoints: T frames, None where there are none.
    poses: (T, D) tracked poses.
    limb: "legs" or "arms", see LIMBS.
    sure_start: frame 0 is known to have its sides right.
    Returns: (T,) true for exchanged frames; the gain, in views, of exchanging them.
    """
    pairs = _pairs(model, LIMBS[limb])
    if not len(pairs):
        return np.zeros(len(poses), np.bool_), 0.0
    places = model.positions(body, poses)
    apart = np.linalg.norm(places[:, pairs[:, 0]] - places[:, pairs[:, 1]], axis=-1).mean(1)
    won = np.zeros(len(poses))  # views with the other side's names minus views with the own side's
    for t, seen in enumerate(keypoints):
        if seen is not None and seen.names == model.names:
            uv = np.stack([camera.project_pinhole(places[t]) for camera in seen.rig])
            renamed, kept = views_by_names(model, limb, seen.points, uv, pixels_per_metre(seen, poses[t, :3]))
            won[t] = renamed - kept
    change = _MEETING + _APART * (apart / _APART_M) ** 2
    change[0] = np.inf if sure_start else _MEETING  # a start may be wrong, however far apart they are
    return _best_stretches(won, change)


def _pairs(model: KeypointModel, parts: Sequence[str]) -> NDArray[np.int64]:
    """List the columns (N, 2) of the left and right point of each part that the body has.

    model: model of the key points; parts: names without the side.
    """
    column = {n: k for k, n in enumerate(model.names) if model.known[k]}
    both = [(column.get(f"left_{p}", -1), column.get(f"right_{p}", -1)) for p in parts]
    return np.array([b for b in both if min(b) >= 0], dtype=np.int64).reshape(-1, 2)


def views_by_names(model: KeypointModel, limb: str, points: Array, expected: Array, size: Array) -> tuple[int, int]:
    """Count the views whose named points lie on the other side's limb, and those whose points lie on their own.

    model: model of the key points; limb: "legs" or "arms".
    points: (C, K, 3) u px, v px, confidence.
    expected: (C, K, 2) places on the body, px; size: (C,) pixels per metre.
    Returns: views on the other side; views on their own side. Views where both fit alike count as neither.
    """
    pairs, seen = _pairs(model, LIMBS[limb]), np.nan_to_num(points)
    if not len(pairs):
        return 0, 0
    there = (seen[..., 2] > MIN_CONFIDENCE) & np.isfinite(expected).all(-1)

    def gap(named: NDArray[np.int64], body: NDArray[np.int64]) -> Array:
        """Compute the mean distance (C,), m, of points from the given places on the body; NaN where there are none."""
        both = there[:, named] & np.isfinite(expected[:, body]).all(-1)
        d = np.linalg.norm(seen[:, named, :2] - expected[:, body], axis=-1) / size[:, None]
        count = both.sum(1)
        return np.where(count > 0, np.where(both, np.minimum(d, _FAR_M), 0.0).sum(1) / np.maximum(count, 1), np.nan)

    own, other = pairs.ravel(), pairs[:, ::-1].ravel()
    as_named, exchanged = gap(own, own), gap(own, other)
    renamed = (as_named > SWAPPED_M) & (exchanged < 0.5 * as_named)
    kept = (exchanged > SWAPPED_M) & (as_named < 0.5 * exchanged)
    return int(renamed.sum()), int(kept.sum())


def _best_stretches(worth: Array, change: Array) -> tuple[NDArray[np.bool_], float]:
    """Choose the frames (T,) to exchange with the largest sum of worth (T,) minus the change costs (T,) at their ends.

    Returns: (T,) the frames; the sum.
    """
    frames = len(worth)
    best, came = np.array([0.0, -change[0]]), np.zeros((frames, 2), np.int64)
    for t in range(frames):
        if t:
            crossing = best[::-1] - change[t]
            came[t] = np.where(crossing > best, [1, 0], [0, 1])
            best = np.maximum(best, crossing)
        best = best + [0.0, worth[t]]
    out, state = np.zeros(frames, np.bool_), int(best[1] > best[0])
    for t in range(frames - 1, -1, -1):
        out[t] = state == 1
        state = int(came[t, state])
    return out, float(max(best[1], best[0]))
