"""Which pixels of a frame are learned: the gesture's own surface, the ring around its place, anywhere else.

Alcoverro 2014, 3.2.3 ("patch collection"). Deviations, from measurements: positives are pixels near the marked surface,
not all that the box holds (behind the fingers there is something else), and the ring teaches where the place ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.compute import DepthImage, ScanPlan
from hypose.gestures.depth_pictures import DepthLens, check_settings, surface_depth
from hypose.gestures.localise import LocaliseSettings

BACKGROUND = 0
Pixels = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Rows (S,) and columns (S,)."""


@dataclass(frozen=True)
class LearnSettings:
    """How many pixels of a frame are learned. positives within box_mm of the marked point and surface_mm of its depth;
    around: negatives between rim_mm and clear_mm of it, which teach where the gesture's place ends; beside: random
    negatives outside clear_mm; hard: most hard negatives, within box_mm of the maximum; few: random negatives that go
    with them; many: random negatives without hard ones (the baseline). look: how the forest is asked while it
    learns."""

    positives: int = 30
    around: int = 10
    beside: int = 8
    hard: int = 30
    few: int = 2
    many: int = 10
    box_mm: float = 15.0
    rim_mm: float = 20.0
    surface_mm: float = 80.0
    clear_mm: float = 45.0
    look: LocaliseSettings = LocaliseSettings(ScanPlan(stride=8, coarse=0), sigma_px=10.0)

    def __post_init__(self) -> None:
        counts = dict.fromkeys(("positives", "around", "beside", "hard", "few", "many"), (0, 1000))
        lengths = dict.fromkeys(("box_mm", "rim_mm", "surface_mm", "clear_mm"), (1, 1000))
        check_settings("Learning's", self, {**counts, **lengths})


@dataclass(frozen=True)
class Example:
    """A frame to learn from: depth (h, w) uint16 mm; gesture from 1 on at pixel (x, y), or 0 for none."""

    depth: DepthImage
    lens: DepthLens
    gesture: int = 0
    x: float = 0.0
    y: float = 0.0


@dataclass
class PixelSampler:
    """Draws pixels of frames with its random numbers."""

    rng: np.random.Generator
    settings: LearnSettings

    def choose(self, example: Example, positives: int, negatives: int) -> list[tuple[Pixels, int]]:
        """Pixels to learn offline from an example with their classes, drawn as in online learning."""
        e, s = example, self.settings
        if not e.gesture:
            return [(self.anywhere(e.depth, negatives, None), BACKGROUND)]
        surface = self.surface(e.depth, e.x, e.y)
        if surface is None:
            return []
        scale = e.lens.fx / surface
        return [
            (self.inside(e.depth, e.x, e.y, scale, surface, positives), e.gesture),
            (self.anywhere(e.depth, negatives, (e.x, e.y, s.clear_mm * scale)), BACKGROUND),
            (self.rim(e.depth, e.x, e.y, scale), BACKGROUND),
        ]

    def inside(self, depth: DepthImage, x: float, y: float, scale: float, surface: float, n: int) -> Pixels:
        """Pixels of the gesture's own surface around the marked point; scale: px per mm there."""
        s = self.settings
        return self.ring(depth, x, y, (0.0, s.box_mm * scale), n, (surface - s.surface_mm, surface + s.surface_mm))

    def rim(self, depth: DepthImage, x: float, y: float, scale: float) -> Pixels:
        """Pixels around the gesture's place."""
        s = self.settings
        return self.ring(depth, x, y, (s.rim_mm * scale, s.clear_mm * scale), s.around)

    def ring(
        self,
        depth: DepthImage,
        x: float,
        y: float,
        radii: tuple[float, float],
        n: int,
        between: tuple[float, float] = (0.0, np.inf),
    ) -> Pixels:
        """At most n pixels at a distance (px) of (x, y) within `radii`, evenly over the area, and at a depth (mm) that
        is usable and within `between`."""
        angle = self.rng.uniform(0, 2 * np.pi, 4 * n)
        r = np.sqrt(self.rng.uniform(radii[0] ** 2, radii[1] ** 2, 4 * n))
        columns = np.rint(x + r * np.cos(angle)).astype(np.int64)
        rows = np.rint(y + r * np.sin(angle)).astype(np.int64)
        ok = (columns >= 0) & (rows >= 0) & (columns < depth.shape[1]) & (rows < depth.shape[0])
        rows, columns = rows[ok], columns[ok]
        d = depth[rows, columns].astype(np.int64)
        ok = self._usable(d) & (d >= between[0]) & (d <= between[1])
        return rows[ok][:n], columns[ok][:n]

    def anywhere(self, depth: DepthImage, n: int, clear: tuple[float, float, float] | None) -> Pixels:
        """At most n usable pixels of the whole picture, but for a circle (x, y, radius px)."""
        rows = self.rng.integers(0, depth.shape[0], 6 * n)
        columns = self.rng.integers(0, depth.shape[1], 6 * n)
        ok = self._usable(depth[rows, columns].astype(np.int64))
        if clear is not None:
            ok &= (columns - clear[0]) ** 2 + (rows - clear[1]) ** 2 > clear[2] ** 2
        return rows[ok][:n], columns[ok][:n]

    def surface(self, depth: DepthImage, x: float, y: float) -> float | None:
        """Depth (mm) of what is marked, if it is where the forest looks."""
        surface, plan = surface_depth(depth, x, y), self.settings.look.plan
        return surface if surface is not None and plan.near_mm <= surface <= plan.far_mm else None

    def _usable(self, d: NDArray) -> NDArray[np.bool_]:
        plan = self.settings.look.plan
        return (d >= plan.near_mm) & (d <= plan.far_mm)
