"""Train a forest while the person shows the gesture: positives around the marked point, and hard negatives where the
forest is wrong at that moment.

Source: Alcoverro 2014, sections 3.3.1 and 3.3.2. Deviations, chosen by measurements: a few random negatives accompany
    the hard ones; the number of hard ones is proportional to the maximum relative to the maxima that gestures reach.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hypose.compute.forest_votes import ScanPlan
from hypose.compute.forests import DepthImage
from hypose.gestures.depth_pictures import DepthLens, surface_depth
from hypose.gestures.forest import ForestSettings, GrowingForest
from hypose.gestures.localise import Localisation, LocaliseSettings, Scratch, localise

BACKGROUND, GESTURE = 0, 1
"""Classes of pixels."""
Pixels = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Rows (S,) and columns (S,) of pixels."""


@dataclass(frozen=True)
class LearnSettings:
    """Settings of how many pixels of a frame are learned.

    positives: number of positives, within box_mm of the marked point and surface_mm of its depth.
    around: number of negatives between rim_mm and clear_mm of the marked point, which define where the gesture ends.
    random: number of random negatives outside clear_mm.
    hard: largest number of hard negatives, within box_mm of a wrong maximum.
    few: number of random negatives that accompany the hard ones in a frame without gesture.
    box_mm, rim_mm, surface_mm, clear_mm: distances, mm.
    look: settings of the localisation while learning.
    """

    positives: int = 30
    around: int = 10
    random: int = 8
    hard: int = 30
    few: int = 2
    box_mm: float = 15.0
    rim_mm: float = 20.0
    surface_mm: float = 80.0
    clear_mm: float = 45.0
    look: LocaliseSettings = LocaliseSettings(ScanPlan(stride=8, coarse=0), sigma_px=10.0)


@dataclass(frozen=True)
class Example:
    """One frame to learn from.

    depth: (h, w) uint16 mm, 0 = hole.
    lens: lens parameters of the depth camera.
    gesture: 1 where the gesture is shown, 0 for other movement.
    x, y: pixel of the gesture.
    """

    depth: DepthImage
    lens: DepthLens
    gesture: int = 0
    x: float = 0.0
    y: float = 0.0


@dataclass
class PixelSampler:
    """Sampler that draws pixels of frames with the generator `rng`, in numbers and distances of the settings."""

    rng: np.random.Generator
    settings: LearnSettings

    def inside(self, depth: DepthImage, x: float, y: float, scale: float, surface: float, n: int) -> Pixels:
        """Draw n pixels of the gesture's own surface around the marked point (x, y).

        scale: px per mm at the point.
        surface: depth of the point, mm.
        """
        s = self.settings
        return self.ring(depth, x, y, (0.0, s.box_mm * scale), n, (surface - s.surface_mm, surface + s.surface_mm))

    def rim(self, depth: DepthImage, x: float, y: float, scale: float) -> Pixels:
        """Draw pixels around the gesture, between rim_mm and clear_mm of (x, y); scale: px per mm there."""
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
        """Draw at most n pixels at a distance from (x, y), evenly over the area.

        radii: least and largest distance, px.
        between: least and largest depth, mm; pixels outside the range of the scan are left out too.
        Returns: rows and columns.
        """
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
        """Draw at most n usable pixels of the whole picture, outside a circle clear = (x, y, radius px)."""
        rows = self.rng.integers(0, depth.shape[0], 6 * n)
        columns = self.rng.integers(0, depth.shape[1], 6 * n)
        ok = self._usable(depth[rows, columns].astype(np.int64))
        if clear is not None:
            ok &= (columns - clear[0]) ** 2 + (rows - clear[1]) ** 2 > clear[2] ** 2
        return rows[ok][:n], columns[ok][:n]

    def surface(self, depth: DepthImage, x: float, y: float) -> float | None:
        """Measure the depth (mm) of the surface at pixel (x, y); None where it is outside the range of the scan."""
        surface, plan = surface_depth(depth, x, y), self.settings.look.plan
        return surface if surface is not None and plan.near_mm <= surface <= plan.far_mm else None

    def _usable(self, d: NDArray) -> NDArray[np.bool_]:
        plan = self.settings.look.plan
        return (d >= plan.near_mm) & (d <= plan.far_mm)


@dataclass(frozen=True)
class Taught:
    """Record of the pixels that were learned from one frame.

    learned: number of pixels of the background and of the gesture.
    found: best place of the gesture before learning.
    mined: whether hard negatives were learned at that place.
    """

    learned: tuple[int, int]
    found: Localisation
    mined: bool


