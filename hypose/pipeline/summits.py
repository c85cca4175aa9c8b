"""Maxima of a series, and how far they stand out, as scipy.signal has them: to import that, and scipy.stats with it,
costs what shows a gait 25 MB and a third of a second."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hypose.geometry import Array


def summits(series: Array, distance: int) -> NDArray[np.int64]:
    """Indices of the maxima of a series (T,) of finite values, in its inside only, of a plateau its middle. Of those
    closer together than `distance` the higher stays. As scipy.signal.find_peaks."""
    steps = np.diff(series)
    changes = np.flatnonzero(steps)
    ups = steps[changes] > 0
    top = np.flatnonzero(ups[:-1] & ~ups[1:])
    found = (changes[top] + 1 + changes[top + 1]) // 2
    keep = np.ones(len(found), dtype=bool)
    for k in np.argsort(series[found], kind="stable")[::-1].tolist():
        if keep[k]:
            near = slice(*np.searchsorted(found, [found[k] - distance + 1, found[k] + distance]))
            keep[near] = False
            keep[k] = True
    return found[keep]


def lowest_beside(series: Array, at: NDArray[np.int64]) -> tuple[Array, Array]:
    """The lowest values on the left and on the right of summits `at` of a series (T,), as far as nothing higher than
    the summit lies between. As the bases of scipy.signal.peak_prominences."""
    before, after = _last_higher(series), len(series) - 1 - _last_higher(series[::-1])[::-1]
    left = [series[before[k] + 1 : k + 1].min() for k in at.tolist()]
    right = [series[k : after[k]].min() for k in at.tolist()]
    return np.array(left, dtype=float), np.array(right, dtype=float)


def _last_higher(series: Array) -> NDArray[np.int64]:
    """Index of the last value before each that is higher, -1 where there is none."""
    values, found, open_ = series.tolist(), [], []
    for k, value in enumerate(values):
        while open_ and values[open_[-1]] <= value:
            open_.pop()
        found.append(open_[-1] if open_ else -1)
        open_.append(k)
    return np.array(found, dtype=np.int64)
