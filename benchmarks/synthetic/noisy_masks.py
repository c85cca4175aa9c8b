"""Scenes whose masks have the faults of a background model: a rough outline, holes, false pieces, shadow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from statistics import NormalDist
from typing import Any

import cv2
import numpy as np

from hypose.geometry import Mask
from hypose.synthetic.render_rgb import shadow_mask
from hypose.synthetic.scenes import Scene, make_scene, smooth_noise

_MASKS = 5
"""First number of the random stream of the masks, in addition to those in `hypose.synthetic.scenes`."""


@dataclass(frozen=True)
class MaskFaults:
    """Faults of masks; the defaults corrupt nothing. Lengths in px refer to the camera's own image size.

    boundary_px: sd of the smooth displacement of a mask's outline, px.
    holes, blobs: mean number of missing and of false pieces per mask (ellipses of 4-14 px).
    shadow: share of the cast shadow that is segmented as the person, 0..1.
    """

    boundary_px: float = 0.0
    holes: float = 0.0
    blobs: float = 0.0
    shadow: float = 0.0


LEVELS = {
    "level-1": MaskFaults(boundary_px=1.5, holes=1.0, blobs=1.5, shadow=0.2),
    "level-2": MaskFaults(boundary_px=3.0, holes=3.0, blobs=4.0, shadow=0.5),
}
"""level-1 is what a decent background model leaves in a good room, level-2 what a bad one leaves."""


def corrupt_mask(mask: Mask, shadow: Mask, faults: MaskFaults, rng: np.random.Generator, scale: float = 1.0) -> Mask:
    """Corrupt a mask as a background model would.

    mask, shadow: (h, w) uint8 0/1, the true silhouette and the person's cast shadow (without the silhouette).
    faults: to apply.
    scale: working size / camera size, by which lengths in px are multiplied.
    Returns: a new (h, w) mask.
    """
    out = mask.copy()
    x, y, w, h = cv2.boundingRect(mask)
    margin = int(np.ceil(4 * faults.boundary_px * scale)) + 2
    near = (slice(max(y - margin, 0), y + h + margin), slice(max(x - margin, 0), x + w + margin))
    if faults.boundary_px > 0 and w > 0:
        part = mask[near]
        inside = cv2.distanceTransform(part, cv2.DIST_L2, 5)
        outside = cv2.distanceTransform(1 - part, cv2.DIST_L2, 5)
        noise = smooth_noise(rng, part.shape, 8 * scale)
        # distances to the nearest pixel centre of the other kind: half a pixel more than to the outline
        signed = np.where(part > 0, inside - 0.5, 0.5 - outside)
        out[near] = signed + faults.boundary_px * scale * noise > 0
    rows, columns = np.nonzero(mask[near])
    rows, columns = rows + near[0].start, columns + near[1].start
    for value, mean in ((0, faults.holes), (1, faults.blobs)):
        for _ in range(int(rng.poisson(mean)) if mean > 0 else 0):
            if len(rows):
                k = int(rng.integers(len(rows)))
                centre = np.array([columns[k], rows[k]], dtype=np.float64)
            else:
                centre = rng.uniform(0, 1, 2) * mask.shape[::-1]
            if value:
                centre = centre + rng.normal(0, 60 * scale, 2)  # near the person or farther away
            axes = np.maximum(np.round(rng.integers(4, 14, 2) * scale), 1).astype(int)
            at = (round(float(centre[0])), round(float(centre[1])))
            cv2.ellipse(out, at, (int(axes[0]), int(axes[1])), float(rng.uniform(0, 180)), 0, 360, value, -1)
    x, y, w, h = cv2.boundingRect(shadow)
    if faults.shadow > 0 and w > 0:
        there = (slice(y, y + h), slice(x, x + w))
        # patches: above the threshold that leaves this share of the noise (its sd is 0.8 after interpolation)
        threshold = 0.8 * NormalDist().inv_cdf(1 - faults.shadow) if faults.shadow < 1 else -np.inf
        out[there] |= (shadow[there] > 0) & (smooth_noise(rng, (h, w), 24 * scale) > threshold)
    return out


@dataclass(frozen=True)
class NoisyScene(Scene):
    """Scene whose masks have faults."""

    faults: MaskFaults = MaskFaults()

    def mask(self, view: int, index: int, scale: float = 1.0) -> Mask:
        """Render the mask of `Scene.mask` with the faults."""
        mask, camera = super().mask(view, index, scale), self.rig.pinhole().scaled(scale)[view]
        shadow, hidden = np.zeros_like(mask), self.occluder_depth(view, scale)
        if self.faults.shadow > 0:
            for subject, vertices in self.skins(self.shown(view, index)):
                shadow |= shadow_mask(camera, subject.faces, vertices)
        if hidden is not None:
            shadow &= ~np.isfinite(hidden)
        rng = np.random.default_rng([self.seed, _MASKS, view, index])
        return corrupt_mask(mask, shadow & (1 - mask), self.faults, rng, scale)


def noisy(scene: Scene, faults: MaskFaults = LEVELS["level-1"]) -> NoisyScene:
    """Give the masks of a scene faults."""
    return NoisyScene(**{f.name: getattr(scene, f.name) for f in fields(Scene)}, faults=faults)


def noisy_scene(*given: Any, corruption: Sequence[str] = ("level-1",), **more: Any) -> NoisyScene:
    """Make a scene as `make_scene` does, with faults of its masks.

    corruption: one of LEVELS, and names of `hypose.synthetic.scenes.CORRUPTIONS`.
    """
    (level,) = (n for n in corruption if n in LEVELS)
    return noisy(make_scene(*given, corruption=tuple(n for n in corruption if n != level), **more), LEVELS[level])
