"""Time offsets between cameras from what happened once for all of them: a sound, or a change of the light.

Sound: generalised cross-correlation with the phase transform, whose peak is sharp whatever the room does to the
spectrum (Knapp & Carter 1976); every pair of views votes, weighted by its peak. Light: a lamp switched on or off lies
somewhere within one exposure, and the brightness of that frame says where; of a flash the centre of the brightness is
taken, which is no better than the exposure is long.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from math import gcd
from typing import Protocol

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import butter, resample_poly, sosfiltfilt

from hypose.errors import EvidenceError
from hypose.geometry import Array

_RATE = 8000  # Hz: what sounds are compared at
_LEAST_PEAK = 6.0  # a peak of the correlation in its own sd, below which there is no common sound


class Sound(Protocol):
    """One camera's sound: samples (N,) at rate Hz; sample 0 belongs to the start of frame 0 (hypose.io.videos)."""

    @property
    def rate(self) -> int:
        """Hz."""
        ...

    @property
    def samples(self) -> Array:
        """(N,)."""
        ...


def offsets_from_sound(sounds: Sequence[Sound], names: Sequence[str], largest_s: float = 10.0) -> tuple[Array, Array]:
    """(C,) seconds by which each view is late, against the median view, and (C,) strength of the evidence (peak of the
    correlation with the others in sd). An EvidenceError names the views that share no sound with the others."""
    prepared = [_prepared(s, n) for s, n in zip(sounds, names, strict=True)]
    c = len(prepared)
    rows, values, weights = [], [], []
    peaks = np.zeros(c)
    for a, b in itertools.combinations(range(c), 2):
        late, peak = _pair(prepared[a], prepared[b], largest_s)
        peaks[[a, b]] = np.maximum(peaks[[a, b]], peak)
        row = np.zeros(c)
        row[b], row[a] = 1, -1
        rows.append(row)
        values.append(late)
        weights.append(max(peak - _LEAST_PEAK, 0.0))
    if (peaks < _LEAST_PEAK).any():
        silent = ", ".join(n for n, p in zip(names, peaks, strict=True) if p < _LEAST_PEAK)
        raise EvidenceError(
            f"{silent}: no sound in common with the other views within {largest_s:g} s; clap once in front of all "
            "cameras, or use --by motion."
        )
    x = _consistent(np.array(rows), np.array(values), np.array(weights))
    return x - np.median(x), peaks


def _consistent(rows: Array, values: Array, weights: Array) -> Array:
    """Offsets that agree with most pairs (weighted L1, iteratively reweighted)."""
    w = np.sqrt(weights)
    x = np.zeros(rows.shape[1])
    for _ in range(20):
        x = np.asarray(np.linalg.lstsq(rows * w[:, None], values * w, rcond=None)[0], dtype=np.float64)
        w = np.sqrt(weights / np.maximum(np.abs(rows @ x - values), 1e-4))
    return x


def _prepared(sound: Sound, name: str) -> Array:
    x = np.asarray(sound.samples, dtype=np.float64)
    if x.ndim != 1 or len(x) < sound.rate // 2 or not np.isfinite(x).all():
        raise EvidenceError(f"{name}: the sound is shorter than half a second or damaged; use --by motion.")
    if sound.rate != _RATE:
        g = gcd(int(sound.rate), _RATE)
        x = np.asarray(resample_poly(x, _RATE // g, int(sound.rate) // g), dtype=np.float64)
    x = sosfiltfilt(butter(2, [150, 3500], "bandpass", fs=_RATE, output="sos"), x)
    sd = float(np.std(x))
    if sd < 1e-9:
        raise EvidenceError(f"{name}: the sound is silent; use --by motion.")
    return np.asarray(x / sd, dtype=np.float64)


def _pair(a: Array, b: Array, largest_s: float) -> tuple[float, float]:
    """Seconds by which b is late against a, and the height of the peak in sd."""
    n = 1 << int(np.ceil(np.log2(len(a) + len(b))))
    cross = np.fft.rfft(b, n) * np.conj(np.fft.rfft(a, n))
    size = np.abs(cross)
    # half whitened: fully whitened, the quiet frequencies' noise would count like the sound
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
    """(C,) frames by which each view is late, against the median view, and what was seen in each ("lamp", "flash").

    brightness: mean of every frame of each view. An EvidenceError names a view without such an event."""
    found = [light_event(np.asarray(b, dtype=np.float64), n) for b, n in zip(brightness, names, strict=True)]
    kinds = tuple(k for _, k in found)
    if len(set(kinds)) > 1:
        seen = ", ".join(f"{n} {k}" for n, k in zip(names, kinds, strict=True))
        raise EvidenceError(f"The views saw different changes of the light ({seen}); use --by motion or --by sound.")
    at = np.array([t for t, _ in found])
    return at - np.median(at), kinds


def light_event(brightness: Array, name: str) -> tuple[float, str]:
    """When (frames, fractional) the light changed most in one view, and how: "lamp" (it stayed) or "flash"."""
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
        # what is missing to the new level, summed over the frames, is the time before the switch
        share = np.clip((after - b[low:high]) / (after - before), 0.0, 1.0)
        share[: max(k - low, 0)] = 1.0
        return low + float(share.sum()), "lamp"
    excess = np.abs(b[low:high] - slow[low:high])
    excess[excess < 0.1 * excess.max()] = 0.0
    return float((np.arange(low, high) * excess).sum() / excess.sum()) + 0.5, "flash"
