"""Segment the person in images: difference from a background model, shadow test, clean-up.

Images are BGR uint8 at working size, undistorted; masks are (h, w) uint8 with 1 = person. Lengths are px of that size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.cameras.camera import CameraRig
from hypose.compute import packed_masks, picture_to_mask
from hypose.compute.glance import Glance, glance_at
from hypose.compute.packed_masks import BitMask
from hypose.errors import InputError
from hypose.evidence.background import BackgroundModel
from hypose.evidence.frame import Silhouettes
from hypose.evidence.outlines import bounding_box
from hypose.geometry import Image, Mask

_RANGES = {
    "threshold": (1e-3, 1e3),
    "min_sd": (1e-3, 255.0),
    "shadow_chroma": (0.0, 500.0),
    "open_px": (0, 100),
    "close_px": (0, 100),
    "hole_px": (0, 10**6),
    "keep_share": (0.0, 1.0),
    "keep_gap": (0.0, 1e6),
}
"""Allowed range of each option; beyond it nothing is left of a mask, or it takes minutes to compute."""
_TWO_VALUED, _LABELS = 48, 32
"""Grey level from which the brighter of two values is no noise; largest number of labels in a picture of labels."""


class Segmenter(Protocol):
    """Interface of an object that segments the person in the images of one view (method `runs`)."""

    glance: Glance | None
    """quick test of a stored picture for any foreground; None: the whole image is needed"""

    def __call__(self, image: Image, band: Mask | None = None, /) -> Mask:
        """Segment an image (h, w, 3); band: (h, w) where the person can be. Returns the mask (h, w)."""
        ...

    def runs(self, image: Image, band: Mask | None = None, box: picture_to_mask.Box | None = None, /) -> BitMask:
        """Segment the person in an image; return a packed mask.

        band: pixels in which the person may be; None: all in the box.
        box: rows and columns in which the person is searched when there is no band; None: the whole image.
        """
        ...


@dataclass(frozen=True)
class SilhouetteSettings:
    """Settings for segmenting the person. The defaults suit a person of 80-400 px height.

    threshold: foreground is beyond this many sd.
    min_sd: lower bound of the sd, grey levels (compression, light).
    shadow: remove shadows, which have the same colour, but darker. Switch it off in grey scenes, where the person has
        the same colour too.
    shadow_range: brightness of a shadow relative to the lit ground.
    shadow_chroma: its largest colour distance from the darkened ground, grey levels.
    open_px, close_px: sizes of the morphological opening and closing, 0 = off.
    hole_px: holes up to this area are filled.
    keep_share: connected parts smaller than this share of the largest one are removed (1 keeps only the largest).
    keep_gap: parts further from the largest than this share of its longer side are removed.
    """

    threshold: float = 4.0
    min_sd: float = 5.0
    shadow: bool = True
    shadow_range: tuple[float, float] = (0.45, 0.97)
    shadow_chroma: float = 12.0
    open_px: int = 0
    close_px: int = 5
    hole_px: int = 60
    keep_share: float = 0.02
    keep_gap: float = 0.1

    @property
    def cleaning(self) -> packed_masks.Cleaning:
        """The settings of the mask's clean-up (opening, closing, holes, small parts)."""
        return packed_masks.Cleaning(self.open_px, self.close_px, self.hole_px, self.keep_share, self.keep_gap)

    @property
    def of_all_people(self) -> SilhouetteSettings:
        """The same settings for several people, who may be anywhere in the picture."""
        return replace(self, keep_gap=_RANGES["keep_gap"][1])

    def __post_init__(self) -> None:
        for name, (least, most) in _RANGES.items():
            if not least <= getattr(self, name) <= most:
                raise InputError(
                    f"Silhouette option {name} = {getattr(self, name)} must lie between {least:g} and {most:g}."
                )
        low, high = self.shadow_range
        if not 0 < low < high <= 1:
            raise InputError(
                f"Silhouette option shadow_range = {self.shadow_range} must be 0 < darkest < lightest <= 1."
            )


