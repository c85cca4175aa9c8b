"""People in the visual hull: parts of it that stand on the floor, each about one upright axis.

A hull of several people has parts of each of them, and ghosts where the rays of one camera that see one person cross
those of another camera that see another. The person who is explained already is left out first
(`hypose.evidence.shared_masks` ignores their pixels), and a person must be shown by several views in pixels that no
person explains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from hypose.cameras.camera import CameraRig
from hypose.errors import EvidenceError
from hypose.evidence.frame import Frame, Silhouettes
from hypose.evidence.hull import Hull, common_view_bounds, visual_hull
from hypose.evidence.shared_masks import DrawnShape, Other, without
from hypose.geometry import Array

VOXEL = 0.04
LITRES, _TALL, FROM_FLOOR = 20.0, 1.0, 0.5
"""A person has at least so many litres of hull, reaches so high, m, and begins that near to the floor, m."""
CHILD_LITRES, CHILD, SLENDER = 12.0, 0.75, 42.0
"""A child has at least so many litres, reaches so high, m, and has no more litres than this times the cube of that: of
children of 0.9 to 1.1 m it was 23 to 39 in four views, of people of any age 20 to 36; of stools, chairs, dogs, bins and
suitcases 48 to 140."""
FEWEST_VIEWS = 3
"""So many views must show a person in pixels that no other person explains; with two there are ghosts."""
ABOUT, REACH, _APART = 0.3, 0.9, 0.42
"""m: what of the hull lies so near to an upright axis makes a person; what lies further away may be theirs, too; no two
axes lie nearer to each other."""
OWN_SHARE = 0.12
"""Share of what a person fills of a view that no other person may fill."""
PART_OF_LARGER_M, SMALL = 0.5, 0.6
"""The person who stands that near to a person larger, m, and has no more than this share of their hull is a part of
them: a seated person's knees, an arm held out."""
_SPREAD, _FINE = 0.12, 0.06
_WIDENED = 0.01
_NEAR_CAMERA = 0.2
_RIM = 12
"""cells around the hull's plan, so that its density falls to nothing inside it"""


def fewest_views(frame: Frame) -> int:
    """How many views of a frame must show a person whom no other explains; a depth camera tells alone where it is."""
    return FEWEST_VIEWS if frame.depth is None else 1


@dataclass(frozen=True)
class HullPerson:
    """hull: the part of it; axis (2,) m: where the person stands; seen (C, h, w): their pixels, where these are known
    (depth cameras)."""

    hull: Hull
    axis: Array
    seen: NDArray[np.uint8] | None = None

    @property
    def litres(self) -> float:
        """Of the hull."""
        return 1e3 * self.hull.volume

    @property
    def tall(self) -> bool:
        """As tall as most people are; a child may not be."""
        return self.hull.height > _TALL

    @property
    def is_person(self) -> bool:
        """Whether there is as much of it as there is of a person, or of a child."""
        if self.tall:
            return self.litres > LITRES
        return CHILD_LITRES < self.litres < SLENDER * self.hull.height**3

    def shape(self, rig: CameraRig, about: float = np.inf) -> DrawnShape:
        """What of the views it fills, its gaps closed; about: m, only what lies so near to the axis, of a hull."""
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
    """Who stands in the masks besides those that are known, the largest first; none when too few views are usable.

    floor: m, height of the floor. The space searched is the cameras' common view, between the floor and what a person
    reaches. A voxel belongs to whose axis it is nearest to."""
    views = int(silhouettes.usable.sum())
    least = min(FEWEST_VIEWS, views)
    left = without(silhouettes, known)
    if views < 2 or (left.informative.any((1, 2)) & left.usable).sum() < least:
        return []
    try:
        bounds = common_view_bounds(silhouettes.rig)
        bounds = np.array([[*bounds[0, :2], floor - 0.3], [*bounds[1, :2], floor + 2.6]])
        # no person known: all views that see the place; a person known: what they cover may be in the mask or not
        hull = visual_hull(left, bounds, VOXEL, min_views=least, largest=False, surely=least)
    except EvidenceError:
        return []
    found = people_of_hull(hull, floor, most)
    return _not_ghosts(left, sorted(found, key=lambda p: -p.litres), least)


def people_of_hull(hull: Hull, floor: float, most: int, surface: float = 0.0) -> list[HullPerson]:
    """Parts of a hull that stand on the floor; ghosts as well. surface: litres that a person has where the voxels are
    no more than their surface, 0: they are whole."""
    return [HullPerson(_part(hull, own, axis), axis) for axis, own in _axes(hull, floor, most, surface)]


