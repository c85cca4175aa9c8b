"""Find where a gesture is in a depth picture: votes of the pixels, their density, its memory of the last frames, and
the volume around the maximum.

Source: Alcoverro 2014, section 3.2.4. Deviations, both so that the same gesture scores the same at every distance: a
    vote is weighted by the surface that its pixel covers (z^2), and the density has unit sum, so that the volume V of
    eq. 3.5 is an area: the cm^2 of surface within the disc that vote for the gesture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hypose.compute import forest_votes, forests
from hypose.compute.forest_votes import ScanPlan
from hypose.compute.forests import DepthImage, PaddedDepth
from hypose.errors import refuse
from hypose.gestures.depth_pictures import KINECT, DepthLens, surface_depth
from hypose.gestures.forest import Forest, GrowingForest


@dataclass(frozen=True)
class LocaliseSettings:
    """Settings of the localisation.

    plan: pixels that are scanned.
    majority: share of the gesture that a pixel needs to vote for it.
    sigma_px: standard deviation of the Parzen kernel, px.
    adaptation_rate: share of the new frame in the density, alpha of eq. 3.4 (1 = no memory).
    disc_mm: radius of the disc over which the volume is summed, mm.

    The plan's stride and sigma_px apply to a focal length of 575.8 px (the first Kinect at 640 x 480) and are scaled
    with the lens, so that a picture of half the size gives the same result.
    """

    plan: ScanPlan = ScanPlan()
    majority: float = 0.5
    sigma_px: float = 8.0
    adaptation_rate: float = 1.0
    disc_mm: float = 60.0

    def at(self, lens: DepthLens) -> LocaliseSettings:
        """Return the settings scaled to the focal length of a lens."""
        factor = lens.fx / KINECT.fx
        plan = replace(self.plan, stride=max(1, round(self.plan.stride * factor)))
        return replace(self, plan=plan, sigma_px=self.sigma_px * factor)


@dataclass(frozen=True)
class Localisation:
    """Best place of one gesture in one picture.

    gesture: number of the gesture, from 1.
    x, y: pixel.
    score: V of eq. 3.5, cm^2; 0 where no pixel voted.
    position: (3,) m in the camera's frame; None where no depth was measured.
    """

    gesture: int
    x: float
    y: float
    score: float
    position: NDArray[np.float64] | None


@dataclass
class Scratch:
    """Memory that a detector keeps between frames.

    picture: padded picture whose memory is reused.
    densities: last density per gesture (eq. 3.4).
    """

    picture: PaddedDepth | None = None
    densities: dict[int, NDArray[np.float32]] = field(default_factory=dict)


Density = tuple[NDArray[np.float32], int]
"""Density of the votes on the scanning grid (rows, columns), m^2 of surface per cell, and the flat index of its
maximum.
"""


def localise(
    depth: DepthImage,
    lens: DepthLens,
    forest_list: Sequence[Forest | GrowingForest],
    settings: LocaliseSettings | None = None,
    scratch: Scratch | None = None,
) -> list[Localisation]:
    """Find the best place of every gesture in a depth picture.

    depth: (h, w) uint16 mm, 0 = hole.
    lens: lens parameters of the depth camera.
    forest_list: one forest per gesture.
    settings: settings of the localisation.
    scratch: memory of one stream, to pass in every frame; it holds the density of the last frames (eq. 3.4).
    Returns: one place per gesture, in the order of the gestures.
    Raises: InputError where the forests do not fit each other.
    """
    s, kept = settings or LocaliseSettings(), scratch or Scratch()
    return settle(densities(depth, lens, forest_list, s, kept), depth, lens, s, kept)


def densities(
    depth: DepthImage,
    lens: DepthLens,
    forest_list: Sequence[Forest | GrowingForest],
    settings: LocaliseSettings,
    scratch: Scratch,
) -> list[Density]:
    """Compute the density of every gesture's votes in one picture alone; `settle` then finds the places.

    depth: (h, w) uint16 mm, 0 = hole.
    lens: lens parameters of the depth camera.
    forest_list: one forest per gesture.
    scratch: memory that is reused in every frame.
    Raises: InputError where the forests do not fit each other.
    """
    s = settings.at(lens)
    reaches, count = {f.settings.reach_mm for f in forest_list}, len(forest_list)
    faults = {
        "There is no forest to search with; train a gesture first": not count,
        "The forests have different reaches; train them with the same reach_mm": len(reaches) > 1,
        f"{count} forests are too many for one search; give at most {forest_votes.MOST_FORESTS}": (
            count > forest_votes.MOST_FORESTS
        ),
    }
    refuse("", faults)
    picture = scratch.picture = forests.pad_depth(depth, lens.fx, s.plan.near_mm, max(reaches), scratch.picture)
    maps = forest_votes.scan(picture, [f.packed for f in forest_list], [f.settings.clip for f in forest_list], s.plan)
    return [forest_votes.parzen(picture, m, s.plan.stride, s.majority, s.sigma_px) for m in maps]


def settle(
    maps: Sequence[Density], depth: DepthImage, lens: DepthLens, settings: LocaliseSettings, scratch: Scratch
) -> list[Localisation]:
    """Find the best place of every gesture from the densities of one picture and the memory of the last ones (eq.
    3.4).

    maps: density of each gesture, of `densities`.
    depth: (h, w) uint16 mm, 0 = hole.
    lens: lens parameters of the depth camera.
    scratch: memory of one stream, which holds the density of the last frames.
    Returns: one place per gesture.
    Deviation: alpha is 1 (no memory) unless it is set; `hypose gesture` sets the printed 0.8.
    """
    s, out = settings.at(lens), []
    for gesture, (density, at) in enumerate(maps, 1):
        if s.adaptation_rate < 1:
            last = scratch.densities.get(gesture)
            if last is not None and last.shape == density.shape:
                density = (np.float32(s.adaptation_rate) * density + np.float32(1 - s.adaptation_rate) * last).astype(
                    np.float32
                )
                at = int(density.argmax())
            scratch.densities[gesture] = density
        out.append(peak(gesture, density, at, depth, lens, s))
    return out


def peak(
    gesture: int, density: NDArray[np.float32], at: int, depth: DepthImage, lens: DepthLens, s: LocaliseSettings
) -> Localisation:
    """Find the maximum of a density, its volume (eq. 3.5) and its position.

    gesture: number of the gesture, from 1.
    density: votes on the scanning grid, m^2 per cell.
    at: flat index of the maximum; it is refined below one cell by a parabola per axis.
    depth, lens: the picture, in mm, and its lens.
    s: settings, scaled to the lens.
    Deviation: V is an area, the cm^2 of surface within the disc that vote, so that it does not depend on the distance.
    """
    i, j = divmod(at, density.shape[1])
    stride = s.plan.stride
    if density[i, j] <= 0:
        return Localisation(gesture, float(j * stride + stride // 2), float(i * stride + stride // 2), 0.0, None)
    y, x = (i + _vertex(density[:, j], i)) * stride + stride // 2, (j + _vertex(density[i], j)) * stride + stride // 2
    z = surface_depth(depth, x, y)
    # with memory the maximum may lie where the hand was, without depth now: the disc is then that at 2 m
    radius = s.disc_mm * lens.fx / (z if z is not None else 2000.0) / stride
    r = int(np.ceil(radius))
    a, b = slice(max(0, i - r), i + r + 1), slice(max(0, j - r), j + r + 1)
    rows, columns = np.ogrid[a.start : min(a.stop, density.shape[0]), b.start : min(b.stop, density.shape[1])]
    score = 1e4 * float(density[a, b][(rows - i) ** 2 + (columns - j) ** 2 <= radius**2].sum())
    return Localisation(gesture, float(x), float(y), score, None if z is None else lens.point(x, y, z / 1000))


def _vertex(line: NDArray[np.float32], k: int) -> float:
    """Refine a maximum to a fraction of a cell by a parabola through it and its neighbours.

    line: values (N,) of a row or column of the density.
    k: index of the maximum.
    Returns: offset from k, -0.5 to 0.5; 0 at a border or where the values do not bend down.
    """
    if not 0 < k < len(line) - 1:
        return 0.0
    a, b, c = float(line[k - 1]), float(line[k]), float(line[k + 1])
    bend = a - 2 * b + c
    return 0.0 if bend >= 0 else float(np.clip(0.5 * (a - c) / bend, -0.5, 0.5))
