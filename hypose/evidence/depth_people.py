"""Find people in front of depth cameras: clusters of the points that all sensors measure, and whose pixels are whose.

A measured pixel is a place in the world, so it belongs to the nearest body or cluster: people need not be separated in
the picture. Pixels of others in front give no information on a person, who may be hidden behind them; pixels of others
behind show that the person is not in front of them.
The module also gives the space that a person seen by depth cameras may fill: the seen surface and what lies behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.errors import EvidenceError
from hypose.evidence.depth_evidence import JUMP_M, Depth, back_projected, in_world, smooth_surface
from hypose.evidence.frame import Expected, Frame, Silhouettes
from hypose.evidence.hull import Hull, visual_hull
from hypose.evidence.hull_people import PART_OF_LARGER_M, SMALL, VOXEL, HullPerson, people_in_hull, people_of_hull
from hypose.evidence.shared_masks import DrawnShape, Other, StandingShape, own_silhouettes
from hypose.geometry import Array

_THICK_M, _VOXEL_M = 0.16, 0.03


def space_behind(depth: Depth, bounds: Array | None = None) -> Hull:
    """Compute the space that the person may fill from depth maps: the seen surface and the space up to _THICK_M (m)
    behind it. It replaces the visual hull of masks.

    depth: maps in which the person is marked.
    bounds: (2, 3) m, limits the space.
    Raises: EvidenceError where no sensor shows a person.
    """
    found, rays = [], []
    for c in np.flatnonzero(depth.usable):
        w, h = depth.rig.sizes[c]
        z, sound = smooth_surface(np.ascontiguousarray(depth.maps[c, :h, :w]))
        v, u = np.nonzero(sound & (depth.person[c, :h, :w] > 0))
        points = in_world(depth.rig[int(c)], back_projected(depth.rig[int(c)], u, v, z[v, u]))
        ray = points - depth.rig[int(c)].position
        found.append(points)
        rays.append(ray / np.linalg.norm(ray, axis=1, keepdims=True))
    if not sum(len(p) for p in found):
        raise EvidenceError("No depth camera shows a person; choose another frame, or record the empty room again.")
    seen, ray = np.concatenate(found), np.concatenate(rays)
    ray[:, 2] = 0  # feet and head are where they are seen
    behind = np.arange(0.0, _THICK_M, _VOXEL_M)
    points = (seen[:, None] + behind[:, None] * ray[:, None]).reshape(-1, 3)
    if bounds is not None:
        points = points[((points >= bounds[0]) & (points <= bounds[1])).all(1)]
    if not len(points):
        return Hull(np.zeros((1, 1, 1), dtype=np.bool_), np.zeros(3), _VOXEL_M)
    origin = points.min(0)
    index = np.rint((points - origin) / _VOXEL_M).astype(int)
    solid = np.zeros(index.max(0) + 1, dtype=np.bool_)
    solid[tuple(index.T)] = True
    return Hull(solid, origin, _VOXEL_M)


SURFACE_LITRES = 15.0
"""Least surface of a person that one sensor shows, in litres of voxels of VOXEL; arms between two people show less."""
_EXPLAINED_M, _REACH_M = 0.2, 0.5
"""m: points this near to a body are explained by it; points further away than the second belong to no person yet"""
_CLUSTER_M = 0.08
"""m: distance of a cluster's own pixels; a pixel nearer than this to another person's body belongs to that person"""
_BEHIND_M = 0.4
"""m behind the visible part of a person: others there do not hide it"""
_LEAST_PX, _PER_VOXEL = 50, 2
_EDGE = np.ones((5, 5), np.uint8)


def occupied_space(frame: Frame, bounds: Array | None = None) -> Hull:
    """Compute the space that the person of a frame may fill, inside bounds (2, 3), m.

    It comes from depth where there is depth, else it is the visual hull of the masks.
    """
    if frame.depth is not None:
        return space_behind(frame.depth, bounds)
    return visual_hull(frame.the(Silhouettes), bounds)


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
    calm = np.stack([cv2.dilate(m, _EDGE[:3, :3]) - cv2.erode(m, _EDGE[:3, :3]) < 2 * JUMP_M for m in depth.maps])
    rest = calm[tuple(at.T)]
    for one in known:
        rest &= _away(one.shape, at, points) > _EXPLAINED_M
    at, points = at[rest], points[rest]
    if len(points) < _LEAST_PX:
        return []
    low = points.min(0)
    index = np.rint((points - low) / VOXEL).astype(np.int64)
    filled = np.zeros(index.max(0) + 1, np.int32)
    np.add.at(filled, tuple(index.T), 1)
    solid = filled >= _PER_VOXEL
    if not solid.any():
        return []
    found = list[HullPerson]()
    for person in people_of_hull(Hull(solid, low, VOXEL), floor, most, SURFACE_LITRES):
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
        near = [k for k, o in enumerate(kept) if np.linalg.norm(o.axis - person.axis) < PART_OF_LARGER_M]
        larger = next((k for k in near if person.litres < SMALL * kept[k].litres), None)
        if larger is None:
            kept.append(person)
            continue
        own, rest = kept[larger].seen, person.seen
        assert own is not None and rest is not None
        kept[larger] = replace(kept[larger], seen=own | rest)
    return kept


def own_frame(frame: Frame, own: StandingShape, others: Sequence[Other], anywhere: bool = False) -> Frame:
    """Extract the evidence for one person from a frame of several people; frame: silhouettes, depth or both, showing
    several people.
    own: shape where the person is expected.
    others: shapes of all other people.
    anywhere: the person was lost and may be anywhere that no other person covers.
    Returns: the frame with the evidence of this person alone.
    """
    if frame.silhouettes is None:
        return frame
    if frame.depth is None:
        return replace(frame, silhouettes=own_silhouettes(frame.silhouettes, own, others, anywhere))
    silhouettes, depth = own_depth(frame.silhouettes, frame.depth, own, others, anywhere)
    colour = frame.silhouettes.usable & ~frame.depth.usable
    if colour.any():
        alone = replace(frame.silhouettes, usable=colour)
        silhouettes = _nearby(silhouettes, own_silhouettes(alone, own, others, anywhere), colour)
    return replace(frame, silhouettes=silhouettes, depth=depth)


def _nearby(of_depth: Silhouettes, of_colour: Silhouettes, colour: NDArray[np.bool_]) -> Silhouettes:
    """Combine silhouettes of depth cameras with those of colour cameras, where `colour` (C,).

    of_depth: usable in the views of depth cameras.
    of_colour: usable in those where `colour` is true.
    """

    def merged(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
        return np.where(colour.reshape(-1, *(1,) * (a.ndim - 1)), b, a)

    reasons = tuple(b if c else a for a, b, c in zip(of_depth.reasons, of_colour.reasons, colour, strict=True))
    masks, usable = merged(of_depth.masks, of_colour.masks), merged(of_depth.usable, of_colour.usable)
    ignored, expected = of_depth.ignored, of_depth.expected
    if of_colour.ignored is not None and of_colour.expected is not None:
        ignored = merged(np.zeros_like(masks) if ignored is None else ignored, of_colour.ignored)
        boxes, areas = of_colour.expected.boxes, of_colour.expected.areas
        if expected is not None:
            boxes, areas = merged(expected.boxes, boxes), merged(expected.areas, areas)
        expected = Expected(boxes, areas)
    return Silhouettes(masks, of_depth.rig, usable, reasons, ignored, expected)


def own_depth(
    silhouettes: Silhouettes, depth: Depth, own: StandingShape, others: Sequence[Other], anywhere: bool = False
) -> tuple[Silhouettes, Depth]:
    """Extract the depth and the silhouettes of one person from maps that show several people.

    own: shape where the person is expected.
    others: shapes of all other people.
    anywhere: the person was lost and may be anywhere that no other person covers.
    Returns: silhouettes and depth of the person; views of colour cameras are marked as not usable.
    """
    at, points = depth.pixels
    mine_m = _away(own, at, points)
    theirs_m = np.full(len(points), np.inf)
    for other in others:
        theirs_m = np.minimum(theirs_m, _away(other.shape, at, points))
    mine = (mine_m <= theirs_m) & (mine_m < _REACH_M)
    if anywhere:
        mine = mine | (theirs_m > _EXPLAINED_M)
    masks, taken, ignored = (np.zeros_like(depth.person) for _ in range(3))
    masks[tuple(at[mine].T)] = 1
    taken[tuple(at[~mine & (theirs_m < np.inf)].T)] = 1
    usable, reasons = silhouettes.usable & depth.usable, list(silhouettes.reasons)
    boxes, areas = own.boxes.copy(), np.zeros(len(usable), np.int64)
    for c in np.flatnonzero(usable):
        body, seen = masks[c], depth.maps[c]
        if not np.count_nonzero(body) > _LEAST_PX:
            usable[c], reasons[c] = False, f"{depth.rig.names[int(c)]}: no part of the person is visible"
            body[:] = 0
            continue
        whole, last = depth.person[c] > 0, float(np.percentile(seen[body > 0], 98)) + _BEHIND_M
        # values between both sides of an edge, and holes, belong to the nearest person, as for one person alone
        body[whole & (taken[c] == 0) & (cv2.dilate(body, _EDGE) > 0)] = 1
        near = (taken[c] > 0) & (seen < last)
        rim = cv2.dilate(near.astype(np.uint8), _EDGE) > 0
        ignored[c] = (rim | (whole & (seen < last))) & (body == 0)
        areas[c] = max(np.count_nonzero(own.drawn(int(c))), np.count_nonzero(body))
        x, y, w, h = cv2.boundingRect(body)
        if boxes[c, 1] <= boxes[c, 0]:
            boxes[c] = y, y + h, x, x + w
    shared = bool(ignored.any())
    expected = Expected(boxes, areas) if shared else None
    outlines = Silhouettes(masks, silhouettes.rig, usable, tuple(reasons), ignored if shared else None, expected)
    return outlines, replace(depth, person=masks, usable=usable.copy())


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
