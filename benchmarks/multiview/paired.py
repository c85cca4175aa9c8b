"""Rows of methods that were measured on the same clips: means, and paired differences with their 95 % intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import t

from benchmarks.bench_report import Row, row


def paired_rows(
    metric: str,
    errors: Mapping[str, Sequence[float]],
    pairs: Sequence[tuple[str, str]],
    actions: Sequence[str],
) -> list[Row]:
    """Mean of every method over the clips and over those of each action, then `differences` of the pairs.

    errors: method -> mm per clip, of the first clips where there are fewer; actions: of each clip.
    """
    rows = []
    for name, values in errors.items():
        for action in ("", *dict.fromkeys(actions)):
            chosen = [v for v, a in zip(values, actions, strict=False) if action in ("", a)]
            rows.append(row(metric, f"{name}/{action}" if action else name, chosen, "mm"))
    return rows + differences("difference{}_mm", errors, pairs, "mm")


def differences(
    metric: str, values: Mapping[str, Sequence[float]], pairs: Sequence[tuple[str, str]], unit: str
) -> list[Row]:
    """Mean of first - second of every pair of methods, and both ends of its 95 % interval (Student's t; NaN for fewer
    than two repetitions).

    metric: name of the rows, with {} where "", "_low" or "_high" stands; values: method -> of each repetition.
    """
    rows = []
    for first, second in pairs:
        apart = np.subtract(values[first], values[second])
        half = t.ppf(0.975, len(apart) - 1) * apart.std(ddof=1) / np.sqrt(len(apart)) if len(apart) > 1 else np.nan
        for end, value in (("", 0.0), ("_low", -half), ("_high", half)):
            rows.append(row(metric.format(end), f"{first} - {second}", apart + value, unit))
    return rows
