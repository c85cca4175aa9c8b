"""Compare the colours of people's clothes; nothing else distinguishes people of one size at one place.

The colours of trunk and legs are counted in all views together, because a person who turns round shows the same shirt
to another camera.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.compute.part_colours import shown_parts
from hypose.evidence.colours import COLOURS
from hypose.evidence.frame import Colours, Frame, Silhouettes
from hypose.geometry import Array
from hypose.tracking.part_colours import counted_colours, part_layout

ZONES = ((1, 2), (5, 6))
"""Indices in part_colours.PARTS of each zone: trunk and sleeves, thighs and shanks."""
FEW = 150.0
"""Number of pixels that a zone must have shown to be compared."""


@dataclass(frozen=True)
class Appearance:
    """Colour counts of a person's clothes.

    counts: (Z, COLOURS) number of pixels by zone (ZONES: trunk, legs) and colour.
    """

    counts: NDArray[np.float32]

    @property
    def known(self) -> NDArray[np.bool_]:
        """Zones (Z,) of which enough pixels were seen."""
        return self.counts.sum(1) >= FEW

    def __add__(self, other: Appearance) -> Appearance:
        return Appearance(self.counts + other.counts)

    def likeness(self, other: Appearance) -> float:
        """Compare two appearances: 0 (no colour in common) to 1 (the same).

        Returns: mean over the zones of the Bhattacharyya coefficient of the colour distributions; NaN where no zone is
            known of both.
        """
        both = self.known & other.known
        if not both.any():
            return float("nan")
        a, b = (c.counts[both] / c.counts[both].sum(1, keepdims=True) for c in (self, other))
        return float(np.sqrt(a * b).sum(1).mean())


def no_appearance() -> Appearance:
    """Build the empty appearance of a person who has not been seen yet."""
    return Appearance(np.zeros((len(ZONES), COLOURS), np.float32))


@dataclass(eq=False)
class AppearanceModel:
    """Appearance model of one person, to find out whether two people were exchanged after they met.

    worn: colours from before other people came near.
    lately: colours counted since other people came near.
    looks: number of frames in `lately`.
    met: names of the people who came near, with the frame in which they were nearest.
    """

    worn: Appearance = field(default_factory=no_appearance)
    lately: Appearance = field(default_factory=no_appearance)
    looks: int = 0
    met: dict[str, int] = field(default_factory=dict)

    def settle(self) -> None:
        """Accept that the person is still the same: add the colours `lately` to `worn`, and forget the meetings."""
        self.worn, self.lately, self.looks, self.met = self.worn + self.lately, no_appearance(), 0, {}

    def arrays(self) -> dict[str, np.ndarray]:
        """Convert the colour counts to arrays for a checkpoint, which `of_arrays` reads."""
        return {"worn": self.worn.counts, "lately": self.lately.counts}

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> AppearanceModel:
        """Restore the model from the values of a checkpoint.

        arrays: as `arrays` returned them.
        about: as the property `about` returned them.
        """
        return cls(Appearance(arrays["worn"]), Appearance(arrays["lately"]), int(about["looks"]), dict(about["met"]))

    @property
    def about(self) -> dict[str, Any]:
        """Values for a checkpoint that are not in `arrays`: `looks` and `met`, as JSON values."""
        return {"looks": self.looks, "met": self.met}


def appearance_in(body: Body, pose: Array, frame: Frame) -> Appearance:
    """Count the colours of a person's clothes in all views of a frame.

    pose: (D,) pose of the person in this frame.
    Returns: counts of the pixels in the mask that show trunk and legs and that no other person covers; all 0 where the
        frame has no pictures.
    """
    out = no_appearance()
    for s, colours in zip(frame.of(Silhouettes), frame.of(Colours), strict=False):
        vertices, (faces, part, _), given = body.skin(pose), part_layout(body), s.informative
        for c in np.flatnonzero(s.usable & colours.seen).tolist():
            w, h = s.rig[c].size
            shown, box = shown_parts(vertices, faces, part, s.rig.projections[c], (h, w))
            found = counted_colours(shown[box], given[c][box].astype(np.uint8), colours.codes[c][box])
            out = out + Appearance(np.stack([found[list(zone)].sum(0) for zone in ZONES]))
    return out
