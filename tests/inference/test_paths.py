"""The likeliest path and the weights of states, against every path there is."""

import itertools

import numpy as np

from hypose.inference.estimates import likeliest_path


def test_path_and_weights_are_those_of_all_paths():
    rng = np.random.default_rng(4)
    for counts in ((2, 3, 1, 2), (1,), (3, 2), (1, 1, 1)):
        costs = [rng.exponential(2.0, n) for n in counts]
        steps = [rng.exponential(2.0, (a, b)) for a, b in zip(counts[:-1], counts[1:], strict=True)]
        every = list(itertools.product(*map(range, counts)))
        total = np.array(
            [
                sum(c[n] for c, n in zip(costs, p, strict=True))
                + sum(s[a, b] for s, a, b in zip(steps, p[:-1], p[1:], strict=True))
                for p in every
            ]
        )
        share = np.exp(-total) / np.exp(-total).sum()
        path, weights = likeliest_path(costs, steps)
        assert tuple(path) == every[int(total.argmin())]
        for t, n in enumerate(counts):
            expected = [sum(w for w, p in zip(share, every, strict=True) if p[t] == k) for k in range(n)]
            np.testing.assert_allclose(weights[t], expected, rtol=1e-9)
