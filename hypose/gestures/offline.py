"""Learning from recorded frames all at once: boosted trees, boosted sub-forests, or neither.

Boosted trees: Lopez-Mendez et al., as described in Alcoverro 2014, 3.2.3. Boosted sub-forests: Gall et al. 2011, the
baseline of Table 3.1. Thresholds are drawn from what a node's samples read, whatever the clipping distance: a prior for
small differences would clip by itself, and hide what reading far behind the hand costs.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hypose.compute import TreeArraysOffline, forests
from hypose.errors import InputError
from hypose.gestures.forest import Forest, ForestSettings
from hypose.gestures.localise import pad
from hypose.gestures.pixels import Example, LearnSettings, PixelSampler

STEP_MM = 6
"""Offsets of offline tests are multiples of this: samples are kept as patches read at that spacing."""


@dataclass(frozen=True)
class OfflineSettings:
    """forest: trees, deepest, clip_mm and reach_mm are used; per_class: samples per class and tree; tests, thresholds:
    random candidates per node; sample: most samples that judge a node; learning: "trees" (boosted, each tree gets the
    errors of the one before), "subforests" (boosted, every `group` trees), "plain"."""

    forest: ForestSettings = field(default_factory=ForestSettings)
    per_class: int = 20000
    tests: int = 100
    thresholds: int = 4
    sample: int = 3000
    learning: Literal["trees", "subforests", "plain"] = "trees"
    group: int = 5


@dataclass(frozen=True)
class Pool:
    """patches (n, P, P) i2: depth around each sample relative to its own, mm; labels (n,) i1."""

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
    """A forest from a pool of samples; InputError when a class has no samples.

    "trees" is the boosted learning of Alcoverro 2014, section 3.2.3: the first tree from a balanced draw, every further
    one from the errors of the tree before on what that has not seen, filled up until balanced."""
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
