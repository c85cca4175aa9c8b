"""Pictures of one scene that were cut, scaled and begun otherwise, laid onto others of it by their still background.

Pose2Sim's film of two people was made from its film of one, with its edges cut, another scale (up to 11 px off) and one
frame more at the beginning. Tracked as it is, through the same calibration, the man would stand elsewhere for that.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from hypose.geometry import Array
from hypose.io.videos.video import open_video

_STILLS, _ROWS, _COLUMNS = 10, 6, 3
_AGREED = 0.5
"""Peak of a phase correlation from which the patch shows the same still thing in both films."""


def laid_onto(film: Path, other: Path, size: tuple[int, int], first: int, folder: Path) -> Path:
    """The folder, with the frames of a film from `first` on as pictures of size (w, h) px in which still things are
    where they are in the other film, stretched to that size."""
    offset, scale = _between(_still(film, size), _still(other, size))
    folder.mkdir(parents=True)
    matrix = np.array([[1 + scale[0], 0, offset[0]], [0, 1 + scale[1], offset[1]]])
    with open_video(film) as frames:
        for k, image in enumerate(frames):
            if k >= first:
                flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
                laid = cv2.warpAffine(cv2.resize(image, size), matrix, size, None, flags, cv2.BORDER_REPLICATE)
                cv2.imwrite(str(folder / f"{k - first:06d}.jpg"), laid, [cv2.IMWRITE_JPEG_QUALITY, 95])
    return folder


def _still(film: Path, size: tuple[int, int]) -> Array:
    """(h, w) edges of what stands still in a film."""
    with open_video(film) as frames:
        every = max(1, frames.n_frames // _STILLS)
        grey = [cv2.cvtColor(cv2.resize(im, size), cv2.COLOR_BGR2GRAY) for k, im in enumerate(frames) if k % every == 0]
    middle = np.median(np.stack(grey).astype(np.float32), 0).astype(np.float32)
    return np.asarray(cv2.Laplacian(cv2.GaussianBlur(middle, (0, 0), 2), cv2.CV_32F), dtype=np.float64)


def _between(film: Array, other: Array) -> tuple[Array, Array]:
    """Offset (2,) px and scale (2,): what is at x in the other picture is at x + offset + scale * x in the film's."""
    h, w = (n // k for n, k in zip(film.shape, (_ROWS, _COLUMNS), strict=True))
    at, moved, weight = [], [], []
    window = cv2.createHanningWindow((w, h), cv2.CV_64F)
    for y in range(0, _ROWS * h, h):
        for x in range(0, _COLUMNS * w, w):
            part = slice(y, y + h), slice(x, x + w)
            shift, peak = cv2.phaseCorrelate(other[part], film[part], window)
            if peak > _AGREED:
                at.append((x + w / 2, y + h / 2))
                moved.append(shift)
                weight.append(peak)
    place, shifts, peaks = np.array(at), np.array(moved), np.array(weight)
    lines = np.array([_line(place[:, axis], shifts[:, axis], peaks) for axis in range(2)])
    return lines[:, 0], lines[:, 1]


def _line(along: Array, shift: Array, peaks: Array) -> tuple[float, float]:
    """Start and slope of the shifts (n,) along an axis; patches in which somebody moved count less and less."""
    slope, start = np.polyfit(along, shift, 1, w=peaks)
    for _ in range(4):
        slope, start = np.polyfit(along, shift, 1, w=peaks / (1 + (shift - start - slope * along) ** 2))
    return float(start), float(slope)
