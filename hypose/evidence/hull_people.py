"""Find people in the visual hull: parts of it that stand on the floor, each around one upright axis.

A hull of several people has a part for each of them, and ghosts where the rays of one camera to one person cross the
rays of another camera to another person. So people who are already known are removed first
(`hypose.evidence.shared_masks` ignores their pixels), and a person must be visible in several views in pixels that no
other person explains.
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
_RIM = 12
"""cells around the hull's plan, so that its smoothed density falls to zero inside the array"""


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
        if self.tall:
            return self.litres > LITRES
        return CHILD_LITRES < self.litres < SLENDER * self.hull.height**3

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
    """
    return [HullPerson(_part(hull, own, axis), axis) for axis, own in _axes(hull, floor, most, surface)]


def _axes(hull: Hull, floor: float, most: int, surface: float) -> list[tuple[Array, NDArray[np.bool_]]]:
    """Find where people stand, (2,) m, in the order of the hull's density there, and which voxels (M,) belong to each.

    floor: height of the floor, m.
    most: largest number of people.
    surface: as for `people_of_hull`.
    """
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
        # most places have too little hull around them
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
    # tested again with the nearest voxels of each: knees and arms in front of a trunk are no person
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
    """Build a disc (2 r + 1, 2 r + 1) of cells."""
    r = int(radius)
    u, v = np.ogrid[-r : r + 1, -r : r + 1]
    return np.hypot(u, v) < radius


def _within(filled: NDArray[np.integer], i: int, j: int, disc: NDArray[np.bool_]) -> int:
    """Sum the plan within a disc around one of its cells.

    filled: (nx, ny) number of voxels in each column.
    i, j: the cell.
    disc: as built by `_disc`.
    """
    r = disc.shape[0] // 2
    low, left = max(i - r, 0), max(j - r, 0)
    part = filled[low : i + r + 1, left : j + r + 1]
    own = disc[low - i + r :, left - j + r :][: part.shape[0], : part.shape[1]]
    return int(part[own].sum())


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
    litres, height = len(near) * litre, float(np.ptp(near[:, 2]))
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
