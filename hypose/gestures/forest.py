"""Random forests of depth tests: a finished one (`Forest`), and one that grows with every sample (`GrowingForest`).

A forest separates a gesture (class 1) from the background (class 0) at a pixel. Source: Alcoverro 2014, sections
3.2 and 3.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hypose.compute import forest_votes, forests
from hypose.compute.forests import GrowingArrays, PaddedDepth

CLASSES = 2
"""Number of classes of a forest: the background (0) and the gesture (1)."""


@dataclass(frozen=True)
class ForestSettings:
    """Settings of the growth of a forest.

    trees: number of trees.
    deepest: number of levels below the root.
    clip_mm: distance kappa at which both depths of a test are clipped around the pixel's own (eq. 3.6); None: no
        clipping (eq. 3.3).
    reach_mm: half side of the square from which offsets are drawn (150 mm = 85 px at 2 m with the first Kinect).
    candidates: number of random tests per leaf.
    alpha: number of samples before a split (Algorithm 6).
    beta: least information gain of a split, bits (Algorithm 6).
    rate: mean of the Poisson number of repeats of a sample (Algorithm 6).
    most_slots: number of leaves per tree that can hold candidates at a time; bounds the memory.
    most_nodes: number of nodes per tree; bounds the memory.
    """

    trees: int = 15
    deepest: int = 20
    clip_mm: int | None = 150
    reach_mm: int = 150
    candidates: int = 60
    alpha: int = 300
    beta: float = 0.0
    rate: float = 1.0
    most_slots: int = 500
    most_nodes: int = 8192

    @property
    def clip(self) -> int:
        """clip_mm as a number; None becomes a value that never clips."""
        return forests.UNCLIPPED_MM if self.clip_mm is None else self.clip_mm

    @property
    def spread_mm(self) -> int:
        """Range of the thresholds that are drawn at a leaf which has no sample yet, mm."""
        return 1000 if self.clip_mm is None else min(self.clip_mm, 300)


@dataclass(frozen=True)
class Forest:
    """Finished forest of nt trees with at most N nodes.

    settings: with which it was grown.
    test: (nt, N, 5) int16, test of each node: two offsets and a threshold, mm.
    left: (nt, N) int16, number of the left child; -1 at a leaf.
    seen: (nt, N, 2) uint32, number of samples per class at each node.
    size: (nt,) int32, number of nodes of each tree.
    """

    settings: ForestSettings
    test: NDArray[np.int16]
    left: NDArray[np.int16]
    seen: NDArray[np.uint32]
    size: NDArray[np.int32]

    @cached_property
    def packed(self) -> NDArray[np.int16]:
        """Memory layout of the forest for scanning pictures."""
        return forest_votes.pack(self.test, self.left, self.seen, self.size)


class GrowingForest:
    """Forest that learns one sample after the other (Alcoverro 2014, Algorithm 6; Saffari 2009).

    It owns its arrays and changes them in place, because copying them per frame would cost more than learning. Memory
    grows with the trees up to the bounds of the settings. The same samples in the same calls give the same forest, also
    across saving and loading, because the random numbers of each tree are part of the arrays.
    """

    def __init__(self, settings: ForestSettings, arrays: GrowingArrays) -> None:
        self.settings, self.arrays = settings, arrays

    @staticmethod
    def new(settings: ForestSettings, rng: np.random.Generator) -> GrowingForest:
        """Make a forest that has learned nothing, whose trees have only roots.

        settings: settings of its growth.
        rng: gives each tree its own random numbers.
        """
        nt, n, s, t = settings.trees, min(64, settings.most_nodes), min(8, settings.most_slots), settings.candidates
        arrays = GrowingArrays(
            np.zeros((nt, n, 5), np.int16),
            np.full((nt, n), -1, np.int16),
            np.zeros((nt, n, CLASSES), np.uint32),
            np.zeros((nt, n), np.uint8),
            np.full((nt, n), -1, np.int16),
            np.ones(nt, np.int32),
            np.tile(np.arange(s, dtype=np.int16), (nt, 1)),
            np.full(nt, s, np.int32),
            np.zeros((nt, s, t, 5), np.int16),
            np.zeros((nt, s, t, CLASSES), np.uint16),
            np.zeros((nt, s, CLASSES), np.int32),
            rng.integers(0, 2**64, nt, dtype=np.uint64),
            np.zeros(2, np.int64),
        )
        return GrowingForest(settings, arrays)

    @property
    def size(self) -> NDArray[np.int32]:
        """Number of nodes of every tree."""
        return self.arrays.size

    def learn(self, picture: PaddedDepth, rows: NDArray, columns: NDArray, labels: NDArray) -> None:
        """Learn pixels of a picture, in their order.

        picture: depth picture, padded for the reach of the settings.
        rows, columns: (S,) pixels.
        labels: (S,) class of each pixel.
        """
        cells = np.require(picture.cells(rows, columns), np.int64, ["C", "W"])
        classes = np.require(labels, np.int32, ["C", "W"])
        for k in range(0, len(cells), 64):  # room for two new nodes per sample is made between blocks
            self._make_room(2 * min(64, len(cells) - k))
            forests.grow(
                picture,
                cells[k : k + 64],
                classes[k : k + 64],
                self.arrays,
                clip_mm=self.settings.clip,
                spread_mm=self.settings.spread_mm,
                rate=self.settings.rate,
                alpha=self.settings.alpha,
                beta=self.settings.beta,
                deepest=self.settings.deepest,
            )

    def freeze(self) -> Forest:
        """Copy the forest as it is now; later growth does not change the copy."""
        a, n = self.arrays, int(self.arrays.size.max())
        return Forest(self.settings, a.test[:, :n].copy(), a.left[:, :n].copy(), a.seen[:, :n].copy(), a.size.copy())

    @property
    def packed(self) -> NDArray[np.int16]:
        """Memory layout of the forest as it is now, for scanning pictures."""
        a = self.arrays
        return forest_votes.pack(a.test, a.left, a.seen, a.size)

    def _make_room(self, nodes: int) -> None:
        """Enlarge the arrays so that `nodes` more nodes fit per tree, within the bounds of the settings."""
        a, s = self.arrays, self.settings
        have, need = a.left.shape[1], min(int(a.size.max()) + nodes, s.most_nodes)
        if need > have:
            n = min(max(need, have * 3 // 2), s.most_nodes)
            a = a._replace(
                test=_longer(a.test, n, 0),
                left=_longer(a.left, n, -1),
                seen=_longer(a.seen, n, 0),
                level=_longer(a.level, n, 0),
                slot=_longer(a.slot, n, -1),
            )
        have = a.free.shape[1]
        if have < s.most_slots and int(a.n_free.min()) < min(nodes, 32):
            n = min(max(have + 32, have * 5 // 4), s.most_slots)
            free = _longer(a.free, n, 0)
            n_free = a.n_free + np.int32(n - have)
            for t in range(len(free)):  # new slots come before the old ones: which slot a leaf gets does not matter
                free[t, : n_free[t]] = np.concatenate([np.arange(have, n, dtype=np.int16), a.free[t, : a.n_free[t]]])
            a = a._replace(
                free=free,
                n_free=n_free,
                candidate=_longer(a.candidate, n, 0),
                left_count=_longer(a.left_count, n, 0),
                total=_longer(a.total, n, 0),
            )
        self.arrays = a


def _longer(a: NDArray, n: int, fill: int) -> NDArray:
    """Return an array (nt, m, ...) enlarged to (nt, n, ...); new entries have the value `fill`."""
    out = np.full((a.shape[0], n, *a.shape[2:]), fill, a.dtype)
    out[:, : a.shape[1]] = a
    return out
