"""Findings of the diagnostics: properties of files, limits, faults, and checks of depth cameras."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any

import cv2
import numpy as np

from hypose.errors import EvidenceError
from hypose.evidence.depth_evidence import Depth, camera_on_floor, in_world
from hypose.geometry import transform

INVALID, REVIEW, INFO = "invalid", "review", "info"
"""Severities of a finding."""


@dataclass(frozen=True)
class ViewFile:
    """Properties of one view's file.

    size: width and height of the stored images, px; None where unknown.
    frame_rate: frames/s; None where unknown.
    frames: number of frames; None where unknown.
    accepted: the user has stated that the images were only stretched (accept_scaled).
    """

    size: tuple[int, int] | None = None
    frame_rate: float | None = None
    frames: int | None = None
    accepted: bool = False


@dataclass(frozen=True)
class Limits:
    """Limits above which the diagnostics report a fault; shares are of the person's longer side in the image.

    gross: disagreement of a view with the others above which gross faults are tried, share.
    gross_lens: disagreement above which other lens conventions are tried, share.
    gross_cured: share of the disagreement that may remain after the cure.
    lens_z: radial term, in its standard deviations.
    lens_gain: share of the residual that may remain after the radial term is freed.
    lens_px: effect of the radial term at the person, share.
    largest_lag: largest delay that is searched first, frames.
    late: delay from which a view counts as late, frames.
    late_sd: delay from which a view counts as late, in standard deviations of the delay.
    late_gain: least gain of half the log likelihood for a late view.
    keypoint_lag_sd: largest standard deviation of a lag of key points against the masks that counts, frames.
    shift: shift of a view's image, share.
    shift_sd: shift of a view's image, in its standard deviations.
    shift_spread: shift of a view's image, as a multiple of the spread of the other views' shifts.
    shift_px: smallest shift, px of the masks.
    extrinsics: share of the residual that may remain after a refinement.
    scatter: share that may remain when only camera poses were wrong and are refined (detectors reach 0.01 to 0.02).
    moved: movement of the person in a camera's image by the refinement, share.
    gain: smallest decrease of the residual, share.
    heights: range of a person's height, m.
    usual_heights: range of nearly all heights, m.
    height_share: relative difference from the known height that is a fault.
    height_doubt: relative difference from the known height that is worth a check.
    tangency: disagreement of the silhouettes' tangent planes, share.
    """

    gross: float = 0.03
    gross_lens: float = 0.012
    gross_cured: float = 0.45
    lens_z: float = 4.8
    lens_gain: float = 0.97
    lens_px: float = 0.006
    largest_lag: float = 12.0
    late: float = 0.4
    late_sd: float = 4.0
    late_gain: float = 12.0
    keypoint_lag_sd: float = 0.25
    shift: float = 0.006
    shift_sd: float = 3.3
    shift_spread: float = 2.3
    shift_px: float = 1.25
    extrinsics: float = 0.85
    scatter: float = 0.035
    moved: float = 0.012
    gain: float = 0.001
    heights: tuple[float, float] = (1.0, 2.3)
    usual_heights: tuple[float, float] = (1.4, 2.0)
    height_share: float = 0.12
    height_doubt: float = 0.07
    tangency: float = 0.02


@dataclass(frozen=True)
class Finding:
    """A fault, or something that the user should know.

    kind: one or two words, for programs.
    views: names of the affected cameras; empty for all.
    text: description with the evidence.
    cure: the next step; empty where there is none.
    size: size of the fault in a unit of its kind.
    severity: INVALID for a result that cannot be trusted, REVIEW for one that must be checked, INFO for information
        only.
    """

    kind: str
    views: tuple[str, ...]
    text: str
    cure: str = ""
    size: float = 1.0
    severity: str = INVALID

    @property
    def fault(self) -> bool:
        """Whether the finding makes a result invalid."""
        return self.severity == INVALID

    @property
    def sentence(self) -> str:
        """Description of the fault and the next step."""
        text = self.text if self.text.endswith((".", ":")) else f"{self.text}."
        return f"{text} Next: {self.cure}." if self.cure else text

    def document(self) -> dict[str, Any]:
        """Convert the finding to JSON values."""
        return {**vars(self), "views": list(self.views)}

    @staticmethod
    def of_document(kept: Mapping[str, Any]) -> Finding:
        """Restore a finding from the JSON values of `document`."""
        texts = {name: str(kept[name]) for name in ("kind", "text", "cure", "severity")}
        return Finding(views=tuple(map(str, kept["views"])), size=float(kept["size"]), **texts)


# ---- doctor depth --------------------------------------------------------------------------------------------------
# Checks of depth cameras by their maps: whether they measure at all, the floor that each sees, and people whom one sees
# at a place that is empty for another one.


FLOOR_M, FLOOR_DEGREES, PLAINLY = 0.03, 1.5, 4.0
"""Largest height (m) and tilt (degrees) of the floor seen by a depth camera against z = 0. From PLAINLY times these
values its maps cannot be trusted. With correct cameras they were at most 4 mm and 0.1 degrees (simulated, seeds 0 to
5); a scale error of 5 % gives 60 mm."""
_BEHIND_M = 0.3
"""Distance, m, by which a camera must see beyond a place to show that no person is there. Late cameras, and cameras
that were moved a little, see the person up to half a step farther away."""
_REFUTED = 0.7
"""Smallest share of points on people beyond which another camera sees, in a third of the frames, of a fault. The share
is at most 0.13 in correct recordings of one and two people, 0.32 with a camera that is 150 mm and 3
degrees off, 0.93 to 0.97 with exchanged maps of a walking person (simulated, seeds 20 to 31),
but at most 0.26 with exchanged maps of a person who stays in the middle."""
_POINTS, _FRAMES = 20, 3
"""Least number of points in front of another camera in a frame, and of such frames, for a result."""
_RIDDLED = 0.97
"""Share of measured pixels with a hole among their neighbours above which maps show no surface. It is at most 0.34 in
simulated cameras (seeds 20 to 25) and 0.07 in crops of a real one. In simulated maps it is 0.96 with three of ten
pixels lost, which can still be tracked, and 0.99 with four of ten, which cannot."""
_BLANK = 0.5
"""Share of frames without any measurement above which a camera is reported; cameras lose a few frames."""


def depth_findings(depths: Sequence[Depth]) -> tuple[Finding, ...]:
    """Check the depth cameras of a recording.

    The checks are: cameras that measure nothing, maps full of holes, the floor in the first and the last map, and
        cameras that see through the person whom another camera sees.

    depths: depth maps of some instants, in the order of time.
    Returns: the findings.
    """
    floors: dict[tuple[str, ...], Finding] = {}
    for depth, when in zip([*depths[:1], *depths[-1:]], ("", " at the end"), strict=False):
        floors = {f.views: f for f in _by_floor(depth, when)} | floors
    return (*_measuring_nothing(depths), *_riddled(depths), *floors.values(), *_by_people(depths))


def _riddled(depths: Sequence[Depth]) -> Iterator[Finding]:
    """Find cameras whose maps have so many holes that no surface is left."""
    for c in _cameras(depths):
        w, h = depths[0].rig[c].size
        measured = [(depth.maps[c, :h, :w] > 0).astype(np.uint8) for depth in depths if depth.usable[c]]
        whole = [cv2.erode(m, np.ones((3, 3), np.uint8), borderValue=1).sum() / max(1, m.sum()) for m in measured]
        share, name = 1 - float(np.median(whole)), depths[0].rig.names[c]
        if share > _RIDDLED:
            yield Finding(
                "holes",
                (name,),
                f"{name} has holes all over its depth maps: {100 * share:.0f} % of what it measures is next to one, "
                "and nothing shows a surface",
                "look at its maps, record without what dazzles it, and without a filter that drops single values",
                share,
            )


def _measuring_nothing(depths: Sequence[Depth]) -> Iterator[Finding]:
    """Find cameras whose maps are empty; it is a fault where no other view is left."""
    blank = np.array([np.zeros(len(d.rig), np.bool_) if d.blank is None else d.blank for d in depths])
    if not blank.size:
        return
    often = blank.mean(0)
    left = np.any([d.usable for d in depths], axis=0) | ~blank.any(0)
    for c in np.flatnonzero(often > _BLANK).tolist():
        name = depths[0].rig.names[c]
        when = "in all frames" if often[c] == 1 else f"in {100 * often[c]:.0f} % of the frames"
        yield Finding(
            "blank",
            (name,),
            f"{name} measures nothing {when} that were looked at: its depth maps are empty",
            "check whether it recorded, and give its maps again, or take its [[view]] out of recording.toml",
            float(often[c]),
            REVIEW if left.any() else INVALID,
        )


def _by_floor(depth: Depth, when: str) -> Iterator[Finding]:
    """Check the floor that each depth camera sees, because a wrong scale or pose of a single camera contradicts nothing
    else.
    """
    for c in np.flatnonzero(depth.usable):
        camera = depth.rig[int(c)]
        w, h = camera.size
        try:
            own = camera_on_floor(np.where(depth.person[c, :h, :w] > 0, 0.0, depth.maps[c, :h, :w]), camera)
        except EvidenceError:  # it need not see the floor
            continue
        away = float(in_world(camera, own[:3, 3])[2])
        tilt = float(np.degrees(np.arccos(np.clip(own[:3, 2] @ camera.camera_from_world[:3, 2], -1, 1))))
        size = max(abs(away) / FLOOR_M, tilt / FLOOR_DEGREES)
        if size > 1:
            yield Finding(
                "floor",
                (camera.name,),
                f"{camera.name} sees the floor{when} {1e3 * abs(away):.0f} mm {'above' if away > 0 else 'below'} z = 0,"
                f" tilted by {tilt:.1f} degrees",
                "check whether its maps are in millimetres and whether it has been moved since it was calibrated; "
                "hypose depth-import finds the cameras' places again",
                size,
                INVALID if size > PLAINLY else REVIEW,
            )


def seen_past(depth: Depth) -> tuple[int, int]:
    """Count the points that one depth camera measures on people, but at which another camera sees a surface further
    away; this shows that no person is there.

    depth: depth maps of all cameras at one instant.
    Returns: number of points at which another camera looks, and number of those beyond which it sees.
    """
    surface, looked, past = depth.surface, 0, 0
    for a, b in permutations(np.flatnonzero(depth.usable).tolist(), 2):
        camera = depth.rig[b]
        w, h = camera.size
        points = surface.points[surface.first[a] : surface.first[a + 1]]
        z = transform(camera.camera_from_world, points)[:, 2]
        points, z = points[z > 0.1], z[z > 0.1]
        u, v = np.rint(camera.project_pinhole(points)).astype(int).T
        inside = (u >= 0) & (u < w) & (v >= 0) & (v < h)
        seen = depth.maps[b, v[inside], u[inside]]
        looked += int((seen > 0).sum())
        past += int((seen > z[inside] + _BEHIND_M).sum())
    return looked, past


def _cameras(depths: Sequence[Depth]) -> list[int]:
    """List the indices of the views that are depth cameras."""
    return np.flatnonzero(np.any([d.usable for d in depths], axis=0)).tolist()


def _by_people(depths: Sequence[Depth]) -> Iterator[Finding]:
    """Find depth cameras that see past the person whom another camera sees, in the upper third of the frames, because a
    person who passes the middle of the scene is there even with wrong cameras.
    """
    shares = [past / looked for looked, past in map(seen_past, depths) if looked >= _POINTS]
    share = float(np.quantile(shares, 2 / 3)) if len(shares) >= _FRAMES else 0.0
    if share > _REFUTED:
        names = tuple(depths[0].rig.names[c] for c in _cameras(depths))
        yield Finding(
            "places",
            names,
            f"{' and '.join(names)} do not see the person at one place: one sees past {100 * share:.0f} % of what the "
            "other sees of them",
            "check whether every camera has its own maps of the same recording, not mirrored and not another camera's, "
            "and whether they all began at the same time; hypose depth-import finds the cameras' places again",
            share,
        )
