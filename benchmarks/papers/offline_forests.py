"""Forests learned from recorded frames all at once: boosted trees, boosted sub-forests, or neither.

Boosted trees: Lopez-Mendez et al., as described in Alcoverro 2014, 3.2.3. Boosted sub-forests: Gall et al. 2011, the
baseline of Table 3.1. Thresholds are drawn from what a node's samples read, whatever the clipping distance: a prior
for small differences would clip by itself, and hide what reading far behind the hand costs.
"""

# ruff: noqa: ANN001 - kernels are compiled for the types they are called with

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hypose.compute.compiled import kernel
from hypose.compute.forests import HALF, MAX_NODES, SHIFT, PaddedDepth, best_test, f4, i4, pad_depth, uniform
from hypose.errors import InputError
from hypose.gestures.forest import Forest, ForestSettings
from hypose.gestures.online import BACKGROUND, Example, LearnSettings, Pixels, PixelSampler

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


def chosen_pixels(sampler: PixelSampler, example: Example, positives: int, negatives: int) -> list[tuple[Pixels, int]]:
    """Return pixels to learn from an example with their classes, drawn as in online learning."""
    e, s = example, sampler.settings
    if not e.gesture:
        return [(sampler.anywhere(e.depth, negatives, None), BACKGROUND)]
    surface = sampler.surface(e.depth, e.x, e.y)
    if surface is None:
        return []
    scale, own = e.lens.fx / surface, (surface - s.surface_mm, surface + s.surface_mm)
    return [
        (sampler.ring(e.depth, e.x, e.y, (0.0, s.box_mm * scale), positives, own), e.gesture),
        (sampler.anywhere(e.depth, negatives, (e.x, e.y, s.clear_mm * scale)), BACKGROUND),
        (sampler.ring(e.depth, e.x, e.y, (s.rim_mm * scale, s.clear_mm * scale), s.around), BACKGROUND),
    ]


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
    sampler = PixelSampler(rng, LearnSettings(around=around))
    patches, labels, picture = [], [], None
    near = sampler.settings.look.plan.near_mm
    for e in examples:
        picture = pad_depth(e.depth, e.lens.fx, near, reach_mm, picture)
        for (rows, columns), label in chosen_pixels(sampler, e, positives, negatives):
            if len(rows):
                patches.append(cut_patches(picture, picture.cells(rows, columns), STEP_MM))
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
        tree = grow_tree(
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
    return share[patch_leaves(pool.patches, tree, clip)]


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


def cut_patches(picture: PaddedDepth, cells: NDArray[np.int64], step_mm: int) -> NDArray[np.int16]:
    """(S, P, P) depth relative to the centre's, mm, every step_mm over the square that tests may reach."""
    side = 2 * (picture.reach_mm // step_mm) + 1
    out = np.empty((len(cells), side, side), np.int16)
    _cut_patches(picture.flat, picture.width, cells, picture.focal, step_mm, out)
    return out


class TreeArraysOffline(NamedTuple):
    """One tree of `grow_tree`: test (N, 5) i2 (patch row and column of u and of v, threshold mm), left (N,) i2, seen
    (N, C) u4, level (N,) u1."""

    test: NDArray[np.int16]
    left: NDArray[np.int16]
    seen: NDArray[np.uint32]
    level: NDArray[np.uint8]


def grow_tree(
    patches: NDArray[np.int16],
    labels: NDArray[np.int8],
    order: NDArray[np.int64],
    classes: int,
    rng: np.random.Generator,
    *,
    deepest: int,
    tests: int,
    thresholds: int,
    clip_mm: int,
    sample: int,
    fewest: int = 4,
) -> TreeArraysOffline:
    """One tree from the patches named in `order` (with repetitions), by information gain (eq. 3.2)."""
    room = min(MAX_NODES, 2 * len(order) + 1)
    tree = TreeArraysOffline(
        np.zeros((room, 5), np.int16),
        np.full(room, -1, np.int16),
        np.zeros((room, classes), np.uint32),
        np.zeros(room, np.uint8),
    )
    state = rng.integers(0, 2**63, 1).astype(np.uint64)
    n = _grow_tree(
        patches,
        labels,
        order.copy(),
        deepest,
        tests,
        thresholds,
        clip_mm,
        sample,
        fewest,
        state,
        *tree,
    )
    kept = tree.test[:n], tree.left[:n], tree.seen[:n], tree.level[:n]
    return TreeArraysOffline(kept[0].copy(), kept[1].copy(), kept[2].copy(), kept[3].copy())


def patch_leaves(patches: NDArray[np.int16], tree: TreeArraysOffline, clip_mm: int) -> NDArray[np.int32]:
    """(S,) the leaf that each patch reaches."""
    out = np.empty(len(patches), np.int32)
    _patch_leaves(patches, clip_mm, tree.test, tree.left, out)
    return out


@kernel
def _cut_patches(flat, width, cells, focal, step, out):
    """out (S, P, P) i2: depth minus the centre's at multiples of `step` mm around each cell: what tests at those
    offsets would read."""
    side = out.shape[1]
    for i in range(cells.shape[0]):
        c = cells[i]
        d = i4(flat[c])
        s = f4(focal / d)
        for a in range(side):
            y = i4(f4((a - side // 2) * step) * s + HALF) - SHIFT
            for b in range(side):
                x = i4(f4((b - side // 2) * step) * s + HALF) - SHIFT
                out[i, a, b] = flat[c + y * width + x] - d


@kernel
def _patch_response(patch, clip, e):
    a = min(max(i4(patch[e[0], e[1]]), -clip), clip)
    return a - min(max(i4(patch[e[2], e[3]]), -clip), clip)


@kernel
def _grow_tree(
    patches, labels, order, deepest, tests, thresholds, clip, sample, fewest, state, test, left, count, level
):
    """One tree from all samples at once: at every node `tests` random pairs of patch pixels with `thresholds` cuts
    each, drawn evenly from the range of what the node's samples read there; judged on at most `sample` samples. order
    (n,) i8 is permuted. test (N, 5) i2: patch indices and threshold; left (N,) i2; count (N, C) u4. Returns the number
    of nodes."""
    classes, side = count.shape[1], patches.shape[1]
    stack = np.empty((2 * deepest + 8, 3), np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, order.shape[0], 0
    waiting, nodes = 1, 1
    level[0] = 0
    pairs, cuts = np.empty((tests, 4), np.int64), np.empty((tests, thresholds), np.int64)
    most = min(sample, order.shape[0])
    read, who = np.empty((tests, most), np.int32), np.empty(most, np.int8)
    lefts, total = np.empty((tests * thresholds, classes), np.int64), np.empty(classes, np.int64)
    sides = np.empty((2, classes), np.int64)
    while waiting > 0:
        waiting -= 1
        a, b, node = stack[waiting, 0], stack[waiting, 1], stack[waiting, 2]
        n = b - a
        count[node] = 0
        for i in range(a, b):
            count[node, labels[order[i]]] += 1
        left[node] = -1
        present = 0
        for c in range(classes):
            present += 1 if count[node, c] > 0 else 0
        if level[node] >= deepest or n < fewest or present < 2 or nodes + 2 > left.shape[0]:
            continue
        for q in range(tests):
            for k in range(4):
                pairs[q, k] = int(uniform(state, 0) * side)
            if uniform(state, 0) < 0.5:
                pairs[q, 2], pairs[q, 3] = side // 2, side // 2
        total[:] = 0
        m = min(n, sample)
        for i in range(m):
            j = order[a + i] if m == n else order[a + int(uniform(state, 0) * n)]
            who[i] = labels[j]
            total[who[i]] += 1
            for q in range(tests):
                read[q, i] = _patch_response(patches[j], clip, pairs[q])
        lefts[:] = 0
        for q in range(tests):
            low, high = read[q, :m].min(), read[q, :m].max()
            for k in range(thresholds):
                cuts[q, k] = low + 1 + int(uniform(state, 0) * (high - low))
                for i in range(m):
                    lefts[q * thresholds + k, who[i]] += 1 if read[q, i] < cuts[q, k] else 0
        best, gain = best_test(lefts, total, sides)
        if best < 0 or gain < 1e-6:
            continue
        q, cut = best // thresholds, cuts[best // thresholds, best % thresholds]
        i, j = a, b
        while i < j:
            if _patch_response(patches[order[i]], clip, pairs[q]) < cut:
                i += 1
            else:
                j -= 1
                swap = order[i]
                order[i] = order[j]
                order[j] = swap
        if i == a or i == b:
            continue
        for k in range(4):
            test[node, k] = pairs[q, k]
        test[node, 4] = cut
        left[node] = nodes
        level[nodes], level[nodes + 1] = level[node] + 1, level[node] + 1
        stack[waiting, 0], stack[waiting, 1], stack[waiting, 2] = a, i, nodes
        stack[waiting + 1, 0], stack[waiting + 1, 1], stack[waiting + 1, 2] = i, b, nodes + 1
        waiting += 2
        nodes += 2
    return nodes


@kernel
def _patch_leaves(patches, clip, test, left, out):
    """out (S,) i4: the leaf of a tree of `_grow_tree` that each patch reaches."""
    for i in range(patches.shape[0]):
        n = 0
        while left[n] >= 0:
            n = left[n] + (0 if _patch_response(patches[i], clip, test[n]) < test[n, 4] else 1)
        out[i] = n
