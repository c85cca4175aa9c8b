"""Extract the evidence for one person from masks that show several people.

Pixels that another person's body covers say nothing about this person: they are in the mask, no matter which of the two
is in front. Where it is known whom each pixel shows (`Silhouettes.owners`), pixels of two people are those of the
nearer one by the bodies' depth, and those of the farther one alone are background for the nearer one. In views without
other people nearby, the masks are cut to where the person is expected, and all pixels count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import CameraRig
from hypose.compute.parts import covered
from hypose.evidence.frame import Expected, Silhouettes
from hypose.geometry import Array

SOLVED_WIDENING, PREDICTED_WIDENING = 0.008, 0.016
"""Share of a body's longer side in the picture by which it is widened where it hides others: with a pose solved in this
frame, and with a predicted pose (2 and 4 px of 250)."""
_NEARBY, _LEAST_PX = 0.35, 32
"""Margin around a person's box inside which masks are evidence: share of its longer side, and least px."""
_SMALLEST_PX = 50
_NEAR_M = 0.05


@dataclass(frozen=True)
class BodyShape:
    """Skin of a posed body as pinhole cameras see it.

    vertices: (V, 3) m.
    faces: (F, 3) faces of a closed surface.
    rig: the cameras.
    """

    vertices: Array
    faces: NDArray[np.int32]
    rig: CameraRig

    @cached_property
    def _projected(self) -> tuple[Array, Array]:
        """Projected vertices (C, 2, V), px, NaN next to and behind the camera; their depths (C, V), m."""
        p = self.rig.projections
        x = p[:, :, :3] @ self.vertices.T + p[:, :, 3:]
        z = x[:, 2:]
        if z.min() > _NEAR_M:
            return x[:, :2] / z, x[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(z > _NEAR_M, x[:, :2] / z, np.nan), x[:, 2]

    @cached_property
    def boxes(self) -> NDArray[np.int64]:
        """Boxes (C, 4) y0, y1, x0, x1, px, half open, around the body in each view's image; empty where the body is
        not in view.
        """
        uv, size = self._projected[0], self.rig.sizes
        low, high = np.floor(np.fmin.reduce(uv, 2)), np.ceil(np.fmax.reduce(uv, 2)) + 1
        low, high = (np.clip(np.nan_to_num(n), 0, size).astype(np.int64) for n in (low, high))
        out = np.stack([low[:, 1], high[:, 1], low[:, 0], high[:, 0]], 1)
        return np.where((high > low).all(1)[:, None], out, 0)

    def depth(self, view: int) -> float:
        """Median depth of the vertices in a view, m."""
        return float(np.median(self._projected[1][view]))

    @cached_property
    def _kept(self) -> dict[int, NDArray[np.uint8]]:
        return {}

    def drawn(self, view: int) -> NDArray[np.uint8]:
        """Draw the silhouette, 0 and 1, inside its box in a view."""
        if view not in self._kept:
            y0, y1, x0, x1 = self.boxes[view].tolist()
            uv, z = (a[view] for a in self._projected)
            closed = bool(z.min() > _NEAR_M)  # else a part lies behind the camera and the surface has a hole
            shape = max(y1 - y0, 0), max(x1 - x0, 0)
            self._kept[view] = covered(uv.T - (x0, y0), z, self.faces, shape, closed)
        return self._kept[view]


@dataclass(frozen=True)
class DrawnShape:
    """Shape of a person given as masks (C, h, w) of 0 and 1; same interface as BodyShape."""

    masks: NDArray[np.uint8]

    @cached_property
    def boxes(self) -> NDArray[np.int64]:
        """Boxes (C, 4) y0, y1, x0, x1, px, half open, around the mask in each view; empty where it is not in view."""
        found = [cv2.boundingRect(m) for m in self.masks]
        return np.array([(y, y + h, x, x + w) for x, y, w, h in found], dtype=np.int64).reshape(-1, 4)

    def drawn(self, view: int) -> NDArray[np.uint8]:
        """Return the silhouette (0 and 1) inside its box in a view."""
        y0, y1, x0, x1 = self.boxes[view]
        return self.masks[view, y0:y1, x0:x1]


StandingShape = BodyShape | DrawnShape
"""Shape of a person: a posed body, or a part of a hull."""


@dataclass(frozen=True)
class Other:
    """Another person, who may hide the tracked person.

    shape: the person's silhouette in each view.
    widened: width by which the silhouette is widened, as a share of its longer side.
    """

    shape: StandingShape
    widened: float = PREDICTED_WIDENING

    def thinned(self, rig: CameraRig) -> Other:
        """Copy the person for masks in which only every other pixel is kept; rig: cameras of these masks."""
        s = self.shape
        thin = BodyShape(s.vertices, s.faces, rig) if isinstance(s, BodyShape) else DrawnShape(s.masks[:, ::2, ::2])
        return Other(thin, self.widened)


def _hide(ignored: NDArray[np.uint8], shape: StandingShape, view: int, share: float, within: Sequence[int]) -> None:
    """Draw the widened silhouette of a shape into ignored (h, w), inside y0, y1, x0, x1, in place.

    ignored: changed in place.
    view: index of the view.
    share: share of the longer side of the box by which the silhouette is widened.
    within: the region.
    """
    y0, y1, x0, x1 = shape.boxes[view].tolist()
    px = max(1, round(share * max(y1 - y0, x1 - x0)))
    top, bottom = max(y0, within[0] - px), min(y1, within[1] + px)  # the part that reaches into the region
    left, right = max(x0, within[2] - px), min(x1, within[3] + px)
    if top >= bottom or left >= right:
        return
    drawn = shape.drawn(view)[top - y0 : bottom - y0, left - x0 : right - x0]
    framed = cv2.copyMakeBorder(drawn, px, px, px, px, cv2.BORDER_CONSTANT, value=0)
    wide = np.asarray(cv2.dilate(framed, _disc(px)), np.uint8)
    top, left = top - px, left - px
    y0, y1 = max(within[0], top), min(within[1], bottom + px)
    x0, x1 = max(within[2], left), min(within[3], right + px)
    ignored[y0:y1, x0:x1] |= wide[y0 - top : y1 - top, x0 - left : x1 - left]


@cache
def _disc(radius: int) -> cv2.typing.MatLike:
    """Build a filled ellipse of 2 radius + 1 px as a kernel of OpenCV."""
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))


