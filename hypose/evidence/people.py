"""Find people in the visual hull or in depth maps, and extract the evidence for one of several people.

A measured pixel is a place in the world, so it belongs to the nearest body or cluster: people need not be separated in
the picture. Pixels of others in front give no information on a person, who may be hidden behind them; pixels of others
behind show that the person is not in front of them.
The module also gives the space that a person may fill.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from hypose.cameras.camera import CameraRig
from hypose.compute.parts import covered
from hypose.errors import EvidenceError
from hypose.evidence.depth_evidence import JUMP_M, Depth
from hypose.evidence.frame import Expected, Frame, Silhouettes
from hypose.evidence.hull import Hull, common_view_bounds, visual_hull
from hypose.geometry import Array

# ---- evidence for one of several people ----------------------------------------------------------------------------
# Extract the evidence for one person from masks that show several people.
#
# Pixels that another person's body covers say nothing about this person: they are in the mask, no matter which of the
# two is in front. Where it is known whom each pixel shows (`Silhouettes.owners`), pixels of two people are those of the
# nearer one by the bodies' depth, and those of the farther one alone are background for the nearer one. In views
# without other people nearby, the masks are cut to where the person is expected, and all pixels count.


SOLVED_WIDENING, PREDICTED_WIDENING = 0.008, 0.016
"""Share of a body's longer side in the picture by which it is widened where it hides others: with a pose solved in this
frame, and with a predicted pose (2 and 4 px of 250)."""
# Margin around a person's box inside which masks are evidence: share of its longer side, and least px.
_NEARBY, _MARGIN_PX = 0.35, 32
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
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * px + 1, 2 * px + 1))
    wide = np.asarray(cv2.dilate(framed, disc), np.uint8)
    top, left = top - px, left - px
    y0, y1 = max(within[0], top), min(within[1], bottom + px)
    x0, x1 = max(within[2], left), min(within[3], right + px)
    ignored[y0:y1, x0:x1] |= wide[y0 - top : y1 - top, x0 - left : x1 - left]


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


def _own_mask(
    silhouettes: Silhouettes, c: int, own: StandingShape, others: Sequence[Other], anywhere: bool
) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None, Sequence[int], int, str]:
    """Extract the evidence for one person from the mask of one view that shows several people.

    c: index of the view.
    own, others, anywhere: as for `own_frame`.
    Returns: mask (h, w); ignored pixels (h, w), None where no other person is nearby; box y0, y1, x0, x1 and area of
        the person, px; why the view is not usable, empty where it is.
    """
    mask, ignored, area = np.zeros_like(silhouettes.masks[c]), None, 0
    (w, h), (y0, y1, x0, x1) = silhouettes.rig.sizes[c].tolist(), own.boxes[c].tolist()
    part = (0, h, 0, w)
    if not anywhere:
        if y1 <= y0 or (y1 - y0) * (x1 - x0) < _SMALLEST_PX:
            return mask, None, own.boxes[c], 0, "the person is out of view"
        m = max(_MARGIN_PX, round(_NEARBY * max(y1 - y0, x1 - x0)))
        part = (max(y0 - m, 0), min(y1 + m, h), max(x0 - m, 0), min(x1 + m, w))
    at = slice(part[0], part[1]), slice(part[2], part[3])
    mask[at] = silhouettes.masks[c][at]
    if near := [o for o in others if _meet(o, c, part)]:
        ignored = np.zeros_like(mask)
        owners, (mine, own_depth) = silhouettes.owners, _owned(silhouettes, own, c)
        for one in near:
            theirs, depth = _owned(silhouettes, one.shape, c)
            if owners is None or not mine or not theirs or mine == theirs:
                _hide(ignored, one.shape, c, one.widened, part)
            elif own_depth < depth:
                mask[at] &= (owners[c][at] & (mine | theirs) != theirs).view(np.uint8)
            else:
                ignored[at] |= (owners[c][at] & theirs > 0).view(np.uint8)
        area = int(np.count_nonzero(own.drawn(c)))
    known = mask[at] if ignored is None else mask[at] > ignored[at]
    box = part if anywhere and y1 <= y0 else own.boxes[c]
    return mask, ignored, box, area, "" if known.any() else "no part of the person is visible"


def _owned(silhouettes: Silhouettes, shape: StandingShape, c: int) -> tuple[int, float]:
    """Find the bit of `Silhouettes.owners` whose pixels overlap most with a person's body in view c.

    Returns: the bit, 0 where it is not known; median depth of the body, m.
    """
    if silhouettes.owners is None or not isinstance(shape, BodyShape):
        return 0, 0.0
    y0, y1, x0, x1 = shape.boxes[c].tolist()
    drawn, owners = shape.drawn(c) > 0, silhouettes.owners[c]
    best, most = 0, 0.0
    for bit in (1, 2, 4, 8):
        both = np.count_nonzero(drawn & (owners[y0:y1, x0:x1] & bit > 0))
        share = both / max(np.count_nonzero(drawn) + np.count_nonzero(owners & bit) - both, 1)
        best, most = (bit, share) if share > most else (best, most)
    return best, float(np.median(shape._projected[1][c]))


def _meet(other: Other, view: int, part: Sequence[int]) -> bool:
    """Decide whether the widened box of another person overlaps a region of a view; part: y0, y1, x0, x1, px."""
    y0, y1, x0, x1 = other.shape.boxes[view].tolist()
    m = 1 + round(other.widened * max(y1 - y0, x1 - x0))
    return y1 > y0 and y0 - m < part[1] and y1 + m > part[0] and x0 - m < part[3] and x1 + m > part[2]


# ---- people in the visual hull -------------------------------------------------------------------------------------
# Find people in the visual hull: parts of it that stand on the floor, each around one upright axis.
#
# A hull of several people has a part for each of them, and ghosts where the rays of one camera to one person cross the
# rays of another camera to another person. So people who are already known are removed first
# (`hypose.evidence.people` ignores their pixels), and a person must be visible in several views in pixels that no
# other person explains.


VOXEL = 0.04
LITRES, _TALL, FROM_FLOOR = 20.0, 1.0, 0.5
"""A person has at least this hull volume, litres, reaches at least this height, m, and begins at most this far above
the floor, m."""
CHILD_LITRES, CHILD, SLENDER = 12.0, 0.75, 42.0
"""A child has at least this hull volume, litres, and height, m, and at most SLENDER times the cube of the height in
litres: for children of 0.9 to 1.1 m it was 23 to 39 in four views, for people of any age 20 to 36; for stools, chairs,
    dogs, bins
