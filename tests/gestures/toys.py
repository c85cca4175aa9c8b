"""Small pictures with a round thing (the gesture) and a square thing, at any distance."""

import numpy as np

from hypose.compute import forest_votes
from hypose.compute.forests import pad_depth
from hypose.gestures.depth_pictures import DepthLens
from hypose.gestures.forest import ForestSettings, GrowingForest

LENS = DepthLens(200.0, 200.0, 99.5, 74.5)
SHAPE = (150, 200)


def toy(rng, distance=1200, holes=True):
    """Depth (150, 200) mm, centre of the disc (x, y), corner and side of the square."""
    depth = np.full(SHAPE, 2600, np.uint16)
    yy, xx = np.mgrid[: SHAPE[0], : SHAPE[1]]
    r = 70 * LENS.fx / distance
    y, x = rng.integers(25, 125), rng.integers(30, 90)
    a, b = rng.integers(10, 110), rng.integers(110, 165)
    side = int(2 * r)
    depth[a : a + side, b : b + side] = distance
    depth[(yy - y) ** 2 + (xx - x) ** 2 <= r * r] = distance
    depth = (depth + rng.integers(-4, 5, SHAPE)).astype(np.uint16)
    if holes:
        depth[rng.random(SHAPE) < 0.02] = 0
    return depth, (float(x), float(y)), (a, b, side)


def padded(depth, reach_mm=150, reuse=None):
    """The picture as forests read it."""
    return pad_depth(depth, LENS.fx, 500, reach_mm, reuse)


def probabilities(forest, picture, rows, columns):
    """(S,) mean shares of class 1 over the leaves that pixels reach, eq. 3.1."""
    every = forest_votes.ScanPlan(stride=1, near_mm=0, far_mm=9999, first=0)
    return forest_votes.scan(picture, [forest.packed], [forest.settings.clip], every)[0][rows, columns]


def samples(rng, where, square, n=12):
    """Rows, columns and labels: the disc's middle, the square, anywhere else."""
    (x, y), (a, b, side) = where, square
    rows = [rng.integers(y - 5, y + 6, n), rng.integers(a, min(a + side, SHAPE[0]), n), rng.integers(0, SHAPE[0], n)]
    columns = [rng.integers(x - 5, x + 6, n), rng.integers(b, min(b + side, SHAPE[1]), n), rng.integers(0, SHAPE[1], n)]
    r, c = np.concatenate(rows), np.concatenate(columns)
    labels = np.repeat([1, 0, 0], n)
    kept = (labels == 1) | ((r - y) ** 2 + (c - x) ** 2 > 20**2)
    return r[kept], c[kept], labels[kept]


def grown(frames=120, seed=0, **settings):
    """A forest that has learned the disc."""
    rng = np.random.default_rng(seed)
    forest = GrowingForest.new(ForestSettings(**{"alpha": 100, "candidates": 40, **settings}), rng)
    more(forest, rng, frames)
    return forest


def more(forest, rng, frames):
    """Teach it some more frames."""
    picture = None
    for _ in range(frames):
        depth, where, square = toy(rng, int(rng.integers(900, 1600)))
        picture = padded(depth, forest.settings.reach_mm, picture)
        forest.learn(picture, *samples(rng, (int(where[0]), int(where[1])), square))
