"""Find the person in a depth map: in front of the empty room as a sensor saw it, or standing on the floor.

A learnt room gives the distance of the empty room per pixel; where the sensor never saw anything it gives nothing.
Without a recording of the empty room, the floor is removed, the rest is split at jumps of depth, and the piece that is
most like a person is kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import Camera
from hypose.compute.depth_points import holes_filled, middle_of_piece
from hypose.errors import InputError
from hypose.evidence.depth_evidence import JUMP_M, Depth, back_projected, depth_sd, in_world
from hypose.evidence.frame import Expected, Silhouettes
from hypose.geometry import DepthMap, Mask

# m, and standard deviations: least distance of a person in front of the room
_LEAST_M, _SDS = 0.03, 4.0
_USUAL_SD = 0.006
_ABOVE_FLOOR_M = 0.05
# m: largest and smallest height, and largest width, of a person's visible surface
_TALL_M, _SMALL_M, _WIDE_M = 2.4, 0.5, 2.2
_LEAST_PX, _REACH_M = 15, 0.6
# likeness from which a piece may be a person, or half of one behind another: 0.12 to 2.5 m^2 visible
_LIKE = 0.1
# m below the top of a person, and width there: a head .13 to .2, with hands next to it .34 at most (eight motions,
# seeds 1 to 17)
_TOP_M, _HEAD_M = 0.2, 0.35
STILL_FRAMES = 16
"""largest number of maps, spread over a recording, that are used to find things that stand still"""
# share of the maps in which a pixel must be measured to be known
_SEEN_SHARE = 0.5
# largest share of the maps that may show something behind a thing that stands still; least share of a thing's pixels
# that must stand still
_FARTHER_SHARE, _WHOLE = 0.15, 0.7
# m, m^2: height and visible area of a person
_SPAN_M, _AREA_M2 = 1.75, 0.55
# m by which a thing stands in front of the person's middle, and next to it; share of a person's area that it covers
_BEFORE_M, _NEARBY_M, _HIDES = 0.25, 0.4, 0.03
# m between the sides of the person and of a thing that is not part of it
_APART_M = 0.35
# least share of a recording's maps in which a thing is seen, and largest scatter of its values, m
_STILL_SHARE, _STILL_M = 0.8, 0.01
# m from a thing at which a moving person stands, in which share of the maps; least number of pixels of a person
_ELSEWHERE_M, _ELSEWHERE_SHARE, _PERSON_PX = 0.9, 0.25, 300
# px around what stands in front of the room that may still be the person's
_RIM = 3


@dataclass(frozen=True)
class DepthBackground:
    """Depth of the empty room.

    depth: (h, w) m; 0 where the sensor sees nothing.
    sd: (h, w) of its values, m.
    """

    depth: DepthMap
    sd: DepthMap


def learn_background(maps: Sequence[DepthMap]) -> DepthBackground:
    """Learn the empty room from depth maps (h, w), m: the median where a pixel is measured at least a quarter of the
    time.

    Raises: InputError where there are no maps or their sizes differ.
    """
    if not maps:
        raise InputError("The empty room needs at least one depth map; give the folder of its recording.")
    if len({m.shape for m in maps}) > 1:
        raise InputError(f"Depth maps of one sensor must have one size, got {sorted({m.shape for m in maps})}.")
    stack = np.stack(maps).astype(np.float32)
    stack[stack <= 0] = np.nan
    middle, spread = _median_and_sd(np.where(np.isfinite(stack).mean(0) >= 0.25, stack, 0.0))
    sd = np.maximum(spread, 0.0 if len(maps) > 3 else _USUAL_SD)
    return DepthBackground(middle.astype(np.float32), sd.astype(np.float32))


def _median_and_sd(values: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Compute the median of each column of values (T, ...) and its standard deviation (1.4826 MAD), without NaN."""
    middle = np.nanmedian(values, axis=0)
    return middle, 1.4826 * np.nanmedian(np.abs(values - middle), axis=0)