and suitcases 48 to 140.
"""
FEWEST_VIEWS = 3
"""Number of views that must show a person in pixels that no other person explains; with two there are ghosts."""
ABOUT, REACH, _APART = 0.3, 0.9, 0.42
"""m: the hull within ABOUT of an upright axis makes a person; hull within REACH may belong to it too; two axes are at
least _APART from each other."""
OWN_SHARE = 0.12
"""Least share of a person's pixels in a view that no other person fills."""
PART_OF_LARGER_M, SMALL = 0.5, 0.6
"""A person this near to a larger one, m, with at most this share of its hull, is a part of it: a seated person's knees,
or an arm held out."""
_SPREAD, _FINE = 0.12, 0.06
_WIDENED = 0.01
_NEAR_CAMERA = 0.2
# cells around the hull's plan, so that its smoothed density falls to zero inside the array
_RIM = 12


def views_to_find(frame: Frame) -> int:
    """Return the number of views that must show a new person in pixels that no known person explains.

    It is 1 with depth cameras, whose pixels are places in the world, else FEWEST_VIEWS. (`Frame.fewest_views` is the
    number that locates a person who is known.)
    """
    return FEWEST_VIEWS if frame.depth is None else 1


@dataclass(frozen=True)
class HullPerson:
    """Person found in a visual hull.

    hull: the part of the hull that is this person.
    axis: (2,) where the person stands on the floor, m.
    seen: (C, h, w) the person's pixels, where they are known (depth cameras).
    """

    hull: Hull
    axis: Array
    seen: NDArray[np.uint8] | None = None

    @property
    def litres(self) -> float:
        """Volume of the hull, litres."""
        return 1e3 * self.hull.volume

    @property
    def tall(self) -> bool:
        """Whether the hull is as tall as most adults; False for a small child."""
        return self.hull.height > _TALL

    @property
    def is_person(self) -> bool:
        """Whether the hull has the volume of a person, or of a child."""
        return _like_a_person(self.hull.height, self.litres, self.litres)

    def shape(self, rig: CameraRig, about: float = np.inf) -> DrawnShape:
        """Draw the person in all views, with gaps closed; about: draw only the hull within this distance of the axis,
        m.

        rig: pinhole cameras of the masks. Where the pixels of depth cameras are known, these are returned.
        """
        if self.seen is not None:
            return DrawnShape(self.seen)
        points = self.hull.points if np.isfinite(about) else self.hull.surface_points
        points = points[np.linalg.norm(points[:, :2] - self.axis, axis=1) < about]
        out = np.zeros((len(rig), int(rig.sizes[:, 1].max()), int(rig.sizes[:, 0].max())), np.uint8)
        for c, camera in enumerate(rig):
            w, h = camera.size
            depth = points @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
            front = depth > _NEAR_CAMERA
            if not front.any():
                continue
            at = np.rint(camera.project_pinhole(points[front]))
            at = at[((at >= 0) & (at < (w, h))).all(1)].astype(np.int64)
            out[c, at[:, 1], at[:, 0]] = 1
            r = int(np.ceil(0.6 * self.hull.voxel * camera.K[0, 0] / float(np.median(depth[front]))))
            disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * r + 1, 2 * r + 1))
            out[c, :h, :w] = cv2.morphologyEx(cv2.dilate(out[c, :h, :w], disc), cv2.MORPH_CLOSE, disc)
        return DrawnShape(out)


