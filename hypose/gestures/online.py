"""Learning while you watch: positives around the marked point, hard negatives where the forest is wrong just now.

Alcoverro 2014, 3.3.1-3.3.2. Deviations, from measurements, beside those of pixels.py: a few random negatives go with
the hard ones; their number is proportional to the maximum relative to what gestures reach.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hypose.compute import DepthImage
from hypose.errors import InputError
from hypose.gestures.depth_pictures import DepthLens, surface_depth
from hypose.gestures.forest import ForestSettings, GrowingForest
from hypose.gestures.localise import Localisation, Scratch, localise, pad
from hypose.gestures.pixels import BACKGROUND, LearnSettings, Pixels, PixelSampler


@dataclass(frozen=True)
class Taught:
    """What a frame taught: pixels learned per class (C,); where hard negatives were taken, and each gesture's
    maximum."""

    learned: tuple[int, ...]
    mined: tuple[Localisation, ...]
    maxima: tuple[Localisation, ...]


@dataclass
class Learner:
    """A forest that is being taught, with the random numbers that choose pixels, and how strong gestures are by now.

    strength: moving average of the maxima in frames that show each gesture (cm^2)."""

    forest: GrowingForest
    rng: np.random.Generator
    settings: LearnSettings = field(default_factory=LearnSettings)
    strength: dict[int, float] = field(default_factory=dict)
    scratch: Scratch = field(default_factory=Scratch)

    @staticmethod
    def new(
        rng: np.random.Generator,
        forest: ForestSettings | None = None,
        settings: LearnSettings | None = None,
        gestures: int = 1,
    ) -> Learner:
        """A learner that knows nothing yet."""
        grown = GrowingForest.new(forest or ForestSettings(), gestures + 1, rng)
        return Learner(grown, rng, settings or LearnSettings())

    def show(
        self, depth: DepthImage, lens: DepthLens, gesture: int, x: float, y: float, *, mine: bool = True
    ) -> Taught | None:
        """Learn a frame (h, w) uint16 mm in which a gesture (number from 1) is done at pixel (x, y).

        None when no surface is measured at that pixel between the nearest and farthest range. mine: also learn hard
        negatives elsewhere in the frame."""
        if not 1 <= gesture < self.forest.classes:
            raise InputError(f"There is no gesture {gesture}; this forest has 1 to {self.forest.classes - 1}.")
        s = self.settings
        draw = self._draw
        surface = draw.surface(depth, x, y)
        if surface is None:
            return None
        scale = lens.fx / surface
        maxima = self._take(depth, lens, mine)
        clear = (x, y, s.clear_mm * scale)
        counts = [0] * self.forest.classes
        self._learn(draw.inside(depth, x, y, scale, surface, s.positives), gesture, counts)
        self._learn(draw.anywhere(depth, s.beside if mine else s.many, clear), BACKGROUND, counts)
        if mine:
            self._learn(draw.rim(depth, x, y, scale), BACKGROUND, counts)
        mined = []
        for found in maxima:
            old = self.strength.get(found.gesture, found.score)
            if found.gesture == gesture:
                self.strength[gesture] = 0.9 * old + 0.1 * found.score
            if np.hypot(found.x - x, found.y - y) > clear[2] and self._mine(depth, lens, found, counts):
                mined.append(found)
        return Taught(tuple(counts), tuple(mined), maxima)

    def reject(self, depth: DepthImage, lens: DepthLens, *, mine: bool = True) -> Taught:
        """Learn a frame in which no gesture is done: hard negatives at every maximum and a few random ones, or only
        random ones (mine = False).

        Deviation: a few random negatives go with the hard ones. Deviation: the number of hard ones is proportional to
        the maximum relative to what gestures reach."""
        counts = [0] * self.forest.classes
        maxima = self._take(depth, lens, mine)
        mined = tuple(f for f in maxima if self._mine(depth, lens, f, counts))
        number = self.settings.few if mine else self.settings.many
        self._learn(self._draw.anywhere(depth, number, None), BACKGROUND, counts)
        return Taught(tuple(counts), mined, maxima)

    @property
    def _draw(self) -> PixelSampler:
        return PixelSampler(self.rng, self.settings)

    def _take(self, depth: DepthImage, lens: DepthLens, look: bool) -> tuple[Localisation, ...]:
        """Pad the picture for learning, and look for the maxima if wanted."""
        s = self.settings.look
        if look:
            return tuple(localise(depth, lens, [self.forest], s, self.scratch))
        self.scratch.picture = pad(depth, lens, self.forest.settings.reach_mm, s.plan.near_mm, self.scratch.picture)
        return ()

    def _mine(self, depth: DepthImage, lens: DepthLens, found: Localisation, counts: list[int]) -> bool:
        surface = surface_depth(depth, found.x, found.y)
        if found.score <= 0 or surface is None:
            return False
        most = max(self.strength.get(found.gesture, found.score), 1e-3)
        number = int(np.ceil(self.settings.hard * min(1.0, found.score / most)))
        radius = self.settings.box_mm * lens.fx / surface
        return self._learn(self._draw.ring(depth, found.x, found.y, (0.0, radius), number), BACKGROUND, counts) > 0

    def _learn(self, pixels: Pixels, label: int, counts: list[int]) -> int:
        """Learn pixels of the padded picture as a class; their number."""
        (rows, columns), picture = pixels, self.scratch.picture
        if len(rows) and picture is not None:
            self.forest.learn(picture, rows, columns, np.full(len(rows), label, np.int32))
            counts[label] += len(rows)
        return len(rows)