def without(silhouettes: Silhouettes, others: Sequence[Other]) -> Silhouettes:
    """Mark the pixels of other people in the silhouettes as ignored.

    others: the people whose bodies, widened, cover the pixels.
    Returns: the silhouettes without an expected place of a person, so they are for visual hulls and not for
        outlines.
    """
    if not others:
        return silhouettes
    ignored = np.zeros_like(silhouettes.masks)
    for c, (w, h) in enumerate(silhouettes.rig.sizes.tolist()):
        for one in others:
            _hide(ignored[c], one.shape, c, one.widened, (0, h, 0, w))
    return replace(silhouettes, ignored=ignored)


def own_silhouettes(
    silhouettes: Silhouettes, own: StandingShape, others: Sequence[Other], anywhere: bool = False
) -> Silhouettes:
    """Extract the evidence for one person from masks of several people.

    own: shape where the person is expected.
    others: all other people.
    anywhere: the person was lost and may be anywhere in the masks that no other person covers.
    Returns: silhouettes; views without other people nearby have no ignored pixels; a view in which the person is not
        expected is not usable.
    """
    sizes, boxes = silhouettes.rig.sizes.tolist(), own.boxes.copy()
    masks, ignored = np.zeros_like(silhouettes.masks), None
    usable, reasons = np.array(silhouettes.usable, dtype=np.bool_), list(silhouettes.reasons)
    areas = np.zeros(len(boxes), np.int64)
    for c, (w, h) in enumerate(sizes):
        y0, y1, x0, x1 = boxes[c].tolist()
        if not usable[c]:
            continue
        if anywhere:
            part = (0, h, 0, w)
        elif y1 <= y0 or (y1 - y0) * (x1 - x0) < _SMALLEST_PX:
            usable[c], reasons[c] = False, f"{silhouettes.rig.names[c]}: the person is out of view"
            continue
        else:
            m = max(_LEAST_PX, round(_NEARBY * max(y1 - y0, x1 - x0)))
            part = (max(y0 - m, 0), min(y1 + m, h), max(x0 - m, 0), min(x1 + m, w))
        at = (c, slice(part[0], part[1]), slice(part[2], part[3]))
        masks[at] = silhouettes.masks[at]
        near = [o for o in others if _meet(o, c, part)]
        if near:
            ignored = np.zeros_like(masks) if ignored is None else ignored
            mine = _owned(silhouettes, own, c)
            for one in near:
                theirs = _owned(silhouettes, one.shape, c)
                if silhouettes.owners is None or not mine or not theirs or mine == theirs:
                    _hide(ignored[c], one.shape, c, one.widened, part)
                elif own.depth(c) < one.shape.depth(c):
                    masks[at] &= (silhouettes.owners[at] & (mine | theirs) != theirs).view(np.uint8)
                else:
                    ignored[at] |= (silhouettes.owners[at] & theirs > 0).view(np.uint8)
            areas[c] = np.count_nonzero(own.drawn(c))
        if anywhere and y1 <= y0:
            boxes[c] = part
        known = masks[at] if ignored is None else masks[at] > ignored[at]
        if not known.any():
            usable[c], reasons[c] = False, f"{silhouettes.rig.names[c]}: no part of the person is visible"
    expected = None if ignored is None else Expected(boxes, areas)
    return Silhouettes(masks, silhouettes.rig, usable, tuple(reasons), ignored, expected)


def _owned(silhouettes: Silhouettes, shape: StandingShape, view: int) -> int:
    """Find the bit of `Silhouettes.owners` whose pixels overlap most with a person's body in a view; 0 where it is not
    known.
    """
    if silhouettes.owners is None or not isinstance(shape, BodyShape):
        return 0
    y0, y1, x0, x1 = shape.boxes[view].tolist()
    drawn, owners = shape.drawn(view) > 0, silhouettes.owners[view]
    best, most = 0, 0.0
    for bit in (1, 2, 4, 8):
        both = np.count_nonzero(drawn & (owners[y0:y1, x0:x1] & bit > 0))
        share = both / max(np.count_nonzero(drawn) + np.count_nonzero(owners & bit) - both, 1)
        best, most = (bit, share) if share > most else (best, most)
    return best


def _meet(other: Other, view: int, part: Sequence[int]) -> bool:
    """Decide whether the widened box of another person overlaps a region of a view; part: y0, y1, x0, x1, px."""
    y0, y1, x0, x1 = other.shape.boxes[view].tolist()
    m = 1 + round(other.widened * max(y1 - y0, x1 - x0))
    return y1 > y0 and y0 - m < part[1] and y1 + m > part[0] and x0 - m < part[3] and x1 + m > part[2]