def people_in_hull(
    silhouettes: Silhouettes,
    known: Sequence[Other] = (),
    *,
    floor: float = 0.0,
    most: int = 8,
) -> list[HullPerson]:
    """Find the people in the masks who are not known yet; the largest comes first.

    known: people whose pixels are ignored.
    floor: height of the floor, m. The cameras' common view is searched, between the floor and a person's reach.
    most: largest number of people.
    Returns: the people; none where too few views are usable. Each voxel belongs to the nearest axis.
    """
    views = int(silhouettes.usable.sum())
    least = min(FEWEST_VIEWS, views)
    left = without(silhouettes, known)
    if views < 2 or (left.informative.any((1, 2)) & left.usable).sum() < least:
        return []
    try:
        bounds = common_view_bounds(silhouettes.rig)
        bounds = np.array([[*bounds[0, :2], floor - 0.3], [*bounds[1, :2], floor + 2.6]])
        # where people are known, the pixels that they cover may or may not be in the mask
        hull = visual_hull(left, bounds, VOXEL, min_views=least, largest=False, surely=least)
    except EvidenceError:
        return []
    found = people_of_hull(hull, floor, most)
    return _not_ghosts(left, sorted(found, key=lambda p: -p.litres), least)


def people_of_hull(hull: Hull, floor: float, most: int, surface: float = 0.0) -> list[HullPerson]:
    """Split a hull into parts that stand on the floor, one per person; parts that are no person (ghosts, where
    silhouettes of different people intersect) are included.

    floor: height of the floor, m.
    most: largest number of people.
    surface: least volume of a person where the voxels are only its surface, litres; 0: the voxels fill the person.
    Returns: the people, in the order of the hull's density where they stand.
    """
    litre, points = 1e3 * hull.voxel**3, hull.points
    filled = np.pad(hull.occupancy.sum(2), _RIM)
    density = np.asarray(ndimage.gaussian_filter(filled * litre, _SPREAD / hull.voxel))
    disc, small, wide = (_disc(r / hull.voxel) for r in (ABOUT, _FINE, _APART))
    around = np.rint(
        cv2.filter2D(filled.astype(np.float32), -1, disc.astype(np.float32), borderType=cv2.BORDER_CONSTANT)
    )
    beyond = wide.shape[0] // 2
    free = np.pad(density > 0, beyond)  # so that no disc ends at the plan's border
    axes: list[Array] = []
    for cell in np.argsort(-density, axis=None, kind="stable").tolist():
        i, j = divmod(cell, density.shape[1])
        if len(axes) == most or density[i, j] <= 0:
            break
        if not free[i + beyond, j + beyond]:
            continue
        taken = small
        # most places have too little hull around them
        if around[i, j] * litre > (surface or CHILD_LITRES):
            axis = hull.origin[:2] + (np.array([i, j]) - _RIM) * hull.voxel
            away = np.linalg.norm(points[:, :2] - axis, axis=1)
            if _stands(points[away < ABOUT], np.count_nonzero(away < PART_OF_LARGER_M) * litre, litre, floor, surface):
                axes.append(axis)
                taken = wide  # no other person stands so near
        r = taken.shape[0] // 2
        free[i + beyond - r : i + beyond + r + 1, j + beyond - r : j + beyond + r + 1] &= ~taken
    if not axes:
        return []
    # tested again with the nearest voxels of each: knees and arms in front of a trunk are no person
    while True:
        away = np.linalg.norm(points[:, None, :2] - np.array(axes), axis=2)
        nearest = away.argmin(1)
        nearby = (away < PART_OF_LARGER_M).sum(0) * litre
        near = [points[(nearest == k) & (away[:, k] < ABOUT)] for k in range(len(axes))]
        stands = [_stands(part, nearby[k], litre, floor, surface) for k, part in enumerate(near)]
        if all(stands) or len(axes) == 1:
            own = [(nearest == k) & (away[:, k] < REACH) for k in range(len(axes))]
            return [HullPerson(_part(hull, part, axis), axis) for axis, part in zip(axes, own, strict=True)]
        worst = max(k for k, ok in enumerate(stands) if not ok)  # they come in the order of their density
        del axes[worst]