def with_still_things(room: DepthBackground, maps: Sequence[DepthMap], camera: Camera) -> tuple[DepthBackground, float]:
    """Add things to the room that were not there when it was empty.

    camera: camera of the maps, placed in the world.
    maps: (h, w) m, spread over a recording. A thing keeps its place while a person moves elsewhere.
    Returns: the new room, and the visible area of the things, m^2; the same room and 0 where no person is ever far
        enough away to know this.
    """
    stack = np.stack(maps)
    before = np.stack([_before_room(m, room) for m in maps]) > 0
    often = before.sum(0) >= _STILL_SHARE * np.maximum((stack > 0).sum(0), 0.5 * len(maps))
    if not often.any():
        return room, 0.0
    middle, sd = np.zeros_like(room.depth), np.zeros_like(room.sd)
    middle[often], sd[often] = _median_and_sd(np.where(before, stack, np.nan)[:, often])
    still = _calm((often & (sd < np.maximum(_SDS * room.sd, _STILL_M))).astype(np.uint8)) > 0
    others = before & (cv2.dilate(still.astype(np.uint8), np.ones((5, 5), np.uint8)) == 0)
    at = [_place(camera, own, m) for own, m in zip(others, maps, strict=True) if own.sum() > _PERSON_PX]
    labels, n = _pieces(still, middle)
    things, spread, area = np.full_like(room.depth, np.inf), room.sd.copy(), 0.0
    for k in range(1, n + 1):
        own = labels == k
        if own.sum() < _LEAST_PX or not at:
            continue
        apart = np.linalg.norm(np.array(at) - _place(camera, own, middle), axis=1)
        if (apart > _ELSEWHERE_M).sum() >= max(2, _ELSEWHERE_SHARE * len(maps)):
            things[own], spread[own] = middle[own], np.maximum(sd[own], room.sd[own])
            area += float((middle[own] ** 2).sum() / (camera.K[0, 0] * camera.K[1, 1]))
    if not area:
        return room, 0.0
    near = cv2.erode(things, np.ones((5, 5), np.uint8))  # values at its edges lie in front of the background
    depth = np.where(np.isfinite(things), things, np.minimum(near, np.where(room.depth > 0, room.depth, np.inf)))
    return DepthBackground(np.where(np.isfinite(depth), depth, 0.0).astype(np.float32), spread), area


def _before_room(depth: DepthMap, room: DepthBackground) -> Mask:
    """Find the pixels (h, w) at which a depth map lies in front of the empty room, or where the room is not known;
    without single pixels.
    """
    near = room.depth - depth > np.maximum(np.float32(_SDS) * room.sd, np.float32(_LEAST_M))
    return _calm(((near | (room.depth <= 0)) & (depth > 0)).view(np.uint8))


def _place(camera: Camera, own: NDArray[np.bool_], depth: DepthMap) -> NDArray[np.float64]:
    """Compute where on the floor (2,), m, the middle of some pixels (h, w) stands.

    own: (h, w) the pixels.
    depth: (h, w) m, 0 = hole.
    camera: camera of the map, placed in the world.
    """
    v, u = np.nonzero(own & (depth > 0))
    return np.median(in_world(camera, back_projected(camera, u, v, depth[v, u]))[:, :2], axis=0)


def person_before(
    depth: DepthMap, background: DepthBackground, focal_px: float | None = None, several: bool = False
) -> Mask:
    """Segment the person in front of the empty room: the largest thing and the parts near it, with holes filled.

    depth: (h, w) map, m.
    background: the empty room.
    focal_px: focal length; with it, parts too far to the side are left out, because they are another person.
    several: segment everything in front of the room but specks, for several people.
    Returns: (h, w) 0 or 1.
    Raises: InputError where map and room differ in size.
    """
    if depth.shape != background.depth.shape:
        raise InputError(
            f"The depth map is {depth.shape[1]} x {depth.shape[0]} px, the empty room "
            f"{background.depth.shape[1]} x {background.depth.shape[0]} px; record both in the same mode."
        )
    before = _before_room(depth, background)
    x, y, w, h = cv2.boundingRect(before)
    out = np.zeros(depth.shape, np.uint8)
    own = slice(max(y - _RIM, 0), y + h + _RIM), slice(max(x - _RIM, 0), x + w + _RIM)
    out[own] = _things(before[own], depth[own], background.depth[own] > 0, focal_px, several)
    return out