def _axes(hull: Hull, floor: float, most: int, surface: float) -> list[tuple[Array, NDArray[np.bool_]]]:
    """Where people stand (2,) m, by how much of the hull is near, and which of its voxels (M,) are theirs."""
    litre, points = 1e3 * hull.voxel**3, hull.points
    filled = np.pad(hull.occupancy.sum(2), _RIM)
    density = np.asarray(ndimage.gaussian_filter(filled * litre, _SPREAD / hull.voxel))
    disc, small, wide = (_disc(r / hull.voxel) for r in (ABOUT, _FINE, _APART))
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
        # most places have too little around them for anybody
        if _within(filled, i, j, disc) * litre > (surface or CHILD_LITRES):
            axis = hull.origin[:2] + (np.array([i, j]) - _RIM) * hull.voxel
            away = np.linalg.norm(points[:, :2] - axis, axis=1)
            if _stands(points[away < ABOUT], np.count_nonzero(away < PART_OF_LARGER_M) * litre, litre, floor, surface):
                axes.append(axis)
                taken = wide  # no other person stands so near
        r = taken.shape[0] // 2
        free[i + beyond - r : i + beyond + r + 1, j + beyond - r : j + beyond + r + 1] &= ~taken
    if not axes:
        return []
    # judged again by the nearest voxels of each: knees and arms before a trunk are no person
    while True:
        away = np.linalg.norm(points[:, None, :2] - np.array(axes), axis=2)
        nearest = away.argmin(1)
        nearby = (away < PART_OF_LARGER_M).sum(0) * litre
        near = [points[(nearest == k) & (away[:, k] < ABOUT)] for k in range(len(axes))]
        stands = [_stands(own, nearby[k], litre, floor, surface) for k, own in enumerate(near)]
        if all(stands) or len(axes) == 1:
            return [(axis, (nearest == k) & (away[:, k] < REACH)) for k, axis in enumerate(axes)]
        worst = max(k for k, ok in enumerate(stands) if not ok)  # they come in the order of their density
        del axes[worst]


def _disc(radius: float) -> NDArray[np.bool_]:
    """(2 r + 1, 2 r + 1) of the cells nearer to the middle one than so many."""
    r = int(radius)
    u, v = np.ogrid[-r : r + 1, -r : r + 1]
    return np.hypot(u, v) < radius


def _within(filled: NDArray[np.integer], i: int, j: int, disc: NDArray[np.bool_]) -> int:
    """What a plan holds within a disc about one of its cells."""
    r = disc.shape[0] // 2
    low, left = max(i - r, 0), max(j - r, 0)
    part = filled[low : i + r + 1, left : j + r + 1]
    own = disc[low - i + r :, left - j + r :][: part.shape[0], : part.shape[1]]
    return int(part[own].sum())


def _stands(near: Array, nearby: float, litre: float, floor: float, surface: float) -> bool:
    """Do the voxels (M, 3) m about an axis make a person? nearby: litres as near as PART_OF_LARGER_M, of whomever: a
    part of something wide is no child; a child's surface alone is no more than a piece of furniture shows."""
    if not len(near) or near[:, 2].min() - floor > FROM_FLOOR:
        return False
    litres, height = len(near) * litre, float(np.ptp(near[:, 2]))
    if height > _TALL:
        return litres > (surface or LITRES)
    return not surface and height > CHILD and litres > CHILD_LITRES and nearby < SLENDER * height**3


def _not_ghosts(left: Silhouettes, found: list[HullPerson], least: int) -> list[HullPerson]:
    """Those who show something of their own in several views: ghosts lie where the masks belong to others."""
    given, kept, others = left.informative, list[HullPerson](), list[Other]()
    for person in found:
        near = [k for k in kept if np.linalg.norm(k.axis - person.axis) < PART_OF_LARGER_M]
        if any(person.litres < SMALL * k.litres for k in near):
            continue
        shape = person.shape(left.rig)
        rest = given & without(left, others).informative
        own = np.array([int((shape.masks[c] & rest[c]).sum()) for c in np.flatnonzero(left.usable)])
        whole = np.array([max(int(shape.masks[c].sum()), 1) for c in np.flatnonzero(left.usable)])
        if (own > OWN_SHARE * whole).sum() >= least and person.is_person:
            kept.append(person)
            others.append(Other(shape, _WIDENED))
    return kept


def _part(hull: Hull, chosen: NDArray[np.bool_], axis: Array) -> Hull:
    """What of the chosen voxels (M,) hangs together with those near the axis (2,)."""
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