def make_segmenter(background: BackgroundModel, options: SilhouetteSettings | None = None) -> Segmenter:
    """Build the function that segments the images of one view.

    background: model of the empty room.
    options: settings (default: SilhouetteSettings()).
    It keeps no memory of earlier images, so frames may come in any order; one segmenter must not be called from two
    threads at once.
    """
    return _Segmenter(background, options or SilhouetteSettings())


class _Segmenter:
    def __init__(self, background: BackgroundModel, options: SilhouetteSettings) -> None:
        self._options, self._shape = options, background.valid.shape
        self._unseen = None if background.valid.all() else ~background.valid
        self._room = _room(background, options)
        self.glance: Glance | None = glance_at(self._room)

    def __call__(self, image: Image, band: Mask | None = None, /) -> Mask:
        return packed_masks.draw(self.runs(image, band))

    def runs(self, image: Image, band: Mask | None = None, box: picture_to_mask.Box | None = None, /) -> BitMask:
        h, w = self._shape
        if image.shape != (h, w, 3):
            raise InputError(f"An image of {image.shape[1::-1]} px does not fit a background of {(w, h)} px.")
        box = bounding_box(band) if band is not None else box or (0, h, 0, w)
        if box is None or box[0] == box[1]:
            return packed_masks.pack(np.zeros((h, w), np.uint8))
        mask = picture_to_mask.not_the_room(image, self._room, box)
        if self._unseen is not None:  # the room is unknown there: the person where the band allows it, else nothing
            mask[self._unseen] = band is not None
        if band is not None:
            mask[band == 0] = 0
        return packed_masks.clean(mask, self._options.cleaning)


def _room(background: BackgroundModel, options: SilhouetteSettings) -> picture_to_mask.BackgroundLevels:
    """Build the Gaussian model of each pixel and channel, with the brightness cone for shadows.

    background: model of the empty room.
    options: threshold, least sd, and shadows.
    Foreground: some channel more than `threshold` sd from the mean. Shadow: the pixel's colour a is s b + rest, with
    background b, s in shadow_range, and a small rest. Source: Xu, Landabaso & Pardas 2005 (as used by Alcoverro 2014,
    section 2.4); the brightness and colour distortions are those of Horprasert et al. 1999. Deviation: the colour
    distortion is in grey levels, not in sd, because with the small sd of clean video a soft shadow never passes.
    """
    reach = options.threshold * np.maximum(background.sd, np.float32(options.min_sd))
    mean = np.ascontiguousarray(background.mean, dtype=np.float32)
    return picture_to_mask.BackgroundLevels(
        np.clip(np.ceil(mean - reach), 0, 255).astype(np.uint8),
        np.clip(np.floor(mean + reach), 0, 255).astype(np.uint8),
        mean,
        options.shadow,
        *options.shadow_range,
        options.shadow_chroma**2,
    )


def clean_mask(mask: Mask, options: SilhouetteSettings | None = None) -> Mask:
    """Clean a mask: opening, closing, small holes filled, small parts removed.

    options: settings of the clean-up (default: SilhouetteSettings()).
    """
    return _cleaned(mask, (options or SilhouetteSettings()).cleaning)


def biggest_parts(mask: Mask, keep_share: float, keep_gap: float = np.inf) -> Mask:
    """Keep the largest connected part of a mask (h, w), and large parts near it.

    keep_share: least area relative to the largest part.
    keep_gap: largest distance of the boxes, relative to the longer side of the largest part's box.
    """
    return _cleaned(mask, packed_masks.Cleaning(keep_share=keep_share, keep_gap=keep_gap))


def _cleaned(mask: Mask, how: packed_masks.Cleaning) -> Mask:
    """Clean a mask (h, w) with the given settings."""
    return packed_masks.draw(packed_masks.clean(mask, how))


