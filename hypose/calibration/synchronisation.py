"""Synchronisation of views: estimation of their offsets, and resampling of their evidence to a common clock.

A view that is late by o frames shows in its frame t + o what the reference shows in its frame t. No frame is dropped or
repeated. Key points are interpolated between frames; masks by their signed distance (a mask half way between two
masks), which is right for parts that move less than their width between two frames.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.signal import butter, resample_poly, sosfiltfilt

from hypose.calibration.sync_motion import (
    Offsets,
    keypoint_curves,
    mask_tracks,
    silhouette_curves,
    solve_offsets,
)
from hypose.cameras.camera import CameraRig
from hypose.compute.mask_distance import signed_distance
from hypose.errors import EvidenceError, InputError
from hypose.evidence.frame import Frame, FrameSource, Keypoints, Silhouettes
from hypose.evidence.outlines import bounding_box
from hypose.geometry import Array
from hypose.io.videos.video import Sound

WHOLE = 0.05
"""Offsets that differ from a whole number by less than this (frames) are rounded, and nothing is interpolated."""


_MASK_SHARE = 0.25  # weight of silhouettes relative to key points, whose errors are the smaller ones


def offsets_from_motion(
    rig: CameraRig,
    keypoints: tuple[Array, Array],
    silhouettes: Sequence[Silhouettes | None] = (),
    *,
    largest: float = 12.0,
) -> Offsets:
    """Estimate the delay of each view from consecutive frames of key points, silhouettes or both.

    rig: the calibrated cameras.
    keypoints: undistorted px (C, T, K, 2) of the calibrated size, and confidence (C, T, K); K is 0 without key points.
    silhouettes: T, at any working size.
    largest: largest offset that is searched, frames.
    Raises: EvidenceError where the recording is too short or no person moves.
    """
    curves = keypoint_curves(rig, *keypoints, largest) if keypoints[0].size else None
    rig_of_masks = next((s.rig for s in silhouettes if s is not None), None)
    if rig_of_masks is not None:
        more = silhouette_curves(rig_of_masks, mask_tracks(silhouettes), largest)
        curves = more if curves is None else curves + replace(more, cost=_MASK_SHARE * more.cost)
    if curves is None:
        raise EvidenceError("There are neither key points nor silhouettes to take the timing from.")
    return solve_offsets(curves, len(rig))


def points_at(points: Array, late: float) -> Array:
    """Interpolate the key points of one view at the times t + late, t = 0..T-1.

    points: (T, K, 3) px, px, confidence.
    late: delay of the view, frames.
    Returns: (T, K, 3); confidence is 0 outside the clip and where a needed neighbour is missing. A missing neighbour is
        replaced by the other one up to half a frame away.
    """
    n = len(points)
    at = np.arange(n) + (round(late) if abs(late - round(late)) < WHOLE else late)
    low = np.floor(at).astype(int)
    share = (at - low)[:, None]
    a, b = np.clip(low, 0, n - 1), np.clip(low + 1, 0, n - 1)
    inside = (at >= -0.5) & (at <= n - 0.5)
    pa, pb = points[a], points[b]
    ca, cb = pa[..., 2] > 0, pb[..., 2] > 0
    both = (1 - share[..., None]) * pa + share[..., None] * pb
    value = np.where((ca & cb)[..., None], both, np.where(ca[..., None], pa, pb))
    near = np.where(ca & cb, True, np.where(ca, share <= 0.5, share >= 0.5) & (ca | cb))
    return np.where((near & inside[:, None])[..., None], value, 0.0)


def mask_between(before: NDArray[np.uint8], after: NDArray[np.uint8], share: float) -> NDArray[np.uint8]:
    """Interpolate between two masks with the zero set of their mixed signed distances.

    before, after: (h, w) of 0 and 1.
    share: position between them, from 0 to 1.
    Why: the nearer mask is used where the mixed mask is empty, because parts that do not overlap vanish in the middle.
    """
    if share <= WHOLE or not after.any():
        return before
    if share >= 1 - WHOLE or not before.any():
        return after
    y0, y1, x0, x1 = bounding_box(before | after, 1) or (0, 0, 0, 0)
    distance = [signed_distance(mask[y0:y1, x0:x1]) for mask in (before, after)]
    mixed = np.zeros_like(before)
    mixed[y0:y1, x0:x1] = (1 - share) * distance[0] + share * distance[1] < 0
    return mixed if mixed.any() else (before if share < 0.5 else after)


class Resampled:
    """Frames of a source, resampled to the common clock.

    late: (C,) delay of each view, frames.
    Raises: InputError where an offset is not finite.
    """

    def __init__(self, source: FrameSource, late: Sequence[float] | Array) -> None:
        self.source = source
        if not np.isfinite(np.asarray(late, dtype=np.float64)).all():
            raise InputError(f"Offsets must be finite numbers of frames, got {list(late)}.")
        self.late = np.array([round(x) if abs(x - round(x)) < WHOLE else float(x) for x in late], dtype=np.float64)
        self._get = lru_cache(4 * int(np.ceil(np.abs(self.late).max())) + 9)(source.frame)

    def __len__(self) -> int:
        return len(self.source)

    def frame(self, index: int, /) -> Frame:
        """Compute frame `index` of the common clock; a view without images at that time is not usable, with a
        reason.
        """
        here, n, views = self._get(index), len(self.source), list[_Between]()
        for c, late in enumerate(self.late.tolist()):
            low = int(np.floor(index + late))
            share = index + late - low
            inside = 0 <= low and low + (share > 0) < n
            a = self._get(min(max(low, 0), n - 1))
            b = self._get(min(max(low + 1, 0), n - 1)) if share > 0 else a
            views.append(_Between(index, c, late, a, b, share, inside))
        kept = {name: _IN_STEP[name](piece, views) for name, piece in here.pieces.items() if name in _IN_STEP}
        return Frame(here.time, here.index, **kept)


class _Between(NamedTuple):
    """Where an instant of the common clock lies in one view: at a share of the way between two frames; inside: the view
    has both of them.
    """

    here: int
    view: int
    late: float
    before: Frame
    after: Frame
    share: float
    inside: bool


def _masks_in_step(here: Silhouettes, views: Sequence[_Between]) -> Silhouettes:
    """Interpolate the masks of all views at an instant of the common clock.

    here: masks of the frame with the same number.
    views: where the instant lies in each view.
    Raises: InputError where there is not one offset per view.
    """
    if len(views) != len(here.rig):
        raise InputError(f"{len(views)} offsets are given for {len(here.rig)} views; give one each.")
    masks, usable, reasons = here.masks.copy(), here.usable.copy(), list(here.reasons)
    for v in views:
        c = v.view
        for a, b in zip(v.before.of(Silhouettes), v.after.of(Silhouettes), strict=False) if v.late else ():
            usable[c] = v.inside and bool(a.usable[c]) and bool(b.usable[c])
            reasons[c] = "" if usable[c] else a.reasons[c] or b.reasons[c]
            if not v.inside:
                where = f"{here.rig.names[c]}, frame {v.here}"
                reasons[c] = f"{where}: the view has no image {v.late:+.2f} frames from here"
            masks[c] = mask_between(a.masks[c], b.masks[c], v.share) if usable[c] else 0
    return Silhouettes(masks, here.rig, usable, tuple(reasons))


def _points_in_step(here: Keypoints, views: Sequence[_Between]) -> Keypoints:
    """Interpolate the key points of all views at an instant of the common clock.

    here: key points of the frame with the same number.
    views: where the instant lies in each view.
    """
    points = here.points.copy()
    for v in views:
        c = v.view
        for a, b in zip(v.before.of(Keypoints), v.after.of(Keypoints), strict=False) if v.late else ():
            points[c] = points_at(np.stack([a.points[c], b.points[c]]), v.share)[0] if v.inside else 0.0
    return replace(here, points=points)


_IN_STEP: dict[str, Callable[[Any, Sequence[_Between]], Any]] = {
    "silhouettes": _masks_in_step,
    "keypoints": _points_in_step,
    "detections": lambda here, _: here,
    "sensor_joints": lambda here, _: here,
}
"""What becomes of each piece of a frame on the common clock; the others, which are of one instant, are left out."""


# ---- sync events ---------------------------------------------------------------------------------------------------
# Time offsets between cameras from what happened once for all of them: a sound, or a change of the light.
#
# Sound: generalised cross-correlation with the phase transform, whose peak is sharp whatever the room does to the
# spectrum (Knapp & Carter 1976); every pair of views votes, weighted by its peak. Light: a lamp switched on or off lies
# somewhere within one exposure, and the brightness of that frame says where; of a flash the centre of the brightness is
# taken, which is no better than the exposure is long.


_RATE = 8000  # Hz: sampling rate at which sounds are compared
_LEAST_PEAK = 6.0  # least peak of the correlation, in its standard deviations, for a common sound


def offsets_from_sound(sounds: Sequence[Sound], names: Sequence[str], largest_s: float = 10.0) -> tuple[Array, Array]:
    """Estimate the delay of each view from the sound, by cross-correlation.

    sounds: sound of each view.
    names: names of the views.
    largest_s: largest offset, s.
    Returns: (C,) delay against the median view, s; (C,) peak of the correlation with the others, in standard
        deviations.
    Raises: EvidenceError where a view has no sound in common with the others.
    """
    prepared = [_prepared(s, n) for s, n in zip(sounds, names, strict=True)]
    first, second = np.array(list(itertools.combinations(range(len(prepared)), 2))).T
    late, heights = np.array([_pair(prepared[a], prepared[b], largest_s) for a, b in zip(first, second, strict=True)]).T
    rows = np.eye(len(prepared))[second] - np.eye(len(prepared))[first]
    peaks = (np.abs(rows) * heights[:, None]).max(0)
    if (peaks < _LEAST_PEAK).any():
        silent = ", ".join(n for n, p in zip(names, peaks, strict=True) if p < _LEAST_PEAK)
        raise EvidenceError(
            f"{silent}: no sound in common with the other views within {largest_s:g} s; clap once in front of all "
            "cameras, or use --by motion."
        )
    # the offsets that agree with most pairs: weighted L1, iteratively reweighted
    x, weights = np.zeros(len(prepared)), np.maximum(heights - _LEAST_PEAK, 0.0)
    for n in range(20):
        w = np.sqrt(weights / (np.maximum(np.abs(rows @ x - late), 1e-4) if n else 1.0))
        x = np.asarray(np.linalg.lstsq(rows * w[:, None], late * w, rcond=None)[0], dtype=np.float64)
    return x - np.median(x), peaks


def _prepared(sound: Sound, name: str) -> Array:
    """Resample a sound to _RATE, filter it to 150 to 3500 Hz, and divide it by its standard deviation.

    name: name of the view, for messages.
    Raises: EvidenceError where the sound is too short, damaged or silent.
    """
    x = np.asarray(sound.samples, dtype=np.float64)
    if x.ndim != 1 or len(x) < sound.rate // 2 or not np.isfinite(x).all():
        raise EvidenceError(f"{name}: the sound is shorter than half a second or damaged; use --by motion.")
    x = resample_poly(x, _RATE, int(sound.rate))
    x = sosfiltfilt(butter(2, [150, 3500], "bandpass", fs=_RATE, output="sos"), x)
    sd = float(np.std(x))
    if sd < 1e-9:
        raise EvidenceError(f"{name}: the sound is silent; use --by motion.")
    return np.asarray(x / sd, dtype=np.float64)


def _pair(a: Array, b: Array, largest_s: float) -> tuple[float, float]:
    """Estimate the delay of b against a, s, and the height of the correlation's peak in standard deviations."""
    n = 1 << int(np.ceil(np.log2(len(a) + len(b))))
    cross = np.fft.rfft(b, n) * np.conj(np.fft.rfft(a, n))
    size = np.abs(cross)
    # half whitened: with full whitening, noise at quiet frequencies would count as much as the sound
    r = np.fft.irfft(cross / np.maximum(size, 1e-3 * size.max()) ** 0.7, n)
    most = min(int(largest_s * _RATE), n // 2 - 2)
    r = np.r_[r[-most:], r[: most + 1]]
    k = int(np.clip(np.argmax(r), 1, len(r) - 2))
    p, q, s = r[k - 1], r[k], r[k + 1]
    bend = p - 2 * q + s
    shift = 0.5 * (p - s) / bend if bend < 0 else 0.0
    sd = 1.4826 * float(np.median(np.abs(r - np.median(r)))) + 1e-12
    return (k - most + shift) / _RATE, float((q - np.median(r)) / sd)


def offsets_from_light(brightness: Sequence[Array], names: Sequence[str]) -> tuple[Array, tuple[str, ...]]:
    """Estimate the delay of each view from a change of the light.

    brightness: mean brightness of every frame of each view.
    names: names of the views.
    Returns: (C,) delay against the median view, frames; the kind of change in each view ("lamp", "flash").
    Raises: EvidenceError where a view has no such change, or the kinds differ.
    """
    found = [light_event(np.asarray(b, dtype=np.float64), n) for b, n in zip(brightness, names, strict=True)]
    kinds = tuple(k for _, k in found)
    if len(set(kinds)) > 1:
        seen = ", ".join(f"{n} {k}" for n, k in zip(names, kinds, strict=True))
        raise EvidenceError(f"The views saw different changes of the light ({seen}); use --by motion or --by sound.")
    at = np.array([t for t, _ in found])
    return at - np.median(at), kinds


def light_event(brightness: Array, name: str) -> tuple[float, str]:
    """Find the largest change of the light in one view.

    brightness: (T,) mean brightness of every frame.
    name: name of the view.
    Returns: its time, frames, fractional; "lamp" where the light stayed changed, "flash" where not.
    Raises: EvidenceError where there is no clear change.
    """
    b = np.asarray(brightness, dtype=np.float64)
    if len(b) < 12 or not np.isfinite(b).all():
        raise EvidenceError(f"{name}: at least 12 frames are needed to look for a flash; use --by motion.")
    slow = median_filter(b, size=min(25, len(b) // 2 * 2 - 1), mode="nearest")
    step = np.diff(b)
    noise = 1.4826 * float(np.median(np.abs(step - np.median(step)))) + 1e-6 * max(float(np.abs(b).max()), 1.0)
    k = int(np.abs(step).argmax())
    if abs(step[k]) < 12 * noise:
        raise EvidenceError(
            f"{name}: no flash and no lamp that was switched is seen (largest change {abs(step[k]):.2f} grey values, "
            f"noise {noise:.2f}); use --by motion or --by sound."
        )
    low, high = max(0, k - 3), min(len(b), k + 5)
    before, after = float(np.median(b[max(0, low - 6) : low + 1])), float(np.median(b[high - 1 : high + 6]))
    if abs(after - before) > 0.5 * abs(step[k]):
        # the difference to the new level, summed over the frames, is the time before the switch
        share = np.clip((after - b[low:high]) / (after - before), 0.0, 1.0)
        share[: max(k - low, 0)] = 1.0
        return low + float(share.sum()), "lamp"
    excess = np.abs(b[low:high] - slow[low:high])
    excess[excess < 0.1 * excess.max()] = 0.0
    return float((np.arange(low, high) * excess).sum() / excess.sum()) + 0.5, "flash"
