"""How well gestures are localized in drawn pictures: one detection per picture, correct within a radius."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.depth_gestures.gesture_pictures import GestureFrame
from hypose.compute.forest_votes import ScanPlan
from hypose.geometry import Array
from hypose.gestures.depth_pictures import KINECT, DepthLens
from hypose.gestures.events import RADIUS_M, average_precision, precision_recall
from hypose.gestures.forest import Forest, GrowingForest
from hypose.gestures.localise import LocaliseSettings, Scratch, localise

RADIUS_PX = 10.0
"""Of a correct localization in the thesis' tables."""


THOROUGH = LocaliseSettings(ScanPlan(first=0, coarse=0))
"""Looks at every place with all trees: what early rejection is compared with."""


@dataclass(frozen=True)
class Judged:
    """scores (n,), errors_px and errors_m (n,) of the detections (inf where the gesture is not shown), shown (n,)."""

    scores: Array
    errors_px: Array
    errors_m: Array
    shown: NDArray[np.bool_]

    def ap(self, radius_px: float = RADIUS_PX) -> float:
        """Average precision at a radius in pixels."""
        return average_precision(self.scores, self.errors_px <= radius_px, int(self.shown.sum()))

    def ap_metres(self, radius: float = RADIUS_M) -> float:
        """Average precision at a radius in metres."""
        return average_precision(self.scores, self.errors_m <= radius, int(self.shown.sum()))

    def auc(self, radius_px: float = RADIUS_PX) -> float:
        """Area under recall over 1 - precision (Table 3.1)."""
        return area_under_curve(self.scores, self.errors_px <= radius_px, int(self.shown.sum()))

    def plain(self) -> dict[str, Any]:
        """For JSON; errors only where the gesture is shown."""
        px, metres = (
            [e if s else None for e, s in zip(v.tolist(), self.shown, strict=True)]
            for v in (self.errors_px, self.errors_m)
        )
        return {"scores": self.scores, "errors_px": px, "errors_m": metres, "shown": self.shown}

    @staticmethod
    def of(value: Mapping[str, Any]) -> Judged:
        """From `plain`."""
        shown = np.asarray(value["shown"], dtype=bool)
        px, metres = (np.where(shown, np.asarray(value[k], dtype=float), np.inf) for k in ("errors_px", "errors_m"))
        return Judged(np.asarray(value["scores"], dtype=float), px, metres, shown)

    def curve(self) -> list[list[float]]:
        """(1 - precision, recall) after each detection, for pictures of the curves."""
        precision, recall = precision_recall(self.scores, self.errors_px <= RADIUS_PX, int(self.shown.sum()))
        return np.round(np.stack([1 - precision, recall], 1), 4).tolist()


def judge(
    forest: Forest | GrowingForest,
    frames: Sequence[GestureFrame],
    gesture: int,
    settings: LocaliseSettings | None = None,
    lens: DepthLens = KINECT,
) -> Judged:
    """What a one-gesture forest finds in every frame, held against the truth for that gesture."""
    scratch, rows = Scratch(), []
    for f in frames:
        found = localise(f.depth, lens, [forest], settings, scratch)[0]
        px = float(np.hypot(found.x - f.x, found.y - f.y)) if f.gesture == gesture else np.inf
        rows.append((found.score, px, px * f.position[2] / lens.fx if f.gesture == gesture else np.inf))
    a = np.array(rows).reshape(-1, 3)
    return Judged(a[:, 0], a[:, 1], a[:, 2], np.array([f.gesture == gesture for f in frames]))


def area_under_curve(scores: Array, correct: NDArray[np.bool_], positives: int) -> float:
    """Area under the curve of the best recall over 1 - precision from 0 to 1."""
    precision, recall = precision_recall(scores, correct, positives)
    if not len(precision):
        return 0.0
    order = np.argsort(1 - precision, kind="stable")
    x, y = (1 - precision)[order], np.maximum.accumulate(recall[order])
    return float((np.diff(np.append(x, 1.0)) * y).sum())
