"""Measure lag and shift between the key points and the masks of one view, by where limbs lie in the masks.

The middle of a limb's cross-section in the mask is compared with the bone between two key points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.compute.linear import weighted_squares
from hypose.compute.losses import lorentzian_weight
from hypose.evidence.frame import Silhouettes
from hypose.evidence.keypoints import person_size
from hypose.geometry import Array

_LIMBS = tuple(
    (f"{side}_{a}", f"{side}_{b}")
    for side in ("left", "right")
    for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
)
_TRUNK = (
    ("left_shoulder", "left_hip"),
    ("right_shoulder", "right_hip"),
    ("left_shoulder", "right_hip"),
    ("right_shoulder", "left_hip"),
)
_ALONG = (0.35, 0.5, 0.65)
_BIAS = 0.01  # of the person's size: how far a limb's middle may lie from its bone, 1 sd
_CLEAR = 0.085  # of the person's size: limbs nearer to another part of the body are left out


@dataclass(frozen=True)
class LimbOffsets:
    """Offsets of limbs in one view: for N points on bones, how far the middle of the mask, measured across the bone,
        lies from the bone. Pixels are those of the working size.

    normal: (N, 2) normal of the bone.
    offset: (N,) offset of the middle from the bone along the normal, px.
    velocity: (N, 2) velocity of the point on the bone, px per frame.
    position: (N, 2) point on the bone, px.
    limb: (N,) index of the limb.
    frame: (N,) index of the frame.
    """

    normal: Array
    offset: Array
    velocity: Array
    position: Array
    limb: NDArray[np.int64]
    frame: NDArray[np.int64]


@dataclass(frozen=True)
class Alignment:
    """The alignment of one view's key points with its masks.

    lag: number of frames: the key points of frame t belong to video frame t + lag.
    lag_sd: standard deviation of the lag, frames.
    shift: (2,) x and y to add to image positions so that masks and key points agree, px of the masks.
    shift_sd: (2,) standard deviation of the shift, px of the masks.
    """

    lag: float
    lag_sd: float
    shift: Array
    shift_sd: Array


def limb_offsets(
    points: Array, velocities: Array, names: Sequence[str], masks: Sequence[NDArray[np.uint8] | None], lag: int
) -> LimbOffsets:
    """Measure the offsets between limbs and masks in one view.

    points: (T, K, 3) px of the masks, and confidence.
    velocities: (T, K, 2) px per frame.
    names: K names of the key points.
    masks: T masks (h, w) or None; mask t + lag is compared with points t.
    """
    column = {n: k for k, n in enumerate(names)}
    limbs = np.array([(column[a], column[b]) for a, b in _LIMBS if a in column and b in column]).reshape(-1, 2)
    bones = np.array([(column[a], column[b]) for a, b in (*_LIMBS, *_TRUNK) if a in column and b in column])
    parts: list[Array] = [np.zeros((0, 10))]
    for t, p in enumerate(points):
        mask = masks[t + lag] if 0 <= t + lag < len(masks) else None
        size = person_size(p, least=5)
        if mask is None or size <= 0 or len(limbs) == 0:
            continue
        reach = 0.14 * size
        bone = p[limbs[:, 1], :2] - p[limbs[:, 0], :2]
        length = np.linalg.norm(bone, axis=1)
        limb = np.flatnonzero((p[limbs, 2].min(1) > 0.4) & (length > 0.06 * size))
        bone, length = bone[limb], length[limb]
        normal = np.repeat(np.stack([-bone[:, 1], bone[:, 0]], 1) / length[:, None], len(_ALONG), 0)
        share = np.tile(_ALONG, len(limb))[:, None]
        a, b = (np.repeat(limbs[limb, k], len(_ALONG)) for k in (0, 1))
        start = p[a, :2] * (1 - share) + p[b, :2] * share
        velocity = velocities[t, a] * (1 - share) + velocities[t, b] * share
        # how far the mask reaches to either side of the bone
        steps = np.arange(0, reach, 0.5)
        width = _reach(mask, np.repeat(start, 2, 0), np.stack([normal, -normal], 1).reshape(-1, 2), steps).reshape(
            -1, 2
        )
        fine = (width.max(1) < 0.6 * reach) & (width.sum(1) > 0.012 * size) & np.isfinite(velocity).all(1)
        which = np.repeat(limb, len(_ALONG))
        fine &= _clearance(start, which, p, limbs, bones) > _CLEAR * size
        offset = 0.5 * (width[:, 0] - width[:, 1])
        across = width.sum(1) / size
        frame = np.full(len(which), t)
        columns = np.column_stack([normal, velocity, start, offset, across, which, frame])
        parts.append(np.asarray(columns[fine], dtype=np.float64))
    rows = np.concatenate(parts)
    rows = rows[_alone(rows[:, 8].astype(np.int64), rows[:, 7], len(limbs))]
    limb, frame = rows[:, 8:].astype(np.int64).T
    return LimbOffsets(rows[:, :2], rows[:, 6], rows[:, 2:4], rows[:, 4:6], limb, frame)


def _clearance(
    start: Array, limb: NDArray[np.int64], p: Array, limbs: NDArray[np.int64], bones: NDArray[np.int64]
) -> Array:
    """Compute the distance of points on limbs from the nearest other bone.

    start: (N, 2) px, points on limbs.
    limb: (N,) index of the limb of each.
    p: (K, 3) px of the frame's key points, and confidence.
    limbs, bones: (L, 2) and (B, 2) indices of the key points at both ends.
    Returns: (N,) px; infinite where no bone without a common joint is seen.
    Why: a limb in front of another part of the body has no outline of its own.
    """
    a, b = p[bones[:, 0], :2], p[bones[:, 1], :2]
    along = b - a
    t = ((start[:, None] - a) * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-9)
    gap = np.linalg.norm(start[:, None] - a - np.clip(t, 0, 1)[..., None] * along, axis=-1)
    joined = (limbs[limb][:, None, :, None] == bones[None, :, None, :]).any((2, 3))
    return np.where(joined | (p[bones, 2].min(1) < 0.2), np.inf, gap).min(1)


def _alone(limb: NDArray[np.int64], across: Array, n_limbs: int) -> NDArray[np.bool_]:
    """Test whether the mask is about as wide as the limb; it is wider in front of another part of the body.

    limb: (N,) index of the limb of each measurement.
    across: (N,) width of the mask across the limb, in sizes of the person.
    n_limbs: number of limbs, of both sides together.
    Returns: (N,) True where the width is below 1.35 times the limb's lower quartile.
    """
    out = np.zeros(len(limb), dtype=bool)
    half = max(n_limbs // 2, 1)  # _LIMBS lists the left side first, then the right in the same order
    for k in range(half):
        pair = np.flatnonzero(limb % half == k)
        if len(pair):
            out[pair] = across[pair] < 1.35 * np.percentile(across[pair], 25)
    return out


def _reach(mask: NDArray[np.uint8], start: Array, direction: Array, steps: Array) -> Array:
    """Compute how far (N,), px, the mask extends from each start (N, 2) in its direction; 0 where the start is
    outside.
    """
    at = np.rint(start[:, None] + direction[:, None] * steps[None, :, None]).astype(int)
    h, w = mask.shape
    inside = (at >= 0).all(-1) & (at[..., 0] < w) & (at[..., 1] < h)
    on = np.zeros(at.shape[:2], dtype=bool)
    on[inside] = mask[at[..., 1][inside], at[..., 0][inside]] > 0
    return steps[np.where(on.all(1), len(steps) - 1, np.argmin(on, axis=1))]


def align_to_masks(
    points: Array, names: Sequence[str], masks: Sequence[NDArray[np.uint8] | None], largest: int = 6
) -> Alignment | None:
    """Estimate the lag and shift between the key points and the masks of one view.

    The middle of a limb in the mask is at bone + shift + delay x velocity; the three unknowns are found by robust
    regression. The lag is rounded and applied to whole frames until less than half a frame remains.

    points: (T, K, 3) px of the masks, and confidence.
    names: K names of the key points.
    masks: T masks (h, w) or None.
    largest: largest lag, frames.
    Returns: None where too few limbs are seen.
    Why: the shift's standard deviation counts limbs, not frames, because the error of a limb is the same all the time
        (clothes, where a detector places a joint).
    """
    found_sizes = [s for s in (person_size(p, least=5) for p in points) if s > 0]
    if not found_sizes:
        return None
    scale = 0.006 * float(np.median(found_sizes))
    # central differences over four frames; NaN where a neighbour is missing
    n, xy = len(points), np.where(points[..., 2:] > 0.4, points[..., :2], np.nan)
    a, b = np.clip(np.arange(n) - 2, 0, n - 1), np.clip(np.arange(n) + 2, 0, n - 1)
    velocities = (xy[b] - xy[a]) / np.maximum(b - a, 1)[:, None, None]
    lag, best = 0, None
    for _ in range(5):
        found = limb_offsets(points, velocities, names, masks, lag)
        if len(found.offset) < 60:
            return best
        x, sd = _regressed(found, scale)
        sd[:2] = np.hypot(sd[:2], _BIAS * scale / 0.006 / np.sqrt(_views_of_limbs(found, scale / 0.006)))
        best = Alignment(lag - float(x[2]), float(sd[2]), -x[:2], sd[:2])
        new = int(np.clip(np.rint(best.lag), -largest, largest))
        if new == lag:
            break
        lag = new
    return best


def _views_of_limbs(found: LimbOffsets, size: float) -> float:
    """Compute the effective number of limbs: one that hardly moves has the same bias in every frame.

    found: measured offsets.
    size: size of the person, px.
    """
    total = 0.0
    for limb in np.unique(found.limb):
        mine = found.position[found.limb == limb]
        if len(mine) >= 10:
            total += min(1 + float(np.std(mine, axis=0).max()) / (0.02 * size), 4.0)
    return max(total, 1.0)


def _regressed(found: LimbOffsets, scale_px: float) -> tuple[Array, Array]:
    """Estimate shift and lag from the offsets of limbs by robust regression.

    found: measured offsets.
    scale_px: robust scale of an offset, px.
    Returns: (3,) shift x and y, px, and time, frames; and their standard deviations (3,).
    """
    rows = np.concatenate([found.normal, (found.normal * found.velocity).sum(1)[:, None]], 1)
    y, x, h = found.offset, np.zeros(3), np.eye(3)
    # a calf bulges backwards in every frame: limbs that are often seen may not outvote the others
    count = np.maximum(np.bincount(found.limb)[found.limb], 15)
    share = count.mean() / count
    weight = share
    for _ in range(12):
        h, right = weighted_squares(rows, weight, y)
        h += 1e-6 * np.eye(3)
        x = np.asarray(np.linalg.solve(h, right), dtype=np.float64)
        weight = lorentzian_weight(((y - rows @ x) / scale_px) ** 2, share)
    r = y - rows @ x
    inverse = np.linalg.inv(h)
    spread = np.zeros((3, 3))
    limbs = np.unique(found.limb)
    for limb in limbs:
        mine = found.limb == limb
        s = np.einsum("ri,r,r->i", rows[mine], weight[mine], r[mine])
        spread += np.outer(s, s)
    by_limb = np.diag(inverse @ spread @ inverse) * len(limbs) / max(len(limbs) - 2, 1)
    # lower bound: as if every second frame gave one independent limb
    frames = max(len(np.unique(found.frame)) / 2, 1.0)
    noise = float((weight * r**2).sum() / max(weight.sum(), 1e-9))
    return x, np.sqrt(np.maximum(by_limb, (np.diag(inverse) * noise * len(y) / frames)))


def view_masks(silhouettes: Sequence[Silhouettes | None], view: int) -> list[NDArray[np.uint8] | None]:
    """List the usable masks (h, w) of one view in each frame, without padding; None where there is none."""
    out: list[NDArray[np.uint8] | None] = []
    for s in silhouettes:
        if s is None or not s.usable[view]:
            out.append(None)
        else:
            w, h = s.rig[view].size
            out.append(s.masks[view, :h, :w])
    return out