@dataclass
class Learner:
    """Growing forest under training, with the random generator that chooses pixels.

    forest: the forest.
    rng: the random generator.
    settings: how many pixels are learned.
    strength: moving average of the maxima in frames that show the gesture, cm^2; None before the first.
    scratch: memory of the localisation.
    """

    forest: GrowingForest
    rng: np.random.Generator
    settings: LearnSettings = field(default_factory=LearnSettings)
    strength: float | None = None
    scratch: Scratch = field(default_factory=Scratch)

    @staticmethod
    def new(
        rng: np.random.Generator, forest: ForestSettings | None = None, settings: LearnSettings | None = None
    ) -> Learner:
        """Make a learner with an untrained forest.

        rng: for the forest and the choice of pixels.
        forest: settings of the forest; None: the defaults.
        settings: how many pixels are learned; None: the defaults.
        """
        return Learner(GrowingForest.new(forest or ForestSettings(), rng), rng, settings or LearnSettings())

    def show(self, depth: DepthImage, lens: DepthLens, x: float, y: float) -> Taught | None:
        """Learn a frame in which the gesture is shown, and hard negatives elsewhere in it.

        depth: (h, w) uint16 mm, 0 = hole.
        lens: lens parameters of the depth camera.
        x, y: pixel of the gesture.
        Returns: what was learned; None where no depth within the range of the scan is measured at that pixel.
        """
        s, draw = self.settings, self._draw
        surface = draw.surface(depth, x, y)
        if surface is None:
            return None
        scale, hard = lens.fx / surface, 0
        found, clear = localise(depth, lens, [self.forest], s.look, self.scratch)[0], (x, y, s.clear_mm * scale)
        positives = self._learn(draw.inside(depth, x, y, scale, surface, s.positives), GESTURE)
        others = self._learn(draw.anywhere(depth, s.random, clear), BACKGROUND)
        others += self._learn(draw.rim(depth, x, y, scale), BACKGROUND)
        old = found.score if self.strength is None else self.strength
        self.strength = 0.9 * old + 0.1 * found.score
        if np.hypot(found.x - x, found.y - y) > clear[2]:
            hard = self._mine(depth, lens, found)
        return Taught((others + hard, positives), found, hard > 0)

    def reject(self, depth: DepthImage, lens: DepthLens) -> Taught:
        """Learn a frame in which the gesture is not shown: hard negatives at the maximum and a few random ones.

        depth: (h, w) uint16 mm, 0 = hole.
        lens: lens parameters of the depth camera.
        Returns: what was learned.
        Deviations: a few random negatives accompany the hard ones; the number of hard ones is proportional to the
        maximum relative to the maxima that the gesture reaches.
        """
        found = localise(depth, lens, [self.forest], self.settings.look, self.scratch)[0]
        hard = self._mine(depth, lens, found)
        others = self._learn(self._draw.anywhere(depth, self.settings.few, None), BACKGROUND)
        return Taught((others + hard, 0), found, hard > 0)

    @property
    def _draw(self) -> PixelSampler:
        return PixelSampler(self.rng, self.settings)

    def _mine(self, depth: DepthImage, lens: DepthLens, found: Localisation) -> int:
        """Learn hard negatives at a place where the forest finds the gesture although it is not there.

        depth: (h, w) uint16 mm.
        lens: lens parameters of the depth camera.
        found: the place; the number of negatives is proportional to its score.
        Returns: number of pixels that were learned.
        """
        surface = surface_depth(depth, found.x, found.y)
        if found.score <= 0 or surface is None:
            return 0
        most = max(found.score if self.strength is None else self.strength, 1e-3)
        number = int(np.ceil(self.settings.hard * min(1.0, found.score / most)))
        radius = self.settings.box_mm * lens.fx / surface
        return self._learn(self._draw.ring(depth, found.x, found.y, (0.0, radius), number), BACKGROUND)

    def _learn(self, pixels: Pixels, label: int) -> int:
        """Learn pixels of the picture in which the gesture was searched last, as one class; return their number.

        pixels: rows and columns.
        label: the class.
        """
        (rows, columns), picture = pixels, self.scratch.picture
        if picture is not None:
            self.forest.learn(picture, rows, columns, np.full(len(rows), label, np.int32))
        return len(rows)
