"""Compute the probability that a pixel shows skin from its colour.

Source: Jones & Rehg 1999, "Statistical color models with application to skin detection" (IJCV 46(1), 2002; tech. report
CRL 98/11), Table 2 and Table 3: mixtures of 16 Gaussians with diagonal covariance in RGB for skin and for the rest.
"""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from hypose.errors import InputError
from hypose.geometry import Array

# mean R, G, B, variance R, G, B, weight
_SKIN = """
73.53 29.94 17.76 765.40 121.44 112.80 0.0294
249.71 233.94 217.49 39.94 154.44 396.05 0.0331
161.68 116.25 96.95 291.03 60.48 162.85 0.0654
186.07 136.62 114.40 274.95 64.60 198.27 0.0756
189.26 98.37 51.18 633.18 222.40 250.69 0.0554
247.00 152.20 90.84 65.23 691.53 609.92 0.0314
150.10 72.66 37.76 408.63 200.77 257.57 0.0454
206.85 171.09 156.34 530.08 155.08 572.79 0.0469
212.78 152.82 120.04 160.57 84.52 243.90 0.0956
234.87 175.43 138.94 163.80 121.57 279.22 0.0763
151.19 97.74 74.59 425.40 73.56 175.11 0.1100
120.52 77.55 59.82 330.45 70.34 151.82 0.0676
192.20 119.62 82.32 152.76 92.14 259.15 0.0755
214.29 136.08 87.24 204.90 140.17 270.19 0.0500
99.57 54.33 38.06 448.13 90.18 151.29 0.0667
238.88 203.08 176.91 178.38 156.27 404.99 0.0749
"""
_OTHER = """
254.37 254.41 253.82 2.77 2.81 5.46 0.0637
9.39 8.09 8.52 46.84 33.59 32.48 0.0516
96.57 96.95 91.53 280.69 156.79 436.58 0.0864
160.44 162.49 159.06 355.98 115.89 591.24 0.0636
74.98 63.23 46.33 414.84 245.95 361.27 0.0747
121.83 60.88 18.31 2502.24 1383.53 237.18 0.0365
202.18 154.88 91.04 957.42 1766.94 1582.52 0.0349
193.06 201.93 206.55 562.88 190.23 447.28 0.0649
51.88 57.14 61.55 344.11 191.77 433.40 0.0656
30.88 26.84 25.32 222.07 118.65 182.41 0.1189
44.97 85.96 131.95 651.32 840.52 963.67 0.0362
236.02 236.27 230.70 225.03 117.29 331.95 0.0849
207.86 191.20 164.12 494.04 237.69 533.52 0.0368
99.83 148.11 188.17 955.88 654.95 916.70 0.0389
135.06 131.92 123.10 350.35 130.30 388.43 0.0943
135.96 103.89 66.88 806.44 642.20 350.36 0.0477
"""
_BINS = 64


def _density(table: str, rgb: Array) -> Array:
    """Compute the density of a mixture at colours rgb (..., 3).

    table: text of lines of seven numbers: mean R, G, B, variance R, G, B, weight.
    Returns: (...,) densities.
    """
    out = np.zeros(rgb.shape[:-1])
    for line in np.array(table.split(), dtype=np.float64).reshape(-1, 7):
        mean, variance, weight = line[:3], line[3:6], line[6]
        distance = ((rgb - mean) ** 2 / variance).sum(-1)
        out += weight * np.exp(-0.5 * distance) / np.sqrt((2 * np.pi) ** 3 * variance.prod())
    return out


def _bin_centres() -> Array:
    """Return the colours (64, 64, 64, 3) BGR at the centres of the bins."""
    bins = np.arange(0.5, _BINS) * (256 / _BINS)
    return np.stack(np.meshgrid(bins, bins, bins, indexing="ij"), -1)


def skin_posterior(rgb: ArrayLike, prior: float = 0.3) -> Array:
    """Compute P(skin | colour) (...) of colours rgb (..., 3), 0..255.

    prior: share of skin among the pixels. It is larger within a person's silhouette than in the pictures of Jones &
        Rehg, where it is 0.09.
    """
    c = np.asarray(rgb, dtype=np.float64)
    skin, other = prior * _density(_SKIN, c), (1 - prior) * _density(_OTHER, c)
    total = skin + other
    return np.where(total > 1e-14, skin / np.maximum(total, 1e-300), 0.0)


ColorTable = NDArray[np.float32]
"""(64, 64, 64) probability of the colour at each bin's centre, by blue, green, red."""


