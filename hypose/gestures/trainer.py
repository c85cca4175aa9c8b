"""A session with a forest: every frame goes through the state machine, teaches, and moves the threshold.

What a screen or a command line drives; it draws and writes nothing itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hypose.compute import DepthImage, TreeArraysOffline, forests
from hypose.errors import InputError
from hypose.gestures.depth_pictures import DepthLens
from hypose.gestures.forest import Forest, ForestSettings, GrowingForest
from hypose.gestures.localise import Localisation, LocaliseSettings, localise, pad
from hypose.gestures.online import Example, Learner, LearnSettings, PixelSampler, Taught
from hypose.gestures.session import Command, Instruction, Session, SessionSettings, advance, update_maximum


@dataclass(frozen=True)
class Feedback:
    """What to show for a frame: the instruction; the box (x, y) px; what was learned (None: nothing); the forest's
    maximum; the threshold so far (cm^2)."""

    instruction: Instruction
    box: tuple[float, float]
    taught: Taught | None
    found: Localisation | None
    threshold: float | None


def half_way(gestures: Sequence[float], others: Sequence[float]) -> float:
    """Return half way between the strongest of the others' scores (0 without any) and the weaker gestures (lower
    quartile)."""
    return 0.5 * (float(np.quantile(gestures, 0.25)) + max(others, default=0.0))


def balanced(gestures: Sequence[float], others: Sequence[float]) -> float:
    """Return a threshold (cm^2) 0.3 of the way, on a logarithmic scale, from what every tenth frame of other movement
    reaches to what the gesture usually (median) scores.

    What every tenth frame reaches is read off an exponential tail above the median of the others' scores: all frames
    have a say in it, where the strongest one alone is chance. At least a tenth of the usual score, because movement
    that never scored says nothing about movement to come.
    """
    usual, middle = float(np.median(gestures)), float(np.median(others))
    above = [v - middle for v in others if v > middle]
    level = middle + (float(np.mean(above)) * np.log(0.5 * _ONE_IN) if above else 0.0)
    return float(max(level, _LEAST_THRESHOLD * usual) ** (1 - _TOWARDS) * usual**_TOWARDS)


_ONE_IN, _TOWARDS, _LEAST_THRESHOLD = 10, 0.3, 0.1  # chosen on people of whom no figure is reported
_KEPT = 16
"""Frames that show the gesture that are kept to find the threshold in the end."""


@dataclass(frozen=True)
class _Snapshot:
    arrays: tuple[NDArray[Any], ...]
    random: Mapping[str, Any]
    strength: dict[int, float]
    kept: list[tuple[DepthImage, DepthLens]]
    movement: list[float]
    shown: int
    keep: Mapping[str, Any]


class Trainer:
    """Teaches one gesture; the forest before the last segment is kept, so that the segment can be taken back."""

    def __init__(self, learner: Learner, settings: SessionSettings | None = None) -> None:
        self.learner, self.settings = learner, settings or SessionSettings()
        self.session = Session()
        self._before: _Snapshot | None = None
        self._segment = 0
        # frames that show the gesture; every one has the same chance of being kept; drawn apart from the learned pixels
        self._keep, self._shown = np.random.default_rng(0), 0
        self._kept: list[tuple[DepthImage, DepthLens]] = []
        self._movement: list[float] = []  # what the forest scored in frames of other movement before it learned them

    @property
    def threshold(self) -> float | None:
        """Return the automatic threshold (cm^2); None until gesture and movement have been seen."""
        return self.session.threshold(self.settings)

    def frame(
        self,
        time: float,
        depth: DepthImage,
        lens: DepthLens,
        box: tuple[float, float],
        commands: Sequence[Command] = (),
        *,
        learn: bool = True,
    ) -> Feedback:
        """Take a frame (h, w) uint16 mm of a time (s); box: the pixel where the gesture is asked for; learn False: the
        frame is kept from the forest (to judge it by, or because it was shown before)."""
        self.session, instruction = advance(self.session, self.settings, time, commands)
        if instruction.restart and self._before is not None:
            self._restore(self._before)
        taught, found = None, None
        if instruction.learn is not None:
            if instruction.segment != self._segment:
                self._segment, self._before = instruction.segment, self._snapshot()
            if learn:
                taught = self.learn(instruction.learn, depth, lens, box)
                found = None if taught is None or not taught.maxima else taught.maxima[0]
        elif instruction.phase == "test":
            found = localise(depth, lens, [self.learner.forest], self.learner.settings.look, self.learner.scratch)[0]
        return Feedback(instruction, box, taught, found, self.threshold)

    def learn(
        self,
        kind: Literal["gesture", "negative"],
        depth: DepthImage,
        lens: DepthLens,
        at: tuple[float, float],
        *,
        mine: bool = True,
    ) -> Taught | None:
        """Learn a frame outside the state machine's order (from a recording): the forest, the moving averages and what
        the threshold is found from change as in a live session. None when no usable surface is at the pixel `at`."""
        learner, shows = self.learner, kind == "gesture"
        look = learner.settings.look
        # as hard negatives do, before it is learned
        found = None if mine else localise(depth, lens, [learner.forest], look, learner.scratch)[0]
        taught = learner.show(depth, lens, 1, *at, mine=mine) if shows else learner.reject(depth, lens, mine=mine)
        if taught is not None:
            score = (found or taught.maxima[0]).score
            session = replace(self.session, phase="positive" if shows else "negative")
            self.session = update_maximum(session, self.settings, score)
            if shows:
                self._remember(depth, lens)
            else:
                self._movement.append(score)
        return taught

    def final_threshold(self, look: LocaliseSettings | None = None) -> float | None:
        """The threshold (cm^2) of the forest as it is now (`balanced`): the gesture's scores in the kept frames, and
        those of movement before it was learned, since what was learned scores less than what comes new.

        Deviation: the published moving averages follow a forest that goes on changing, and what a gesture scores in the
        end differs; they are shown while training and used when one kind has not been seen."""
        if not self._kept or not self._movement:
            return self.threshold
        forest = self.learner.forest.freeze()
        scores = [localise(depth, lens, [forest], look)[0].score for depth, lens in self._kept]
        return balanced(scores, self._movement) or None

    def _remember(self, depth: DepthImage, lens: DepthLens) -> None:
        self._shown += 1
        if len(self._kept) < _KEPT:
            self._kept.append((depth, lens))
        elif (place := int(self._keep.integers(self._shown))) < _KEPT:
            self._kept[place] = depth, lens

    def _snapshot(self) -> _Snapshot:
        a = self.learner
        arrays = tuple(x.copy() for x in a.forest.arrays)
        keep = self._keep.bit_generator.state
        kept, movement = self._kept.copy(), self._movement.copy()
        return _Snapshot(arrays, a.rng.bit_generator.state, dict(a.strength), kept, movement, self._shown, keep)

    def _restore(self, s: _Snapshot) -> None:
        forest = self.learner.forest
        arrays = type(forest.arrays)(*(x.copy() for x in s.arrays))
        self.learner.forest = GrowingForest(forest.settings, arrays)
        self.learner.rng.bit_generator.state = s.random
        self.learner.strength = dict(s.strength)
        self._kept, self._movement, self._shown = s.kept.copy(), s.movement.copy(), s.shown
        self._keep.bit_generator.state = s.keep


# ---- offline ---------------------------------------------------------------------------------------------------------
# Learning from recorded frames all at once: boosted trees, boosted sub-forests, or neither.
#
# Boosted trees: Lopez-Mendez et al., as described in Alcoverro 2014, 3.2.3. Boosted sub-forests: Gall et al. 2011, the
# baseline of Table 3.1. Thresholds are drawn from what a node's samples read, whatever the clipping distance: a prior
# for small differences would clip by itself, and hide what reading far behind the hand costs.


STEP_MM = 6
"""Offsets of offline tests are multiples of this: samples are kept as patches read at that spacing."""


@dataclass(frozen=True)
class OfflineSettings:
    """Offline settings.

    forest: trees, deepest, clip_mm and reach_mm are used.
    per_class: samples per class and tree.
    tests, thresholds: random candidates per node.
    sample: most samples that judge a node.
    learning: "trees" (boosted, each tree gets the errors of the one before), "subforests" (boosted, every `group`
        trees), "plain".
    """

    forest: ForestSettings = field(default_factory=ForestSettings)
    per_class: int = 20000
    tests: int = 100
    thresholds: int = 4
    sample: int = 3000
    learning: Literal["trees", "subforests", "plain"] = "trees"
    group: int = 5


@dataclass(frozen=True)
class Pool:
    """Pool.

    patches (n, P, P) i2: depth around each sample relative to its own, mm.
    labels (n,) i1.
    """

    patches: NDArray[np.int16]
    labels: NDArray[np.int8]


def collect(
    examples: Iterable[Example],
    rng: np.random.Generator,
    *,
    positives: int = 40,
    negatives: int = 12,
    around: int = 10,
    reach_mm: int = 150,
) -> Pool:
    """Samples of every example: N+ around the marked point, N- at random outside it or anywhere in a negative frame,
    and `around` in a ring around the place (0: as published).

    Deviation: positives are pixels near the marked surface, not all that the box holds."""
    chooser = PixelSampler(rng, LearnSettings(around=around))
    patches, labels, picture = [], [], None
    near = chooser.settings.look.plan.near_mm
    for e in examples:
        picture = pad(e.depth, e.lens, reach_mm, near, picture)
        for (rows, columns), label in chooser.choose(e, positives, negatives):
            if len(rows):
                patches.append(forests.cut_patches(picture, picture.cells(rows, columns), STEP_MM))
                labels.append(np.full(len(rows), label, np.int8))
    if not patches:
        raise InputError("There is nothing to learn from: no example has depth between the nearest and farthest range.")
    return Pool(np.concatenate(patches), np.concatenate(labels))


def train_offline(pool: Pool, rng: np.random.Generator, settings: OfflineSettings | None = None) -> Forest:
    """Return a forest from a pool of samples; InputError when a class has no samples.

    "trees" is the boosted learning of Alcoverro 2014, section 3.2.3: the first tree from a balanced draw, every further
    one from the errors of the tree before on what that has not seen, filled up until balanced.
    """
    s = settings or OfflineSettings()
    f = s.forest
    classes = int(pool.labels.max()) + 1 if len(pool.labels) else 0
    members = [np.flatnonzero(pool.labels == c) for c in range(classes)]
    if classes < 2 or any(len(m) == 0 for m in members):
        raise InputError("A forest needs samples of the background and of every gesture; record what is missing.")
    trees: list[TreeArraysOffline] = []
    errors, votes = np.zeros(0, np.int64), np.zeros((len(pool.labels), classes))
    for k in range(f.trees):
        chosen = errors if len(errors) <= s.per_class else rng.choice(errors, s.per_class, replace=False)
        draw = [chosen]
        for c, m in enumerate(members):  # filled up until balanced; the errors themselves are not balanced
            draw.append(rng.choice(m, max(0, s.per_class - int((pool.labels[chosen] == c).sum()))))
        order = rng.permutation(np.concatenate(draw))
        tree = forests.grow_tree(
            pool.patches,
            pool.labels,
            order,
            classes,
            rng,
            deepest=f.deepest,
            tests=s.tests,
            thresholds=s.thresholds,
            clip_mm=f.clip,
            sample=s.sample,
        )
        trees.append(tree)
        if s.learning == "trees":  # its errors on what it has not seen
            wrong = _shares(pool, tree, f.clip).argmax(1) != pool.labels
            wrong[order] = False
            errors = np.flatnonzero(wrong)
        elif s.learning == "subforests":  # the errors of all trees so far, on everything
            votes += _shares(pool, tree, f.clip)
            if (k + 1) % s.group == 0:
                errors = np.flatnonzero(votes.argmax(1) != pool.labels)
    return _joined(trees, f, pool.patches.shape[1] // 2)


def _shares(pool: Pool, tree: TreeArraysOffline, clip: int) -> NDArray[np.float64]:
    share = tree.seen / np.maximum(tree.seen.sum(1, keepdims=True), 1)
    return share[forests.patch_leaves(pool.patches, tree, clip)]


def _joined(trees: list[TreeArraysOffline], settings: ForestSettings, centre: int) -> Forest:
    n, classes = max(len(t.left) for t in trees), trees[0].seen.shape[1]
    test = np.zeros((len(trees), n, 5), np.int16)
    left = np.full((len(trees), n), -1, np.int16)
    count = np.zeros((len(trees), n, classes), np.uint32)
    for k, t in enumerate(trees):
        test[k, : len(t.left), :4] = (t.test[:, :4] - centre) * STEP_MM
        test[k, : len(t.left), 4] = t.test[:, 4]
        left[k, : len(t.left)], count[k, : len(t.left)] = t.left, t.seen
    return Forest(settings, test, left, count, np.array([len(t.left) for t in trees], np.int32))