def _disc(radius: float) -> NDArray[np.bool_]:
    """Build a disc (2 r + 1, 2 r + 1) of cells."""
    r = int(radius)
    u, v = np.ogrid[-r : r + 1, -r : r + 1]
    return np.hypot(u, v) < radius


def _stands(near: Array, nearby: float, litre: float, floor: float, surface: float) -> bool:
    """Decide whether the voxels (M, 3), m, around an axis make a person.

    near: voxels nearer than ABOUT.
    litre: volume of one voxel, litres.
    floor: height of the floor, m.
    surface: as for `people_of_hull`.
    nearby: litres within PART_OF_LARGER_M, of any person. Why: a part of something wide is no child; and a child's
        surface alone is no larger than that of furniture.
    """
    if not len(near) or near[:, 2].min() - floor > FROM_FLOOR:
        return False
    return _like_a_person(float(np.ptp(near[:, 2])), len(near) * litre, nearby, surface)


def _like_a_person(height: float, litres: float, nearby: float, surface: float = 0.0) -> bool:
    """Decide by height, m, and volume, litres, whether a hull may be a person, or a child; nearby, surface: as for
    `_stands`.
    """
    if height > _TALL:
        return litres > (surface or LITRES)
    return not surface and height > CHILD and litres > CHILD_LITRES and nearby < SLENDER * height**3


def _not_ghosts(left: Silhouettes, found: list[HullPerson], least: int) -> list[HullPerson]:
    """Keep the people who show own pixels in several views; ghosts lie where the masks belong to other people.

    left: silhouettes in which known people are ignored.
    found: candidates, the largest first.
    least: number of views.
    """
    given, kept, others = left.informative, list[HullPerson](), list[Other]()
    for person in found:
        if _larger(person, kept) is not None:
            continue
        shape = person.shape(left.rig)
        rest = given & without(left, others).informative
        own = np.array([int((shape.masks[c] & rest[c]).sum()) for c in np.flatnonzero(left.usable)])
        whole = np.array([max(int(shape.masks[c].sum()), 1) for c in np.flatnonzero(left.usable)])
        if (own > OWN_SHARE * whole).sum() >= least and person.is_person:
            kept.append(person)
            others.append(Other(shape, _WIDENED))
    return kept