def as_mask(image: ArrayLike, source: str = "The mask image") -> Mask:
    """Convert an image to a mask (h, w): grey, colour (by its brightest channel) or with alpha, 8 or 16 bit.

    source: name of the image in error messages.
    The threshold is half of the range. Where nothing reaches that, images with zero and one other value (0/1, 0/127),
    or with two values and little in between (0/127 from a video), are split between the two values.
    Raises: InputError where it is a picture of several labels, or has another shape.
    """
    a = np.asarray(image)
    if a.ndim == 3 and a.shape[2] in (1, 3, 4):
        a = a[..., : min(a.shape[2], 3)].max(2)
    if a.ndim != 2:
        raise InputError(f"{source} has the shape {np.shape(image)}; a grey or colour image is needed.")
    if a.dtype == np.bool_:
        return a.astype(np.uint8)
    if not np.issubdtype(a.dtype, np.integer):
        return (a > 0.5).astype(np.uint8)
    top, half = int(a.max(initial=0)), 0.5 * np.iinfo(a.dtype).max
    return (a > (half if top > half else _dim_level(a, top, half, source))).astype(np.uint8)


def _dim_level(a: NDArray[Any], top: int, half: float, source: str) -> float:
    """Choose the threshold of an image (h, w) with no value above half its range.

    a: grey values.
    top: the largest.
    half: half of the range.
    source: name of the image for the error message.
    Raises: InputError where it is a picture of labels.
    """
    levels = np.unique(a[a > 0])
    if len(levels) < 2:
        return 0.5
    bright = int((a > 0.25 * top).sum())
    between = bright - int((a > 0.75 * top).sum())
    if top >= _TWO_VALUED and between < 0.1 * bright:
        return 0.5 * top
    if len(levels) <= _LABELS:
        shown = ", ".join(str(v) for v in levels[:4]) + (", ..." if len(levels) > 4 else "")
        raise InputError(
            f"{source} holds the labels {shown}, but not which of them is the person; write masks of the "
            "person alone (0 and 255)."
        )
    return half  # faint grey: probably no person was found


