"""Alcoverro 2014, chapter 3, equation by equation against plain Python."""

import itertools
import math

import numpy as np
import pytest

from benchmarks.papers import offline_forests
from benchmarks.papers.offline_forests import OfflineSettings, Pool, train_offline
from hypose.compute import forest_votes, forests
from hypose.compute.forests import UNCLIPPED_MM
from hypose.gestures.forest import ForestSettings, GrowingForest
from hypose.gestures.localise import LocaliseSettings, Scratch, settle
from hypose.gestures.trainer import Session, SessionSettings, advance, update_maximum
from tests.gestures.toys import LENS, grown, padded, probabilities, samples, toy

FAR = 10000


def depth_at(depth, y, x):
    """d(y, x) mm; a hole or a place outside the picture is as far as it can be."""
    inside = 0 <= y < depth.shape[0] and 0 <= x < depth.shape[1]
    return int(depth[y, x]) if inside and depth[y, x] else FAR


def f_printed(depth, y, x, u, v, kappa):
    """Eq. 3.6, and eq. 3.3 where kappa is endless: u, v (2,) = (y, x) mm, divided by the depth and times the focal
    length in pixels."""
    d = depth_at(depth, y, x)
    out = []
    for a, b in (u, v):
        q = depth_at(depth, y + math.floor(a * LENS.fx / d + 0.5), x + math.floor(b * LENS.fx / d + 0.5))
        out.append(max(min(q, d + kappa), d - kappa))
    return out[0] - out[1]


@pytest.mark.parametrize("kappa", [150, 300, UNCLIPPED_MM])
def test_equations_3_3_and_3_6_what_a_test_reads(kappa, rng):
    depth, _, _ = toy(rng)
    picture = padded(depth)
    rows, columns = (rng.integers(0, n, 400) for n in depth.shape)
    different = 0
    for y, x, cell in zip(rows, columns, picture.cells(rows, columns), strict=True):
        d = int(depth[y, x])
        if d == 0:
            continue
        u, v = rng.integers(-150, 151, 2), rng.integers(-150, 151, 2)
        v = v if rng.random() < 0.5 else 0 * v
        scale = np.float32(LENS.fx / d)
        found = forests.response(picture.flat, picture.width, np.uint64(cell), d, scale, d - kappa, d + kappa, *u, *v)
        # single precision may round an offset to the next pixel
        different += found != f_printed(depth, int(y), int(x), u, v, kappa)
    assert different <= 4


def test_equation_3_1_probabilities_are_means_over_the_leaves_that_are_reached(rng):
    forest = grown(60).freeze()
    depth, _, _ = toy(rng)
    rows, columns = np.nonzero(depth)
    chosen = rng.choice(len(rows), 150, replace=False)
    found = probabilities(forest, padded(depth), rows[chosen], columns[chosen])
    near = 0
    for y, x, p in zip(rows[chosen].tolist(), columns[chosen].tolist(), found, strict=True):
        shares = []
        for test, left, seen in zip(forest.test, forest.left, forest.seen, strict=True):
            n = 0
            while left[n] >= 0:
                u, v, threshold = test[n, :2], test[n, 2:4], test[n, 4]
                n = left[n] + int(f_printed(depth, y, x, u, v, forest.settings.clip) >= threshold)
            shares.append(seen[n] / seen[n].sum())
        near += np.abs(np.mean(shares, axis=0)[1] - p) < 2e-4
    assert near >= 147  # as above


def entropy(counts):
    p = np.asarray(counts)[np.asarray(counts) > 0] / np.sum(counts)
    return float(-(p * np.log2(p)).sum())


def test_equation_3_2_the_test_of_largest_information_gain(rng):
    for _ in range(50):
        total = rng.integers(1, 60, 3)
        left = rng.integers(0, total + 1, (20, 3))
        n = total.sum()
        printed = np.full(20, -np.inf)
        for q, side in enumerate(left):
            if 0 < side.sum() < n:
                rest = total - side
                printed[q] = -side.sum() / n * entropy(side) - rest.sum() / n * entropy(rest)
        index, gain = forests.best_test(left, total, np.empty((2, 3), np.int64))
        assert printed[index] == pytest.approx(printed.max(), abs=1e-12)
        assert gain == pytest.approx(entropy(total) + printed.max(), abs=1e-12)
    # sides of one sample count as any other; empty ones gain nothing
    assert forests.best_test(np.array([[0, 0], [1, 0]]), np.array([1, 5]), np.empty((2, 2), np.int64))[0] == 1
    assert forests.best_test(np.array([[0, 0], [2, 2]]), np.array([2, 2]), np.empty((2, 2), np.int64))[0] == -1


