"""The Mamdani engine against an independent implementation: sampled membership functions and a plain triple loop."""

import numpy as np
import pytest

from hypose.fusion.swarm import MEDIUM_SD, PUBLISHED_RULES, SHARP_RULES


def independent(f, d, a, rules):
    """Sets as tables of 1001 samples read by interpolation, rules as text, the centroid by the trapezoid rule."""
    u = np.linspace(0, 1, 1001)
    table = {
        "low": 1 / (1 + np.exp(rules.slope * (u - rules.low_centre))),
        "high": 1 / (1 + np.exp(-rules.slope * (u - rules.high_centre))),
        "medium": np.exp(-((u - 0.5) ** 2) / (2 * MEDIUM_SD**2)),
    }
    value = {"F": f, "D": d, "A": a}

    def degree(term):
        name, level = term.split("=")
        return float(np.interp(value[name], u, table[level]))

    # each rule: alternatives (OR) of conjunctions (AND)
    text = [
        ("D=low&F=low&A=low", "low"),
        ("D=high|F=high&A=high", "high"),
        ("D=medium&F=low&A=low", "medium"),
        ("D=low&F=medium&A=low", "medium"),
        ("D=low&F=low&A=medium", "medium"),
    ]
    total = np.zeros_like(u)
    for condition, consequent in text:
        strength = max(min(degree(t) for t in part.split("&")) for part in condition.split("|"))
        scaled = strength * table[consequent]
        total = total + scaled - total * scaled
    return np.trapezoid(total * u, u) / np.trapezoid(total, u)


@pytest.mark.parametrize("rules", [PUBLISHED_RULES, SHARP_RULES])
def test_equals_an_independent_implementation_on_a_grid(rules):
    grid = np.linspace(0, 1, 6)
    f, d, a = (x.ravel() for x in np.meshgrid(grid, grid, grid))
    expected = np.array([independent(*v, rules) for v in zip(f, d, a, strict=True)])
    assert np.abs(rules.noise(f, d, a) - expected).max() < 1e-2