@cache
def skin_table(prior: float = 0.3) -> ColorTable:
    """Compute the posterior of Jones & Rehg, P(skin | colour), as a table; prior: share of skin among the pixels."""
    return skin_posterior(_bin_centres()[..., ::-1], prior).astype(np.float32)


def learned_table(
    ends: NDArray[np.uint8], rest: NDArray[np.uint8], prior: float = 0.3, trust: float = 30.0
) -> ColorTable:
    """Learn a person's own colours: the probability that a pixel of this colour is of head or hands and not of the
    rest.

    ends: (N, 3), rest: (M, 3) uint8 BGR pixels of head and hands, and of the clothes, from a frame with a known pose.
    prior: share of head and hands among the pixels.
    trust: number of similar pixels at which the learnt colours get half of the weight; the rest is the posterior of
        Jones & Rehg.
    Returns: table of probabilities, see `ColorTable`.
    Colours are compared in brightness and two colour ratios, smoothed, so that shading matters little. Why: the
    published model misses dark skin and skin in shade (recall of hands 0.1 to 0.5 on rendered scenes, where this one
    has 0.5 to 0.9).
    """
    here = _smoothed(ends), _smoothed(rest)
    share = prior * here[0] / max(here[0].sum(), 1.0), (1 - prior) * here[1] / max(here[1].sum(), 1.0)
    own = share[0] / np.maximum(share[0] + share[1], 1e-12)
    certainty = (here[0] + here[1]) / (here[0] + here[1] + trust)
    at = _chroma_bins(_bin_centres())
    return (certainty[at] * own[at] + (1 - certainty[at]) * skin_table(prior)).astype(np.float32)


def _chroma_bins(bgr: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Compute bins of brightness (16, of a factor 1.2 to 1.5), red / green and green / blue (40 each) of colours
    (..., 3).
    """
    c = np.log(np.asarray(bgr, dtype=np.float64) + 4.0)  # + 4: ratios of nearly black pixels are noise
    bright = np.clip((c.mean(-1) - 1.4) / 4.2 * 16, 0, 15)
    red = np.clip((c[..., 2] - c[..., 1] + 0.8) / 2.0 * 40, 0, 39)
    blue = np.clip((c[..., 1] - c[..., 0] + 0.8) / 2.0 * 40, 0, 39)
    return bright.astype(np.int64), red.astype(np.int64), blue.astype(np.int64)


def _smoothed(pixels: NDArray[np.uint8]) -> Array:
    """Count pixels (N, 3) BGR in the bins of `_chroma_bins`, smoothed over neighbouring bins."""
    counts = np.zeros((16, 40, 40))
    np.add.at(counts, _chroma_bins(pixels), 1.0)
    return np.asarray(ndimage.gaussian_filter(counts, (1.5, 1.2, 1.2), truncate=3.0)) * 20.0  # nearby pixels


def skin_map(image: NDArray[np.uint8], mask: NDArray[np.uint8], table: ColorTable | None = None) -> NDArray[np.float32]:
    """Compute the probability of skin (h, w) in a picture (h, w, 3) uint8 BGR; 0 outside the mask (h, w).

    table: as returned by `skin_table` (default) or `learned_table`.
    It is the mean over 3 x 3 pixels within the mask without its outermost pixel, because masks include a little of the
    floor, which may be brown.
    Raises: InputError where the picture has another format, or picture and mask differ in size.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise InputError(
            f"The skin detector needs a colour picture (h, w, 3) of 8 bit, got {image.dtype} {image.shape}; grey "
            "recordings have no skin colour: use key points instead."
        )
    if mask.shape != image.shape[:2]:
        raise InputError(f"The mask {mask.shape} and the picture {image.shape[:2]} differ in size.")
    colors = skin_table() if table is None else table
    where = np.asarray(cv2.erode((mask > 0).astype(np.uint8), np.ones((3, 3), np.uint8)), dtype=np.uint8)
    x, y, w, h = cv2.boundingRect(where)
    out = np.zeros(image.shape[:2], np.float32)
    if w == 0:
        return out
    inside = where[y : y + h, x : x + w].astype(np.float32)
    bins = image[y : y + h, x : x + w] >> 2
    value = colors[bins[..., 0], bins[..., 1], bins[..., 2]] * inside
    total = cv2.blur(inside, (3, 3), borderType=cv2.BORDER_CONSTANT)
    mean = cv2.blur(value, (3, 3), borderType=cv2.BORDER_CONSTANT)
    out[y : y + h, x : x + w] = inside * mean / np.maximum(total, 1e-6)
    return out
