"""Learning while you watch: positives around the marked point, hard negatives where the forest is wrong just now.

Alcoverro 2014, 3.3.1-3.3.2. Deviations, from measurements: positives are pixels near the marked surface only (a box
also holds what is behind the fingers); a few random negatives go with the hard ones; the number of hard negatives is
proportional to the maximum relative to what gestures reach.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hypose.compute.forests import Depth, ScanPlan
from hypose.errors import InputError
from hypose.gestures.bounds import check
from hypose.gestures.forest import ForestSettings, GrowingForest
from hypose.gestures.localise import Found, LocaliseSettings, Scratch, localise, pad
from hypose.gestures.pictures import Lens, surface_depth

BACKGROUND = 0


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
        check("Learning's", self, {**counts, **lengths})


@dataclass(frozen=True)
class Taught:
    """What a frame taught: pixels learned per class (C,); where hard negatives were taken, and each gesture's
    maximum."""

    learned: tuple[int, ...]
    mined: tuple[Found, ...]
    maxima: tuple[Found, ...]


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

    def show(self, depth: Depth, lens: Lens, gesture: int, x: float, y: float, *, mine: bool = True) -> Taught | None:
        """Learn a frame (h, w) uint16 mm in which a gesture (number from 1) is done at pixel (x, y).

        None when no surface is measured at that pixel between the nearest and farthest range. mine: also learn hard
        negatives elsewhere in the frame."""
        if not 1 <= gesture < self.forest.classes:
            raise InputError(f"There is no gesture {gesture}; this forest has 1 to {self.forest.classes - 1}.")
        s = self.settings
        surface = self._surface(depth, x, y)
        if surface is None:
            return None
        scale = lens.fx / surface
        maxima = self._take(depth, lens, mine)
        clear = (x, y, s.clear_mm * scale)
        counts = [0] * self.forest.classes
        self._learn(*self._inside(depth, x, y, scale, surface, s.positives), gesture, counts)
        self._learn(*self._anywhere(depth, s.beside if mine else s.many, clear), BACKGROUND, counts)
        if mine:
            self._learn(*self._rim(depth, x, y, scale), BACKGROUND, counts)
        mined = []
        for found in maxima:
            old = self.strength.get(found.gesture, found.score)
            if found.gesture == gesture:
                self.strength[gesture] = 0.9 * old + 0.1 * found.score
            if np.hypot(found.x - x, found.y - y) > clear[2] and self._mine(depth, lens, found, counts):
                mined.append(found)
        return Taught(tuple(counts), tuple(mined), maxima)

    def reject(self, depth: Depth, lens: Lens, *, mine: bool = True) -> Taught:
        """Learn a frame in which no gesture is done: hard negatives at every maximum and a few random ones, or only
        random ones (mine = False)."""
        counts = [0] * self.forest.classes
        maxima = self._take(depth, lens, mine)
        mined = tuple(f for f in maxima if self._mine(depth, lens, f, counts))
        number = self.settings.few if mine else self.settings.many
        self._learn(*self._anywhere(depth, number, None), BACKGROUND, counts)
        return Taught(tuple(counts), mined, maxima)

    def choose(self, example: Example, positives: int, negatives: int) -> list[tuple[NDArray, NDArray, int]]:
        """(rows, columns, class) of pixels to learn offline from an example, chosen as `show` and `reject` do."""
        e, s = example, self.settings
        if not e.gesture:
            return [(*self._anywhere(e.depth, negatives, None), BACKGROUND)]
        surface = self._surface(e.depth, e.x, e.y)
        if surface is None:
            return []
        scale = e.lens.fx / surface
        return [
            (*self._inside(e.depth, e.x, e.y, scale, surface, positives), e.gesture),
            (*self._anywhere(e.depth, negatives, (e.x, e.y, s.clear_mm * scale)), BACKGROUND),
            (*self._rim(e.depth, e.x, e.y, scale), BACKGROUND),
        ]

    def _take(self, depth: Depth, lens: Lens, look: bool) -> tuple[Found, ...]:
        """Pad the picture for learning, and look for the maxima if wanted."""
        s = self.settings.look
        if look:
            return tuple(localise(depth, lens, [self.forest], s, self.scratch))
        self.scratch.picture = pad(depth, lens, self.forest.settings.reach_mm, s.plan.near_mm, self.scratch.picture)
        return ()

    def _mine(self, depth: Depth, lens: Lens, found: Found, counts: list[int]) -> bool:
        surface = surface_depth(depth, found.x, found.y)
        if found.score <= 0 or surface is None:
            return False
        most = max(self.strength.get(found.gesture, found.score), 1e-3)
        number = int(np.ceil(self.settings.hard * min(1.0, found.score / most)))
        radius = self.settings.box_mm * lens.fx / surface
        rows, columns = self._ring(depth, found.x, found.y, (0.0, radius), number)
        self._learn(rows, columns, BACKGROUND, counts)
        return bool(len(rows))

    def _learn(self, rows: NDArray, columns: NDArray, label: int, counts: list[int]) -> None:
        picture = self.scratch.picture
        if not len(rows) or picture is None:
            return
        self.forest.learn(picture, rows, columns, np.full(len(rows), label, np.int32))
        counts[label] += len(rows)

    def _inside(
        self, depth: Depth, x: float, y: float, scale: float, surface: float, n: int
    ) -> tuple[NDArray, NDArray]:
        """Pixels of the gesture's own surface around the marked point; scale: px per mm there."""
        s = self.settings
        return self._ring(depth, x, y, (0.0, s.box_mm * scale), n, (surface - s.surface_mm, surface + s.surface_mm))

    def _rim(self, depth: Depth, x: float, y: float, scale: float) -> tuple[NDArray, NDArray]:
        """Pixels around the gesture's place."""
        s = self.settings
        return self._ring(depth, x, y, (s.rim_mm * scale, s.clear_mm * scale), s.around)

    def _ring(
        self,
        depth: Depth,
        x: float,
        y: float,
        radii: tuple[float, float],
        n: int,
        between: tuple[float, float] = (0.0, np.inf),
    ) -> tuple[NDArray, NDArray]:
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

    def _anywhere(self, depth: Depth, n: int, clear: tuple[float, float, float] | None) -> tuple[NDArray, NDArray]:
        rows = self.rng.integers(0, depth.shape[0], 6 * n)
        columns = self.rng.integers(0, depth.shape[1], 6 * n)
        ok = self._usable(depth[rows, columns].astype(np.int64))
        if clear is not None:
            ok &= (columns - clear[0]) ** 2 + (rows - clear[1]) ** 2 > clear[2] ** 2
        return rows[ok][:n], columns[ok][:n]

    def _surface(self, depth: Depth, x: float, y: float) -> float | None:
        """Depth (mm) of what is marked, if it is where the forest looks."""
        surface, plan = surface_depth(depth, x, y), self.settings.look.plan
        return surface if surface is not None and plan.near_mm <= surface <= plan.far_mm else None

    def _usable(self, d: NDArray) -> NDArray[np.bool_]:
        plan = self.settings.look.plan
        return (d >= plan.near_mm) & (d <= plan.far_mm)


@dataclass(frozen=True)
class Example:
    """A frame to learn from: depth (h, w) uint16 mm; gesture from 1 on at pixel (x, y), or 0 for none."""

    depth: Depth
    lens: Lens
    gesture: int = 0
    x: float = 0.0
    y: float = 0.0


def teach(learner: Learner, examples: Sequence[Example], *, mine: bool = True, shuffle: bool = False) -> None:
    """Show all examples once, in their order or in one drawn from the learner's random numbers."""
    order = learner.rng.permutation(len(examples)) if shuffle else np.arange(len(examples))
    for k in order.tolist():
        e = examples[k]
        if e.gesture:
            learner.show(e.depth, e.lens, e.gesture, e.x, e.y, mine=mine)
        else:
            learner.reject(e.depth, e.lens, mine=mine)