class Tree:
    """Algorithm 6 for one tree, as printed: plain objects, with the forest's own random numbers (splitmix64)."""

    def __init__(self, state, settings, classes):
        self.state, self.s, self.classes = int(state), settings, classes
        self.nodes = [{"level": 0, "seen": np.zeros(classes, int), "candidates": None}]

    def uniform(self):
        mask = 2**64 - 1
        self.state = (self.state + 0x9E3779B97F4A7C15) & mask
        z = self.state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
        return ((z ^ (z >> 31)) >> 11) / 2**53

    def poisson(self):
        u, k, p = self.uniform(), 0, math.exp(-self.s.rate)
        total = p
        while u > total:
            k, p = k + 1, p * self.s.rate / (k + 1)
            total += p
        return k

    def random_test(self):
        def offset():
            return int(self.uniform() * (2 * self.s.reach_mm + 1)) - self.s.reach_mm

        u = (offset(), offset())
        v = (offset(), offset()) if self.uniform() < 0.5 else (0, 0)
        return u, v, int((2 * self.uniform() - 1) * self.s.spread_mm * self.uniform())

    def update(self, read, label):
        repeats = self.poisson()
        if repeats == 0:
            return
        n = 0
        while "test" in self.nodes[n]:  # findLeaf
            u, v, threshold = self.nodes[n]["test"]
            n = self.nodes[n]["left"] + int(read(u, v) >= threshold)
        leaf = self.nodes[n]
        leaf["seen"][label] += repeats  # updateNode: the leaf's statistics ...
        if leaf["level"] >= self.s.deepest:
            return
        if leaf["candidates"] is None:
            if (leaf["seen"] >= 2).sum() < 2:
                return
            leaf["candidates"] = [(self.random_test(), np.zeros(self.classes, int)) for _ in range(self.s.candidates)]
            leaf["total"] = np.zeros(self.classes, int)
        leaf["total"][label] += repeats
        for (u, v, threshold), left in leaf["candidates"]:  # ... and those of every test's sides
            left[label] += repeats if read(u, v) < threshold else 0
        size = leaf["total"].sum()
        if size <= self.s.alpha:  # shouldSplit
            return
        gains = []
        for _, left in leaf["candidates"]:
            right = leaf["total"] - left
            some = 0 < left.sum() < size
            after = (
                (left.sum() * entropy(left) + right.sum() * entropy(right)) / size if some else entropy(leaf["total"])
            )
            gains.append(entropy(leaf["total"]) - after)
        best = int(np.argmax(np.round(gains, 12)))
        if gains[best] > self.s.beta + 1e-12:
            test, left = leaf["candidates"][best]
            leaf["test"], leaf["left"] = test, len(self.nodes)
            for side in (left, leaf["total"] - left):  # children begin with the counts of their side
                self.nodes.append({"level": leaf["level"] + 1, "seen": side.copy(), "candidates": None})
        elif size > 3 * self.s.alpha:
            leaf["candidates"] = None


def test_algorithm_6_an_online_forest_grows_as_printed(rng):
    settings = ForestSettings(trees=2, alpha=25, candidates=12, deepest=4)
    forest = GrowingForest.new(settings, rng)
    trees = [Tree(state, settings, 2) for state in forest.arrays.random]
    for _ in range(25):
        depth, (x, y), square = toy(rng, 1000)
        rows, columns, labels = samples(rng, (int(x), int(y)), square, 6)
        forest.learn(padded(depth, settings.reach_mm), rows, columns, labels)
        for r, c, label in zip(rows.tolist(), columns.tolist(), labels.tolist(), strict=True):
            if depth[r, c] < 500:
                continue
            for tree in trees:
                tree.update(lambda u, v, at=(depth, r, c): f_printed(*at, u, v, settings.clip), label)
    frozen = forest.freeze()
    for k, tree in enumerate(trees):
        assert frozen.size[k] == len(tree.nodes) > 5
        for n, node in enumerate(tree.nodes):
            assert frozen.left[k, n] == node.get("left", -1)
            if "test" in node:
                u, v, threshold = node["test"]
                assert frozen.test[k, n].tolist() == [*u, *v, threshold]
            assert np.abs(frozen.seen[k, n].astype(int) - node["seen"]).sum() <= 2  # single precision, as above


