"""What one depth camera sees when nobody is there, and the person before it; the live engine's evidence of depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import Camera
from hypose.evidence.depth_background import DepthBackground, learn_background, person_before
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Silhouettes
from hypose.evidence.outlines import WORKING_HEIGHT, ViewOutline, view_outline
from hypose.evidence.silhouettes import Mask
from hypose.io.recordings.view_source import DepthPreparer

DepthMap = NDArray[np.float32]
Millimetres = NDArray[np.uint16]
_MOVED_M, _MOVED_SHARE = 0.05, 0.01
"""m, and share of the pixels that are known, that change where somebody has not left"""


class DepthRoom:
    """One depth view, in place of a `ViewRoom`. camera: as calibrated; small: pinhole, of the working size; background:
    where it is known already. The room does not change: light is nothing to it. Used by one thread at a time."""

    def __init__(
        self, camera: Camera, small: Camera, shift: tuple[float, float], background: DepthBackground | None = None
    ) -> None:
        self._prepare, self.size, self.background = DepthPreparer(camera, small, shift), small.size, background
        self._focal_px = float(small.K[0, 0])
        self.seen: Millimetres | None = None
        """(h, w) the last map that was looked at"""

    @property
    def moved(self) -> bool:
        """Something moved while the room was learnt."""
        room = self.background
        known = None if room is None else room.depth > 0
        if room is None or known is None or not known.any():
            return False
        return float((room.sd[known] > _MOVED_M).mean()) > _MOVED_SHARE

    def learn(self, maps: Sequence[DepthMap]) -> None:
        """Take stored maps (H, W) m for those of the empty room."""
        self.background = learn_background([self._prepare(m) for m in maps])

    def mask(self, depth: DepthMap) -> tuple[Mask, ViewOutline | None]:
        """Who stands before the room in a stored map, (h, w), and the outline (None: nobody). The room must be
        known."""
        assert self.background is not None
        own = self._prepare(depth)
        self.seen = np.minimum(own * 1000 + 0.5, 65535).astype(np.uint16)
        mask = person_before(own, self.background, self._focal_px)
        return mask, view_outline(mask, working_height=WORKING_HEIGHT) if mask.any() else None


@dataclass(frozen=True)
class KeptDepth:
    """The person in the depth maps of one instant, so that seconds of it take little room: mm (C, h, w) in a box at
    corner (row, column), 0 elsewhere; usable (C,)."""

    millimetres: Millimetres
    corner: tuple[int, int]
    usable: NDArray[np.bool_]

    @staticmethod
    def of(depth: Depth) -> KeptDepth:
        """Of a frame's depth."""
        someone = np.asarray(depth.person.any(0))
        rows, columns = np.flatnonzero(someone.any(1)), np.flatnonzero(someone.any(0))
        if not len(rows):
            return KeptDepth(np.zeros((len(depth.maps), 0, 0), np.uint16), (0, 0), depth.usable)
        y, x = int(rows[0]), int(columns[0])
        box = np.s_[:, y : int(rows[-1]) + 1, x : int(columns[-1]) + 1]
        kept = np.where(depth.person[box] > 0, depth.maps[box] * 1000 + 0.5, 0).astype(np.uint16)
        return KeptDepth(kept, (y, x), depth.usable)

    def depth(self, silhouettes: Silhouettes) -> Depth:
        """The depth again, beside the masks of the same instant."""
        maps = np.zeros(silhouettes.masks.shape, np.float32)
        (y, x), (h, w) = self.corner, self.millimetres.shape[1:]
        maps[:, y : y + h, x : x + w] = self.millimetres * np.float32(1e-3)
        person = silhouettes.masks * self.usable.astype(np.uint8)[:, None, None]
        return Depth(maps, person, silhouettes.rig, self.usable)


def depth_of(silhouettes: Silhouettes, maps: Sequence[Millimetres | None]) -> Depth | None:
    """What depth cameras measured of who is in the silhouettes; maps: of each view, None where it has none."""
    usable = silhouettes.usable & np.array([m is not None for m in maps])
    if not usable.any():
        return None
    out = np.zeros(silhouettes.masks.shape, np.float32)
    for c in np.flatnonzero(usable):
        own = maps[int(c)]
        assert own is not None
        np.multiply(own, np.float32(1e-3), out=out[c, : own.shape[0], : own.shape[1]])
    return Depth(out, silhouettes.masks * usable.astype(np.uint8)[:, None, None], silhouettes.rig, usable)
