"""How well gestures are localized: one detection per picture, correct within a radius; curves and averages."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hypose.geometry import Array

RADIUS_M = 0.05
"""Of a correct localization that does not depend on the distance, in the picture plane at the gesture's depth."""


def precision_recall(scores: Array, correct: NDArray[np.bool_], positives: int) -> tuple[Array, Array]:
    """Precision and recall after each detection, best score first; equal scores put the wrong ones first; a score of 0
    is no detection."""
    order = np.lexsort((correct, -scores))
    order = order[scores[order] > 0]
    hits = np.cumsum(correct[order])
    return hits / np.arange(1, len(order) + 1), hits / max(positives, 1)


def average_precision(scores: Array, correct: NDArray[np.bool_], positives: int) -> float:
    """Mean precision at each correct detection, missed ones counting 0."""
    precision, recall = precision_recall(scores, correct, positives)
    return float((precision * np.diff(recall, prepend=0.0)).sum())