def person_on_floor(depth: DepthMap, camera: Camera, room: DepthMap | None = None, several: bool = False) -> Mask:
    """Segment the piece most like a person among everything that stands on the floor (z = 0), split at jumps of depth.

    depth: (h, w) m.
    camera: camera of the map, placed in the world (floor at z = 0).
    room: (h, w) distance of the room, m, 0 = unknown (`unlike_people`).
    several: segment everything that may be a person, or a part of one next to another.
    Returns: (h, w) 0 or 1; all 0 where nothing has a person's size.
    """
    known = False if room is None else (room > 0) & (depth > room - _tolerance(room))
    found = _standing(np.where(known, 0, depth).astype(np.float32), camera)
    unknown = np.zeros(depth.shape, dtype=np.bool_)
    if several:
        return holes_filled(_calm(found.people()), depth, unknown)
    best = max(found.pieces, key=lambda k: found.pieces[k].like, default=0)
    if not best or not found.pieces[best].like:
        return np.zeros(depth.shape, np.uint8)
    return _things(_calm(found.with_limbs([best], found.pieces)), depth, unknown, camera.K[0, 0])


def unlike_people(maps: Sequence[DepthMap], camera: Camera) -> DepthMap:
    """Find the parts of a recording that stand still and are not like a person: walls, small things, things as wide as
    a box.

    camera: camera of the maps, placed in the world (floor at z = 0).
    maps: (h, w) m, spread over the recording.
    Returns: (h, w) their distance, m, 0 elsewhere. A person who stands still the whole time is not included; walls are,
        also where a person passes in front of them.
    """
    stack = np.stack(maps)
    known = (stack > 0).mean(0) >= _SEEN_SHARE
    values = np.where(known, np.where(stack > 0, stack, np.nan), 0.0)
    middle, sd = (a.astype(np.float32) for a in _median_and_sd(values))
    apart = _tolerance(middle)
    still = known & (sd < apart)
    still &= (values > middle + apart).mean(0) < _FARTHER_SHARE  # else a person stood there and left
    found = _standing(middle, camera)
    no_person = found.above & (found.people(_HEAD_M) == 0)
    count = int(found.labels.max()) + 1
    share = np.bincount(found.labels[still], minlength=count) / np.maximum(np.bincount(found.labels.ravel()), 1)
    whole = (share > _WHOLE)[found.labels] & (found.labels > 0)  # not the middle of a place where a person passed
    rim = cv2.dilate(whole.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    return np.where(still & no_person & rim, middle, 0).astype(np.float32)


def _tolerance(depth: DepthMap) -> DepthMap:
    """Compute the largest difference (h, w), m, of two values of one surface."""
    return np.asarray(np.maximum(_LEAST_M, _SDS * depth_sd(depth)), dtype=np.float32)


@dataclass(frozen=True)
class _Piece:
    """One connected piece of a depth map.

    middle: (2,) on the floor, m.
    wide: width on the floor, m.
    top: height of its top, m.
    head: mean width of its uppermost part, m.
    like: likeness to a person, 0 where it has another size.
    """

    middle: NDArray[np.float64]
    wide: float
    top: float
    head: float
    like: float


@dataclass(frozen=True)
class _Standing:
    """Everything that stands on the floor of a map, split into pieces.

    above: (h, w) everything higher than the floor.
    labels: (h, w) number of the piece.
    pieces: by their numbers.
    """

    above: NDArray[np.bool_]
    labels: NDArray[np.int32]
    pieces: dict[int, _Piece]

    def people(self, head: float = np.inf) -> Mask:
        """Segment all pieces (h, w) that may be a person, or half of one behind another, and are no wider than
        `head` at the top.
        """
        low = {k: p for k, p in self.pieces.items() if p.top < _TALL_M}  # walls and ceilings reach higher
        return self.with_limbs([k for k, p in low.items() if p.like > _LIKE and p.head < head], low)

    def with_limbs(self, people: Sequence[int], among: Mapping[int, _Piece]) -> Mask:
        """Segment these pieces (h, w), and those among others that may be their limbs in front of or behind the trunk.

        people: numbers of the pieces.
        among: pieces that may be limbs, by their numbers.
        Returns: (h, w) 0 or 1.
        """
        middles = [self.pieces[k].middle for k in people]

        def nearby(p: _Piece) -> bool:
            return p.wide < 1 and any(np.linalg.norm(p.middle - m) < _REACH_M for m in middles)

        own = np.isin(self.labels, [*people, *(k for k, p in among.items() if nearby(p))]).astype(np.uint8)
        rim = cv2.dilate(own, np.ones((3, 3), np.uint8)) > 0  # rim pixels belong to no piece
        return (rim & self.above).astype(np.uint8)


def _standing(depth: DepthMap, camera: Camera) -> _Standing:
    """Split everything on the floor of a depth map (h, w), m, into pieces, and judge how like a person each is.

    camera: camera of the map, placed in the world (floor at z = 0).
    """
    v, u = np.indices(depth.shape)
    world = in_world(camera, back_projected(camera, u, v, depth))
    above = (depth > 0) & (world[..., 2] > _ABOVE_FLOOR_M)
    labels, n = _pieces(above, depth)
    pieces: dict[int, _Piece] = {}
    areas = np.bincount(labels.ravel(), minlength=n + 1)
    per_px = (depth / camera.K[0, 0]) * (depth / camera.K[1, 1])
    for k in np.flatnonzero(areas[1:] >= _LEAST_PX) + 1:
        own = labels == k
        points, sizes = world[own], per_px[own]
        low, high = np.percentile(points[:, 2], (1, 99))
        wide = float(np.linalg.norm(np.ptp(np.percentile(points[:, :2], (2, 98), axis=0), axis=0)))
        tall, like = float(high - low), 0.0
        if _SMALL_M < tall < _TALL_M and wide <= _WIDE_M and not own[0].any():
            area = float(sizes.sum())  # m^2; a person shows about 0.4 to 0.8
            like = float(np.exp(-(np.log(area / _AREA_M2) ** 2)) * min(tall / 1.2, 1.0))
        head = float(sizes[points[:, 2] > high - _TOP_M].sum()) / _TOP_M
        pieces[int(k)] = _Piece(np.median(points[:, :2], axis=0), wide, float(high), head, like)
    return _Standing(above, labels, pieces)


def behind_things(
    silhouettes: Silhouettes, depth: Depth | None, rooms: Sequence[DepthBackground | None]
) -> Silhouettes:
    """Mark pixels as ignored where a thing of the empty room stands in front of the person, who may be behind it or
    not.

    depth: maps of the same views; None: the silhouettes are returned as they are.
    rooms: rooms of each view; None: unknown.
    Returns: the silhouettes with ignored pixels; the same silhouettes where nothing stands in front.
    """
    if depth is None:
        return silhouettes
    ignored: Mask | None = None
    boxes, areas = np.zeros((len(rooms), 4), np.int64), np.array(silhouettes.areas)
    for c in np.flatnonzero(depth.usable):
        room, camera, (x0, y0, x1, y1) = rooms[int(c)], depth.rig[int(c)], depth.boxes[int(c)]
        boxes[c] = y0, y1, x0, x1
        own = depth.person[c, y0:y1, x0:x1] > 0
        away = middle_of_piece(own.view(np.uint8), 1, depth.maps[c, y0:y1, x0:x1])
        if room is None or np.isnan(away):
            continue
        h, w = room.depth.shape
        metre = camera.K[0, 0] / away
        whole = int(_SPAN_M * metre)
        # the visible part may be all but the legs, or all but the head
        top, low = max(min(y0, y1 - whole), 0), min(max(y1, y0 + whole), h)
        left, right = max(int(x0 - _NEARBY_M * metre), 0), min(int(x1 + _NEARBY_M * metre), w)
        part = slice(top, low), slice(left, right)
        nearer = (room.depth[part] > 0) & (room.depth[part] < away - _BEFORE_M) & (depth.person[c][part] == 0)
        before = _calm(nearer.view(np.uint8))
        v, u = np.nonzero(before)
        at = in_world(camera, back_projected(camera, u + left, v + top, room.depth[part][v, u]))
        before[v, u] = at[:, 2] >= _ABOVE_FLOOR_M
        if np.count_nonzero(before) > _HIDES * _AREA_M2 * metre**2:
            if ignored is None:
                ignored = np.zeros_like(silhouettes.masks)
            ignored[c, top:low, left:right] = before
            boxes[c], areas[c] = (top, low, x0, x1), max(int(areas[c]), int(_AREA_M2 * metre**2))
    if ignored is None:
        return silhouettes
    return replace(silhouettes, ignored=ignored, expected=Expected(boxes, areas))


def _pieces(mask: NDArray[np.bool_], depth: DepthMap) -> tuple[NDArray[np.int32], int]:
    """Label the pieces (h, w) of a mask that have no jump of depth inside; return their number too."""
    kernel = np.ones((3, 3), np.uint8)
    far = np.where(mask, depth, 0.0).astype(np.float32)
    near = np.where(mask, depth, 1e3).astype(np.float32)
    calm = mask & (cv2.dilate(far, kernel) - cv2.erode(near, kernel) < 2 * JUMP_M)
    n, labels = cv2.connectedComponents(calm.astype(np.uint8), connectivity=8)
    # edge pixels are added to the piece next to them
    grown = cv2.dilate(np.asarray(labels, np.float32), kernel).astype(np.int32)
    return np.where(mask & (labels == 0), grown, labels).astype(np.int32), n - 1


def _calm(mask: Mask) -> Mask:
    """Remove single pixels from a mask."""
    return np.asarray(cv2.medianBlur(mask, 3), dtype=np.uint8)


def _things(
    before: Mask, depth: DepthMap, solid: NDArray[np.bool_], focal_px: float | None, several: bool = False
) -> Mask:
    """Keep the largest thing of a mask and the parts near it in space, with holes filled.

    before: (h, w) 0 or 1.
    depth: (h, w) m.
    solid: (h, w) where the sensor would see something behind, so that a hole belongs to the person.
    focal_px: focal length, None: parts at any distance to the side are kept.
    several: keep all things but specks.
    Returns: (h, w) 0 or 1; all 0 where the mask is empty or none of the largest thing's pixels is measured.
    """
    n, found, stats, _ = cv2.connectedComponentsWithStats(before, connectivity=8)
    labels, areas, left = np.asarray(found, dtype=np.int32), stats[:, cv2.CC_STAT_AREA], stats[:, cv2.CC_STAT_LEFT]
    areas[0] = 0
    keep = (areas >= _LEAST_PX).astype(np.uint8)
    main = int(areas.argmax())
    if not several:
        right, usual = left + stats[:, cv2.CC_STAT_WIDTH], middle_of_piece(labels, main, depth) if main else np.nan
        nearby = _APART_M / usual * (np.inf if focal_px is None else focal_px)
        far_aside = (left - right[main] > nearby) | (left[main] - right > nearby)
        keep[:] = 0
        for k in np.flatnonzero(
            (areas >= max(12, 0.01 * areas[main])) & ~far_aside
        ):  # skip the many specks to save time
            # False where all are holes
            keep[k] = k == main or abs(middle_of_piece(labels, int(k), depth) - usual) < 0.8
        keep[main] = not np.isnan(usual)  # a speck without any measured pixel is no person
    return holes_filled(keep.take(labels), depth, solid)