def flag_collapsed(
    areas: ArrayLike,
    history: ArrayLike,
    names: Sequence[str],
    frame: int,
    lowest: float = 0.6,
    highest: float = 2.5,
) -> tuple[str, ...]:
    """Find the views whose mask cannot be trusted.

    names: names of the C cameras.
    frame: its number, for the sentences.
    lowest, highest: the shares named below.
    areas: (C,) foreground pixels of this frame.
    history: (C, H) areas in frames around or before it (H may be 0).
    Returns: C sentences, "" for a good view. A mask is bad when it is empty, above `highest` times its median area,
        below `lowest` times the second smallest area of the history, or below half of `lowest` times the median.
    Why: the smallest areas count, because a person who turns sideways and walks away from a camera loses half the area
        within two seconds, and the mask is still right.
    """
    now = np.asarray(areas, dtype=np.float64)
    past = np.asarray(history, dtype=np.float64).reshape(len(now), -1)
    reasons = []
    for area, before, name in zip(now.tolist(), past.tolist(), names, strict=True):
        seen = sorted(a for a in before if a > 0)
        usual = (seen[(len(seen) - 1) // 2] + seen[len(seen) // 2]) / 2 if seen else 0.0
        smallest = seen[min(1, len(seen) - 1)] if seen else 0.0
        least = max(lowest * smallest, 0.5 * lowest * usual)
        if area <= 0:
            reasons.append(f"{name}, frame {frame}: the mask is empty")
        elif usual > 0 and not least <= area <= highest * usual:
            what = "collapsed" if area < usual else "far too large"
            reasons.append(f"{name}, frame {frame}: the mask is {what} ({area:.0f} px, usually {usual:.0f} px)")
        else:
            reasons.append("")
    return tuple(reasons)


def make_silhouettes(
    masks: Sequence[Mask | BitMask | None], rig: CameraRig, reasons: Sequence[str] | None = None
) -> Silhouettes:
    """Build the silhouettes of one instant from masks (h_c, w_c) per view, packed or not, padded with 0 to the common
    size.

    rig: pinhole cameras of the masks.
    reasons: (C,) why a view is not usable, "" where it is (default: all "").
    A view without a mask, with an empty one, or with a reason is not usable.
    Raises: InputError where a mask does not have its camera's size.
    """
    sizes = rig.sizes
    h, w = int(sizes[:, 1].max()), int(sizes[:, 0].max())
    out = np.zeros((len(rig), h, w), np.uint8)
    why = list(reasons) if reasons is not None else [""] * len(rig)
    for c, mask in enumerate(masks):
        if mask is None:
            why[c] = why[c] or f"{rig.names[c]}: no image"
            continue
        if mask.shape != (sizes[c, 1], sizes[c, 0]):
            raise InputError(
                f"Camera {rig.names[c]}: the mask is {mask.shape[1]} x {mask.shape[0]} px, the camera "
                f"{sizes[c, 0]} x {sizes[c, 1]} px."
            )
        if isinstance(mask, BitMask):
            packed_masks.draw(mask, out[c])
            empty = mask.area == 0
        else:
            np.not_equal(mask, 0, out=out[c, : mask.shape[0], : mask.shape[1]].view(np.bool_))
            empty = not mask.any()
        if not why[c] and empty:
            why[c] = f"{rig.names[c]}: the mask is empty"
    return Silhouettes(out, rig, np.array([not r for r in why]), tuple(why))


# ---- limbs that a mask does not confirm ----
# Limbs of a 2D skeleton that the mask does not confirm: there nothing of the mask may be cut away.
# A mask that is kept within a thick skeleton loses whatever a detector has got wrong: a limb that is taken for the
# other one, or is not seen at all, is cut off, and silhouettes that were to correct the key points can only agree
# with them.


CONFIRMED = 0.6
"""Least share of a limb's line that lies in the mask; for true limbs it is nearly 1, also in front of the trunk."""
_MIN_CONFIDENCE = 0.3
_LEAST_WHOLE = 3
_LIMBS = tuple(
    (f"{side}_{root}", f"{side}_{middle}", f"{side}_{end}", reach)
    for side in ("left", "right")
    for root, middle, end, reach in (("shoulder", "elbow", "wrist", 0.46), ("hip", "knee", "ankle", 0.58))
)
"""Root, middle and end of the limbs, and how far they reach, with hand or foot, in body heights."""


def with_doubted_limbs(
    band: NDArray[np.uint8], mask: NDArray[np.uint8], points: ArrayLike, names: Sequence[str], height: float
) -> NDArray[np.uint8] | None:
    """Widen the search band (h, w) around every limb of the 2D skeleton that the mask (h, w) does not confirm.

    band: pixels near the 2D skeleton, to which the mask was cut.
    points: (K, 3) px and confidence.
    names: names of the points.
    height: height of the person, px.
    A limb without its root point is left alone. Returns: the widened band; None where the mask confirms all limbs; a
    band of ones where most complete limbs lie outside the mask, because the skeleton is then in the wrong place.
    """
    p = np.asarray(points, dtype=np.float64)
    at = {n: p[k] for k, n in enumerate(names) if p[k, 2] > _MIN_CONFIDENCE}
    out = band.copy()
    doubted, whole, outside = False, 0, 0
    for root, middle, end, reach in _LIMBS:
        if root not in at or height <= 0:
            continue
        line = [at[n][:2] for n in (root, middle, end) if n in at]
        if len(line) == 3:
            whole += 1
            if _inside(mask, np.stack(line)) >= CONFIRMED:
                continue
            outside += 1
        doubted = True
        u, v = (int(np.clip(round(x), -4 * max(mask.shape), 4 * max(mask.shape))) for x in at[root][:2])
        cv2.circle(out, (u, v), max(1, round(reach * height)), 1, -1)
    if whole >= _LEAST_WHOLE and outside > 0.5 * whole:
        return np.ones_like(band)
    return out if doubted else None


def _inside(mask: NDArray[np.uint8], line: NDArray[np.float64]) -> float:
    """Compute the share of points along a line (N, 2), px, without its first tenth, that lie in the mask or outside
    the picture.
    """
    share = np.linspace(0.0, 1.0, 12)[1:, None]
    along = np.concatenate([a + share * (b - a) for a, b in zip(line[:-1], line[1:], strict=True)])
    u, v = np.rint(along).astype(int).T
    h, w = mask.shape
    out = (u < 0) | (v < 0) | (u >= w) | (v >= h)
    found = mask[np.clip(v, 0, h - 1), np.clip(u, 0, w - 1)] > 0
    return float((found | out).mean())