def test_section_3_2_3_a_tree_learns_from_the_errors_of_the_one_before(monkeypatch, rng):
    # a pool on which a shallow tree errs: the class hangs on two of the patch's depths at once
    patches = rng.integers(-200, 200, (600, 7, 7)).astype(np.int16)
    labels = ((patches[:, 1, 2] > 0) ^ (patches[:, 5, 4] > 0)).astype(np.int8)
    drawn, grow_tree = [], offline_forests.grow_tree

    def noted(patches, labels, order, *rest, **settings):
        tree = grow_tree(patches, labels, order.copy(), *rest, **settings)
        drawn.append((order.copy(), tree))
        return tree

    monkeypatch.setattr(offline_forests, "grow_tree", noted)
    settings = OfflineSettings(ForestSettings(trees=4, deepest=3), per_class=220, tests=20)
    train_offline(Pool(patches, labels), rng, settings)
    assert np.bincount(labels[drawn[0][0]]).tolist() == [220, 220]  # the first draw is balanced
    clip = settings.forest.clip
    for (order, tree), (following, _) in itertools.pairwise(drawn):
        said = []
        for patch in patches.astype(int):
            n = 0
            while tree.left[n] >= 0:
                a, b, c, d, threshold = tree.test[n].tolist()
                read = np.clip(patch[a, b], -clip, clip) - np.clip(patch[c, d], -clip, clip)
                n = tree.left[n] + int(read >= threshold)
            said.append(tree.seen[n].argmax())
        wrong = np.setdiff1d(np.flatnonzero(np.array(said) != labels), order)  # out of the bag
        assert 20 < len(wrong) < 220
        assert np.isin(wrong, following).all()  # all of them, not balanced; the rest is filled up until it is
        assert np.bincount(labels[following]).tolist() == [220, 220]


def test_section_3_2_4_the_density_is_a_parzen_estimate_of_the_votes(rng):
    depth = np.full((80, 100), 1250, np.uint16)
    picture = forests.pad_depth(depth, 200.0, 500, 50)
    scores = np.where(rng.random((20, 25)) < 0.1, rng.uniform(0.3, 1.0, (20, 25)), 0.0).astype(np.float32)
    density, at = forest_votes.parzen(picture, scores, 4, 0.5, 8.0)
    sigma, expected = 8.0 / 4, np.zeros((20, 25))
    reach = range(-6, 7)
    whole = sum(math.exp(-0.5 * (k / sigma) ** 2) for k in reach)
    for i, j in np.argwhere(scores > 0.5):
        vote = float(scores[i, j]) ** 3 * (1.25 * 4 / 200) ** 2
        for a in reach:
            for b in reach:
                if 0 <= i + a < 20 and 0 <= j + b < 25:
                    expected[i + a, j + b] += vote * math.exp(-0.5 * (a * a + b * b) / sigma**2) / whole**2
    np.testing.assert_allclose(density, expected, rtol=1e-4, atol=1e-9)
    assert at == expected.argmax()


def test_equations_3_4_and_3_5_recursion_maximum_and_volume(rng):
    depth = np.full((150, 200), 1500, np.uint16)
    settings, scratch = LocaliseSettings(adaptation_rate=0.8, disc_mm=60.0), Scratch()
    stride = settings.at(LENS).plan.stride
    shape = (-(-(150 - stride // 2) // stride), -(-(200 - stride // 2) // stride))
    remembered = None
    for _ in range(4):
        p = rng.random(shape).astype(np.float32) ** 6
        remembered = p if remembered is None else 0.8 * p + 0.2 * remembered
        found = settle([(p, int(p.argmax()))], depth, LENS, settings, scratch)[0]
        i, j = np.unravel_index(remembered.argmax(), shape)
        assert abs((found.x - stride // 2) / stride - j) <= 0.5 and abs((found.y - stride // 2) / stride - i) <= 0.5
        radius = 60.0 * LENS.fx / 1500 / stride  # px of the disc, inversely proportional to the depth
        disc = [(a, b) for a in range(shape[0]) for b in range(shape[1]) if (a - i) ** 2 + (b - j) ** 2 <= radius**2]
        assert found.score == pytest.approx(1e4 * sum(float(remembered[c]) for c in disc), rel=1e-5)


def test_section_3_4_1_the_threshold_is_the_weighted_mean_of_two_moving_averages(rng):
    settings = SessionSettings(sigma=0.9, rho=0.8)
    session, _ = advance(Session(), settings, 0.0, ["next"])
    averages = {}
    for phase in ("positive", "negative"):
        for m in rng.uniform(1, 50, 6).tolist():
            assert session.phase == phase
            session = update_maximum(session, settings, m)
            averages[phase] = m if phase not in averages else 0.9 * m + 0.1 * averages[phase]
        session, _ = advance(advance(session, settings, 0.1, ["next"])[0], settings, 0.1, ["next"])
    assert session.threshold(settings) == pytest.approx(0.8 * averages["positive"] + 0.2 * averages["negative"])
