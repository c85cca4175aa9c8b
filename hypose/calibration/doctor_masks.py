"""What silhouettes say about key points, and about each other.

Key points against masks: across a limb the mask is as wide on one side of the bone as on the other, so the middle of
the mask across the bone tells where the bone should lie; the offsets of many limbs in many directions give the image
shift of a view and, as a function of the time lag, whether key points and video are in step.
Silhouettes against each other: the planes through two camera centres that touch the person must be the same in both
views (frontier points, Sinha & Pollefeys 2010).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.calibration.sync_motion import MaskTrack, tangent_planes
from hypose.cameras.camera import CameraRig
from hypose.evidence.frame import Silhouettes
from hypose.geometry import Array

LIMBS = tuple(
    (f"{side}_{a}", f"{side}_{b}")
    for side in ("left", "right")
    for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
)
_ALONG = (0.35, 0.5, 0.65)


@dataclass(frozen=True)
class LimbOffsets:
    """Across how many limbs the mask's middle was found: normal (N, 2) of the bone, offset (N,) px of the middle from
    the bone along the normal, frame (N,), all in px of the working size."""

    normal: Array
    offset: Array
    frame: NDArray[np.int64]


@dataclass(frozen=True)
class Alignment:
    """Key points of one view against its masks. lag: frames by which the key points are early (key points t belong to
    video frame t + lag); agreement (L,) at lags (L,): median distance (px of the working size) of bone and middle of
    the limb, after the best shift; shift (2,): px to add to the images so that they agree, shift_sd (2,)."""

    lag: float
    lags: NDArray[np.int64]
    agreement: Array
    shift: Array
    shift_sd: Array
    samples: int


def limb_offsets(
    points: Array, names: Sequence[str], masks: Sequence[NDArray[np.uint8] | None], lag: int
) -> LimbOffsets:
    """Offsets of one view. points (T, K, 3) px of the masks; masks (T) of (h, w) or None; mask t + lag is compared."""
    column = {n: k for k, n in enumerate(names)}
    limbs = [(column[a], column[b]) for a, b in LIMBS if a in column and b in column]
    normals, offsets, frames = [], [], []
    for t, p in enumerate(points):
        mask = masks[t + lag] if 0 <= t + lag < len(masks) else None
        if mask is None:
            continue
        size = _size(p)
        if size <= 0:
            continue
        reach = 0.14 * size
        steps = np.arange(0, reach, 0.5)
        a = np.array([i for i, j in limbs if min(p[i, 2], p[j, 2]) > 0.4], dtype=int)
        b = np.array([j for i, j in limbs if min(p[i, 2], p[j, 2]) > 0.4], dtype=int)
        if len(a) == 0:
            continue
        bone = p[b, :2] - p[a, :2]
        length = np.linalg.norm(bone, axis=1)
        long = length > 0.06 * size
        if not long.any():
            continue
        a, b, bone, length = a[long], b[long], bone[long], length[long]
        normal = np.repeat(np.stack([-bone[:, 1], bone[:, 0]], 1) / length[:, None], len(_ALONG), 0)
        share = np.tile(_ALONG, len(a))[:, None]
        start = np.repeat(p[a, :2], len(_ALONG), 0) * (1 - share) + np.repeat(p[b, :2], len(_ALONG), 0) * share
        # how far the mask reaches to either side of the bone
        width = np.stack([_reach(mask, start, sign * normal, steps) for sign in (1, -1)], 1)
        fine = (width.max(1) < 0.6 * reach) & (width.sum(1) > 0.012 * size)
        normals.append(normal[fine])
        offsets.append(0.5 * (width[fine, 0] - width[fine, 1]))
        frames.append(np.full(int(fine.sum()), t))
    if not normals:
        return LimbOffsets(np.zeros((0, 2)), np.zeros(0), np.zeros(0, np.int64))
    return LimbOffsets(np.concatenate(normals), np.concatenate(offsets), np.concatenate(frames))


def _size(points: Array) -> float:
    p = points[points[:, 2] > 0.3, :2]
    return float(np.ptp(p, axis=0).max()) if len(p) > 4 else 0.0


def _reach(mask: NDArray[np.uint8], start: Array, direction: Array, steps: Array) -> Array:
    """(N,) px that the mask goes on from each start (N, 2) in its direction; 0 when the start lies outside."""
    at = np.rint(start[:, None] + direction[:, None] * steps[None, :, None]).astype(int)
    h, w = mask.shape
    inside = (at >= 0).all(-1) & (at[..., 0] < w) & (at[..., 1] < h)
    on = np.zeros(at.shape[:2], dtype=bool)
    on[inside] = mask[at[..., 1][inside], at[..., 0][inside]] > 0
    first_off = np.where(on.all(1), len(steps) - 1, np.argmin(on, axis=1))
    return steps[first_off]


def robust_shift(found: LimbOffsets, scale_px: float) -> tuple[Array, Array, float]:
    """Shift (2,) of the key points that centres them in the limbs, its sd (2,), and the median distance left, px."""
    n, y = found.normal, found.offset
    shift, weight = np.zeros(2), np.ones(len(y))
    for _ in range(10):
        h = (n * weight[:, None]).T @ n + 1e-6 * np.eye(2)
        shift = np.linalg.solve(h, (n * weight[:, None]).T @ y)
        weight = 1 / (1 + ((y - n @ shift) / scale_px) ** 2)
    left = np.abs(y - n @ shift)
    frames = max(len(np.unique(found.frame)), 1)
    # limbs of neighbouring frames err together: a third of the frames count, with one limb each
    spread = 1.4826 * float(np.median(left))
    sd = spread / np.sqrt(np.maximum((n**2).mean(0), 1e-3) * max(frames / 3, 1))
    return shift, sd, float(np.median(left))


def align(
    points: Array, names: Sequence[str], masks: Sequence[NDArray[np.uint8] | None], largest: int = 4
) -> Alignment | None:
    """Lag and shift of one view's key points (T, K, 3), px of the masks; None when too few limbs are seen."""
    lags = np.arange(-largest, largest + 1)
    agreement = np.full(len(lags), np.nan)
    sizes = [s for s in (_size(p) for p in points) if s > 0]
    if not sizes:
        return None
    scale = 0.006 * float(np.median(sizes))
    first, last = max(0, largest), len(points) - max(0, largest)
    use = points.copy()
    use[:first, :, 2] = 0
    use[last:, :, 2] = 0  # the same frames at every lag
    found = {}
    for k, lag in enumerate(lags):
        found[int(lag)] = limb_offsets(use, names, masks, int(lag))
        if len(found[int(lag)].offset) >= 60:
            agreement[k] = robust_shift(found[int(lag)], scale)[2]
    if np.isnan(agreement).all():
        return None
    k = int(np.nanargmin(agreement))
    lag = float(lags[k])
    if 0 < k < len(lags) - 1 and np.isfinite(agreement[[k - 1, k + 1]]).all():
        p, q, s = agreement[k - 1], agreement[k], agreement[k + 1]
        # left of and right of a minimum the disagreement grows linearly
        lag += 0.5 * (p - s) / max(max(p, s) - q, 1e-9)
    shift, sd, _ = robust_shift(found[int(lags[k])], scale)
    # the middle of the limb lies at the bone + shift: the images have to move by - shift
    return Alignment(lag, lags, agreement, -shift, sd, len(found[int(lags[k])].offset))