def _larger(person: HullPerson, kept: Sequence[HullPerson]) -> int | None:
    """Find the first of the people of whom a person is a part (PART_OF_LARGER_M, SMALL); None where there is none."""
    near = (np.linalg.norm(k.axis - person.axis) < PART_OF_LARGER_M and person.litres < SMALL * k.litres for k in kept)
    return next((k for k, part in enumerate(near) if part), None)


def _part(hull: Hull, chosen: NDArray[np.bool_], axis: Array) -> Hull:
    """Select the part of the chosen voxels (M,) that is connected to those near the axis (2,).

    hull: hull of all people; returned is a hull cut to the part.
    """
    index = np.argwhere(hull.occupancy)
    kept = np.zeros_like(hull.occupancy)
    kept[tuple(index[chosen].T)] = True
    label = np.zeros(kept.shape, np.int32)
    ndimage.label(kept, np.ones((3, 3, 3)), output=label)
    near = chosen & (np.linalg.norm(hull.points[:, :2] - axis, axis=1) < ABOUT)
    own = np.unique(label[tuple(index[near].T)])
    kept = np.isin(label, own[own > 0])
    low, high = np.argwhere(kept).min(0), np.argwhere(kept).max(0) + 1
    part = kept[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
    return Hull(part, hull.origin + low * hull.voxel, hull.voxel)


# ---- people in depth maps, and the evidence of each ----------------------------------------------------------------
_THICK_M, _VOXEL_M = 0.16, 0.03
_AROUND = np.ones((3, 3), np.uint8)


SURFACE_LITRES = 15.0
"""Least surface of a person that one sensor shows, in litres of voxels of VOXEL; arms between two people show less."""
# m: points this near to a body are explained by it; points further away than the second belong to no person yet
_EXPLAINED_M, _REACH_M = 0.2, 0.5
# m: distance of a cluster's own pixels; a pixel nearer than this to another person's body belongs to that person
_CLUSTER_M = 0.08
# m behind the visible part of a person: others there do not hide it
_BEHIND_M = 0.4
_LEAST_PX, _PER_VOXEL = 50, 2
_EDGE = np.ones((5, 5), np.uint8)


def occupied_space(frame: Frame, bounds: Array | None = None) -> Hull:
    """Compute the space that the person of a frame may fill.

    With depth it is the seen surface and the space up to _THICK_M (m) behind it, else the visual hull of the masks.

    bounds: (2, 3) m, limits the space.
    Raises: EvidenceError where no sensor shows a person.
    """
    if frame.depth is None:
        return visual_hull(frame.the(Silhouettes), bounds)
    depth = frame.depth
    at, seen = replace(depth, maps=np.stack([cv2.medianBlur(m, 3) for m in depth.maps])).pixels
    whole = _even(depth.maps, _AROUND, JUMP_M)[tuple(at.T)]
    at, seen = at[whole], seen[whole]
    if not len(seen):
        raise EvidenceError("No depth camera shows a person; choose another frame, or record the empty room again.")
    ray = seen - depth.rig.positions[at[:, 0]]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    ray[:, 2] = 0  # feet and head are where they are seen
    behind = np.arange(0.0, _THICK_M, _VOXEL_M)
    points = (seen[:, None] + behind[:, None] * ray[:, None]).reshape(-1, 3)
    if bounds is not None:
        points = points[((points >= bounds[0]) & (points <= bounds[1])).all(1)]
    if not len(points):
        return Hull(np.zeros((1, 1, 1), dtype=np.bool_), np.zeros(3), _VOXEL_M)
    return _voxels(points, _VOXEL_M, 1)


def _even(maps: NDArray[np.float32], around: NDArray[np.uint8], most: float) -> NDArray[np.bool_]:
    """Find the pixels (C, h, w) around which depth maps differ by less than `most`, m; around: shape of the part."""
    return np.stack([cv2.dilate(m, around) - cv2.erode(m, around) < most for m in maps])


def _voxels(points: Array, voxel: float, least: int) -> Hull:
    """Make the hull of the voxels (edge in m) that hold at least `least` of the points (N, 3), m."""
    origin = points.min(0)
    index = np.rint((points - origin) / voxel).astype(np.int64)
    count = np.zeros(index.max(0) + 1, np.int32)
    np.add.at(count, tuple(index.T), 1)
    return Hull(count >= least, origin, voxel)


def people_seen(frame: Frame, known: Sequence[Other] = (), *, floor: float = 0.0) -> list[HullPerson]:
    """Find the people in a frame who are not known yet, in depth maps where the frame has some, else in the visual
    hull; the largest come first.

    known: people who are left out.

    floor: height of the floor, m.
    """
    if frame.depth is not None:
        return people_in_depth(frame.depth, known, floor=floor)
    return [] if frame.silhouettes is None else people_in_hull(frame.silhouettes, known, floor=floor)


def people_in_depth(
    depth: Depth, known: Sequence[Other] = (), *, floor: float = 0.0, most: int = 8
) -> list[HullPerson]:
    """Find the people in depth maps who are not known yet, the largest first.

    Each pixel belongs to the nearest axis. Values between both sides of a depth edge are left out.
    known: people who are left out.
    floor: height of the floor, m.
    most: largest number of people.
    """
    at, points = depth.pixels
    rest = _even(depth.maps, _AROUND, 2 * JUMP_M)[tuple(at.T)]
    for one in known:
        rest &= _away(one.shape, at, points) > _EXPLAINED_M
    at, points = at[rest], points[rest]
    if len(points) < _LEAST_PX:
        return []
    solid = _voxels(points, VOXEL, _PER_VOXEL)
    if not solid.occupancy.any():
        return []
    found = list[HullPerson]()
    for person in people_of_hull(solid, floor, most, SURFACE_LITRES):
        own = person.hull
        inside = np.rint((points - own.origin) / VOXEL).astype(np.int64)
        last = np.array(own.occupancy.shape) - 1
        within = (inside == np.clip(inside, 0, last)).all(1) & own.occupancy[tuple(np.clip(inside, 0, last).T)]
        masks = np.zeros_like(depth.person)
        masks[tuple(at[within].T)] = 1
        found.append(replace(person, seen=masks))
    return _without_parts(sorted(found, key=lambda p: -p.litres))


def _without_parts(found: Sequence[HullPerson]) -> list[HullPerson]:
    """Add the pixels of separate parts, such as an arm held out, to the larger person nearby.

    found: people, the largest first. Returns: those who are no part of a larger one.
    """
    kept = list[HullPerson]()
    for person in found:
        larger = _larger(person, kept)
        if larger is None:
            kept.append(person)
            continue
        own, rest = kept[larger].seen, person.seen
        assert own is not None and rest is not None
        kept[larger] = replace(kept[larger], seen=own | rest)
    return kept


def own_frame(frame: Frame, own: StandingShape, others: Sequence[Other], anywhere: bool = False) -> Frame:
    """Extract the evidence for one person from a frame of several people.

    frame: silhouettes, depth or both, showing several people.
    own: shape where the person is expected.
    others: shapes of all other people.
    anywhere: the person was lost and may be anywhere that no other person covers.
    Returns: the frame with the evidence of this person alone. Views without other people nearby have no ignored pixels;
        a view in which the person is not expected, or not visible, is not usable.
    """
    given, depth = frame.silhouettes, frame.depth
    if given is None:
        return frame
    masks, ignored, shared = np.zeros_like(given.masks), np.zeros_like(given.masks), False
    usable, reasons = np.array(given.usable, dtype=np.bool_), list(given.reasons)
    boxes, areas = own.boxes.copy(), np.zeros(len(usable), np.int64)
    mine, taken = (masks, masks) if depth is None else _nearest_person(depth, own, others, anywhere)
    for c in np.flatnonzero(usable).tolist():
        if depth is None or not depth.usable[c]:
            masks[c], hidden, boxes[c], areas[c], reason = _own_mask(given, c, own, others, anywhere)
        else:
            masks[c], hidden, boxes[c], areas[c], reason = _own_pixels(depth, c, own, mine[c], taken[c] > 0)
        if hidden is not None:
            ignored[c], shared = hidden, True
        if reason:
            usable[c], reasons[c] = False, f"{given.rig.names[c]}: {reason}"
    expected = Expected(boxes, areas) if shared else None
    outlines = Silhouettes(masks, given.rig, usable, tuple(reasons), ignored if shared else None, expected)
    if depth is not None:
        measured = depth.usable & usable
        depth = replace(depth, person=masks * depth.usable[:, None, None].astype(np.uint8), usable=measured)
    return replace(frame, silhouettes=outlines, depth=depth)


def _nearest_person(
    depth: Depth, own: StandingShape, others: Sequence[Other], anywhere: bool
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Find the pixels of depth maps (C, h, w) that belong to a person, and those that belong to others.

    own, others, anywhere: as for `own_frame`.
    """
    at, points = depth.pixels
    mine_m = _away(own, at, points)
    theirs_m = np.min([np.full(len(points), np.inf), *(_away(other.shape, at, points) for other in others)], axis=0)
    mine = (mine_m <= theirs_m) & (mine_m < _REACH_M) | (anywhere & (theirs_m > _EXPLAINED_M))
    masks, taken = np.zeros_like(depth.person), np.zeros_like(depth.person)
    masks[tuple(at[mine].T)] = 1
    taken[tuple(at[~mine & (theirs_m < np.inf)].T)] = 1
    return masks, taken


def _own_pixels(
    depth: Depth, c: int, own: StandingShape, body: NDArray[np.uint8], taken: NDArray[np.bool_]
) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None, Sequence[int], int, str]:
    """Extract the evidence for one person from the depth map of one view.

    c: index of the view.
    body, taken: (h, w) pixels nearest to the person, and those nearest to others; body is changed.
    Returns: as of `_own_mask`.
    """
    seen, whole, box = depth.maps[c], depth.person[c] > 0, own.boxes[c]
    if not np.count_nonzero(body) > _LEAST_PX:
        return np.zeros_like(body), None, box, 0, "no part of the person is visible"
    last = float(np.percentile(seen[body > 0], 98)) + _BEHIND_M
    # values between both sides of an edge, and holes, belong to the nearest person, as for one person alone
    body[whole & ~taken & (cv2.dilate(body, _EDGE) > 0)] = 1
    rim = cv2.dilate((taken & (seen < last)).astype(np.uint8), _EDGE) > 0
    ignored = ((rim | (whole & (seen < last))) & (body == 0)).astype(np.uint8)
    area = int(max(np.count_nonzero(own.drawn(c)), np.count_nonzero(body)))
    if box[1] <= box[0]:
        x, y, w, h = cv2.boundingRect(body)
        box = (y, y + h, x, x + w)
    return body, ignored if ignored.any() else None, box, area, ""


def _away(shape: StandingShape, at: NDArray[np.int64], points: Array) -> Array:
    """Compute the distance (N,), m, of measured pixels (N, 3), at points (N, 3), m, from a person; inf where it is far.

    shape: shape of the person; the pixels of a shape that is given as masks are _CLUSTER_M away, all others inf.
    """
    from scipy.spatial import KDTree  # takes long to import

    if isinstance(shape, DrawnShape):
        return np.where(shape.masks[tuple(at.T)] > 0, _CLUSTER_M, np.inf)
    out = np.full(len(points), np.inf)
    low, high = shape.vertices.min(0) - _REACH_M, shape.vertices.max(0) + _REACH_M
    near = ((points > low) & (points < high)).all(1)
    if near.any():
        out[near] = KDTree(shape.vertices).query(points[near], distance_upper_bound=_REACH_M)[0]
    return out