def view_masks(silhouettes: Sequence[Silhouettes | None], view: int) -> list[NDArray[np.uint8] | None]:
    """The usable masks of one view, without padding."""
    out: list[NDArray[np.uint8] | None] = []
    for s in silhouettes:
        if s is None or not s.usable[view]:
            out.append(None)
        else:
            w, h = s.rig[view].size
            out.append(s.masks[view, :h, :w])
    return out


def tangency(rig: CameraRig, tracks: Sequence[MaskTrack]) -> dict[tuple[int, int], Array]:
    """Per pair of views (T, 2) px (of the working size) by which the planes that touch the person differ; NaN where a
    view has no whole mask. Positive: view b's plane lies further along the pencil."""
    out = {}
    for a, b in itertools.combinations(range(len(tracks)), 2):
        planes, px = tangent_planes(rig, tracks, a, b)
        size = np.where(np.isnan(px).any(0), np.nan, px.mean(0))
        out[a, b] = (planes[1] - planes[0]) * size
    return out


def tangency_by_view(pairs: dict[tuple[int, int], Array], n_views: int) -> Array:
    """(C,) px: median over frames and tangents of a view's disagreement with its best partners (median of pairs)."""
    out = np.full(n_views, np.nan)
    for c in range(n_views):
        mine = [np.nanmedian(np.abs(v)) for k, v in pairs.items() if c in k and np.isfinite(v).any()]
        if mine:
            out[c] = float(np.median(mine))
    return out
